# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A fitted rigid body: its numbers with intervals, and how well other inputs would fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

from hnn_vi_ros.learning.data.motions import EvenMotion, part_of
from hnn_vi_ros.learning.families.choices import TrajectoryLoss
from hnn_vi_ros.learning.fit.growing import FittedNumbers
from hnn_vi_ros.learning.fit.input_courses import (
    EVIDENCE, evidence_at, evidence_of, input_courses, InputCourses, misfit_with)
from hnn_vi_ros.learning.fit.loop import Fitted
from hnn_vi_ros.learning.fit.machine import samples_of
from hnn_vi_ros.learning.fit.noise import covariances
from hnn_vi_ros.learning.fit.prediction import Prediction
from hnn_vi_ros.learning.fit.rigid_model import RigidModel
from hnn_vi_ros.learning.fit.shooting import (
    least_squares_factors, projected, undetermined, units_of)
from hnn_vi_ros.learning.fit.step_forces import constant_forces
from hnn_vi_ros.learning.fit.windows import KnownModel
from hnn_vi_ros.models import CoordinateCard, FittedNumber
import numpy as np

# Half-width of 95 % intervals in standard deviations.
_QUANTILE = 1.96
# Residuals in units of the noise that show that a body lacks something, and the least share of
# them that is evidence for other forces.
_POOR, _MOST = 5.0, 0.5
# Correlation of the errors of two numbers that is named.
_CORRELATED = 0.99
# Share of a direction that the data do not determine from which a number is a part of it.
OPEN_SHARE = 1e-3
# Differences of the values of a column, relative to its range, that are rounding errors of
# conversions; distance from a multiple of their common step; and least number of levels.
_ROUNDED, _MULTIPLE, _LEVELS = 1e-9, 0.01, 100


@dataclass(frozen=True)
class FittedRigidBody(Fitted):
    """
    A fitted rigid body.

    Parameters
    ----------
    module, losses, history, noise
        See Fitted; the losses are of positions the residuals in units of the noise.
    numbers : FittedNumbers, optional
        The fit to positions; None if velocities were measured.

    """

    numbers: FittedNumbers | None = None

    def is_driven(self, motions: Sequence[EvenMotion]) -> bool:
        """Return True if it was fitted to positions under forces."""
        return self.numbers is not None and any(motion.tau.any() for motion in motions)

    def known(self) -> KnownModel:
        """Return a rigid body that was fitted to positions as a model without free numbers."""
        assert self.numbers is not None
        model = self.numbers.problem.model
        return KnownModel(model.name, model.parts_at(self.numbers.solution.values))

    def courses(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss, stated: bool
                ) -> InputCourses:
        """Return the residuals for other courses of the forces, in a fit to positions."""
        assert self.numbers is not None
        return input_courses(
            self.numbers.solution, self.numbers.problem, motions[0].inputs, stated,
            lambda other: downsampled([replace(motion, inputs=other) for motion in motions],
                                      loss.step_size)[0])

    def is_evidence(self, gain: float) -> bool:
        """
        Return True if residuals that are smaller by this share are three sigma smaller.

        Of residuals that are many times the noise it must be most: the body lacks something else.
        """
        return self.numbers is not None and (
            evidence_of(self.numbers.solution.freedom, 1.0 - gain) > EVIDENCE) and (
                gain > _MOST or self.numbers.stages[-1][1] < _POOR)

    def misfit_with(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss) -> float:
        """Return the residuals with other forces, of a fit to positions."""
        assert self.numbers is not None
        return misfit_with(self.numbers.solution, self.numbers.problem,
                           downsampled(motions, loss.step_size)[0])

    def is_hint(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss) -> bool:
        """Return True if a change towards other forces promises evidence, to first order."""
        assert self.numbers is not None
        return evidence_at(self.numbers.solution, self.numbers.problem,
                           downsampled(motions, loss.step_size)[0]) > EVIDENCE

    def gain_with(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss) -> float:
        """Return the share by which other forces reduce the residuals."""
        assert self.numbers is not None
        return 1.0 - self.misfit_with(motions, loss) / self.numbers.problem.misfit(
            self.numbers.solution)

    def no_worse(self, other: Fitted) -> float | None:
        """Return the longest windows [s] of both fits if the other is no worse there, or None."""
        if not isinstance(other, FittedRigidBody) or self.numbers is None or other.numbers is None:
            return None
        own, others = dict(self.numbers.stages), dict(other.numbers.stages)
        length = max(own.keys() & others.keys(), default=None)
        return length if length is not None and others[length] <= own[length] else None

    def estimates(self, coordinates: Sequence[CoordinateCard], q: np.ndarray | None
                  ) -> dict[str, FittedNumber]:
        """
        Return the numbers of a rigid body that was fitted to positions, with 95 % intervals.

        A number that the data do not determine has none; none has one if residuals are so large
        that the fit explains nothing.

        Parameters
        ----------
        coordinates : sequence of CoordinateCard
            Names and units of the coordinates.
        q : np.ndarray, shape (N, d), or None
            Coordinates whose mean first inertia is 1, if no forces fix the scale of the energy.

        """
        assert self.numbers is not None
        solution, model = self.numbers.solution, self.numbers.problem.model
        assert isinstance(model, RigidModel)
        values, slopes = solution.values, np.eye(len(solution.values))
        labels = model.unknowns.labels(coordinates)
        own = [labels[int(number.name)] for number in model.numbers]
        if q is not None:
            # Numbers x / (w . x): the common factor, which is open, does not change them.
            places = [int(number.name) for number in model.numbers]
            w, scaled = model.unknowns.mean_inertia(q)[places], model.unknowns.scaled[places]
            factor = np.where(scaled, 1.0 / (w @ values), 1.0)
            values = values * factor
            slopes = (np.eye(len(w)) - np.outer(values * scaled, w)) * factor[:, None]
        motors = model.motors
        if motors:
            # The norm of the map is open too; that of MechanicalNetwork.input_map is taken.
            values, size = values.copy(), float(np.linalg.norm(values[motors]))
            unit_map = values[motors] / size
            norm = math.sqrt(model.unknowns.network.raw_map.shape[1])
            own_slopes = np.eye(len(values))
            own_slopes[np.ix_(motors, motors)] = norm / size * (
                np.eye(len(motors)) - np.outer(unit_map, unit_map))
            values[motors], slopes = norm * unit_map, own_slopes @ slopes
        covariance = slopes @ covariance_of(self.numbers) @ slopes.T
        error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        half, told = _QUANTILE * error, self._told(slopes) & self.explains
        correlated = np.abs(covariance) > _CORRELATED * np.outer(error, error)
        return {name: FittedNumber(
            value=x, unit=unit, interval=[x - e, x + e] if known else None,
            correlated=[other for (other, _), same, as_well in zip(own, row, told, strict=True)
                        if same and known and as_well and other != name])
                for (name, unit), x, e, known, row in zip(
                    own, values.tolist(), half.tolist(), told.tolist(), correlated, strict=True)}

    @property
    def explains(self) -> bool:
        """Return whether the residuals are small enough to be those of a minimum of the log."""
        assert self.numbers is not None
        return self.numbers.stages[-1][1] < _POOR

    def _told(self, slopes: np.ndarray) -> np.ndarray:
        """Return which quantities, of these slopes by the numbers, the data determine, (n,)."""
        assert self.numbers is not None
        solution = self.numbers.solution
        units = units_of(solution)
        open_ = undetermined(
            solution, self.numbers.problem.weights(solution.residuals)) / units[:, None]
        least = OPEN_SHARE * (np.abs(slopes) @ (1.0 / units))
        told: np.ndarray = (np.abs(slopes @ open_) <= least[:, None]).all(axis=1)
        return told


