# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate a recorded run again, and compare its states with the log bit by bit."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.effects import Command
from hnn_vi_ros.errors import HnnViRosError, prefixed, RecordingError, StepFailure
from hnn_vi_ros.kernels import identity
from hnn_vi_ros.phase_space import columns, momentum_rates
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.run.companions.sensors import joint_sensor, joints_of
from hnn_vi_ros.run.recorded_run import CAUSES, own_topics, RecordedRun, simulators
from hnn_vi_ros.run.sampling import nanoseconds_of, Sampler
from hnn_vi_ros.run.saved_state import restore_state, STATE_FILE
from hnn_vi_ros.simulation import build, PathReport, Simulation
import numpy as np

# Relative changes of the initial state: one far above round-off and far below the motion, and
# no change, which is -0.0 because adding 0.0 would change a -0.0.
_PERTURBATION, _NO_PERTURBATION = 2.0**-26, -0.0
# Round-off of one step, in units in the last place of the largest coordinate or momentum: the
# solver stops at a few units, and a network sums hundreds of terms.
_ROUND_OFF_UNITS = 64.0
_EPSILON = np.finfo(np.float64).eps
# Relative changes of a state along which H is linear up to round-off, and the largest round-off
# on another processor relative to that seen there, which is of a few states only.
_NEIGHBOURS, _SCATTERS = 2.0**-34 * np.arange(-8, 9), 8.0
# Maximum steps per sample, and before the first sample of another recorder. At 1 to 3 us per
# step, 10^6 steps per sample still run in real time at one sample per second.
_MAX_STEPS_PER_SAMPLE, _MAX_STEPS_BEFORE = 10**6, 10**8
# Error of a difference of stamps, which are rounded to nanoseconds [ns].
_STAMP_ROUNDING = 2
# Minimum number of differences, and minimum share of equal ones, for an evenly spaced grid.
_MIN_COUNT, _MIN_SHARE = 3, 0.5


class Verdict(NamedTuple):
    """Verdict of a comparison: text of one line, and True if the log is confirmed."""

    text: str
    good: bool


class Difference(NamedTuple):
    """The first difference: its stamp [ns], the quantity, and the two values."""

    stamp: int
    name: str
    recorded: float
    simulated: float


class Margin(NamedTuple):
    """The largest difference, the part explained by round-off, its stamp [ns], the quantity."""

    difference: float
    explained: float
    stamp: int
    name: str


def check_replays(bag: Path, trust_code: bool = False, node: str = '') -> Iterator[Verdict]:
    """
    Yield the verdict on the run of each simulator in a bag; see ``check_replay``.

    Parameters
    ----------
    bag : Path
        A folder with the files of one bag, or one file.
    trust_code : bool, optional
        True to allow the execution of Python code that a scene names.
    node : str, optional
        Name of the simulator whose run is checked; empty checks all.

    """
    reader = BagReader(bag)
    nodes = simulators(reader, own_topics(reader))
    if node or len(nodes) == 1:
        yield check_replay(bag, trust_code, node)
        return
    for found in nodes:
        try:
            verdict = check_replay(bag, trust_code, found)
        except HnnViRosError as problem:
            # Continue with the other simulators.
            verdict = Verdict(str(problem), False)
        yield verdict._replace(text=f'{found}: {verdict.text}')


