# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Random models of the family mechanical, and their definition in torch."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.models import (
    Box, Checkpoint, CoordinateCard, CoulombTerm, FrictionCard, Layers, MechanicalCard, ModelCard,
    PriorCard, Quantity, save_checkpoint, StribeckTerm)
import numpy as np
import pytest
import torch

# The Hessians of networks of this size are of the order of ten; see test_neural.
ROUND_OFF = 1e-12
PRIOR = PriorCard(kind='double_pendulum', parameters={
    name: Quantity(value=value, unit='1') for name, value in {
        'inertia1': 1.5, 'inertia2': 0.7, 'coupling12': 0.6, 'gravity1': 1.3, 'gravity2': -0.4,
        'motor_inertia2': 0.2}.items()})
# An arm with two continuous joints and absolute angles as inputs; a cart with a pole; a revolute
# joint with constant mass; an arm next to a prior; three combined coordinates; a joint with
# friction that depends on position; an arm whose features repeat; and an arm with friction between
# its joints.
SHAPES = {
    'arm': {'kinds': ['continuous', 'continuous'], 'features': [[1.0, 0.0], [1.0, 1.0]],
            'mass_features': [[0.0, 1.0]]},
    'cart and pole': {'kinds': ['prismatic', 'continuous'], 'features': [[1.0, 0.0], [0.0, 1.0]],
                      'mass_features': [[0.0, 1.0]], 'diagonal_mass': True},
    'joint': {'kinds': ['revolute'], 'features': [[1.0]], 'mass_features': []},
    'double pendulum': {
        'kinds': ['continuous', 'continuous'], 'features': [[1.0, 0.0], [1.0, 1.0]],
        'mass_features': [[0.0, 1.0]], 'floor': 0.0, 'prior': PRIOR},
    'three': {'kinds': ['revolute', 'continuous', 'prismatic'], 'features': [
        [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.5, 0.0, -1.0]], 'mass_features': [
            [1.0, 0.0, -0.5], [0.0, 1.0, 0.0]]},
    'eccentric': {'kinds': ['continuous'], 'features': [[1.0]], 'mass_features': [],
                  'friction_features': [[1.0]]},
    'repeated': {'kinds': ['continuous', 'revolute'],
                 'features': [[0.0, 1.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
                 'mass_features': [[0.0, 1.0], [0.0, 1.0]]},
    'worn': {'kinds': ['continuous', 'revolute'], 'features': [[1.0, 0.0], [0.0, 1.0]],
             'mass_features': [[0.0, 1.0]], 'friction_features': [[1.0, 0.0], [0.0, 1.0]]},
}


def random_friction(d: int) -> FrictionCard:
    rng = np.random.default_rng(d)
    force, width = rng.uniform(0.1, 0.5, d).tolist(), rng.uniform(0.3, 0.6, d).tolist()
    return FrictionCard(viscous=rng.uniform(0.1, 0.5, d).tolist(),
                        coulomb=[CoulombTerm(force=force, width=width)],
                        stribeck=[StribeckTerm(force=width, width=force, speed=width)])


def random_mechanical(shape: str, **changes) -> Checkpoint:
    """Return a model with random networks of the usual size."""
    settings = {'floor': 0.05} | SHAPES[shape] | changes
    d = len(settings['kinds'])
    rng = np.random.default_rng(d)
    mechanical = MechanicalCard(
        **settings, mass_scale=rng.uniform(0.5, 1.5, d).tolist(),
        friction=random_friction(d))
    networks = {}
    for name, ends in mechanical.networks.items():
        widths = [ends.inputs, 9, 6, ends.outputs(1, 0)]
        networks[name] = Layers(
            tuple(rng.normal(size=(b, a)) / np.sqrt(a) for a, b in pairwise(widths)),
            tuple(0.3 * rng.normal(size=b) for b in widths[1:]))
    card = ModelCard(
        name='random', family='mechanical', dataset='none', seed=d, losses={},
        training_command='', package_version='0', mechanical=mechanical,
        networks={name: [layers.weights[0].shape[1], *(bias.size for bias in layers.biases)]
                  for name, layers in networks.items()},
        box=Box(q=[[-1.0, 1.0]] * d, p=[[-1.0, 1.0]] * d),
        coordinates=[CoordinateCard(name=f'x{i}') for i in range(d)])
    return Checkpoint(card, networks)


def saved(folder: Path, shape: str) -> str:
    path = folder / f'{shape.replace(" ", "_")}.safetensors'
    save_checkpoint(path, random_mechanical(shape))
    return str(path)


def network(layers: Layers, x: torch.Tensor) -> torch.Tensor:
    *hidden, last = [tuple(map(torch.tensor, parts)) for parts in zip(*layers, strict=True)]
    for weight, bias in hidden:
        x = torch.tanh(weight @ x + bias)
    return last[0] @ x + last[1]


def seen(card: MechanicalCard, features: list[list[float]], q: torch.Tensor) -> torch.Tensor:
    inputs = []
    for row in features:
        y = torch.tensor(row, dtype=torch.float64) @ q
        turns = any(x and kind == 'continuous' for x, kind in zip(row, card.kinds, strict=True))
        inputs += [torch.sin(y), torch.cos(y)] if turns else [y]
    return torch.stack(inputs) if inputs else torch.zeros(1, dtype=torch.float64)


def torch_energy(model: Checkpoint, z: torch.Tensor) -> torch.Tensor:
    """Return H as defined by the family, with an inverse matrix; the mean for an ensemble."""
    q, p = z.chunk(2)
    found = [mass_and_potential(member, q) for member in model.members or (model,)]
    mass, potential = (sum(parts) / len(found) for parts in zip(*found, strict=True))
    return 0.5 * p @ torch.linalg.inv(mass) @ p + potential


def mass_and_potential(model: Checkpoint, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return M and V."""
    card = model.card.mechanical
    d = len(q)
    if card.prior is not None and card.prior.alone:
        return prior_mass(q), prior_potential(q)
    entries = network(model.networks['mass'], seen(card, card.mass_features, q))
    L = torch.zeros(d, d, dtype=torch.float64)
    k = 0
    for i in range(d):
        for j in range(i + 1):
            if i == j or not card.diagonal_mass:
                L[i, j] = torch.log(1.0 + torch.exp(entries[k])) if i == j else entries[k]
                k += 1
    scale = torch.diag(torch.tensor(card.mass_scale, dtype=torch.float64))
    mass = scale @ (L @ L.T + card.floor * torch.eye(d, dtype=torch.float64)) @ scale
    potential = network(model.networks['potential'], seen(card, card.features, q))[0]
    if card.prior is not None:
        mass, potential = mass + prior_mass(q), potential + prior_potential(q)
    return mass, potential


def prior_mass(q: torch.Tensor) -> torch.Tensor:
    """Return M of PRIOR, whose second angle is relative to the first link, as in textbooks."""
    a, b, c, _, _, r = (quantity.value for quantity in PRIOR.parameters.values())
    both = b + c * torch.cos(q[1])
    return torch.stack([torch.stack([a + 2.0 * both - b, both]),
                        torch.stack([both, torch.tensor(b + r, dtype=q.dtype)])])


def prior_potential(q: torch.Tensor) -> torch.Tensor:
    weights = [PRIOR.parameters[f'gravity{i}'].value for i in (1, 2)]
    return (weights[0] * (1.0 - torch.cos(q[0]))
            + weights[1] * (1.0 - torch.cos(q[0] + q[1])))


def assert_agrees_with_torch(hamiltonian: Hamiltonian, model: Checkpoint, z: np.ndarray,
                             v: np.ndarray, torch_energy: Callable = torch_energy,
                             curvature: float = 10 * ROUND_OFF) -> None:
    """Compare H, its gradient at z and its Hessian times v with autograd."""
    d = hamiltonian.dimension
    gradient = np.hstack(hamiltonian.gradient(z[:, :d], z[:, d:]))
    product = np.hstack(hamiltonian.hessian_vector(z[:, :d], z[:, d:], v[:, :d], v[:, d:]))
    energies = hamiltonian.energy(z[:, :d], z[:, d:])
    for i in range(len(z)):
        state = torch.tensor(z[i], requires_grad=True)
        energy = torch_energy(model, state)
        (slope,) = torch.autograd.grad(energy, state, create_graph=True)
        (curved,) = torch.autograd.grad(slope @ torch.tensor(v[i]), state)
        assert energies[i] == pytest.approx(energy.item(), abs=ROUND_OFF)
        assert np.abs(gradient[i] - slope.detach().numpy()).max() <= ROUND_OFF
        # Second derivatives of M^-1, with condition number 1 / floor, exceed twice the slopes.
        assert np.abs(product[i] - curved.numpy()).max() <= curvature
