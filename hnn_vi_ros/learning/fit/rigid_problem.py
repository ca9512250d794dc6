# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A fitted rigid body: its numbers with intervals, and how well other inputs would fit."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math

from hnn_vi_ros.learning.data.motions import EvenMotion, part_of
from hnn_vi_ros.learning.families.choices import TrajectoryLoss
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.growing import Fitted
from hnn_vi_ros.learning.fit.input_courses import (
    EVIDENCE, evidence_of, input_courses, InputCourses, misfit_with)
from hnn_vi_ros.learning.fit.loop import TrainingProblem
from hnn_vi_ros.learning.fit.machine import samples_of
from hnn_vi_ros.learning.fit.noise import covariances, Process
from hnn_vi_ros.learning.fit.rigid_model import RigidModel
from hnn_vi_ros.learning.fit.shooting import projected, units_of
from hnn_vi_ros.learning.fit.step_forces import constant_forces
from hnn_vi_ros.learning.fit.windows import KnownModel
from hnn_vi_ros.models import CoordinateCard, FittedNumber
import numpy as np

# Half-width of 95 % intervals in standard deviations, and singular values of normalised columns
# below which a direction, such as the scale of the energy, is open.
_QUANTILE, _OPEN = 1.96, 1e-12


class RigidProblem(TrainingProblem):
    """
    A fitted rigid body, of which nothing is left to train.

    Parameters
    ----------
    network : MechanicalNetwork
        The rigid body.
    losses : mapping of str to float
        Losses of its fits; of positions the residuals in units of the noise.
    fitted : Fitted or None
        The fit to positions, None if velocities were measured.

    """

    def __init__(self, network: MechanicalNetwork, losses: Mapping[str, float],
                 fitted: Fitted | None = None):
        super().__init__(network, losses=losses)
        self.fitted, self.noise = fitted, None if fitted is None else fitted.noise

    def is_driven(self, motions: Sequence[EvenMotion]) -> bool:
        """Return True if it was fitted to positions under forces."""
        return self.fitted is not None and any(motion.tau.any() for motion in motions)

    def known(self) -> KnownModel:
        """Return a rigid body that was fitted to positions as a model without free numbers."""
        assert self.fitted is not None
        model = self.fitted.problem.model
        return KnownModel(model.name, model.parts_at(self.fitted.solution.values))

    def courses(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss, stated: bool
                ) -> InputCourses:
        """Return how well other courses of the forces fit, of a fit to positions."""
        assert self.fitted is not None
        return input_courses(
            self.fitted.solution, self.fitted.problem, motions[0].inputs, stated,
            lambda other: downsampled([replace(motion, inputs=other) for motion in motions],
                                      loss.step_size)[0])

    def is_evidence(self, gain: float) -> bool:
        """Return True if residuals that are smaller by this share are three sigma smaller."""
        return self.fitted is not None and (
            evidence_of(self.fitted.solution.freedom, 1.0 - gain) > EVIDENCE)

    def misfit_with(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss) -> float:
        """Return the residuals with other forces, of a fit to positions."""
        assert self.fitted is not None
        return misfit_with(self.fitted.solution, self.fitted.problem,
                           downsampled(motions, loss.step_size)[0])

    def gain_with(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss) -> float:
        """Return the share by which other forces reduce the residuals."""
        assert self.fitted is not None
        return 1.0 - self.misfit_with(motions, loss) / self.fitted.problem.misfit(
            self.fitted.solution)

    def no_worse(self, other: TrainingProblem) -> float | None:
        """Return the longest windows [s] of both fits if the other is no worse there, or None."""
        if not isinstance(other, RigidProblem) or self.fitted is None or other.fitted is None:
            return None
        own, others = dict(self.fitted.stages), dict(other.fitted.stages)
        length = max(own.keys() & others.keys(), default=None)
        return length if length is not None and others[length] <= own[length] else None

    def estimates(self, coordinates: Sequence[CoordinateCard], q: np.ndarray | None
                  ) -> dict[str, FittedNumber]:
        """
        Return the numbers of a rigid body that was fitted to positions, with 95 % intervals.

        Parameters
        ----------
        coordinates : sequence of CoordinateCard
            Names and units of the coordinates.
        q : np.ndarray, shape (N, d), or None
            Coordinates whose mean first inertia is 1, if no forces fix the scale of the energy.

        """
        assert self.fitted is not None
        solution, model = self.fitted.solution, self.fitted.problem.model
        assert isinstance(model, RigidModel)
        values, covariance = solution.values, covariance_of(self.fitted)
        labels = model.unknowns.labels(coordinates)
        own = [labels[int(number.name)] for number in model.numbers]
        if q is not None:
            # Numbers x / (w . x): the common factor, which is open, does not change them.
            inertia = model.unknowns.mean_inertia(q)
            w = np.array([inertia[int(number.name)] for number in model.numbers])
            values = values / (w @ values)
            slopes = (np.eye(len(w)) - np.outer(values, w)) / (w @ solution.values)
            covariance = slopes @ covariance @ slopes.T
        motors = model.motors
        if motors:
            # The norm of the map is open too; that of MechanicalNetwork.input_map is taken.
            values, size = values.copy(), float(np.linalg.norm(values[motors]))
            unit_map = values[motors] / size
            norm = math.sqrt(model.unknowns.network.raw_map.shape[1])
            slopes = np.eye(len(values))
            slopes[np.ix_(motors, motors)] = norm / size * (
                np.eye(len(motors)) - np.outer(unit_map, unit_map))
            values[motors], covariance = norm * unit_map, slopes @ covariance @ slopes.T
        half = _QUANTILE * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return {name: FittedNumber(value=x, unit=unit, interval=[x - e, x + e])
                for (name, unit), x, e in zip(own, values.tolist(), half.tolist(), strict=True)}


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


def covariance_of(fitted: Fitted) -> np.ndarray:
    """
    Return the covariance of fitted numbers, shape (n, n).

    It is that of the noise of the sensors, or of residuals where errors of the model exceed it.
    """
    solution, excess = fitted.solution, max(1.0, fitted.stages[-1][1])
    weights = fitted.problem.weights(solution.residuals)
    units = units_of(solution)
    slopes = projected(solution, weights)[0] / units
    matrix = slopes.reshape(-1, len(units))
    inverse = np.linalg.pinv(matrix.T @ matrix, rcond=_OPEN, hermitian=True)
    found = covariances(slopes @ inverse, sensors_of(fitted))[0]
    # For the robust loss psi = w r has slope w^3.
    bend = float((weights[solution.windows.there]**3).mean())
    return (excess / bend)**2 * found / np.outer(units, units)


def sensors_of(fitted: Fitted) -> list[list[Process]]:
    """Return the noise of the sensors in units of that of the fit."""
    return [[one._replace(variance=one.variance / scale**2)]
            for one, scale in zip(fitted.sensor, fitted.solution.noise, strict=True)]
