# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report of an evaluation: a page with its table, a picture, and a recording."""

from collections.abc import Sequence
from pathlib import Path

from hnn_vi_ros.learning.judging.evaluation import Fan
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.viewer.rerun_predictions import PredictedRun, write_predictions
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

REPORT, PICTURE, RECORDING = 'report.md', 'predictions.png', 'predictions.rrd'
# Predictions begin four times while one lasts: denser ones hide one another.
_OVERLAP = 4
# Those of a run in a recording, and how many times as long as one the picture is.
_MOST, _WINDOW = 80, 12.0
# Side by side these are told apart, by people who see no red or no green as well (Okabe, Ito).
_COLORS = '#d55e00', '#0072b2', '#009e73', '#cc79a7'
_INK = '#333333'
# Room above and below what was measured, in its range; predictions may leave it.
_ROOM = 0.25


def write_evaluation(folder: Path, name: str, text: str, fans: Sequence[Fan], horizon: float,
                     coordinates: Sequence[Coordinate]) -> None:
    """
    Write the page, the picture and the recording of an evaluation.

    Parameters
    ----------
    folder : Path
        An empty one.
    name : str
        Of what was judged.
    text : str
        What is known of it: Markdown.
    fans : sequence of Fan
        Its predictions.
    horizon : float
        How much of each is shown [s].
    coordinates : sequence of Coordinate
        d of them.

    """
    runs = shown(fans, horizon)
    draw_predictions(folder / PICTURE, name, coordinates, runs)
    write_predictions(folder / RECORDING, name, coordinates, runs)
    (folder / REPORT).write_text(
        f'# {name}\n\n{text}\n\n![Predictions over the measurement]({PICTURE})\n\n'
        f'All runs: `rerun {RECORDING}`.\n', encoding='utf-8')


def shown(fans: Sequence[Fan], horizon: float) -> list[PredictedRun]:
    """Return as many predictions, of one horizon [s] each, as can be told apart."""
    runs = []
    for motion, starts, q in fans:
        last = round(horizon / motion.spacing)
        # Of a long run only some: at even distances, all over it.
        apart = max(last / _OVERLAP, len(motion.t) / _MOST)
        keep = np.unique(np.searchsorted(starts, np.arange(0.0, starts[-1] + 1.0, apart)))
        predicted = []
        for row in keep[keep < len(starts)]:
            t, path = motion.t[starts[row]:][:last + 1], q[row, :last + 1]
            # A simulation that failed, or that left all bounds, is drawn for as long as it ran.
            end = min(len(t), int(np.isfinite(path).all(axis=1).cumprod().sum()))
            predicted.append((t[:end], path[:end]))
        runs.append(PredictedRun(motion.name, motion.t, motion.q, predicted))
    return runs


def draw_predictions(path: Path, name: str, coordinates: Sequence[Coordinate],
                     runs: Sequence[PredictedRun]) -> None:
    """Write a picture of the predictions over the middle of the longest run."""
    run = max(runs, key=lambda candidate: candidate.t[-1] - candidate.t[0])
    length = max((t[-1] - t[0] for t, _ in run.predicted), default=0.0)
    middle, half = 0.5 * (run.t[0] + run.t[-1]), 0.5 * _WINDOW * length
    window = max(middle - half, run.t[0]), min(middle + half, run.t[-1])
    inside = (run.t >= window[0]) & (run.t <= window[1])
    predicted = [(t, q) for t, q in run.predicted if t[0] >= window[0] and t[-1] <= window[1]]
    d = len(coordinates)
    figure = Figure(figsize=(11.0, 1.2 + max(2.0, 6.0 / d) * d), layout='constrained')
    FigureCanvasAgg(figure)
    figure.suptitle(f'{name}: predictions of {length:.3g} s over run {run.name}')
    grid = figure.subplots(d, 1, sharex=True, squeeze=False)[:, 0]
    for i, (axes, coordinate) in enumerate(zip(grid, coordinates, strict=True)):
        measured = run.q[inside, i]
        axes.plot(run.t[inside], measured, color=_INK, linewidth=2.2, label='measured')
        for k, (t, q) in enumerate(predicted):
            color = _COLORS[k % len(_COLORS)]
            axes.plot(t, q[:, i], color=color, linewidth=0.9,
                      label='predicted, from each dot' if k == 0 else None)
            axes.plot(t[:1], q[:1, i], '.', color=color, markersize=4.0)
        low, high = measured.min(), measured.max()
        room = _ROOM * (high - low) or 1.0
        axes.set(xlim=window, ylim=(low - room, high + room),
                 ylabel=f'{coordinate.name} [{coordinate.q_unit}]')
        axes.grid(alpha=0.3)
    grid[0].legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    grid[-1].set_xlabel('t [s]')
    figure.savefig(path, dpi=130)
