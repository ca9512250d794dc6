# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian with walls that keep states near its training box."""

from functools import cache, cached_property, lru_cache
import hashlib
from pathlib import Path
from typing import NamedTuple, Self

from hnn_vi_ros.errors import ModelError, prefixed
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import (
    by_address, composed, Energy, Functions, functions_of, Gradient, HessianVector, inlined,
    Kernel, Parameters)
from hnn_vi_ros.models.checkpoint import load_checkpoint, opened
from hnn_vi_ros.models.ensemble import load_member
import numpy as np

# Number of states on each face of the box at which the gradient is evaluated.
_FACE_SAMPLES = 64


class ConfinedParameters(NamedTuple):
    """
    Parameters of the functions of a confined Hamiltonian, their first argument.

    Parameters
    ----------
    base : Parameters
        Parameters of the base, by address.
    walls : np.ndarray, shape (2 d, 3)
        For each coordinate, then each momentum: the ends of its interval, and K [J].

    """

    base: Parameters
    walls: np.ndarray


class ConfinedHamiltonian(Hamiltonian):
    """
    H(z) + sum_i K_i (phi(y(q_i)) + phi(y(p_i))): H in the box, and a convex wall around it.

    y(x) = (abs(x - c) - w) / w is the distance of x from its interval of centre c and half-width
    w, in half-widths, and

        phi(y) = 0 for y <= 0,  y^4 / (2 (1 + y^2)) for y > 0,

    is convex, three times continuously differentiable, with phi'' <= 5/4 and phi ~ y^2 / 2 far
    away. In the box H is unchanged to the last bit. K_i = max(w_q G_q, w_p G_p), where G is the
    largest absolute derivative of H by that coordinate or momentum on the faces of the box: K_i is
    the change of H over a half-width. One half-width outside, the wall repels with at least 3/4 of
    G, increasing outwards; its frequencies K_i phi'' / (w_q w_p) are similar to those in the box.

    A tanh network does not confine states: its gradient vanishes far away, and abs(H - b) <= B,
    with b its last bias and B the sum of its absolute last weights. At energy E the wall confines
    each coordinate and momentum to K_i phi(y) <= E - b + B. Motions outside the box remain
    extrapolations. An angle is confined like any other coordinate: it cannot rotate freely. Use it
    for long runs of models that leave their box.

    Parameters
    ----------
    base : Hamiltonian
        A Hamiltonian with a box.

    Raises
    ------
    ModelError
        Its coordinates are not canonical, or include rotations.
    ValueError
        It has no box.

    Attributes
    ----------
    energies : np.ndarray, shape (d,)
        K [J].

    """

    box: tuple[np.ndarray, np.ndarray]

    def __init__(self, base: Hamiltonian):
        if base.box is None:
            raise ValueError(f'{type(base).__name__} has no training domain to confine states to')
        if not base.canonical:
            raise ModelError('confine: walls need canonical momenta, which this model does not '
                             'have; remove confine')
        if base.rotations:
            raise ModelError('confine: walls need scalar coordinates, but this model has an '
                             'attitude; remove confine')
        self.base, self.coordinates, self.separable = base, base.coordinates, base.separable
        self.box, self.smooth, self.scheme = base.box, base.smooth, base.scheme
        self.provenance = base.provenance | {'confined': 'to its training box'}
        self.energies = self._wall_energies()

    def copy(self) -> Self:
        """Return the same function with its own workspace."""
        other = super().copy()
        other.base = self.base.copy()
        return other

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        base = by_address(self.base.kernel)
        walls = np.column_stack([np.concatenate(self.box), np.tile(self.energies, 2)])
        return composed(base, _confined(*functions_of(base)), (ConfinedHamiltonian,),
                        ConfinedParameters(base.parameters, walls))

    def _wall_energies(self) -> np.ndarray:
        """Return K of each degree of freedom [J], from states on the faces of the box."""
        d = self.dimension
        low, high = np.concatenate(self.box).T
        z = np.random.default_rng(0).uniform(low, high, (2, 2 * d, _FACE_SAMPLES, 2 * d))
        for i in range(2 * d):
            z[0, i, :, i], z[1, i, :, i] = low[i], high[i]
        gradient = np.concatenate(self.base.gradient(z[..., :d], z[..., d:]), axis=-1)
        largest = np.abs(gradient).max(axis=(0, 1, 2))
        return (0.5 * (high - low) * largest).reshape(2, d).max(axis=0)


