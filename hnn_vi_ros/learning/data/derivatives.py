# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Smooth what was measured, and estimate its derivative by time."""

from typing import Literal

from hnn_vi_ros.files.yaml_file import StrictModel
import numpy as np
from pydantic import Field
from scipy.interpolate import make_smoothing_spline
from scipy.signal import savgol_filter


class SavitzkyGolay(StrictModel):
    """Derivatives of a polynomial fitted in a sliding window; needs even sampling."""

    kind: Literal['savitzky_golay'] = 'savitzky_golay'
    window: float = Field(gt=0.0, description='length of the window [s]')
    degree: int = Field(3, ge=1, le=9, description='of the polynomial')


class SmoothingSpline(StrictModel):
    """Derivatives of a smoothing cubic spline; takes uneven sampling."""

    kind: Literal['smoothing_spline']
    smoothing: float | None = Field(None, ge=0.0, description=(
        'weight of the squared second derivative; without it, generalised cross-validation'))


def differentiate(t: np.ndarray, values: np.ndarray, method: object, window: int
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Smooth measured values and estimate their derivative.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Increasing instants [s]; evenly spaced for a SavitzkyGolay method.
    values : np.ndarray, shape (N, d)
        What was measured then.
    method : SavitzkyGolay or SmoothingSpline
        How to smooth.
    window : int
        Rows in the window of a SavitzkyGolay method.

    Returns
    -------
    tuple of np.ndarray, shape (N, d)
        The smoothed values and their derivatives [1/s].

    References
    ----------
    A. Savitzky, M. Golay, Analytical Chemistry 36 (1964), doi:10.1021/ac60214a047.

    """
    if isinstance(method, SavitzkyGolay):
        spacing = (t[-1] - t[0]) / (len(t) - 1)
        return tuple(savgol_filter(values, window, method.degree, deriv=order, delta=spacing,
                                   axis=0) for order in (0, 1))
    splines = [make_smoothing_spline(t, column, lam=method.smoothing) for column in values.T]
    return (np.stack([spline(t) for spline in splines], axis=-1),
            np.stack([spline.derivative()(t) for spline in splines], axis=-1))
