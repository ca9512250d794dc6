# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An observer draws a simulation to what is observed, and refuses what cannot be."""

from helpers import plain_run, Uncompiled
from hnn_vi_ros.effects import EffectError, largest_gain, Observation
from hnn_vi_ros.effects.observer import Observer
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numpy as np
import pytest

NAN, INF = float('nan'), float('inf')
GAIN, DAMPING, MASS = 30.0, 6.0, 2.0
BODY = Uncompiled(HAMILTONIANS['free_particle'](MASS, ('x',)))


def observed(h: float, q: float = 0.4, p: float = 1.0, method: str = 'implicit_midpoint',
             effects: tuple = (), **arguments: float) -> Simulation:
    own = {'gain': GAIN, 'damping': DAMPING, 'timeout': 100.0} | arguments
    return plain_run(BODY, method, h, [q], [p], Observer(['x'], **own), *effects)


def seen(x: float, v: float = NAN, delay: float = 0.0, names=('x',)) -> Observation:
    return Observation(names, delay, np.array([x]), np.array([v]))


def test_observer_converges_with_order_2_to_the_damped_oscillator():
    """Of a free mass, e = q - y: e'' + lambda e' + (k / m) e = 0 behind y = y0 + w t."""
    T, y0, w = 1.0, 0.7, -0.3
    errors = []
    for steps in (20, 40):
        simulation = observed(T / steps)
        simulation.set_command(seen(y0, w))
        simulation.advance(steps)
        matrix = np.array([[-DAMPING, 1.0 / MASS], [-GAIN, 0.0]])
        # (e, p - m w)' = matrix (e, p - m w).
        values, vectors = np.linalg.eig(matrix)
        start = np.linalg.solve(vectors, [0.4 - y0, 1.0 - MASS * w])
        e, p = (vectors @ (np.exp(values * T) * start)).real
        errors.append(np.hypot(simulation.q[0] - (y0 + w * T + e),
                               simulation.p[0] - MASS * w - p))
    assert 3.6 < errors[0] / errors[1] < 4.4


def test_work_of_an_observer_is_the_change_of_the_energy():
    simulation = observed(0.01)
    simulation.set_command(seen(0.7, -0.3))
    simulation.advance(200)
    # The method keeps H of a free mass; 400 half flows round it by some eps of its size each.
    assert abs(simulation.energy_balance) < 1e-12
    assert simulation.works['observer'] != 0.0


def test_observer_without_gain_leaves_every_bit():
    simulation, alone = observed(0.01, gain=0.0, damping=0.0), plain_run(
        BODY, 'implicit_midpoint', 0.01, [0.4], [1.0])
    simulation.set_command(seen(5.0))
    for one in (simulation, alone):
        one.advance(50)
    assert (simulation.q.tobytes(), simulation.p.tobytes()) == (
        alone.q.tobytes(), alone.p.tobytes())


def test_observation_ends_with_its_timeout_and_survives_a_snapshot():
    simulation = observed(0.01, timeout=0.1)
    simulation.set_command(seen(0.7))
    simulation.advance(5)
    snapshot = simulation.snapshot()
    simulation.advance(20)
    end = simulation.q.copy(), simulation.p.copy()
    # Behind the time-out no force acts.
    simulation.advance(10)
    assert simulation.p.tobytes() == end[1].tobytes()
    simulation.restore(snapshot)
    simulation.advance(20)
    assert (simulation.q.tobytes(), simulation.p.tobytes()) == (
        end[0].tobytes(), end[1].tobytes())


def test_joints_are_matched_by_name_in_any_order_beside_others():
    one, other = observed(0.01), observed(0.01)
    one.set_command(seen(0.7, 0.1))
    other.set_command(Observation(('gripper', 'x'), 0.0, np.array([NAN, 0.7]),
                                  np.array([NAN, 0.1])))
    for simulation in (one, other):
        simulation.advance(10)
    assert one.q.tobytes() == other.q.tobytes()


