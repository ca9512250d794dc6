# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of a scene without ROS: one trajectory, or many in blocks on threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path
from typing import Any
import warnings

from hnn_vi_ros.effects import LARGEST
from hnn_vi_ros.errors import optional, StateError, StepFailure
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.phase_space import check_state
from hnn_vi_ros.scene import AutoChoice, Choice, load_scene, Parts, Scene
from hnn_vi_ros.simulation.accuracy.trials import InitialValueProblem
from hnn_vi_ros.simulation.checks import check_count, check_numbers, check_seconds
from hnn_vi_ros.simulation.construction import build, build_at
from hnn_vi_ros.simulation.dense_step import whole_steps
from hnn_vi_ros.simulation.events import watched
from hnn_vi_ros.simulation.guards.bands import ResolutionGuard
from hnn_vi_ros.simulation.guards.base import Alarm
from hnn_vi_ros.simulation.guards.watch import energies_of, show_many, tell, tell_many, Watch
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System
from hnn_vi_ros.simulation.trajectory.record import (
    BLOCK, check_commands, Commands, in_blocks, MOST_NUMBERS, record, record_block, record_rows,
    Schedule)
from hnn_vi_ros.simulation.trajectory.trajectory import Trajectory
import numpy as np
from numpy.typing import ArrayLike

# Commands of m trajectories: rows held from sample to sample, or a function of time [s].
ManyCommands = ArrayLike | Callable[[float], ArrayLike]
# An initial state.
State = tuple[ArrayLike, ArrayLike] | Mapping[str, ArrayLike]
_FIRST = slice(0, 1)
# Samples of q and p, shape (n, m, d), and alarms about the steps.
Recorded = tuple[np.ndarray, np.ndarray, list[Alarm]]
# Maximum gradients of `name_step`, as a share of those of a calibration run: tenths of a second.
_MAX_GRADIENT_SHARE = 0.1


def name_step(alarms: Sequence[Alarm], simulation: Simulation,
              repeat: Callable[[float], Sequence[Alarm]]) -> list[Alarm]:
    """
    Return the alarms of a run, with a sufficient step size added to that of ResolutionGuard.

    The energy error does not predict this step size: at any step size that does not resolve the
    motion, the error is as large as the energy scale. The run is therefore repeated with a half
    of its step size, a quarter and so on; no step size is added if this takes more gradients than
    can be evaluated in some tenths of a second.

    Parameters
    ----------
    alarms : sequence of Alarm
        Alarms of the run.
    simulation : Simulation
        Simulation at the end of the run.
    repeat : callable
        Function that repeats the run at another step size [s] and returns its alarms.

    """
    named = list(alarms)
    for k, alarm in enumerate(alarms):
        if alarm.kind == ResolutionGuard.kind:
            step = _resolving_step(simulation, repeat)
            if step is not None:
                named[k] = alarm._replace(
                    message=f'{alarm.message}; step_size {step:g} resolves this run')
    return named


def _resolving_step(simulation: Simulation, repeat: Callable[[float], Sequence[Alarm]]
                    ) -> float | None:
    h, cost = simulation.step_size, simulation.gradients
    if simulation.usual_gradients:
        # Ignore extra gradients of steps that are hard to solve: shorter ones do not need them.
        cost = min(cost, simulation.steps * simulation.usual_gradients)
    most = _MAX_GRADIENT_SHARE * InitialValueProblem(
        simulation.hamiltonian, (), simulation.q, simulation.p).gradients
    while (cost := 2 * cost) <= most:
        h *= 0.5
        # Round down to two significant digits.
        digit = 10.0 ** (math.floor(math.log10(h)) - 1)
        h = float(f'{math.floor(h / digit * (1.0 + 1e-12)) * digit:.2g}')
        with warnings.catch_warnings(), np.errstate(all='ignore'):
            warnings.simplefilter('ignore')
            try:
                if all(alarm.kind != ResolutionGuard.kind for alarm in repeat(h)):
                    return h
            except StepFailure:
                continue
    return None


