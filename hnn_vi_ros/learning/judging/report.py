# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reports of training and evaluation: a Markdown page and pictures."""

from collections.abc import Callable, Sequence
from pathlib import Path
import platform
from typing import Any, NamedTuple

from hnn_vi_ros.files import dump_yaml, save_figure, write_text
from hnn_vi_ros.learning.fit.config import TrainingConfig
from hnn_vi_ros.learning.fit.loop import LossHistory
from hnn_vi_ros.learning.fit.shooting import Solution
from hnn_vi_ros.learning.judging.evaluation import TrajectoryBundle
from hnn_vi_ros.models import Checkpoint, interval_text, ModelCard, ratio_unit
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.scene import Scene
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
import numpy as np
import torch

# Limits of the field picture: rows of coordinates, arrows, points.
_MOST_ROWS, _MOST_ARROWS, _MOST_POINTS = 4, 150, 2000
# Maximum number of lags of an autocorrelation.
_MOST_LAGS = 100
# File names of an evaluation.
REPORT, PICTURE = 'report.md', 'predictions.png'
# Number of predictions that start during one prediction; more would hide one another.
_OVERLAP = 4
# Maximum number of predictions per run in the picture; width of the picture in predictions.
_MOST, _WINDOW = 80, 12.0
# Colours distinguishable with colour blindness (Okabe, Ito).
_COLORS = '#d55e00', '#0072b2', '#009e73', '#cc79a7'
_MEASURED = '#b8b8b8'
# Margin above and below the measured range, as a share of it; predictions may leave it.
_ROOM = 0.25


class Outputs(NamedTuple):
    """Paths of the files of a training run, in the folder of the model."""

    model: Path
    losses: Path
    picture: Path
    report: Path
    residuals: Path
    scene: Path
    table: Path

    @classmethod
    def beside(cls, model: Path, picture: str) -> 'Outputs':
        """Return the output paths of a model, with this name of the picture."""
        return cls(model, *(model.with_suffix(suffix) for suffix in (
            '.loss.png', f'.{picture}.png', '.report.md', '.residuals.png', '.scene.yaml',
            '.loss.csv')))


class PredictedRun(NamedTuple):
    """
    A measured run with its predictions.

    Parameters
    ----------
    name : str
        Name of the run.
    t : np.ndarray, shape (N,)
        Times of the measurement [s].
    q : np.ndarray, shape (N, d)
        Measured coordinates.
    predicted : sequence of (np.ndarray, np.ndarray)
        Times and coordinates of each prediction.

    """

    name: str
    t: np.ndarray
    q: np.ndarray
    predicted: Sequence[tuple[np.ndarray, np.ndarray]]


class Judged(NamedTuple):
    """
    Result of judging a trained model.

    Parameters
    ----------
    checkpoint : Checkpoint
        The model with the result on its card.
    text : str
        Printed result.
    page : str
        Result for the report, in Markdown.
    draw : callable, optional
        ``draw(path)`` writes the picture.
    residuals : Solution, optional
        Fit of the initial states of held-out motions, whose residuals are drawn.
    scene : callable, optional
        ``scene(model, place)`` returns a scene at a path in the folder of the model of this name.
    open_scale : str, optional
        Unit of the quantity that fixes the scale of all forces by convention, '' if the data do.

    """

    checkpoint: Checkpoint
    text: str
    page: str
    draw: Callable[[Path], None] | None = None
    residuals: Solution | None = None
    scene: Callable[[str, Path], Scene] | None = None
    open_scale: str = ''


def page(title: str, *parts: str) -> str:
    """Join the non-empty parts to a Markdown page."""
    return '\n\n'.join([f'# {title}', *filter(None, parts)]) + '\n'


