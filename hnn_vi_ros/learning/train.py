# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Train a model of a mechanical system: ``ros2 run hnn_vi_ros train --config NAME``.

A model of the configuration's family is fitted so that its loss is small, for the plain network
H(q, p) the error of (H_p, -H_q) against (dq/dt, dp/dt): first by Adam, which finds a good valley,
then by L-BFGS, which descends it. All in float64, on all the data at once, and the same on the
same machine for the same seed.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
import os
from pathlib import Path
import shlex
import time

from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.hamiltonians.checkpoint import Checkpoint, save_checkpoint
from hnn_vi_ros.hamiltonians.model_card import ModelCard
from hnn_vi_ros.learning.config import find_config, load_config, TrainingConfig
from hnn_vi_ros.learning.dataset import Dataset
from hnn_vi_ros.learning.problem import Problem
from hnn_vi_ros.learning.sources import make_dataset
from hnn_vi_ros.version import __version__
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
import torch
from tqdm import tqdm

# torch's L-BFGS drops curvature pairs below an absolute 1e-10: unscaled, it stops learning once
# the loss is below 1e-7.
LBFGS_SCALE = 1e8
# Steps from one look at the validation loss to the next; L-BFGS ends when as many steps gain
# less than this share of the loss.
INTERVAL = 20
LEAST_GAIN = 1e-6

Note = Callable[[int, float, bool], None]  # step, loss, whether to look at the validation loss


@dataclass
class History:
    """Losses over the steps of a run: training, and validation every so often."""

    train: list[float] = field(default_factory=list)
    train_step: list[int] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    validation_step: list[int] = field(default_factory=list)
    adam_steps: int = 0


def fit(problem: Problem, config: TrainingConfig, progress: tqdm) -> History:
    """
    Train the model of a problem in place.

    Parameters
    ----------
    problem : Problem
        Its model is changed.
    config : TrainingConfig
        Numbers of steps and the learning rate.
    progress : tqdm
        Counts the steps and shows the loss.

    Raises
    ------
    DataError
        The loss is not finite any more.

    """
    history = History(adam_steps=config.adam_steps)

    def note(step: int, loss: float, look: bool) -> None:
        if not np.isfinite(loss):
            raise DataError(f'the loss is {loss} after {step} steps; lower learning_rate, and '
                            'look for outliers in the data')
        history.train.append(loss)
        history.train_step.append(step)
        if look:
            history.validation.append(problem.validation_loss())
            history.validation_step.append(step)
        progress.update(step - progress.n)
        progress.set_postfix_str(f'loss {loss:.2e}', refresh=False)

    _run_adam(problem, config, note)
    _run_lbfgs(problem, config, note)
    return history


def _run_adam(problem: Problem, config: TrainingConfig, note: Note) -> None:
    adam = torch.optim.Adam(problem.family.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, config.adam_steps)
    for step in range(config.adam_steps):
        adam.zero_grad()
        loss = problem.loss()
        loss.backward()
        note(step, float(loss.detach()), step % INTERVAL == 0)
        adam.step()
        schedule.step()


def _run_lbfgs(problem: Problem, config: TrainingConfig, note: Note) -> None:
    lbfgs = torch.optim.LBFGS(
        problem.family.parameters(), max_iter=INTERVAL, max_eval=10 * INTERVAL,
        history_size=config.lbfgs_history, tolerance_grad=0.0, tolerance_change=0.0,
        line_search_fn='strong_wolfe')

    def closure() -> torch.Tensor:
        lbfgs.zero_grad()
        scaled = LBFGS_SCALE * problem.loss()
        scaled.backward()
        return scaled

    before = float(problem.loss().detach())
    note(config.adam_steps, before, True)
    for done in range(INTERVAL, config.lbfgs_steps + 1, INTERVAL):
        lbfgs.step(closure)
        after = float(problem.loss().detach())
        note(config.adam_steps + done, after, True)
        if before - after < LEAST_GAIN * before:
            break
        before = after