def simulate(scene: Scene | Parts | str | Path | Callable[[Any, Any], Any], *more: ArrayLike,
             duration: float | None = None, step_size: float | None = None,
             integrator: Choice | None = None, initial_state: State | None = None,
             effects: Sequence[Mapping[str, Any]] | None = None,
             commands: Commands | None = None, every: int = 1,
             times: Sequence[float] | np.ndarray | None = None) -> Trajectory:
    """
    Simulate ``(scene, duration)`` or ``(H, q, p, duration, step_size)``, without ROS.

    Parameters
    ----------
    scene : Scene, Parts, str, Path or callable
        A scene from ``load_scene``, the name of a shipped scene, the path of a YAML file, or a
        function H(q, p) [J], which is called with symbols and becomes a formula: it may use
        operators and functions of numpy, but no branches on values. ``scene.to_yaml()`` of the
        trajectory returns it.
    *more : float or array
        ``duration``; or with a function ``q, p, duration, step_size``, where q and p are numbers
        for one coordinate and arrays of shape (d,) for several.
    duration : float, optional
        Simulated time [s] of the last sample, by default that of the scene; see DenseStep for a
        time between steps.
    step_size : float, optional
        Step size h [s]; overrides the scene's.
    integrator : str or mapping, optional
        Key of INTEGRATORS, or ``{'kind': 'taylor', 'tolerance': 1e-14}``; overrides the scene's
        integrator. The default for a function is gauss8.
    initial_state : tuple of (q, p) or mapping with 'q' and 'p' or 'v', shape (d,) each, optional
        Initial state; overrides the scene's.
    effects : sequence of mapping, optional
        Effects, each as in YAML: ``{'kind': 'damping', 'rate': 0.1}``; overrides the scene's.
    commands : callable or array, shape (N, c), optional
        Commands for external_force: a function of time [s], called before each step, or one row
        per sample, held until the next. For a servo, a function that returns JointCommand.
    every : int, optional
        Number of steps between samples.
    times : sequence of float, optional
        Times of the samples, instead of `every`, in increasing order from 0 to the duration [s];
        they may lie between steps. Cannot be combined with commands, which are held per sample.

    Returns
    -------
    Trajectory
        The samples. The first is the initial state, unless `times` is given; if an event ended
        the run, the last is the state at the event.

    Warns
    -----
    AlarmWarning
        A guard found the run unreliable; ``alarms`` of the trajectory contains the alarm. For an
        under-resolved run the warning recommends a step size, if one is found within some tenths
        of a second.

    Raises
    ------
    HnnViRosError
        Unknown scene or integrator, a model that cannot be loaded, or a StepFailure.
    ValueError
        Invalid argument, or more samples than fit into memory.
    TypeError
        Argument of a wrong type.

    Examples
    --------
    >>> simulate('exact_pendulum', 20.0, integrator='gauss4').q.shape
    (2001, 1)
    >>> run = simulate(lambda q, p: p**2 / 2 - np.cos(q), 1.0, 0.0, 10.0, 0.1)
    >>> run.scene.hamiltonian.H
    '0.5*p^2 - cos(q)'

    """
    names = ('q', 'p', 'duration', 'step_size') if callable(scene) else ('duration',)
    if len(more) > len(names):
        raise TypeError(f'expected at most {len(names)} arguments after the first: '
                        f'{", ".join(names)}; give others by name')
    given: dict[str, Any] = {'duration': duration, 'step_size': step_size}
    for name, value in zip(names, more, strict=False):
        if given.get(name) is not None:
            raise TypeError(f'{name} is given twice')
        given[name] = value
    if callable(scene):
        scene = Scene.build(
            hamiltonian=scene, integrator=integrator or 'gauss8', step_size=given['step_size'],
            initial_state=initial_state or {name: given.get(name) for name in 'qp'}, name='H')
        integrator = initial_state = None
    check_count('every', every)
    parts = changed_parts(scene, given['step_size'], integrator, initial_state, effects)
    scene, duration = parts.scene, given['duration']
    if duration is None:
        duration = scene.duration
    check_seconds('duration', duration)
    simulation = watched(build(parts), scene)
    recorded = record_one(simulation, duration, int(every), times, commands)

    def repeat(h: float) -> tuple[Alarm, ...]:
        # Sample at whole steps only, which suffices: states between steps are expensive.
        other = build(parts._replace(scene=scene.with_overrides(h)))
        return record_one(other, float(recorded.t[-1]), int(every) if times is None else 1).alarms

    tell(name_step(recorded.alarms, simulation, repeat), scene.known_step_size)
    return replace(recorded, scene=scene)