def load_learned(model: Path, confine: bool | None = None, member: int | None = None
                 ) -> Hamiltonian:
    """
    Return the Hamiltonian of a model file.

    Parameters
    ----------
    model : Path
        Path of the model; for errors see ``load_checkpoint``.
    confine : bool, optional
        True to confine states to the training box; by default as in its model card.
    member : int, optional
        Member of an ensemble, from 1 on, instead of the mean of all.

    """
    with opened(model) as stream:
        digest = hashlib.file_digest(stream, 'sha256').hexdigest()
    return _learned(model, digest, confine, member).copy()


@lru_cache(maxsize=4)
def _learned(model: Path, digest: str, confine: bool | None, member: int | None) -> Hamiltonian:
    """Return the Hamiltonian of a file with this content; simulations copy it."""
    checkpoint = load_checkpoint(model, ensembles=True)
    if checkpoint.sha256 != digest:
        raise ModelError(f'{model}: changed while it was read; try again')
    with prefixed(str(model), ModelError, ModelError):
        learned = load_member(checkpoint, member)
        if checkpoint.card.confine if confine is None else confine:
            return ConfinedHamiltonian(learned)
    return learned


# Parameters are not unpacked into names: each named array is reference-counted in every call.
@cache
def _confined(base_energy: Energy, base_gradient: Gradient, base_hessian_vector: HessianVector
              ) -> Functions:
    def energy(parameters: ConfinedParameters, q: np.ndarray, p: np.ndarray) -> float:
        total, walls, d = base_energy(parameters.base, q, p), parameters.walls, q.size
        for i in range(d):
            total += _wall(walls, i, q[i])[0] + _wall(walls, d + i, p[i])[0]
        return total

    def gradient(parameters: ConfinedParameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                 dH_dp: np.ndarray) -> None:
        base_gradient(parameters.base, q, p, dH_dq, dH_dp)
        walls = parameters.walls
        d = walls.shape[0] // 2
        for k in range(q.size):
            dH_dq[k] += _wall(walls, k % d, q[k])[1]
            dH_dp[k] += _wall(walls, d + k % d, p[k])[1]

    def hessian_vector(parameters: ConfinedParameters, q: np.ndarray, p: np.ndarray,
                       v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                       product_p: np.ndarray) -> None:
        base_hessian_vector(parameters.base, q, p, v_q, v_p, product_q, product_p)
        walls = parameters.walls
        d = walls.shape[0] // 2
        for k in range(q.size):
            product_q[k] += _wall(walls, k % d, q[k])[2] * v_q[k]
            product_p[k] += _wall(walls, d + k % d, p[k])[2] * v_p[k]
    return energy, gradient, hessian_vector


@inlined
def _wall(walls: np.ndarray, i: int, x: float) -> tuple[float, float, float]:
    """Return K phi(y(x)) and its two derivatives by x: zeros within interval i."""
    low, high, energy = walls[i, 0], walls[i, 1], walls[i, 2]
    if low <= x <= high:
        return 0.0, 0.0, 0.0
    half = 0.5 * (high - low)
    # y has the sign of the derivative.
    y = (x - high if x > high else x - low) / half
    square = y * y
    s = square / (1.0 + square)
    return (0.5 * energy * square * s, energy / half * y * s * (2.0 - s),
            energy / (half * half) * s * (6.0 - s * (9.0 - 4.0 * s)))
