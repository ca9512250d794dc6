# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Train a model of a mechanical system: ``hnn train --config NAME``.

Training minimises the loss of the configuration's family, for the plain network H(q, p) the error
of (H_p, -H_q) with respect to (dq/dt, dp/dt): first with Adam, which finds a good basin, then with
L-BFGS, which converges in it. All numbers are float64; the same seed gives the same result on the
same machine. A family supplies its data, loss, card and judgement (learning/tasks).
"""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
import os
from pathlib import Path
import shlex
import time
from typing import Any

from hnn_vi_ros.errors import listed, ParameterError
from hnn_vi_ros.files import check_new, in_plain_words
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.data.arrays import split_runs
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.data.sources import states_of
from hnn_vi_ros.learning.families.choices import FamilyChoice
from hnn_vi_ros.learning.fit.config import (
    AnyConfig, BodyConfig, FieldConfig, find_config, guess_config, guess_states, load_config,
    MachineConfig)
from hnn_vi_ros.learning.fit.loop import (
    Callback, Epoch, Fitted, kept, member_files, members_kept, trained, TrainingCheckpoint)
from hnn_vi_ros.learning.judging.ensemble import check_count, combined
from hnn_vi_ros.learning.judging.report import Outputs, write_report
from hnn_vi_ros.learning.tasks import TrainingTask
from hnn_vi_ros.learning.tasks.body import BODY
from hnn_vi_ros.learning.tasks.field import FIELD, FieldData
from hnn_vi_ros.learning.tasks.machine import MACHINE
from hnn_vi_ros.learning.user_module import Loss, ModuleChoice, ModuleConfig
from hnn_vi_ros.models import (
    averaged_families, Checkpoint, complete_checkpoint, FAMILIES, GraphHamiltonian,
    load_checkpoint)
from hnn_vi_ros.phase_space import Coordinate
from pydantic import ValidationError
import torch

_TASKS: dict[type[AnyConfig], TrainingTask] = {
    FieldConfig: FIELD, ModuleConfig: FIELD, MachineConfig: MACHINE, BodyConfig: BODY}


def main(argv: Sequence[str]) -> None:
    """Train a model with the options of the command line."""
    arguments = command_lines.train().parse_args(argv)
    # More threads do not help small networks; one thread makes sums identical on all machines.
    torch.set_num_threads(1)
    source, config = _configuration(arguments)
    if arguments.seed is not None:
        config = config.model_copy(update={'seed': arguments.seed})
    command = shlex.join(['hnn', 'train', *(part for part in argv if part != '--resume')])
    _train(source, config, arguments, command)


def train(module: torch.nn.Module, data: str | Path | Sequence[EvenMotion], out: str | Path,
          loss: Loss | None = None, coordinates: Sequence[Coordinate] = (),
          callbacks: Sequence[Callback] = (), device: str = 'cpu', resume: bool = False,
          folds: int | None = None, **settings: Any) -> GraphHamiltonian:
    """
    Train a torch module H(q, p) on motions without forces, and export it.

    Without masses, momenta are velocities, and H is that of a unit mass. A copy of the module is
    trained in float64 and in evaluation mode.

    Parameters
    ----------
    module : torch.nn.Module
        The module with its first weights; see ``learning.export``.
    data : str, Path or sequence of EvenMotion
        A log, arrays or a bag, or motions of ``learning.read_motions``.
    out : str or Path
        The model file to write, next to which there are a report and the losses.
    loss : callable, optional
        ``loss(module, states, predicted, target)`` returns one number; rates of change, shape
        (N, 2 d), are in units of their root mean squares. Default: the mean square error.
    coordinates : sequence of Coordinate, optional
        Names and units; required for motions, else default to the data's.
    callbacks : sequence of callable
        ``callback(epoch)`` is called with stage, step, loss, held_out and module at each step of
        Adam, and every 20 of L-BFGS; the stage ends if it returns True.
    device : str
        'cpu' or 'cuda'.
    resume : bool
        True to resume an interrupted training.
    folds : int, optional
        Number of models for a cross-validation, each trained without a share of the runs.
    **settings
        Keys of a training configuration: adam_steps, learning_rate, lbfgs_steps, patience, seed,
        and others; ``windows={'integrator': 'implicit_midpoint', 'step_size': 0.05, 'count': 4}``
        trains through four steps of an integrator in place of rates.

    Returns
    -------
    GraphHamiltonian
        The trained model, as loaded from its file.

    Raises
    ------
    HnnViRosError
        The data cannot be read, the module cannot be exported, or a setting is invalid.

    """
    torch.set_num_threads(1)
    out, file = Path(out), [str(data)] if isinstance(data, str | Path) else []
    settings = {'data': {'kind': 'arrays'}} | (
        guess_states(file)[0].model_dump(exclude_unset=True) if file else {}) | settings
    if (windows := settings.pop('windows', None)) is not None:
        settings['loss'] = {'kind': 'steps', **windows}
    if coordinates or not file:
        settings['coordinates'] = [{'name': one.name, 'q_unit': one.q_unit, 'p_unit': one.p_unit}
                                   for one in coordinates]
    try:
        config = ModuleConfig(**settings | {'family': ModuleChoice.of(module, loss)})
    except ValidationError as problem:
        raise ParameterError(f'train: {in_plain_words(problem)}') from problem
    read = None if isinstance(data, str | Path) else FieldData.of(
        config, states_of(data, listed(one.name for one in data)))
    _train(out, config, Namespace(out=out, data=file, seed=None, ensemble=None, device=device,
                                  resume=resume, folds=folds), 'hnn_vi_ros.learning.train.train',
           read, callbacks)
    return GraphHamiltonian(load_checkpoint(out))


def _train(source: Path, config: AnyConfig, arguments: Namespace, command: str,
           read: FieldData | None = None, callbacks: Sequence[Callback] = ()) -> None:
    """Train a model on data, read here or before, judge it, and write it with its report."""
    _check_options(source, config.family, arguments)
    model = arguments.out or Path('models') / f'{source.stem}.safetensors'
    task, count = _TASKS[type(config)], arguments.ensemble or 1
    if arguments.folds is not None and task.folds is None:
        raise ParameterError(f'--folds: the family {config.family.kind} is judged on its test '
                             'motions; remove the option')
    if arguments.folds is not None and arguments.folds < 2:
        raise ParameterError(f'--folds {arguments.folds}: expected at least 2')
    outputs = Outputs.beside(model, task.picture)
    state = _check_outputs(
        (*outputs, *member_files(model, arguments.ensemble or 0)), arguments.resume)
    # Training starts here, including the choice of a model.
    begun, members, fits = time.perf_counter(), list[Checkpoint](), list[Fitted]()
    data = task.select(task.read(source, config, arguments.data, count > 1) if read is None else
                       read)
    crossed = task.folds(data, config, arguments.folds, arguments.device) \
        if task.folds and arguments.folds else {}
    # The run of an ensemble cannot be resumed.
    keeper = TrainingCheckpoint(state, config, data.arrays, arguments.device, arguments.resume) \
        if count == 1 else None
    with members_kept(model, members), _board(model, task is FIELD and count == 1) as board:
        for k in range(count):
            own = config.model_copy(update={'seed': config.seed + k})
            name = model.stem if count == 1 else f'{model.stem}, member {k + 1}'
            fits.append(task.fit(data, own, arguments.device, partial(
                trained, name=name, keeper=keeper, callbacks=[*callbacks, *board])))
            fits[k] = replace(fits[k], losses={**fits[k].losses, **crossed})
            members.append(task.describe(data, fits[k], own, name, command))
    checkpoint = members[0] if count == 1 else combined(members, model.stem, data.box)
    seconds = time.perf_counter() - begun
    with kept(model, checkpoint):
        judged = task.judge(data, checkpoint, fits[0])
        complete_checkpoint(model, judged.checkpoint)
        write_report(outputs, config, judged, fits[0].history, seconds, arguments.device)
    simulated = '' if judged.scene is None else (
        f'scene: {outputs.scene}\nnext: hnn run {outputs.scene} '
        f'--plot {outputs.scene.with_suffix(".png")}\n')
    print(f'model: {model}\nreport: {outputs.report}\n{simulated}\n{judged.text}\n'
          f'trained in {seconds:.1f} s')


def _configuration(arguments: Namespace) -> tuple[Path, AnyConfig]:
    """Return the path that names the model, and the configuration or the reading of the data."""
    if arguments.config is not None:
        source = find_config(arguments.config)
        config = load_config(source)
    elif not arguments.data:
        raise ParameterError('--config or --data: name a configuration, or a log, arrays or bags')
    else:
        source = split_runs(arguments.data[0])[0]
        config, text = (guess_states if arguments.module else guess_config)(
            arguments.data, arguments.counts)
        print(f'configuration (for --config, with the data at this place):\n\n{text}', flush=True)
    if arguments.module is None:
        if arguments.loss is not None:
            raise ParameterError(f'--loss {arguments.loss}: is for --module; write the loss of a '
                                 'family in its configuration')
        return source, config
    if not isinstance(config, FieldConfig):
        raise ParameterError(f'{source}: --module trains H(q, p) on states, and the family '
                             f'{config.family.kind} has data of another kind; remove family')
    seed = config.seed if arguments.seed is None else arguments.seed
    try:
        return source, ModuleConfig.of(
            config, ModuleChoice.loaded(arguments.module, arguments.loss, seed))
    except ValidationError as problem:
        raise ParameterError(f'{source}: {in_plain_words(problem)}') from problem


@contextmanager
def _board(model: Path, wanted: bool) -> Iterator[list[Callback]]:
    """Yield callbacks that write the losses for TensorBoard, none if it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        wanted = False
    if not wanted:
        yield []
        return

    def write(epoch: Epoch) -> None:
        writer.add_scalar('loss/training', epoch.loss, epoch.step)
        if epoch.held_out is not None:
            writer.add_scalar('loss/validation', epoch.held_out, epoch.step)

    with SummaryWriter(str(model.with_suffix('.tensorboard'))) as writer:
        yield [write]


