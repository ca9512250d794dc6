# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Gradients of learned Hamiltonians at many states, as matrix products that are written out.

With the columns of A_0 the states, Z_l = W_l A_(l-1) + b_l, A_l = f(Z_l), the gradient of
H = w . a_K + b is propagated back by D_K = w f'(Z_K), D_l = (W_(l+1)^T D_(l+1)) f'(Z_l), and is
W_1^T D_1: two products with each matrix, and nothing recorded.

States go through in batches of a few sizes, filled up with zeros. On the processor there is one
size for each network, so that each product is the same call, whatever the number of states, and
what comes of a state does not depend on which others there are.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.models import (
    ConfinedHamiltonian, Layers, LearnedHamiltonian, MeanHamiltonian, NeuralHamiltonian,
    SeparableHamiltonian, VariationalHamiltonian)
import numpy as np
import torch

# Numbers in an array of activations on the processor, which stays in a second-level cache; and the
# states of a batch there at most, and at least. The last is a multiple of the blocks of 8, 12, 24
# or 64 columns that BLAS multiplies at once: in the remainder it adds in another order.
_NUMBERS, _MOST, _LEAST = 80_000, 960, 192
# Sizes of batches on a GPU; each has a graph of its own.
_BUCKETS = tuple(2**k for k in range(8, 18))
# Runs before the capture: libraries allocate in the first ones.
_WARM_UP = 3
FAMILIES = 'hnn, dissipative_hnn (its energy), dgnet, separable_hnn, vin'
# (H_q, H_p), shape (2 d, m), at states (q, p) of that shape.
Gradient = Callable[[torch.Tensor], torch.Tensor]
_Slope = Callable[[torch.Tensor, torch.Tensor], None]


def dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """
    Return the sum of the products of rows, added one after another.

    ``torch.sum`` adds in an order that depends on how many trajectories there are.
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
        Whose energy is that of perceptrons of (q, p), of q, or of p.
    device : torch.device
        Where states are.

    Raises
    ------
    UnsupportedSystem
        Another H; names those that can.

    """
    def of(layers: Layers) -> PerceptronGradient:
        assert isinstance(hamiltonian, LearnedHamiltonian), 'only such have layers'
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
            # It is symmetric: its rows are its columns.
            return _sum(of(hamiltonian.checkpoint.networks['potential']),
                        lambda p: dot(inverse[..., None], p[:, None]))
    if isinstance(hamiltonian, MeanHamiltonian):
        raise UnsupportedSystem('a device takes no mean of an ensemble: leave device out, or take '
                                'one of its members, with member: K in hamiltonian')
    name = f'a model of the family {hamiltonian.checkpoint.card.family}' if isinstance(
        hamiltonian, LearnedHamiltonian) else type(hamiltonian).__name__
    raise UnsupportedSystem(f'{name} is not an H of perceptrons alone, as a device takes it; '
                            f'leave device out, or take a learned model of one of: {FAMILIES}')


def _sum(of_q: Gradient, of_p: Gradient) -> Gradient:
    """Return the gradient of V(q) + T(p)."""
    def gradient(z: torch.Tensor) -> torch.Tensor:
        q, p = z.chunk(2)
        return torch.cat([of_q(q), of_p(p)])
    return gradient


def _confined(base: Gradient, hamiltonian: ConfinedHamiltonian, device: torch.device) -> Gradient:
    """Return the gradient with the walls of ConfinedHamiltonian, which has the formula."""
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
    The gradient of a network by its inputs.

    Parameters
    ----------
    layers : Layers
        The network, of one output.
    activation : str
        What stands between its layers.
    device : torch.device
        Where states are.

    """

    def __init__(self, layers: Layers, activation: str, device: torch.device):
        self._device, self._activation = device, activation
        *weights, last = (torch.from_numpy(np.ascontiguousarray(w)).to(device)
                          for w in layers.weights)
        biases = (torch.from_numpy(b).to(device) for b in layers.biases[:-1])
        self._layers = list(zip(weights, (b[:, None] for b in biases), strict=True))
        self._last, self._inputs = last.T.contiguous(), layers.weights[0].shape[1]
        widest = max(len(w) for w in weights)
        size = max(min(_NUMBERS // widest, _MOST) // _LEAST, 1) * _LEAST
        self._buckets = _BUCKETS if device.type == 'cuda' else (size,)
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
        """Cut m states into batches; yield where each begins and ends, and its size."""
        first = 0
        while first < m:
            size = next((s for s in self._buckets if s >= m - first), self._buckets[-1])
            yield first, min(first + size, m), size
            first += size


class _Batch:
    """The passes of a fixed number of states, in arrays that stay where they are."""

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
        """Fill the gradient."""
        (first, bias), rest = self._layers[0], list(zip(
            self._layers, self._values, self._slopes, strict=True))
        torch.addmm(bias, first, self.inputs, out=self._values[0])
        self._activate(self._values[0], self._slopes[0])
        for (_, before, _), ((weight, bias), value, slope) in pairwise(rest):
            torch.addmm(bias, weight, before, out=value)
            self._activate(value, slope)
        torch.mul(self._slopes[-1], self._last, out=self._slopes[-1])
        # The values are not needed again: in their place what is propagated back.
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
        # max(z, 0) + log(1 + exp(-abs(z))), which holds all digits.
        positive = z.clamp_min(0.0)
        torch.add(positive, z.abs_().neg_().exp_().log1p_(), out=z)

    def _relu(self, z: torch.Tensor, slope: torch.Tensor) -> None:
        # NaN stays NaN.
        torch.where(z > 0.0, self._one, torch.where(z <= 0.0, 0.0 * self._one, z), out=slope)
        torch.clamp_min(z, 0.0, out=z)


def captured(run: Callable[[], None], device: torch.device) -> Callable[[], Any]:
    """
    Return what repeats a run on the same arrays: on a GPU a CUDA graph, launched as a whole.

    Parameters
    ----------
    run : callable
        Works on arrays that stay where they are, and waits for nothing.
    device : torch.device
        Of the arrays.

    """
    if device.type != 'cuda':
        return run
    stream = torch.cuda.Stream(device)
    stream.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(stream):
        for _ in range(_WARM_UP):
            run()
    torch.cuda.current_stream(device).wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    # On a stream of this device: the default one is of whichever device captured first.
    with torch.cuda.device(device), torch.cuda.graph(graph, stream=stream):
        run()
    return graph.replay
