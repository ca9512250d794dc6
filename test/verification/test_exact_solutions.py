# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects against the exact solutions that mechanics has for them, and what damping takes."""

from collections.abc import Callable

from helpers import EPS, free, Uncompiled
from hnn_vi_ros.effects import Effect, EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest

G = 9.81


def oscillator() -> Uncompiled:
    """Return a mass of 1 kg on a spring of 1 N/m."""
    return Uncompiled(HAMILTONIANS['harmonic_oscillator']())


def effect(kind: str, *arguments: object, **more: object) -> Effect:
    """Build an effect."""
    return EFFECTS[kind](*arguments, **more)


def path(simulation: Simulation, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, shape (steps,), and q and p, shape (steps, d), after each step."""
    q, p = simulation.record(steps, 1)
    return simulation.step_size * np.arange(1, steps + 1), q, p


def largest_error(make: Callable[[float], Simulation], duration: float, steps: int,
                  exact: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the largest abs(q_0 - exact(t)) along a run."""
    t, q, _ = path(make(duration / steps), steps)
    return np.abs(q[:, 0] - exact(t)).max()


def damped(t: np.ndarray) -> np.ndarray:
    """Solve x'' = -x - x' / 2 from x = 1 at rest."""
    omega = np.sqrt(1.0 - 0.0625)
    return np.exp(-0.25 * t) * (np.cos(omega * t) + 0.25 / omega * np.sin(omega * t))


def driven(t: np.ndarray) -> np.ndarray:
    """Solve x'' = -x + 2 cos(w t + 0.4) from x = 1 at rest, w = 2 pi 0.3, off resonance."""
    omega = 2.0 * np.pi * 0.3
    size = 2.0 / (1.0 - omega * omega)
    start, speed = 1.0 - size * np.cos(0.4), size * omega * np.sin(0.4)
    return size * np.cos(omega * t + 0.4) + start * np.cos(t) + speed * np.sin(t)


@pytest.mark.parametrize('kind, arguments, exact', [
    ('damping', (0.5,), damped), ('periodic_drive', ('x', 2.0, 0.3, 0.4), driven)])
@pytest.mark.parametrize('name', ['stormer_verlet', 'generalized_leapfrog', 'implicit_midpoint',
                                  'gauss8'])
def test_oscillator_with_an_effect_follows_its_exact_solution(kind, arguments, exact, name,
                                                              measured):
    def make(h: float) -> Simulation:
        return Simulation(oscillator(), INTEGRATORS[name](), h, [1.0], [0.0],
                          [effect(kind, *arguments)])

    if name == 'gauss8':
        # h^8 over some constant of 1e-6, for h = 0.1.
        error = largest_error(make, 10.0, 100, exact)
        measured('error against an exact solution', f'{name}, {kind}', error, '< 1e-12')
        assert error < 1e-12
        return
    errors = [largest_error(make, 10.0, steps, exact) for steps in (100, 200)]
    # Order 2, from a first error that is that of h = 0.1.
    assert errors[0] < 0.1
    order = np.log2(errors[0] / errors[1])
    # The next term of the error is a h^2 of the first, with h = 0.1 and a of the order of 1.
    measured('order against an exact solution', f'{name}, {kind}', order, '2 ± 0.05')
    assert order == pytest.approx(2.0, abs=0.05)


# The noise of a thermostat without heat is of the size of 1e-20, the momenta are above 1e-5.
@pytest.mark.parametrize('friction', [('damping', [0.3, 2.0]), ('thermostat', 1e-40, [0.3, 2.0])],
                         ids=lambda friction: friction[0])
def test_friction_of_a_free_particle_is_exact_to_round_off(friction: tuple):
    simulation = Simulation(free('x', 'y'), INTEGRATORS['stormer_verlet'](), 0.1,
                            [0.0, 0.0], [1.0, 1.0], [effect(*friction)])
    t, _, p = path(simulation, 50)
    # Two factors a step, each rounded.
    exact = np.exp(-np.outer(t, [0.3, 2.0]))
    assert np.abs(p / exact - 1.0).max() <= 2 * 50 * 2 * EPS


def test_magnetic_field_turns_a_particle_on_its_circle_to_round_off_with_gauss8(measured):
    """Solve q' = v, v' = w J v with w = c B / m = 3: a circle of radius |v| / w."""
    simulation = Simulation(free('x', 'y'), INTEGRATORS['gauss8'](), np.pi / 90,
                            [1.0, 0.0], [0.0, -1.5], [effect('magnetic_field', ['x', 'y'], 2.0,
                                                             1.5)])
    # p = (0, -1.5) is m v + c A with A = B (-y, x) / 2: v = (0, -3).
    assert simulation.dH_dp == pytest.approx([0.0, -3.0], abs=4 * EPS)
    t, q, _ = path(simulation, 180)
    error = np.abs(q - np.column_stack([np.cos(3.0 * t), -np.sin(3.0 * t)])).max()
    measured('error against an exact solution', 'gauss8, cyclotron motion', error, '< 1e-12')
    # (w h)^8 over 1e8 or so, and the rounding of 180 steps.
    assert error < 1e-12


def test_magnetic_field_with_implicit_midpoint_keeps_the_circle_and_its_known_frequency(measured):
    """Each step turns the velocity by 2 atan(w h / 2), and q stays on the circle."""
    h, omega, steps = 0.3, 1.0, 200
    simulation = Simulation(free('x', 'y'), INTEGRATORS['implicit_midpoint'](), h,
                            [1.0, 0.0], [0.0, -0.5], [effect('magnetic_field', ['x', 'y'])])
    _, q, _ = path(simulation, steps)
    radius = np.hypot(*q.T)
    measured('error of the radius', 'implicit_midpoint, cyclotron motion',
             np.abs(radius - 1.0).max(), '< 8 eps x 200')
    assert np.abs(radius - 1.0).max() <= 8 * EPS * steps
    angle = 2.0 * np.arctan(0.5 * omega * h) * np.arange(1, steps + 1)
    assert np.abs(q - np.column_stack([np.cos(angle), -np.sin(angle)])).max() <= \
        steps * 8 * EPS * steps


def test_gravity_throws_a_parabola():
    simulation = Simulation(free('x', 'z'), INTEGRATORS['stormer_verlet'](), 0.01,
                            [0.0, 1.0], [2.0, 3.0], [effect('gravity', 'z')])
    t, q, _ = path(simulation, 200)
    # Stormer-Verlet is exact for a constant force; z falls to some -12.
    assert np.abs(q - np.column_stack([2.0 * t, 1.0 + 3.0 * t - 0.5 * G * t * t])).max() < 1e-12


def test_spring_between_two_particles_swings_with_their_reduced_mass():
    """Two masses of 1 kg: the distance swings with the frequency sqrt(2 k / m) about l."""
    simulation = Simulation(
        free('x', 'y'), INTEGRATORS['gauss8'](), 0.1, [1.5, 0.0], [0.3, 0.3],
        [effect('spring', ['x'], other=['y'], stiffness=0.5, rest_length=1.0)])
    t, q, _ = path(simulation, 100)
    assert np.abs(q[:, 0] - q[:, 1] - (1.0 + 0.5 * np.cos(t))).max() < 1e-12
    # Their centre moves on.
    assert np.abs(q.mean(axis=1) - (0.75 + 0.3 * t)).max() < 1e-12


def test_spring_with_a_length_at_rest_swings_and_circles_in_the_plane():
    along = np.array([0.6, 0.8])
    anchor, stiffness, rest = np.array([0.5, -0.2]), 2.0, 1.0

    def run(r: float, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        simulation = Simulation(
            free('x', 'y'), INTEGRATORS['gauss8'](), 0.05, anchor + r * along, speed,
            [effect('spring', ['x', 'y'], anchor=anchor.tolist(), stiffness=stiffness,
                    rest_length=rest)])
        t, q, _ = path(simulation, 200)
        return t, q - anchor

    t, q = run(1.3, np.zeros(2))
    exact = np.outer(rest + 0.3 * np.cos(np.sqrt(stiffness) * t), along)
    assert np.abs(q - exact).max() < 1e-12
    # A circle of radius r has w^2 = (k / m) (r - l) / r.
    omega = np.sqrt(stiffness * 0.5 / 1.5)
    t, q = run(1.5, 1.5 * omega * np.array([-0.8, 0.6]))
    angle = np.arctan2(0.8, 0.6) + omega * t
    exact = 1.5 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert np.abs(q - exact).max() < 1e-12


def test_quadratic_drag_slows_a_particle_as_one_over_time():
    """Solve m v' = -b v^2: v = v0 / (1 + b v0 t / m), x = (m / b) log(1 + b v0 t / m)."""
    b, mass, speed = 0.8, 2.0, np.array([3.0, 4.0])
    simulation = Simulation(
        Uncompiled(HAMILTONIANS['free_particle'](mass, ('x', 'y'))), INTEGRATORS['gauss8'](),
        0.02, [0.0, 0.0], mass * speed, [effect('quadratic_drag', ['x', 'y'], b)])
    t, q, p = path(simulation, 100)
    rate = b * 5.0 / mass
    slowing = 1.0 + rate * t
    # The nearest singularity is 0.5 s before the start: (h / 0.5)^8 / 1e4 a step.
    assert np.abs(p - mass * speed / slowing[:, None]).max() < 1e-12
    assert np.abs(q - np.outer(np.log(slowing) / rate, speed)).max() < 1e-12


def test_dry_friction_follows_the_integral_of_its_smooth_law():
    """Solve m v' = -F tanh(v / u): sinh(v / u) = sinh(v0 / u) exp(-F t / (m u))."""
    force, u, v0, mass = 1.0, 0.2, 0.6, 2.0
    simulation = Simulation(Uncompiled(HAMILTONIANS['free_particle'](mass)),
                            INTEGRATORS['gauss8'](), 0.02, [0.0], [mass * v0],
                            [effect('dry_friction', 'x', force, u)])
    t, _, p = path(simulation, 150)
    exact = u * np.arcsinh(np.sinh(v0 / u) * np.exp(-force * t / (mass * u)))
    # The law bends over u, which takes some 20 steps: (1 / 20)^8 and less.
    assert np.abs(p[:, 0] / mass - exact).max() < 1e-11


def test_dry_friction_lets_a_body_at_rest_creep_under_a_load():
    """F tanh(v / u) balances the load: v = u atanh(load / F)."""
    simulation = Simulation(
        free('x'), INTEGRATORS['gauss4'](), 0.05, [0.0], [0.0],
        [effect('dry_friction', 'x', 2.0, 0.5), effect('gravity', 'x', 1.0, -1.0)])
    simulation.advance(300)
    # The approach is exp(-(1 - 1/4) F t / (m u)), with t = 15 s.
    assert simulation.p[0] == pytest.approx(0.5 * np.arctanh(0.5), rel=1e-12)


# One that takes the flow of damping around its steps, and one that takes the force at its nodes.
AROUND_AND_AT_NODES = ['generalized_leapfrog', 'gauss8']


def in_field(method: str, h: float, q: list[float], velocity: list[float],
             rate: float | list[float]) -> Simulation:
    """Return a particle of 1 kg in a field of 1 T, with friction."""
    # c A(q) = B (-y, x) / 2.
    p = [velocity[0] - 0.5 * q[1], velocity[1] + 0.5 * q[0]]
    effects = [effect('damping', rate), effect('magnetic_field', ['x', 'y'])]
    return Simulation(free('x', 'y'), INTEGRATORS[method](), h, q, p, effects)


@pytest.mark.parametrize('method', AROUND_AND_AT_NODES)
def test_damping_leaves_what_rests_in_a_magnetic_field_at_rest(method: str):
    simulation = in_field(method, 0.05, [1.0, -0.7], [0.0, 0.0], [0.5, 0.2])
    simulation.advance(200)
    # A step rounds p and the vector potential, by some eps each.
    assert np.abs(simulation.dH_dp).max() <= 200 * 4 * EPS
    assert simulation.q == pytest.approx([1.0, -0.7], abs=200 * 4 * EPS)


@pytest.mark.parametrize('method, error', [('generalized_leapfrog', 1e-4), ('gauss8', 1e-12)])
def test_damping_in_a_magnetic_field_slows_the_spiral_exponentially(method: str, error: float):
    """Solve v' = -gamma v + B J v: the speed falls as exp(-gamma t) and turns with B."""
    h, steps, rate = 0.01, 500, 0.4
    simulation = in_field(method, h, [1.0, 0.0], [0.0, -1.0], rate)
    t, q, p = path(simulation, steps)
    velocity = simulation.hamiltonian.gradient(q, p)[1]
    expected = np.exp(-rate * t)[:, None] * np.column_stack([-np.sin(t), -np.cos(t)])
    # Of order 2: h^2 over the five radians; of order 8 round-off.
    assert np.abs(velocity - expected).max() <= error


@pytest.mark.parametrize('method', AROUND_AND_AT_NODES)
def test_damping_in_a_magnetic_field_never_adds_energy(method: str):
    simulation = in_field(method, 0.05, [1.0, 0.3], [0.4, -1.0], [0.3, 0.9])
    q, p = simulation.record(400, 1)
    energy = simulation.hamiltonian.energy(q, p)
    # Rounding of H, which is a difference of squares of 1.
    assert (np.diff(energy) <= 8 * EPS).all()
    assert energy[-1] < 1e-3 * energy[0]


def test_damping_with_rates_that_feed_energy_into_coupled_masses_is_refused():
    """The double pendulum from angles at which its masses are not coupled."""
    def damped(rate: list[float]) -> Simulation:
        return Simulation(Uncompiled(HAMILTONIANS['double_pendulum']()),
                          INTEGRATORS['generalized_leapfrog'](), 0.01, [0.5 * np.pi, 0.0],
                          [0.0, 0.0], [effect('damping', rate)])
    with pytest.raises(ValueError, match=r'rates \[0.0, 5.0\] .* add energy .* at q = .*one'):
        damped([0.0, 5.0])
    assert damped([0.5, 0.5]).time == 0.0
