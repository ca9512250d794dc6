# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training tasks: what each group of families supplies to the one trainer."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

from hnn_vi_ros.learning.fit.loop import Problem
from hnn_vi_ros.learning.judging.report import Judged
from hnn_vi_ros.models.checkpoint import Checkpoint
import numpy as np


class Task(ABC):
    """
    Data, loss, card and judgement of models of some families.

    Its arguments are the file of a configuration, the configuration, the files that the command
    line gives instead of the configuration's, and whether an ensemble is trained: then some data
    are held out.
    """

    # The name of the picture in the report.
    picture: ClassVar[str]

    @abstractmethod
    def __init__(self, source: Path, config: Any, given: Sequence[str], ensemble: bool):
        """Read the data."""

    @abstractmethod
    def arrays(self) -> Iterable[np.ndarray]:
        """Return the data, by which an interrupted run is known again."""

    @abstractmethod
    def problem(self, config: Any, device: str) -> Problem:
        """Return a fresh model with its stages; of an ensemble, on data drawn by its seed."""

    @abstractmethod
    def describe(self, problem: Any, config: Any, name: str, command: str) -> Checkpoint:
        """Return a trained model with its card."""

    @abstractmethod
    def combined(self, members: list[Checkpoint], name: str) -> Checkpoint:
        """Return members as one model."""

    @abstractmethod
    def judged(self, checkpoint: Checkpoint, problem: Any) -> Judged:
        """Return the model, judged by data that it has not seen."""