def check_replay(bag: Path, trust_code: bool = False, node: str = '') -> Verdict:
    """
    Simulate the run of a bag again from its scene and first state, and compare each sample.

    Unreadable parts of the bag and samples missing from the even grid of stamps are reported, and
    the log is then not confirmed.

    Parameters
    ----------
    bag : Path
        A folder with the files of one bag, or one file.
    trust_code : bool, optional
        True to allow the execution of Python code that the scene names.
    node : str, optional
        Name of the simulator; required if the bag holds several.

    Raises
    ------
    HnnViRosError
        The bag does not come from the simulator, or a file that the run used is missing.

    """
    run = RecordedRun(bag, trust_code, node)
    simulation = _simulation(run)
    # Called after the build, which imports the libraries whose versions are compared.
    there, here = run.reader.metadata('hnn_vi_ros'), identity()
    others = {name: there.get(name, 'unknown') for name, value in here.items()
              if there.get(name) != value and (name != 'torch' or name in there)}
    where = 'on the machine and with the versions of the log'
    if others:
        where = 'under conditions other than those of the log, where ' + ', '.join(
            f'{name} is {value}' for name, value in others.items()) if there \
            else 'of a log that states neither machine nor versions'
    begin, path_error = simulation.steps, PathReport.of(run.scene)
    path_error.follow(simulation, period=0.0)
    readings = _Readings(run, simulation)
    samples, difference = _first_difference(run, simulation, readings)
    missing = _gap_report(run, begin)
    if difference is None and not samples:
        path_error.close()
        return Verdict(f'{run.reader.path}: contains no samples to compare{missing}', False)
    compared = 'work' if simulation.ledger is None else f'work, and the {CAUSES},'
    agreed = f'{run.reader.path}: q, p, dp/dt, H and {compared} of {samples} samples are ' \
        f'bit-identical, {where}'
    if difference is None:
        missing = readings.report() + missing
        path_error.finish()
        return Verdict(f'{agreed}{readings.omitted}; {path_error}{missing}', not missing)
    path_error.close()
    margin = _margin(run)
    size = abs(difference.simulated - difference.recorded)
    within = margin.difference <= margin.explained < np.inf
    commands = ('; the scene takes commands, but the log does not contain the steps at which they '
                'acted') \
        if simulation.motors.takes and not any(run.commands()) else ''
    return Verdict(
        f'{agreed}; then {difference.name} differs at t = {difference.stamp * 1e-9:.9g} s by '
        f'{size:.3g}: {difference.recorded!r} in the log, {difference.simulated!r} now; the '
        f'largest difference, {margin.difference:.3g} of {margin.name} at t = '
        f'{margin.stamp * 1e-9:.9g} s, is {"within" if within else "beyond"} what round-off '
        f'explains, {margin.explained:.3g}{commands}{missing}',
        within and bool(others) and not missing)


def _gap_report(run: RecordedRun, begin: int) -> str:
    """Return the report on missing or duplicate samples and on damage, '' if there are none."""
    text, stamps = '', [stamp for stamp, _, _ in run.samples()]
    if repeated := [stamp for before, stamp in pairwise(stamps) if stamp == before]:
        text = (f'; BUT {len(repeated)} samples are duplicates, the first at t = '
                f'{repeated[0] * 1e-9:.9g} s')
    if run.own and stamps:
        # Only the simulator's own bags must begin at the first step; others may begin later.
        stamps.append(run.stamp_of(begin))
    if gaps := stamp_gaps(stamps, run.spacing):
        first = gaps[0]
        text += (f'; BUT {sum(gap.count for gap in gaps)} samples are missing in {len(gaps)} '
                 f'gaps, the first from t = {first.after * 1e-9:.9g} s to '
                 f'{first.before * 1e-9:.9g} s')
    if run.reader.damage:
        text += f'; BUT {run.reader.damage}'
    return text


class StampGap(NamedTuple):
    """
    A gap in an even grid.

    Parameters
    ----------
    after, before : int
        Stamps before and after the gap [ns].
    count : int
        Number of missing stamps between them.

    """

    after: int
    before: int
    count: int  # type: ignore[assignment]  # not tuple.count


def stamp_gaps(stamps: Sequence[int] | np.ndarray, spacing: int | None = None) -> list[StampGap]:
    """
    Return the gaps in a grid; the default spacing is the most frequent difference.

    Additional stamps within the grid, such as those of single steps in a pause, are ignored. If
    less than half of the stamps are evenly spaced, no gaps are returned.

    Parameters
    ----------
    stamps : sequence of int
        Stamps in any order [ns].
    spacing : int, optional
        Largest regular difference between two stamps [ns].

    """
    t = np.unique(np.asarray(stamps, dtype=np.uint64))
    differences = np.diff(t).astype(np.float64)
    usual = spacing or _most_frequent(differences)
    if usual is None:
        return []
    return [StampGap(int(t[i]), int(t[i + 1]), round(differences[i] / usual) - 1)
            for i in np.flatnonzero(differences > 1.5 * usual)]


def _most_frequent(differences: np.ndarray) -> float | None:
    """Return the most frequent difference; None if less than half of them are equal to it."""
    if len(differences) < _MIN_COUNT:
        return None
    values, counts = np.unique(differences, return_counts=True)
    spacing = float(values[np.argmax(counts)])
    even = np.abs(differences - spacing) <= _STAMP_ROUNDING
    return spacing if even.sum() >= max(_MIN_COUNT, _MIN_SHARE * len(differences)) else None


