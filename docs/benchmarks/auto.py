# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 7: the choice of `integrator: auto`, relative to the best of a sweep."""

from collections.abc import Iterator

from benchmarks.campaign import swept, Truth
from benchmarks.choosing import cheapest, problem_of, Way
from benchmarks.measurement import Contestant, race, Row, Settings
from hnn_vi_ros.simulation import InitialValueProblem, Method, Tolerance
from hnn_vi_ros.simulation.accuracy.automatic_choice import calibrate
from hnn_vi_ros.simulation.accuracy.trials import CalibrationTask

_PAIRS = (
    ('exact_pendulum', Tolerance('energy_error', 1e-3, 200.0)),
    ('exact_pendulum', Tolerance('energy_error', 1e-8, 200.0)),
    ('pendulum', Tolerance('energy_error', 1e-5, 200.0)),
    ('kepler', Tolerance('energy_error', 1e-6, 200.0)),
)
# Longest step of the sweep, half a period of the pendulums [s].
_LONGEST = 1.0


def rows(settings: Settings) -> Iterator[Row]:
    """Measure a row for each pair of scene and tolerance."""
    for name, tolerance in _PAIRS:
        settings.say(f'{name}, {tolerance.kind} {tolerance.error:g}')
        problem = problem_of(name)
        choice = calibrate(CalibrationTask(problem, tolerance))
        chosen = Method(choice.method, choice.arguments)
        ways = [Way(method, h, cost, _run(problem, method, h, tolerance.horizon))
                for method, h, cost in swept(
                    problem, Truth(problem, tolerance.horizon), tolerance,
                    tolerance.horizon / _LONGEST)]
        yield race(
            f'auto on {name}, {tolerance.kind} {tolerance.error:g}: time per simulated second',
            {'auto': _run(problem, chosen, choice.step_size, tolerance.horizon)},
            cheapest(ways), settings, target=1.5, scale=1e6 / tolerance.horizon,
            note=f'auto chose {chosen}, h = {choice.step_size:.3g}; the peer is the fastest of '
                 'the sweep that holds the tolerance',
            miss='auto counts gradients and steps, whose fixed cost is that of one machine, so '
                 'that its choice does not depend on the load.')


def _run(problem: InitialValueProblem, method: Method, h: float, duration: float) -> Contestant:
    simulation = problem.simulation(method, h)
    simulation.compile()
    return lambda: lambda: simulation.advance(round(duration / h))
