# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Planners: the sweep of iLQR, limits, warm starts, regulators and path integrals."""

from typing import Any

from hnn_vi_ros import load_scene
from hnn_vi_ros.control import (
    BatchStep, find_equilibrium, Ilqr, Kinetic, linearise, lqr, Mppi, Point, Quadratic, Regulator,
    velocity)
from hnn_vi_ros.control.riccati import riccati_sweep, Stages
from messages import refused
import numpy as np
import pytest
from scipy.optimize import minimize

H = 0.02


@pytest.fixture(scope='module')
def pendulum() -> BatchStep:
    """Return steps of a pendulum of 1 kg and 1 m with a motor."""
    scene = load_scene('exact_pendulum')
    scene = scene.model_copy(update={'hamiltonian': scene.hamiltonian.model_copy(update={
        'mass': 1.0, 'length': 1.0, 'gravity': 9.81})})
    return BatchStep(scene.with_overrides(H, 'rk4', effects=[
        {'kind': 'external_force', 'coordinates': ['angle']}]), 3)


def planner(kind: type, steps: BatchStep, torque: float, regulated: bool = True, **options: Any):
    at = find_equilibrium(steps, [3.0])
    a, b = linearise(steps, at, hold=3)
    gain, cost = lqr(a, b, np.eye(2), np.eye(1), discrete=True)
    tip = Point.chain([1.0], [0.0, 0.0, 1.0]).saturating(0.1)
    running = tip + Quadratic(steps.hamiltonian, at, np.zeros((2, 2)), [[1e-3]])
    final = 5.0 * Quadratic(steps.hamiltonian, at, cost, [[0.0]]).saturating(100.0)
    if kind is Ilqr and regulated:
        options['regulator'] = Regulator(at, gain, 0.5)
    return kind(steps, running, final, 40, ([-torque], [torque]), **options)


def stages(seed: int, count: int, n: int, c: int, limit: float) -> Stages:
    rng = np.random.default_rng(seed)
    a = np.eye(n) + 0.2 * rng.normal(size=(n, n))
    b = rng.normal(size=(n, c))
    half = rng.normal(size=(n, n))
    shape = (1, count, c)
    return Stages(
        np.broadcast_to(a, (1, count, n, n)).copy(), np.broadcast_to(b, (1, count, n, c)).copy(),
        rng.normal(size=(1, count + 1, n)),
        np.broadcast_to(half @ half.T, (1, count + 1, n, n)).copy(),
        rng.normal(size=shape), np.broadcast_to(np.eye(c), (1, count, c, c)).copy(),
        np.full(shape, -limit), np.full(shape, limit), np.zeros(1))


def swept(of: Stages) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    _, count, n, c = of.f_u.shape
    changes, gains = np.zeros((1, count, c)), np.zeros((1, count, c, n))
    gained = np.zeros((1, 2))
    riccati_sweep(of, changes, gains, gained)
    return changes[0], gains[0], gained[0]


def test_the_sweep_ends_in_the_regulator_of_riccatis_equation():
    of = stages(0, 200, 4, 2, np.inf)
    _, gains, _ = swept(of)
    expected, _ = lqr(of.f_z[0, 0], of.f_u[0, 0], of.l_zz[0, 0], of.l_uu[0, 0], discrete=True)
    assert np.abs(gains[0] + expected).max() < 1e-10 * np.abs(expected).max()


@pytest.mark.parametrize('limit', [np.inf, 0.3])
def test_the_sweep_minimises_a_quadratic_cost_in_a_box(limit):
    # Of one command at a time the box of a stage is exact, so two stages, one of which is free.
    of = stages(1, 1, 3, 3, limit)
    changes, _, gained = swept(of)

    def cost(k: np.ndarray) -> float:
        x = of.f_u[0, 0] @ k
        return (of.l_u[0, 0] @ k + 0.5 * k @ of.l_uu[0, 0] @ k + of.l_z[0, 1] @ x
                + 0.5 * x @ of.l_zz[0, 1] @ x)
    found = minimize(cost, np.zeros(3), bounds=[(-limit, limit)] * 3, method='L-BFGS-B',
                     options={'ftol': 1e-15, 'gtol': 1e-10})
    assert gained.sum() == pytest.approx(cost(changes[0]), rel=1e-12)
    assert cost(changes[0]) <= found.fun + 1e-9 * abs(found.fun)
    assert np.abs(changes).max() <= limit


def test_a_rollout_is_steps_one_after_another_with_feedback_and_limits(pendulum):
    rng = np.random.default_rng(3)
    z, u, gains = rng.normal(size=2), rng.normal(size=(3, 5, 1)), rng.normal(size=(5, 1, 2))
    states, commands = pendulum.rollout(z, u)
    assert np.array_equal(commands, u) and states.shape == (3, 6, 2)
    for n in range(5):
        assert np.abs(pendulum(states[:, n], u[:, n]) - states[:, n + 1]).max() < 1e-14
    about = rng.normal(size=(5, 2))
    states, commands = pendulum.rollout(z, u, gains, about, ([-0.5], [0.7]))
    wanted = u + np.einsum('nck,mnk->mnc', gains, states[:, :-1] - about)
    assert np.abs(commands - np.clip(wanted, -0.5, 0.7)).max() < 1e-14
    assert (commands == -0.5).any() and (commands == 0.7).any()


