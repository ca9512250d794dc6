# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""States between steps: a fine reference of the pendulum, and close encounters of comets."""

from functools import cache

from helpers import EPS, free, kepler_orbit, KINDS, long, Method, METHODS, mostly_long, Uncompiled
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import Integrator, INTEGRATORS
from hnn_vi_ros.integrators.composition import Yoshida4
from hnn_vi_ros.integrators.time_transformed import CONTROLS, TimeTransformed
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import simulate, simulate_many, Simulation
from hnn_vi_ros.simulation.dense_step import record_at
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_lie_methods import euler_poisson, P, Q, simulation as top

THETAS = np.array([0.1, 0.25, 0.4, 0.6, 0.85])
TO_THE_END = np.append(THETAS, 1.0)


# At none of all at once is a derivative of the path small.
STARTS = [(1.5, 2.0), (0.4, -1.0), (2.5, 0.7), (-1.0, 4.0)]


def pendulum(method: str, h: float, *effects, start: tuple[float, float] = STARTS[0]
             ) -> Simulation:
    """Return a pendulum that swings widely."""
    return Simulation(Uncompiled(HAMILTONIANS['pendulum']()), INTEGRATORS[method](), h,
                      start[:1], start[1:], effects)


@cache
def exact(t: float, start: tuple[float, float] = STARTS[0]) -> tuple[float, float]:
    """Return (q, p) at a time: two steps of order 16 and at most 0.1 s err by less than 1e-15."""
    simulation = pendulum('gauss16', t / 2.0, start=start)
    simulation.advance(2)
    return float(simulation.q[0]), float(simulation.p[0])


def worst(method: str, h: float) -> float:
    """Return the largest deviation of the polynomial in steps of h."""
    steps = [(start, pendulum(method, h, start=start).dense_step()) for start in STARTS]
    return max(np.abs(np.ravel(dense.polynomial(theta)) - exact(theta * h, start)).max()
               for start, dense in steps for theta in THETAS)


# Of the polynomial: of cubic Hermite 3, of quintic 5, of s stages s, of a method p: the local
# error of each is of one order more, and that of the step's end as well.
@pytest.mark.parametrize('method, order, largest', [
    ('stormer_verlet', 2, 0.1), ('rk4', 4, 0.1), long('gauss6', 5, 0.05), ('gauss10', 5, 0.05),
    long('gauss14', 7, 0.1), long('gauss16', 8, 0.1)])
def test_polynomial_converges_with_its_order_or_that_of_the_method(method, order, largest):
    h = largest * np.array([1.0, 0.7, 0.5])
    errors = [worst(method, step) for step in h]
    # The plateau, a few roundings of 2 rad, is left out.
    above = np.array(errors) > 1e-14
    assert above.sum() >= 2
    slope = np.polyfit(np.log(h[above]), np.log(np.array(errors)[above]), 1)[0]
    assert slope >= order + 1 - 0.35


@pytest.mark.parametrize('method', ['gauss10', long('gauss14')])
def test_collocation_polynomial_meets_the_conditions_at_its_nodes(method):
    """Its slope there is that of Hamilton's equations, and its end that of the step."""
    simulation = pendulum(method, 0.2)
    dense = simulation.dense_step()
    polynomial, stages = dense.polynomial, simulation.integrator.stages
    assert polynomial.order == stages
    nodes = 0.5 * (np.polynomial.legendre.leggauss(stages)[0] + 1.0)
    q, p = polynomial(nodes)
    H_q, H_p = simulation.hamiltonian.gradient(q, p)
    # The derivative of the interpolant through the nodes and the start, of the same degree.
    fitted = np.polynomial.Polynomial.fit(np.append(nodes, 0.0), np.vstack(
        [np.hstack([q, p]), np.hstack(polynomial(0.0))])[:, 0], stages).deriv()(nodes) / 0.2
    # Differentiation multiplies rounding by the degree squared over h.
    assert np.abs(fitted - H_p[:, 0]).max() < 1e-15 * 10 * stages ** 2 / 0.2
    assert H_q.shape == (stages, 1)
    end = np.ravel(polynomial(1.0))
    assert np.abs(end - [simulation.q[0], simulation.p[0]]).max() < 1e-14


@pytest.mark.parametrize('method', ['stormer_verlet', 'generalized_leapfrog', 'gauss16'])
def test_states_between_steps_are_as_accurate_as_the_method(method):
    """No worse than twice the local error of a whole step, and no worse than rounding."""
    h = 0.1
    simulation = pendulum(method, h)
    dense = simulation.dense_step()
    local = np.abs(np.ravel([simulation.q, simulation.p]) - exact(h)).max()
    for theta in THETAS:
        error = np.abs(np.ravel(dense.state(theta)) - exact(theta * h)).max()
        assert error < 2.0 * local + 1e-14
    assert np.array_equal(np.ravel(dense.state(1.0)), np.ravel([simulation.q, simulation.p]))
    assert np.ravel(dense.state(0.0)).tolist() == [1.5, 2.0]


