# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The energy of a model along measured motions, against what the work on them accounts for."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import Effect, EffectState, Force
from hnn_vi_ros.effects.commands import Commanded
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.momenta import momentum
from hnn_vi_ros.learning.data.runs import Run
from hnn_vi_ros.models.energy_error import rows_of_each
import numpy as np
from scipy.optimize import nnls


class Balance(NamedTuple):
    """
    Energy and work along one motion, each of shape (N,).

    Parameters
    ----------
    energy : np.ndarray
        H(q, p(v)) [J].
    work : np.ndarray
        Of all forces, friction included, since the first sample [J].

    """

    energy: np.ndarray
    work: np.ndarray

    @property
    def unaccounted(self) -> np.ndarray:
        """Return H less the work, which a true model holds constant [J]."""
        return self.energy - self.work


def unaccounted(effects: Sequence[Effect]) -> list[str]:
    """Return the classes of effects whose work measured states do not tell, as that of noise."""
    return [type(effect).__name__ for effect in effects
            if not (effect.conservative or isinstance(effect, Force))]


def balance(hamiltonian: Hamiltonian, effects: Sequence[Effect], motion: Run) -> Balance:
    """
    Return energy and work along a motion.

        W(t) = integral of (H_q . f_q + H_p . f_p) dt,  f of friction and of the motors

    by the trapezoidal rule, of second order, with the smoothed states and p from H_p(q, p) = v.
    The measured forces act as in simulations: their mean over each interval.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H, with the potentials of the effects.
    effects : sequence of Effect
        Each conservative or a Force.
    motion : Run
        The measured motion.

    Raises
    ------
    ModelError
        A velocity has no momentum.

    """
    state = EffectState.empty(len(effects), hamiltonian.dimension)
    # All of them: a magnetic field's gauge is in what others take.
    resolved = [(effect, effect.resolve(hamiltonian.coordinates, state)) for effect in effects]
    motors = [(effect, own) for effect, own in resolved if isinstance(effect, Commanded)]
    friction = [(effect, own) for effect, own in resolved
                if isinstance(effect, Force) and not isinstance(effect, Commanded)]
    q = motion.q_smooth
    p = momentum(hamiltonian, q, motion.v_smooth, np.zeros_like(q))
    none = np.empty((len(q), 0))
    lost = _power(hamiltonian, friction, motion.t, q, p, none)
    # A force is the same from one end of an interval to the other.
    ends = [_power(hamiltonian, motors, motion.t[rows], q[rows], p[rows], motion.forces)
            for rows in (slice(None, -1), slice(1, None))]
    steps = 0.5 * motion.spacing * (lost[1:] + lost[:-1] + ends[0] + ends[1])
    return Balance(hamiltonian.energy(q, p), np.concatenate([[0.0], np.cumsum(steps)]))


def _power(hamiltonian: Hamiltonian, forces: Sequence[tuple[Any, Any]], t: np.ndarray,
           q: np.ndarray, p: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return the power of forces at states, shape (N,), commanded so [W]."""
    power = np.zeros(len(q))
    if not forces:
        return power
    H_q, H_p = hamiltonian.gradient(q, p)
    f_q, f_p = np.zeros((2, q.shape[1]))
    for k in range(len(q)):
        f_q[:], f_p[:] = 0.0, 0.0
        for effect, own in forces:
            if isinstance(effect, Commanded):
                effect.prepare(commands[k], own, q[k])()
            effect.add_force(own, t[k], q[k], p[k], H_p[k], f_q, f_p)
        power[k] = H_q[k] @ f_q + H_p[k] @ f_p
    return power


def energy_mismatch(balances: Sequence[Balance], spacing: float, horizons: Sequence[float]
                    ) -> dict[float, float] | None:
    """
    Return the energy that no work accounts for, as a share of the range of H.

    Parameters
    ----------
    balances : sequence of Balance
        Of motions, with samples at even times.
    spacing : float
        From one to the next [s].
    horizons : sequence of float
        Over which energies are compared, of at most the longest motion [s].

    Returns
    -------
    dict of float to float, or None
        For each horizon the root mean square, over all samples, of what H less the work changes
        by in that time, over max H - min H of all motions; None where H does not change.

    """
    energies = np.concatenate([found.energy for found in balances])
    size = float(np.ptp(energies))
    # Round-off of H is no range.
    if size <= 1e3 * np.finfo(np.float64).eps * np.abs(energies).max():
        return None
    shares = {}
    for horizon in horizons:
        k = round(horizon / spacing)
        changes = np.concatenate([
            found.unaccounted[k:] - found.unaccounted[:max(0, len(found.energy) - k)]
            for found in balances])
        shares[horizon] = float(np.sqrt(np.mean(changes**2))) / size
    return shares


def friction_work(learned: np.ndarray, trajectory: np.ndarray, t: np.ndarray, v: np.ndarray
                  ) -> tuple[np.ndarray, float]:
    """
    Fit the work of friction to energies along motions, by least squares.

        W(t) = -sum_i integral of (b_i v_i^2 + c_i abs(v_i)) dt,  b_i, c_i >= 0

    Parameters
    ----------
    learned : np.ndarray, shape (n,)
        Energies [J], in the order of time within each trajectory.
    trajectory : np.ndarray of int, shape (n,)
        Of which each state is one.
    t : np.ndarray, shape (n,)
        When [s].
    v : np.ndarray, shape (n, d)
        Velocities.

    Returns
    -------
    np.ndarray of shape (n,), and float
        W [J], from zero on in each trajectory, and the mean power that friction takes [W].

    """
    columns = integrated(np.hstack([v**2, np.abs(v)]), trajectory, t)
    centred, energies, duration = columns.copy(), learned.copy(), 0.0
    for rows in rows_of_each(trajectory):
        centred[rows] -= columns[rows].mean(axis=0)
        energies[rows] -= energies[rows].mean()
        duration += t[rows[-1]] - t[rows[0]]
    # In units of their own: nnls judges by absolute sizes.
    units = np.sqrt(np.mean(centred**2, axis=0))
    units[units == 0.0] = 1.0
    coefficients = nnls(centred / units, -energies)[0] / units
    work = -columns @ coefficients
    lost = sum(work[rows[0]] - work[rows[-1]] for rows in rows_of_each(trajectory))
    return work, float(lost / duration) if duration > 0.0 else 0.0


def integrated(rates: np.ndarray, trajectory: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return integrals over time, shape (n, k), from zero on in each trajectory (trapezoids)."""
    integral = np.zeros_like(rates)
    for rows in rows_of_each(trajectory):
        steps = 0.5 * np.diff(t[rows])[:, None] * (rates[rows[1:]] + rates[rows[:-1]])
        integral[rows[1:]] = np.cumsum(steps, axis=0)
    return integral
