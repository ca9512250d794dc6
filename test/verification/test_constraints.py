# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Constraints: what RATTLE keeps in every step, and the motion that it gives."""

from collections.abc import Callable

from helpers import EPS, free, long, mostly_long, Uncompiled
from hnn_vi_ros.effects import EffectError, EFFECTS
from hnn_vi_ros.effects.gravity import Gravity
from hnn_vi_ros.effects.holonomic_constraint import HolonomicConstraint
from hnn_vi_ros.errors import SceneError, StepFailure
from hnn_vi_ros.hamiltonians import Formula, Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import Integrator, INTEGRATORS
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build, Simulation
from messages import refused
import numpy as np
from pydantic import ValidationError
import pytest
from scipy.integrate import solve_ivp
import yaml

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
    hamiltonian = hamiltonian or free('x', 'z')
    q = np.array([np.sin(angle), -np.cos(angle)])
    p = momentum * np.array([np.cos(angle), np.sin(angle)])
    return Simulation(hamiltonian, integrator, h, q, p, [Gravity('z'), from_pivot()])


def chain(hamiltonian: Hamiltonian, integrator: Integrator, h: float) -> Simulation:
    """Return two masses on two rods, with the weight of the outer one."""
    return Simulation(hamiltonian, integrator, h, [0.6, 0.8, 0.6, 1.8], [0.8, -0.6, 1.6, -0.6],
                      [Gravity('z2'), from_pivot(), between()])


def ends(values: np.ndarray, n: int = 2) -> np.ndarray:
    """Return, for each rod, the vector between its ends, or its rate: (N, rods, n)."""
    points = values.reshape(len(values), -1, n)
    return np.diff(points, axis=1, prepend=np.zeros((len(values), 1, n)))


def drift(error: np.ndarray) -> float:
    """Return the slope of the maxima of errors in 100 blocks, over the largest error."""
    blocks = error.reshape(100, -1).max(axis=1)
    return abs(np.polyfit(np.linspace(0.0, 1.0, 100), blocks, 1)[0]) / error.max()


@pytest.mark.parametrize('name, steps', [
    ('pendulum', 2000), ('chain', 2000),
    *(long(name, 100_000) for name in ('pendulum', 'chain', 'spherical pendulum'))])
def test_rattle_keeps_rods_and_velocities_in_every_step(name: str, steps: int, measured):
    integrator, h, whole = INTEGRATORS['stormer_verlet'](), 0.01, steps == 100_000
    names = {'pendulum': 'x z', 'chain': 'x z x2 z2', 'spherical pendulum': 'x y z'}[name].split()
    base = HAMILTONIANS['free_particle'](1.0, tuple(names)) if whole else free(*names)
    if name == 'chain':
        simulation = chain(base, integrator, h)
    elif name == 'pendulum':
        simulation = pendulum(base, integrator, h, 2.5, 0.0)
    else:
        simulation = Simulation(base, integrator, h, START, SIDEWAYS,
                                [Gravity('z'), HolonomicConstraint(**SPHERE)])
    start = simulation.energy
    q, p = simulation.record(steps, 1)
    # All masses are 1 kg: p is the velocity.
    along, rate = (ends(part, 3 if 'y' in names else 2) for part in (q, p))
    g = np.abs(np.linalg.norm(along, axis=-1) - 1.0).max()
    G_velocity = np.abs((along * rate).sum(axis=-1) / np.linalg.norm(along, axis=-1)).max()
    assert g <= 1e-10
    assert G_velocity <= 1e-9
    assert simulation.work == 0.0
    assert simulation.conservative
    # The last coordinate is the height of what has a weight.
    error = np.abs(0.5 * (p * p).sum(axis=1) + G * q[:, -1] - start)
    # Order 2: the band is O(h^2) of 10 J, and stays where it was.
    assert error.max() < (0.01 if name == 'spherical pendulum' else 0.5)
    if whole:
        slope = drift(error)
        found = [('abs(g) [m] over 1e5 steps', g, '<= 1e-10'),
                 ("abs(G q') [m/s] over 1e5 steps", G_velocity, '<= 1e-9'),
                 ('energy drift over 1e5 steps, share of its band', slope, '<= 0.1')]
        if name == 'spherical pendulum':
            momentum = q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]
            change = np.abs(momentum - START[0] * SIDEWAYS[1]).max()
            found.append(('angular momentum L_z over 1e5 steps [kg m^2/s]', change, '<= 1e-11'))
            # Rounding of eps a step, at worst all of one sign: 2e-11.
            assert change <= EPS * steps
        for claim, value, bound in found:
            measured(claim, f'RATTLE, stormer_verlet, {name}', value, bound)
        assert slope <= 0.1


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
    # The next term of a symmetric method is smaller by (h rate)^2, at most (0.02 * 5)^2.
    measured('order of convergence', f'RATTLE, {name}, pendulum', slope, '2 ± 0.05')
    assert slope == pytest.approx(2.0, abs=0.05)