def orbit_errors(method: Integrator, e: float, h: float, start: float, times: np.ndarray
                 ) -> np.ndarray:
    """Return the errors of a Kepler orbit, in units of the state at its pericentre, (k,)."""
    q0, p0 = kepler_orbit(np.array([start]), e)
    simulation = Simulation(Uncompiled(HAMILTONIANS['kepler'](1.0)), method, h, q0[0], p0[0])
    (q, p), (exact_q, exact_p) = record_at(simulation, times), kepler_orbit(start + times, e)
    return np.maximum(np.abs(q - exact_q).max(axis=1) / (1.0 - e),
                      np.abs(p - exact_p).max(axis=1) * np.sqrt(1.0 - e))


@pytest.mark.parametrize('e', [long(0.6), 0.99])
@pytest.mark.parametrize('method', mostly_long(METHODS, *KINDS, 'gauss8', 'taylor'))
def test_states_between_steps_of_an_encounter_are_as_accurate_as_those_at_their_ends(
        method: Method, e: float):
    """Kepler's equation around the pericentre, off the grid and on it."""
    integrator = method.integrator
    if method.name == 'discrete_euler_lagrange':
        integrator = INTEGRATORS[method.name]('helpers:kepler_lagrangian', 2)
    # The pericentre's angular velocity times h; where errors of high orders are above round-off.
    n, h = 10, (0.05 if integrator.order <= 2 else 0.3) * (1.0 - e) ** 1.5
    ends = h * np.arange(2 * n + 1)
    inside = (ends[:-1, None] + h * THETAS).ravel()
    times = np.sort(np.concatenate([ends, inside]))
    errors = orbit_errors(integrator, e, h, -n * h, times)
    on = np.isin(times, ends)
    # Twice for the local error of a part of a step; the angle of the start is known to an ulp of
    # the time, which near the pericentre is 1 / (1 - e) as large in the state.
    assert errors[~on].max() < 2.0 * errors[on].max() + 16.0 * EPS / (1.0 - e)


@pytest.mark.parametrize('e', [long(0.6), 0.99])
@pytest.mark.parametrize('control, base', [
    ((control, base) if (control, base) == ('hamiltonian', 'gauss4') or base == 'stormer_verlet'
     else long(control, base)) for control, bases in CONTROLS.items() for base in bases])
def test_states_within_steps_of_the_clock_converge_with_the_order_of_the_base(control, base, e):
    """A whole pericentre passage lies within a step of the clock."""
    times = np.linspace(0.0, 4.0 * np.pi, 41)
    # Half of the samples near the pericentres, at even steps of the eccentric anomaly.
    times = np.sort(np.concatenate([times, times - e * np.sin(times - np.pi)]))
    coarse, fine = (orbit_errors(TimeTransformed(base, control=control), e, h, -np.pi, times).max()
                    for h in (0.375, 0.1875))
    assert np.log2(coarse / fine) >= TimeTransformed(base, control=control).order - 0.35


def test_looking_between_steps_changes_no_later_step():
    effects = [EFFECTS['thermostat'](0.5, 1.0), EFFECTS['impact']('angle', 0.0, restitution=0.9)]
    seen, plain = (pendulum('stormer_verlet', 0.05, *effects) for _ in range(2))
    for _ in range(20):
        seen.dense_step().state(0.3)
    plain.advance(20)
    assert np.array_equal([seen.q, seen.p], [plain.q, plain.p])
    assert (seen.works, seen.gradients, seen.time) == (plain.works, plain.gradients, plain.time)


def test_states_between_steps_keep_rods_and_walls():
    rod = EFFECTS['holonomic_constraint'](['x', 'z'], anchor=[0.0, 0.0], length=1.0)
    simulation = Simulation(
        free('x', 'z'), INTEGRATORS['stormer_verlet'](), 0.1, [1.0, 0.0], [0.0, -1.0], [rod])
    q, _ = simulation.dense_step().state(0.37)
    # RATTLE's own tolerance.
    assert np.hypot(*q) == pytest.approx(1.0, abs=1e-10)
    wall = Simulation(free('x'), INTEGRATORS['stormer_verlet'](), 1.0, [0.3], [-1.0],
                      [EFFECTS['impact']('x')])
    dense = wall.dense_step()
    # It turns at 0.3 s.
    assert [float(dense.state(theta)[0][0]) for theta in (0.1, 0.3, 0.8)] == pytest.approx(
        [0.2, 0.0, 0.5], abs=1e-15)