def _simulation(run: RecordedRun, shake: float = _NO_PERTURBATION) -> Simulation:
    """Return a simulation at the start of the bag, its state perturbed by a relative change."""
    simulation = build(run.scene)
    for name, value in simulation.hamiltonian.provenance.items():
        if run.described.get(name, value) != value:
            raise RecordingError(
                f'{run.reader.path}: was recorded with another model: its {name} is '
                f'{run.described[name]}, but that of the model found is {value}')
    q, p = simulation.q.copy(), simulation.p.copy()
    change = shake * _size(simulation)
    simulation.restart(q + change, p + change, step=run.first_step)
    if (state := run.reader.attachment(STATE_FILE)) is not None:
        restore_state(simulation, state, str(run.reader.path), change)
    return simulation


def _simulated_samples(run: RecordedRun, *simulations: Simulation
                       ) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Yield the stamp and values of each sample, with the simulations advanced to its step."""
    commands = run.commands()
    command = next(commands, None)
    for number, (stamp, values) in enumerate(run.reported(), 1):
        step = run.step_of(stamp)
        if step - run.first_step > _MAX_STEPS_BEFORE + number * _MAX_STEPS_PER_SAMPLE:
            raise RecordingError(
                f'{run.reader.path}: verifying its sample {number} requires '
                f'{step - run.first_step} steps of {run.scene.step_size:g} s, expected at most '
                f'{_MAX_STEPS_PER_SAMPLE:.0e} per sample and {_MAX_STEPS_BEFORE:.0e} before the '
                'first; check the step_size of its scene')
        # A step publishes its state before it takes commands, which act from the next step on.
        while command is not None and command[0] < step:
            for simulation in simulations:
                _advance(run, simulation, command[0])
                _command(run, simulation, *command[1:])
            command = next(commands, None)
        for simulation in simulations:
            _advance(run, simulation, step)
            if any(own.shape != values.get(kind, own).shape
                   for kind, own in _values(simulation).items()):
                raise RecordingError(f'{run.reader.path}: the dimension of its samples differs '
                                     'from that of its scene')
        yield stamp, values


def _values(simulation: Simulation) -> dict[str, np.ndarray]:
    """Return the values that ~/state would hold for the current state."""
    rates = momentum_rates(simulation.hamiltonian.rotations, simulation.q, simulation.p,
                           simulation.dH_dq, simulation.dH_dp)
    return {'q': simulation.q, 'p': simulation.p, 'dp/dt': rates,
            'H': np.array([simulation.energy]), 'work': np.array([simulation.work])} | (
                {} if simulation.causes is None else {CAUSES: simulation.causes})


def _advance(run: RecordedRun, simulation: Simulation, step: int) -> None:
    if step < simulation.steps:
        raise RecordingError(f'{run.reader.path}: contains a message from step {step}, earlier '
                             f'than its first state, at step {simulation.steps}')
    with prefixed(f'{run.reader.path}: cannot be simulated again', RecordingError, StepFailure):
        simulation.advance(max(0, step - simulation.steps))


def _command(run: RecordedRun, simulation: Simulation, topic: str, command: Command) -> None:
    """Apply a recorded command; the simulator's own bags hold only accepted commands."""
    try:
        # Own bags hold accepted commands, perhaps of a version without joint limits.
        simulation.set_command(command, limited=not run.own)
    except ValueError as problem:
        if run.own:
            raise RecordingError(f'{run.reader.path}: {topic}: {problem}') from problem


class _Readings:
    """Readings of the sensor of joint_states in a repeated run, compared with its bag."""

    def __init__(self, run: RecordedRun, simulation: Simulation):
        self._sensor, self.omitted = None, ''
        # Other recorders may have lost messages.
        if run.scene.measurements is not None and run.own and run.spacing:
            every = round(run.spacing / nanoseconds_of(simulation.step_size))
            self._sensor = joint_sensor(run.scene, simulation, every)
            self._sampler = Sampler(simulation, 1.0 / (every * simulation.step_size), run.origin)
            _, self._values = joints_of(simulation.hamiltonian.coordinates)
            stamps = ((message.header.stamp, message) for message in run.joint_states())
            self._recorded = {t.sec * 10**9 + t.nanosec: message for t, message in stamps}
        elif run.scene.measurements is not None:
            self.omitted = '; readings of joint_states are not compared: another recorder may ' \
                'have lost some'
        self._wrong = list[int]()

    def compare(self) -> None:
        """Compare the reading at the simulation's state."""
        if self._sensor is None:
            return
        sample = self._sampler.sample()
        found = self._sensor.measure(sample.step, self._values(sample))
        recorded = self._recorded.pop(sample.stamp, None)
        own, there = (None if one is None else b''.join(
            np.asarray(part).tobytes() for part in (one.position, one.velocity, one.effort))
            for one in (found, recorded))
        if self._sensor.settled and own != there:
            self._wrong.append(sample.stamp)

    def report(self) -> str:
        """Return the report on readings that differ, or ''."""
        return f'; BUT {len(self._wrong)} readings of joint_states differ, the first at t = ' \
            f'{self._wrong[0] * 1e-9:.9g} s' if self._wrong else ''


