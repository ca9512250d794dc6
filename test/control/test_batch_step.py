# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of many states with commands, and their derivatives."""

from concurrent.futures import ThreadPoolExecutor

from helpers import long, mostly_long
from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.control import batch_step, BatchStep
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.scene import Scene
from messages import refused
import numpy as np
import pytest

H = 0.01


def driven(name: str, method: str, coordinate: str, *others: dict, gain: float = 1.0) -> Scene:
    force = {'kind': 'external_force', 'coordinates': [coordinate], 'gain': gain}
    return load_scene(name).with_overrides(H, method, effects=[force, *others])


def states(seed: int, count: int, d: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 2 * d)), rng.normal(size=(count, 1))


@pytest.mark.parametrize('method', mostly_long(
    ('rk4', 'variational_euler', 'implicit_midpoint', 'dop853'), 'rk4', 'dop853'))
def test_steps_equal_those_of_simulate_bit_by_bit(method):
    scene = driven('exact_double_pendulum', method, 'angle2', {'kind': 'damping', 'rate': 0.3})
    z, u = states(0, 3, 2)
    found = BatchStep(scene, 5)(z, u)
    for start, command, end in zip(z, u, found, strict=True):
        path = simulate(scene, 5 * H, initial_state=(start[:2], start[2:]),
                        commands=np.tile(command, (5, 1)))
        assert np.array_equal(end, np.append(path.q[-1], path.p[-1]))


def complex_step(z: np.ndarray, u: complex) -> np.ndarray:
    """Return a pendulum's rk4 step, H = p^2 / 2 + 9.81 (1 - cos q), with a torque."""
    def field(z: np.ndarray) -> np.ndarray:
        return np.array([z[1], -9.81 * np.sin(z[0]) + u])
    k1 = field(z)
    k2 = field(z + 0.5 * H * k1)
    k3 = field(z + 0.5 * H * k2)
    return z + H / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + field(z + H * k3))


def test_derivatives_are_those_by_complex_steps():
    scene = driven('exact_pendulum', 'rk4', 'angle')
    scene = scene.model_copy(update={'hamiltonian': scene.hamiltonian.model_copy(update={
        'mass': 1.0, 'length': 1.0, 'gravity': 9.81})})
    z, u = states(1, 5, 1)
    end, by_z, by_u = BatchStep(scene).derivatives(z, u)
    for k, (start, (command,)) in enumerate(zip(z, u, strict=True)):
        columns = [complex_step(start + 1e-30j * unit, command).imag / 1e-30
                   for unit in np.eye(2)]
        assert np.abs(end[k] - complex_step(start, command)).max() < 1e-14
        assert np.abs(by_z[k] - np.transpose(columns)).max() < 1e-10
        assert np.abs(by_u[k, :, 0] - complex_step(
            start + 0j, command + 1e-30j).imag / 1e-30).max() < 1e-10


@pytest.mark.parametrize('method, gain', [
    ('rk4', 1.0), ('implicit_midpoint', 2.5), long('variational_euler', 1.0)])
def test_derivatives_are_differences_of_held_steps(method, gain):
    scene = driven('exact_double_pendulum', method, 'angle2', {'kind': 'damping', 'rate': 0.3},
                   gain=gain)
    steps = BatchStep(scene, 4)
    z, u = states(2, 3, 2)
    end, by_z, by_u = steps.derivatives(z, u)
    assert np.array_equal(end, steps(z, u))
    # Central differences: their rounding, 2e-16 of a state of some units by e, and e^2.
    e = 1e-5
    for k, unit in enumerate(np.eye(4)):
        found = (steps(z + e * unit, u) - steps(z - e * unit, u)) / (2.0 * e)
        assert np.abs(found - by_z[..., k]).max() < 1e-8
    found = (steps(z, u + e) - steps(z, u - e)) / (2.0 * e)
    assert np.abs(found - by_u[..., 0]).max() < 1e-8


def test_a_state_that_cannot_step_is_nan_and_leaves_others():
    steps = BatchStep(driven('exact_double_pendulum', 'rk4', 'angle2'))
    z, u = states(3, 3, 2)
    alone = steps(z[2], u[2])
    z[1, 3] = np.inf
    end, by_z, _ = steps.derivatives(z, u)
    assert np.isnan(end[1]).all() and np.isnan(by_z[1]).all()
    assert np.array_equal(end[2], alone) and np.isfinite(by_z[[0, 2]]).all()


def test_a_scene_without_commands_takes_none():
    steps = BatchStep('exact_double_pendulum')
    _, by_z, by_u = steps.derivatives(np.ones(4))
    assert by_z.shape == (4, 4) and by_u.shape == (4, 0)
    with refused(ValueError):
        steps(np.ones(4), [1.0])


def test_what_is_not_a_function_of_state_and_command_is_refused():
    servo = {'kind': 'servo', 'coordinates': ['angle'], 'stiffness': 1.0, 'damping': 0.1}
    with refused(UnsupportedSystem):
        BatchStep(load_scene('exact_pendulum').with_overrides(effects=[servo]))
    with refused(UnsupportedSystem):
        BatchStep('mathieu')


def test_limits_that_leave_no_command_are_refused():
    steps = BatchStep(driven('exact_pendulum', 'rk4', 'angle'))
    for limits in (([1.0], [-1.0]), ([np.nan], [1.0])):
        with refused(ValueError):
            steps.rollout(np.zeros(2), np.zeros((1, 3, 1)), limits=limits)
    with refused(ValueError):
        steps.rollout(np.zeros(2), np.zeros((1, 0, 1)))


def test_threads_that_share_steps_get_what_one_thread_gets():
    steps = BatchStep(driven('exact_pendulum', 'rk4', 'angle'), 20)
    calls = [states(seed, 5, 1) for seed in range(40)]
    alone = [steps(z, u) for z, u in calls]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda call: steps(*call), calls * 5))
    assert all(np.array_equal(*pair) for pair in zip(together, alone * 5, strict=True))


def test_results_do_not_depend_on_the_number_of_threads():
    scene = driven('exact_pendulum', 'rk4', 'angle')
    z, u = states(3, 1001, 1)
    gains, about = np.ones((1, 1, 1, 2)), np.zeros((1, 1, 2))
    alone, shared = (BatchStep(scene, 5, threads) for threads in (1, 3))
    assert np.array_equal(shared(z, u), alone(z, u))
    for found, expected in zip(shared.rollout(z, u[:, None], gains, about),
                               alone.rollout(z, u[:, None], gains, about), strict=True):
        assert np.array_equal(found, expected)


def test_threads_that_go_on_after_an_interrupt_change_no_later_result(monkeypatch):
    steps = BatchStep(driven('exact_pendulum', 'rk4', 'angle'), 5, 2)
    z, u = states(4, 1001, 1)
    expected, used = steps(z, u), list(steps._simulations)

    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(batch_step, 'in_threads', interrupted)
        steps(z, u)
    assert np.array_equal(steps(z, u), expected)
    assert not {*map(id, used)} & {*map(id, steps._simulations)}


@pytest.mark.parametrize('z, u', [
    ([[1.0, 0.5j]], [[0.0]]), (np.ma.array([[1.0, 2.0]], mask=[[False, True]]), [[0.0]]),
    ([[1.0, 2.0]], [['force']])])
def test_what_is_no_number_is_refused(z, u):
    steps = BatchStep(driven('exact_pendulum', 'rk4', 'angle'))
    with refused(TypeError):
        steps(z, u)
