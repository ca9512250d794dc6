# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fit numbers of a scene to measured motions: ``hnn identify``."""

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
import json
import math
import os
from pathlib import Path
import shlex
import tempfile
from typing import NamedTuple

from hnn_vi_ros.effects import Effect, ExternalForce, Joined, Servo
from hnn_vi_ros.errors import counted, DataError, ParameterError, UnsupportedSystem
from hnn_vi_ros.files import elapsed, make_folder, save_figure, write_text
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.identify import arguments as command_lines
from hnn_vi_ros.identify.commanded import (
    as_ratios, better_servos, commanded_scene, first_scene, RATE, SPEED_NAME, SPEEDS)
from hnn_vi_ros.identify.free_numbers import free_scene, FreeScene, STATES, write_fitted
from hnn_vi_ros.identify.intervals import Estimate, Estimates, estimates_of, profile, quantile
from hnn_vi_ros.identify.loads import check_loads, Load, load_of, read_loads, with_load
from hnn_vi_ros.learning import (
    ArraysData, check_times, Course, DELAY, EvenMotion, EVIDENCE, fit_numbers, FittedNumbers,
    input_courses, InputCourses, judged, keys_of, made_up, MeasuredColumns, MotionSource,
    predicted_by, read_motions, refitted, refusals, Solution, source_of, split_runs, steps_between,
    warnings_of, Windows)
from hnn_vi_ros.models import force_unit
from hnn_vi_ros.phase_space import Coordinate, energy_unit
from hnn_vi_ros.scene import load_scene, Parts, Scene
from hnn_vi_ros.simulation import build, DifferentiableRun, resolve
import numpy as np

REPORT, FIT, CORRELATIONS = 'report.md', 'fit.png', 'correlations.png'
_INK, _FITTED = '#333333', '#d55e00'
# Maximum of samples drawn per quantity; more cannot be distinguished.
_MOST = 4000
_INTERVAL = 1.96
# Tolerance in powers of ten around a ratio of 1000, which suggests a wrong unit: factor 2.
_MILLI = 0.3


