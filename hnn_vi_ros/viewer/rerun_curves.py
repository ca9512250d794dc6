# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Curves over the steps of a training run, for the rerun viewer."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from hnn_vi_ros.viewer.rerun_layout import PALETTE
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

_LEAST = np.finfo(np.float64).tiny


def write_curves(path: Path, name: str,
                 curves: Mapping[str, tuple[Sequence[int], Sequence[float]]]) -> None:
    """
    Write curves to a recording, as their decimal logarithms: the viewer has no such axis.

    Parameters
    ----------
    path : Path
        The .rrd file to write.
    name : str
        Of the run.
    curves : mapping of str to (sequence of int, sequence of float)
        For each, its steps and its positive values.

    """
    recording = rr.RecordingStream('hnn_vi_ros_training', recording_id=name)
    recording.save(path)
    recording.send_blueprint(rrb.Blueprint(
        rrb.TimeSeriesView(origin='/log10', name=f'{name}: log10 of the loss'),
        collapse_panels=True))
    for (label, (steps, values)), color in zip(curves.items(), PALETTE, strict=False):
        entity = f'/log10/{rr.escape_entity_path_part(label)}'
        recording.log(entity, rr.SeriesLines(names=label, colors=color), static=True)
        recording.send_columns(
            entity, indexes=[rr.TimeColumn('step', sequence=np.asarray(steps, dtype=np.int64))],
            columns=rr.Scalars.columns(scalars=np.log10(np.maximum(values, _LEAST))))
    recording.flush()
    recording.disconnect()