def write_report(outputs: Outputs, config: TrainingConfig, judged: Judged, history: LossHistory,
                 seconds: float, device: str) -> None:
    """
    Write the pictures and the page of a training run.

    Parameters
    ----------
    outputs : Outputs
        Paths of the files.
    config : TrainingConfig
        Configuration of the training.
    judged : Judged
        Result of judging the model.
    history : LossHistory
        Losses during the training.
    seconds : float
        Wall time of the training.
    device : str
        Device of the training.

    """
    card, pictures = judged.checkpoint.card, list[str]()
    if judged.draw is not None:
        judged.draw(outputs.picture)
        pictures += [f'![{outputs.picture.name}]({outputs.picture.name})']
    if judged.residuals is not None:
        plot_residuals(judged.residuals, card, outputs.residuals)
        pictures += [f'![Residuals]({outputs.residuals.name})']
    if judged.scene is not None:
        write_text(outputs.scene, judged.scene(outputs.model.name, outputs.scene).to_yaml())
    if history.train:
        plot_history(history, card.name, outputs.losses)
        write_text(outputs.table, losses_text(history))
        pictures += [f'![Losses]({outputs.losses.name})']
    facts: dict[str, Any] = {
        'family': card.family, 'data': card.dataset, 'seed': card.seed,
        **({'steps': history.train_step[-1], 'best step': history.best_step}
           if history.train else {}),
        'wall time': f'{seconds:.1f} s on {device}, {platform.machine()}, torch '
        f'{torch.__version__}', 'command': f'`{card.training_command}`',
        **{key: f'{value:.4g}' for key, value in card.losses.items()}}
    if card.domain is not None:
        facts['range of the data'] = card.domain.text(
            [(one.name, one.q_unit, one.p_unit) for one in card.coordinates])
    if judged.scene is not None:
        facts['scene'] = f'`hnn run {outputs.scene.name}`'
    if card.energy_error is not None:
        error, unit = card.energy_error, ratio_unit('J', judged.open_scale)
        facts |= {
            f'energy error, RMS [{unit}]':
                f'{error.rms:.3g} ({interval_text(error.rms_interval)}), against the '
                f'{error.compared_with}, which varies by {error.spread:.3g}',
            f'energy error, largest [{unit}]': f'{error.sup:.3g} of {error.states} states'}
    table = '\n'.join(['| | |', '|---|---|', *(
        f'| {key} | {value} |' for key, value in facts.items())])
    settings = dump_yaml(config.model_dump(mode='json', exclude_unset=True))
    write_text(outputs.report, page(
        card.name, config.description, table, judged.page, *pictures,
        f'## Configuration\n\n```yaml\n{settings}```'))


def losses_text(history: LossHistory) -> str:
    """Return the losses by step as text with commas, in a row for each step that has one."""
    train, held_out = (dict(zip(steps, losses, strict=True)) for steps, losses in (
        (history.train_step, history.train), (history.validation_step, history.validation)))
    rows = [f'{step},{train.get(step, "")},{held_out.get(step, "")}'
            for step in sorted(train.keys() | held_out)]
    return '\n'.join(['step,training,validation', *rows, ''])


def plot_history(history: LossHistory, name: str, path: Path) -> None:
    """Write the loss curves as a PNG, with a line at the start of each stage."""
    figure = Figure(figsize=(7.0, 4.5), layout='constrained')
    axes = figure.add_subplot()
    axes.semilogy(history.train_step, history.train, label='training, all terms')
    if history.validation:
        axes.semilogy(history.validation_step, history.validation, '--', label='validation')
    for stage, step in history.begins.items():
        axes.axvline(step, color='0.6', linewidth=0.8)
        axes.annotate(stage, (step, 0.97), (4, 0), va='top', color='0.4',
                      xycoords=('data', 'axes fraction'), textcoords='offset points')
    axes.set(title=name, xlabel='step', ylabel='loss [-], relative to the data')
    axes.legend()
    axes.grid(alpha=0.3)
    save_figure(path, figure, 150)


