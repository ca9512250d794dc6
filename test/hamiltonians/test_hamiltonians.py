# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Analytic Hamiltonians: their gradients, their formulas derived anew, and exact facts."""

from collections.abc import Callable

from helpers import dop853_path, EPS
from hnn_vi_ros.files import shipped_names
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.hamiltonians.double_pendulum import DoublePendulum
from hnn_vi_ros.hamiltonians.fput_chain import FputChain
from hnn_vi_ros.hamiltonians.henon_heiles import HenonHeiles
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
from hnn_vi_ros.scene import load_scene
from messages import refused
import numpy as np
import pytest

UNEVEN = {
    'double_pendulum': {'mass1': 0.7, 'mass2': 1.9, 'length1': 1.3, 'length2': 0.6,
                        'gravity': 3.7},
    'fput_chain': {'pairs': 4, 'omega': 20.0},
    'free_particle': {'mass': 0.7, 'names': ['x', 'y', 'z']},
    'harmonic_oscillator': {'mass': 0.7, 'stiffness': 2.3},
    'henon_heiles': {},
    'kepler': {'mu': 2.5},
    'pendulum': {'mass': 0.7, 'length': 1.3, 'gravity': 3.7},
    'tao': {},
}
STATES = 20
# Those that turn have other columns in p than in q: test_rigid_bodies.py.
FLAT = [name for name in HAMILTONIANS if not HAMILTONIANS[name]().rotations]


def uneven(name: str) -> Hamiltonian:
    """Build the Hamiltonian with parameters of which no two are the same, so none can hide."""
    return HAMILTONIANS[name](**UNEVEN[name])


def states(hamiltonian: Hamiltonian) -> tuple[np.ndarray, np.ndarray]:
    """Return random q and p, each of shape (STATES, d), of order one."""
    return np.random.default_rng(7).normal(size=(2, STATES, hamiltonian.dimension))


def slope(function: Callable, z: np.ndarray) -> np.ndarray:
    """
    Return the derivative of an analytic function of z along each component of z.

    It is Im f(z + i s) / s: without a difference there is no cancellation, and s = 1e-40 leaves
    no truncation error either.
    """
    shifts = 1e-40j * np.eye(z.size)
    return np.array([np.imag(function(z + shift)) / 1e-40 for shift in shifts])


def gradient_at(hamiltonian: Hamiltonian, z: np.ndarray) -> np.ndarray:
    """Evaluate the uncompiled gradient (H_q, H_p) in the arithmetic of z, of shape (2 d,)."""
    kernel, d, gradient = hamiltonian.kernel, z.size // 2, np.zeros_like(z)
    kernel.gradient.py_func(kernel.parameters, z[:d], z[d:], gradient[:d], gradient[d:])
    return gradient


