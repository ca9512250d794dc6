# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Residuals of a model on measured motions, in units of the noise of their sensors."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.fit.fitted_rigid_body import downsampled
from hnn_vi_ros.learning.fit.growing import fits_by_length, with_states_of
from hnn_vi_ros.learning.fit.shooting import Solution
from hnn_vi_ros.learning.fit.windows import ParametricModel
from hnn_vi_ros.learning.judging.evaluation import variance_of
from hnn_vi_ros.models import ModelCard
import numpy as np

# Largest step size of a model that is judged; its error is far below that of most sensors [s].
STEP = 0.01
# Residual in units of the noise up to which nothing but noise is left.
ONLY_NOISE = 1.25
# RMS error in standard deviations of the motions beyond which simulations have left them: the
# mean of a motion, and a state at another time, are off by less.
_LEFT = 3.0

# Residual of each coordinate in units of its noise, by the length of the windows [s].
Residuals = dict[str, list[float]]


class FollowedMotions(NamedTuple):
    """
    Motions that a model was simulated along, from the initial states that fit best.

    Parameters
    ----------
    residuals : dict of str to list of float
        Residual of each coordinate in units of its noise, by the length of the windows [s].
    motions : list of EvenMotion
        The motions with the states of the model as the smoothed ones; where it does not follow
        them, even in the shortest windows, those of the filter.
    longest : Solution, optional
        Fit of the longest windows; None if no simulation comes through the shortest ones.

    """

    residuals: Residuals
    motions: list[EvenMotion]
    longest: Solution | None


def judged_along(model: ParametricModel, motions: Sequence[EvenMotion], noise: np.ndarray
                 ) -> FollowedMotions:
    """
    Follow motions with a model.

    Parameters
    ----------
    model : ParametricModel
        Model without free numbers.
    motions : sequence of EvenMotion
        Motions that it was not fitted to.
    noise : np.ndarray, shape (C,)
        Noise of each measured quantity.

    """
    d, fits = motions[0].q.shape[1], fits_by_length(model, downsampled(motions, None)[0], noise)
    residuals = {f'{length:.3g}': ratios[:d].tolist() for length, _, ratios in fits}
    within = followed(residuals)
    longest = [solution for length, solution, _ in fits if float(f'{length:.3g}') <= within]
    return FollowedMotions(
        residuals, with_states_of(model, motions, longest[-1]) if longest else [*motions],
        fits[-1][1] if fits else None)


def resolving_step(card: ModelCard) -> float:
    """Return the largest step size with which a machine's model is judged [s]."""
    assert card.mechanical is not None, 'of a machine'
    return min(STEP, card.mechanical.step_size or STEP)


def followed(residuals: Mapping[str, Sequence[float]]) -> float:
    """Return the length [s] up to which nothing but noise is left, 0 if there is more in all."""
    within = 0.0
    for length, ratios in residuals.items():
        if max(ratios) > ONLY_NOISE:
            break
        within = float(length)
    return within


def is_noise(residuals: Mapping[str, Sequence[float]]) -> bool:
    """Return True if nothing but noise is left in windows of all lengths."""
    return bool(residuals) and followed(residuals) == float([*residuals][-1])


def is_off(errors: Iterable[Sequence[float | None] | np.ndarray], motions: Sequence[EvenMotion]
           ) -> bool:
    """Return True if an RMS error is not finite, or far larger than the motions."""
    most = _LEFT * np.sqrt(variance_of(motions))
    return not all((np.array(rms, dtype=float) < most).all() for rms in errors)


def noise_text(residuals: Mapping[str, Sequence[float]], off: bool = False) -> str:
    """Describe the residuals in a clause; `off` if simulations leave the motions."""
    if not residuals:
        return 'no simulation comes through the shortest windows'
    within, (last, ratios) = followed(residuals), [*residuals.items()][-1]
    worst = max(ratios)
    if is_noise(residuals):
        return (f'its residuals are {worst:.2f} times the noise of the sensors in windows of up '
                f'to {last} s, ' + ('but simulations from states along them leave the motions'
                                    if off else 'so its own error is below the noise'))
    growing = f'{worst:.2g} times the noise in windows of {last} s'
    if not within:
        return f'its residuals exceed the noise of the sensors: {growing}'
    return ('its residuals are those of the noise of the sensors in windows of up to '
            f'{within:g} s, and {growing}')


def errors_text(residuals: Mapping[str, Sequence[float]], noise: np.ndarray,
                coordinates: Sequence[Any], off: bool) -> str:
    """Return the sentences on errors and noise; the coordinates have a name and a unit."""
    sizes = ', '.join(f'{x:.3g} {one.q_unit} of {one.name}' for x, one in zip(
        noise.tolist(), coordinates, strict=False))
    return (f'On these motions {noise_text(residuals, off)}. The noise, {sizes}, is part of the '
            'errors above.')
