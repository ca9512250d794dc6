# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of a scene without ROS: one, or many in lock-step blocks on several threads."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
import math
from pathlib import Path
from typing import Any
import warnings

from hnn_vi_ros.accuracy.automatic_choice import resolve
from hnn_vi_ros.accuracy.trials import InitialValueProblem
from hnn_vi_ros.effects.commands import Command, LARGEST
from hnn_vi_ros.errors import optional, StepFailure, StoppedByEvent
from hnn_vi_ros.guards.bands import ResolutionGuard
from hnn_vi_ros.guards.base import Alarm
from hnn_vi_ros.guards.watch import (
    energies_of, look, look_at_block, look_at_rows, record_watched, show_many, tell, tell_many,
    Watch, watch_of_block)
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.phase_space import check_state
from hnn_vi_ros.processors import in_threads, usable_processors
from hnn_vi_ros.scene import load_scene, Parts, Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.build import build, build_at
from hnn_vi_ros.simulation.checks import check_count, check_numbers, check_seconds
from hnn_vi_ros.simulation.dense_step import record_at, whole_steps
from hnn_vi_ros.simulation.events import watched
from hnn_vi_ros.simulation.system import System
from hnn_vi_ros.trajectory.trajectory import Trajectory
import numpy as np
from numpy.typing import ArrayLike

# Coordinates that the samples of a run may have in all; with as many momenta: 4 GiB.
MOST_NUMBERS = 2**28
# Compiled code counts no further.
_MOST_STEPS = 2**63 - 1

# Commands over time: a function of time [s], or values at each sample.
Commands = Callable[[float], Command] | Sequence[Sequence[float]] | np.ndarray
# Of m trajectories: to be held from sample to sample, or a function of the time [s].
ManyCommands = ArrayLike | Callable[[float], ArrayLike]
# What takes samples: q and p, shape (k, d) each.
Recorder = Callable[[], tuple[np.ndarray, np.ndarray]]


def recorders(simulation: Simulation, duration: float, every: int,
              times: Sequence[float] | np.ndarray | None, commands: Commands | None, watch: Watch
              ) -> tuple[np.ndarray, list[Recorder]]:
    """
    Return the times of the initial state and of all samples, and what takes those in turn.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    duration, every, times, commands
        See ``simulate``.
    watch : Watch
        The guards, which look on meanwhile where work is done.

    Returns
    -------
    tuple of (np.ndarray, list of callable)
        Times, shape (N + 1,) [s]; each callable returns q and p, shape (k, d), of the next ones.

    Raises
    ------
    ValueError
        Times or commands that cannot be used, or more samples than fit into memory.

    """
    if times is not None:
        if commands is not None:
            raise ValueError('times and commands cannot both be given: use every with commands')
        t = _check_times(times, duration)
        return np.append(0.0, t), [lambda: record_samples(simulation, t.size, t, watch)]
    every = min(every, _MOST_STEPS)
    check_memory(duration, simulation.step_size * every, simulation.q.size)
    steps, part = whole_steps(duration, simulation.step_size)
    every = min(every, steps + 1)
    samples, rest = divmod(steps, every)
    t = np.arange(samples + 1) * every * simulation.step_size
    if commands is None:
        takers = [lambda: record_samples(simulation, samples, every, watch)]
    else:
        commands = _check_commands(commands, samples + bool(rest or part))
        takers = [lambda: _record_commanded(simulation, samples, every, commands, watch)]
    if rest or part:
        t = np.append(t, duration)
        takers.append(lambda: _record_last(
            simulation, samples, rest, duration, commands, watch))
    return t, takers


def record_samples(simulation: Simulation, samples: int, every: int | np.ndarray, watch: Watch
                   ) -> tuple[np.ndarray, np.ndarray]:
    """Take samples, every so many steps or at given times; look on where work is done."""
    if isinstance(every, int):
        return (simulation.record(samples, every) if simulation.conservative
                else record_watched(simulation, samples, every, watch))
    if simulation.conservative:
        return record_at(simulation, every)
    watch.update(look(simulation))
    return record_at(simulation, every, lambda: watch.update(look(simulation)))


