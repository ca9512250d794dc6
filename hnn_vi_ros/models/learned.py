# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of all trained models, as Hamiltonians."""

from abc import abstractmethod
from functools import cached_property
import warnings

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.kernels.addresses import by_address
from hnn_vi_ros.kernels.kernel import Energy, Gradient, HessianVector, Kernel, Parameters
from hnn_vi_ros.models.checkpoint import Checkpoint, Layers
from hnn_vi_ros.networks.activations import ACTIVATIONS
from hnn_vi_ros.networks.perceptron_memory import pack, PackedPerceptron
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# States of the box at which rounding is measured.
_SAMPLES = 64
_EPS = float(np.finfo(np.float64).eps)


class LearnedHamiltonian(Hamiltonian):
    """
    A Hamiltonian made of the trained networks of a model.

    A subclass gives the functions of its kernel, and its gradient in extended precision, by which
    their rounding is measured.

    Parameters
    ----------
    checkpoint : Checkpoint
        The networks and the model card.

    """

    def __init__(self, checkpoint: Checkpoint):
        self.checkpoint = checkpoint
        self.coordinates = tuple(
            Coordinate(c.name, c.q_unit, c.p_unit) for c in checkpoint.card.coordinates)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of q and of p, each (d, 2), of the data that H was learned from."""
        box = self.checkpoint.card.box
        return np.array(box.q), np.array(box.p)

    @property
    def smooth(self) -> bool:
        """Return whether the gradient of H is continuous."""
        return ACTIVATIONS[self.checkpoint.card.activation].smooth

    @property
    def provenance(self) -> dict[str, str]:
        """Return the digest of the model file."""
        return {'model_sha256': self.checkpoint.sha256}

    @property
    def scheme(self) -> tuple[str, float] | None:
        """Return the method and the step size [s] that the model was trained through, if any."""
        scheme = self.checkpoint.card.scheme
        return None if scheme is None else (scheme.integrator, scheme.step_size)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        kernel = self._kernel()
        if self._scales is None:
            # Simulations call by address too, so that they share the functions compiled here.
            called = by_address(kernel)
            self._scales = self._gradient_scale(called), self._energy_scale(called)
        gradient, energy = self._scales
        return kernel._replace(gradient_scale=gradient, energy_scale=energy)

    # Measured once: copies are the same function.
    _scales: tuple[tuple[float, float], float] | None = None

    def _packed(self, network: str, part: str = 'both') -> PackedPerceptron:
        """Return a network of (q, p), or of q or p alone, for the loops of perceptron.py."""
        return pack(*padded(self.checkpoint.networks[network], part),
                    self.checkpoint.card.activation)

    def _evaluated(self, network: str, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return outputs (m, k) and their derivatives (m, k, inputs) in extended precision."""
        value, slope, _ = ACTIVATIONS[self.checkpoint.card.activation]
        weights, biases = self.checkpoint.networks[network]
        a, slopes = x.astype(np.longdouble), []
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            z = a @ weight.T.astype(np.longdouble) + bias
            a = value(z)
            slopes.append(slope(z))
        derivative = np.tile(weights[-1].astype(np.longdouble), (len(x), 1, 1))
        for weight, slope_l in zip(weights[-2::-1], slopes[::-1], strict=True):
            derivative = (derivative * slope_l[:, None, :]) @ weight
        return a @ weights[-1].T.astype(np.longdouble) + biases[-1], derivative

    @abstractmethod
    def _kernel(self) -> Kernel:
        """Return the functions, with working memory of their own."""

    def _kernel_of(self, energy: Energy, gradient: Gradient, hessian_vector: HessianVector,
                   parameters: Parameters) -> Kernel:
        """Return a kernel of functions that are marked to be compiled."""
        return Kernel(energy, gradient, hessian_vector, parameters, self.dimension, (0.0, 0.0),
                      compiled=True, rotations=self.rotations)

    @abstractmethod
    def _extended_gradient(self, z: np.ndarray) -> np.ndarray:
        """Return (H_q, H_p) at states of shape (m, 2 d), in extended precision."""

    def _gradient_scale(self, kernel: Kernel) -> tuple[float, float]:
        """
        Return the rounding error of H_q and of H_p, in units of the unit round-off.

        It is measured against extended precision at random states of the box; a bound from the
        weights alone would grow exponentially with the depth.
        """
        d, z = self.dimension, self._samples()
        errors = np.abs(_gradient(kernel, z) - self._extended_gradient(z))
        return (4.0 * float(errors[:, :d].max()) / _EPS, 4.0 * float(errors[:, d:].max()) / _EPS)

    def _energy_scale(self, kernel: Kernel) -> float:
        """Return the rounding error of H: its jumps between states too close to differ else."""
        d, z = self.dimension, self._samples()
        near = z + 1e3 * _EPS * np.random.default_rng(1).uniform(-1.0, 1.0, z.shape)
        before, after = (np.array([
            kernel.energy(kernel.parameters, state[:d], state[d:]) for state in states])
            for states in (z, near))
        jumps = after - before - ((near - z) * _gradient(kernel, z)).sum(axis=1)
        return 4.0 * float(np.abs(jumps).max()) / _EPS

    def _samples(self) -> np.ndarray:
        """Return states of the box, shape (m, 2 d)."""
        low, high = np.concatenate(self.box).T
        return np.random.default_rng(0).uniform(low, high, (_SAMPLES, low.size))


def _gradient(kernel: Kernel, z: np.ndarray) -> np.ndarray:
    """Return (H_q, H_p) at states of shape (m, 2 d)."""
    parts = [np.ascontiguousarray(part) for part in np.split(z, 2, axis=1)]
    slopes = [np.empty_like(part) for part in parts]
    kernel.gradient(kernel.parameters, *(part.ravel() for part in (*parts, *slopes)))
    return np.hstack(slopes)


def warn_of_scheme(hamiltonian: Hamiltonian, integrator: str, step_size: float) -> None:
    """Warn if H was trained through another method, or step size [s], than it runs with."""
    if hamiltonian.scheme is None:
        return
    method, h = hamiltonian.scheme
    if integrator != method or abs(step_size - h) > 1e-9 * h:
        warnings.warn(
            f'the model was trained through {method} with step_size {h:g}, and is right for that; '
            f'it runs with {integrator} and step_size {step_size:g}', stacklevel=3)


def padded(layers: Layers, part: str) -> Layers:
    """Return a network of one ``part``, q or p, as one of both; leave one of both unchanged."""
    first, *others = layers.weights
    zero = np.zeros_like(first)
    parts = {'both': (first,), 'q': (first, zero), 'p': (zero, first)}
    return Layers((np.hstack(parts[part]), *others), layers.biases)
