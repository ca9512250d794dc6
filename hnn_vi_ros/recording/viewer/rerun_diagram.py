# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training curves and predictions as rerun recordings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.recording.viewer.rerun_blueprint import PALETTE, WHITE
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

_MIN_LOSS = np.finfo(np.float64).tiny


def write_curves(path: Path, name: str,
                 curves: Mapping[str, tuple[Sequence[int], Sequence[float]]]) -> None:
    """
    Write the decimal logarithms of curves to a recording: the viewer has no logarithmic axis.

    Parameters
    ----------
    path : Path
        The .rrd file to write.
    name : str
        Name of the run.
    curves : mapping of str to (sequence of int, sequence of float)
        Steps and positive values of each curve.

    """
    recording = rr.RecordingStream('hnn_vi_ros_training', recording_id=name)
    recording.save(path)
    recording.send_blueprint(rrb.Blueprint(
        rrb.TimeSeriesView(origin='/log10', name=f'{name}: log10 of the loss'),
        collapse_panels=True))
    for (label, (steps, values)), color in zip(curves.items(), PALETTE, strict=False):
        _send(recording, f'/log10/{rr.escape_entity_path_part(label)}',
              rr.TimeColumn('step', sequence=np.asarray(steps, dtype=np.int64)),
              np.log10(np.maximum(values, _MIN_LOSS)), rr.SeriesLines(names=label, colors=color))
    recording.flush()
    recording.disconnect()


_TIME = 'time'


class PredictedRun(NamedTuple):
    """
    A measured run with its predictions.

    Parameters
    ----------
    name : str
        Name of the run.
    t : np.ndarray, shape (N,)
        Times [s].
    q : np.ndarray, shape (N, d)
        Measured coordinates.
    predicted : sequence of (np.ndarray of shape (m,), np.ndarray of shape (m, d))
        Times and finite coordinates of each prediction.

    """

    name: str
    t: np.ndarray
    q: np.ndarray
    predicted: Sequence[tuple[np.ndarray, np.ndarray]]


def write_predictions(path: Path, name: str, coordinates: Sequence[Coordinate],
                      runs: Sequence[PredictedRun]) -> None:
    """
    Write a recording with a tab for each run and a view for each coordinate.

    Parameters
    ----------
    path : Path
        The .rrd file to write.
    name : str
        Name of the model that predicts.
    coordinates : sequence of Coordinate
        Tuple of d coordinates.
    runs : sequence of PredictedRun
        Runs, each with its own times.

    """
    stream = rr.RecordingStream('hnn_vi_ros_evaluation', recording_id=name)
    stream.save(path)
    tabs = []
    for number, run in enumerate(runs):
        views = []
        for i, coordinate in enumerate(coordinates):
            origin = f'/run{number}/{rr.escape_entity_path_part(coordinate.name)}'
            views.append(rrb.TimeSeriesView(
                name=f'{coordinate.name} [{coordinate.q_unit}], measured in white',
                origin=origin, plot_legend=rrb.PlotLegend(visible=False)))
            for k, (t, q) in enumerate(run.predicted):
                _send(stream, f'{origin}/predicted/{k}', rr.TimeColumn(_TIME, duration=t), q[:, i],
                      rr.SeriesLines(names=f'from {t[0]:.6g} s', widths=1.0,
                                     colors=PALETTE[k % len(PALETTE)]))
            _send(stream, f'{origin}/measured', rr.TimeColumn(_TIME, duration=run.t), run.q[:, i],
                  rr.SeriesLines(names='measured', widths=2.0, colors=WHITE))
        tabs.append(rrb.Vertical(*views, name=run.name))
    stream.send_blueprint(rrb.Blueprint(
        rrb.Tabs(*tabs), rrb.TimePanel(timeline=_TIME, state='collapsed'), collapse_panels=True))
    stream.flush()
    stream.disconnect()


def _send(stream: rr.RecordingStream, entity: str, index: rr.TimeColumn, values: np.ndarray,
          style: rr.SeriesLines) -> None:
    stream.log(entity, style, static=True)
    stream.send_columns(entity, indexes=[index], columns=rr.Scalars.columns(scalars=values))
