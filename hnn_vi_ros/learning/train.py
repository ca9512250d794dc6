# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Train a model of a mechanical system: ``ros2 run hnn_vi_ros train --config NAME``.

A model of the configuration's family is fitted so that its loss is small, for the plain network
H(q, p) the error of (H_p, -H_q) against (dq/dt, dp/dt): first by Adam, which finds a good valley,
then by L-BFGS, which descends it. All in float64, on all the data at once, and the same on the
same machine for the same seed.
"""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
import os
from pathlib import Path
import shlex
import time

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning import body_train, machine_train
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.exact_data import ExactData, sample_exact
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.families.base import EnergyFamily, Trainable
from hnn_vi_ros.learning.fit.config import find_config, load_config, TrainingConfig
from hnn_vi_ros.learning.fit.interruption import Keeper
from hnn_vi_ros.learning.fit.keeping import kept, member_files, members_kept
from hnn_vi_ros.learning.fit.loop import Loop, LossHistory
from hnn_vi_ros.learning.fit.problem import TrainingProblem
from hnn_vi_ros.learning.judging.energy_account import friction_work, integrated
from hnn_vi_ros.learning.judging.ensemble import (
    band_text, calibrated, check_ensemble, combined, held_out, resampled)
from hnn_vi_ros.learning.judging.report import Outputs, write_report
from hnn_vi_ros.models.checkpoint import Checkpoint, complete_checkpoint
from hnn_vi_ros.models.energy_error import energy_error, energy_spread, EnergyError
from hnn_vi_ros.models.ensemble import load_member
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.model_card import ModelCard
from hnn_vi_ros.version import __version__
import numpy as np
import torch
from tqdm import tqdm

# States of the box at which the learned energy is compared with the true one.
_STATES = 2000


def train(config: TrainingConfig, dataset: Dataset, name: str, command: str,
          device: str = 'cpu', keeper: Keeper | None = None, resume: bool = False
          ) -> tuple[Checkpoint, LossHistory, TrainingProblem]:
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
    device : str
        Where to train: 'cpu' or 'cuda'.
    keeper : Keeper, optional
        Keeps the state of the run while it lasts.
    resume : bool
        Whether to go on from the state that the keeper has.

    Returns
    -------
    tuple of Checkpoint, LossHistory and TrainingProblem
        The trained model, not yet saved, how the losses fell, and the problem that it solves.

    Raises
    ------
    DataError
        Training diverges.
    Interrupted
        Ctrl-C stopped it.
    ParameterError
        There is nothing to go on from.

    """
    problem = TrainingProblem(config, dataset)
    problem.to(device)
    loop = Loop(problem, config)
    if resume and keeper is not None:
        keeper.load(loop)
    with tqdm(total=config.adam_steps + config.lbfgs_steps, desc=name, unit='step',
              disable=None) as progress:
        if keeper is None:
            history = loop.run(progress)
        else:
            with keeper.watching():
                history = loop.run(progress, keeper)
    problem.to('cpu')
    return describe(problem, config, dataset, name, command), history, problem


def describe(problem: TrainingProblem, config: TrainingConfig, dataset: Dataset, name: str,
             command: str) -> Checkpoint:
    """Return a trained model with its card; see train."""
    family, reference = problem.family, config.reference
    box = replace(dataset, p=family.momenta(dataset)).box
    centre = np.mean([*box.q, *box.p], axis=1)
    z0 = centre if reference is None else np.array([*reference.q, *reference.p])
    networks = family.networks(z0, 0.0 if reference is None else reference.energy)
    widths = {key: [layers.weights[0].shape[1], *(len(bias) for bias in layers.biases)]
              for key, layers in networks.items()}
    several = {'networks': widths} if len(widths) > 1 else {'widths': next(iter(widths.values()))}
    card = ModelCard(
        name=name, family=config.family.kind, **several, **family.constants(),
        scheme=config.loss.scheme, coordinates=config.coordinates,
        box=box, dataset=dataset.description, seed=config.seed,
        losses=problem.final_losses(), units=problem.units, training_command=command,
        package_version=__version__, confine=config.confine)
    return Checkpoint(card, networks)