def train(config: TrainingConfig, dataset: Dataset, name: str, command: str
          ) -> tuple[Checkpoint, History]:
    """
    Train a network and describe it.

    Parameters
    ----------
    config : TrainingConfig
        How.
    dataset : Dataset
        What to learn from.
    name, command : str
        For the model card.

    Returns
    -------
    tuple of Checkpoint and History
        The trained model, not yet saved, and how the losses fell.

    Raises
    ------
    DataError
        Training diverges.

    """
    problem = Problem(config, dataset)
    with tqdm(total=config.adam_steps + config.lbfgs_steps, desc=name, unit='step',
              disable=None) as progress:
        history = fit(problem, config, progress)
    return describe(problem, config, dataset, name, command), history


def describe(problem: Problem, config: TrainingConfig, dataset: Dataset, name: str, command: str
             ) -> Checkpoint:
    """Return a trained model with its card; see train."""
    family, reference = problem.family, config.reference
    box = replace(dataset, p=family.momenta(dataset)).box
    centre = np.mean([*box.q, *box.p], axis=1)
    z0 = centre if reference is None else np.array([*reference.q, *reference.p])
    networks = family.networks(z0, 0.0 if reference is None else reference.energy)
    widths = {key: [layers.weights[0].shape[1], *(len(bias) for bias in layers.biases)]
              for key, layers in networks.items()}
    several = {'networks': widths} if len(widths) > 1 else {'widths': [*widths.values()][0]}
    card = ModelCard(
        name=name, family=config.family.kind, **several, **family.constants(),
        scheme=config.loss.scheme, coordinates=config.coordinates,
        box=box, dataset=dataset.description, seed=config.seed,
        losses=problem.final_losses(), training_command=command, package_version=__version__,
        confine=config.confine)
    return Checkpoint(card, networks)


def plot_history(history: History, name: str, path: Path) -> None:
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


def main(argv: Sequence[str] | None = None) -> None:
    """Train a model as the command line says."""
    parser = argparse.ArgumentParser(prog='train', description=__doc__.strip().split('\n')[0])
    parser.add_argument('--config', required=True, metavar='NAME|FILE',
                        help='a shipped training configuration, or a YAML file')
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='the model file to write (default: models/<name>.safetensors)')
    parser.add_argument('--data', nargs='+', default=[], metavar='FILE',
                        help='a measured log, or bags, instead of data.path')
    parser.add_argument('--seed', type=int, help="instead of the configuration's seed")
    arguments = parser.parse_args(argv)
    # Small networks gain nothing from more threads, and sums come out the same on any machine.
    torch.set_num_threads(1)
    source = find_config(arguments.config)
    config = load_config(source)
    if arguments.seed is not None:
        if not 0 <= arguments.seed < 2**63:
            raise ParameterError(
                f'--seed {arguments.seed}: expected an integer from 0 to 2^63 - 1')
        config = config.model_copy(update={'seed': arguments.seed})
    out = arguments.out or Path('models') / f'{source.stem}.safetensors'
    dataset = make_dataset(config.data, config.seed, source, arguments.data)
    curve = _check_output(out)
    command = shlex.join(['ros2', 'run', 'hnn_vi_ros', 'train', *(argv or ())])
    start = time.perf_counter()
    checkpoint, history = train(config, dataset, out.stem, command)
    seconds = time.perf_counter() - start
    save_checkpoint(out, checkpoint)
    plot_history(history, out.stem, curve)
    losses = ', '.join(f'{key} {value:.3g}' for key, value in checkpoint.card.losses.items())
    print(f'model: {out}\nloss curve: {curve}\n{losses}\ntrained in {seconds:.1f} s')


def _check_output(out: Path) -> Path:
    """Refuse an output before the work begins; return where the loss curve goes."""
    if out.suffix != '.safetensors':
        raise ParameterError(f'--out {out}: a model file must end in .safetensors')
    curve = out.with_suffix('.loss.png')
    for path in (out, curve):
        if os.path.lexists(path):
            raise ParameterError(f'{path} exists already and is not overwritten; '
                                 'name another file with --out FILE')
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        # Found out now, not after the training.
        out.touch()
        out.unlink()
    except OSError as problem:
        raise ParameterError(f'--out {out}: cannot be written ({problem.strerror}); name another '
                             'file') from problem
    return curve
