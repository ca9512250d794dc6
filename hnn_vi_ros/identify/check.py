# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""``hnn check``: whether a log is fit for a fit, and what it can tell, before the fit."""

from argparse import Namespace
from collections.abc import Iterator, Sequence
import os
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.effects import LARGEST
from hnn_vi_ros.errors import counted, DataError, ParameterError
from hnn_vi_ros.files import save_figure, write_text
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.identify import arguments as command_lines
from hnn_vi_ros.identify.commanded import (
    columns_of, delays_of, forces_needed, rated_efforts, robot_of, SPEED)
from hnn_vi_ros.identify.identify import source_by_format
from hnn_vi_ros.learning import (
    ANGLE, configuration_of, even_motions, EvenMotion, joined, LogWarning, low_pass, Motion,
    read_header, recording_of, run_of, split_runs, warnings_of)
from hnn_vi_ros.models import force_unit
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Half-width of an interval of 95 % in standard errors, cut-off of the estimates [Hz], share of the
# forces that a log resolves, and the motion that tells a number.
_WIDTH, _CUTOFF, _SEEN = 1.96, 10.0, 0.05
_COMMANDED = {
    'stiffness': ('N m/rad', 'steps of the command'), 'damping': ('N m s/rad', 'fast steps'),
    'friction': ('N m', 'slow ramps in both directions'),
    'rotor inertia': ('kg m2', 'steps that accelerate as fast as the servo can'),
    'offset times stiffness': ('N m', 'rests on both sides of the middle')}
_DRIVEN = {
    'scale of masses': ('1', 'postures with different weights'),
    'rotor inertia': ('kg m2', 'fast reversals'), 'damping': ('N m s/rad', 'several speeds'),
    'friction': ('N m', 'slow motion in both directions'),
    'offset': ('N m', 'the same posture from both sides')}
# Amplitude of an excitation relative to the range of a joint, and without limits [rad], [m]; its
# steps, which are small so that drives do not saturate, their duration [s], and the time of a
# slow ramp [s].
_SHARE, _UNLIMITED, _STEPS, _HELD, _RAMP = 0.2, 0.5, (0.2, -0.2, 0.3, -0.1, 0.0), 0.7, 8.0


class Told(NamedTuple):
    """
    A number of a joint.

    Parameters
    ----------
    name, unit : str
        Its name and unit.
    value, half_width : float
        Its value and half the width of its interval.
    motion : str
        The motion that tells it.
    share : float
        The half-width as a share of the forces: if it is small, the log has this motion.

    """

    name: str
    value: float
    half_width: float
    unit: str
    motion: str
    share: float

    @property
    def known(self) -> bool:
        """Return whether the half-width is less than the number; only offsets are negative."""
        return self.half_width < (abs(self.value) if 'offset' in self.name else self.value)

    @property
    def small(self) -> bool:
        """Return whether the log tells that the number hardly matters."""
        return not self.known and self.share < _SEEN


class Checked(NamedTuple):
    """Result of a check: the samples as logged and at even times, and what was found."""

    raw: list[Motion]
    motions: list[EvenMotion]
    names: list[str]
    units: list[str]
    times: str  # column of the times of a log
    description: str
    warnings: list[LogWarning]
    numbers: list[Told]
    delay: float | None

    @property
    def useless(self) -> list[str]:
        """Return the reasons that the log is useless."""
        found = [one.text for one in self.warnings if one.useless]
        if self.numbers and not any(one.known for one in self.numbers):
            found.append('it tells none of the numbers')
        return found


def main(argv: Sequence[str]) -> int:
    """Print the check of a log; return 1 if it is useless."""
    options = command_lines.check().parse_args(argv)
    if bool(options.excitation) > bool(options.robot):
        raise ParameterError('--excitation needs the robot: add --robot URDF')
    if not (options.log or options.excitation):
        raise ParameterError('give a LOG, or --robot URDF and --excitation FILE.csv')
    if options.excitation:
        robot = robot_of(options.robot)
        rows, names = excitation_of(robot), [one.name for one in robot.coordinates]
        write_text(options.excitation, '\n'.join([
            ','.join(['time', *(f'{name}_command' for name in names)]),
            *(','.join(f'{x:.6g}' for x in row) for row in rows)]) + '\n')
        print(*saturation_of(robot, rated_efforts(options.robot, names), rows), '', sep='\n')
    if not options.log:
        return 0
    try:
        found = check(options.log, options.robot)
    except DataError as problem:
        print(f'{problem}\n\nVerdict: useless.')
        return 1
    print('\n'.join(report_of(found)))
    if not options.robot:
        print('Checked: how it is read, and its faults; --robot URDF estimates what it tells.')
    if options.plot:
        draw(options.plot, found)
    return int(bool(found.useless))


