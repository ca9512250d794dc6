# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations in Python: counting of time, failures, repeatability, arguments."""

from functools import cached_property

from helpers import EPS, KINDS, mostly_long, plain_run, random_checkpoint
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import SceneError, StepFailure
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models import NeuralHamiltonian
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import simulate, Simulation
from hnn_vi_ros.simulation.dense_step import record_at
from messages import refused
import numba
import numpy as np
import pytest
import sympy


def tao(h: float, q: float = 1.0, p: float = -1.0, **options: int | str) -> Simulation:
    """Return a simulation of Tao's Hamiltonian."""
    return plain_run('tao', INTEGRATORS['variational_euler'](**options), h, [q], [p])


@pytest.fixture(scope='module')
def scene():
    """Return a scene of the exact oscillator, which needs no model."""
    return load_scene('exact_harmonic_oscillator')


def test_simulate_returns_the_initial_state_first_and_every_step_after_it(scene):
    trajectory = simulate(scene, 10.0)
    assert trajectory.t.shape == trajectory.energy.shape == (1001,)
    assert trajectory.q.shape == trajectory.p.shape == (1001, 1)
    assert (trajectory.q[0, 0], trajectory.p[0, 0], trajectory.energy[0]) == (1.0, 0.0, 0.5)
    # Times are products, not sums: each is the double nearest to n h, to one rounding.
    assert np.array_equal(trajectory.t, np.arange(1001) * 0.01)


def test_simulate_takes_step_size_and_integrator_in_place_of_the_scenes(scene):
    coarse = simulate(scene, 1.0, step_size=0.1, integrator='explicit_euler')
    assert coarse.t[-1] == pytest.approx(1.0)
    # Each step of explicit Euler multiplies the oscillator's energy by 1 + h^2.
    assert coarse.energy[-1] / coarse.energy[0] == pytest.approx(1.01 ** 10, rel=1e-12)


def test_simulate_takes_parts_as_yaml_writes_them_and_the_scenes_duration(scene):
    own = scene.changed({'duration': 0.5})
    run = simulate(own, integrator={'kind': 'gauss4'}, initial_state={'q': [2.0], 'p': [0.0]})
    assert run.t[-1] == 0.5 and run.q[0, 0] == 2.0 and run.scene.integrator.kind == 'gauss4'


def test_simulate_every_keeps_each_nth_state(scene):
    assert np.array_equal(simulate(scene, 1.0, every=10).q, simulate(scene, 1.0).q[::10])


@pytest.mark.parametrize('arguments, error', [
    ({'every': 1.5}, TypeError), ({'every': True}, TypeError), ({'every': 0}, ValueError),
    ({'integrator': 'leapfrog9'}, SceneError), ({'duration': '1 s'}, TypeError),
    *(({'step_size': h}, SceneError) for h in (0.0, -0.1, float('nan'), float('inf'))),
    *(({'duration': duration}, ValueError) for duration in (-1.0, float('nan'), float('inf'))),
    ({'duration': 1e12}, ValueError), ({'duration': 1e308}, ValueError), ({'scene': 3}, TypeError),
    ({'scene': 'nowhere'}, SceneError), ({'initial_state': {'q': [1.0]}}, TypeError),
    ({'initial_state': 3}, TypeError), ({'initial_state': ([1.0, 2.0], [0.0, 0.0])}, SceneError),
    ({'effects': [{'kind': 'dampin'}]}, SceneError), ({'commands': [[1.0]]}, ValueError),
    ({'commands': lambda t: [1.0]}, ValueError), ({'duration': 10 ** 400}, ValueError)])
def test_simulate_refuses_an_argument_in_a_sentence(scene, arguments, error):
    with refused(error):
        simulate(**{'scene': scene, 'duration': 1.0} | arguments)


def test_simulate_takes_the_name_of_a_scene():
    assert simulate('exact_harmonic_oscillator', 0.01).q.shape == (2, 1)


@pytest.mark.long
def test_simulate_takes_a_tuple_of_effects(scene):
    damped = {'kind': 'damping', 'rate': 0.5}
    assert np.array_equal(simulate(scene, 0.1, effects=(damped,)).q,
                          simulate(scene, 0.1, effects=[damped]).q)


@pytest.mark.long
def test_simulate_takes_an_initial_state_and_effects_in_place_of_the_scenes(scene):
    trajectory = simulate(scene, 1.0, initial_state=(np.array([0.0]), [2.0]),
                          integrator='gauss8', effects=[{'kind': 'damping', 'rate': 0.5}])
    assert (trajectory.q[0, 0], trajectory.p[0, 0]) == (0.0, 2.0)
    omega = np.sqrt(1.0 - 0.0625)
    exact = 2.0 / omega * np.exp(-0.25 * trajectory.t) * np.sin(omega * trajectory.t)
    # Of order 8 with h = 0.01: round-off alone, of 100 steps.
    assert trajectory.q[:, 0] == pytest.approx(exact, abs=100 * 4 * np.finfo(float).eps)


