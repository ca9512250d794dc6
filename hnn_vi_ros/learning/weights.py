# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of H of a trained model by the weights of its networks."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from hnn_vi_ros.errors import listed, UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.learning.families.base import gradient
from hnn_vi_ros.models.checkpoint import Checkpoint, Layers
from hnn_vi_ros.models.learned import LearnedHamiltonian
import numpy as np
import torch

# What each network of H sees, in families whose H is the sum of them and of what has no weights.
_SEES = {
    'hnn': {'energy': 'both'}, 'dissipative_hnn': {'energy': 'both'}, 'dgnet': {'energy': 'both'},
    'separable_hnn': {'kinetic': 'p', 'potential': 'q'}, 'vin': {'potential': 'q'}}
_ACTIVATIONS = {
    'tanh': torch.tanh, 'sine': torch.sin, 'relu': torch.relu,
    'softplus': lambda z: torch.logaddexp(z, torch.zeros_like(z))}
# States that are differentiated together.
_ROWS = 4096


def with_weights(hamiltonian: Hamiltonian, weights: Mapping[str, np.ndarray]
                 ) -> LearnedHamiltonian:
    """
    Return a trained H with other weights.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Of a scene.
    weights : mapping of str to np.ndarray
        By the names of the tensors in its model file: ``linear1.weight``, and
        ``potential.linear1.weight`` in a family of several networks.

    Raises
    ------
    UnsupportedSystem
        H is not that of a trained model, or of a family whose H is no sum of networks, or walls
        confine it.
    ValueError
        There is no such tensor, or it has another shape.

    """
    known = check_weights(hamiltonian, weights)
    assert isinstance(hamiltonian, LearnedHamiltonian)
    for name, value in weights.items():
        if value.shape != known[name].shape:
            raise ValueError(f'{name} has shape {value.shape}, expected {known[name].shape}')
    checkpoint = hamiltonian.checkpoint
    networks = dict(checkpoint.networks) | _layers(checkpoint, known | dict(weights))
    return type(hamiltonian)(replace(checkpoint, networks=networks))


def check_weights(hamiltonian: Hamiltonian, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return the tensors of a trained H by name; raise as ``with_weights`` does for others."""
    if not isinstance(hamiltonian, LearnedHamiltonian):
        raise UnsupportedSystem(
            f'weights of {type(hamiltonian).__name__} are not differentiable yet: it is not H of '
            'a trained model, or it is confined to its box (confine: false)')
    checkpoint = hamiltonian.checkpoint
    if checkpoint.card.family not in _SEES:
        raise UnsupportedSystem(f'weights of the family {checkpoint.card.family} are not '
                                f'differentiable yet; families whose are: {", ".join(_SEES)}')
    if checkpoint.members:
        raise UnsupportedSystem('weights of an ensemble are not differentiable yet: take one of '
                                'its members, with member: K in hamiltonian')
    known = dict(_tensors(checkpoint))
    for name in names:
        if name not in known:
            raise ValueError(f'the model has no tensor {name!r}; it has: {listed(known)}')
    return known


class OnWeights:
    """
    The dependence of a trained H on some of its weights, one after another; see Dependence.

    Parameters
    ----------
    hamiltonian : LearnedHamiltonian
        From ``with_weights``.
    names : sequence of str
        Of the tensors.

    """

    def __init__(self, hamiltonian: LearnedHamiltonian, names: Sequence[str]):
        self._checkpoint, self._names, self._d = (
            hamiltonian.checkpoint, names, hamiltonian.dimension)
        self._tensors = {name: torch.tensor(array)
                         for name, array in _tensors(self._checkpoint)}

    def contracted(self, q: np.ndarray, p: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the gradient, shape (W,); see Dependence."""
        total = 0.0
        for states, directions in zip(self._rows(q, p), self._rows(*weights), strict=True):
            flat, slopes = self._slopes(states)
            (part,) = torch.autograd.grad(
                slopes, flat, directions, allow_unused=True, materialize_grads=True)
            total = total + part
        return total.numpy()

    def changed(self, q: np.ndarray, p: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Return the change, from one of shape (W,); see Dependence."""
        parts = []
        for states in self._rows(q, p):
            flat, slopes = self._slopes(states)
            # Linear in the seed, so that its derivative by it is the change, at any seed.
            seed = torch.zeros_like(slopes, requires_grad=True)
            (pulled,) = torch.autograd.grad(slopes, flat, seed, create_graph=True,
                                            allow_unused=True, materialize_grads=True)
            (part,) = torch.autograd.grad(pulled, seed, torch.tensor(change),
                                          allow_unused=True, materialize_grads=True)
            parts.append(part)
        both = torch.cat(parts).reshape(-1, 2, self._d).transpose(0, 1)
        return both.reshape(2, -1).numpy()

    def _rows(self, q: np.ndarray, p: np.ndarray) -> tuple[torch.Tensor, ...]:
        """Return states, shape (N, 2 d), some at a time."""
        states = np.hstack([q.reshape(-1, self._d), p.reshape(-1, self._d)])
        return torch.from_numpy(states).split(_ROWS)

    def _slopes(self, states: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the weights, (W,), and what H' of the networks is by them, shape (N, 2 d)."""
        with torch.enable_grad():
            own = [self._tensors[name] for name in self._names]
            flat = torch.cat([tensor.reshape(-1) for tensor in own]).requires_grad_()
            parts = flat.split([tensor.numel() for tensor in own])
            followed = {name: part.reshape(tensor.shape) for name, part, tensor in zip(
                self._names, parts, own, strict=True)}
            layers = _layers(self._checkpoint, self._tensors | followed)
            return flat, gradient(lambda z: self._energy(layers, z), states)

    def _energy(self, layers: Mapping[str, Layers], z: torch.Tensor) -> torch.Tensor:
        """Return the networks' part of H, shape (N,), at states z, shape (N, 2 d)."""
        q, p = z.chunk(2, dim=1)
        seen, card = {'q': q, 'p': p, 'both': z}, self._checkpoint.card
        total = torch.zeros(len(z), dtype=z.dtype)
        for network, (weights, biases) in layers.items():
            a = seen[_SEES[card.family][network]]
            for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
                a = _ACTIVATIONS[card.activation](a @ weight.T + bias)
            total = total + (a @ weights[-1].T + biases[-1])[:, 0]
        return total


def _names(checkpoint: Checkpoint) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Yield each network of H, with the names of weight and bias of each of its layers."""
    for network in _SEES[checkpoint.card.family]:
        prefix = '' if checkpoint.card.networks is None else f'{network}.'
        yield network, [(f'{prefix}linear{k}.weight', f'{prefix}linear{k}.bias')
                        for k in range(1, len(checkpoint.networks[network].weights) + 1)]


def _tensors(checkpoint: Checkpoint) -> Iterator[tuple[str, np.ndarray]]:
    for network, names in _names(checkpoint):
        for layer, values in zip(names, zip(*checkpoint.networks[network], strict=True),
                                 strict=True):
            yield from zip(layer, values, strict=True)


def _layers(checkpoint: Checkpoint, tensors: Mapping) -> dict[str, Layers]:
    """Return the networks of H, of arrays or tensors by name."""
    return {network: Layers(*zip(*((tensors[weight], tensors[bias]) for weight, bias in names),
                                 strict=True))
            for network, names in _names(checkpoint)}