def check(log: Sequence[str], robot: Path | None = None) -> Checked:
    """
    Check a log before a fit.

    Parameters
    ----------
    log : sequence of str
        Bags, arrays or logs of one machine.
    robot : Path, optional
        URDF of the robot, to estimate what the log tells.

    Raises
    ------
    DataError
        The log cannot be read, or holds no motion.
    ParameterError
        There is no such file.

    """
    for file, _ in map(split_runs, log):
        if not os.path.exists(file):
            raise ParameterError(f'{file}: no such file; give a bag, an .npz file of arrays, or a '
                                 'log')
    tree = None if robot is None else robot_of(robot)
    coordinates: Sequence[Any] = tree.coordinates if tree is not None else [
        Coordinate(one['name'], one['q_unit'], one['p_unit'])
        for one in configuration_of(log, usual=ANGLE)['coordinates']]
    names = [one.name for one in coordinates]
    options = Namespace(config=None, data=log, counts=None, inputs=None)
    for commanded in (True, False):
        source, data = source_by_format(options, coordinates, commanded)
        raw = recording_of(source, data, names, log, [one.q_unit for one in coordinates])
        if raw.motions[0].commanded or not commanded:
            break
    motions, description = even_motions(raw, data)
    units = [one.q_unit for one in coordinates]
    intervals = np.concatenate([np.diff(motion.t) for motion in raw.motions])
    usual = float(np.median(intervals))
    even = (spread := float(np.quantile(np.abs(intervals / usual - 1.0), 0.9))) <= 0.5
    found = Checked(raw.motions, motions, names, units, getattr(data, 'time', ''),
                    description, [], [], None)
    whole = _judged(found, tree, even)
    if whole.useless:
        # A fit of several motions learns at least what it does from the best.
        runs = [[one for one in motions if run_of(one) == run]
                for run in dict.fromkeys(map(run_of, motions))]
        alone = [_judged(found._replace(motions=run), tree, even) for run in runs] \
            if len(runs) > 1 else []
        if usable := [one for one in alone if not one.useless]:
            best = max(usable, key=lambda one: sum(number.known for number in one.numbers))
            run = run_of(best.motions[0])
            whole = best._replace(motions=motions, warnings=[LogWarning(
                f'all runs together: {"; ".join(whole.useless)}; below is what {run} alone tells'),
                *best.warnings])
    warnings = [*whole.warnings]
    if data.kind == 'log':
        warnings += [LogWarning(f'{name} is constant or without numbers, and left out')
                     for name in read_header(Path(log[0]), coordinates).still]
    if not even:
        warnings.append(LogWarning(f'a tenth of the intervals differ by more than {spread:.0%} '
                                   'from the usual one'))
    return whole._replace(warnings=warnings)


def _judged(found: Checked, tree: RigidBodyTree | None, even: bool) -> Checked:
    """Return a check with the warnings and the numbers of its motions."""
    warnings = warnings_of(found.motions, found.names, found.units, even)
    if tree is None or any(one.useless for one in warnings):
        return found._replace(warnings=warnings)
    numbers, delay = _told(tree, found.motions)
    return found._replace(warnings=warnings, numbers=numbers, delay=delay)


