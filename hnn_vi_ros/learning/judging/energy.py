# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Energy and work of a model along measured motions, and the work of unknown friction."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.effects import Commanded, Effect, EffectState, Force
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.models import rows_of_each
import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import nnls

# Least range of H, as a share of the kinetic energy, that energy mismatches can be relative to.
_LEAST_RANGE = 0.1


class EnergyBalance(NamedTuple):
    """
    Energy and work along one motion, shape (N,) each.

    Parameters
    ----------
    energy : np.ndarray
        H(q, p(v)) [J].
    work : np.ndarray
        Work of all forces, including friction, since the first sample [J].
    kinetic : np.ndarray
        v . p(v) / 2 [J].

    """

    energy: np.ndarray
    work: np.ndarray
    kinetic: np.ndarray


def unaccounted(effects: Sequence[Effect]) -> list[str]:
    """Return the classes of effects without work defined by measured states, such as noise."""
    return [type(effect).__name__ for effect in effects
            if not (effect.conservative or isinstance(effect, Force)) or effect.internal]


def balance(hamiltonian: Hamiltonian, effects: Sequence[Effect], motion: EvenMotion
            ) -> EnergyBalance:
    """
    Return energy and work along a motion.

        W(t) = integral of (H_q . f_q + H_p . f_p) dt,  f from friction and motors

    The integral uses the second-order trapezoidal rule, smoothed states, and p with H_p(q, p) = v.
    The measured forces act as in simulations, as means over each interval.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H including the potentials of the effects.
    effects : sequence of Effect
        Effects, each conservative or a Force.
    motion : EvenMotion
        The measured motion.

    Raises
    ------
    ModelError
        No momentum corresponds to some velocity.

    """
    q = motion.q_smooth
    p = momentum(hamiltonian, q, motion.v_smooth, np.zeros_like(q))
    # A command is constant over an interval; friction may depend on it.
    ends = [_power(hamiltonian, effects, motion.t[rows], q[rows], p[rows], motion.forces)
            for rows in (slice(None, -1), slice(1, None))]
    steps = 0.5 * motion.spacing * (ends[0] + ends[1])
    return EnergyBalance(hamiltonian.energy(q, p), np.concatenate([[0.0], np.cumsum(steps)]),
                         0.5 * (motion.v_smooth * p).sum(axis=1))


def _power(hamiltonian: Hamiltonian, effects: Sequence[Effect], t: np.ndarray, q: np.ndarray,
           p: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return the power of forces at states under these commands, shape (N,) [W]."""
    state = EffectState.empty(len(effects), hamiltonian.dimension)
    # Resolve all effects: some use the gauge of a magnetic field.
    resolved = [(effect, effect.resolve(hamiltonian.coordinates, state)) for effect in effects]
    forces: list[tuple[Any, Any]] = [
        (effect, own) for effect, own in resolved if isinstance(effect, Force)]
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
        for effect, own in forces:
            effect.add_force(own, t[k], q[k], p[k], H_p[k], f_q, f_p)
        power[k] = H_q[k] @ f_q + H_p[k] @ f_p
    return power


def energy_mismatch(balances: Sequence[EnergyBalance], spacing: float, horizons: Sequence[float]
                    ) -> dict[float, float] | None:
    """
    Return the energy change without matching work, relative to the range of H.

    Parameters
    ----------
    balances : sequence of Balance
        Energy and work of motions sampled at even times.
    spacing : float
        Sampling interval [s].
    horizons : sequence of float
        Times over which energies are compared, at most the longest motion [s].

    Returns
    -------
    dict of float to float, or None
        For each horizon, the RMS over all samples of the change of (H - work) in that time,
        divided by max H - min H over all motions; None if that is less than a tenth of the
        largest kinetic energy, which noise could explain.

    """
    energies, kinetic = (np.concatenate(parts) for parts in zip(*(
        (found.energy, found.kinetic) for found in balances), strict=True))
    size = float(np.ptp(energies))
    if size <= _LEAST_RANGE * kinetic.max():
        return None
    shares = {}
    for horizon in horizons:
        k = round(horizon / spacing)
        # For a true model, H minus the work is constant.
        changes = np.concatenate([
            rest[k:] - rest[:max(0, len(rest) - k)]
            for rest in (found.energy - found.work for found in balances)])
        shares[horizon] = float(np.sqrt(np.mean(changes**2))) / size
    return shares


def friction_work(learned: np.ndarray, trajectory: np.ndarray, t: np.ndarray, v: np.ndarray
                  ) -> tuple[np.ndarray, float]:
    """
    Fit the work of friction to energies along motions by least squares.

        W(t) = -sum_i integral of (b_i v_i^2 + c_i abs(v_i)) dt,  b_i, c_i >= 0

    Parameters
    ----------
    learned : np.ndarray, shape (n,)
        Energies [J], ordered by time within each trajectory.
    trajectory : np.ndarray of int, shape (n,)
        Trajectory number of each state.
    t : np.ndarray, shape (n,)
        Times [s].
    v : np.ndarray, shape (n, d)
        Velocities.

    Returns
    -------
    np.ndarray of shape (n,), and float
        Work W [J], zero at the start of each trajectory, and mean power of friction loss [W].

    """
    columns = integrated(np.hstack([v**2, np.abs(v)]), trajectory, t)
    centred, energies, duration = columns.copy(), learned.copy(), 0.0
    for rows in rows_of_each(trajectory):
        centred[rows] -= columns[rows].mean(axis=0)
        energies[rows] -= energies[rows].mean()
        duration += t[rows[-1]] - t[rows[0]]
    # Normalise the columns, because nnls uses absolute tolerances.
    units = np.sqrt(np.mean(centred**2, axis=0))
    units[units == 0.0] = 1.0
    coefficients = nnls(centred / units, -energies)[0] / units
    work = -columns @ coefficients
    lost = sum(work[rows[0]] - work[rows[-1]] for rows in rows_of_each(trajectory))
    return work, float(lost / duration) if duration > 0.0 else 0.0


def integrated(rates: np.ndarray, trajectory: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Integrate (trapezoidal rule) over time, from zero in each trajectory, shape (n, k)."""
    integral = np.zeros_like(rates)
    for rows in rows_of_each(trajectory):
        integral[rows] = cumulative_trapezoid(rates[rows], t[rows], axis=0, initial=0.0)
    return integral
