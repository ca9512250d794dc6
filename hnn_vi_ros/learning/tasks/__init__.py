# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training tasks: the parts that each group of families supplies to the common trainer."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from hnn_vi_ros.learning.fit.loop import TrainingProblem
from hnn_vi_ros.learning.judging.report import Judged
from hnn_vi_ros.models import Box, Checkpoint, CoordinateCard, Layers, ModelCard, widths_of
from hnn_vi_ros.version import __version__
import numpy as np

# Note on the energy scale for model cards.
OPEN_BY_MAP = ('; the energy scale is arbitrary, since the input map was learned: the mean square '
               'of its columns is 1')


class TrainingTask(ABC):
    """
    Base class of a task: data, loss, card and judgement of models of some families.

    Arguments: the path of a configuration, the configuration, data files from the command line
    that override the configured ones, and whether an ensemble is trained; an ensemble holds out
    some data for calibration.
    """

    # Name of the picture in the report.
    picture: ClassVar[str]
    # Training domain of an ensemble; default: the mean of its members' boxes.
    box: Box | None = None

    @abstractmethod
    def __init__(self, source: Path, config: Any, given: Sequence[str], ensemble: bool):
        """Read the data."""

    @abstractmethod
    def arrays(self) -> Iterable[np.ndarray]:
        """Return the data arrays, which identify an interrupted run."""

    @abstractmethod
    def problem(self, config: Any, device: str) -> TrainingProblem:
        """Return a new model with its stages; for an ensemble, on data resampled by the seed."""

    @abstractmethod
    def describe(self, problem: Any, config: Any, name: str, command: str) -> Checkpoint:
        """Return a trained model with its card."""

    @abstractmethod
    def judged(self, checkpoint: Checkpoint, problem: Any) -> Judged:
        """Return the model, judged on unseen data."""


def described(config: Any, networks: Mapping[str, Layers], name: str, command: str,
              **entries: Any) -> Checkpoint:
    """Return a trained model with its card; ``entries`` are task-specific card entries."""
    coordinates = [CoordinateCard(name=one.name, q_unit=one.q_unit, p_unit=one.p_unit)
                   for one in config.coordinates]
    return Checkpoint(ModelCard(
        name=name, coordinates=coordinates, seed=config.seed, training_command=command,
        package_version=__version__, **widths_of(networks), **entries), networks)