def draw_fit(path: Path, solution: Solution, channels: Sequence[tuple[str, str]]) -> None:
    """Plot measurement and fit of the longest run, and the residuals with their noise."""
    from matplotlib.figure import Figure
    windows = solution.windows
    runs = [len(motion.t) for motion in windows.motions]
    run = int(np.argmax(runs))
    own = np.flatnonzero(windows.run == run)
    t = np.concatenate([windows.motions[run].t[windows.first[w]:][:windows.there[w].sum()]
                        for w in own])
    measured, residuals = (np.concatenate([part[w][windows.there[w]] for w in own])
                           for part in (windows.measured, solution.residuals))
    fitted, thin = measured + residuals * solution.noise, max(1, len(t) // _MOST)
    count = len(channels)
    figure = Figure(figsize=(12.0, 1.0 + 2.2 * count), layout='constrained')
    grid = figure.subplots(count, 2, sharex=True, squeeze=False)
    for c, (name, unit) in enumerate(channels):
        left, right = grid[c]
        left.plot(t[::thin], measured[::thin, c], '.', color=_INK, markersize=2.5,
                  label='measured')
        left.plot(t[::thin], fitted[::thin, c], color=_FITTED, linewidth=1.0, label='fitted')
        left.set_ylabel(f'{name} [{unit}]', parse_math=False)
        right.plot(t[::thin], residuals[::thin, c], '.', color=_FITTED, markersize=2.5)
        for side in (-_INTERVAL, _INTERVAL):
            right.axhline(side, color=_INK, linewidth=0.7, linestyle='--')
        right.set_ylabel(f'{name}: residual / noise [1]', parse_math=False)
        for axes in (left, right):
            axes.grid(alpha=0.3)
    grid[0, 0].legend(loc='upper right', frameon=False)
    grid[0, 1].set_title('dashed: 95 % band of white noise', fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel('t [s]')
    figure.suptitle(f'run {windows.motions[run].name}', parse_math=False)
    save_figure(path, figure, 130)


def draw_correlations(path: Path, estimates: Estimates) -> None:
    """Plot the correlations of the errors of all determined numbers."""
    from matplotlib.figure import Figure
    rows = [k for k, one in enumerate(estimates.estimates) if one.known]
    names = [estimates.estimates[k].name for k in rows]
    error = np.sqrt(np.diag(estimates.covariance)[rows])
    scale = np.where(error > 0.0, error, 1.0)
    matrix = estimates.covariance[np.ix_(rows, rows)] / np.outer(scale, scale)
    size = 2.5 + 0.55 * len(rows)
    figure = Figure(figsize=(size + 1.5, size), layout='constrained')
    axes = figure.add_subplot()
    picture = axes.imshow(matrix, cmap='RdBu_r', vmin=-1.0, vmax=1.0)
    axes.set_xticks(range(len(rows)), names, rotation=60, ha='right')
    axes.set_yticks(range(len(rows)), names)
    for i, j in np.ndindex(*matrix.shape):
        axes.text(j, i, f'{matrix[i, j]:.2f}', ha='center', va='center', fontsize=8,
                  color='white' if abs(matrix[i, j]) > 0.6 else _INK)
    figure.colorbar(picture, ax=axes, label='correlation of the errors [1]')
    save_figure(path, figure, 130)


# Warn if residuals exceed the noise in short windows by this factor.
_POOR = 3.0
# Change of a number at half the step that matters, in standard errors, and most halvings: the
# rest of the error of a method of order 2 is a third more; intervals of 95 % then hold 94 %.
_MOVED, _HALVED = 0.2, 6
# Names of velocities, and of commanded positions, in arrays.
_VELOCITIES = 'dq', 'v'
_COMMANDS = {'command': ('command', 'goal', 'action', 'target', 'reference', 'q_des'),
             'enabled': ('enabled', 'torque_enable')}


class Identified(NamedTuple):
    """Result of a fit with all that its report needs."""

    free: FreeScene
    solution: Solution
    estimates: Estimates
    stages: list[tuple[float, float]]
    hamiltonian: Hamiltonian
    data: str
    inputs: InputCourses | None
    notes: list[str]


def main(argv: Sequence[str]) -> None:
    """Run the fit requested by the command line."""
    options = command_lines.identify().parse_args(argv)
    _check(options)
    with tempfile.TemporaryDirectory() as folder:
        scene = first_scene(options.robot, Path(folder)) if options.robot else \
            load_scene(options.scene)
        found = identify(scene, options, Path(folder))
        text = report_of(found)
        print(text)
        command = shlex.join(['hnn', 'identify', *argv])
        _write(options, found, f'{text}\n\n`{command}`')


def identify(scene: Scene, options: Namespace, folder: Path) -> Identified:
    """
    Fit the numbers of a scene.

    Parameters
    ----------
    scene : Scene
        Scene to fit; with the option ``robot``, that of ``first_scene``, which gets servos.
    options : Namespace
        Options of the command line.
    folder : Path
        Folder for temporary files of the fit.

    """
    parts = _supported(scene, options)
    scene, hamiltonian, _, effects = parts
    servo = any(isinstance(effect, Servo) for effect in effects) and not any(
        isinstance(effect, ExternalForce) for effect in effects)
    log = _log(options, hamiltonian, servo or options.robot is not None)
    motions, driven = log.motions, any(motion.tau.any() for motion in log.motions)
    commanded, notes, loads = motions[0].commanded, list[str](), read_loads(options.loads)
    check_loads(loads, [motion.name for motion in motions])
    if options.robot:
        if not commanded:
            raise DataError(f'{options.data[0]}: no commanded positions; name their columns after '
                            'the joints, such as elbow_command, or fit '
                            'measured forces with hnn train and the family rigid_body')
        servos = partial(commanded_scene, options.robot, robots=_loaded(scene, loads, motions),
                         motions=motions, known=_known(options.known))
        scene, wanted = servos(folder)
        more = [name for name in options.free if name != STATES]
        options.free = [*wanted, *options.free]
        parts = resolve(scene)
        _, hamiltonian, _, effects = parts
        notes = _of_commands(options, wanted)
    if not driven:
        motions = [replace(motion, tau=np.zeros((len(motion.t), hamiltonian.dimension)))
                   for motion in motions]
    if driven and not commanded and not any(
            isinstance(effect, ExternalForce) for effect in effects):
        raise DataError(f'{options.data[0]}: the motions contain forces, but {scene.name} has no '
                        'effect external_force; add it for the driven coordinates')
    spacing = motions[0].spacing
    check_times(effects, motions, spacing / steps_between(spacing, scene.known_step_size))
    wanted, bounds = [name for name in options.free if name != STATES], (
        {SPEED_NAME: SPEEDS} if options.robot else {}) | _bounds(options.bounds)
    free = free_scene(parts, wanted, bounds, folder, driven and not commanded, loads)
    wanted = [number.name for number in free.numbers]
    for option, given in (('bounds', bounds), ('profile', options.profile)):
        for name in given:
            if name not in wanted:
                raise ParameterError(f'--{option} {name}: not among the free numbers '
                                     f'({", ".join(wanted)})')
    seen = _seen(scene, hamiltonian, log.names, motions)
    with elapsed('fitting'):
        if options.robot:
            limited = None
            if RATE not in _known(options.known):
                ramped, wanted = servos(folder / 'ramps', limited=True)
                limited = free_scene(
                    resolve(ramped), [*wanted, *more], bounds, folder, False, loads)
            free = better_servos(free, limited, motions, seen)
        fitted, said = _fit(free, motions, options, seen)
        notes += [*said, *(one.text for one in warnings_of(
            motions, log.names, log.units))]
        fitted, free, estimates, note = _finer_steps(fitted, free, lambda one, own: estimates_of(
            one.solution, one.problem, own, hamiltonian.coordinates, STATES in options.free))
    solution, problem, stages = fitted.solution, fitted.problem, fitted.stages
    notes += note + _missing_forces(effects, hamiltonian, driven, options.data[0])
    estimates = _as_requested(estimates, options, fitted, free, motions)
    inputs = None
    if driven and not commanded:
        idle = solution.windows.motions[0].idle
        inputs = input_courses(
            solution, problem, motions[0].inputs, log.data.inputs is not None,
            lambda other: [replace(motion, idle=idle) for motion in log.with_inputs(other)])
    return Identified(free, solution, estimates, stages, hamiltonian, log.description, inputs,
                      [*notes, *_energies(free, solution)])


def _supported(scene: Scene, options: Namespace) -> Parts:
    """Return the parts of a scene, or raise UnsupportedSystem if they cannot be fitted."""
    parts = resolve(scene)
    build(parts)  # checks that the parts fit each other
    hamiltonian, effects = parts.hamiltonian, parts.effects
    if hamiltonian.rotations or not hamiltonian.canonical:
        raise UnsupportedSystem(f'{scene.name}: identify supports only canonical scalar '
                                'coordinates')
    if hamiltonian.time is not None and not hamiltonian.separable:
        raise UnsupportedSystem(f'{scene.name}: identify supports a time in H only if H is T(p) '
                                '+ V(q, t): velocities must not depend on the time')
    if hamiltonian.loops is not None:
        for name in options.free:
            if name in (STATES, DELAY):
                raise UnsupportedSystem(f'{scene.name}: --free {name} does not support loops; '
                                        'remove it')
        DifferentiableRun(*parts[1:3], scene.known_step_size, effects)  # names unsupported effects
    return parts


def _as_requested(estimates: Estimates, options: Namespace, fitted: FittedNumbers,
                  free: FreeScene, motions: Sequence[EvenMotion]) -> Estimates:
    """Return the estimates with requested profiles, and as ratios if masses are unknown."""
    solution, problem = fitted.solution, fitted.problem
    profiles = {name: profile(solution, problem, free, one) for one in estimates.estimates
                if (name := one.name) in options.profile}
    estimates = replace(estimates, estimates=[
        profiles.get(one.name, one) for one in estimates.estimates])
    if options.masses == 'unknown':
        q = np.mean([motion.q.mean(axis=0) for motion in motions], axis=0)
        estimates = as_ratios(estimates, free.parts_at(solution.values).hamiltonian, q)
    return estimates


def _loaded(scene: Scene, loads: Mapping[str, Load], motions: Sequence[EvenMotion]
            ) -> list[tuple[Hamiltonian, float]]:
    """Return H with the load of each motion, and the factor on the stiffness of its servos."""
    of = {'': (scene.create_hamiltonian(), 1.0)} | {
        key: (with_load(scene, load, {}).create_hamiltonian(), load.gain)
        for key, load in loads.items()}
    return [of[load_of(loads, motion.name)] for motion in motions]


def _energies(free: FreeScene, solution: Solution) -> list[str]:
    """Describe the works of effects, or their heats, in all windows."""
    parts = free.parts_at(solution.values)
    if all(isinstance(effect, Joined) for effect in parts.effects) \
            and parts.hamiltonian.time is None:
        return []
    # The work of a passive effect is the negative of its heat, but for the stored energy.
    found = predicted_by(free, solution.values, solution.windows).log.energies(solution.starts)
    unit = energy_unit(parts.hamiltonian.coordinates)
    texts = [f'{name.replace("/", " of ", 1)} {value:.4g} {unit}' for name, value in found.items()
             if name.replace('work/', 'heat/', 1) not in found or name.startswith('heat/')]
    return [f'Energy in the windows, by the fitted scene: {", ".join(texts)}'] if texts else []


def _missing_forces(effects: Sequence[Effect], hamiltonian: Hamiltonian, driven: bool, data: str
                    ) -> list[str]:
    """Return a note on the force that an effect takes from the data and that they lack."""
    names = [name for effect in effects if isinstance(effect, ExternalForce)
             for name in effect.names]
    if driven or not names:
        return []
    units = ', '.join(f'{one.name}_force [{force_unit(one.p_unit)}]'
                      for one in hamiltonian.coordinates if one.name in names)
    return [f'{data} has no column of a force, or only zeros, so external_force on '
            f'{", ".join(names)} was taken as 0. If a force acted, add its column '
            f'({units}; in arrays: tau), or name it in data.tau of --config']


class _Log(NamedTuple):
    """Motions of a log, and how they are read again with forces of another course."""

    source: Path
    data: MotionSource
    names: list[str]  # measured coordinates
    units: list[str]
    given: Sequence[str]
    motions: list[EvenMotion]
    description: str

    def with_inputs(self, inputs: Course) -> list[EvenMotion]:
        """Return the motions with forces of this course between samples."""
        return read_motions(self.source, self.data.model_copy(update={'inputs': inputs}),
                            self.names, self.given, self.units, True)[0]


def _of_commands(options: Namespace, names: Sequence[str]) -> list[str]:
    """Describe what a log of commanded positions tells."""
    notes = [] if any('joint_friction.damping' in name for name in names) else [
        'servo.damping contains the gain of the velocity, viscous friction and back EMF: motions '
        'with the motors on do not tell them apart']
    scale = f'Forces have the scale of the masses of {options.robot}'
    if options.masses == 'unknown':
        return [*notes, 'Without known masses the log tells forces relative to inertias alone: '
                'those of the joints, with their rotors, at the mean position; '
                f'the numbers of --write have the scale of the masses of {options.robot}']
    return [*notes, f'{scale}: if all of these are s times as large, so are stiffness, damping, '
            'friction and rotor inertia; see --masses']


def _known(given: Sequence[Sequence[str]]) -> dict[str, float]:
    try:
        return {name: float(value) for name, value in given}
    except ValueError as problem:
        raise ParameterError(f'--known: {problem}; expected a name and a number') from problem


def _log(options: Namespace, hamiltonian: Hamiltonian, commanded: bool) -> _Log:
    """Return the log of the command line, of the measured coordinates."""
    every = hamiltonian.coordinates
    source, data = source_by_format(options, [one for one in every if (
        one.name in options.measured if options.measured else not one.rotor_of)], commanded)
    names = _measured(hamiltonian, options.measured or data.measured)
    units = [one.q_unit for name in names for one in every if one.name == name]
    data = data.model_copy(update={'measured': names})
    motions, description = read_motions(source, data, names, options.data, units, True)
    if motions[0].q.shape[1] != len(names):
        raise DataError(f'{options.data[0]}: {counted(motions[0].q.shape[1], "coordinate")}, '
                        f'expected {len(names)}: {", ".join(names)}; name those that the data '
                        'hold with --measured')
    return _Log(source, data, names, units, options.data, motions, description)


def _measured(hamiltonian: Hamiltonian, given: Sequence[str]) -> list[str]:
    """Return the measured coordinates in the order of the data; by default all but rotors."""
    names = [coordinate.name for coordinate in hamiltonian.coordinates]
    for name in given:
        if name not in names or list(given).count(name) > 1:
            raise ParameterError(f'measured coordinate {name!r}: unknown, or named twice; valid: '
                                 f'{", ".join(names)}')
    return [*given] or [one.name for one in hamiltonian.coordinates if not one.rotor_of]


def _seen(scene: Scene, hamiltonian: Hamiltonian, names: Sequence[str],
          motions: Sequence[EvenMotion]) -> MeasuredColumns:
    """
    Return the measured coordinates, and where the others begin.

    Rotors begin with their joints, the others at the scene's initial state.
    """
    coordinates, every = hamiltonian.coordinates, [one.name for one in hamiltonian.coordinates]
    q, p = map(np.array, (scene.initial_state.q, scene.initial_state.p))
    columns = np.array([every.index(name) for name in names])
    moved = float(max(motion.q.std(axis=0).max() for motion in motions))
    spread = np.array([0.0 if one.rotor_of else 1.0 if one.q_unit == 'rad' else moved
                       for one in coordinates])
    rotors = [(i, every.index(one.rotor_of)) for i, one in enumerate(coordinates)
              if one.rotor_of and one.name not in names]
    return MeasuredColumns(columns, np.stack([q, hamiltonian.gradient(q, p)[1]]), spread, rotors)


def _fit(free: FreeScene, motions: Sequence[EvenMotion], options: Namespace, seen: MeasuredColumns
         ) -> tuple[FittedNumbers, list[str]]:
    """
    Return a fit, and a note on the forces before the first samples if it depends on them.

    With a delay, the first forces that act were commanded before the record: assumed are the first
    recorded one, or none. The better fit is returned.
    """
    late = DELAY in [number.place for number in free.numbers]
    if not late or not any(motion.tau[0].any() for motion in motions):
        return fit_numbers([free], motions, options.horizon, options.robust, seen), []
    fits = [fit_numbers([free], [replace(motion, idle=idle) for motion in motions],
                        options.horizon, options.robust, seen) for idle in (False, True)]
    # Longer windows first: a fit ends at shorter ones if the scene does not follow.
    lengths = [one.solution.windows.there.sum(axis=1).max() for one in fits]
    sizes = [one.size for one in fits]
    ways = 'the first recorded force', 'no force'
    better = int((-lengths[1], sizes[1]) < (-lengths[0], sizes[0]))
    return fits[better], [
        f'Assumed before each run: {ways[better]}, which fits better than {ways[1 - better]} '
        f'(residuals {sizes[1 - better] / sizes[better]:.4g} times as large, in windows of '
        f'{lengths[1 - better]} samples instead of {lengths[better]})']


def _finer_steps(fitted: FittedNumbers, free: FreeScene,
                 estimated: Callable[[FittedNumbers, FreeScene], Estimates]
                 ) -> tuple[FittedNumbers, FreeScene, Estimates, list[str]]:
    """
    Repeat a fit with smaller steps until half the step moves no number, and add a note.

    The step is halved until that moves the numbers, to first order about the fit, by less than
    _MOVED; then the fit is repeated and its step examined again.
    """
    scene, begun, estimates = free.scene, fitted.solution, estimated(fitted, free)
    first, windows = (fitted, free, estimates), begun.windows
    step_size = windows.spacing / steps_between(windows.spacing, scene.known_step_size)
    named, moved, halved, done = '', 0.0, 0, -1
    while done != halved:
        done, solution = halved, fitted.solution
        errors = np.array([one.standard_error or math.inf
                           for one in estimates.estimates[:len(solution.values)]])
        now = predicted_by(free, solution.values, windows).log.predict(solution.starts)
        while True:
            fine = free.at_step(step_size / 2**(halved + 1))
            after = predicted_by(fine, solution.values, windows).log.predict(solution.starts)
            change = np.where(windows.there[..., None], (after - now) / solution.noise, 0.0)
            if not np.isfinite(change).all():
                raise DataError(
                    f'{scene.name} cannot be simulated at the solution with a step size of '
                    f'{fine.scene.known_step_size:.3g} s; give a smaller step_size')
            shifts, left = made_up(solution, fitted.problem.weights(solution.residuals), change)
            sizes = abs(shifts) / errors
            worst = estimates.estimates[int(sizes.argmax())].name if sizes.size else ''
            if sizes.max(initial=0.0) <= _MOVED or halved == _HALVED:
                break
            named, moved = named or worst, moved or float(sizes.max())
            halved, now, free = halved + 1, after, fine
            if (left * (left + 2.0 * solution.residuals)).sum() > EVIDENCE:
                # Too large a change for the first order, or a log of the scene's own steps.
                break
        if done == halved:
            break
        # Errors of the larger steps were taken for noise, also in shorter windows.
        found = judged(refitted(fitted._replace(fits=fitted.fits[-1:]), free, solution.values))
        costs = [fitted.problem.cost(one.residuals * one.noise / begun.noise).sum()
                 for one in (found.solution, begun)]
        if done == 0 and halved == 1 and costs[0] - costs[1] > EVIDENCE:
            return *first, [
                f'Half of the step size, {step_size:.3g} s, fits worse, as for data simulated '
                f'with such steps, and is not used; it moves {named} by {moved:.2g} standard '
                'errors']
        fitted, estimates = found, estimated(found, free)
    if not halved:
        return *first, []
    note = (f'Fitted with a step size of {free.scene.known_step_size:.3g} s: half of the '
            f"scene's, {step_size:.3g} s, moves {named} by {moved:.2g} standard errors")
    if sizes.max() > _MOVED:
        note += (f'; half of it still moves {worst} by {sizes.max():.2g}: use an integrator of a '
                 'higher order')
    return fitted, free, estimates, [note]


def _check(options: Namespace) -> None:
    """Raise an error for invalid options before the work starts."""
    if (options.scene is None) == (options.robot is None):
        raise ParameterError('give a scene, or --robot with a URDF')
    if options.robot is None:
        if not options.free:
            raise ParameterError('--free: name the numbers to fit')
        if options.known or options.masses == 'unknown':
            raise ParameterError('--known and --masses need --robot')
    if options.loads and options.masses == 'unknown':
        raise ParameterError('--masses unknown: --loads gives masses; leave one of them out')
    if options.horizon is not None and not (
            math.isfinite(options.horizon) and options.horizon > 0.0):
        raise ParameterError(f'--horizon {options.horizon}: expected a positive number of seconds')
    if options.free == [STATES]:
        raise ParameterError(f'--free {STATES}: name a number of the scene too; initial states '
                             'are always fitted')
    given = [(name, getattr(options, name)) for name in ('json', 'posterior', 'out', 'write')
             if getattr(options, name) is not None]
    for name, path in given:
        if os.path.lexists(path):
            raise ParameterError(f'--{name} {path}: exists already; choose another file')
        if [other for _, other in given].count(path) > 1:
            raise ParameterError(f'--{name} {path}: is given twice')
        if name != 'out' and not path.parent.is_dir():
            raise ParameterError(f'--{name} {path}: folder {str(path.parent)!r} does not exist; '
                                 'create it first')


def _bounds(given: Sequence[Sequence[str]]) -> dict[str, tuple[float, float]]:
    bounds = {}
    for name, *words in given:
        try:
            low, high = (float(word) for word in words)
        except ValueError as problem:
            raise ParameterError(f'--bounds {name} {" ".join(words)}: expected two numbers'
                                 ) from problem
        bounds[name] = low, high
    return bounds


def source_by_format(options: Namespace, coordinates: Sequence[Coordinate], commanded: bool
                     ) -> tuple[Path, MotionSource]:
    """Return the reader of the data, by configuration or by format."""
    if options.config is not None:
        # Imported lazily: it brings the libraries of training.
        from hnn_vi_ros.learning import ExcitationData, load_machine
        path, found = options.config, load_machine(options.config).data
        if isinstance(found, ExcitationData):
            raise DataError(f'{path}: its data are computed, so it does not describe how to read '
                            '--data; remove --config, or name one with measured data')
        data: MotionSource = found
    else:
        path, data = split_runs(options.data[0])[0], source_of(
            options.data[0], coordinates, options.counts, commanded)
        data = _arrays(path, data, commanded) if isinstance(data, ArraysData) else data
    return path, data if options.inputs is None else data.model_copy(
        update={'inputs': options.inputs})


def _arrays(path: Path, data: ArraysData, commanded: bool) -> ArraysData:
    """Fill in the keys that arrays have; leave errors in the file to its reader."""
    keys = keys_of(path)
    if not keys:
        return data
    return data.model_copy(update={
        'v': next((name for name in _VELOCITIES if name in keys), None),
        'tau': 'tau' if 'tau' in keys and not commanded else None} | {
            key: next((name for name in names if name in keys), None)
            for key, names in _COMMANDS.items() if commanded})


def report_of(found: Identified) -> str:
    """Return the report as Markdown."""
    solution, estimates = found.solution, found.estimates
    windows = solution.windows
    length = (windows.there.sum(axis=1).max() - 1) * windows.spacing
    lines = [
        f'{found.free.scene.name} fitted to {found.data}: {int(windows.there.sum())} samples with '
        f'an interval of {windows.spacing:.4g} s, in {_counted(windows, length)}', '',
        '| number | value | unit | standard error | 95 % interval |',
        '|---|---:|---|---:|---|', *map(_row, estimates.estimates), '']
    for direction in estimates.unknown:
        named = ', '.join(f'{name} {part:+.3g}' for name, part in direction.items())
        lines.append('Not identifiable: the data do not change if these change together, '
                     f'relatively: {named}' if len(direction) > 1 else
                     f'Not identifiable: the data do not depend on {next(iter(direction))}')
    lines += [*_held_back(found), *_wrong_units(found)]
    lines += [f'Correlation of {one} and {other}: {r:.3f}; an error of one compensates an error '
              'of the other' for one, other, r in estimates.correlated]
    lines += [found.inputs.text('--inputs')] if found.inputs else []
    lines += [*found.notes, *_noise(found)]
    low, high = (part(windows.measured[windows.there], axis=0) for part in (np.min, np.max))
    ranges = ', '.join(f'{name} {a:.4g} to {b:.4g} {unit}' for (name, unit), a, b in zip(
        channels(found), low, high, strict=True))
    lines.append(f'Valid range: the data cover {ranges}')
    lines += [f'Windows of {seconds:.4g} s: residuals {misfit:.3g} times the noise'
              for seconds, misfit in found.stages]
    if found.stages[-1][1] > _POOR:
        lines.append('The residuals are much larger than the noise: the model is incomplete, a '
                     'bound is active, or the data belong to another system; the intervals do not '
                     'account for this')
    if len(found.stages) > 1 and found.stages[-1][0] > 1.5 * length:
        lines.append(f'Over windows longer than {length:.4g} s the scene follows the data less '
                     'well: the model is incomplete, or the motion is chaotic')
    return '\n'.join(lines)


def _counted(windows: Windows, length: float) -> str:
    if len(windows.run) == 1:
        return f'one window of {length:.4g} s with its own initial state'
    return f'{len(windows.run)} windows of up to {length:.4g} s, each with its own initial state'


def _held_back(found: Identified) -> list[str]:
    """Describe numbers that ended at their bounds, or where the scene refuses others."""
    estimates = found.estimates.estimates[:len(found.free.numbers)]
    near = np.array([max(1e-6 * abs(one.value), 1e-2 * (one.standard_error or 0.0))
                     for one in estimates])
    refused = refusals(found.free, np.array([one.value for one in estimates]), near)
    return [f'{one.name} is at its bound, {end:g} {one.unit}: the data may fit better beyond it, '
            'and its interval ignores the bound'
            for number, one, most in zip(found.free.numbers, estimates, near, strict=True)
            for end in (number.low, number.high) if one.known and abs(one.value - end) <= most
            ] + [f'{estimates[k].name} is at the end of what the scene accepts: {reason}; the '
                 'data may fit better beyond it, and its interval ignores this condition'
                 for k, reason in refused.items()]


def _wrong_units(found: Identified) -> list[str]:
    """Describe numbers of a driven scene that are about 1000 times their start, or 1/1000."""
    if found.inputs is None:
        return []
    pairs = zip(found.free.numbers, found.estimates.estimates, strict=False)
    ratios = {one.name: one.value / number.start for number, one in pairs
              if one.known and number.start}
    return [f'{name} is {ratio:.3g} times its value in the scene, as if efforts were in N mm or '
            'lengths in mm; if so, convert the data to N m and m'
            for name, ratio in ratios.items()
            if ratio and abs(abs(math.log10(abs(ratio))) - 3.0) < _MILLI]


def _row(one: Estimate) -> str:
    if not one.known:
        return f'| {one.name} | {one.value:.6g} | {one.unit} | - | not identifiable |'
    low, high = ('?' if end is None else f'{end:.6g}' for end in (one.low, one.high))
    return (f'| {one.name} | {one.value:.6g} | {one.unit} | {one.standard_error:.3g} '
            f'| {low} to {high} |')


def _noise(found: Identified) -> list[str]:
    """Describe the noise estimated from the residuals."""
    lines = []
    for (name, unit), noise, factor in zip(
            channels(found), found.solution.noise, found.estimates.coloured, strict=True):
        coloured = '' if factor <= 1.0 else (
            f', correlated in time: {factor:.3g} samples count as one in the standard errors')
        lines.append(f'Noise of {name}: {noise:.3g} {unit}{coloured}')
    return lines


def channels(found: Identified) -> list[tuple[str, str]]:
    """Return name and unit of each measured quantity."""
    coordinates = [found.hamiltonian.coordinates[k] for k in found.solution.windows.columns]
    names = [(one.name, one.q_unit) for one in coordinates]
    names += [(f'd{one.name}/dt', f'{one.q_unit}/s') for one in coordinates]
    return names[:found.solution.residuals.shape[2]]


def _write(options: Namespace, found: Identified, text: str) -> None:
    """Write the files requested by the command line."""
    if options.json is not None:
        _dump(options.json, as_json(found.estimates))
    if options.posterior is not None:
        _dump(options.posterior, posterior(found))
    if options.write is not None:
        solution, state = found.solution, None
        if STATES in options.free:
            q, p = np.split(solution.starts[0], 2)
            state = {'q': q.tolist(), 'p': p.tolist()}
        write_fitted(options.write, found.free, solution.values.tolist(), state)
        print(f'\nscene: {options.write}')
    if options.out is not None:
        make_folder(options.out, new=True)
        draw_fit(options.out / FIT, found.solution, channels(found))
        draw_correlations(options.out / CORRELATIONS, found.estimates)
        write_text(options.out / REPORT, (
            f'# Identification\n\n{text}\n\n![Fit and residuals of the longest run]({FIT})\n\n'
            f'![Correlations of the errors]({CORRELATIONS})\n'))
        print(f'\nreport: {options.out}')


def _dump(path: Path, data: Mapping[str, object]) -> None:
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + '\n')


def as_json(estimates: Estimates) -> dict[str, dict[str, float | None]]:
    """Return the content of ``--json``."""
    return {one.name: {'value': one.value, 'low': one.low, 'high': one.high}
            for one in estimates.estimates}


def posterior(found: Identified) -> dict[str, object]:
    """Return the content of ``--posterior``; the covariance is of the determined numbers."""
    own, places = found.estimates, {one.name: one.place for one in found.free.numbers}
    rows = [k for k, one in enumerate(own.estimates) if one.known]
    return {
        'scene': found.free.scene.name,
        'parameters': {one.name: {
            'value': one.value, 'low': one.low, 'high': one.high,
            'standard_error': one.standard_error, 'unit': one.unit,
            'place': places.get(one.name, one.name)} for one in own.estimates},
        'covariance': {'names': [own.estimates[k].name for k in rows],
                       'matrix': own.covariance[np.ix_(rows, rows)].tolist()},
        'interval': 0.95, 'quantile': quantile(found.solution.freedom)}
