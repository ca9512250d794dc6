# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rods: what RATTLE keeps in every step, and the motion that it gives."""

from helpers import Uncompiled
from hnn_vi_ros.effects.gravity import Gravity
from hnn_vi_ros.effects.holonomic_constraint import HolonomicConstraint
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest

pytestmark = pytest.mark.filterwarnings('ignore:Uncompiled is not a tanh network')

METHODS = ['stormer_verlet', 'generalized_leapfrog', 'implicit_midpoint']
G = 9.81


def from_pivot(length: float = 1.0) -> HolonomicConstraint:
    """Return a rod from the origin to (x, z)."""
    return HolonomicConstraint(['x', 'z'], anchor=[0.0, 0.0], length=length)


def between() -> HolonomicConstraint:
    """Return a rod between the two masses of a chain."""
    return HolonomicConstraint(['x2', 'z2'], other=['x', 'z'])


def pendulum(hamiltonian: Hamiltonian | None, integrator: Integrator, h: float, angle: float,
             momentum: float) -> Simulation:
    """Return the pendulum of the same name, in Cartesian coordinates."""
    hamiltonian = hamiltonian or Uncompiled(HAMILTONIANS['free_particle'](1.0, ('x', 'z')))
    q = np.array([np.sin(angle), -np.cos(angle)])
    p = momentum * np.array([np.cos(angle), np.sin(angle)])
    return Simulation(hamiltonian, integrator, h, q, p, [Gravity('z'), from_pivot()])


def chain(hamiltonian: Hamiltonian, integrator: Integrator, h: float) -> Simulation:
    """Return two masses on two rods, with the weight of the outer one."""
    return Simulation(hamiltonian, integrator, h, [0.6, 0.8, 0.6, 1.8], [0.8, -0.6, 1.6, -0.6],
                      [Gravity('z2'), from_pivot(), between()])


def ends(values: np.ndarray) -> np.ndarray:
    """Return, for each rod, the vector between its ends, or its rate: (N, rods, 2)."""
    points = values.reshape(len(values), -1, 2)
    return np.diff(points, axis=1, prepend=np.zeros((len(values), 1, 2)))


@pytest.mark.parametrize('name', ['pendulum', 'chain'])
def test_rattle_keeps_rods_and_velocities_in_every_one_of_1e5_steps(name: str, measured):
    integrator, h, steps = INTEGRATORS['stormer_verlet'](), 0.01, 100_000
    if name == 'pendulum':
        base = HAMILTONIANS['free_particle'](1.0, ('x', 'z'))
        simulation, weight = pendulum(base, integrator, h, 2.5, 0.0), 1
    else:
        base = HAMILTONIANS['free_particle'](1.0, ('x', 'z', 'x2', 'z2'))
        simulation, weight = chain(base, integrator, h), 3
    start = simulation.energy
    q, p = simulation.record(steps, 1)
    # All masses are 1 kg: p is the velocity.
    along, rate = ends(q), ends(p)
    g = np.abs(np.linalg.norm(along, axis=-1) - 1.0).max()
    G_velocity = np.abs((along * rate).sum(axis=-1) / np.linalg.norm(along, axis=-1)).max()
    measured('abs(g) [m] over 1e5 steps', f'RATTLE, stormer_verlet, {name}', g, '<= 1e-10')
    measured("abs(G q') [m/s] over 1e5 steps", f'RATTLE, stormer_verlet, {name}', G_velocity,
             '<= 1e-9')
    assert g <= 1e-10
    assert G_velocity <= 1e-9
    assert simulation.work == 0.0
    assert simulation.conservative
    error = np.abs(0.5 * (p * p).sum(axis=1) + G * q[:, weight] - start)
    blocks = error.reshape(100, -1).max(axis=1)
    slope = abs(np.polyfit(np.linspace(0.0, 1.0, 100), blocks, 1)[0])
    measured('energy drift over 1e5 steps, share of its band',
             f'RATTLE, stormer_verlet, {name}', slope / error.max(), '<= 0.1')
    # Order 2: the band is O(h^2) of 10 J, and stays where it was.
    assert error.max() < 0.5
    assert slope <= 0.1 * error.max()