@pytest.mark.parametrize('observation', [
    seen(NAN), seen(INF), seen(1.0, INF), seen(1.0, names=('y',)),
    Observation(('x', 'x'), 0.0, np.zeros(2), np.zeros(2)),
    Observation((), 0.0, np.zeros(0), np.zeros(0)), seen(1.0, delay=-0.6), seen(1.0, delay=1.7e9),
    seen(1.0, delay=NAN), seen(1.0, delay=-0.2), seen(1.0, 101.0), seen(1e9)])
def test_observation_that_cannot_be_used_is_refused_and_changes_nothing(observation):
    simulation, alone = observed(0.01, timeout=0.5), observed(0.01, timeout=0.5)
    for one in (simulation, alone):
        one.set_command(seen(0.7))
        one.advance(10)
    with refused(ValueError):
        simulation.set_command(observation)
    for one in (simulation, alone):
        one.advance(10)
    assert simulation.q.tobytes() == alone.q.tobytes()


def test_observer_takes_methods_of_order_2_at_most_and_stands_once():
    with refused(UnsupportedSystem):
        observed(0.01, method='gauss8')
    with refused(EffectError):
        observed(0.01, effects=(Observer(['x']),))


def test_observation_ahead_of_time_holds_up_no_later_one():
    simulation = observed(0.01, timeout=0.5)
    simulation.set_command(seen(0.7, delay=0.45))
    simulation.advance(1)
    # As late as any that comes from another machine.
    simulation.set_command(seen(0.6, delay=-0.002))
    simulation.advance(1)
    with refused(ValueError):
        simulation.set_command(seen(0.6, delay=-0.1))


def test_machine_is_found_again_after_a_wrong_observation_that_looked_right():
    simulation = observed(0.01, timeout=0.5, velocity_limit=20.0)
    # At the start it may be as far away as it moves in the time-out: 10 m.
    with refused(ValueError):
        simulation.set_command(seen(10.5))
    simulation.set_command(seen(10.3))
    rejected = 0
    for _ in range(100):
        simulation.advance(1)
        try:
            simulation.set_command(seen(0.4, 0.0))
        except ValueError:
            rejected += 1
    # By V from where it seemed to be, 9.9 m: after 0.5 s.
    assert rejected <= 50
    # Errors of the mode exp(-3 t) are left for another half of a second.
    assert abs(simulation.q[0] - 0.4) < 0.3


def test_simulation_is_set_to_what_is_observed_beyond_reach():
    near, far = (observed(0.01, q=0.0, p=5.0, velocity_limit=3.0, timeout=2.0) for _ in range(2))
    # Of 3 / 6 m, from which it moves away by 25 mm in the step.
    near.set_command(seen(-0.45, 0.0))
    far.set_command(seen(-0.501, 0.0))
    for one in (near, far):
        one.advance(1)
    # Set at once, at rest; else pulled by k, and no closer than the decay of 0.01 s leads.
    assert (far.q[0], far.p[0]) == (-0.501, 0.0)
    assert near.q[0] > -0.45 * (1.0 - np.exp(-0.01 * DAMPING)) and near.p[0] > 4.0
    # The work is that of the change: all of what was kinetic.
    assert far.works['observer'] == pytest.approx(-5.0**2 / (2.0 * MASS))


@pytest.mark.parametrize('damping', [0.0, 6.0, 300.0])
def test_largest_gain_is_where_the_splitting_becomes_unstable(damping):
    h, most = 0.01, largest_gain(MASS, damping, 0.01)
    if damping == 0.0:
        assert most == pytest.approx(4.0 * MASS / h**2)
    for share, stable in ((0.999, True), (1.001, False)):
        simulation = observed(h, q=0.4 + 1e-9, p=0.0, gain=share * most, damping=damping)
        simulation.set_command(seen(0.4, 0.0))
        # A thousandth beyond it an eigenvalue is below -1 by more than 2e-3, of which 5000 steps
        # make 2e4; below it the ellipse of the motion is at most 1 / sqrt(0.001) as long as wide.
        away = np.abs(simulation.record(5000, 1)[0] - 0.4).max()
        assert away < 1e-7 if stable else away > 1e-5, (share, away)
