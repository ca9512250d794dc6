# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report of an identification: a page with its table, and pictures."""

from collections.abc import Sequence
from pathlib import Path

from hnn_vi_ros.learning.scene_numbers.fit import Solution
from hnn_vi_ros.learning.scene_numbers.intervals import Estimates
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

REPORT, FIT, CORRELATIONS = 'report.md', 'fit.png', 'correlations.png'
_INK, _FITTED = '#333333', '#d55e00'
# Samples that are drawn of each quantity; more cannot be told apart.
_MOST = 4000
_INTERVAL = 1.96


def write_identification(folder: Path, text: str, solution: Solution, estimates: Estimates,
                         channels: Sequence[tuple[str, str]]) -> None:
    """
    Write the page and the pictures of an identification.

    Parameters
    ----------
    folder : Path
        An empty one.
    text : str
        Text of the report: Markdown.
    solution : Solution
        The fit.
    estimates : Estimates
        What it tells.
    channels : sequence of (str, str)
        Name and unit of each measured quantity.

    """
    draw_fit(folder / FIT, solution, channels)
    draw_correlations(folder / CORRELATIONS, estimates)
    (folder / REPORT).write_text(
        f'# Identification\n\n{text}\n\n![Fit and residuals of the longest run]({FIT})\n\n'
        f'![Correlations of the errors]({CORRELATIONS})\n', encoding='utf-8')


def draw_fit(path: Path, solution: Solution, channels: Sequence[tuple[str, str]]) -> None:
    """Draw measurement and fit of the longest run, and the residuals with their noise."""
    windows = solution.windows
    runs = [len(motion.t) for motion in windows.motions]
    run = int(np.argmax(runs))
    own = np.flatnonzero(windows.run == run)
    t = np.concatenate([windows.motions[run].t[windows.first[w]:][:windows.there[w].sum()]
                        for w in own])
    measured, residuals = (np.concatenate([part[w][windows.there[w]] for w in own])
                           for part in (windows.measured, solution.residuals))
    fitted, thin = measured + residuals * solution.noise, max(1, len(t) // _MOST)
    count = len(channels)
    figure = Figure(figsize=(12.0, 1.0 + 2.2 * count), layout='constrained')
    FigureCanvasAgg(figure)
    grid = figure.subplots(count, 2, sharex=True, squeeze=False)
    for c, (name, unit) in enumerate(channels):
        left, right = grid[c]
        left.plot(t[::thin], measured[::thin, c], '.', color=_INK, markersize=2.5,
                  label='measured')
        left.plot(t[::thin], fitted[::thin, c], color=_FITTED, linewidth=1.0, label='fitted')
        left.set_ylabel(f'{name} [{unit}]')
        right.plot(t[::thin], residuals[::thin, c], '.', color=_FITTED, markersize=2.5)
        for side in (-_INTERVAL, _INTERVAL):
            right.axhline(side, color=_INK, linewidth=0.7, linestyle='--')
        right.set_ylabel(f'{name}: residual / noise [1]')
        for axes in (left, right):
            axes.grid(alpha=0.3)
    grid[0, 0].legend(loc='upper right', frameon=False)
    grid[0, 1].set_title('between the dashed lines: 95 % of white noise', fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel('t [s]')
    figure.suptitle(f'run {windows.motions[run].name}')
    figure.savefig(path, dpi=130)


def draw_correlations(path: Path, estimates: Estimates) -> None:
    """Draw the correlations of the errors of all numbers that the data tell."""
    rows = [k for k, one in enumerate(estimates.estimates) if one.known]
    names = [estimates.estimates[k].name for k in rows]
    error = np.sqrt(np.diag(estimates.covariance)[rows])
    scale = np.where(error > 0.0, error, 1.0)
    matrix = estimates.covariance[np.ix_(rows, rows)] / np.outer(scale, scale)
    size = 2.5 + 0.55 * len(rows)
    figure = Figure(figsize=(size + 1.5, size), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    picture = axes.imshow(matrix, cmap='RdBu_r', vmin=-1.0, vmax=1.0)
    axes.set_xticks(range(len(rows)), names, rotation=60, ha='right')
    axes.set_yticks(range(len(rows)), names)
    for i, j in np.ndindex(*matrix.shape):
        axes.text(j, i, f'{matrix[i, j]:.2f}', ha='center', va='center', fontsize=8,
                  color='white' if abs(matrix[i, j]) > 0.6 else _INK)
    figure.colorbar(picture, ax=axes, label='correlation of the errors [1]')
    figure.savefig(path, dpi=130)