@pytest.mark.parametrize('name', METHODS)
def test_rattle_agrees_with_the_pendulum_in_its_angle_with_order_2(name: str, measured):
    angle, momentum, duration = 0.7, -1.2, 1.0
    exact = Simulation(Uncompiled(HAMILTONIANS['pendulum']()), INTEGRATORS['gauss8'](),
                       duration / 100, [angle], [momentum])
    exact.advance(100)
    steps, errors = np.array([50, 75, 100]), []
    for n in steps:
        simulation = pendulum(None, INTEGRATORS[name](), duration / n, angle, momentum)
        simulation.advance(int(n))
        errors.append(abs(np.arctan2(simulation.q[0], -simulation.q[1]) - exact.q[0]))
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    measured('order of convergence', f'RATTLE, {name}, pendulum', slope, '2 ± 0.35')
    assert slope == pytest.approx(2.0, abs=0.35)


def test_rattle_agrees_with_the_double_pendulum_in_its_angles():
    angles, duration = np.array([1.0, -0.5]), 1.0
    exact = Simulation(Uncompiled(HAMILTONIANS['double_pendulum']()), INTEGRATORS['gauss8'](),
                       0.01, angles, [0.0, 0.0])
    exact.advance(100)
    inner, outer = (np.array([np.sin(angle), -np.cos(angle)]) for angle in angles)
    errors = []
    for steps in (200, 400):
        simulation = Simulation(
            Uncompiled(HAMILTONIANS['free_particle'](1.0, ('x', 'z', 'x2', 'z2'))),
            INTEGRATORS['stormer_verlet'](), duration / steps, [*inner, *(inner + outer)],
            [0.0] * 4, [Gravity('z'), Gravity('z2'), from_pivot(), between()])
        simulation.advance(steps)
        (first, second), = ends(simulation.q[None])
        found = [np.arctan2(first[0], -first[1]), np.arctan2(second[0], -second[1])]
        errors.append(np.abs(found - exact.q).max())
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.35)


@pytest.mark.parametrize('name', METHODS)
def test_rattle_is_symmetric(name: str):
    """Forward, back with the velocities turned around: the start is met again."""
    base = Uncompiled(HAMILTONIANS['free_particle'](1.0, ('x', 'z', 'x2', 'z2')))
    there = chain(base, INTEGRATORS[name](), 0.02)
    q0, p0 = there.q.copy(), there.p.copy()
    there.advance(50)
    back = chain(base, INTEGRATORS[name](), 0.02)
    back.restart(there.q, -there.p)
    back.advance(50)
    # Solved to 64 eps a step, and stretched less than 100 times by the flow.
    assert np.abs(back.q - q0).max() < 100 * 50 * 64 * 2.3e-16
    assert np.abs(back.p + p0).max() < 100 * 50 * 64 * 2.3e-16


@pytest.mark.parametrize('name', METHODS)
def test_rattle_is_symplectic_on_the_constraint_manifold(name: str, measured):
    """In the pendulum's angle and its momentum a step preserves the area."""
    simulation = pendulum(None, INTEGRATORS[name](), 0.1, 0.7, -1.2)

    def step(angle: float, momentum: float) -> np.ndarray:
        other = pendulum(None, INTEGRATORS[name](), 0.1, angle, momentum)
        simulation.restart(other.q, other.p)
        simulation.advance(1)
        (x, z), (p_x, p_z) = simulation.q, simulation.p
        return np.array([np.arctan2(x, -z), x * p_z - z * p_x])

    # Central differences: truncation 1e-8 of the third derivative, rounding 1e-16 / 1e-4.
    d = 1e-4
    columns = [(step(0.7 + d, -1.2) - step(0.7 - d, -1.2)) / (2 * d),
               (step(0.7, -1.2 + d) - step(0.7, -1.2 - d)) / (2 * d)]
    defect = abs(np.linalg.det(np.array(columns)) - 1.0)
    measured('symplectic defect on the constraint manifold', f'RATTLE, {name}', defect, '< 1e-7')
    assert defect < 1e-7


def test_rods_that_the_initial_state_does_not_fit_are_refused_with_the_difference():
    with pytest.raises(ValueError, match=r'distance of 1\.0 m, but .* 0\.5 m, 0\.5 m off'):
        Simulation(Uncompiled(HAMILTONIANS['free_particle'](1.0, ('x', 'z'))),
                   INTEGRATORS['stormer_verlet'](), 0.01, [0.3, 0.4], [0.0, 0.0],
                   [from_pivot()])
