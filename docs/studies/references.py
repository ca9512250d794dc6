# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The paths that errors are measured against: exact solutions, else Gauss of order 16, checked."""

from collections.abc import Callable
from dataclasses import dataclass
import math
import re

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models.energy_error import EnergyError
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.simulation import Simulation
import numpy as np
from scipy.special import ellipj, ellipk, ellipkinc

# A path error is the largest over these many instants, equally far apart, the horizon the last.
INSTANTS = 10
# States of a path by which its energies are judged.
SAMPLES = 1000
# A reference that is less accurate than this share of the motion's size is none: chaos.
VERIFIED = 1e-4
_EPS = float(np.finfo(np.float64).eps)
_METHOD, _HALVINGS = 'gauss16', 3
# Next to its separatrix the elliptic functions of the pendulum lose their digits.
_SEPARATRIX = 1e-9


@dataclass(frozen=True)
class Reference:
    """
    Reference motion at the instants T/10, 2T/10, ..., T.

    Parameters
    ----------
    path : np.ndarray, shape (INSTANTS, 2 d)
        (q, p), row by row.
    accuracy : float
        Largest error of the path, as far as it is known; infinity if there is no path.
    how : str
        What it was computed by.
    samples : np.ndarray, shape (n, 2 d)
        More states of the same motion, for energies; may be empty.

    """

    path: np.ndarray
    accuracy: float
    how: str
    samples: np.ndarray

    @property
    def verified(self) -> bool:
        """Return whether errors can be measured against the path."""
        return self.accuracy <= VERIFIED * np.abs(self.path).max(initial=1e-300)


@dataclass(frozen=True)
class ModelDiscrepancy:
    """
    Error of a learned H, whatever integrates it.

    Parameters
    ----------
    path : float
        Largest distance between the motions of the learned and of the true H at the instants;
        NaN where either is not verified.
    energy : float
        Largest change of the true H along the motion of the learned one [J].
    box : EnergyError or None
        The error of the learned H all over its box, from its model card, where that says so.

    """

    path: float
    energy: float
    box: EnergyError | None = None


def instants(horizon: float) -> np.ndarray:
    """Return T/10, 2T/10, ..., T [s], shape (INSTANTS,)."""
    return horizon * np.arange(1, INSTANTS + 1) / INSTANTS


