# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of samples and steps: energy error, drift and scale, local error."""

import math
from typing import Any

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.phase_space import angle_columns
from hnn_vi_ros.simulation import Simulation
import numpy as np


def local_error(simulation: Simulation) -> float:
    """
    Return the estimated error that the next step of a simulation adds, and leave it unchanged.

    A step of h and two of h / 2 from the same state differ by (1 - 2^-p) of the error of the
    first, up to terms of higher order, with p the order of the method:

        e = max abs(z_h - z_(h/2, h/2)) / (1 - 2^-p)

    Parameters
    ----------
    simulation : Simulation
        In any state; it continues bit-identically.

    Returns
    -------
    float
        The largest error of a coordinate or momentum, in its own unit; NaN where such a step
        fails, and where a thermostat makes each step another one.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.4.

    """
    if any(label.partition('_')[0] == 'thermostat' for label in simulation.works):
        return math.nan
    h, start = simulation.step_size, simulation.snapshot()
    try:
        once, twice = (np.concatenate(simulation.trial(start, h / parts, parts))
                       for parts in (1, 2))
    except StepFailure:
        return math.nan
    difference = float(np.abs(once - twice).max())
    return difference / (1.0 - 0.5 ** simulation.integrator.order)


# Share of the state over which to difference H where (q, p) is not canonical: truncation and
# rounding are both some 1e-6.
_SCALE_SPACING = 1e-5
# With this many samples, their mean represents the mean over the path; fewer may all lie at a
# turning point.
_MEAN = 8


