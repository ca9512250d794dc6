# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Losses over discrete steps are zero on what the simulator's steps of the same method make."""

from dataclasses import replace
from itertools import pairwise

from helpers import random_checkpoint
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.families.base import Scales, Trainable
from hnn_vi_ros.learning.families.choices import (
    DGNetChoice, DiscreteGradient, DiscreteLagrangian, VINChoice)
from hnn_vi_ros.learning.families.hnn import DGNet
from hnn_vi_ros.learning.families.lagrangian import VIN
from hnn_vi_ros.learning.tasks.field import LOSSES
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.models.variational import VariationalHamiltonian
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
import torch

D, WIDTHS, STARTS, STEPS = 2, [16, 16], 5, 4
SCALES = Scales(*np.random.default_rng(6).uniform(0.5, 1.5, (8, D)), np.zeros(0))
# Friction begins at a tenth of these rates: at one rate for all, or a coupled system gains energy.
SCALES = replace(SCALES, p_rate=SCALES.p_half)


def random_dgnet(friction: bool) -> tuple[DGNet, Hamiltonian]:
    """Return a network as it is trained, and as it is simulated."""
    family = DGNet(DGNetChoice(kind='dgnet', friction=friction), WIDTHS, SCALES, seed=3)
    card = random_checkpoint([2 * D, *WIDTHS, 1], seed=0).card
    return family, NeuralHamiltonian(Checkpoint(card, family.networks(np.zeros(2 * D), 0.0)))


def random_vin() -> tuple[VIN, Hamiltonian]:
    """Return the same of V(q), with a mass matrix that is not diagonal."""
    family = VIN(VINChoice(kind='vin', mass=1.3), WIDTHS, SCALES, seed=4)
    with torch.no_grad():
        family.factor.add_(0.3 * torch.randn(D, D, generator=torch.Generator().manual_seed(5)))
    card = random_checkpoint([2 * D, *WIDTHS, 1], seed=0).card.model_copy(update={
        'family': 'vin', 'widths': [D, *WIDTHS, 1], **family.constants()})
    return family, VariationalHamiltonian(Checkpoint(card, family.networks(np.zeros(2 * D), 0.0)))


def steps(hamiltonian: Hamiltonian, method: str, h: float, effects: tuple = ()) -> Dataset:
    """Return the states of simulations from random ones: what a user would learn from."""
    q, p = [], []
    for start in np.random.default_rng(7).uniform(-1.0, 1.0, (STARTS, 2, D)):
        simulation = Simulation(hamiltonian, INTEGRATORS[method](), h, *start, effects)
        path_q, path_p = simulation.record(STEPS, 1)
        q += [start[:1], path_q]
        p += [start[1:], path_p]
    q, p = np.concatenate(q), np.concatenate(p)
    block = np.repeat(np.arange(STARTS), STEPS + 1)
    return Dataset(q, p, q, p, block, 'simulated', np.tile(h * np.arange(STEPS + 1), STARTS))


def residuals(choice, family: Trainable, data: Dataset) -> np.ndarray:
    """Return what a loss of this choice squares, in the units of its target."""
    loss = LOSSES[choice.kind]
    batch = loss.batch(choice, data)
    return (loss.predict(choice, family, *batch.inputs) - batch.target).detach().numpy()


def test_loss_of_the_discrete_gradient_vanishes_on_the_simulators_steps():
    (family, hamiltonian), h = random_dgnet(friction=False), 0.1
    choice = DiscreteGradient(kind='discrete_gradient', step_size=h)
    data = steps(hamiltonian, choice.scheme.integrator, h)
    change = [np.linalg.norm(np.diff(np.hstack([data.q, data.p])[data.block == k], axis=0), axis=1)
              for k in range(STARTS)]
    # Both know H, a sum of 16 terms of order 1, to 16 eps = 4e-15, and divide its change by that
    # of the state: h times this enters a step. The step itself is solved and rounded to 1e-15.
    assert np.abs(residuals(choice, family, data)).max() * h <= h * 4e-15 / np.min(change) + 1e-15


@pytest.mark.parametrize('rule', ['trapezoid', 'midpoint'])
def test_loss_of_the_discrete_lagrangian_vanishes_on_the_simulators_steps(rule: str):
    (family, hamiltonian), h = random_vin(), 0.1
    choice = DiscreteLagrangian(kind='discrete_lagrangian', rule=rule, step_size=h)
    data = steps(hamiltonian, choice.scheme.integrator, h)
    # Second differences of coordinates of order 1: four roundings of eps / 2 each, as much again
    # where steps are solved; accelerations, of sums of 16 terms, enter them times h^2.
    assert np.abs(residuals(choice, family, data)).max() * h**2 <= 1e-14


def test_loss_of_the_discrete_gradient_takes_friction_in_the_middle_of_a_step():
    # The two cannot agree to round-off: the loss takes friction at the mean momentum, as its
    # authors do, and the simulator its exact flow before and after the step. Both are of order 2,
    # and symmetric: their difference, as a rate, is h^2 times a constant, and smaller terms h^4.
    family, hamiltonian = random_dgnet(friction=True)
    damping = EFFECTS['damping'](family.constants()['friction'])
    sizes = []
    for h in (0.1, 0.05, 0.025):
        choice = DiscreteGradient(kind='discrete_gradient', step_size=h)
        data = steps(hamiltonian, 'discrete_gradient', h, (damping,))
        # Of the first step of each path: all begin in the same states.
        first = residuals(choice, family, data).reshape(STARTS, STEPS, 2 * D)[:, 0]
        sizes.append(np.abs(first).max())
    for coarse, fine in pairwise(sizes):
        assert coarse / fine == pytest.approx(4.0, rel=0.1)
    # Small beside friction itself, whose rates are some 0.1 / s.
    assert sizes[-1] <= 1e-5
