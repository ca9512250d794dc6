# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 7: what the integrator auto chose, over the best of a grid of methods and step sizes."""

from collections.abc import Callable, Iterator
import math

from benchmarks.measurement import compare, interleave, Row, Settings
from hnn_vi_ros.accuracy.automatic_choice import calibrate, CANDIDATES
from hnn_vi_ros.accuracy.trials import InitialValueProblem, Method, Tolerance
from hnn_vi_ros.errors import StepFailure, UnsupportedSystem
from hnn_vi_ros.scene import load_scene
import numpy as np

_PAIRS = (
    ('exact_pendulum', Tolerance('energy_error', 1e-3, 200.0)),
    ('exact_pendulum', Tolerance('energy_error', 1e-8, 200.0)),
    ('pendulum', Tolerance('energy_error', 1e-5, 200.0)),
    ('kepler', Tolerance('energy_error', 1e-6, 200.0)),
)
_STEP_SIZES = [0.8 * 2.0 ** -k for k in range(11)]
# Simulated time of a timed run [s].
_TIMED = 200.0


def rows(settings: Settings) -> Iterator[Row]:
    """Measure a row for each pair of scene and tolerance."""
    for name, tolerance in _PAIRS:
        settings.say(f'{name}, {tolerance.kind} {tolerance.error:g}')
        yield _row(name, tolerance, settings)


def _row(name: str, tolerance: Tolerance, settings: Settings) -> Row:
    scene = load_scene(name)
    problem = InitialValueProblem(scene.create_hamiltonian(), (), np.array(scene.initial_state.q),
                                  np.array(scene.initial_state.p))
    choice = calibrate(problem, tolerance)
    label, h = _best(problem, tolerance, choice.energy_scale)
    chosen = Method(choice.method, choice.arguments)
    times = interleave([_contestant(problem, chosen, choice.step_size),
                        _contestant(problem, label, h)], settings.repetitions)
    return compare(
        f'auto on {name}, {tolerance.kind} {tolerance.error:g}: time a simulated second',
        times[:, 0],
        times[:, 1], target=1.5, scale=1e6 / _TIMED, peer_name=f'{label}, h = {h:g}',
        note=f'auto chose {chosen}, h = {choice.step_size:.3g}; the peer is the fastest '
             'row of the grid that holds the tolerance',
        miss='auto counts gradients and steps, whose fixed cost is that of one machine, so that '
             'its choice does not depend on the load.')


def _contestant(problem: InitialValueProblem, method: str | Method, h: float) -> Callable:
    simulation = problem.simulation(method, h)
    simulation.compile()
    return lambda: lambda: simulation.advance(round(_TIMED / h))


def _best(problem: InitialValueProblem, tolerance: Tolerance, size: float) -> tuple[str, float]:
    """Return the fastest method and step that hold the tolerance, over an energy [J]."""
    found = []
    for method in CANDIDATES:
        for h in _STEP_SIZES:
            try:
                simulation = problem.simulation(method, h)
                worst = 0.0
                every = math.ceil(tolerance.horizon / h / 2000)
                while simulation.time < tolerance.horizon and worst <= tolerance.error:
                    simulation.advance(every)
                    worst = max(worst, abs(simulation.energy_balance) / size)
            except UnsupportedSystem:
                break
            except StepFailure:
                continue
            if worst <= tolerance.error:
                # The largest step of a method that holds it is its fastest.
                run = _contestant(problem, method, h)
                found.append((float(np.median(interleave([run], 5))), method, h))
                break
    return min(found)[1:]
