# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sample of a run: state and energies after a whole number of steps."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sample:
    """
    The state after a whole number of steps, with its energies.

    Parameters
    ----------
    step : int
        Number of steps since the start of the run.
    stamp : int
        Simulated time since the start of the run [ns].
    q, p : np.ndarray, shape (d,)
        Generalised coordinates and conjugate momenta.
    dH_dq, dH_dp : np.ndarray, shape (d,)
        -p' and q' at (q, p): minus the generalised force, and the velocity. Without forces they
        are the gradient of H.
    energy : float
        H(q, p) [J].
    modified_energy : float
        Energy nearly conserved by the integrator [J]; NaN if unknown.
    energy_error : float
        (H - H0 - W) / |H0|, or H - H0 - W [J] if H0 is zero.
    work : float
        Work W done on the system by the scene's effects since the start [J].
    motors : np.ndarray, shape (d,), or None
        Generalised forces due to commands [N] or [N m]; None without commands.
    spread : np.ndarray, shape (2 d,), or None
        Half-widths of an ensemble's bands around q, then p; None without members.
    causes : np.ndarray, shape (C,), or None
        Energy by cause [J]; None if it was not requested.

    """

    step: int
    stamp: int
    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    energy: float
    modified_energy: float
    energy_error: float
    work: float = 0.0
    motors: np.ndarray | None = None
    spread: np.ndarray | None = None
    causes: np.ndarray | None = None