def test_rattle_agrees_with_the_double_pendulum_in_its_angles():
    angles, duration = np.array([1.0, -0.5]), 1.0
    exact = Simulation(Uncompiled(HAMILTONIANS['double_pendulum']()), INTEGRATORS['gauss8'](),
                       0.01, angles, [0.0, 0.0])
    exact.advance(100)
    inner, outer = (np.array([np.sin(angle), -np.cos(angle)]) for angle in angles)
    errors = []
    for steps in (200, 400):
        simulation = Simulation(
            free('x', 'z', 'x2', 'z2'), INTEGRATORS['stormer_verlet'](), duration / steps,
            [*inner, *(inner + outer)], [0.0] * 4,
            [Gravity('z'), Gravity('z2'), from_pivot(), between()])
        simulation.advance(steps)
        (first, second), = ends(simulation.q[None])
        found = [np.arctan2(first[0], -first[1]), np.arctan2(second[0], -second[1])]
        errors.append(np.abs(found - exact.q).max())
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.35)


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


# General constraints, and Hamiltonians that do not separate.

class Turning(Uncompiled):
    """
    A particle of 1 kg in a frame that turns about z, whose mass may depend on x.

    Parameters
    ----------
    rate : float
        Omega [rad/s].
    softness : float
        a [1/m^2].

    """

    def __init__(self, rate: float = 0.0, softness: float = 0.0):
        self.rate, self.softness = rate, softness
        super().__init__(Formula(
            ['x', 'y', 'z'],
            '(1 + a*x^2) * (p_x^2 + p_y^2 + p_z^2)/2 - Omega*(x*p_y - y*p_x) + G*z',
            {'a': softness, 'Omega': rate, 'G': G}))

    def momentum(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return p of a velocity."""
        return (v + self.rate * np.array([-q[1], q[0], 0.0])) / (1.0 + self.softness * q[0] ** 2)


def ellipsoid() -> Callable:
    """Return a constraint of ours to x^2 + 2 y^2 + z^2 = 1, as a factory in a scene does."""
    def g(q: np.ndarray, gradient: np.ndarray) -> float:
        gradient[0], gradient[1], gradient[2] = 2.0 * q[0], 4.0 * q[1], 2.0 * q[2]
        return q[0] * q[0] + 2.0 * q[1] * q[1] + q[2] * q[2] - 1.0
    return g


SPHERE = {'form': 'sphere', 'point': ['x', 'y', 'z'], 'anchor': [0.0, 0.0, 0.0], 'radius': 1.0}
ELLIPSOID = {'form': 'python', 'factory': 'test_constraints:ellipsoid'}
# The matrix A of each, with g' along A q, and a point that moves on it.
SHAPES = {'sphere': (SPHERE, np.eye(3)), 'ellipsoid': (ELLIPSOID, np.diag([1.0, 2.0, 1.0]))}
START, SIDEWAYS = np.array([0.6, 0.0, -0.8]), np.array([0.4, 1.5, 0.3])


def on_surface(hamiltonian: Turning, shape: str, method: str, h: float, *effects: object
               ) -> Simulation:
    """Return a particle that moves on a sphere or an ellipsoid."""
    return Simulation(hamiltonian, INTEGRATORS[method](), h, START,
                      hamiltonian.momentum(START, SIDEWAYS),
                      [HolonomicConstraint(**SHAPES[shape][0]), *effects])


def exact_end(hamiltonian: Turning, shape: str, duration: float, damping: float = 0.0,
              field: float = 0.0) -> np.ndarray:
    """Return (q, p) by DOP853 on the equations of motion with the multiplier solved for."""
    A, d = SHAPES[shape][1], 3
    B = 0.5 * field * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])

    def slope(t: float, z: np.ndarray) -> np.ndarray:
        # In (q, P), P = p - c A(q) the momentum of the velocity; the field is a force.
        q, p = z[:d], z[d:]
        force, v = hamiltonian.gradient(q, p)
        push = -force - damping * p + 2.0 * B.T @ v
        zero, products = np.zeros(d), np.zeros((2, d))
        kernel = hamiltonian.kernel

        def rate_of_velocity(of_p: np.ndarray) -> np.ndarray:
            kernel.hessian_vector(kernel.parameters, q, p, v, of_p, *products)
            return products[1].copy()

        kernel.hessian_vector(kernel.parameters, q, p, zero, A @ q, *products)
        mobility = products[1].copy()
        # 0 = d/dt (A q . v) = v . A v + A q . (H_pq v + H_pp (push - lambda A q)).
        multiplier = (v @ A @ v + (A @ q) @ rate_of_velocity(push)) / ((A @ q) @ mobility)
        return np.concatenate([v, push - multiplier * (A @ q)])

    start = np.concatenate([START, hamiltonian.momentum(START, SIDEWAYS)])
    end = solve_ivp(slope, (0.0, duration), start, 'DOP853', rtol=1e-12, atol=1e-12).y[:, -1]
    end[d:] += B @ end[:d]
    return end


CASES = {
    'sphere': (Turning(), 'sphere'),
    'sphere in a turning frame': (Turning(3.0), 'sphere'),
    'sphere, mass that depends on q': (Turning(softness=0.5), 'sphere'),
    'ellipsoid in a turning frame, mass that depends on q': (Turning(2.0, 0.5), 'ellipsoid'),
}


def order_of(make: Callable[[float], Simulation], exact: np.ndarray, duration: float) -> float:
    """Return the slope of the error in (q, p) over three step sizes."""
    steps, errors = np.array([20, 30, 40]), []
    for n in steps:
        simulation = make(duration / n)
        simulation.advance(int(n))
        assert simulation.rescued == 0
        errors.append(np.abs(np.concatenate([simulation.q, simulation.p]) - exact).max())
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize('method', ['generalized_leapfrog', 'implicit_midpoint'])
@pytest.mark.parametrize('case', mostly_long(CASES, 'ellipsoid in a turning frame, mass that '
                                             'depends on q'))
def test_spherical_pendulum_converges_with_order_2_for_every_hamiltonian(
        case: str, method: str, measured):
    hamiltonian, shape = CASES[case]
    slope = order_of(lambda h: on_surface(hamiltonian, shape, method, h),
                     exact_end(hamiltonian, shape, 1.0), 1.0)
    # The next term is smaller by (h rate)^2, with h = 0.05 s and a frame that turns at 3 rad/s.
    measured('order of convergence', f'RATTLE, {method}, {case}', slope, '2 ± 0.1')
    assert slope == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize('method', ['generalized_leapfrog', long('implicit_midpoint')])
@pytest.mark.parametrize('kind, arguments, other', [
    ('damping', {'rate': 0.7}, {'damping': 0.7}),
    ('magnetic_field', {'plane': ['x', 'y'], 'field': 3.0}, {'field': 3.0})])
def test_constraint_keeps_order_2_with_another_effect(
        kind: str, arguments: dict, other: dict, method: str):
    # Without a mass of its own: P is the velocity. p is P + c A(q).
    hamiltonian, effect = Turning(), EFFECTS[kind](**arguments)
    B = 0.5 * other.get('field', 0.0) * np.array([-START[1], START[0], 0.0])

    def make(h: float) -> Simulation:
        return Simulation(hamiltonian, INTEGRATORS[method](), h, START, SIDEWAYS + B,
                          [effect, HolonomicConstraint(**SPHERE)])

    assert order_of(make, exact_end(hamiltonian, 'sphere', 1.0, **other), 1.0) == pytest.approx(
        2.0, abs=0.35)


@pytest.mark.parametrize('case', mostly_long(CASES, 'sphere in a turning frame'))
def test_constraint_and_its_velocity_are_kept_in_every_step_and_energy_does_not_drift(case: str):
    hamiltonian, shape = CASES[case]
    simulation, A = on_surface(hamiltonian, shape, 'generalized_leapfrog', 0.05), SHAPES[shape][1]
    start, steps = simulation.energy, 400
    q, p = simulation.record(steps, 1)
    velocity = np.array([hamiltonian.gradient(*z)[1] for z in zip(q, p, strict=True)])
    assert np.abs(((q @ A) * q).sum(axis=1) - 1.0).max() <= 1e-10
    assert np.abs(((q @ A) * velocity).sum(axis=1)).max() <= 1e-9
    error = np.abs(hamiltonian.energy(q, p) - start).reshape(10, -1).max(axis=1)
    # A band of order 2: the last tenth is no wider than half again the widest before it.
    assert error[-1] <= 1.5 * error[:5].max()
    if hamiltonian.softness == 0.0:
        # What commutes with H and the sphere is kept: solved to 64 eps in each step.
        momentum = q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]
        assert np.abs(momentum - momentum[0]).max() <= 64 * EPS * steps


@pytest.mark.parametrize('turning, method', [
    *((False, method) for method in METHODS), *((True, method) for method in METHODS[1:])])
def test_rattle_is_symmetric_also_in_a_turning_frame_whose_mass_depends_on_q(
        turning: bool, method: str):
    """Forward, back with the velocities and the turn of the frame turned around: the start."""
    there, back = (
        on_surface(Turning(rate, 0.5), 'ellipsoid', method, 0.05) if turning else
        chain(free('x', 'z', 'x2', 'z2'), INTEGRATORS[method](), 0.02) for rate in (2.0, -2.0))
    q0, p0 = there.q.copy(), there.p.copy()
    there.advance(50)
    back.restart(there.q, -there.p)
    back.advance(50)
    # Solved to 64 eps a step, and stretched less than 100 times by the flow.
    assert np.abs(back.q - q0).max() < 100 * 50 * 64 * EPS
    assert np.abs(back.p + p0).max() < 100 * 50 * 64 * EPS


@pytest.mark.parametrize('method', ['generalized_leapfrog', 'implicit_midpoint'])
def test_rattle_is_symplectic_in_a_turning_frame_whose_mass_depends_on_q(method: str):
    """In longitude and height of the sphere and their momenta a step keeps dq ^ dp."""
    hamiltonian = Turning(2.0, 0.5)
    simulation = on_surface(hamiltonian, 'sphere', method, 0.1)

    def lift(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (turn, z), of = x[:2], x[2:]
        r = np.sqrt(1.0 - z * z)
        along = np.array([[-r * np.sin(turn), r * np.cos(turn), 0.0],
                          [-z / r * np.cos(turn), -z / r * np.sin(turn), 1.0]])
        q = np.array([r * np.cos(turn), r * np.sin(turn), z])
        p = np.linalg.pinv(along) @ of
        # p is known across the sphere's normal; along it, what G H_p = 0 says.
        _, v = hamiltonian.gradient(q, p)
        return q, p - (q @ v) / (1.0 + hamiltonian.softness * q[0] ** 2) * q

    def step(x: np.ndarray) -> np.ndarray:
        simulation.restart(*lift(x))
        simulation.advance(1)
        q, p = simulation.q, simulation.p
        r = np.hypot(q[0], q[1])
        return np.array([np.arctan2(q[1], q[0]), q[2], q[0] * p[1] - q[1] * p[0],
                         p[2] - q[2] / r ** 2 * (q[0] * p[0] + q[1] * p[1])])

    x, d = np.array([0.3, -0.5, 0.8, -0.4]), 1e-4
    M = np.column_stack([(step(x + d * unit) - step(x - d * unit)) / (2 * d)
                         for unit in np.eye(4)])
    J = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    # Central differences: truncation 1e-8 of the third derivative, some 10.
    assert np.abs(M.T @ J @ M - J).max() < 1e-6


def test_newton_of_rattle_gains_two_digits_a_trial_where_h_does_not_separate():
    """By H_qp: with H_pp alone the digits gained go to zero as h Omega to one."""
    trials = []

    class Counting(INTEGRATORS['implicit_midpoint']):
        """The midpoint rule, whose steps are counted."""

        @staticmethod
        def step(*arguments: object) -> tuple[int, float, int]:
            trials.append(1)
            return INTEGRATORS['implicit_midpoint'].step(*arguments)

    hamiltonian = Turning(5.0)
    simulation = Simulation(hamiltonian, Counting(), 0.1, START,
                            hamiltonian.momentum(START, SIDEWAYS), [HolonomicConstraint(**SPHERE)])
    simulation.advance(20)
    assert simulation.rescued == 0
    # 16 digits at 2.5 of each, and one more trial that shows no further change.
    assert len(trials) <= 20 * 8


def test_constraint_takes_the_solution_that_goes_to_zero_with_h():
    """At h Omega = 2 another solution is nearer, by which the energy fell by 7 J in 2 s."""
    whole, half = (on_surface(Turning(10.0), 'sphere', 'generalized_leapfrog', h)
                   for h in (0.2, 0.1))
    whole.advance(10)
    half.advance(20)
    # Steps that have no such solution are taken in two parts, which have.
    assert whole.rescued == 10
    # Solved to 64 eps a step, and stretched less than 1000 times by the flow.
    assert whole.q == pytest.approx(half.q, abs=1000 * 20 * 64 * EPS)


def test_damping_of_a_momentum_that_is_not_that_of_the_velocity_is_warned_of():
    with pytest.warns(UserWarning, match='not proportional to the velocity'):
        on_surface(Turning(3.0), 'sphere', 'generalized_leapfrog', 0.1, EFFECTS['damping'](0.5))


def at_rest(hamiltonian: Hamiltonian, q: list[float], effects: list[object],
            p: list[float] | None = None) -> Simulation:
    """Return a simulation by stormer_verlet."""
    return Simulation(hamiltonian, INTEGRATORS['stormer_verlet'](), 0.01, q,
                      p or [0.0] * len(q), effects)


def test_point_on_a_plane_slides_down_with_the_exact_acceleration():
    normal = np.array([3.0, 0.0, 4.0])
    simulation = at_rest(free('x', 'y', 'z'), [0.4, 0.0, 0.7], [
        Gravity('z'), HolonomicConstraint(form='plane', point=['x', 'y', 'z'],
                                          anchor=[0.4, 0.0, 0.7], normal=normal.tolist())],
        p=[0.0, 0.3, 0.0])
    simulation.advance(50)
    slope = -G * np.array([0.0, 0.0, 1.0]) + G * 0.8 * normal / 5.0
    # Verlet is exact under a constant force; 50 steps of rounding.
    assert simulation.q == pytest.approx(
        [0.4, 0.15, 0.7] + 0.125 * slope, abs=50 * 64 * EPS)


def test_circle_in_space_is_a_sphere_cut_by_a_plane_and_one_in_a_plane_is_a_rod():
    normal, center = [0.0, 1.0, 0.0], [0.0, 0.3, 0.0]
    space = at_rest(free('x', 'y', 'z'), [0.6, 0.3, 0.8], [Gravity('z'), HolonomicConstraint(
        form='circle', point=['x', 'y', 'z'], anchor=center, radius=1.0, normal=normal)])
    plane = at_rest(free('x', 'z'), [0.6, 0.8], [Gravity('z'), HolonomicConstraint(
        form='circle', point=['x', 'z'], anchor=[0.0, 0.0], radius=1.0)])
    rod = at_rest(free('x', 'z'), [0.6, 0.8], [Gravity('z'), from_pivot()])
    for simulation in (space, plane, rod):
        simulation.advance(50)
    # Solved to 64 eps a step, and stretched less than 100 times by the flow.
    assert space.q == pytest.approx([rod.q[0], 0.3, rod.q[1]], abs=100 * 50 * 64 * EPS)
    assert np.array_equal(plane.q, rod.q)


# Constraints that depend on each other.

SQUARE = [0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0]
CORNERS = [['x1', 'z1'], ['x2', 'z2'], ['x3', 'z3'], ['x4', 'z4']]


def braced(sides: list[tuple[int, int]]) -> list[HolonomicConstraint]:
    """Return rods between corners of a square."""
    return [HolonomicConstraint(CORNERS[a], other=CORNERS[b], length=float(np.linalg.norm(
        np.subtract(SQUARE[2 * a:2 * a + 2], SQUARE[2 * b:2 * b + 2])))) for a, b in sides]


@pytest.mark.parametrize('effects, q, index', [
    ([from_pivot(), Gravity('z'), from_pivot()], [0.6, 0.8], 2),
    ([HolonomicConstraint(form='plane', point=['x', 'z'], anchor=[0.0, 0.0], normal=[1.0, 2.0]),
      HolonomicConstraint(form='plane', point=['z', 'x'], anchor=[0.0, 0.0], normal=[6.0, 3.0])],
     [0.0, 0.0], 1),
    (braced([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]), SQUARE, 5),
    # A chain of two rods, stretched between two pivots: it can move neither way.
    ([from_pivot(), HolonomicConstraint(['x', 'z'], anchor=[2.0, 0.0])], [1.0, 0.0], 1)],
    ids=['identical rods', 'planes', 'braced square', 'stretched chain'])
def test_redundant_constraint_is_named_at_load_with_those_that_it_depends_on(effects, q, index):
    names = [name for point in CORNERS for name in point] if len(q) == 8 else ['x', 'z']
    with refused(EffectError) as raised:
        at_rest(free(*names), q, effects)
    assert raised.value.index == index


def test_square_with_one_brace_less_is_no_redundant_one():
    effects = braced([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)])
    simulation = at_rest(free(*[name for point in CORNERS for name in point]), SQUARE, effects,
                         [0.0, 0.0, 0.0, 1.0, -1.0, 1.0, -1.0, 0.0])
    simulation.advance(100)
    # It turns about its centre as a whole; the distance without a rod is kept by the others.
    corners = simulation.q.reshape(4, 2)
    assert np.linalg.norm(corners[1] - corners[3]) == pytest.approx(np.sqrt(2.0), abs=1e-12)


def narrowing() -> Callable:
    """Return z + s(x) y with s = x^3 where x > 0, else 0: where x <= 0 it is z once more."""
    def g(q: np.ndarray, gradient: np.ndarray) -> float:
        x = max(q[0], 0.0)
        gradient[0], gradient[1], gradient[2] = 3.0 * x * x * q[1], x * x * x, 1.0
        return q[2] + x * x * x * q[1]
    return g


def test_constraint_that_becomes_redundant_is_named_in_the_step_where_it_does():
    simulation = at_rest(free('x', 'y', 'z'), [0.205, 0.0, 0.0], [
        HolonomicConstraint(form='plane', point=['z'], anchor=[0.0], normal=[1.0]),
        HolonomicConstraint(form='python', factory='test_constraints:narrowing')],
        p=[-1.0, 0.0, 0.0])
    with pytest.raises(StepFailure, match='holonomic_constraint_1: it depends on earlier '
                                          'constraints.*; remove it'):
        simulation.advance(100)
    # Where x^3 at the two ends of a step is lost beside 1: at x = 0.01, to half a step.
    assert simulation.q[0] == pytest.approx(0.01, abs=0.0051)


# What is refused.

@pytest.mark.parametrize('arguments', [
    {'form': 'sphere', 'point': ['x', 'y', 'z'], 'anchor': [0.0] * 3},
    {'form': 'sphere', 'point': ['x', 'y', 'z'], 'anchor': [0.0] * 3, 'length': 1.0},
    {'point': ['x', 'z'], 'anchor': [0.0] * 2, 'radius': 1.0},
    {'form': 'plane', 'point': ['x'], 'anchor': [0.0], 'normal': [0.0]},
    {'form': 'circle', 'point': ['x'], 'anchor': [0.0], 'radius': -1.0}, {'form': 'python'},
    {'form': 'python', 'factory': 'no_such:one'},
    {'form': 'python', 'factory': 'test_constraints:G'},
    {'form': 'python', 'factory': 'builtins:dict'}], ids=str)
def test_constraint_of_bad_arguments_is_refused(arguments):
    with refused(ValueError):
        HolonomicConstraint(**arguments)


@pytest.mark.parametrize('arguments', [
    {'form': 'circle', 'point': ['x', 'y', 'z'], 'anchor': [0.0] * 3, 'radius': 1.0},
    {'form': 'sphere', 'point': ['x', 'z'], 'anchor': [0.0] * 2, 'radius': 1.0},
    {'form': 'plane', 'point': ['x', 'z'], 'anchor': [0.0] * 2, 'normal': [1.0]}], ids=str)
def test_constraint_that_does_not_fit_the_coordinates_is_refused(arguments):
    with refused(EffectError):
        at_rest(free('x', 'y', 'z'), [1.0, 0.0, 0.0], [HolonomicConstraint(**arguments)])


def wrong_gradient() -> Callable:
    """Return a sphere with half of its gradient."""
    def g(q: np.ndarray, gradient: np.ndarray) -> float:
        gradient[:] = q
        return q @ q - 1.0
    return g


def test_constraint_whose_gradient_is_not_its_own_is_refused():
    effect = HolonomicConstraint(form='python', factory='test_constraints:wrong_gradient')
    with refused(EffectError):
        at_rest(free('x', 'z'), [0.6, 0.8], [effect])


@pytest.mark.parametrize('arguments, q, p', [
    (ELLIPSOID, [0.6, 0.0, -0.9], [0.0, 1.0, 0.0]), (ELLIPSOID, [0.6, 0.0, -0.8], [1.0, 0.0, 0.0]),
    ({'point': ['x', 'z'], 'anchor': [0.0, 0.0], 'length': 1.0}, [0.3, 0.0, 0.4], [0.0] * 3)],
    ids=range(3))
def test_state_that_rods_or_a_surface_of_ones_own_do_not_fit_is_refused(arguments, q, p):
    with refused(ValueError):
        at_rest(free('x', 'y', 'z'), q, [HolonomicConstraint(**arguments)], p)


SCENE = """\
hamiltonian: {kind: free_particle, names: [x, y, z]}
effects:
  - {kind: gravity, coordinate: z}
  - {kind: holonomic_constraint, form: python, factory: 'wire_for_a_scene:NAME'}
integrator: {kind: stormer_verlet}
step_size: 0.01
initial_state: {q: [0.6, 0.0, -0.8], p: [0.0, 1.5, 0.0]}
"""
MODULE = """\
def sphere():
    def g(q, gradient):
        for i in range(3):
            gradient[i] = 2.0 * q[i]
        return q[0] ** 2 + q[1] ** 2 + q[2] ** 2 - 1.0
    return g


def not_for_numba():
    def g(q, gradient):
        gradient[:] = [2.0 * float(str(x)) for x in q]
        return sum(x * x for x in q.tolist()) - 1.0
    return g
"""


@pytest.mark.long
def test_constraint_of_a_function_beside_its_scene_runs_compiled_as_the_named_one(tmp_path):
    (tmp_path / 'wire_for_a_scene.py').write_text(MODULE)
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE.replace('NAME', 'sphere'))
    simulation = build(load_scene(path))
    named = at_rest(free('x', 'y', 'z'), [0.6, 0.0, -0.8],
                    [Gravity('z'), HolonomicConstraint(**SPHERE)], [0.0, 1.5, 0.0])
    for each in (simulation, named):
        each.advance(50)
    assert simulation.q == pytest.approx(named.q, abs=100 * 50 * 64 * EPS)
    path.write_text(SCENE.replace('NAME', 'not_for_numba'))
    with pytest.raises(SceneError, match=r'scene.yaml:4: effects.1: .*numba cannot'):
        build(load_scene(path))


def test_constraint_of_a_function_is_refused_in_what_is_not_trusted():
    with pytest.raises(ValidationError, match="'wire_for_a_scene:sphere' is code"):
        Scene.model_validate(yaml.safe_load(SCENE.replace('NAME', 'sphere')))


def test_redundant_constraint_of_a_scene_is_told_with_its_line(tmp_path):
    path = tmp_path / 'scene.yaml'
    sphere = ('{kind: holonomic_constraint, form: sphere, point: [x, y, z], '
              'anchor: [0.0, 0.0, 0.0], radius: 1.0}')
    lines = SCENE.splitlines()
    path.write_text('\n'.join([*lines[:3], f'  - {sphere}', f'  - {sphere}', *lines[4:]]))
    with refused(SceneError):
        build(load_scene(path))
