# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Logarithmic diagrams, training curves and predictions as rerun recordings."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.viewer.rerun_blueprint import PALETTE, WHITE
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


_TIME = 'time'


class PredictedRun(NamedTuple):
    """
    A measured run, and what was predicted of it.

    Parameters
    ----------
    name : str
        Of the run.
    t : np.ndarray, shape (N,)
        Times [s].
    q : np.ndarray, shape (N, d)
        Measured coordinates.
    predicted : sequence of (np.ndarray of shape (m,), np.ndarray of shape (m, d))
        Times and coordinates of each prediction, all of them finite.

    """

    name: str
    t: np.ndarray
    q: np.ndarray
    predicted: Sequence[tuple[np.ndarray, np.ndarray]]


def write_predictions(path: Path, name: str, coordinates: Sequence[Coordinate],
                      runs: Sequence[PredictedRun]) -> None:
    """
    Write a recording with a tab for each run and a view for each of its coordinates.

    Parameters
    ----------
    path : Path
        The .rrd file to write.
    name : str
        Of what predicts.
    coordinates : sequence of Coordinate
        d of them.
    runs : sequence of PredictedRun
        Each over its own time.

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
                _send(stream, f'{origin}/predicted/{k}', f'from {t[0]:.6g} s', t, q[:, i],
                      rr.SeriesLines.from_fields(colors=PALETTE[k % len(PALETTE)], widths=1.0))
            _send(stream, f'{origin}/measured', 'measured', run.t, run.q[:, i],
                  rr.SeriesLines.from_fields(colors=WHITE, widths=2.0))
        tabs.append(rrb.Vertical(*views, name=run.name))
    stream.send_blueprint(rrb.Blueprint(
        rrb.Tabs(*tabs), rrb.TimePanel(timeline=_TIME, state='collapsed'), collapse_panels=True))
    stream.flush()
    stream.disconnect()


def _send(stream: rr.RecordingStream, entity: str, name: str, t: np.ndarray, values: np.ndarray,
          style: rr.SeriesLines) -> None:
    stream.log(entity, style, rr.SeriesLines.from_fields(names=name), static=True)
    stream.send_columns(entity, indexes=[rr.TimeColumn(_TIME, duration=t)],
                        columns=rr.Scalars.columns(scalars=values))


_BACKGROUND, _INK, _GRID = (255, 255, 255), (60, 60, 60), (225, 225, 225)
# A decade upwards is this much of a decade to the right, so that a diagram fits its view.
_HEIGHT = 0.4


@dataclass(frozen=True)
class Curve:
    """A named line: its colour (red, green, blue), and points (x, y), all positive."""

    name: str
    color: tuple[int, ...]
    points: Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Diagram:
    """
    Diagram of one horizon.

    Parameters
    ----------
    name : str
        Of the entity, without spaces; diagrams of one name share a view.
    title, x_label, y_label : str
        For people.
    horizon : float
        When on the timeline [s].
    curves : sequence of Curve
        The lines.
    floor : float
        A horizontal line; NaN for none.
    notes : str
        Markdown to read with it.

    """

    name: str
    title: str
    x_label: str
    y_label: str
    horizon: float
    curves: Sequence[Curve]
    floor: float
    notes: str


def record_diagrams(path: Path, application: str, diagrams: Iterable[Diagram]) -> None:
    """Write a recording, which must not exist; the horizons are its timeline ``horizon``."""
    diagrams = list(diagrams)
    stream = rr.RecordingStream(f'hnn_vi_ros_{application}')
    stream.save(path)
    views = {diagram.name: rrb.Spatial2DView(
        name=f'{diagram.title}: {diagram.y_label} over {diagram.x_label}',
        origin=f'/{diagram.name}', background=_BACKGROUND) for diagram in diagrams}
    stream.send_blueprint(rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(*views.values()),
                     rrb.TextDocumentView(name='Cheapest', origin='/notes'),
                     row_shares=[0.72, 0.28]),
        rrb.TimePanel(timeline='horizon'), collapse_panels=True))
    for diagram in diagrams:
        stream.set_time('horizon', duration=diagram.horizon)
        _log(stream, diagram)
        stream.log('/notes', rr.TextDocument(
            f'## T = {diagram.horizon:g} s\n\n{diagram.notes}', media_type='text/markdown'))
    stream.disconnect()


def _log(stream: rr.RecordingStream, diagram: Diagram) -> None:
    stream.log(f'/{diagram.name}', rr.Clear(recursive=True))
    if not diagram.curves:
        return
    points = np.log10(np.vstack([curve.points for curve in diagram.curves]))
    low, high = np.floor(points.min(axis=0)), np.ceil(points.max(axis=0))
    _log_grid(stream, f'/{diagram.name}/axes', low, high)
    for curve in diagram.curves:
        places = _place(np.log10(np.array(curve.points)))
        entity = f'/{diagram.name}/{rr.escape_entity_path_part(curve.name)}'
        stream.log(entity, rr.LineStrips2D(
            [places], colors=[curve.color], radii=rr.Radius.ui_points(1.2)))
        stream.log(f'{entity}/runs', rr.Points2D(
            places, colors=[curve.color], radii=rr.Radius.ui_points(4.0),
            labels=[*[''] * (len(places) - 1), curve.name], show_labels=True))
    if not math.isnan(diagram.floor):
        height = math.log10(diagram.floor)
        stream.log(f'/{diagram.name}/floor', rr.LineStrips2D(
            [_place(np.array([[low[0], height], [high[0], height]]))], colors=[_INK],
            labels=[f'the learned H is off by {diagram.floor:.2g}'],
            radii=rr.Radius.ui_points(1.0)))


def _log_grid(stream: rr.RecordingStream, entity: str, low: np.ndarray, high: np.ndarray) -> None:
    columns, rows = (range(int(a), int(b) + 1) for a, b in zip(low, high, strict=True))
    lines = [[(x, low[1]), (x, high[1])] for x in columns]
    lines += [[(low[0], y), (high[0], y)] for y in rows]
    stream.log(entity, rr.LineStrips2D(
        [_place(np.array(line, dtype=float)) for line in lines], colors=[_GRID],
        radii=rr.Radius.ui_points(0.5)))
    marks = [((x, low[1] - 0.3), f'1e{x}') for x in columns]
    marks += [((low[0] - 0.3, y), f'1e{y}') for y in rows if (y - low[1]) % 2 == 0]
    stream.log(f'{entity}/marks', rr.Points2D(
        _place(np.array([place for place, _ in marks], dtype=float)), colors=[_INK],
        radii=rr.Radius.ui_points(0.01), labels=[text for _, text in marks], show_labels=True))


def _place(points: np.ndarray) -> np.ndarray:
    """Turn decades into places; the viewer's y axis points down."""
    return points * np.array([1.0, -_HEIGHT])
