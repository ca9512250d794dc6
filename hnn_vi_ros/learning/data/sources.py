# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sources of training data, by their kind."""

from collections.abc import Sequence
import os
from pathlib import Path
from typing import Annotated

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.bag_data import BagData, read_bags
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.exact_data import ExactData, sample_exact
from hnn_vi_ros.learning.data.measured_log import MeasuredData, read_measured_log
from pydantic import Field

Source = Annotated[ExactData | MeasuredData | BagData, Field(discriminator='kind')]


def dimension(data: Source) -> int:
    """Return the number of coordinates of a source."""
    if isinstance(data, BagData):
        return len(data.joints)
    return len(data.box.q if isinstance(data, ExactData) else data.q)


def make_dataset(data: Source, seed: int, config: Path, given: Sequence[str] = ()) -> Dataset:
    """
    Sample or read the data of a training configuration.

    Parameters
    ----------
    data : Source
        What to learn from.
    seed : int
        Of samples.
    config : Path
        The file of the configuration; a relative ``data.path`` is looked up beside it, then in
        the working directory, and so are ``data.paths``.
    given : sequence of str
        Files in place of ``data.path`` or ``data.paths``.

    Raises
    ------
    DataError
        The data cannot be read, or files are given for exact data.

    """
    if isinstance(data, ExactData):
        if given:
            raise DataError(f'{config}: its data is exact, so --data {given[0]} has no use; '
                            'leave it')
        return sample_exact(data, seed)
    if isinstance(data, BagData):
        if not (given or data.paths):
            raise DataError(f'{config}: data.paths is empty; pass bags with --data BAG ...')
        return read_bags([Path(path) for path in given] or [
            _beside(config, path) for path in data.paths], data)
    if len(given) > 1:
        raise DataError(f'{config}: its data is one measured log, but --data has {len(given)} '
                        'files; join them, and number them in a column data.trial')
    if not (given or data.path):
        source = f', which is {data.source}' if data.source else ''
        raise DataError(f'{config}: data.path is empty; pass the log with --data FILE{source}')
    return read_measured_log(Path(given[0]) if given else _beside(config, data.path), data)


def _beside(config: Path, path: str) -> Path:
    """Return a file beside the configuration if it is there, else as it is named."""
    beside = config.parent / path
    return beside if os.path.exists(beside) else Path(path)
