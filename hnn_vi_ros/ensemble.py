# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of a scene without ROS: one, or many in lock-step blocks on several threads."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
from typing import Any

from hnn_vi_ros.checks import check_count, check_seconds
from hnn_vi_ros.dense_step import record_at, whole_steps
from hnn_vi_ros.guards.base import Alarm
from hnn_vi_ros.guards.energy import EnergyGuard
from hnn_vi_ros.guards.watch import (
    energies_of, look, record_watched, show_many, tell, tell_many, Watch)
from hnn_vi_ros.phase_space import check_state, Trajectory
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.system import System
import numpy as np

# Trajectories that step together: a network's weights are read once for all of them. Larger
# blocks gain no more, and each waits for its slowest trajectory.
BLOCK = 32
# Coordinates that the samples of a run may have in all; as many momenta come beside them: 4 GiB.
_MOST_NUMBERS = 2**28

# What a command is in time: values at a time [s], or at each sample.
Commands = Callable[[float], Sequence[float]] | Sequence[Sequence[float]]


def simulate(scene: Scene | str | Path, duration: float, *, step_size: float | None = None,
             integrator: str | None = None,
             initial_state: tuple[Sequence[float], Sequence[float]] | None = None,
             effects: Sequence[Mapping[str, Any]] | None = None,
             commands: Commands | None = None, every: int = 1,
             times: Sequence[float] | None = None) -> Trajectory:
    """
    Simulate a scene without ROS.

    Parameters
    ----------
    scene : Scene, str or Path
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
        Of the effect external_force: a function of the time [s] that is asked before each step,
        or a row for each sample, which holds until the next.
    every : int, optional
        Steps from one sample to the next.
    times : sequence of float, optional
        Of the samples in place of every, rising, from 0 to the duration [s]; they need not be
        whole steps. Not with commands, which are held from sample to sample.

    Returns
    -------
    Trajectory
        The first sample is the initial state, unless times says otherwise.

    Warns
    -----
    AlarmWarning
        A guard says that the run is not to be trusted; ``alarms`` of the trajectory holds it.

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
    simulation = Simulation.from_scene(_scene(scene).with_overrides(
        step_size, integrator, _state(initial_state), _listed(effects)))
    watch = Watch(simulation, simulation.hamiltonian.barrier)
    if times is None:
        t, q, p = _record_evenly(simulation, duration, every, commands, watch)
    elif commands is None:
        t = _check_times(times, duration)
        q, p = _record(simulation, t.size, t, watch)
    else:
        raise ValueError('times and commands cannot both be given: use every with commands')
    energies = energies_of(simulation, q, p)
    if simulation.conservative:
        watch.show(simulation, t / simulation.step_size, (q, p), energies)
    tell(watch.alarms, simulation.step_size)
    return Trajectory(t, q, p, energies[0], tuple(watch.alarms))


def _record_evenly(simulation: Simulation, duration: float, every: int,
                   commands: Commands | None, watch: Watch
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return t, q and p after each ``every`` steps, and at the end."""
    interval = simulation.step_size * every
    _check_memory(duration, interval, simulation.q.size)
    samples, share = whole_steps(duration, interval)
    parts = [(simulation.q[None].copy(), simulation.p[None].copy())]
    t = np.arange(samples + 1) * every * simulation.step_size
    if commands is None:
        parts.append(_record(simulation, samples, every, watch))
    else:
        commands = _check_commands(commands, samples + bool(share))
        parts.append(_record_commanded(simulation, samples, every, commands, watch))
    if share:
        t = np.append(t, duration)
        if commands is not None:
            _advance_commanded(simulation, int(share * every), commands, samples)
            simulation.set_command(_command(commands, simulation.time, samples))
        parts.append(_record(simulation, 1, t[-1:], watch))
    return t, *(np.vstack(halves) for halves in zip(*parts, strict=True))


def _record(simulation: Simulation, samples: int, every: int | np.ndarray, watch: Watch
            ) -> tuple[np.ndarray, np.ndarray]:
    """Take samples, every so many steps or at given times; look on where work is done."""
    if isinstance(every, int):
        return (simulation.record(samples, every) if simulation.conservative
                else record_watched(simulation, samples, every, watch))
    if simulation.conservative:
        return record_at(simulation, every)
    watch.update(look(simulation))
    return record_at(simulation, every, lambda: watch.update(look(simulation)))


def _scene(scene: Scene | str | Path) -> Scene:
    """Return the scene of a name."""
    if isinstance(scene, str | Path):
        return load_scene(scene)
    if not isinstance(scene, Scene):
        raise TypeError(f'scene is a {type(scene).__name__}: give what load_scene returns, the '
                        'name of a shipped scene, or the path of a YAML file')
    return scene


def _state(state: tuple[Sequence[float], Sequence[float]] | None
           ) -> dict[str, Sequence[float]] | None:
    """Return a pair (q, p) by name."""
    if state is None:
        return None
    if not isinstance(state, Sequence | np.ndarray) or isinstance(state, str) or len(state) != 2:
        raise TypeError('initial_state must be a pair: the coordinates q, and the momenta p')
    return {name: np.array(part, dtype=np.float64).tolist()
            for name, part in zip(('q', 'p'), state, strict=True)}


def _listed(effects: Sequence[Mapping[str, Any]] | None) -> Any:
    """Return a sequence of effects as the list that a scene holds, and anything else as it is."""
    return list(effects) if isinstance(effects, tuple) else effects


