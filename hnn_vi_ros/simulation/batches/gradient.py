# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Gradients of learned Hamiltonians at many states, as explicit matrix products.

The columns of A_0 are the states, Z_l = W_l A_(l-1) + b_l and A_l = f(Z_l). The gradient of
H = w . a_K + b is W_1^T D_1, by backpropagation with D_K = w f'(Z_K) and
D_l = (W_(l+1)^T D_(l+1)) f'(Z_l): two products with each matrix, without an autograd graph.

States are evaluated in batches of a few sizes, padded with zeros. On the CPU there is one size
per network, so each product is the same call for any number of states, and the result of a state
does not depend on the other states.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.models import (
    ConfinedHamiltonian, Layers, LearnedHamiltonian, NeuralHamiltonian, SeparableHamiltonian,
    VariationalHamiltonian)
import numpy as np
import torch

# Size of an array of activations on the CPU, which fits the L2 cache; maximum and minimum batch
# size on the CPU. The latter is a multiple of the blocks of 8, 12, 24 or 64 columns that BLAS
# multiplies at once: remainders are summed in another order.
_CACHED_NUMBERS, _MAX_BATCH, _MIN_BATCH = 80_000, 960, 192
# Batch sizes on a GPU; each has its own CUDA graph.
_GPU_BATCHES = tuple(2**k for k in range(8, 18))
# Number of runs before the capture: libraries allocate memory in the first ones.
_WARM_UP_RUNS = 3
FAMILIES = 'hnn, dissipative_hnn (its energy), dgnet, separable_hnn, vin'
# (H_q, H_p), shape (2 d, m), at states (q, p) of that shape.
Gradient = Callable[[torch.Tensor], torch.Tensor]
_Slope = Callable[[torch.Tensor, torch.Tensor], None]


def row_dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """
    Return the sum of products of rows, in sequential order.

    The order of summation of ``torch.sum`` depends on the number of trajectories.
    """
    total = a[0] * b[0]
    for k in range(1, len(a)):
        total = total + a[k] * b[k]
    return total


def make_gradient(hamiltonian: Hamiltonian, device: torch.device) -> Gradient:
    """
    Return the gradient of H on a device.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian made of perceptrons of (q, p), of q, or of p.
    device : torch.device
        Device of the states.

    Raises
    ------
    UnsupportedSystem
        Any other H; the message names the supported families.

    """
    def of(layers: Layers) -> PerceptronGradient:
        assert isinstance(hamiltonian, LearnedHamiltonian), 'only learned ones have layers'
        return PerceptronGradient(layers, hamiltonian.checkpoint.card.activation, device)

    match hamiltonian:
        case ConfinedHamiltonian():
            return _confined(make_gradient(hamiltonian.base, device), hamiltonian, device)
        case NeuralHamiltonian():
            return of(hamiltonian.checkpoint.networks['energy'])
        case SeparableHamiltonian():
            networks = hamiltonian.checkpoint.networks
            return _sum(of(networks['potential']), of(networks['kinetic']))
        case VariationalHamiltonian():
            inverse = torch.from_numpy(hamiltonian.mass_inverse).to(device)
            # The inverse mass matrix is symmetric, so its rows are its columns.
            return _sum(of(hamiltonian.checkpoint.networks['potential']),
                        lambda p: row_dot(inverse[..., None], p[:, None]))
    if isinstance(hamiltonian, LearnedHamiltonian) and hamiltonian.checkpoint.members:
        raise UnsupportedSystem('a device does not support the mean of an ensemble; remove '
                                'device, or select a member with `member: K` in hamiltonian')
    name = f'a model of the family {hamiltonian.checkpoint.card.family}' if isinstance(
        hamiltonian, LearnedHamiltonian) else type(hamiltonian).__name__
    raise UnsupportedSystem(f'a device does not support {name}, which is not made of perceptrons '
                            f'alone; remove device, or use a learned model of: {FAMILIES}')


def _sum(of_q: Gradient, of_p: Gradient) -> Gradient:
    """Return the gradient of V(q) + T(p)."""
    def gradient(z: torch.Tensor) -> torch.Tensor:
        q, p = z.chunk(2)
        return torch.cat([of_q(q), of_p(p)])
    return gradient


def _confined(base: Gradient, hamiltonian: ConfinedHamiltonian, device: torch.device) -> Gradient:
    """Return the gradient with walls added; see ConfinedHamiltonian for the formula."""
    low, high = torch.from_numpy(np.concatenate(hamiltonian.box)).to(device).T[:, :, None]
    energy = torch.from_numpy(np.tile(hamiltonian.energies, 2)).to(device)[:, None]
    half = 0.5 * (high - low)

    def gradient(z: torch.Tensor) -> torch.Tensor:
        y = torch.where(z > high, z - high, torch.where(z < low, z - low, 0.0)) / half
        square = y * y
        s = square / (1.0 + square)
        return base(z) + energy / half * y * s * (2.0 - s)
    return gradient


