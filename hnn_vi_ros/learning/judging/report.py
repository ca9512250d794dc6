# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report of a training run, beside its model: pictures, curves, and a page about it."""

from pathlib import Path
import platform
from typing import NamedTuple

from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.learning.fit.config import TrainingConfig
from hnn_vi_ros.learning.fit.loop import LossHistory
from hnn_vi_ros.learning.fit.problem import Comparison
from hnn_vi_ros.models.energy_error import interval_text
from hnn_vi_ros.models.model_card import ModelCard
from hnn_vi_ros.viewer.rerun_curves import write_curves
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
import torch

_MOST_ROWS = 4  # of coordinates in the picture of the field
_MOST_ARROWS, _MOST_POINTS = 150, 2000


class Outputs(NamedTuple):
    """The files of a run, all beside the model."""

    model: Path
    losses: Path
    curves: Path
    field: Path
    report: Path

    @classmethod
    def beside(cls, model: Path) -> 'Outputs':
        """Return the files of a model."""
        return cls(model, *(model.with_suffix(suffix) for suffix in (
            '.loss.png', '.loss.rrd', '.field.png', '.report.md')))


def write_report(outputs: Outputs, config: TrainingConfig, card: ModelCard, history: LossHistory,
                 comparison: Comparison, seconds: float, device: str) -> None:
    """
    Write the pictures, the curves and the page of a run.

    Parameters
    ----------
    outputs : Outputs
        Where to.
    config : TrainingConfig
        How was trained.
    card : ModelCard
        What came of it.
    history : LossHistory
        How the losses fell.
    comparison : Comparison
        What the model says of held-out data, beside what they are.
    seconds : float
        Wall time of the training.
    device : str
        Where it ran.

    """
    plot_history(history, card.name, outputs.losses)
    write_curves(outputs.curves, card.name, {
        'training': (history.train_step, history.train),
        'validation': (history.validation_step, history.validation)})
    plot_field(comparison, card, outputs.field)
    outputs.report.write_text(
        _page(outputs, config, card, history, comparison, seconds, device), encoding='utf-8')


def plot_history(history: LossHistory, name: str, path: Path) -> None:
    """Write the loss curves as a PNG."""
    figure = Figure(figsize=(7.0, 4.5), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.semilogy(history.train_step, history.train, label='training, with every term')
    axes.semilogy(history.validation_step, history.validation, '--', label='validation')
    axes.axvline(history.adam_steps, color='0.6', linewidth=0.8)
    axes.annotate('L-BFGS', (history.adam_steps, 0.97), (4, 0), va='top', color='0.4',
                  xycoords=('data', 'axes fraction'), textcoords='offset points')
    axes.set(title=name, xlabel='step (Adam, then L-BFGS)',
             ylabel='loss [-]: squared field error / mean squared field')
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def plot_field(comparison: Comparison, card: ModelCard, path: Path) -> None:
    """Write a picture of the learned against the true field, or of its residuals on data."""
    rows = min(len(card.coordinates), _MOST_ROWS)
    columns = 2 if comparison.states is not None else 1
    figure = Figure(figsize=(6.0 * columns, 4.0 * rows), layout='constrained')
    FigureCanvasAgg(figure)
    figure.suptitle(f'{card.name}: learned field against '
                    f'{"the true one" if comparison.exact else "held-out data"}')
    grid = figure.subplots(rows, columns, squeeze=False)
    for i in range(rows):
        if comparison.states is not None:
            _draw_arrows(grid[i, 0], comparison, card, i)
        _draw_residuals(grid[i, -1], comparison, card, i)
    figure.savefig(path, dpi=110)


def _draw_arrows(axes, comparison: Comparison, card: ModelCard, i: int) -> None:
    d, coordinate = len(card.coordinates), card.coordinates[i]
    # A loss over several steps has the first of them first.
    states = comparison.states[:_MOST_ARROWS]
    x, y = states[:, i], states[:, d + i]
    box = np.array([card.box.q[i], card.box.p[i]])
    # Arrows keep their direction in the picture: both axes in units of the box.
    size = np.ptp(box, axis=1)
    for values, color, width, label in (
            (comparison.target, '0.7', 0.008, 'true' if comparison.exact else 'data'),
            (comparison.predicted, '#1f77b4', 0.003, 'learned')):
        u, v = values[:len(states), i] / size[0], values[:len(states), d + i] / size[1]
        axes.quiver(x, y, u, v, angles='uv', color=color, width=width, label=label,
                    scale=20.0 * np.sqrt(np.mean(comparison.target[:, i]**2)) / size[0])
    limits = box + 0.15 * size[:, None] * [-1.0, 1.0]  # arrows stick out
    axes.set(xlim=limits[0], ylim=limits[1], xlabel=f'{coordinate.name} [{coordinate.q_unit}]',
             ylabel=f'its momentum [{coordinate.p_unit}]',
             title='field at held-out states' + (', projected' if d > 1 else ''))
    axes.legend(loc='upper right', framealpha=0.6)


def _draw_residuals(axes, comparison: Comparison, card: ModelCard, i: int) -> None:
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


def _page(outputs: Outputs, config: TrainingConfig, card: ModelCard, history: LossHistory,
          comparison: Comparison, seconds: float, device: str) -> str:
    facts = {
        'family': card.family, 'data': card.dataset, 'seed': card.seed,
        'loss': config.loss.kind, 'steps': history.train_step[-1],
        'best step': history.best_step, 'wall time': f'{seconds:.1f} s on {device}, '
        f'{platform.machine()}, torch {torch.__version__}',
        'command': f'`{card.training_command}`',
        **{key: f'{value:.4g}' for key, value in card.losses.items()}}
    if card.energy_error is not None:
        error = card.energy_error
        facts |= {
            f'energy error, {name} [J]': f'{value:.3g} ({interval_text(interval)}), against the '
            f'{error.compared_with} at {error.states} states, which vary by {error.spread:.3g}'
            for name, value, interval in (('RMS', error.rms, error.rms_interval),
                                          ('largest', error.sup, error.sup_interval))}
    rows = '\n'.join(f'| {key} | {value} |' for key, value in facts.items())
    settings = dump_yaml(config.model_dump(mode='json', exclude_unset=True))
    return (f'# {card.name}\n\n{config.description}\n\n| | |\n|---|---|\n{rows}\n\n'
            f'![Losses]({outputs.losses.name})\n\n![Field]({outputs.field.name})\n\n'
            f'The losses as curves: `rerun {outputs.curves.name}`.\n\n'
            f'## Configuration\n\n```yaml\n{settings}```\n')