def _check_times(times: Sequence[float], duration: float) -> np.ndarray:
    """Return times of samples as an array, or raise."""
    t = np.array(times, dtype=np.float64)
    if t.ndim != 1 or t.size == 0:
        raise ValueError(f'times has shape {t.shape}, expected (N,): a list of at least one time')
    if not (np.isfinite(t).all() and (np.diff(t) >= 0.0).all() and t[0] >= 0.0
            and t[-1] <= duration):
        raise ValueError(f'times must rise from 0 s at least to the duration, {duration:g} s, at '
                         'most')
    return t


def _check_memory(duration: float, interval: float, dimension: int) -> None:
    """Raise ValueError if the samples of a run do not fit into memory."""
    samples = duration / interval
    if samples * dimension > _MOST_NUMBERS:
        raise ValueError(f'duration = {duration:g} s would make {samples:.2g} samples, one every '
                         f'{interval:g} s: more than memory holds; take a larger every')


def _check_commands(commands: Commands, samples: int) -> Commands:
    """Return rows of commands as an array, or raise if there are too few."""
    if callable(commands):
        return commands
    rows = np.array(commands, dtype=np.float64)
    if rows.ndim != 2 or len(rows) < samples:
        raise ValueError(f'commands has shape {rows.shape}, expected ({samples}, c): a row '
                         'for each sample but the last; or give a function of the time')
    return rows


def _record_commanded(simulation: Simulation, samples: int, every: int, commands: Commands,
                      watch: Watch) -> tuple[np.ndarray, np.ndarray]:
    """Take samples times every steps, with a command before each step."""
    q, p = np.empty((2, samples, simulation.q.size))
    watch.update(look(simulation))
    for sample in range(samples):
        _advance_commanded(simulation, every, commands, sample)
        q[sample], p[sample] = simulation.q, simulation.p
        watch.update(look(simulation))
    return q, p


def _advance_commanded(simulation: Simulation, steps: int, commands: Commands, sample: int
                       ) -> None:
    """Take steps after a sample, with a command before each: none ends by the time-out."""
    for _ in range(steps):
        simulation.set_command(_command(commands, simulation.time, sample))
        simulation.advance(1)


def _command(commands: Commands, time: float, sample: int) -> Sequence[float]:
    """Return the command at a time, which lies after a sample."""
    return commands(time) if callable(commands) else commands[sample]


def simulate_many(scene: Scene | str | Path, q: Sequence[Sequence[float]],
                  p: Sequence[Sequence[float]], duration: float, *, samples: int = 1,
                  threads: int | None = None) -> Trajectory:
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
    threads : int, optional
        By default as many as there are processors.

    Returns
    -------
    Trajectory
        t of shape (samples + 1,), q and p of shape (samples + 1, m, d), energy of shape
        (samples + 1, m). Where work is done, the energies of trajectories that step together are
        watched together.

    Warns
    -----
    AlarmWarning
        See ``simulate``.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, or a step of some trajectory fails.
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
    scene = _scene(scene).resolved()
    hamiltonian, integrator = scene.create_hamiltonian(), scene.create_integrator()
    effects = scene.create_effects()
    system = System(hamiltonian, effects, integrator)
    d, size = hamiltonian.dimension, BLOCK if system.lockstep else 1
    q0, p0 = (part.reshape(-1, d) for part in check_state(q, p, d))
    if q0.size == 0:
        raise ValueError(f'q has shape {np.shape(q)}: no trajectory to simulate')
    if q0.size * samples > _MOST_NUMBERS:
        raise ValueError(f'{samples} samples of {len(q0)} trajectories are more than memory '
                         'holds; take fewer at a time')
    interval = duration / samples
    every, share = whole_steps(interval, scene.step_size)
    t = np.arange(samples + 1) * (interval if share else every * scene.step_size)

    def start(block: slice) -> Simulation:
        return Simulation(hamiltonian.twin(), integrator, scene.step_size, q0[block], p0[block],
                          effects, scene.on_failure)

    workers = min(threads or os.cpu_count() or 1, -(-len(q0) // size))
    q_all, p_all = np.empty((2, samples + 1, len(q0), d))
    alarms: list[list[Alarm]] = [[] for _ in q0]
    q_all[0], p_all[0] = q0, p0
    with ThreadPoolExecutor(workers) as pool:
        # Taken from the iterator, so that a failure of one worker is raised here.
        list(pool.map(lambda worker: _fill(
            start, range(worker * size, len(q0), workers * size), size,
            t[1:] if share else every, q_all, p_all, alarms), range(workers)))
    energies = show_many(
        start(slice(0, 1)), t / scene.step_size, q_all, p_all, alarms)
    tell_many(alarms, scene.step_size)
    return Trajectory(t, q_all, p_all, energies, tuple(map(tuple, alarms)))


def _fill(start: Callable[[slice], Simulation], firsts: range, size: int,
          every: int | np.ndarray, q_all: np.ndarray, p_all: np.ndarray,
          alarms: list[list[Alarm]]) -> None:
    """Simulate the blocks that begin at these trajectories; every: steps, or samples' times."""
    samples, d = len(q_all) - 1, q_all.shape[2]
    simulation = start(slice(firsts[0], firsts[0] + size))
    for first in firsts:
        block = slice(first, first + size)
        # Each trajectory has noise of its own.
        simulation.restart(q_all[0, block], p_all[0, block], stream=first)
        watch = Watch(simulation, None, kinds=(EnergyGuard,))
        q_block, p_block = _record(simulation, samples, every, watch)
        for own in alarms[block]:
            own += watch.alarms
        q_all[1:, block] = q_block.reshape(samples, -1, d)
        p_all[1:, block] = p_block.reshape(samples, -1, d)