def _check_times(times: Sequence[float] | np.ndarray, duration: float) -> np.ndarray:
    """Return times of samples as an array, or raise."""
    t = check_numbers('times', times)
    if t.ndim != 1 or t.size == 0:
        raise ValueError(f'times has shape {t.shape}, expected (N,): a list of at least one time')
    if not (np.isfinite(t).all() and (np.diff(t) >= 0.0).all() and t[0] >= 0.0
            and t[-1] <= duration * (1.0 + 1e-12)):
        raise ValueError(f'times must rise from 0 s at least to the duration, {duration:g} s, at '
                         'most')
    return t


def check_memory(duration: float, interval: float, dimension: int) -> None:
    """
    Raise ValueError if the samples of a run do not fit into memory.

    Parameters
    ----------
    duration, interval : float
        Of the run, and from one sample to the next [s].
    dimension : int
        Coordinates of each, of all trajectories.

    """
    samples = duration / interval
    if samples * dimension > MOST_NUMBERS:
        raise ValueError(f'duration = {duration:g} s would make {samples:.2g} samples, one every '
                         f'{interval:g} s: more than memory holds; take a larger every')


def _check_commands(commands: Commands, samples: int) -> Commands:
    """Return rows of commands as an array, or raise if there are too few."""
    if callable(commands):
        return commands
    rows = check_numbers('commands', commands)
    if rows.ndim != 2 or len(rows) < samples:
        raise ValueError(f'commands has shape {rows.shape}, expected ({samples}, c): a row '
                         'for each sample but the last; or give a function of the time')
    return rows


def _record_commanded(simulation: Simulation, samples: int, every: int, commands: Commands,
                      watch: Watch) -> tuple[np.ndarray, np.ndarray]:
    """Take samples times every steps, with a command before each step."""
    q, p = (np.empty((samples, part.size)) for part in (simulation.q, simulation.p))
    watch.update(look(simulation))
    for sample in range(samples):
        try:
            _advance_commanded(simulation, every, commands, sample)
        except StoppedByEvent as stop:
            raise stop.after(q[:sample], p[:sample]) from None
        q[sample], p[sample] = simulation.q, simulation.p
        watch.update(look(simulation))
    return q, p


def _record_last(simulation: Simulation, sample: int, steps: int, duration: float,
                 commands: Commands | None, watch: Watch) -> tuple[np.ndarray, np.ndarray]:
    """Take the sample at the end of a duration, after another: some steps, and a part of one."""
    if commands is not None:
        _advance_commanded(simulation, steps, commands, sample)
        simulation.set_command(_command(commands, simulation.time, sample))
    return record_samples(simulation, 1, np.array([duration]), watch)


def _advance_commanded(simulation: Simulation, steps: int, commands: Commands, sample: int
                       ) -> None:
    """Take steps after a sample, with a command before each: none ends by the time-out."""
    for _ in range(steps):
        simulation.set_command(_command(commands, simulation.time, sample))
        simulation.advance(1)


def _command(commands: Commands, time: float, sample: int) -> Command:
    """Return the command at a time, which lies after a sample."""
    return commands(time) if callable(commands) else commands[sample]


# Share of the gradients that a run of a calibration may take: tenths of a second.
_SHARE = 0.1


def name_step(alarms: Sequence[Alarm], simulation: Simulation,
              repeat: Callable[[float], Sequence[Alarm]]) -> list[Alarm]:
    """
    Return the alarms of a run, that of ResolutionGuard with a step size that raises none.

    How far an energy has gone says little of the step that would keep it: where steps do not
    resolve a motion its error is as large as the energies in play, at any of them. So the run is
    repeated with a half of its step, a quarter and so on; none is named where that takes more
    gradients than some tenths of a second hold.

    Parameters
    ----------
    alarms : sequence of Alarm
        Of the run.
    simulation : Simulation
        That took it.
    repeat : callable
        Repeats it at another step size [s], and returns its alarms.

    """
    told = list(alarms)
    for k, alarm in enumerate(alarms):
        if alarm.kind == ResolutionGuard.kind:
            step = _resolving_step(simulation, repeat)
            if step is not None:
                told[k] = alarm._replace(
                    message=f'{alarm.message}; step_size {step:g} resolves this run')
    return told


