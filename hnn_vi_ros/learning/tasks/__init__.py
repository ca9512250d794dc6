# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training tasks: the parts that each group of families supplies to the common trainer."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.learning.fit.loop import Fitted
from hnn_vi_ros.learning.judging.report import Judged
from hnn_vi_ros.models import Checkpoint

# Note on the energy scale for model cards.
OPEN_BY_MAP = ('; the energy scale is arbitrary, since the input map was learned: the mean square '
               'of its columns is 1')


class TrainingTask(NamedTuple):
    """
    Functions that train models of some families, called in this order.

    Parameters
    ----------
    picture : str
        Name of the picture in the report.
    read : callable
        ``read(source, config, given, ensemble)`` returns the data of a configuration at a path, or
        of given files in their place; an ensemble holds out some data for calibration. Data have
        ``arrays``, which identify an interrupted run, and ``box``, the training domain of an
        ensemble (None: the mean of its members' boxes).
    select : callable
        ``select(data)`` returns the data with the configuration of the model that suits them.
    fit : callable
        ``fit(data, config, device, train)`` returns a fitted model; for an ensemble, on data
        resampled by the seed of the configuration.
    describe : callable
        ``describe(data, fitted, config, name, command)`` returns the model with its card.
    judge : callable
        ``judge(data, checkpoint, fitted)`` returns the model, judged on unseen data.
    folds : callable, optional
        ``folds(data, config, count, device)`` returns losses of a cross-validation for the card.

    """

    picture: str
    read: Callable[[Path, Any, Sequence[str], bool], Any]
    select: Callable[[Any], Any]
    fit: Callable[..., Fitted]
    describe: Callable[[Any, Any, Any, str, str], Checkpoint]
    judge: Callable[[Any, Checkpoint, Any], Judged]
    folds: Callable[[Any, Any, int, str], dict[str, float]] | None = None