def plot_residuals(fitted: Solution, card: ModelCard, path: Path) -> None:
    """
    Plot the residuals along the longest window and their autocorrelation.

    That of white noise is within 1.96 / sqrt(N) of 0 for 95 % of the lags; a model that lacks a
    force leaves longer correlations.
    """
    windows, run = fitted.windows, int(fitted.windows.there.sum(axis=1).argmax())
    there = windows.there[run]
    d, t = len(card.coordinates), windows.times[run] + windows.spacing * np.flatnonzero(there)
    figure = Figure(figsize=(11.0, 1.0 + 2.4 * d), layout='constrained')
    figure.suptitle(f'{card.name}: residuals over run {windows.motions[windows.run[run]].name}',
                    parse_math=False)
    for (left, right), coordinate, residuals in zip(
            figure.subplots(d, 2, squeeze=False), card.coordinates,
            fitted.residuals[run, there].T, strict=False):
        left.plot(t, residuals, color=_COLORS[1], linewidth=0.8)
        left.set(ylabel=f'{coordinate.name}, residual / noise')
        rest = residuals - residuals.mean()
        lags = np.arange(min(_MOST_LAGS, len(rest) // 2))
        own = np.array([rest[:len(rest) - k] @ rest[k:] for k in lags]) / (rest @ rest + 1e-300)
        right.vlines(lags * windows.spacing, 0.0, own, color=_COLORS[1])
        right.axhspan(*1.96 / np.sqrt(len(rest)) * np.array([-1.0, 1.0]), color='0.9', zorder=0,
                      label='95 % of white noise')
        right.set(ylabel='autocorrelation', ylim=(min(-0.5, 1.1 * own.min()), 1.05))
        for axes in (left, right):
            axes.grid(alpha=0.3)
    left.set_xlabel('t [s]')
    right.set_xlabel('lag [s]')
    right.legend(loc='upper right')
    save_figure(path, figure, 130)


class Comparison(NamedTuple):
    """
    Predictions of a model for held-out data, with the data.

    Parameters
    ----------
    states : np.ndarray, shape (M, 2 d), or None
        States of the first rows of the loss; None if predictions are not made from states.
    target, predicted : np.ndarray, shape (N, k)
        Rates of change or accelerations.
    units : np.ndarray, shape (k,)
        Root mean square of the target.
    parts : tuple of str
        Names of the equal parts of a row.
    exact : bool
        True if the target is the field of an exact system.

    """

    states: np.ndarray | None
    target: np.ndarray
    predicted: np.ndarray
    units: np.ndarray
    parts: tuple[str, ...]
    exact: bool


def plot_field(comparison: Comparison, card: ModelCard, path: Path) -> None:
    """Plot the learned and the true field, or the residuals on data."""
    rows = min(len(card.coordinates), _MOST_ROWS)
    columns = 2 if comparison.states is not None else 1
    figure = Figure(figsize=(6.0 * columns, 4.0 * rows), layout='constrained')
    figure.suptitle(f'{card.name}: learned field against '
                    f'{"the true one" if comparison.exact else "held-out data"}', parse_math=False)
    grid = figure.subplots(rows, columns, squeeze=False)
    for i in range(rows):
        if comparison.states is not None:
            _draw_arrows(grid[i, 0], comparison, card, i)
        _draw_residuals(grid[i, -1], comparison, card, i)
    save_figure(path, figure, 110)


def _draw_arrows(axes: Any, comparison: Comparison, card: ModelCard, i: int) -> None:
    d, coordinate = len(card.coordinates), card.coordinates[i]
    # A loss over several steps stores the first step first.
    assert comparison.states is not None, 'drawn where there are some'
    states = comparison.states[:_MOST_ARROWS]
    x, y = states[:, i], states[:, d + i]
    box = np.array([card.box.q[i], card.box.p[i]])
    # Scaling both axes by the box keeps the arrows' directions in the picture.
    size = np.ptp(box, axis=1)
    for values, color, width, label in (
            (comparison.target, '0.7', 0.008, 'true' if comparison.exact else 'data'),
            (comparison.predicted, '#1f77b4', 0.003, 'learned')):
        u, v = values[:len(states), i] / size[0], values[:len(states), d + i] / size[1]
        axes.quiver(x, y, u, v, angles='uv', color=color, width=width, label=label,
                    scale=20.0 * np.sqrt(np.mean(comparison.target[:, i]**2)) / size[0])
    limits = box + 0.15 * size[:, None] * [-1.0, 1.0]  # room for the arrows
    axes.set(xlim=limits[0], ylim=limits[1], xlabel=f'{coordinate.name} [{coordinate.q_unit}]',
             ylabel=f'momentum [{coordinate.p_unit}]',
             title='field at held-out states' + (', projected' if d > 1 else ''))
    axes.legend(loc='upper right', framealpha=0.6)


def _draw_residuals(axes: Any, comparison: Comparison, card: ModelCard, i: int) -> None:
    d = len(card.coordinates)
    for k, part in enumerate(comparison.parts):
        unit = comparison.units[k * d + i]
        target = comparison.target[:_MOST_POINTS, k * d + i] / unit
        error = comparison.predicted[:_MOST_POINTS, k * d + i] / unit - target
        axes.plot(target, error, '.', markersize=3.0,
                  label=f'{part} of {card.coordinates[i].name}')
    axes.axhline(0.0, color='0.6', linewidth=0.8)
    axes.set(xlabel=f'{"true rate" if comparison.exact else "rate in the data"} / its RMS',
             ylabel='error / RMS of the rate', title='residuals at held-out states')
    axes.legend(loc='upper right')
    axes.grid(alpha=0.3)


def write_evaluation(folder: Path, name: str, text: str, fans: Sequence[TrajectoryBundle],
                     horizon: float, coordinates: Sequence[Coordinate]) -> None:
    """
    Write the page and the picture of an evaluation.

    Parameters
    ----------
    folder : Path
        Empty folder for the files.
    name : str
        Name of the judged model or scene.
    text : str
        Result in Markdown.
    fans : sequence of TrajectoryBundle
        Predictions of the model.
    horizon : float
        Displayed duration of each prediction [s].
    coordinates : sequence of Coordinate
        The d coordinates.

    """
    runs = shown(fans, horizon)
    draw_predictions(folder / PICTURE, name, coordinates, runs)
    write_text(folder / REPORT, page(
        name, text, f'![Predictions over the measurement]({PICTURE})'))


def shown(fans: Sequence[TrajectoryBundle], horizon: float) -> list[PredictedRun]:
    """Select distinguishable predictions, each cut to one horizon [s]."""
    runs = []
    for motion, starts, q in fans:
        last = round(horizon / motion.spacing)
        # A long run shows an evenly spaced selection.
        apart = max(last / _OVERLAP, len(motion.t) / _MOST)
        keep = np.unique(np.searchsorted(starts, np.arange(0.0, starts[-1] + 1.0, apart)))
        predicted = []
        for row in keep[keep < len(starts)]:
            t, path = motion.t[starts[row]:][:last + 1], q[row, :last + 1]
            # Draw a failed or stopped simulation up to its last finite value.
            end = min(len(t), int(np.isfinite(path).all(axis=1).cumprod().sum()))
            predicted.append((t[:end], path[:end]))
        runs.append(PredictedRun(motion.name, motion.t, motion.q, predicted))
    return runs


def draw_predictions(path: Path, name: str, coordinates: Sequence[Coordinate],
                     runs: Sequence[PredictedRun]) -> None:
    """Draw the predictions over the middle of the longest run, each with its error below."""
    run = max(runs, key=lambda candidate: candidate.t[-1] - candidate.t[0])
    length = max((t[-1] - t[0] for t, _ in run.predicted), default=0.0)
    middle, half = 0.5 * (run.t[0] + run.t[-1]), 0.5 * _WINDOW * length
    window = max(middle - half, run.t[0]), min(middle + half, run.t[-1])
    inside = (run.t >= window[0]) & (run.t <= window[1])
    predicted = [(t, q) for t, q in run.predicted if t[0] >= window[0] and t[-1] <= window[1]]
    d = len(coordinates)
    figure = Figure(figsize=(11.0, 1.2 + max(2.6, 6.0 / d) * d), layout='constrained')
    figure.suptitle(f'{name}: predictions of {length:.3g} s over run {run.name}', parse_math=False)
    grid = figure.subplots(2 * d, 1, sharex=True, height_ratios=[3, 1] * d)
    for i, coordinate in enumerate(coordinates):
        axes, lower = grid[2 * i:2 * i + 2]
        measured = run.q[inside, i]
        line, = axes.plot(run.t[inside], measured, color=_MEASURED, linewidth=4.5)
        drawn = []
        for k, (t, q) in enumerate(predicted):
            color = _COLORS[k % len(_COLORS)]
            drawn += axes.plot(t, q[:, i], color=color, linewidth=1.4)
            start, = axes.plot(t[:1], q[:1, i], 'o', color=color, markersize=4.0)
            lower.plot(t, q[:, i] - np.interp(t, run.t, run.q[:, i]), color=color, linewidth=1.0)
        low, high = measured.min(), measured.max()
        room = _ROOM * (high - low) or 1.0
        axes.set(xlim=window, ylim=(low - room, high + room),
                 ylabel=f'{coordinate.name} [{coordinate.q_unit}]')
        lower.set_ylabel(f'error [{coordinate.q_unit}]')
        lower.axhline(0.0, color='0.6', linewidth=0.8)
        for one in (axes, lower):
            one.grid(alpha=0.3)
    entries = {'measured': line} | ({} if not predicted else {
        'predictions, of which several overlap': tuple(drawn[:len(_COLORS)]),
        'start of a prediction': start, 'error: predicted - measured (lower panels)':
        tuple(drawn[:len(_COLORS)])})
    figure.legend(entries.values(), entries.keys(), loc='outside lower center', ncols=4,
                  frameon=False, handler_map={tuple: HandlerTuple(ndivide=None, pad=0.2)},
                  handlelength=3.0)
    figure.align_ylabels()
    grid[-1].set_xlabel('t [s]')
    save_figure(path, figure, 130)