def test_simulate_takes_commands_as_a_function_of_time_or_as_rows(scene):
    """A constant force f moves the oscillator about f; a row holds from sample to sample."""
    def run(commands: object) -> np.ndarray:
        return simulate(scene, 2.0, initial_state=([0.0], [0.0]), integrator='gauss8', every=10,
                        effects=[{'kind': 'external_force', 'coordinates': ['x'],
                                  'timeout': 0.01}], commands=commands).q[:, 0]
    t = 0.1 * np.arange(21)
    assert run(lambda time: [0.5]) == pytest.approx(0.5 * (1.0 - np.cos(t)), abs=1e-12)
    force = 0.5 * np.arange(20)
    rows = run(force[:, None])
    assert np.array_equal(rows, run(lambda time: [0.5 * ((time + 1e-9) // 0.1)]))
    # By superposition of steps of the force, which the oscillator answers by 1 - cos.
    steps = np.diff(force, prepend=0.0)
    expected = [sum(steps[k] * (1.0 - np.cos(time - 0.1 * k)) for k in range(20) if 0.1 * k < time)
                for time in t]
    assert rows == pytest.approx(expected, abs=1e-11)


@pytest.mark.long
def test_hamiltonian_of_functions_without_a_module_is_simulated():
    """As sympy's lambdify makes them."""
    q, p = sympy.symbols('q p')
    energy, slope, velocity = (numba.njit(sympy.lambdify((q, p), expression)) for expression in (
        p ** 2 / 2 + 2 * q ** 2, 4 * q, p))

    class Own(Hamiltonian):
        coordinates, separable = (Coordinate('x'),), True

        @cached_property
        def kernel(self) -> Kernel:
            @numba.njit
            def gradient(_, q, p, dH_dq, dH_dp):
                for i in range(q.size):
                    dH_dq[i], dH_dp[i] = slope(q[i], p[i]), velocity(q[i], p[i])

            @numba.njit
            def hessian_vector(_, q, p, v_q, v_p, product_q, product_p):
                for i in range(q.size):
                    product_q[i], product_p[i] = 4.0 * v_q[i], v_p[i]

            @numba.njit
            def whole(_, q, p):
                return energy(q[0], p[0])
            for function in (whole, gradient, hessian_vector):
                function.py_func.__module__ = None
            return Kernel(whole, gradient, hessian_vector, (), 1, (0.0, 0.0), True)

    simulation = Simulation(Own(), INTEGRATORS['gauss8'](), 0.01, [1.0], [0.0],
                            [EFFECTS['gravity']('x', acceleration=0.0)])
    simulation.advance(100)
    assert simulation.q[0] == pytest.approx(np.cos(2.0), abs=1e-13)


@pytest.mark.parametrize('q, p', [([1.0, 2.0], [0.0]), ([float('nan')], [0.0]), ([], [])])
def test_simulation_state_of_wrong_shape_or_not_finite_is_refused(q, p):
    with refused(ValueError):
        Simulation(HAMILTONIANS['tao'](), INTEGRATORS['variational_euler'](), 0.1, q, p)


@pytest.mark.parametrize('effects', [[], [EFFECTS['damping'](0.2)]], ids=['plain', 'forces'])
@pytest.mark.parametrize('shape', [(2,), (1, 2), (3, 2)])
def test_state_and_all_that_is_made_of_it_have_the_shape_of_the_initial_state(shape, effects):
    q, p = np.random.default_rng(0).uniform(-0.3, 0.3, (2, *shape))
    simulation = plain_run('henon_heiles', 'gauss4', 0.1, q, p, *effects)
    dense = simulation.dense_step()
    states = [(simulation.q, simulation.p), (simulation.dH_dq, simulation.dH_dp),
              simulation.probe.trial(simulation.row, 0.05), record_at(simulation, [0.15])]
    states += [dense.state(theta) for theta in (0.0, 0.3, 1.0)]
    assert [x.shape for pair in states[:2] + states[4:] for x in pair] == [shape] * 10
    assert [x.shape for x in (*states[2], *states[3], *simulation.record(4, 2))] == (
        [(1, *shape)] * 4 + [(4, *shape)] * 2)
    # Views of what the loop changes, not copies of it.
    before = simulation.q.copy()
    simulation.advance(1)
    assert (simulation.q != before).any()


def test_step_failure_names_time_and_residual_and_keeps_the_last_good_state():
    # h abs(H_qp) > 1 from the start: the fixed point does not contract, and is cut short.
    simulation = tao(1.0, 2.0, 2.0, solver='fixed_point', max_iterations=3)
    with pytest.raises(StepFailure) as caught:
        simulation.advance(5)
    failure = caught.value
    assert simulation.steps == 0
    assert (simulation.q[0], simulation.p[0]) == (2.0, 2.0)
    assert (failure.t, failure.h) == (0.0, 1.0)
    assert failure.reason == 'no convergence'
    assert failure.evaluations >= 1
    assert not failure.relative_residual < 1e-3
    assert f'relative residual {failure.relative_residual:.3g} after' in str(failure)
    assert f'{failure.evaluations} evaluations' in str(failure)


def test_step_failure_for_a_state_that_is_not_finite():
    # Explicit Euler at a huge step multiplies the energy by 1 + h^2 until it overflows.
    simulation = plain_run('harmonic_oscillator', 'explicit_euler', 1e6, [1.0], [0.0])
    with pytest.raises(StepFailure, match='not finite'):
        simulation.advance(1000)
    assert np.isfinite([simulation.q[0], simulation.p[0]]).all()
    assert simulation.steps > 0
    # Going on from the last good state fails in the same step again, and says so.
    with pytest.raises(StepFailure, match='not finite'):
        simulation.advance(1)


@pytest.mark.parametrize('name', mostly_long(sorted(set(INTEGRATORS) - {
    'stormer_verlet', 'taylor', 'discrete_euler_lagrange', 'variational_midpoint'} - {
        name for name in INTEGRATORS if name.startswith('lie_')}), *KINDS, 'time_transformed',
        'dop853'))
def test_simulation_restored_from_a_snapshot_is_bit_identical(name):
    whole, resumed = (plain_run('tao', name, 0.05, [1.0], [-1.0]) for _ in range(2))
    whole.advance(50)
    snapshot = whole.snapshot()
    whole.advance(50)
    resumed.restore(snapshot)
    assert resumed.steps == 50
    resumed.advance(50)
    for part in ('q', 'p', 'dH_dq', 'dH_dp', 'steps'):
        assert np.array_equal(getattr(resumed, part), getattr(whole, part))


def test_simulation_takes_sub_steps_where_no_solver_converges_and_counts_them():
    # h abs(H_qp) is far above 1, and Newton's method finds no solution from so far away.
    simulation = tao(3.0, 2.0, 2.0)
    simulation.advance(1)
    assert (simulation.steps, simulation.rescued) == (1, 1)
    fine = plain_run('tao', 'gauss8', 0.03, [2.0], [2.0])
    fine.advance(100)
    assert simulation.energy == pytest.approx(fine.energy, rel=0.5)


@pytest.mark.parametrize('amplitude', [1e-200, 1e-9, 1e-3, 1.0, 1e6])
def test_implicit_step_converges_at_every_scale_of_the_state(amplitude):
    simulation = plain_run('harmonic_oscillator', 'variational_euler', 0.01, [amplitude], [0.0])
    simulation.advance(1000)
    assert np.hypot(simulation.q[0], simulation.p[0]) == pytest.approx(amplitude, rel=0.01)


@pytest.mark.parametrize('widths', mostly_long(
    [[2, 200, 200, 1], [4, 32, 1], [2, 64, 64, 64, 1], [2, *[64] * 12, 1]], '[4, 32, 1]',
    str([2, *[64] * 12, 1])))
def test_implicit_step_of_a_network_converges_to_round_off(widths):
    """A bound on its rounding from the weights would let any first guess pass; it is measured."""
    hamiltonian, h = NeuralHamiltonian(random_checkpoint(widths, seed=4)), 0.01
    d = hamiltonian.dimension
    simulation = Simulation(hamiltonian, INTEGRATORS['variational_euler'](), h, [0.5] * d,
                            [0.1] * d)
    q, p = simulation.record(2000, 1)
    # Fixed point contracts by h abs(H_qp) < 0.01 an iteration: 16 digits take at most 9 of them.
    assert simulation.gradients / simulation.steps < 10.0
    dH_dq, _ = hamiltonian.gradient(q, p)
    residual = np.abs(p[1:] - (p[:-1] - h * dH_dq[1:]))
    # The rounding of p, and the 8 eps of the gradient's measured rounding that are accepted.
    scale = max(np.abs(p).max(), h * hamiltonian.kernel.gradient_scale[0])
    assert residual.max() <= 16 * EPS * scale
    assert h * hamiltonian.kernel.gradient_scale[0] < 10.0 * np.abs(p).max()
