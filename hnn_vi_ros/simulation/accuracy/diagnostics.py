# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Quality measures of samples and steps: energy error, drift and scale, local error."""

import math
from typing import Any

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.phase_space import angle_columns
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np
from numpy.typing import ArrayLike


def local_error(simulation: Simulation) -> float:
    """
    Return the estimated local error of the next step, and leave the simulation unchanged.

    One step of h and two of h / 2 from the same state differ by (1 - 2^-p) times the error of
    the former, up to terms of higher order, where p is the order of the method:

        e = max abs(z_h - z_(h/2, h/2)) / (1 - 2^-p)

    Parameters
    ----------
    simulation : Simulation
        Simulation in any state; it continues bit-identically.

    Returns
    -------
    float
        The largest error of a coordinate or momentum, in its own unit; NaN if a step fails or
        if a thermostat makes steps random.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.4.

    """
    if any(label.partition('_')[0] == 'thermostat' for label in simulation.works):
        return math.nan
    h, start = simulation.step_size, simulation.row
    try:
        once, twice = (np.hstack(simulation.probe.trial(start, h / parts, every=parts))
                       for parts in (1, 2))
    except StepFailure:
        return math.nan
    difference = float(np.abs(once - twice).max())
    return difference / (1.0 - 0.5 ** simulation.integrator.order)


# Relative spacing of finite differences of H if (q, p) is not canonical: truncation and rounding
# errors are both about 1e-6.
_SCALE_SPACING = 1e-5
# Minimum number of samples for a representative mean; fewer may all lie at a turning point.
_MIN_MEAN_SAMPLES = 8
# Length of the record of a path: integral of the virial, time, largest virial, number of samples,
# initial scale, flag that energy has been exchanged once.
RECORD = 6


@kept(error_model='numpy')
def follow(record: np.ndarray, potential: float, virial: float, weight: float
           ) -> tuple[float, bool]:
    """Add the next sample of a path; return the scale, and whether energy was exchanged once."""
    # Skip non-finite values; the energy itself reveals them.
    if math.isfinite(virial):
        record[0] += weight * virial
        record[1] += weight
        record[2] = max(record[2], virial)
        record[3] += 1.0
        if 0.5 * (potential + virial) > record[4]:
            record[4] = 0.5 * (potential + virial)
        mean = record[0] / record[1]
        if record[3] >= _MIN_MEAN_SAMPLES and record[2] - virial >= mean > 0.0:
            record[5] = 1.0
    turned = record[5] > 0.0
    return (record[0] / record[1] if turned else record[4]), turned


@kept(error_model='numpy')
def _follow_all(records: np.ndarray, potential: np.ndarray, virial: np.ndarray,
                weights: np.ndarray, scales: np.ndarray) -> None:
    for i in range(len(weights)):
        for k in range(len(records)):
            scales[i, k], _ = follow(records[k], potential[i, k], virial[i, k], weights[i])