class PerceptronGradient:
    """
    Gradient of a network with respect to its inputs.

    Parameters
    ----------
    layers : Layers
        Layers of the network, with one output.
    activation : str
        Name of the activation function.
    device : torch.device
        Device of the states.

    """

    def __init__(self, layers: Layers, activation: str, device: torch.device):
        self._device, self._activation = device, activation
        *weights, last = (torch.from_numpy(np.ascontiguousarray(w)).to(device)
                          for w in layers.weights)
        biases = (torch.from_numpy(b).to(device) for b in layers.biases[:-1])
        self._layers = list(zip(weights, (b[:, None] for b in biases), strict=True))
        self._last, self._inputs = last.T.contiguous(), layers.weights[0].shape[1]
        widest = max(len(w) for w in weights)
        size = max(min(_CACHED_NUMBERS // widest, _MAX_BATCH) // _MIN_BATCH, 1) * _MIN_BATCH
        self._buckets = _GPU_BATCHES if device.type == 'cuda' else (size,)
        self._batches: dict[int, _Batch] = {}

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """Return the gradient, shape (n, m), at inputs of that shape."""
        out = torch.empty_like(x)
        for first, end, size in self._parts(x.shape[1]):
            if size not in self._batches:
                self._batches[size] = _Batch(self._layers, self._last, self._activation, size)
            batch = self._batches[size]
            batch.inputs[:, :end - first] = x[:, first:end]
            batch.inputs[:, end - first:] = 0.0
            batch.run()
            out[:, first:end] = batch.gradient[:, :end - first]
        return out

    def _parts(self, m: int) -> Iterator[tuple[int, int, int]]:
        """Split m states into batches; yield start, end and padded size of each."""
        first = 0
        while first < m:
            size = next((s for s in self._buckets if s >= m - first), self._buckets[-1])
            yield first, min(first + size, m), size
            first += size


class _Batch:
    """Forward and backward pass of a fixed number of states, in preallocated arrays."""

    def __init__(self, layers: list[tuple[torch.Tensor, torch.Tensor]], last: torch.Tensor,
                 activation: str, size: int):
        device, self._layers, self._last = last.device, layers, last

        def empty(n: int) -> torch.Tensor:
            return torch.zeros((n, size), dtype=torch.float64, device=device)
        widths = [layers[0][0].shape[1], *(len(weight) for weight, _ in layers)]
        self.inputs, *self._values = map(empty, widths)
        self.gradient, *self._slopes = map(empty, widths)
        self._one = torch.ones((), dtype=torch.float64, device=device)
        self._activate = {'tanh': self._tanh, 'sine': self._sine, 'softplus': self._softplus,
                          'relu': self._relu}[activation]
        self.run = captured(self._propagate, device)

    def _propagate(self) -> None:
        """Compute the gradient in place."""
        (first, bias), rest = self._layers[0], list(zip(
            self._layers, self._values, self._slopes, strict=True))
        torch.addmm(bias, first, self.inputs, out=self._values[0])
        self._activate(self._values[0], self._slopes[0])
        for (_, before, _), ((weight, bias), value, slope) in pairwise(rest):
            torch.addmm(bias, weight, before, out=value)
            self._activate(value, slope)
        torch.mul(self._slopes[-1], self._last, out=self._slopes[-1])
        # Reuse the arrays of values, which are no longer needed, for backpropagation.
        for ((weight, _), _, slope), (_, value, before) in pairwise(reversed(rest)):
            torch.mm(weight.T, slope, out=value)
            torch.mul(before, value, out=before)
        torch.mm(first.T, self._slopes[0], out=self.gradient)

    def _tanh(self, z: torch.Tensor, slope: torch.Tensor) -> None:
        torch.tanh(z, out=z)
        torch.addcmul(self._one, z, z, value=-1.0, out=slope)

    def _sine(self, z: torch.Tensor, slope: torch.Tensor) -> None:
        torch.cos(z, out=slope)
        torch.sin(z, out=z)

    def _softplus(self, z: torch.Tensor, slope: torch.Tensor) -> None:
        torch.sigmoid(z, out=slope)
        # Use max(z, 0) + log(1 + exp(-abs(z))), which is accurate to all digits.
        positive = z.clamp_min(0.0)
        torch.add(positive, z.abs_().neg_().exp_().log1p_(), out=z)

    def _relu(self, z: torch.Tensor, slope: torch.Tensor) -> None:
        # Propagate NaN.
        torch.where(z > 0.0, self._one, torch.where(z <= 0.0, 0.0 * self._one, z), out=slope)
        torch.clamp_min(z, 0.0, out=z)


def captured(run: Callable[[], None], device: torch.device) -> Callable[[], Any]:
    """
    Return a function that repeats a run on the same arrays: on a GPU by one CUDA graph launch.

    Parameters
    ----------
    run : callable
        Function that uses fixed arrays and does not synchronise.
    device : torch.device
        Device of the arrays.

    """
    if device.type != 'cuda':
        return run
    stream = torch.cuda.Stream(device)
    stream.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(stream):
        for _ in range(_WARM_UP_RUNS):
            run()
    torch.cuda.current_stream(device).wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    # Use a stream of this device: the default one belongs to the device that captured first.
    with torch.cuda.device(device), torch.cuda.graph(graph, stream=stream):
        run()
    return graph.replay