def _first_difference(run: RecordedRun, simulation: Simulation, readings: _Readings
                      ) -> tuple[int, Difference | None]:
    """Return the number of equal samples, counted once per stamp, and the first difference."""
    count, newest = 0, None
    names, momenta = columns(simulation.hamiltonian.coordinates)
    ledger = simulation.ledger
    labels: dict[str, Sequence[str]] = {'q': names, CAUSES: ledger.names if ledger else ()}
    for stamp, values in _simulated_samples(run, simulation):
        own = _values(simulation)
        for kind, recorded in values.items():
            # Compare the bits: -0.0 is not 0.0.
            simulated = np.ascontiguousarray(own[kind])
            different = np.flatnonzero(recorded.view(np.uint64) != simulated.view(np.uint64))
            if different.size:
                i = different[0]
                name = kind if kind in ('H', 'work') else (
                    f'{kind} of {labels.get(kind, momenta)[i]}')
                return count, Difference(stamp, name, float(recorded[i]), float(simulated[i]))
        readings.compare()
        # A duplicate counts once.
        count, newest = count + (stamp != newest), stamp
    return count, None


def _margin(run: RecordedRun) -> Margin:
    """
    Return the margin of the value that exceeds the round-off estimate by the largest factor.

    The round-off of each step propagates like a change of the initial state, whose growth a second
    simulation measures. It changes H by at most that times the largest |dH/dq| + |dH/dp|, the work
    by as much as H or as in the second simulation, and dp/dt by as much as there. The round-off of
    each of these quantities is added; that of H, whose terms may be much larger than their sum,
    is measured at adjacent states, and each step of the work has as much.
    """
    own = _simulation(run)
    try:
        shaken = _simulation(run, _PERTURBATION)
    except ValueError:
        # A constraint does not allow the perturbed state; the growth is then unknown.
        shaken = _simulation(run)
    change = _PERTURBATION * _size(own)
    sizes, growths = dict.fromkeys(_values(own), 0.0), dict.fromkeys(_values(own), 0.0)
    growth, slope, scatter, worst = 1.0, 0.0, 0.0, Margin(0.0, 0.0, 0, 'q')
    for stamp, values in _simulated_samples(run, own, shaken):
        here, there = _values(own), _values(shaken)
        for kind in here:
            sizes[kind] = max(sizes[kind], _largest(here[kind]))
            growths[kind] = max(growths[kind], _largest(there[kind] - here[kind]) / change)
        growth = max(growth, growths['q'], growths['p'])
        slope = max(slope, float(np.abs(own.dH_dq).sum() + np.abs(own.dH_dp).sum()))
        steps, scatter = own.steps - run.first_step, max(scatter, _scatter(own))
        rounded = _ROUND_OFF_UNITS * _EPSILON * max(sizes['q'], sizes['p']) * steps
        parts = {'H': _SCATTERS * scatter} | dict.fromkeys(
            ('work', CAUSES), _SCATTERS * scatter * (1 + steps))
        carried = {'q': growth, 'p': growth, 'dp/dt': growths['dp/dt'], 'H': growth * slope,
                   'work': growth * slope + growths['work'],
                   CAUSES: growth * slope + growths.get(CAUSES, 0.0)}
        for kind, recorded in values.items():
            difference = _largest(recorded - here[kind])
            explained = rounded * carried[kind]
            if kind not in ('q', 'p'):
                explained += _ROUND_OFF_UNITS * _EPSILON * sizes[kind] + parts.get(kind, 0.0)
            found = Margin(difference, explained, stamp, kind)
            if np.isnan(difference):
                # The log holds NaN, which round-off does not explain.
                return found
            if difference and difference * worst.explained >= worst.difference * explained:
                worst = found
    return worst


def _scatter(simulation: Simulation) -> float:
    """Return the round-off of H [J]: the second differences of H in a row of adjacent states."""
    scales = 1.0 + _NEIGHBOURS.reshape((-1,) + (1,) * simulation.q.ndim)
    energies = simulation.hamiltonian.energy(
        scales * simulation.q, scales * simulation.p, simulation.time)
    return _largest(np.diff(energies, 2, axis=0)) / 2.0


def _size(simulation: Simulation) -> float:
    """Return the magnitude of the largest coordinate or momentum, 1 if all are zero."""
    return max(_largest(simulation.q), _largest(simulation.p)) or 1.0


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max())
