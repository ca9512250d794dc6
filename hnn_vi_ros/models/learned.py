# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of all trained models, as Hamiltonians."""

from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any
import warnings

from hnn_vi_ros.hamiltonians import compiled_kernel, Hamiltonian
from hnn_vi_ros.kernels import by_address, Energy, Gradient, HessianVector, Kernel, Parameters
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.networks.activations import SMOOTH
from hnn_vi_ros.models.networks.layers import Layers
from hnn_vi_ros.models.networks.perceptron_memory import pack, PackedPerceptron
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Number of states of the box at which rounding is measured.
SAMPLES = 64
_EPS = float(np.finfo(np.float64).eps)
# Distance of the states of a second difference, relative to the largest.
_SPACING = 1e3 * _EPS


class LearnedHamiltonian(Hamiltonian):
    """
    A Hamiltonian of the trained networks of a model.

    A subclass defines the functions of its kernel; their rounding error is measured.

    Parameters
    ----------
    checkpoint : Checkpoint
        The networks and the model card.

    """

    box: tuple[np.ndarray, np.ndarray]

    def __init__(self, checkpoint: Checkpoint):
        card = checkpoint.card
        self.checkpoint = checkpoint
        self.coordinates = tuple(Coordinate(c.name, c.q_unit, c.p_unit) for c in card.coordinates)
        self.box = np.array(card.box.q), np.array(card.box.p)
        self.smooth = SMOOTH[card.activation]
        self.provenance = {'model_sha256': checkpoint.sha256}
        if card.scheme is not None:
            self.scheme = card.scheme.integrator, card.scheme.step_size
        # Results that copies share: they are the same function.
        self._shared = dict[str, Any]()

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        kernel = self._kernel()
        if 'scales' not in self._shared:
            # Simulations also call by address, so that they share the functions compiled here.
            called, z, d = by_address(kernel), self._samples(), self.dimension
            slopes = rounding(lambda z: np.hstack(
                [*called.slopes(*_flat(z)).reshape(2, -1, d)]), z)
            (values,) = rounding(lambda z: called.energies(*_flat(z))[:, None], z)
            self._shared['scales'] = (
                (float(slopes[:d].max()), float(slopes[d:].max())), float(values))
        gradient, energy = self._shared['scales']
        return kernel._replace(gradient_scale=gradient, energy_scale=energy)

    def _packed(self, network: str, part: str = 'both') -> PackedPerceptron:
        """Return a network of (q, p), or of only q or p, for the loops of perceptron.py."""
        return pack(*padded(self.checkpoint.networks[network], part),
                    self.checkpoint.card.activation)

    @abstractmethod
    def _kernel(self) -> Kernel:
        """Return the functions, with their own workspace."""

    def _kernel_of(self, energy: Energy, gradient: Gradient, hessian_vector: HessianVector,
                   parameters: Parameters) -> Kernel:
        """Return a kernel of these functions, compiled."""
        return compiled_kernel((energy, gradient, hessian_vector), parameters, self.dimension,
                               rotations=self.rotations)

    def _samples(self, count: int = SAMPLES) -> np.ndarray:
        """Return random states of the box, shape (count, 2 d)."""
        low, high = np.concatenate(self.box).T
        return np.random.default_rng(0).uniform(low, high, (count, low.size))


def rounding(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """
    Return a bound on the rounding errors of a function, in units of the unit round-off.

    The bound is twice the largest f(z + e) - 2 f(z) + f(z - e), for e so small that the second
    difference of the exact f is far below its rounding. Its standard deviation is 6^(1/2) times
    that of one rounding error. A bound from the weights would grow exponentially with the layers.

    Parameters
    ----------
    function : callable
        Function that returns k values at each of m states, shape (m, k).
    z : np.ndarray, shape (m, 2 d)
        The states.

    Returns
    -------
    np.ndarray, shape (k,)
        The bound of each value, over all states.

    """
    e = _SPACING * np.abs(z).max(axis=0) * np.random.default_rng(1).uniform(-1.0, 1.0, z.shape)
    ahead = z + e
    # 2 z - ahead is exact: the three states are evenly spaced.
    bend = function(ahead) - 2.0 * function(z) + function(2.0 * z - ahead)
    return 2.0 / _EPS * np.abs(bend).max(axis=0)


def _flat(z: np.ndarray) -> list[np.ndarray]:
    """Return q and p, each of shape (m d,), of states of shape (m, 2 d)."""
    return [part.ravel() for part in np.split(z, 2, axis=1)]


def warn_of_scheme(hamiltonian: Hamiltonian, integrator: str, step_size: float) -> None:
    """Warn if H was trained through another method or step size [s] than in this run."""
    if hamiltonian.scheme is None:
        return
    method, h = hamiltonian.scheme
    if integrator != method or abs(step_size - h) > 1e-9 * h:
        warnings.warn(
            f'the model was trained through {method} with step_size {h:g} s, and is valid for it; '
            f'it runs with {integrator} and step_size {step_size:g} s', stacklevel=3)


def padded(layers: Layers, part: str) -> Layers:
    """Return a network of one ``part``, q or p, extended to both; one of both is unchanged."""
    if part == 'both':
        return layers
    n = layers.widths[0]
    return layers.widened(2 * n, range(n) if part == 'q' else range(n, 2 * n))