@kept(error_model='numpy')
def _virials(q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray,
             middle: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return abs((q - c) . H_q) and abs(p . H_p) at n states, shape (2, n)."""
    virials = np.zeros((2, len(q)))
    for i in range(len(q)):
        for j in range(q.shape[1]):
            x = q[i, j] - middle[j]
            if angles[j]:
                x = (x + math.pi) % (2.0 * math.pi) - math.pi
            virials[0, i] += x * dH_dq[i, j]
        for j in range(p.shape[1]):
            virials[1, i] += p[i, j] * dH_dp[i, j]
    return np.abs(virials)


class EnergyScale:
    """
    Energy scale of a path, or of m paths, from the virials of its states.

    The virial p . H_p is twice the kinetic energy. For a bounded motion its time average equals
    that of (q - c) . H_q for any c, so it measures kinetic and potential energy alike, and is
    independent of constants in H and offsets of q; in a magnetic field p is the kinetic momentum.
    The scale is

        E_s(t) = (1 / t) integral over the path so far of abs(p . H_p)

    once there are enough samples for a mean and p . H_p has fallen from its maximum by at least
    its mean: kinetic and potential energy have been exchanged once. Before that, when a start at
    rest would have no scale, it is the largest value so far of
    (abs((q - c) . H_q) + abs(p . H_p)) / 2, where c is the centre of the training box, or 0 if
    there is none; angles are taken modulo one turn about c.

    Averaging over the path prevents a rest near a saddle from setting the scale, as a minimum
    over short blocks would; and it weights a close encounter at the start by its duration.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of d coordinates.

    References
    ----------
    H. Goldstein, Classical Mechanics, 1980, section 3.4 (the virial theorem).

    """

    def __init__(self, hamiltonian: Hamiltonian):
        self._hamiltonian = hamiltonian
        box = hamiltonian.box
        self._middle = np.zeros(hamiltonian.dimension) if box is None else box[0].mean(axis=1)
        self._angles = angle_columns(hamiltonian.coordinates)
        self._gauge = hamiltonian.gauge

    def virials(self, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray]:
        """Return abs((q - c) . H_q) and abs(p . H_p) [J], shape (...), at states (..., d)."""
        if self._gauge is not None:
            # Use P = p - c A(q) and its H_q: far from the zero of A, p . H_p is mostly c A . v.
            p, dH_dq = p - q @ self._gauge.T, dH_dq + dH_dp @ self._gauge
        if self._hamiltonian.canonical:
            q_, p_, H_q, H_p = (np.ascontiguousarray(x).reshape(-1, x.shape[-1])
                                for x in (q, p, dH_dq, dH_dp))
            potential, virial = _virials(q_, p_, H_q, H_p, self._middle, self._angles)
            return potential.reshape(q.shape[:-1]), virial.reshape(q.shape[:-1])
        x = q - self._middle
        x = np.where(self._angles, np.remainder(x + np.pi, 2.0 * np.pi) - np.pi, x)
        zero = np.zeros_like(q)
        return np.abs(self._slope(q, p, x, zero)), np.abs(self._slope(q, p, zero, p))

    def _slope(self, q: np.ndarray, p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray) -> np.ndarray:
        """Return H' (v_q, v_p) by central differences, if the kernel has no gradient of H."""
        ahead, behind = self._hamiltonian.energy(
            np.array([q + _SCALE_SPACING * v_q, q - _SCALE_SPACING * v_q]),
            np.array([p + _SCALE_SPACING * v_p, p - _SCALE_SPACING * v_p]))
        return np.asarray(ahead - behind) / (2.0 * _SCALE_SPACING)


def energy_scale(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray, t: ArrayLike = 0.0
                 ) -> float:
    """
    Return the energy scale of a path [J]; see EnergyScale.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of d coordinates.
    q, p : np.ndarray, shape (N, d)
        States at equidistant times.
    t : array_like, shape (N,), optional
        These times, for an H that depends on them [s].

    """
    return float(scales_along(hamiltonian, q, p, np.ones(len(q)), t)[-1])


def scales_along(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray, weights: np.ndarray,
                 t: ArrayLike = 0.0) -> np.ndarray:
    """Return the energy scale [J], shape (k,) or (k, m), along paths (k, d) or (k, m, d)."""
    return scales_of(
        *EnergyScale(hamiltonian).virials(q, p, *hamiltonian.gradient(q, p, t)), weights)


def scales_of(potential: np.ndarray, virial: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """
    Return the energy scale [J] at k samples of m paths, with the shape of `virial`.

    Parameters
    ----------
    potential, virial : np.ndarray, shape (k,) or (k, m)
        See EnergyScale.virials.
    weights : np.ndarray, shape (k,)
        Time since the previous sample, in any unit.

    """
    rows = virial.reshape(len(weights), -1)
    scales = np.empty(rows.shape)
    _follow_all(np.zeros((rows.shape[1], RECORD)), potential.reshape(rows.shape), rows, weights,
                scales)
    return scales.reshape(virial.shape)


_EPS = float(np.finfo(np.float64).eps)


def energy_band(error: np.ndarray) -> float:
    """Return the largest absolute value of an energy error; NaN if it contains NaN."""
    return float(np.abs(error).max(initial=0.0))


def secular_change(values: np.ndarray) -> float:
    """
    Return the least-squares slope of equidistant values, times their total length.

    Parameters
    ----------
    values : np.ndarray, shape (n,)
        The block maxima of an energy error give the energy drift over the run.

    """
    if values.size < 2 or not np.isfinite(values).all():
        return float('nan') if values.size > 1 else 0.0
    x = np.linspace(-0.5, 0.5, values.size)
    return float(x @ values / (x @ x))


def rounding_walk(scale: Any, steps: Any) -> Any:
    """
    Return a bound of the energy error due to rounding, eight standard deviations [J].

    A step solved to 8 eps has a relative energy error of that size; these errors accumulate as a
    random walk. A smaller energy band contains no information about the method.
    """
    return 8.0 * 8.0 * _EPS * scale * np.sqrt(steps)


def state_scales(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the scale of each entry of (q, p): half its box, or the size of the state."""
    if hamiltonian.box is not None:
        return 0.5 * np.ptp(np.concatenate(hamiltonian.box), axis=1)
    # Clip angles: full turns do not increase their size.
    angles = angle_columns(hamiltonian.coordinates)
    sizes = [float(np.abs(x).max()) or 1.0 for x in (np.where(angles, np.clip(q, -1, 1), q), p)]
    return np.repeat(sizes, (q.size, p.size))