def _check_options(source: Path, family: FamilyChoice, arguments: Namespace) -> None:
    """Raise ParameterError for options that are invalid or unsupported by the family."""
    refuses = dict(family.refuses)
    row = FAMILIES.get(family.kind)
    if row is not None and not row.averaged:
        refuses.setdefault('ensemble', (
            'has its own momenta or forces, whose mean is meaningless; valid families: '
            f'{", ".join(averaged_families())}'))
    for option, given in (('ensemble', arguments.ensemble is not None),
                          ('device', arguments.device != 'cpu'), ('resume', arguments.resume)):
        if given and option in refuses:
            raise ParameterError(f'{source}: --{option}: the family {family.kind} '
                                 f'{refuses[option]}; remove the option')
    if arguments.seed is not None and not 0 <= arguments.seed < 2**63:
        raise ParameterError(f'--seed {arguments.seed}: expected an integer from 0 to 2^63 - 1')
    if arguments.device == 'cuda' and not torch.cuda.is_available():
        raise ParameterError('--device cuda: torch finds no CUDA device here; use --device cpu')
    if arguments.ensemble is not None:
        check_count(arguments.ensemble)
        if arguments.resume:
            raise ParameterError('--resume: the training of an ensemble cannot be resumed; remove '
                                 '--resume or --ensemble')


def _check_outputs(outputs: Sequence[Path], resume: bool) -> Path:
    """Check the outputs before the work starts; return the path of the saved run state."""
    out = outputs[0]
    state = out.with_suffix('.training')
    if out.suffix != '.safetensors':
        raise ParameterError(f'--out {out}: a model file must end in .safetensors')
    # Fail now instead of after the training.
    for path in outputs:
        check_new('--out', path)
    if os.path.lexists(state) and not resume:
        raise ParameterError(f'{state} is the state of an interrupted run; resume it with '
                             '--resume, or remove it')
    return state
