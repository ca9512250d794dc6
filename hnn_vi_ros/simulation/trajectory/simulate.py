# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of one trajectory of a scene without ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import listed
from hnn_vi_ros.phase_space import energy_unit
from hnn_vi_ros.scene import Choice, load_scene, Parts, Scene
from hnn_vi_ros.simulation.checks import check_count, check_numbers, check_seconds
from hnn_vi_ros.simulation.construction import build, resolve
from hnn_vi_ros.simulation.events import watched
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.watch import judge, tell, Watch
from hnn_vi_ros.simulation.run_samples import CommandFunction, Commands, record, Schedule
from hnn_vi_ros.simulation.second_run import PathReport
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.trajectory.trajectory import EnergyByCause, Trajectory
import numpy as np
from numpy.typing import ArrayLike

# An initial state.
State = tuple[ArrayLike, ArrayLike] | Mapping[str, ArrayLike]


def simulate(scene: Scene | Parts | str | Path | Callable[[Any, Any], Any], *more: ArrayLike,
             duration: float | None = None, step_size: float | None = None,
             integrator: Choice | None = None, initial_state: State | None = None,
             effects: Sequence[Mapping[str, Any]] | None = None,
             commands: Commands | None = None, every: int = 1,
             times: Sequence[float] | np.ndarray | None = None,
             energy_by_cause: bool = False, path_error: str | None = None) -> Trajectory:
    """
    Simulate ``(scene, duration)`` or ``(H, q, p, duration, step_size)``, without ROS.

    Parameters
    ----------
    scene : Scene, Parts, str, Path or callable
        A scene from ``load_scene``, the name of a shipped scene, the path of a YAML file, or a
        function H(q, p) or H(q, p, t) [J], which is called with symbols and becomes a formula: it
        may use operators and functions of numpy, but no branches on values. ``scene.to_yaml()``
        of the trajectory returns it.
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
    energy_by_cause : bool, optional
        Account for the energy by cause, as ``energy_by_cause: true`` of a scene does.
    path_error : str, optional
        ``'measured'``, or ``'off'``; overrides the scene's. See PathError.

    Returns
    -------
    Trajectory
        The samples. The first is the initial state, unless `times` is given; if an event ended
        the run, the last is the state at the event.

    Warns
    -----
    AlarmWarning
        A guard found the run unreliable; ``alarms`` of the trajectory contains the alarm. If the
        path is not resolved, the warning recommends a step size.

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
    given: dict[str, Any] = dict(zip(names, more, strict=False))
    duration, step_size = _once('duration', given, duration), _once('step_size', given, step_size)
    if callable(scene):
        if initial_state and more:
            raise TypeError(f'{listed(names[:len(more)])} and initial_state are both given; after '
                            'a function H, numbers without a name are q, p, duration and '
                            'step_size: write duration=10.0')
        scene = Scene.build(
            hamiltonian=scene, integrator=integrator or 'gauss8', step_size=step_size,
            initial_state=initial_state or {name: given.get(name) for name in 'qp'}, name='H')
        step_size = integrator = initial_state = None
    check_count('every', every)
    if duration is not None:
        check_seconds('duration', duration)
    if times is not None and commands is not None:
        raise ValueError('times and commands cannot both be given: use every with commands')
    parts = changed_parts(scene, step_size, integrator, initial_state, effects, energy_by_cause,
                          path_error)
    simulation = watched(build(parts), parts.scene)
    end = parts.scene.duration if duration is None else duration
    schedule = Schedule.at(times, end) if times is not None else Schedule.until(
        end, int(every), simulation)
    function = CommandFunction(commands) if callable(commands) else None
    found = record_one(simulation, schedule, function or commands, PathReport.of(parts.scene))
    if function is not None:
        function.check_held(simulation.step_size)
    tell(list(found.alarms), simulation.step_size)
    return replace(found, scene=parts.scene)


def _once(name: str, given: Mapping[str, Any], value: Any) -> Any:
    """Return an argument given by position or by name; raise TypeError if it is given twice."""
    if name in given and value is not None:
        raise TypeError(f'{name} is given twice')
    return given.get(name, value)


def changed_parts(scene: Scene | Parts | str | Path, step_size: float | None = None,
                  integrator: Choice | None = None, initial_state: State | None = None,
                  effects: Sequence[Mapping[str, Any]] | None = None,
                  energy_by_cause: bool = False, path_error: str | None = None) -> Parts:
    """Return the parts of a resolved scene with overrides applied; see ``simulate``."""
    more = ({'energy_by_cause': energy_by_cause} if energy_by_cause else {}) | (
        {'path_error': path_error} if path_error else {})
    if isinstance(scene, Parts):
        if more:
            scene = scene._replace(scene=scene.scene.changed(more))
        if all(value is None for value in (step_size, integrator, initial_state, effects)):
            return scene
        scene = scene.scene
    scene = _scene(scene).with_overrides(
        step_size, integrator, _state(initial_state), _listed(effects))
    return resolve(scene.changed(more) if more else scene)


def record_one(simulation: Simulation, schedule: Schedule, commands: Commands | None = None,
               report: PathReport | None = None) -> Trajectory:
    """
    Simulate one trajectory without emitting warnings.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state, of shape (d,).
    schedule : Schedule
        Schedule of the samples.
    commands : callable or array, optional
        See ``simulate``.
    report : PathReport, optional
        Path error of the run, by default measured.

    Returns
    -------
    Trajectory
        The samples, with alarms.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    report = report or PathReport()
    report.follow(simulation, schedule.steps(simulation.step_size), period=0.0)
    watch = Watch(RunFacts(simulation))
    try:
        found = record(simulation, schedule, commands, watch.observe)
        energy, alarms = judge(found, watch)
        alarms = sorted([*alarms, *(alarm for _, alarm in report.finish())],
                        key=lambda alarm: alarm.step)
    finally:
        report.close()
    return Trajectory(found.t, found.q, found.p, energy, simulation.hamiltonian.coordinates,
                      tuple(alarms), tuple(event for event in getattr(simulation, 'events', ())
                                           if event.t <= found.t[-1]), work=found.work,
                      energy_by_cause=by_cause(simulation, found.t, found.causes),
                      path_error=report.errors()[0])


def by_cause(simulation: Simulation, t: np.ndarray, causes: np.ndarray | None
             ) -> EnergyByCause | None:
    """Return the energy by cause of samples; None if it was not requested."""
    return None if simulation.ledger is None or causes is None else EnergyByCause(
        t, simulation.ledger.names, causes, energy_unit(simulation.hamiltonian.coordinates))


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


def _listed(effects: Sequence[Mapping[str, Any]] | None) -> Any:
    """Return a tuple of effects as a list, and anything else unchanged."""
    return list(effects) if isinstance(effects, tuple) else effects