def train_ensemble(config: TrainingConfig, dataset: Dataset, model: Path, command: str,
                   count: int, device: str = 'cpu'
                   ) -> tuple[Checkpoint, LossHistory, TrainingProblem]:
    """
    Train members by seeds and bootstraps of their own.

    Parameters
    ----------
    config, command, device
        See ``train``.
    dataset : Dataset
        What to learn from, without what is held out.
    model : Path
        The file that is to hold them; see ``members_kept``.
    count : int
        How many members; their seeds are those from the configuration's on.

    Returns
    -------
    tuple of Checkpoint, LossHistory and TrainingProblem
        The ensemble, not yet saved, and how the first member's losses fell, and its problem.

    Raises
    ------
    DataError
        See ``train``.

    """
    members: list[Checkpoint] = []
    with members_kept(model, members):
        for k, seed in enumerate(range(config.seed, config.seed + count)):
            own = config.model_copy(update={'seed': seed})
            member, losses, solved = train(
                own, resampled(dataset, seed), f'{model.stem}, member {k + 1}', command, device)
            members.append(member)
            if not k:
                history, problem = losses, solved
    return combined(members, dataset, model.stem), history, problem


def judged(checkpoint: Checkpoint, family: Trainable, config: TrainingConfig, dataset: Dataset
           ) -> Checkpoint:
    """Return a trained model whose card tells the error of its energy, where that is known."""
    error = judge_energy(checkpoint, family, config, dataset)
    return replace(checkpoint, card=checkpoint.card.model_copy(update={'energy_error': error}))


def judge_energy(checkpoint: Checkpoint, family: Trainable, config: TrainingConfig,
                 dataset: Dataset) -> EnergyError | None:
    """
    Return how far the learned energy is from what is known of it; None if nothing is.

    For exact data that is the true one, at states of the box that training has not seen. For
    others, what it should be along each motion: it changes by the work of the forces that the
    family has; one that has none and was measured loses what friction takes.

    Parameters
    ----------
    checkpoint : Checkpoint
        The trained model.
    family : Trainable
        The same, for the momenta of the states.
    config : TrainingConfig
        How it was trained.
    dataset : Dataset
        What it was trained on.

    """
    exact, row = isinstance(config.data, ExactData), FAMILIES[checkpoint.card.family]
    hamiltonian = load_member(checkpoint, None)  # refuses a Lagrangian that is singular
    if exact:
        data = config.data.model_copy(update={
            'samples': _STATES, 'edge_share': 0.0, 'trajectory': None, 'noise': 0.0})
        dataset = sample_exact(data, config.seed + 1)
    p = family.momenta(dataset)
    learned = hamiltonian.energy(dataset.q, p)
    if exact:
        return energy_error(learned, dataset.energies, config.seed)
    if dataset.t is None:
        return None  # without times there is no motion along which anything is known
    numbers = dataset.block if dataset.trajectory is None else dataset.trajectory
    if isinstance(family, EnergyFamily) and not row.conservative:
        work = model_work(family, replace(dataset, p=p), numbers)
        return energy_spread(learned, numbers, config.seed, work, 'work of forces and friction')
    work, power = friction_work(learned, numbers, dataset.t, dataset.dq_dt)
    if power == 0.0:
        return energy_spread(learned, numbers, config.seed)
    error = energy_spread(learned, numbers, config.seed, work, 'work of fitted friction')
    return error.model_copy(update={'friction_power': power})


def model_work(family: EnergyFamily, dataset: Dataset, trajectory: np.ndarray) -> np.ndarray:
    """
    Return the work of the forces that a model has learned, along measured motions.

    Its own rates (q', p') have the power H_q . q' + H_p . p': Hamilton's equations have none.

    Parameters
    ----------
    family : EnergyFamily
        The model.
    dataset : Dataset
        States and commands, with their times.
    trajectory : np.ndarray of int, shape (N,)
        Of which each state is one.

    Returns
    -------
    np.ndarray, shape (N,)
        W [J], from zero on in each trajectory, by the trapezoidal rule.

    """
    z = torch.tensor(np.hstack([dataset.q, dataset.p]))
    commands = None if dataset.commands is None else torch.tensor(dataset.commands)
    rates = family.vector_field(z, commands)
    power = (family.gradient(z) * rates).sum(dim=1).detach().numpy()
    return integrated(power[:, None], trajectory, dataset.t)[:, 0]