def _resolving_step(simulation: Simulation, repeat: Callable[[float], Sequence[Alarm]]
                    ) -> float | None:
    h, cost = simulation.step_size, simulation.gradients
    if simulation.usual_gradients:
        # Steps that are hard to solve take more, which shorter ones do not.
        cost = min(cost, simulation.steps * simulation.usual_gradients)
    most = _SHARE * InitialValueProblem(
        simulation.hamiltonian, (), simulation.q, simulation.p).gradients
    while (cost := 2 * cost) <= most:
        h *= 0.5
        # Rounded down, to two digits.
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


# Trajectories that step together: a network's weights are read once for all of them. Larger
# blocks gain no more, and each waits for its slowest trajectory.
BLOCK = 32


def simulate(scene: Scene | Parts | str | Path, duration: float, *, step_size: float | None = None,
             integrator: str | None = None,
             initial_state: tuple[ArrayLike, ArrayLike] | None = None,
             effects: Sequence[Mapping[str, Any]] | None = None,
             commands: Commands | None = None, every: int = 1,
             times: Sequence[float] | np.ndarray | None = None) -> Trajectory:
    """
    Simulate a scene without ROS.

    Parameters
    ----------
    scene : Scene, Parts, str or Path
        From ``load_scene``, or what that takes: the name of a shipped scene, or a YAML file.
    duration : float
        Simulated time [s], which the last sample is at; see DenseStep for a time between steps.
    step_size : float, optional
        h [s], in place of the scene's.
    integrator : str, optional
        A name from INTEGRATORS, in place of the scene's.
    initial_state : tuple of (q, p), shape (d,) each, optional
        In place of the scene's.
    effects : sequence of mapping, optional
        In place of the scene's, each as in YAML: ``{'kind': 'damping', 'rate': 0.1}``.
    commands : callable or array, shape (N, c), optional
        Of external_force: a function of the time [s] that is asked before each step, or a row for
        each sample, which holds until the next. For a servo, a function that returns JointCommand.
    every : int, optional
        Steps from one sample to the next.
    times : sequence of float, optional
        Of the samples in place of every, rising, from 0 to the duration [s]; they need not be
        whole steps. Not with commands, which are held from sample to sample.

    Returns
    -------
    Trajectory
        The first sample is the initial state, unless times says otherwise; the last one is where
        an event ended the run, if one did.

    Warns
    -----
    AlarmWarning
        A guard says that the run is not to be trusted; ``alarms`` of the trajectory holds it. Of
        a run that is under-resolved the warning names a step size that resolves it, where one is
        found in some tenths of a second.

    Raises
    ------
    HnnViRosError
        An unknown scene or integrator, a model that cannot be loaded, or a StepFailure.
    ValueError
        An argument that is not usable, or more samples than fit into memory.
    TypeError
        An argument of another type.

    """
    check_seconds('duration', duration)
    check_count('every', every)
    parts = changed_parts(scene, step_size, integrator, initial_state, effects)
    scene = parts.scene
    simulation = watched(build(parts), scene)
    recorded = record_one(simulation, duration, int(every), times, commands)

    def repeat(h: float) -> tuple[Alarm, ...]:
        # At whole steps alone, where that is as good: states between them take time.
        other = build(parts._replace(scene=scene.with_overrides(h)))
        return record_one(other, float(recorded.t[-1]), int(every) if times is None else 1).alarms

    tell(name_step(recorded.alarms, simulation, repeat), scene.known_step_size)
    return replace(recorded, scene=scene)


def changed_parts(scene: Scene | Parts | str | Path, step_size: float | None = None,
                  integrator: str | None = None,
                  initial_state: tuple[ArrayLike, ArrayLike] | None = None,
                  effects: Sequence[Mapping[str, Any]] | None = None) -> Parts:
    """Return the parts of a resolved scene, with others where given; see ``simulate``."""
    own = scene.scene if isinstance(scene, Parts) else _scene(scene)
    changed, _ = resolve(own.with_overrides(
        step_size, integrator, _state(initial_state), _listed(effects)))
    return scene if isinstance(scene, Parts) and changed is own else changed.parts()