def changed_parts(scene: Scene | Parts | str | Path, step_size: float | None = None,
                  integrator: Choice | None = None, initial_state: State | None = None,
                  effects: Sequence[Mapping[str, Any]] | None = None) -> Parts:
    """Return the parts of a resolved scene with overrides applied; see ``simulate``."""
    own = scene.scene if isinstance(scene, Parts) else _scene(scene)
    changed = _resolved(own.with_overrides(
        step_size, integrator, _state(initial_state), _listed(effects)))
    return scene if isinstance(scene, Parts) and changed is own else changed.parts()


def record_one(simulation: Simulation, duration: float, every: int,
               times: Sequence[float] | np.ndarray | None = None,
               commands: Commands | None = None) -> Trajectory:
    """
    Simulate one trajectory without emitting warnings.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state, of shape (d,).
    duration, every, times, commands
        See ``simulate``.

    Returns
    -------
    Trajectory
        The samples, with alarms.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    watch = Watch(simulation, simulation.hamiltonian.barrier)
    if times is not None:
        if commands is not None:
            raise ValueError('times and commands cannot both be given: use every with commands')
        # Given times need not include the initial state.
        schedule, first = Schedule.at(times, duration), 1
    else:
        schedule, first = Schedule.until(
            duration, every, simulation.step_size, simulation.q.size), 0
        commands = None if commands is None else check_commands(commands, schedule)
    t, q, p = (part[first:] for part in record(simulation, schedule, watch, commands))
    energies, work = energies_of(simulation, q, p), None
    if not simulation.conservative:
        steps = [whole_steps(time, simulation.step_size) for time in t.tolist()]
        # The work at states between steps is unknown.
        work = np.array([math.nan if share else watch.works.get(step, math.nan)
                         for step, share in steps])
    else:
        watch.show(simulation, t / simulation.step_size, (q, p), energies)
    return Trajectory(t, q, p, energies[0], simulation.hamiltonian.coordinates,
                      tuple(watch.alarms), tuple(
                          event for event in getattr(simulation, 'events', ())
                          if event.t <= t[-1]), work=work)


def _resolved(scene: Scene) -> Scene:
    """Return the scene with `integrator: auto`, if it has that, resolved."""
    if not isinstance(scene.integrator, AutoChoice):
        return scene
    # Imported lazily: few scenes use `integrator: auto`.
    from hnn_vi_ros.simulation.accuracy.automatic_choice import resolve
    return resolve(scene)[0]


def _scene(scene: Scene | str | Path) -> Scene:
    """Return a scene, loaded if given by name or path."""
    if isinstance(scene, str | Path):
        return load_scene(scene)
    if not isinstance(scene, Scene):
        raise TypeError(f'scene has type {type(scene).__name__}; give a Scene from load_scene, '
                        'the name of a shipped scene, or the path of a YAML file')
    return scene


def _state(state: State | None) -> dict[str, list[float]] | None:
    """Return an initial state as a mapping of lists."""
    if state is None:
        return None
    names = 'qv' if isinstance(state, Mapping) and state.keys() == {'q', 'v'} else 'qp'
    if isinstance(state, Mapping) and state.keys() == set(names):
        state = state['q'], state[names[1]]
    if not isinstance(state, Sequence | np.ndarray) or isinstance(state, str) or len(state) != 2:
        raise TypeError('initial_state must be a pair of coordinates q and momenta p, such as '
                        "([1.0], [0.0]) or {'q': [1.0], 'p': [0.0]}, or have velocities v, as "
                        f"{{'q': [1.0], 'v': [0.0]}}, not {state!r:.60}")
    return {name: check_numbers(f'{name} of initial_state', part).tolist()
            for name, part in zip(names, state, strict=True)}


def _initial_states(q: ArrayLike, p: ArrayLike,
                    hamiltonian: Hamiltonian) -> list[np.ndarray]:
    """Return q and p of initial states, shape (m, d), or raise an error if they are invalid."""
    states, d, turning = (
        (check_numbers('q', q), check_numbers('p', p)), hamiltonian.dimension,
        hamiltonian.rotations)
    widths = d, d - len(turning)
    for name, part, width in zip('qp', states, widths, strict=True):
        if part.ndim == 1 and part.size != width:
            raise ValueError(f'{name} has shape {part.shape}, expected (m, {width}): a row for '
                             'each trajectory, a column for each coordinate')
    checked = [part.reshape(-1, width) for part, width in zip(
        check_state(*states, d, turning), widths, strict=True)]
    if checked[0].size == 0:
        raise ValueError(f'q has shape {np.shape(q)}: no trajectory to simulate')
    return checked


def _listed(effects: Sequence[Mapping[str, Any]] | None) -> Any:
    """Return a tuple of effects as a list, and anything else unchanged."""
    return list(effects) if isinstance(effects, tuple) else effects


def _numbers(commands: Any, time: float, sample: int, shape: tuple[int, int]) -> np.ndarray:
    """Return the commands of all trajectories, (m, c), at a time after sample `sample`."""
    if not callable(commands):
        return np.asarray(commands[:, sample])
    return np.broadcast_to(_checked_numbers(
        f'commands({time:g})', commands(time), [shape, shape[1:]]), shape)


def _checked_numbers(name: str, values: Any, shapes: list[tuple[int, ...]]) -> np.ndarray:
    """Return finite numbers of one of the shapes, or raise ValueError."""
    found = check_numbers(name, values)
    if found.shape not in shapes:
        raise ValueError(f'{name} has shape {found.shape}, expected '
                         f'{" or ".join(map(str, shapes))}')
    if not (np.abs(found) <= LARGEST).all():
        raise ValueError(f'{name} must hold finite numbers, at most {LARGEST:g} in size')
    return found


def simulate_many(scene: Scene | str | Path, q: ArrayLike, p: ArrayLike, duration: float, *,
                  samples: int = 1, commands: ManyCommands | None = None,
                  threads: int | None = None, device: str | None = None) -> Trajectory:
    """
    Simulate one scene from many initial states.

    Trajectories are independent: a block of them is one system whose H is the sum of their
    Hamiltonians, stepped by the same code. The implicit equations of a block are solved until
    each of its trajectories has converged. With a thermostat, an impact or a constraint each
    trajectory is stepped separately, with its own noise.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``simulate``; the scene's initial state is not used.
    q, p : sequence, shape (m, d)
        Initial states.
    duration : float
        Simulated time [s].
    samples : int, optional
        Number of equidistant samples after the initial one; see DenseStep for times between steps.
    commands : array or callable, optional
        Commands for external_force as plain numbers: an array of shape (m, samples, c), held from
        sample to sample, or a function of time [s] that returns (m, c) or (c,), called before
        each step. Each trajectory is then stepped separately, with results bit-identical to
        ``simulate``, and the interval between samples must be a whole number of steps.
    threads : int, optional
        Number of threads; by default the number of usable processors. Ignored on a GPU.
    device : str, optional
        torch device, ``'cuda'``, ``'cuda:N'`` or ``'cpu'``: take the steps in torch instead of
        compiled loops, solving each trajectory separately; see docs/how-to/scale.md. Requires an
        H of perceptrons without effects, and supports some of the methods.

    Returns
    -------
    Trajectory
        t of shape (samples + 1,), q and p of shape (samples + 1, m, d), energy of shape
        (samples + 1, m). Alarms about steps, and about energies if work is done, are assigned to
        all trajectories of a block. A trajectory that fails has the alarm ``failed``, and NaN
        from then on.

    Warns
    -----
    AlarmWarning
        See ``simulate``.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, or all trajectories fail.
    MissingPackage
        `device` is given, but the extra ``train`` is not installed.
    ValueError
        Invalid argument, or more samples than fit into memory.
    TypeError
        Argument of a wrong type.

    Examples
    --------
    >>> simulate_many('exact_pendulum', [[0.1], [0.2], [0.3]], np.zeros((3, 1)), 1.0).q.shape
    (2, 3, 1)

    """
    check_seconds('duration', duration)
    check_count('samples', samples)
    if threads is not None:
        check_count('threads', threads)
    scene = _resolved(_scene(scene))
    if scene.events:
        raise ValueError('simulate_many does not support events: remove `events` from '
                         f'{scene.name}, or simulate one trajectory at a time')
    run = _Many(scene.parts(), q, p, duration, samples)
    if commands is not None:
        run.follow(commands, threads, device)
    elif device is not None:
        run.step_on(device, threads)
    else:
        run.step(threads)
    energies = run.energies()
    tell_many(run.alarms, run.step_size)
    return Trajectory(run.t, run.q, run.p, energies, run.parts.hamiltonian.coordinates,
                      tuple(map(tuple, run.alarms)), scene=scene)


class _Many:
    """
    Run of many trajectories of one scene.

    Parameters
    ----------
    parts : Parts
        Parts of the scene.
    q, p, duration, samples
        See ``simulate_many``.

    Attributes
    ----------
    t : np.ndarray, shape (samples + 1,)
        Times of the samples [s].
    q, p : np.ndarray, shape (samples + 1, m, d)
        Samples, filled in by step, follow or step_on.
    alarms : list of list of Alarm
        Alarms about the steps of each trajectory.
    failures : dict of int to StepFailure or StateError
        Failures of trajectories.

    """

    def __init__(self, parts: Parts, q: ArrayLike, p: ArrayLike, duration: float, samples: int):
        q0, p0 = _initial_states(q, p, parts.hamiltonian)
        if q0.size * samples > MOST_NUMBERS:
            raise ValueError(f'{samples} samples of {len(q0)} trajectories do not fit into '
                             'memory; simulate fewer at a time')
        self.parts, self.count = parts, len(q0)
        self.step_size = h = parts.scene.known_step_size
        samples = samples if duration else 0
        self._interval = interval = duration / max(samples, 1)
        self._every, self._share = whole_steps(interval, h)
        self.t = np.arange(samples + 1) * (interval if self._share else self._every * h)
        self.q, self.p = (np.full((samples + 1, *part.shape), np.nan) for part in (q0, p0))
        self.q[0], self.p[0] = q0, p0
        self.alarms: list[list[Alarm]] = [[] for _ in q0]
        self.failures: dict[int, StepFailure | StateError] = {}

    def simulation(self, block: slice = _FIRST) -> Simulation:
        """Return a simulation of a block of trajectories in their initial states."""
        return build_at(self.parts, self.q[0, block], self.p[0, block])

    def step(self, threads: int | None) -> None:
        """Take the steps in compiled loops, of blocks if the system supports batches."""
        _, hamiltonian, integrator, effects = self.parts
        size = BLOCK if System(hamiltonian, effects, integrator).batched else 1

        def take(simulation: Simulation, block: slice, samples: int) -> Recorded:
            return record_block(
                simulation, self.q[0, block], self.p[0, block], block.start,
                Schedule(0, 1, self.t[1:samples + 1]) if self._share or not self._every else
                Schedule(samples, self._every, np.empty(0)))
        in_blocks(self.count, size, threads, lambda first: self._kept(take, size))

    def follow(self, commands: ManyCommands, threads: int | None, device: str | None) -> None:
        """Take the steps with individual commands, or raise ValueError."""
        one = self.simulation()
        if not one.takes_commands:
            raise ValueError('no effect of the scene accepts commands; add external_force with '
                             'its coordinates')
        if self._share or device is not None:
            raise ValueError('commands need whole steps between samples, and no device; change '
                             'duration or samples, and remove device')
        if callable(commands):
            # The function may not be thread-safe.
            threads = 1
        else:
            commands = _checked_numbers(
                'commands', commands, [(self.count, self.t.size - 1, one.command_size)])

        def take(simulation: Simulation, block: slice, samples: int) -> Recorded:
            return record_rows(
                simulation, self.q[0, block], self.p[0, block], block.start,
                (part[block] for part in self._held(commands, one.command_size, samples)))
        in_blocks(self.count, BLOCK, threads, lambda first: self._kept(take, 1))

    def _held(self, commands: Any, c: int, samples: int) -> Iterator[np.ndarray]:
        """Yield, for each interval between samples, the commands of its steps, (m, every, c)."""
        for sample in range(samples):
            yield np.stack([
                _numbers(commands, k * self.step_size, sample, (self.count, c))
                for k in range(sample * self._every, (sample + 1) * self._every)], axis=1)

    def step_on(self, device: str, threads: int | None) -> None:
        """Take the steps in torch, or raise ValueError."""
        if self._share:
            raise ValueError(f'device = {device}: samples are {self._interval:g} s apart, '
                             f'{self._interval / self.step_size:g} steps; a device needs whole '
                             'steps between samples; change duration or samples')
        with optional('torch', f'device = {device}'):
            from hnn_vi_ros.simulation.batches.batch_simulation import open_device
            from hnn_vi_ros.simulation.trajectory.devices import (
                batch_on, one_thread_each, record_on, TOGETHER)
        size = TOGETHER if open_device(device).type == 'cpu' else self.count
        samples = [k * self._every for k in range(self.t.size)]

        def start(first: slice) -> Callable[[slice], None]:
            ensemble, one = batch_on(device, self.parts), self.simulation(_FIRST)

            def take(block: slice) -> None:
                found, alarms = record_on(
                    ensemble, one, self.q[0, block], self.p[0, block], samples)
                self.q[:, block], self.p[:, block] = found.q, found.p
                for k, problem in found.failures.items():
                    self._fail(block.start + k, problem)
                for k, told in alarms.items():
                    self.alarms[block.start + k] += told
            return take

        with one_thread_each(device):
            in_blocks(self.count, size, threads, start)

    def _kept(self, take: Callable[[Simulation, slice, int], Recorded], size: int
              ) -> Callable[[slice], None]:
        """Return a function that records a block; if it fails, each trajectory on its own."""
        cached = list[Simulation]()

        def put(block: slice, samples: int) -> None:
            simulation = cached.pop() if cached else self.simulation(
                slice(block.start, min(block.stop, block.start + size)))
            q, p, alarms = take(simulation, block, samples)
            # One that failed is not used again.
            cached.append(simulation)
            self.q[:samples + 1, block], self.p[:samples + 1, block] = q, p
            for own in self.alarms[block]:
                own += alarms

        def attempt(block: slice) -> None:
            try:
                put(block, self.t.size - 1)
            except (StepFailure, StateError) as problem:
                alone = [slice(k, k + 1) for k in range(self.count)[block]]
                if len(alone) > 1:
                    for own in alone:
                        attempt(own)
                elif samples := self._fail(block.start, problem):
                    put(block, samples)
        return attempt

    def _fail(self, k: int, problem: StepFailure | StateError) -> int:
        """Record the failure of a trajectory; return the number of samples before it."""
        time = getattr(problem, 't', 0.0) + 1e-9 * self.step_size
        samples = int(np.searchsorted(self.t, time, 'right')) - 1
        self.q[samples + 1:, k] = self.p[samples + 1:, k] = np.nan
        self.failures[k] = problem
        self.alarms[k].append(Alarm('failed', round(time / self.step_size), time,
                                    float(self.t[-1]), str(problem), 's'))
        return samples

    def energies(self) -> np.ndarray:
        """Return H, shape (samples + 1, m), and add alarms; if all failed, raise the first."""
        if len(self.failures) == self.count:
            raise self.failures[min(self.failures)]
        kept = [k for k in range(self.count) if k not in self.failures]
        simulation = self.simulation(slice(kept[0], kept[0] + 1))
        found = np.asarray(simulation.hamiltonian.energy(self.q, self.p)) if self.failures else \
            np.empty(self.q.shape[:2])
        found[:, kept] = show_many(simulation, self.t / self.step_size, self.q[:, kept],
                                   self.p[:, kept], [self.alarms[k] for k in kept])
        return found