def main(argv: Sequence[str]) -> None:
    """Train a model as the command line says."""
    arguments = command_lines.train().parse_args(argv)
    # Small networks gain nothing from more threads, and sums come out the same on any machine.
    torch.set_num_threads(1)
    source = find_config(arguments.config)
    model = arguments.out or Path('models') / f'{source.stem}.safetensors'
    given = [part for part in argv if part != '--resume']
    command = shlex.join(['ros2', 'run', 'hnn_vi_ros', 'train', *given])
    own = machine_train.own_family(source)
    if own:
        _check_options(source, own, arguments)
    if own == 'lie_group':
        _check_outputs((model,), resume=False)
        body_train.run(source, arguments, model, command)
        return
    if own:
        files = machine_train.Outputs.beside(model)
        _check_outputs((*files, *member_files(model, arguments.ensemble or 0)), resume=False)
        machine_train.run(source, arguments, files, command)
        return
    outputs = Outputs.beside(model)
    config = load_config(source)
    if arguments.seed is not None:
        if not 0 <= arguments.seed < 2**63:
            raise ParameterError(
                f'--seed {arguments.seed}: expected an integer from 0 to 2^63 - 1')
        config = config.model_copy(update={'seed': arguments.seed})
    if arguments.device == 'cuda' and not torch.cuda.is_available():
        raise ParameterError('--device cuda: torch finds no CUDA device here; use --device cpu')
    if arguments.ensemble is not None:
        check_ensemble(config, arguments.ensemble)
        if arguments.resume:
            raise ParameterError('--resume: an ensemble is trained anew; leave one of the two out')
    dataset = make_dataset(config.data, config.seed, source, arguments.data)
    state = _check_outputs(
        (*outputs, *member_files(model, arguments.ensemble or 0)), arguments.resume)
    keeper = Keeper(state, config, dataset, arguments.device)
    known, test = (dataset, None) if arguments.ensemble is None else held_out(config, dataset)
    start = time.perf_counter()
    checkpoint, history, problem = train(
        config, dataset, outputs.model.stem, command, arguments.device, keeper, arguments.resume
    ) if arguments.ensemble is None else train_ensemble(
        config, known, outputs.model, command, arguments.ensemble, arguments.device)
    seconds = time.perf_counter() - start
    with kept(outputs.model, checkpoint):
        checkpoint = judged(checkpoint, problem.family, config, known)
        if arguments.ensemble is not None:
            checkpoint = calibrated(checkpoint, config, test)
        complete_checkpoint(outputs.model, checkpoint)
        card = checkpoint.card
        write_report(outputs, config, card, history, problem.compare(), seconds, arguments.device)
    losses = ', '.join(f'{key} {value:.3g}' for key, value in card.losses.items())
    error = card.energy_error
    known = '' if error is None else (f'\nenergy error: RMS {error.rms:.3g} J, largest '
                                      f'{error.sup:.3g} J, against the {error.compared_with}')
    known += _spread(card)
    print(f'model: {outputs.model}\nloss curve: {outputs.losses}\nreport: {outputs.report}\n'
          f'{losses}{known}\ntrained in {seconds:.1f} s')


def _spread(card: ModelCard) -> str:
    """Say what the spread of an ensemble tells, in a line of its own."""
    ensemble = card.ensemble
    if ensemble is None:
        return ''
    count = len(ensemble.members)
    if ensemble.factors is None:
        return (f'\n{count} members, the curves are those of the first; their spread was not '
                f'calibrated ({ensemble.calibration})')
    return f'\n{count} members, the curves are those of the first; {band_text(ensemble)}'


def _check_options(source: Path, family: str, arguments: Namespace) -> None:
    """Refuse what a family that is trained in its own way does not take."""
    if arguments.resume or arguments.device != 'cpu':
        raise ParameterError(f'{source}: a model of the family {family} is trained in minutes, '
                             'on the CPU; leave out --resume and --device')
    if arguments.ensemble is not None and family == 'lie_group':
        raise ParameterError(f'{source}: --ensemble: models of the family {family} have momenta '
                             'of their own, whose mean means nothing; leave it out')


def _check_outputs(outputs: Sequence[Path], resume: bool) -> Path:
    """Refuse outputs before the work begins; return where the state of the run is kept."""
    out = outputs[0]
    state = out.with_suffix('.training')
    if out.suffix != '.safetensors':
        raise ParameterError(f'--out {out}: a model file must end in .safetensors')
    for path in outputs:
        if os.path.lexists(path):
            raise ParameterError(f'{path} exists already and is not overwritten; '
                                 'name another file with --out FILE')
    if os.path.lexists(state) and not resume:
        raise ParameterError(f'{state} is a run that was interrupted; go on with it with '
                             '--resume, or remove it')
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        # Found out now, not after the training.
        out.touch()
        out.unlink()
    except OSError as problem:
        raise ParameterError(f'--out {out}: cannot be written ({problem.strerror}); name another '
                             'file') from problem
    return state