def test_derivatives_at_several_times_are_those_at_each():
    drive = {'kind': 'periodic_drive', 'coordinate': 'angle', 'amplitude': 2.0, 'frequency': 0.7}
    steps = BatchStep(load_scene('exact_pendulum').with_overrides(H, 'rk4', effects=[
        {'kind': 'external_force', 'coordinates': ['angle']}, drive]), 3)
    z, times = np.random.default_rng(4).normal(size=(4, 2)), np.array([0.0, 0.3, 1.1, 2.0])
    found = steps.derivatives(z, np.ones((4, 1)), times)
    for n, t in enumerate(times):
        for all_, one in zip(found, steps.derivatives(z[n], [1.0], float(t)), strict=True):
            assert np.array_equal(all_[n], one)
    assert np.abs(steps(z[0], [1.0], 0.0) - steps(z[0], [1.0], 0.3)).max() > 1e-3


def driven_up(steps: BatchStep, controller: Any, count: int) -> tuple[np.ndarray, list[str]]:
    """Return the last state of a run from below, and the modes."""
    z, modes = np.zeros(2), []
    for n in range(count):
        u = controller(z[:1], velocity(steps, z[:1], z[1:]), n * steps.duration)
        modes.append(controller.mode)
        assert controller.plan.shape == (41, 2) and np.isfinite(controller.cost)
        z = steps(z, u)
    return z, modes


def test_ilqr_swings_a_pendulum_up_with_half_the_torque_that_lifts_it(pendulum):
    z, modes = driven_up(pendulum, planner(Ilqr, pendulum, 5.0), 120)
    assert np.abs(np.cos(z[0]) + 1.0) < 1e-4 and abs(z[1]) < 1e-2
    assert modes[0] == 'restart' and modes[-1] == 'regulate'
    # Nothing disturbs it, and the model is the plant: one search is enough.
    assert modes.count('restart') == 1


def test_ilqr_holds_limits_and_searches_again_after_a_disturbance(pendulum):
    controller = planner(Ilqr, pendulum, 5.0)
    assert abs(controller([0.0], [0.0], 0.0)) <= 5.0
    for n in range(1, 4):
        controller(controller.plan[1, :1], controller.plan[1, 1:], n * pendulum.duration)
        assert controller.mode == 'plan'
    controller([1.0], [-3.0], 4 * pendulum.duration)
    assert controller.mode == 'restart'


def test_a_plan_ends_with_its_budget(pendulum):
    ticks = iter(range(1000))
    short = planner(Ilqr, pendulum, 5.0, budget=2.5, clock=lambda: float(next(ticks)))
    long = planner(Ilqr, pendulum, 5.0)
    short([0.0], [0.0], 0.0)
    long([0.0], [0.0], 0.0)
    # Start, one look at the clock before each iteration, and one after it.
    assert next(ticks) == 4 and short.cost > long.cost


def test_mppi_swings_a_pendulum_up(pendulum):
    controller = planner(Mppi, pendulum, 5.0, spread=[3.0], temperature=0.5, samples=128)
    z, modes = driven_up(pendulum, controller, 120)
    assert np.cos(z[0]) < -0.95 and set(modes) == {'plan'}


@pytest.mark.parametrize(('kind', 'options'), [
    (Ilqr, {}), (Mppi, {'spread': [3.0], 'temperature': 0.5, 'samples': 16})])
def test_a_planner_that_was_reset_plans_as_a_new_one(pendulum, kind, options):
    new, used = (planner(kind, pendulum, 5.0, regulated=False, **options) for _ in range(2))
    for k in range(3):
        used([0.5 * k], [0.1], 0.06 * k)
    before = used([0.2], [0.0], 0.18)
    used.reset()
    assert used.plan is None and np.isinf(used.cost)
    for k in range(2):
        expected = new([0.2], [0.0], 0.06 * k)
        assert (used([0.2], [0.0], 0.06 * k) == expected).all() and used.cost == new.cost
        assert k or not np.array_equal(before, expected)


def test_what_cannot_plan_is_one_line(pendulum):
    with refused(ValueError):
        planner(Ilqr, pendulum, 0.0)
    with refused(ValueError):
        Ilqr(pendulum, Kinetic(pendulum.hamiltonian), Kinetic(pendulum.hamiltonian), 0, (-1, 1))
    with refused(ValueError):
        planner(Mppi, pendulum, 5.0, spread=[0.0], temperature=1.0)
    alone = BatchStep('exact_pendulum')
    with refused(ValueError):
        Ilqr(alone, Kinetic(alone.hamiltonian), Kinetic(alone.hamiltonian), 5, (-1.0, 1.0))
