# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers that end at a state at rest: energy shaping, the regulator, and hovering."""

from helpers import long
from hnn_vi_ros import load_scene
from hnn_vi_ros.control import Balance, BatchStep, EnergyShaping, find_equilibrium, Hover, velocity
from hnn_vi_ros.control.balance import weights_of
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build
import numpy as np
import pytest

LIMIT, PERIOD = 4.0, 0.01


def scene(mass: float = 1.0, *effects: dict) -> Scene:
    return Scene.build(
        hamiltonian={'kind': 'pendulum', 'mass': mass}, integrator='stormer_verlet',
        initial_state=([0.0], [0.0]), step_size=0.002,
        effects=[{'kind': 'external_force', 'coordinates': ['angle']}, *effects])


def balance(model: Scene) -> Balance:
    steps = BatchStep(model, 5)
    return Balance(steps, find_equilibrium(steps, [3.0]), [LIMIT], 10.0, 1.0)


def test_weights_of_velocities_are_those_of_momenta_over_the_inertia():
    steps = BatchStep(scene(mass=2.0))
    found = weights_of(steps, find_equilibrium(steps, [3.0]), 3.0, 5.0)
    assert found == pytest.approx(np.diag([3.0, 5.0 / 2.0**2]), abs=1e-12)


@pytest.mark.parametrize('effects', [(), long(({'kind': 'damping', 'rate': 0.05},))])
def test_energy_shaping_swings_a_pendulum_up_from_rest_and_balances_it(effects):
    law = balance(scene(1.0, *effects))
    controller, z, modes = EnergyShaping(law), np.zeros(2), []
    for k in range(1200):
        u = controller(z[:1], velocity(law.steps, z[:1], z[1:]), k * PERIOD)
        assert np.abs(u) <= LIMIT
        z = law.steps(z, u)
        modes.append(controller.mode)
    assert modes[0] == 'energy' and modes[-500:] == ['lqr'] * 500
    assert abs(np.cos(z[0]) + 1.0) < 1e-9 and abs(z[1]) < 1e-4


def test_energy_shaping_never_lets_the_distance_of_the_energy_grow():
    law = balance(scene())
    controller, z, away = EnergyShaping(law, gain=0.5), np.array([0.3, 0.0]), []
    model = law.steps.hamiltonian
    top = model.energy(*np.split(law.at[0], 2))
    while True:
        u = controller(z[:1], velocity(law.steps, z[:1], z[1:]))
        if controller.mode == 'lqr':
            break
        away.append(abs(model.energy(z[:1], z[1:]) - top))
        z = law.steps(z, u)
    # A command that is held does up to u |a| h^2 / 2 where the velocity turns, with |a| < 14.
    assert len(away) > 50 and np.diff(away).max() < LIMIT * 14.0 * PERIOD**2 / 2.0


def test_regulator_catches_where_its_law_leads_home_and_nowhere_else():
    law = balance(scene())
    assert law.catches(np.array([-np.pi + 0.1, 0.0])) and not law.catches(np.array([0.0, 0.0]))
    # The motor carries the bob at rest up to sin(x) = 4 / 9.81.
    assert not law.catches(np.array([np.pi - 0.6, 0.0]))
    assert law.catches(np.array([np.pi - 0.6, 2.0]))


@pytest.mark.parametrize('late', [long(0), 3])
def test_hover_brings_the_quadrotor_to_a_place_also_by_commands_that_come_late(late: int):
    run, place = build(load_scene('quadrotor')), np.array([8.0, -5.0, 14.0])
    body = run.hamiltonian
    controller, told, heights = Hover(body.mass, body.weight, body.inertia, place), [], []
    for _ in range(800):
        run.advance(10)
        told.append(controller(run.q, body.gradient(run.q, run.p)[1]))
        run.set_command(told[max(0, len(told) - 1 - late)])
        heights.append(run.q[2])
    # Of the slowest mode there is exp(-0.8 t) left, of the way exp(-5).
    assert abs(run.q[:3] - place).max() < 0.02 and abs(run.p[:3]).max() < 0.02
    assert min(heights) > 9.5 and max(heights) < 14.5
