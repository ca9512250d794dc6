# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sample of a run: its state and energies after a whole number of steps."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sample:
    """
    The state after a whole number of steps, with the energies that belong to it.

    Parameters
    ----------
    step : int
        Steps since the start of the run.
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
        The energy that the integrator nearly conserves [J]; NaN if none is known.
    energy_error : float
        (H - H0 - W) / |H0|, or H - H0 - W [J] where H0 is zero.
    work : float
        W that the scene's effects have done on the system since the start [J].
    motors : np.ndarray, shape (d,), or None
        The generalised forces that commands make [N] or [N m]; None for none.
    spread : np.ndarray, shape (2 d,), or None
        Half-widths of the bands around q, then p, of an ensemble; None for no members.

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