def record_one(simulation: Simulation, duration: float, every: int,
               times: Sequence[float] | np.ndarray | None = None,
               commands: Commands | None = None) -> Trajectory:
    """
    Take the samples of one trajectory, and warn of nothing.

    Parameters
    ----------
    simulation : Simulation
        In its initial state, of shape (d,).
    duration, every, times, commands
        See ``simulate``.

    Returns
    -------
    Trajectory
        With the alarms.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    watch = Watch(simulation, simulation.hamiltonian.barrier)
    parts = [(simulation.q[None].copy(), simulation.p[None].copy())]
    t, takers = recorders(simulation, duration, every, times, commands, watch)
    try:
        for take in takers:
            parts.append(take())  # noqa: PERF401  what was taken before it stops is kept
    except StoppedByEvent as stop:
        parts += [(stop.q, stop.p), (stop.event.q[None], stop.event.p[None])]
        t = np.append(t[:sum(len(q) for q, _ in parts) - 1], stop.event.t)
    # Times that were asked for need not begin with the initial state.
    first = int(times is not None)
    t, (q, p) = t[first:], (np.vstack(halves) for halves in zip(*parts[first:], strict=True))
    energies, work = energies_of(simulation, q, p), None
    if not simulation.conservative:
        steps = [whole_steps(time, simulation.step_size) for time in t.tolist()]
        # Of a state between two steps the work is not known.
        work = np.array([math.nan if share else watch.works.get(step, math.nan)
                         for step, share in steps])
    else:
        watch.show(simulation, t / simulation.step_size, (q, p), energies)
    return Trajectory(t, q, p, energies[0], simulation.hamiltonian.coordinates,
                      tuple(watch.alarms), tuple(
                          event for event in getattr(simulation, 'events', ())
                          if event.t <= t[-1]), work=work)


def record_block(simulation: Simulation, q: np.ndarray, p: np.ndarray, stream: int,
                 duration: float, every: int, times: np.ndarray | None = None
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Alarm]]:
    """
    Take the samples of trajectories that step together.

    Parameters
    ----------
    simulation : Simulation
        Of as many trajectories; it is restarted.
    q, p : np.ndarray, shape (m, d)
        Initial states.
    stream : int
        Of noise.
    duration, every, times
        See ``simulate``; the first of the times is 0.

    Returns
    -------
    tuple of (np.ndarray, np.ndarray, np.ndarray, list of Alarm)
        Times, shape (n,), q and p there, shape (n, m, d), and the alarms about the steps of all;
        without work those about energies are left to ``show_many``.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    simulation.restart(q, p, stream=stream)
    watch = watch_of_block(simulation)
    t, takers = recorders(simulation, duration, every, None if times is None else times[1:],
                          None, watch)
    parts = [(q[None], p[None]), *(take() for take in takers)]
    watch.update(look_at_block(simulation))
    q_all, p_all = (np.vstack(halves) for halves in zip(*parts, strict=True))
    return t, q_all, p_all, watch.alarms


