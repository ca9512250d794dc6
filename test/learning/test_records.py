# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The loss of whole motions of a machine's networks, whose gradient is that of compiled steps."""

from copy import deepcopy
from dataclasses import replace

from hnn_vi_ros.learning.data.runs import Run, smoothed
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.loop import Problem
from hnn_vi_ros.learning.tasks.machine import describe, problem_of
from hnn_vi_ros.learning.tasks.records import Records
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch

T = 0.02 * np.arange(301)
CONFIG = MachineConfig.model_validate({
    'coordinates': [{'name': 'angle', 'kind': 'continuous'}], 'data': {'kind': 'arrays'},
    'family': {'kind': 'mechanical', 'prior': 'none', 'mass': 'constant',
               'friction': {'coulomb': 1, 'network': True}},
    'hidden': [8], 'loss': {
        'kind': 'trajectory', 'forward_steps': 100, 'forward_lbfgs_steps': 100, 'step_size': 0.04,
        'batch': 32, 'windows': [{'duration': 0.2, 'steps': 20}]}})


def pendulum(seed: int) -> Run:
    """Return 6 s of a driven pendulum with friction, every 20 ms."""
    rates, phases = np.random.default_rng(seed).uniform(0.5, 4.0, (2, 3))
    tau = np.sin(T[:, None] * rates + phases).sum(axis=1)

    def rate(t: float, z: np.ndarray) -> list[float]:
        return [z[1], np.interp(t, T, tau) - 4.0 * np.sin(z[0]) - 0.4 * z[1]]
    z = solve_ivp(rate, (0.0, T[-1]), [0.5, 0.0], t_eval=T, rtol=1e-9, atol=1e-9).y.T
    return smoothed(f'run{seed}', T, *np.hsplit(z, 2), tau[:, None], 20.0)


@pytest.fixture(scope='module')
def records() -> tuple[Problem, Records]:
    motions = [pendulum(1), pendulum(2)]
    problem = problem_of(CONFIG, motions)
    problem.fit()
    found = Records(problem.module, CONFIG.windows, motions, lambda: describe(
        problem.module, CONFIG, motions, '', {}, 'draft', ''), lambda: torch.zeros(()))
    found.begin()
    return problem, found


@pytest.mark.parametrize('steps', [40, 1000])
def test_gradient_of_motions_is_that_of_differences(records, steps: int):
    problem, loss = records
    parts = [part for name, part in problem.module.named_parameters() if 'linears' in name]
    generator = torch.Generator().manual_seed(0)
    direction = [torch.randn(part.shape, generator=generator, dtype=torch.float64)
                 for part in parts]
    slopes = torch.autograd.grad(loss.loss(steps), parts, allow_unused=True)
    along = sum(float((slope * move).sum()) for slope, move in zip(slopes, direction, strict=True)
                if slope is not None)

    def moved(distance: float) -> float:
        with torch.no_grad():
            for part, move in zip(parts, direction, strict=True):
                part.add_(move, alpha=distance)
            found = float(loss.loss(steps))
            for part, move in zip(parts, direction, strict=True):
                part.sub_(move, alpha=distance)
        return found
    # What order 6 cuts off is below 1e-11 here; second derivatives of forces are differences.
    expected = sum(weight * (moved(1e-3 * k) - moved(-1e-3 * k)) for k, weight in (
        (1, 45.0), (2, -9.0), (3, 1.0))) / 60e-3
    assert along == pytest.approx(expected, rel=1e-8)


def test_whole_motions_improve_and_end_no_worse(records):
    problem, loss = records
    before = loss.whole()
    losses = Problem(problem.module, loss.stages()).fit()
    assert [*losses] == ['records_0.25', 'records_0.5', 'records_1']
    # Windows of 0.2 s leave small errors of forces, which 6 s add up: 1.0e-5, then 9e-8.
    assert loss.whole() < 0.1 * before
    # A stage that finds nothing better leaves the weights as they were.
    best = deepcopy(problem.module.state_dict())
    away = replace(loss.stages()[0], loss=lambda: sum(
        part.square().sum() for part in problem.module.tensors().values()))
    Problem(problem.module, [away]).fit()
    after = problem.module.state_dict()
    assert all(torch.equal(part, after[name]) for name, part in best.items())