class EnergyScale:
    """
    Follow the energy scale of a path, sample by sample.

    The virial p . H_p is twice the kinetic energy. Of a bounded motion its mean over time is that
    of (q - c) . H_q about any c as well, so it measures kinetic and potential energy alike, and
    neither a constant in H nor an offset of q changes it; in a magnetic field p is meant as the
    momentum of the velocity. The scale is

        E_s(t) = (1 / t) integral over the path so far of abs(p . H_p)

    from when p . H_p has fallen, from its largest value, by its mean, and samples are enough for a
    mean: energy has been turned over once. Before, a start at rest would have no scale. Until
    then it is the largest value so far
    of (abs((q - c) . H_q) + abs(p . H_p)) / 2 with c the middle of the training box, 0 where
    there is none; angles count modulo a turn about c.

    A mean over the path keeps a motion that rests near a saddle from having the scale of that
    rest, which a minimum over short blocks would take; and a close encounter at the start weighs
    by the time that it takes.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of d coordinates.

    Attributes
    ----------
    value : float
        E_s as of the last sample [J]; 0 as long as neither q nor p has any.
    turned : bool
        Whether energy has been turned over.

    References
    ----------
    H. Goldstein, Classical Mechanics, 1980, section 3.4 (the virial theorem).

    """

    def __init__(self, hamiltonian: Hamiltonian):
        self._hamiltonian, self.value = hamiltonian, 0.0
        box = hamiltonian.box
        middle = np.zeros(hamiltonian.dimension) if box is None else box[0].mean(axis=1)
        angles = angle_columns(hamiltonian.coordinates)
        # None skips the shift where all its numbers are zero.
        self._middle = middle if middle.any() else None
        self._angles = angles if angles.any() else None
        self._gauge = hamiltonian.gauge
        self._sum, self._time, self._largest, self._first = 0.0, 0.0, 0.0, 0.0
        self._count = 0
        self.turned = False

    def add(self, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray,
            weight: float = 1.0) -> float:
        """
        Take the next sample; return the scale [J].

        Parameters
        ----------
        q, p : np.ndarray, shape (d,) or (m, d)
            The state, or m states, whose energies add up.
        dH_dq, dH_dp : np.ndarray, of the shape of q
            -p' and q' there.
        weight : float, optional
            Time since the sample before, in any unit.

        """
        p, dH_dq = self._ungauged(q, p, dH_dq, dH_dp)
        if self.turned:
            virial = self._virial(q, p, dH_dp)
        else:
            potential, virial = self._both(q, p, dH_dq, dH_dp)
            self._first = max(self._first, 0.5 * (potential + virial))
        # A value that is not finite is not in play; the energy itself shows it.
        if math.isfinite(virial):
            self._sum += weight * virial
            self._time += weight
            self._largest = max(self._largest, virial)
            self._count += 1
            mean = self._sum / self._time
            self.turned = self.turned or (
                self._count >= _MEAN and self._largest - virial >= mean > 0.0)
            self.value = mean if self.turned else self._first
        return self.value

    def ahead(self, p: np.ndarray, dH_dp: np.ndarray, weights: np.ndarray
              ) -> tuple[np.ndarray, tuple[float, float, float, int]] | None:
        """
        Return the scale at each of the next k samples [J], and what ``take`` needs to take them.

        None where they must be added one by one: before energy has been turned over, and where a
        virial is more than a product.

        Parameters
        ----------
        p, dH_dp : np.ndarray, shape (k, d)
            Their momenta and velocities.
        weights : np.ndarray, shape (k,)
            As of ``add``.

        """
        if not (self.turned and self._hamiltonian.canonical and self._gauge is None):
            return None
        # Products and sums in the order of ``add``, so that all bits are the same.
        virial = np.abs(p[:, 0] * dH_dp[:, 0]) if p.shape[1] == 1 else np.array(
            [abs(float(np.vdot(*pair))) for pair in zip(p, dH_dp, strict=True)])
        if not np.isfinite(virial).all():
            return None
        sums = np.add.accumulate(np.concatenate([[self._sum], weights * virial]))[1:]
        times = np.add.accumulate(np.concatenate([[self._time], weights]))[1:]
        return sums / times, (float(sums[-1]), float(times[-1]),
                              max(self._largest, float(virial.max())), self._count + len(p))

    def take(self, ahead: tuple[float, float, float, int]) -> None:
        """Take the samples that ``ahead`` was asked for."""
        self._sum, self._time, self._largest, self._count = ahead
        self.value = self._sum / self._time

    def least(self, weights: np.ndarray, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> np.ndarray:
        """
        Return the least value along each of m paths of a canonical H, after the first sample.

        Parameters
        ----------
        weights : np.ndarray, shape (n,)
            See ``add``.
        q, p, dH_dq, dH_dp : np.ndarray, shape (n, m, d)
            The paths, at n >= 2 samples, all finite.

        Returns
        -------
        np.ndarray, shape (m,)
            [J].

        """
        p, dH_dq = self._ungauged(q, p, dH_dq, dH_dp)
        potential = np.abs(np.einsum('nmd,nmd->nm', self._offset(q), dH_dq))
        virial = np.abs(np.einsum('nmd,nmd->nm', p, dH_dp))
        mean = np.cumsum(weights[:, None] * virial, axis=0) / np.cumsum(weights)[:, None]
        falls = np.maximum.accumulate(virial, axis=0) - virial >= mean
        falls[:_MEAN - 1] = False
        turned = np.logical_or.accumulate(falls & (mean > 0.0), axis=0)
        first = np.maximum.accumulate(0.5 * (potential + virial), axis=0)
        return np.where(turned, mean, first)[1:].min(axis=0)

    def _ungauged(self, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray]:
        """Return P = p - c A(q) and its H_q: far from where A vanishes p . H_p is c A . v."""
        if self._gauge is None:
            return p, dH_dq
        return p - q @ self._gauge.T, dH_dq + dH_dp @ self._gauge

    def _virial(self, q: np.ndarray, p: np.ndarray, dH_dp: np.ndarray) -> float:
        """Return abs(p . H_p) [J]."""
        if self._hamiltonian.canonical:
            return abs(float(np.vdot(p, dH_dp)))
        return abs(self._slope(q, p, np.zeros_like(q), p))

    def _both(self, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray
              ) -> tuple[float, float]:
        """Return abs((q - c) . H_q) and abs(p . H_p) [J]."""
        x = self._offset(q)
        if self._hamiltonian.canonical:
            return abs(float(np.vdot(x, dH_dq))), self._virial(q, p, dH_dp)
        return abs(self._slope(q, p, x, np.zeros_like(p))), self._virial(q, p, dH_dp)

    def _offset(self, q: np.ndarray) -> np.ndarray:
        """Return q from the middle of the box."""
        x = q if self._middle is None else q - self._middle
        if self._angles is None:
            return x
        return np.where(self._angles, np.remainder(x + np.pi, 2.0 * np.pi) - np.pi, x)

    def _slope(self, q: np.ndarray, p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray) -> float:
        """Return H' (v_q, v_p) by differences, for a kernel that gives no gradient of H."""
        ahead, behind = self._hamiltonian.energy(
            np.array([q + _SCALE_SPACING * v_q, q - _SCALE_SPACING * v_q]),
            np.array([p + _SCALE_SPACING * v_p, p - _SCALE_SPACING * v_p]))
        return float(np.sum(ahead - behind)) / (2.0 * _SCALE_SPACING)


def energy_scale(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray) -> float:
    """
    Return the energy scale of a path [J]; see EnergyScale.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of d coordinates.
    q, p : np.ndarray, shape (N, d)
        States at equal distances in time.

    """
    scale = EnergyScale(hamiltonian)
    for sample in zip(q, p, *hamiltonian.gradient(q, p), strict=True):
        scale.add(*sample)
    return scale.value


_EPS = float(np.finfo(np.float64).eps)


def energy_band(error: np.ndarray) -> float:
    """Return the largest absolute value of an energy error; NaN if it holds one."""
    return float(np.abs(error).max(initial=0.0))


def secular_change(values: np.ndarray) -> float:
    """
    Return the least-squares slope of equally distant values, times their whole run.

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
    Return how far rounding alone may carry the energy, eight times its standard deviation [J].

    A step solved to 8 eps leaves errors of that share of the scale; they add up like a random
    walk. A band below this says nothing of the method.
    """
    return 8.0 * 8.0 * _EPS * scale * np.sqrt(steps)


def state_scales(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return over what H changes, for each entry of (q, p): its box, or the size of the state."""
    if hamiltonian.box is not None:
        return 0.5 * np.ptp(np.concatenate(hamiltonian.box), axis=1)
    # An angle that has turned over many times is no larger for that.
    angles = angle_columns(hamiltonian.coordinates)
    sizes = [float(np.abs(x).max()) or 1.0 for x in (np.where(angles, np.clip(q, -1, 1), q), p)]
    return np.repeat(sizes, (q.size, p.size))
