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
from collections.abc import Sequence
from functools import partial
import os
from pathlib import Path
import shlex
import time

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import check_new
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.data.arrays import split_runs
from hnn_vi_ros.learning.families.choices import FamilyChoice
from hnn_vi_ros.learning.fit.config import (
    AnyConfig, BodyConfig, FieldConfig, find_config, guess_config, load_config, MachineConfig)
from hnn_vi_ros.learning.fit.loop import (
    Fitted, kept, member_files, members_kept, trained, TrainingCheckpoint)
from hnn_vi_ros.learning.judging.ensemble import check_count, combined
from hnn_vi_ros.learning.judging.report import Outputs, write_report
from hnn_vi_ros.learning.tasks import TrainingTask
from hnn_vi_ros.learning.tasks.body import BODY
from hnn_vi_ros.learning.tasks.field import FIELD
from hnn_vi_ros.learning.tasks.machine import MACHINE
from hnn_vi_ros.models import averaged_families, Checkpoint, complete_checkpoint, FAMILIES
import torch

_TASKS: dict[type[AnyConfig], TrainingTask] = {
    FieldConfig: FIELD, MachineConfig: MACHINE, BodyConfig: BODY}


def main(argv: Sequence[str]) -> None:
    """Train a model with the options of the command line."""
    arguments = command_lines.train().parse_args(argv)
    # More threads do not help small networks; one thread makes sums identical on all machines.
    torch.set_num_threads(1)
    source, config = _configuration(arguments)
    _check_options(source, config.family, arguments)
    if arguments.seed is not None:
        config = config.model_copy(update={'seed': arguments.seed})
    model = arguments.out or Path('models') / f'{source.stem}.safetensors'
    task, count = _TASKS[type(config)], arguments.ensemble or 1
    outputs = Outputs.beside(model, task.picture)
    state = _check_outputs(
        (*outputs, *member_files(model, arguments.ensemble or 0)), arguments.resume)
    command = shlex.join(['hnn', 'train', *(
        part for part in argv if part != '--resume')])
    # Training starts here, including the choice of a model.
    begun, members, fits = time.perf_counter(), list[Checkpoint](), list[Fitted]()
    data = task.select(task.read(source, config, arguments.data, count > 1))
    # The run of an ensemble cannot be resumed.
    keeper = TrainingCheckpoint(state, config, data.arrays, arguments.device, arguments.resume) \
        if count == 1 else None
    with members_kept(model, members):
        for k in range(count):
            own = config.model_copy(update={'seed': config.seed + k})
            name = model.stem if count == 1 else f'{model.stem}, member {k + 1}'
            fits.append(task.fit(data, own, arguments.device, partial(
                trained, name=name, keeper=keeper)))
            members.append(task.describe(data, fits[k], own, name, command))
    checkpoint = members[0] if count == 1 else combined(members, model.stem, data.box)
    seconds = time.perf_counter() - begun
    with kept(model, checkpoint):
        judged = task.judge(data, checkpoint, fits[0])
        complete_checkpoint(model, judged.checkpoint)
        write_report(outputs, config, judged, fits[0].history, seconds, arguments.device)
    print(f'model: {model}\nreport: {outputs.report}\n\n{judged.text}\n'
          f'trained in {seconds:.1f} s')


def _configuration(arguments: Namespace) -> tuple[Path, AnyConfig]:
    """Return the path that names the model, and the configuration or the reading of the data."""
    if arguments.config is not None:
        source = find_config(arguments.config)
        return source, load_config(source)
    if not arguments.data:
        raise ParameterError('--config or --data: name a configuration, or a log, arrays or bags')
    config, text = guess_config(arguments.data)
    print(f'configuration (for --config, with the data at this place):\n\n{text}', flush=True)
    return split_runs(arguments.data[0])[0], config


def _check_options(source: Path, family: FamilyChoice, arguments: Namespace) -> None:
    """Raise ParameterError for options that are invalid or unsupported by the family."""
    refuses = dict(family.refuses)
    row = FAMILIES.get(family.kind)
    if row is not None and not row.averaged:
        refuses['ensemble'] = ('has its own momenta or forces, whose mean is meaningless; valid '
                               f'families: {", ".join(averaged_families())}')
    for option, given in (('ensemble', arguments.ensemble is not None),
                          ('device', arguments.device != 'cpu'), ('resume', arguments.resume)):
        if given and option in refuses:
            raise ParameterError(f'{source}: --{option}: the family {family.kind} '
                                 f'{refuses[option]}; remove the option')
    if arguments.seed is not None and not 0 <= arguments.seed < 2**63:
        raise ParameterError(
            f'--seed {arguments.seed}: expected an integer from 0 to 2^63 - 1')
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