def record_rows(simulation: Simulation, q: np.ndarray, p: np.ndarray, stream: int,
                commands: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray, list[Alarm]]:
    """
    Take the samples of trajectories each of which has commands of its own.

    Parameters
    ----------
    simulation : Simulation
        Of one of them; it is restarted.
    q, p : np.ndarray, shape (m, d)
        Initial states.
    stream : int
        Of the noise of the first; the others have those that follow.
    commands : iterable of np.ndarray, shape (m, every, c)
        Before each step, from one sample to the next.

    Returns
    -------
    tuple of (np.ndarray, np.ndarray, list of Alarm)
        q and p, shape (n, m, d), and the alarms about the steps of all.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    begun = []
    for k in range(len(q)):
        simulation.restart(q[k:k + 1], p[k:k + 1], stream=stream + k)
        begun.append(simulation.row)
    rows, watch = np.array(begun), watch_of_block(simulation)
    states, width = [np.hstack([q, p])], q.shape[1]
    watch.update(look_at_rows(simulation, rows, q, p))
    for held in commands:
        states.append(simulation.follow_on(rows, held)[:, -1, :width + p.shape[1]])
        watch.update(look_at_rows(simulation, rows, states[-1][:, :width], states[-1][:, width:]))
    path = np.array(states)
    return path[..., :width], path[..., width:], watch.alarms


def _scene(scene: Scene | str | Path) -> Scene:
    """Return the scene of a name."""
    if isinstance(scene, str | Path):
        return load_scene(scene)
    if not isinstance(scene, Scene):
        raise TypeError(f'scene is a {type(scene).__name__}: give what load_scene returns, the '
                        'name of a shipped scene, or the path of a YAML file')
    return scene


def _state(state: tuple[ArrayLike, ArrayLike] | None) -> dict[str, list[float]] | None:
    """Return a pair (q, p) by name."""
    if state is None:
        return None
    if not isinstance(state, Sequence | np.ndarray) or isinstance(state, str) or len(state) != 2:
        raise TypeError('initial_state must be a pair: the coordinates q, and the momenta p, '
                        f'such as ([1.0], [0.0]), not {state!r:.60}')
    return {name: check_numbers(f'{name} of initial_state', part).tolist()
            for name, part in zip(('q', 'p'), state, strict=True)}


def _initial_states(q: ArrayLike, p: ArrayLike,
                    hamiltonian: Hamiltonian) -> list[np.ndarray]:
    """Return q and p of initial states, of shape (m, d), or raise an error about them."""
    states, d, turning = (
        (check_numbers('q', q), check_numbers('p', p)), hamiltonian.dimension,
        hamiltonian.rotations)
    widths = d, d - len(turning)
    for name, part, width in zip('qp', states, widths, strict=True):
        if part.ndim == 1 and part.size != width:
            raise ValueError(f'{name} has shape {part.shape}, expected (m, {width}): a row for '
                             'each trajectory, a number in it for each coordinate')
    checked = [part.reshape(-1, width) for part, width in zip(
        check_state(*states, d, turning), widths, strict=True)]
    if checked[0].size == 0:
        raise ValueError(f'q has shape {np.shape(q)}: no trajectory to simulate')
    return checked


def _listed(effects: Sequence[Mapping[str, Any]] | None) -> Any:
    """Return a sequence of effects as the list that a scene holds; leave anything else alone."""
    return list(effects) if isinstance(effects, tuple) else effects


def _check_many(commands: ManyCommands, share: float, device: str | None, one: Simulation,
                shape: tuple[int, int]) -> None:
    """Raise ValueError for commands, of an array of shape (m, samples, c), that do not fit."""
    if not one.takes_commands:
        raise ValueError('no effect of the scene takes commands: add external_force, with its '
                         'coordinates')
    if share or device is not None:
        raise ValueError('with commands samples lie whole steps apart, and no device takes the '
                         'steps; take another duration or samples, and leave device out')
    if not callable(commands):
        _checked_numbers('commands', commands, [(*shape, one.command_size)])


def _numbers(commands: Any, time: float, sample: int, shape: tuple[int, int]) -> np.ndarray:
    """Return the commands of all trajectories, (m, c), at a time after a sample."""
    if not callable(commands):
        return np.asarray(commands[:, sample])
    return np.broadcast_to(_checked_numbers(
        f'commands({time:g})', commands(time), [shape, shape[1:]]), shape)


def _checked_numbers(name: str, values: Any, shapes: list[tuple[int, ...]]) -> np.ndarray:
    """Return numbers of one of the shapes, or raise ValueError."""
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

    Trajectories do not depend on each other: a block of them is one system, the sum of their
    Hamiltonians, so the formula of a step is the same code. The implicit equations of a block
    are solved until each of its trajectories has converged. With a thermostat, an impact or a
    constraint each trajectory steps alone, and meets its own noise.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``simulate``; its own initial state is not used.
    q, p : sequence, shape (m, d)
        Initial states.
    duration : float
        Simulated time [s].
    samples : int, optional
        Samples after the initial one, evenly spaced; see DenseStep for times between steps.
    commands : array or callable, optional
        Of external_force, plain numbers: an array of shape (m, samples, c), which each trajectory
        holds from sample to sample, or a function of the time [s] that returns (m, c) or (c,)
        before each step. Each trajectory then steps alone, bit by bit as in ``simulate``, and
        samples lie whole steps apart.
    threads : int, optional
        By default as many as there are processors; of no meaning on a GPU.
    device : str, optional
        ``'cuda'``, ``'cuda:N'`` or ``'cpu'``: take the steps in torch, with each trajectory solved
        by itself, in place of compiled loops; see docs/scale.md. For an H of perceptrons, without
        effects, and some of the methods.

    Returns
    -------
    Trajectory
        t of shape (samples + 1,), q and p of shape (samples + 1, m, d), energy of shape
        (samples + 1, m). Alarms about steps, and about energies where work is done, go to all
        trajectories that step together.

    Warns
    -----
    AlarmWarning
        See ``simulate``.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, or a step of some trajectory fails.
    MissingPackage
        A device takes the extra ``train``.
    ValueError
        An argument that is not usable, or more samples than fit into memory.
    TypeError
        An argument of another type.

    """
    check_seconds('duration', duration)
    if duration == 0.0:
        raise ValueError('duration = 0 s: the samples must lie some time apart')
    check_count('samples', samples)
    if threads is not None:
        check_count('threads', threads)
    scene, _ = resolve(_scene(scene))
    if scene.events:
        raise ValueError('simulate_many watches for no events: leave the events out of '
                         f'{scene.name}, or simulate one trajectory at a time')
    parts = scene.parts()
    _, hamiltonian, integrator, effects = parts
    size = BLOCK if System(hamiltonian, effects, integrator).lockstep else 1
    q0, p0 = _initial_states(q, p, hamiltonian)
    if q0.size * samples > MOST_NUMBERS:
        raise ValueError(f'{samples} samples of {len(q0)} trajectories are more than memory '
                         'holds; take fewer at a time')
    h, interval = scene.known_step_size, duration / samples
    every, share = whole_steps(interval, h)
    t = np.arange(samples + 1) * (interval if share else every * h)

    def start(block: slice) -> Simulation:
        return build_at(parts, q0[block], p0[block])

    def work(firsts: range) -> None:
        simulation = start(slice(firsts[0], firsts[0] + (size if commands is None else 1)))
        for first in firsts:
            block = slice(first, first + size)
            if commands is None:
                _, q_all[:, block], p_all[:, block], told = record_block(
                    simulation, q0[block], p0[block], first, float(t[-1]), max(every, 1),
                    t if share else None)
            else:
                q_all[:, block], p_all[:, block], told = record_rows(
                    simulation, q0[block], p0[block], first,
                    (part[block] for part in held(commands, simulation.command_size)))
            for own in alarms[block]:
                own += told

    def held(commands: ManyCommands, c: int) -> Iterator[np.ndarray]:
        """Yield the commands before each step from one sample to the next, (m, every, c)."""
        for sample in range(samples):
            yield np.stack([_numbers(commands, k * h, sample, (len(q0), c)) for k in range(
                sample * every, sample * every + every)], axis=1)

    if commands is not None:
        size = BLOCK
        _check_many(commands, share, device, start(slice(0, 1)), (len(q0), samples))
        commands, threads = (commands, 1) if callable(commands) else (
            np.asarray(commands, dtype=np.float64), threads)
    alarms: list[list[Alarm]] = [[] for _ in q0]
    if device is None:
        workers = min(threads or usable_processors(), -(-len(q0) // size))
        q_all, p_all = (np.empty((samples + 1, *part.shape)) for part in (q0, p0))
        in_threads(lambda k: work(range(k * size, len(q0), workers * size)), workers)
    else:
        if share:
            raise ValueError(f'device = {device}: samples lie {interval:g} s apart, '
                             f'{interval / h:g} steps: on a device these are whole; take another '
                             'duration or samples')
        with optional('torch', f'device = {device}'):
            from hnn_vi_ros.trajectory.devices import ensemble_on, record_on_device
        q_all, p_all, failures = record_on_device(
            start(slice(0, 1)), partial(ensemble_on, device, parts), device, q0, p0,
            [k * every for k in range(samples + 1)], threads, alarms)
        if failures:
            raise failures[min(failures)]
    energies = show_many(start(slice(0, 1)), t / h, q_all, p_all, alarms)
    tell_many(alarms, h)
    return Trajectory(t, q_all, p_all, energies, hamiltonian.coordinates,
                      tuple(map(tuple, alarms)), scene=scene)