def positions_alone(motions: Sequence[EvenMotion]) -> bool:
    """Return True unless velocities were measured in all motions."""
    return any(motion.v is None for motion in motions)


def downsampled(motions: Sequence[EvenMotion], step_size: float | None
                ) -> tuple[list[EvenMotion], np.ndarray]:
    """Downsample motions to this step, with held forces; return them and std(q), shape (d,)."""
    every, found = samples_of(motions, step_size).every, []
    for motion in motions:
        coarse, h = part_of(motion, slice(None, None, every)), every * motion.spacing
        found.append(replace(coarse, inputs='held', tau=constant_forces(
            motion, h * np.arange(len(coarse.t) + 1), h, rates=False)))
    return found, np.concatenate([motion.q for motion in motions]).std(axis=0)


def covariance_of(fitted: FittedNumbers) -> np.ndarray:
    """
    Return the covariance of fitted numbers, shape (n, n).

    It is that of the noise of the sensors, or of residuals where errors of the model exceed it,
    and 0 along directions that the data do not determine; see ``undetermined``.
    """
    solution, excess = fitted.solution, max(1.0, fitted.stages[-1][1])
    slopes, _ = projected(solution, fitted.problem.weights(solution.residuals))
    taken, factors, _ = least_squares_factors(
        slopes.reshape(-1, slopes.shape[3]), units_of(solution))
    found = covariance_of_sums(fitted, (taken @ factors).reshape(slopes.shape))
    return (excess / fitted.problem.bend(solution))**2 * found


def covariance_of_sums(fitted: FittedNumbers, weights: np.ndarray) -> np.ndarray:
    """
    Return the covariance of weighted sums of the residuals, of weights (W, T, C, n).

    It is that of the noise of the sensors, and of the rounding of forces, which moves a motion
    without friction ever further from that of the model.
    """
    solution, sensors = fitted.solution, [
        [one._replace(variance=one.variance / scale**2)]
        for one, scale in zip(fitted.sensor, fitted.solution.noise, strict=True)]
    found = covariances(weights, sensors)[0]
    rounding = rounding_of(np.concatenate([motion.tau for motion in solution.windows.motions]))
    if rounding.any():
        moved = rounding[:, None] * Prediction(
            fitted.problem.model, solution.values, solution.windows).by_forces(
                solution.starts, weights / solution.noise[:, None])
        found = found + np.einsum('wtmi,wtmj->ij', moved, moved)
    return found


def rounding_of(values: np.ndarray) -> np.ndarray:
    """
    Return the standard deviation of the rounding errors of columns (N, m), shape (m,).

    A column is rounded if its values are multiples of one number, and so many that they are
    those of a measurement rather than levels of a command. Of forces that are held, that is: those
    of linear courses are weighted means, whose common step is smaller.
    """
    found = np.zeros(values.shape[1])
    for k, column in enumerate(values.T):
        gaps = np.diff(np.unique(column))
        gaps = gaps[gaps > _ROUNDED * np.ptp(column)]
        if len(gaps) >= _LEVELS:
            share = column / gaps.min()
            found[k] = gaps.min() / math.sqrt(12.0) * (
                np.abs(share - np.rint(share)).max() < _MULTIPLE)
    return found