def _told(tree: RigidBodyTree, motions: Sequence[EvenMotion]) -> tuple[list[Told], float | None]:
    """Return the least-squares estimates from forces of a measured motion, and the delay."""
    names, delay = [one.name for one in tree.coordinates], None
    if motions[0].commanded:
        fits = [(_of_errors(tree, motions, one), one) for one in delays_of(motions)]
        residuals = [sum(_solved(*part)[2] / (part[1]**2).sum() for part in parts)
                     for parts, _ in fits]
        parts, delay = fits[int(np.argmin(residuals))]
        kinds = _COMMANDED
    else:
        parts = [(np.stack([forces_needed(tree, motion), motion.a_smooth, motion.v_smooth,
                            np.tanh(motion.v_smooth / SPEED), np.ones_like(motion.q)], axis=-1),
                  motion.tau) for motion in motions]
        columns, forces = map(np.concatenate, zip(*parts, strict=True))
        if forces.shape[1] != len(names) or not forces.any():
            return [], None
        kinds, parts = _DRIVEN, [(columns[:, k], forces[:, k]) for k in range(len(names))]
    found = []
    for name, part in zip(names, parts, strict=True):
        values, widths, _ = _solved(*part)
        with np.errstate(invalid='ignore'):
            shares = widths * np.linalg.norm(part[0], axis=0) / np.linalg.norm(part[1])
        if motions[0].commanded:
            # Relative to the stiffness, whose reciprocal is the first coefficient.
            values[0], widths[0] = 1.0 / values[0], widths[0] / values[0]**2
            values[1:], widths[1:] = values[1:] * values[0], widths[1:] * abs(values[0])
        found += [Told(f'{kind} of {name}', value, width, unit, motion, share)
                  for (kind, (unit, motion)), value, width, share in zip(
                      kinds.items(), values.tolist(), widths.tolist(), shares.tolist(),
                      strict=True)]
    return found, delay


def _of_errors(tree: RigidBodyTree, motions: Sequence[EvenMotion], delay: float
               ) -> list[tuple[np.ndarray, np.ndarray]]:
    """
    Return the columns of 1 / k, c / k, F / k, J / k, o and the errors r - q of each joint.

    The forces, with their noisy accelerations, are among the columns: on the other side they would
    be explained by a rotor with the negative inertia of the arm.
    """
    parts = []
    for motion in motions:
        columns, needed = columns_of(motion, 1.0, delay), forces_needed(tree, motion)
        table = np.concatenate([needed[..., None], -columns[..., 1:], columns[..., :1]], axis=-1)
        on = columns[..., 4] != 0.0
        # The equations hold for filtered motions as well, with less noise of accelerations.
        table = low_pass(motion.where, table, motion.spacing, _CUTOFF)
        parts.append(np.where(on[..., None], table, 0.0))
    both = np.concatenate(parts)
    return [(own[:, :5], own[:, 5]) for own in (
        both[both[:, k].any(axis=1), k] for k in range(both.shape[1]))]


