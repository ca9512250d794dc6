# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Logarithmic diagrams of a work-precision study as a rerun recording."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

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
        Name of the entity, without spaces; diagrams of one name share a view.
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