def make_reference(hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray, horizon: float,
                   step_size: float) -> Reference:
    """
    Return the exact motion where a formula is known, else that of Gauss of order 16.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Of d degrees of freedom.
    q0, p0 : np.ndarray, shape (d,)
        Initial state.
    horizon : float
        T [s].
    step_size : float
        The longest step that is tried [s]; it is halved up to _HALVINGS times, or until paths
        differ by no more than rounding makes of so many steps. The accuracy is the smallest
        difference between two paths that follow one another.

    """
    solve = EXACT.get(type(hamiltonian))
    solution = solve(hamiltonian, q0, p0, instants(horizon)) if solve else None
    if solution is not None:
        path, condition, how = solution
        return Reference(path, _rounding(hamiltonian, path, condition, horizon), how,
                         np.empty((0, path.shape[1])))
    best = Reference(np.empty((0, 2 * q0.size)), math.inf, 'none: no path converged',
                     np.empty((0, 2 * q0.size)))
    before, every = None, math.ceil(horizon / (SAMPLES * step_size) * (1.0 - 1e-9))
    for halving in range(_HALVINGS + 1):
        h = horizon / (SAMPLES * every * 2 ** halving)
        samples = _gauss_path(hamiltonian, q0, p0, h, every * 2 ** halving)
        if before is not None and samples is not None:
            path = samples[SAMPLES // INSTANTS - 1::SAMPLES // INSTANTS]
            accuracy = float(max(np.abs(samples - before).max(), _EPS * np.abs(path).max()))
            if accuracy < best.accuracy:
                best = Reference(path, accuracy, f'{_METHOD}, h = {h:.3g} s, checked by halving',
                                 samples)
            elif best.verified:
                break
            if accuracy <= _EPS * np.abs(path).max() * math.sqrt(horizon / h):
                break
        before = samples
    return best


def true_hamiltonian(hamiltonian: Hamiltonian) -> Hamiltonian | None:
    """Return the H that a network was taught, by its model card; None where that is unknown."""
    if not isinstance(hamiltonian, NeuralHamiltonian):
        return None
    found = re.fullmatch(r'\d+ exact samples of (\w+)\((.*)\)',
                         hamiltonian.checkpoint.card.dataset)
    if found is None or found[1] not in HAMILTONIANS:
        return None
    pairs = [item.split('=') for item in found[2].split(', ') if item]
    return HAMILTONIANS[found[1]](**{key: float(value) for key, value in pairs})


def model_error(learned: Reference, truth: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
                horizon: float, step_size: float) -> ModelDiscrepancy:
    """Return what the motion of a learned H is off by; arguments as of make_reference."""
    energies = truth.energy(*np.split(learned.samples, 2, axis=1))
    energy = float(np.abs(energies - truth.energy(q0, p0)).max(initial=0.0))
    if not learned.verified:
        return ModelDiscrepancy(math.nan, energy)
    exact = make_reference(truth, q0, p0, horizon, step_size)
    if not exact.verified:
        return ModelDiscrepancy(math.nan, energy)
    return ModelDiscrepancy(float(np.abs(learned.path - exact.path).max()), energy)


def _gauss_path(hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray, h: float, every: int
                ) -> np.ndarray | None:
    """Return (q, p) at the samples, that many steps apart; None if a step fails."""
    try:
        return np.hstack(Simulation(
            hamiltonian, INTEGRATORS[_METHOD](), h, q0, p0).record(SAMPLES, every))
    except StepFailure:
        return None


def _rounding(hamiltonian: Hamiltonian, path: np.ndarray, condition: float, horizon: float
              ) -> float:
    """Bound the error of a formula: its phase is known to about two eps, its value to one."""
    speed = np.abs(hamiltonian.gradient(*np.split(path, 2, axis=1))).max()
    return float(_EPS * (np.abs(path).max() + 2.0 * condition * speed * horizon))


def _oscillator(hamiltonian: HarmonicOscillator, q0: np.ndarray, p0: np.ndarray, t: np.ndarray
                ) -> tuple[np.ndarray, float, str]:
    inertia = math.sqrt(hamiltonian.mass * hamiltonian.stiffness)
    phase = math.sqrt(hamiltonian.stiffness / hamiltonian.mass) * t[:, None]
    sine, cosine = np.sin(phase), np.cos(phase)
    path = np.hstack([q0 * cosine + p0 / inertia * sine, p0 * cosine - q0 * inertia * sine])
    return path, 1.0, 'exact: sine and cosine'


def _pendulum(hamiltonian: Pendulum, q0: np.ndarray, p0: np.ndarray, t: np.ndarray
              ) -> tuple[np.ndarray, float, str] | None:
    """
    Swing or turn over by Jacobi's elliptic functions; None next to the separatrix.

    With k^2 = H / (2 m g l), a swing (k < 1) has sin(q / 2) = k sn(omega t + u0 | k^2) and a turn
    (k > 1) has q / 2 = am(k omega t + u0 | 1 / k^2), where omega^2 = g / l.
    """
    omega = math.sqrt(hamiltonian.gravity / hamiltonian.length)
    top = 2.0 * omega * hamiltonian.mass * hamiltonian.length ** 2
    turns = round(float(q0[0]) / (2.0 * math.pi))
    half = 0.5 * (float(q0[0]) - 2.0 * math.pi * turns)
    sine, speed = math.sin(half), float(p0[0]) / top
    m = sine * sine + speed * speed
    if abs(m - 1.0) < _SEPARATRIX:
        return None
    k = math.sqrt(m)
    if m < 1.0:
        start = ellipkinc(math.atan2(sine, speed), m)
        sn, cn, _, _ = ellipj(np.remainder(omega * t + start, 4.0 * ellipk(m)), m)
        q, p = 2.0 * np.arcsin(k * sn), top * k * cn
    else:
        sign = math.copysign(1.0, speed)
        u = k * omega * t + ellipkinc(sign * half, 1.0 / m)
        period = 2.0 * ellipk(1.0 / m)
        whole = np.floor(u / period)
        _, _, dn, amplitude = ellipj(u - whole * period, 1.0 / m)
        q, p = 2.0 * sign * (amplitude + math.pi * whole), sign * top * k * dn
    path = np.column_stack([q + 2.0 * math.pi * turns, p])
    # How much longer a swing takes for a change of its energy.
    condition = max(1.0, 1.0 / abs(1.0 - m))
    return path, condition, 'exact: Jacobi elliptic functions'


def _kepler(hamiltonian: Kepler, q0: np.ndarray, p0: np.ndarray, t: np.ndarray
            ) -> tuple[np.ndarray, float, str] | None:
    """
    Go round an ellipse by Kepler's equation for the change E of the eccentric anomaly.

        n t = E - (1 - r0 / a) sin E + (q0 . p0) / sqrt(mu a) (1 - cos E)

    and from there by Lagrange's f and g (Battin, An Introduction to the Mathematics and Methods
    of Astrodynamics, section 4.3). None for an orbit that is open, or meets the centre.
    """
    mu, r0, squared = hamiltonian.mu, float(np.hypot(*q0)), float(p0 @ p0)
    inverse = 2.0 / r0 - squared / mu
    if inverse <= 0.0 or q0[0] * p0[1] == q0[1] * p0[0]:
        return None
    a = 1.0 / inverse
    n = math.sqrt(mu / a ** 3)
    radial, along = 1.0 - r0 / a, float(q0 @ p0) / math.sqrt(mu * a)
    mean = np.remainder(n * t, 2.0 * math.pi)
    low, high = mean - 4.0, mean + 4.0
    for _ in range(64):
        middle = 0.5 * (low + high)
        ahead = (middle - radial * np.sin(middle)
                 + 2.0 * along * np.sin(0.5 * middle) ** 2) > mean
        low, high = np.where(ahead, low, middle), np.where(ahead, middle, high)
    change = 0.5 * (low + high)
    versine = 2.0 * np.sin(0.5 * change) ** 2
    r = a * (1.0 - radial * np.cos(change) + along * np.sin(change))
    f, g = 1.0 - a / r0 * versine, (mean - change + np.sin(change)) / n
    f_dot, g_dot = -math.sqrt(mu * a) / (r * r0) * np.sin(change), 1.0 - a / r * versine
    path = np.hstack([np.outer(f, q0) + np.outer(g, p0),
                      np.outer(f_dot, q0) + np.outer(g_dot, p0)])
    # 1 / a is a difference, and its relative error that of the period.
    condition = 1.5 * a * (2.0 / r0 + squared / mu)
    return path, condition, "exact: Kepler's equation"


EXACT: dict[type, Callable] = {
    HarmonicOscillator: _oscillator, Kepler: _kepler, Pendulum: _pendulum}