@pytest.mark.parametrize('name', FLAT)
def test_hamiltonian_gradient_is_the_derivative_of_its_energy(name: str):
    hamiltonian = uneven(name)
    kernel, d = hamiltonian.kernel, hamiltonian.dimension
    q, p = states(hamiltonian)
    computed = np.hstack(hamiltonian.gradient(q, p))
    for row, z in zip(computed, np.hstack([q, p]), strict=True):
        exact = slope(lambda z: kernel.energy.py_func(kernel.parameters, z[:d], z[d:]), z)
        np.testing.assert_allclose(row, exact, rtol=1e-12, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize('name', FLAT)
def test_hamiltonian_hessian_vector_is_the_derivative_of_its_gradient(name: str):
    hamiltonian = uneven(name)
    q, p = states(hamiltonian)
    v_q, v_p = np.random.default_rng(8).normal(size=(2, *q.shape))
    computed = np.hstack(hamiltonian.hessian_vector(q, p, v_q, v_p))
    for row, z, v in zip(computed, np.hstack([q, p]), np.hstack([v_q, v_p]), strict=True):
        exact = np.imag(gradient_at(hamiltonian, z + 1e-40j * v)) / 1e-40
        np.testing.assert_allclose(row, exact, rtol=1e-12, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize('name', FLAT)
def test_hamiltonian_is_separable_where_it_says_so(name: str):
    """H = T(p) + V(q) exactly where every mixed derivative H_qp is zero."""
    hamiltonian = uneven(name)
    d = hamiltonian.dimension
    largest = 0.0
    for z in np.hstack(states(hamiltonian)):
        mixed = slope(lambda z: gradient_at(hamiltonian, z), z)[d:, :d]
        largest = max(largest, np.abs(mixed).max())
    assert (largest == 0.0) == hamiltonian.separable


@pytest.mark.parametrize('name, parameter', [
    (name, parameter) for name, parameters in UNEVEN.items() for parameter in parameters
    if parameter != 'names'])
@pytest.mark.parametrize('value', [0.0, -1.0, float('nan'), float('inf')])
def test_hamiltonian_refuses_parameter_out_of_range_in_one_line(
        name: str, parameter: str, value: float):
    with refused(ValueError):
        HAMILTONIANS[name](**{**UNEVEN[name], parameter: value})


@pytest.mark.parametrize('name, arguments', [
    *(('free_particle', {'names': names})
      for names in ([], ['x', 'x'], [''], ['1x'], ['a b'], ['a\n'])),
    ('fput_chain', {'pairs': 2.5})])
def test_hamiltonian_refuses_names_and_numbers_of_coordinates_that_cannot_be_used(name, arguments):
    with refused(ValueError):
        HAMILTONIANS[name](**arguments)


def test_hamiltonian_names_each_coordinate_once():
    for name in FLAT:
        names = [coordinate.name for coordinate in uneven(name).coordinates]
        assert len({*names}) == len(names) == uneven(name).dimension, name


@pytest.mark.parametrize('name', [
    name for name in shipped_names('scene') if name != 'air_track'])  # its model is not shipped
def test_shipped_scene_starts_inside_its_model_and_moves(name: str):
    scene = load_scene(name)
    hamiltonian = scene.create_hamiltonian()
    q, p = np.array(scene.initial_state.q), np.array(scene.initial_state.p)
    assert np.isfinite(hamiltonian.energy(q, p))
    # Where H alone leaves the state at rest, an effect moves it.
    assert scene.effects or np.abs(np.concatenate(hamiltonian.gradient(q, p))).max() > 0.0
    for values, bounds in zip((q, p), hamiltonian.box or (), strict=False):
        assert (bounds[:, 0] < values).all() and (values < bounds[:, 1]).all()


def test_free_particle_has_kinetic_energy_alone_and_moves_straight_on():
    hamiltonian = uneven('free_particle')
    q, p = states(hamiltonian)
    # A few roundings of sums of three positive terms.
    np.testing.assert_allclose(
        hamiltonian.energy(q, p), np.sum(p**2, axis=1) / (2.0 * 0.7), rtol=4.0 * EPS)
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    np.testing.assert_array_equal(dH_dq, 0.0)
    np.testing.assert_array_equal(dH_dp, p / 0.7)


def test_pendulum_energy_is_its_kinetic_and_potential_energy():
    hamiltonian = uneven('pendulum')
    m, l, g = hamiltonian.mass, hamiltonian.length, hamiltonian.gravity  # noqa: E741
    q, p = states(hamiltonian)
    expected = p**2 / (2.0 * m * l**2) + m * g * l * (1.0 - np.cos(q))
    # A few roundings of terms of order ten.
    np.testing.assert_allclose(hamiltonian.energy(q, p), expected[:, 0], rtol=1e-14, atol=1e-14)


def test_pendulum_has_the_frequency_of_small_swings_and_the_separatrix_it_states():
    hamiltonian = uneven('pendulum')
    m, l, g = hamiltonian.mass, hamiltonian.length, hamiltonian.gravity  # noqa: E741
    hessian = slope(lambda z: gradient_at(hamiltonian, z), np.zeros(2))
    assert np.sqrt(np.linalg.det(hessian)) == pytest.approx(np.sqrt(g / l), rel=1e-14)
    top = hamiltonian.energy(np.array([np.pi]), np.zeros(1))
    fastest = hamiltonian.energy(np.zeros(1), np.array([2.0 * m * l * np.sqrt(g * l)]))
    assert top == pytest.approx(2.0 * m * g * l, rel=1e-14)
    assert fastest == pytest.approx(top, rel=1e-14) and hamiltonian.barrier[1] == top


def lagrangian_parts(hamiltonian: DoublePendulum, x: np.ndarray
                     ) -> tuple[np.ndarray, np.ndarray]:
    """Return T and V of angles and rates x = (q1, q2, v1, v2), bob by bob in the plane."""
    q, v = x[:2], x[2:]
    lengths = np.array([hamiltonian.length1, hamiltonian.length2])
    # The bobs at the end of one rod and of two: sums of what each rod adds.
    right = np.cumsum(lengths * np.cos(q) * v)
    up = np.cumsum(lengths * np.sin(q) * v)
    height = np.cumsum(lengths * (1.0 - np.cos(q)))
    masses = np.array([hamiltonian.mass1, hamiltonian.mass2])
    return 0.5 * masses @ (right**2 + up**2), hamiltonian.gravity * masses @ height


def test_double_pendulum_is_the_legendre_transform_of_its_lagrangian():
    """With p = L_v: H = T + V, H_p = v and H_q = -L_q, from the motion of the bobs alone."""
    hamiltonian = uneven('double_pendulum')
    for x in np.hstack(states(hamiltonian)):
        kinetic, potential = lagrangian_parts(hamiltonian, x)
        of_lagrangian = slope(
            lambda x: np.subtract(*lagrangian_parts(hamiltonian, x)), x)
        q, v, p = x[:2], x[2:], of_lagrangian[2:]
        dH_dq, dH_dp = hamiltonian.gradient(q, p)
        # M has a condition number below 1e3, and each result a dozen roundings.
        assert hamiltonian.energy(q, p) == pytest.approx(kinetic + potential, rel=1e-12)
        np.testing.assert_allclose(dH_dp, v, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(dH_dq, -of_lagrangian[:2], rtol=1e-12, atol=1e-12)


def test_double_pendulum_of_equal_halves_has_the_known_normal_modes():
    length, gravity = 1.3, 3.7
    hamiltonian = DoublePendulum(2.0, 2.0, length, length, gravity)
    hessian = slope(lambda z: gradient_at(hamiltonian, z), np.zeros(4))
    # q'' = -H_pp H_qq q: the squares of the frequencies are (2 -+ sqrt(2)) g / l.
    squares = np.sort(np.linalg.eigvals(hessian[2:, 2:] @ hessian[:2, :2]))
    expected = gravity / length * (2.0 + np.sqrt(2.0) * np.array([-1.0, 1.0]))
    np.testing.assert_allclose(squares, expected, rtol=1e-13)


def test_double_pendulum_with_a_tiny_lower_bob_is_a_pendulum():
    tiny = 1e-9
    double, single = DoublePendulum(1.1, tiny, 1.3, 0.6, 3.7), Pendulum(1.1, 1.3, 3.7)
    q, p = states(double)
    p[:, 1] *= tiny  # so that the lower bob moves at a rate of order one
    dH_dq, dH_dp = double.gradient(q, p)
    dH_dq1, dH_dp1 = single.gradient(q[:, :1], p[:, :1])
    # What the lower bob does to the upper is its mass times accelerations of order ten.
    np.testing.assert_allclose(dH_dp[:, :1], dH_dp1, atol=100.0 * tiny)
    np.testing.assert_allclose(dH_dq[:, :1], dH_dq1, atol=100.0 * tiny)


def test_kepler_circular_orbit_falls_as_fast_as_it_turns():
    mu, radius = 2.5, 0.8
    hamiltonian = Kepler(mu)
    angles = np.linspace(0.0, 6.0, 9)
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    ahead = np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    q, p = radius * direction, np.sqrt(mu / radius) * ahead
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    # |p|^2 / r towards the centre keeps it on the circle.
    np.testing.assert_allclose(dH_dq, mu / radius**2 * direction, rtol=1e-13, atol=1e-14)
    np.testing.assert_array_equal(dH_dp, p)
    np.testing.assert_allclose(hamiltonian.energy(q, p), -mu / (2.0 * radius), rtol=1e-14)


def test_kepler_starts_an_ellipse_from_its_pericentre_as_it_states():
    mu, a, e = 2.5, 1.2, 0.6
    hamiltonian = Kepler(mu)
    q, p = np.array([a * (1 - e), 0.0]), np.array([0.0, np.sqrt(mu * (1 + e) / (a * (1 - e)))])
    assert hamiltonian.energy(q, p) == pytest.approx(-mu / (2.0 * a), rel=1e-14)


def test_kepler_centre_gives_infinity_or_nan_and_no_exception():
    q, p = np.zeros(2), np.ones(2)
    assert Kepler().energy(q, p) == -np.inf
    assert not np.isfinite(Kepler().gradient(q, p)[0]).any()


def test_henon_heiles_escapes_over_three_saddle_points_at_one_sixth():
    hamiltonian = HenonHeiles()
    corners = np.array([[0.0, 1.0], [np.sqrt(0.75), -0.5], [-np.sqrt(0.75), -0.5]])
    rest = np.zeros((3, 2))
    np.testing.assert_allclose(
        hamiltonian.energy(corners, rest), hamiltonian.barrier[1], rtol=1e-14)
    assert hamiltonian.barrier[1] == 1.0 / 6.0
    # Terms of order one cancel.
    np.testing.assert_allclose(hamiltonian.gradient(corners, rest)[0], 0.0, atol=8.0 * EPS)
    for corner in corners:
        hessian = slope(lambda z: gradient_at(hamiltonian, z), np.concatenate([corner, rest[0]]))
        low, high = np.linalg.eigvalsh(hessian[:2, :2])
        assert low < 0.0 < high


def test_henon_heiles_has_the_symmetry_of_a_triangle():
    hamiltonian = HenonHeiles()
    q, p = states(hamiltonian)
    cosine, sine = -0.5, np.sqrt(0.75)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    # Cancelling terms of up to about ten.
    np.testing.assert_allclose(
        hamiltonian.energy(q @ turn.T, p @ turn.T), hamiltonian.energy(q, p), atol=100.0 * EPS)


@pytest.mark.parametrize('pairs', [1, 2, 5])
def test_fput_chain_is_the_chain_of_masses_and_springs(pairs: int):
    """Compare with displacements u: H = |u'|^2 / 2 + omega^2 stiff^2 / 4 + soft^4, summed."""
    omega = 20.0
    hamiltonian = FputChain(pairs, omega)
    u, v = np.random.default_rng(1).normal(size=(2, STATES, 2 * pairs))
    q, p = (np.hstack([x[:, 1::2] + x[:, ::2], x[:, 1::2] - x[:, ::2]]) / np.sqrt(2.0)
            for x in (u, v))
    extensions = np.diff(np.pad(u, ((0, 0), (1, 1))), axis=1)
    soft, stiff = extensions[:, ::2], extensions[:, 1::2]
    expected = np.sum(v**2, axis=1) / 2.0 + omega**2 / 4.0 * np.sum(stiff**2, axis=1) \
        + np.sum(soft**4, axis=1)
    np.testing.assert_allclose(hamiltonian.energy(q, p), expected, rtol=1e-13)


def test_fput_chain_exchanges_its_stiff_energies_and_keeps_their_sum():
    scene = load_scene('fput_chain')
    hamiltonian = scene.create_hamiltonian()
    m, omega = hamiltonian.pairs, hamiltonian.omega
    z = dop853_path(hamiltonian, scene.initial_state.q, scene.initial_state.p,
                    np.linspace(0.0, 100.0, 2001), 1e-6).T
    stiff = 0.5 * (z[3 * m:]**2 + (omega * z[m:2 * m])**2)
    total = stiff.sum(axis=0)
    assert np.abs(total - total[0]).max() < 4.0 / omega
    assert stiff[0, -1] < 0.2 * stiff[0, 0] and stiff[2].max() > 0.4 * total[0]


def test_fput_chain_has_two_coordinates_a_pair():
    assert [c.name for c in FputChain(pairs=2).coordinates] == [
        'centre1', 'centre2', 'stretch1', 'stretch2']