def _solved(columns: np.ndarray, needed: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return least squares, half-widths with the correlation of residuals, and their squares."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    scaled = columns / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10)
    values = inverse @ (scaled.T @ needed)
    rest = needed - scaled @ values
    squares = float(rest @ rest)
    lag = float(rest[1:] @ rest[:-1]) / squares if squares else 0.0
    share = np.linalg.eigvalsh(scaled.T @ scaled)
    more = (1.0 + max(lag, 0.0)) / max(1.0 - lag, 1e-3)
    variance = np.diag(inverse) * squares / max(len(needed) - len(values), 1) * more
    # Columns that are zero, or a sum of others, tell nothing.
    lost = (columns == 0.0).all(axis=0) | (share[0] < 1e-10 * share[-1])
    return values / size, np.where(lost, np.inf, _WIDTH * np.sqrt(variance) / size), squares


def report_of(found: Checked) -> Iterator[str]:
    """Yield the lines of the report."""
    yield f'# {found.description}\n'
    intervals = np.concatenate([np.diff(motion.t) for motion in found.raw])
    usual = float(np.median(intervals))
    duration = sum(float(np.ptp(one.t)) for one in found.raw)
    yield (f'{counted(len(found.raw), "run")}, {sum(len(one.t) for one in found.raw)} samples, '
           f'{duration:.4g} s; {1.0 / usual:.4g} samples per second, '
           f'intervals {intervals.min():.3g} to {intervals.max():.3g} s\n')
    has = 'commanded positions' if found.motions[0].commanded else 'forces' if any(
        motion.tau.any() for motion in found.motions) else 'neither commands nor forces'
    rates = 'velocities' if found.motions[0].v is not None else 'no velocities'
    times, units = f'times of {found.times}, ' * bool(found.times), dict.fromkeys(found.units)
    yield f'Read as: {times}positions [{", ".join(units)}], {rates}, {has}.\n'
    if {*units} - {'rad'}:
        yield ('No log tells whether a length is in m or mm, nor a force in N or another unit: '
               'they are as named.\n')
    yield '| joint | least | largest | largest speed |\n|---|---|---|---|'
    q, v = joined(found.motions, 'q_smooth', 'v_smooth')
    for k, name in enumerate(found.names):
        yield (f'| {name} | {q[:, k].min():.4g} | {q[:, k].max():.4g} | '
               f'{np.abs(v[:, k]).max():.3g} |')
    if found.numbers:
        late = '' if found.delay is None else f', with a delay of {found.delay:.3g} s'
        yield (f'\nThe log tells (rough least squares of forces{late}; half-widths of 95 % '
               'lack the bias of filtered accelerations, which identify does not have):\n\n'
               '| number | value | half-width | unit |\n|---|---|---|---|')
        yield from (f'| {one.name} | {one.value:.3g} | {one.half_width:.2g} | {one.unit} |'
                    for one in found.numbers if one.known)
        if small := [one for one in found.numbers if one.small]:
            yield f'\nToo small to matter, within {_SEEN:.0%} of the forces:\n'
            yield from (f'- {one.name}: {one.value:.2g} +- {one.half_width:.2g} {one.unit}'
                        for one in small)
        if lacking := [one for one in found.numbers if not (one.known or one.small)]:
            yield '\nIt does not tell, and what would:\n'
            yield from (f'- {one.name}: {one.motion}' for one in lacking)
    if found.warnings:
        yield '\nWarnings:\n'
        yield from (f'- {one.text}' for one in found.warnings)
    verdict = f'useless: {"; ".join(found.useless)}' if found.useless else 'usable' + (
        ', see the warnings' if found.warnings else '')
    yield f'\nVerdict: {verdict}.'


def draw(path: Path, found: Checked) -> None:
    """Draw positions, commands and intervals of the first run."""
    # Imported lazily: the import is slow.
    from matplotlib.figure import Figure
    motion, raw, d = found.motions[0], found.raw[0], len(found.names)
    figure = Figure(figsize=(8.0, 1.6 * (d + 1)), layout='constrained')
    axes = figure.subplots(d + 1, 1)
    for k, (axis, name) in enumerate(zip(axes, found.names, strict=False)):
        if motion.commanded and k < motion.tau.shape[1]:
            command = np.where(np.abs(motion.tau[:, k]) > 1e9, np.nan, motion.tau[:, k])
            axis.step(motion.t, command, where='post', color='C1', label='command')
        axis.plot(motion.t, motion.q[:, k], color='C0', label='position')
        axis.set_ylabel(name)
    axes[0].legend(loc='upper right')
    axes[-1].plot(raw.t[1:], 1e3 * np.diff(raw.t), '.', markersize=2)
    axes[-1].set(xlabel='t [s]', ylabel='interval [ms]')
    save_figure(path, figure)


def saturation_of(robot: RigidBodyTree, limits: np.ndarray, rows: np.ndarray) -> Iterator[str]:
    """Yield for each joint with a limit what saturates its drive in an excitation."""
    q = rows[:, 1:]
    weights = np.abs(robot.gradient(q, np.zeros_like(q))[0]).max(axis=0)
    steps = np.abs(np.diff(q, axis=0)).max(axis=0)
    for one, weight, step, limit in zip(robot.coordinates, weights, steps, limits, strict=True):
        if limit < LARGEST:
            unit, most = force_unit(one.p_unit), (limit - weight) / step
            yield (f'{one.name}: up to {weight:.3g} of {limit:.3g} {unit} bear the weight; ' + (
                f'its steps of {step:.3g} {one.q_unit} saturate a drive stiffer than {most:.3g} '
                f'{unit}/{one.q_unit}: then make them smaller' if most > 0.0 else
                'the drive saturates: command other positions'))


def excitation_of(robot: RigidBodyTree) -> np.ndarray:
    """Return times and positions to command, (N, 1 + d), joint by joint: steps, slow ramps."""
    d, rows, time = robot.dimension, list[list[float]](), 0.0
    middle, size = np.zeros(d), np.full(d, _UNLIMITED)
    for k, joint in enumerate(robot.joints):
        low, high = joint.bounds
        if low is not None and high is not None:
            middle[k], size[k] = 0.5 * (low + high), min(_SHARE * (high - low), _UNLIMITED)
    for k in range(d):
        course = [(step, _HELD) for step in _STEPS] + [
            (x, 0.02) for x in np.interp(np.arange(0.0, _RAMP, 0.02), np.array(
                [0.0, 0.25, 0.75, 1.0]) * _RAMP, [0.0, 1.0, -1.0, 0.0])]
        for share, held in course:
            target = middle.copy()
            target[k] += share * size[k]
            rows.append([time, *target])
            time += held
    return np.array(rows)