def test_duration_and_times_that_are_no_multiple_of_the_step_are_met():
    scene = load_scene('exact_pendulum').with_overrides(0.05, 'gauss8')
    run = simulate(scene, 0.33, every=2)
    assert run.t.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.33])
    times = [0.0, 0.01, 0.02, 0.1, 0.33]
    listed = simulate(scene, 0.4, times=times)
    assert listed.t.tolist() == times
    assert np.array_equal(listed.q[-1], run.q[-1])
    assert np.array_equal(listed.q[3], run.q[1])
    fine = simulate(scene, 0.33, step_size=0.01, every=1)
    # gauss8 errs by (0.05 s / 0.3 s)^9 / 1e4 a step.
    assert np.abs(listed.q - fine.q[[0, 1, 2, 10, 33]]).max() < 1e-10
    many = simulate_many(scene, [run.q[0]] * 2, [run.p[0]] * 2, 0.33, samples=3)
    assert many.t[-1] == 0.33
    assert np.abs(many.q[1:, 1] - fine.q[[11, 22, 33]]).max() < 1e-10


@pytest.mark.parametrize('times', [[], [[0.1]], [0.2, 0.1], [-0.1], [1.1], [np.nan]])
def test_times_that_cannot_be_sampled_are_refused(times):
    with refused(ValueError):
        simulate('exact_pendulum', 1.0, times=times)


# Bodies that turn.

def top_at(t: np.ndarray) -> np.ndarray:
    """Return (q, p) of the top at rising times, shape (k, 7)."""
    return solve_ivp(euler_poisson, (0.0, t[-1]), [*Q, *P], 'DOP853', t_eval=t, rtol=1e-13,
                     atol=1e-13).y.T


ON_A_GROUP = {**{name: create for name, create in INTEGRATORS.items()
                 if name.startswith('lie_')}, 'yoshida4': lambda: Yoshida4('lie_leapfrog')}


@pytest.mark.parametrize('name', mostly_long(
    ON_A_GROUP, 'lie_variational_euler', 'lie_leapfrog', 'lie_gauss4'))
def test_states_between_steps_on_a_group_are_as_accurate_as_the_method(name: str):
    """No worse than twice the local error of a whole step, and no worse than the reference."""
    h = 0.1
    dense = top(ON_A_GROUP[name](), h).dense_step()
    states = [dense.state(theta) for theta in TO_THE_END]
    errors = np.abs(np.array([np.concatenate(state) for state in states])
                    - top_at(h * TO_THE_END)).max(axis=1)
    assert (errors < 2.0 * errors[-1] + 1e-12).all()
    assert [np.linalg.norm(q) for q, _ in states] == pytest.approx([1.0] * 6, abs=1e-15)


def test_polynomial_through_a_step_on_a_group_is_of_order_3():
    lengths = 0.1 * np.array([1.0, 0.7, 0.5])
    errors = []
    for h in lengths:
        polynomial = top(INTEGRATORS['lie_gauss8'](), h).dense_step().polynomial
        found = np.hstack(polynomial(TO_THE_END))
        errors.append(np.abs(found - top_at(h * TO_THE_END)).max())
    # Cubic Hermite errs by h^4.
    assert np.polyfit(np.log(lengths), np.log(errors), 1)[0] >= 4 - 0.35


@pytest.mark.filterwarnings('ignore:the model was trained through')
@pytest.mark.parametrize('name', ['heavy_top', long('quadrotor'), long('turning_pendulum')])
def test_times_between_steps_of_a_scene_that_turns_are_met_to_the_order(name: str):
    times, scene = [0.0, 0.0137, 0.05, 0.1, 0.3333, 0.4999], load_scene(name)
    if name == 'quadrotor':
        # It hovers; here it turns.
        scene.initial_state.p[3:] = [0.01, 0.02, 0.03]
    runs = [simulate(scene, 0.5, step_size=scene.known_step_size / parts, times=times)
            for parts in (1, 2, 8)]
    assert runs[0].t.tolist() == times
    coarse, fine = (max(np.abs(run.q - runs[2].q).max(), np.abs(run.p - runs[2].p).max())
                    for run in runs[:2])
    # (1 - 1 / 64) / (1 / 4 - 1 / 64) = 4.2 times, within the 0.35 of the tests of order.
    assert coarse / fine >= 4.2 / 2.0 ** 0.35
    q0, p0 = np.tile(runs[0].q[0], (3, 1)), np.tile(runs[0].p[0], (3, 1))
    many = simulate_many(scene, q0, p0, 0.4999, samples=3)
    alone = simulate(scene, 0.4999, times=many.t)
    # Of a block the equations are solved until all of it has converged.
    assert np.abs(many.q[:, 1] - alone.q).max() < 1e-13
