# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training loop: stages of Adam and L-BFGS that can be stopped and resumed."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from hashlib import sha256
import math
from pathlib import Path
import signal
import sys
from tempfile import mkdtemp
import time
from types import MappingProxyType
from typing import Any, NamedTuple

from hnn_vi_ros.errors import (
    DataError, HnnViRosError, Interrupted, ModelError, ParameterError, RecordingError)
from hnn_vi_ros.files import in_plain_words, one_line, ProgressLine, written
from hnn_vi_ros.learning.fit.config import TrainingConfig
from hnn_vi_ros.learning.torch_file import load_tensors
from hnn_vi_ros.models import Checkpoint, save_checkpoint
import numpy as np
from pydantic import ValidationError
import torch

# torch's L-BFGS drops curvature pairs below an absolute 1e-10: unscaled, it stops making
# progress once the loss is below 1e-7.
LBFGS_SCALE = 1e8
# Number of steps between evaluations on held-out data; L-BFGS ends when that many steps reduce
# the loss by less than this share.
INTERVAL, LEAST_GAIN = 20, 1e-6
# Loss passed to L-BFGS instead of a non-finite one, so that its line search shortens the
# step.
_TOO_FAR = 1e30
# Maximum size of a saved run [bytes]: two hundred copies of the weights, of L-BFGS.
_MAX_STATE_SIZE = 2**30
# Attributes of a saved run that describe its progress.
_KEPT = (
    'stage', 'taken', 'before', 'least', 'waited', 'best', 'loss_at_best', 'retried', 'gained')
# Factor of the learning rate when a stage restarts.
_SLOWER = 0.25
_REMEDY = 'reduce learning_rate, and check the data for outliers'


# Start of a stage: returns the loss of a module, with the source of random numbers.
Begin = Callable[[Any, torch.Generator], Callable[[], torch.Tensor]]


@dataclass(frozen=True)
class Stage:
    """
    A number of steps of one optimiser on one loss.

    Parameters
    ----------
    name : str
        Name for the model card and the progress bar.
    begin : callable
        ``begin(module, generator)`` returns the scalar loss as a function: for Adam on a new batch
        at each call, for L-BFGS a function of the parameters alone. It may draw random numbers.
    steps : int
        Maximum number of steps.
    rate : float, optional
        Initial learning rate of Adam, annealed to zero along a cosine; None selects L-BFGS.
    held_out : callable, optional
        ``held_out(module)`` returns the loss on held-out data.
    patience : int, optional
        Number of evaluations of ``held_out`` without improvement after which the stage ends; the
        best parameters are then restored. If None, the last ones are kept.
    retries : int
        Number of restarts, each at a quarter of the rate, if ``held_out`` does not improve or the
        loss is not finite; requires patience.
    clip : bool
        True to clip gradients to norm one, so that an outlier cannot undo the training on
        other samples.
    pairs, evaluations : int
        History size of L-BFGS, and maximum number of loss evaluations per step.
    remedy : str
        Advice in the error message for a loss that is not finite.
    ended : callable
        Callback at the end.

    """

    name: str
    begin: Begin
    steps: int
    rate: float | None = None
    held_out: Callable[[Any], float] | None = None
    patience: int | None = None
    retries: int = 0
    clip: bool = False
    pairs: int = 50
    evaluations: int = 10
    remedy: str = _REMEDY
    ended: Callable[[], None] = lambda: None


@dataclass
class LossHistory:
    """
    Training loss per step, and loss on held-out data at some steps.

    ``begins`` maps each stage to its first step.
    """

    train: list[float] = field(default_factory=list)
    train_step: list[int] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    validation_step: list[int] = field(default_factory=list)
    best_step: int = 0
    begins: dict[str, int] = field(default_factory=dict)


class Epoch(NamedTuple):
    """
    Progress of a training, for callbacks.

    Parameters
    ----------
    stage : str
        Name of the stage.
    step : int
        Index of the step, counted from the start of the first stage.
    loss : float
        Training loss.
    held_out : float or None
        Loss on held-out data; None if it was not evaluated at this step.
    module : torch.nn.Module
        The module.

    """

    stage: str
    step: int
    loss: float
    held_out: float | None
    module: Any


# Called at each step of Adam, and every INTERVAL of L-BFGS; the stage ends if it returns True.
Callback = Callable[[Epoch], object]


class TrainingProblem(NamedTuple):
    """
    A module and the stages that fit it.

    Parameters
    ----------
    module : torch.nn.Module
        Module at which the training begins.
    stages : sequence of Stage
        Stages in order. The best parameters by held-out data are passed on to the next stage if
        it is judged in the same way.
    seed : int
        Seed of the batches.
    losses : mapping of str to float
        Losses of preceding fits.

    """

    module: Any
    stages: Sequence[Stage] = ()
    seed: int = 0
    losses: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Fitted:
    """
    A fitted model.

    Parameters
    ----------
    module : torch.nn.Module
        The trained module; the one at which the training began is unchanged.
    losses : mapping of str to float
        Final loss of each fit and stage: for Adam the mean of the last tenth of the steps; with
        patience the loss at the best parameters.
    history : LossHistory
        Losses over the steps.
    noise : np.ndarray, optional
        Noise of each measured quantity, if the fit has estimated it.

    """

    module: Any
    losses: Mapping[str, float]
    history: LossHistory = field(default_factory=LossHistory)
    noise: np.ndarray | None = None


# Trains the module of a problem.
Train = Callable[[TrainingProblem], Fitted]


def trained(problem: TrainingProblem, name: str = '', keeper: 'TrainingCheckpoint | None' = None,
            callbacks: Sequence[Callback] = ()) -> Fitted:
    """
    Run all stages on a copy of the module.

    Parameters
    ----------
    problem : TrainingProblem
        The module and its stages.
    name : str
        Name for the progress bar.
    keeper : TrainingCheckpoint, optional
        File of the run, from which it is resumed if requested.
    callbacks : sequence of callable
        ``callback(epoch)`` is called at each step of Adam and at every 20th of L-BFGS; the stage
        ends if it returns True.

    Raises
    ------
    DataError
        The loss is not finite.

    """
    run = TrainingRun(problem, name, callbacks)
    if keeper is None:
        run.to_end()
    else:
        if keeper.resumes:
            keeper.load(run)
        with keeper.watching():
            run.to_end(keeper)
    return Fitted(run.module, run.losses, run.history)


class TrainingRun:
    """
    A training run, from the first step or resumed.

    Parameters
    ----------
    problem : TrainingProblem
        Problem, of whose module a copy is trained.
    name : str
        Name for the progress bar.
    callbacks : sequence of callable
        See ``trained``.

    Attributes
    ----------
    module : torch.nn.Module
        The copy.
    history : LossHistory
        Losses over the steps.
    losses : dict of str to float
        Final loss of each stage; see Fitted.

    """

    def __init__(self, problem: TrainingProblem, name: str = '',
                 callbacks: Sequence[Callback] = ()):
        self._callbacks = callbacks
        self.module, self.stages = deepcopy(problem.module), problem.stages
        self.history, self.losses = LossHistory(), dict(problem.losses)
        self._name, self._generator = name, torch.Generator().manual_seed(problem.seed)
        self._parameters = [part for part in self.module.parameters() if part.requires_grad]
        self._stage = self._taken = self._waited = self._retried = 0
        self._gained = False
        self._before = self._least = self._loss_at_best = math.inf
        self._best: dict[str, Any] | None = None
        self._begin()

    @property
    def step(self) -> int:
        """Return the index of the next step, counted from the start of the first stage."""
        return sum(stage.steps for stage in self.stages[:self._stage]) + self._taken

    def to_end(self, pause: Callable[['TrainingRun'], None] = lambda run: None) -> None:
        """
        Train to the end.

        Parameters
        ----------
        pause : callable
            Callback every INTERVAL steps; ``state`` can be saved there.

        Raises
        ------
        DataError
            The loss is not finite.

        """
        while self._stage < len(self.stages):
            stage = self.stages[self._stage]
            self._progress = ProgressLine()
            try:
                if isinstance(self._optimiser, torch.optim.LBFGS):
                    self._descend_valley(stage, self._optimiser, pause)
                else:
                    self._find_valley(stage, self._optimiser, pause)
            finally:
                self._progress.close()
            stage.ended()
            self._taken, self._waited, self._before = 0, 0, math.inf
            if stage.retries and not self._gained:
                print(f'{stage.name}: no improvement at learning rate '
                      f'{self._rate(stage):.2g}', flush=True)
            if stage.retries > self._retried and not self._gained:
                self._retried += 1
            else:
                self._stage, self._retried = self._stage + 1, 0
                if self._stage < len(self.stages) and \
                        self.stages[self._stage].held_out != stage.held_out:
                    self._least, self._best = math.inf, None
            self._gained = False
            self._begin()

    def _rate(self, stage: Stage) -> float:
        """Return the learning rate of Adam."""
        assert stage.rate is not None, 'it is for Adam'
        return stage.rate * _SLOWER**self._retried

    def _begin(self) -> None:
        """Start the next stage with a new optimiser."""
        if self._stage == len(self.stages):
            return
        stage = self.stages[self._stage]
        self.history.begins.setdefault(stage.name, self.step)
        self._drawn_from = self._generator.get_state()
        self._loss = stage.begin(self.module, self._generator)
        if stage.rate is None:
            self._optimiser: torch.optim.Optimizer = torch.optim.LBFGS(
                self._parameters, max_iter=INTERVAL, max_eval=stage.evaluations * INTERVAL,
                history_size=stage.pairs, tolerance_grad=0.0, tolerance_change=0.0,
                line_search_fn='strong_wolfe')
            return
        self._optimiser = torch.optim.Adam(self._parameters, lr=self._rate(stage))
        self._schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self._optimiser, stage.steps)

    def _find_valley(self, stage: Stage, adam: torch.optim.Optimizer,
                     pause: Callable[['TrainingRun'], None]) -> None:
        while self._taken < stage.steps:
            look = self._taken % INTERVAL == 0
            if look:
                pause(self)
            adam.zero_grad()
            loss = self._loss()
            loss.backward()
            if self._note(stage, float(loss.detach()), look):
                break
            if stage.clip:
                torch.nn.utils.clip_grad_norm_(self._parameters, 1.0)
            adam.step()
            self._schedule.step()
            self._taken += 1
        else:
            if stage.patience is not None:
                self._look(stage, self.history.train[-1])
        self._end(stage, float(np.mean(self.history.train[-max(1, stage.steps // 10):])))

    def _descend_valley(self, stage: Stage, lbfgs: torch.optim.LBFGS,
                        pause: Callable[['TrainingRun'], None]) -> None:
        def closure() -> torch.Tensor:
            lbfgs.zero_grad()
            loss = LBFGS_SCALE * self._loss()
            if not loss.isfinite():
                # Stepping with a NaN gradient would destroy the parameters.
                for parameter in self._parameters:
                    parameter.grad = torch.zeros_like(parameter)
                return torch.full_like(loss, _TOO_FAR)
            loss.backward()
            return loss

        if math.isinf(self._before):
            self._before = float(self._loss().detach())
            self._note(stage, self._before, True)
        while self._taken < stage.steps:
            pause(self)
            steps = min(INTERVAL, stage.steps - self._taken)
            lbfgs.param_groups[0]['max_iter'] = steps
            lbfgs.step(closure)
            self._taken += steps
            after = float(self._loss().detach())
            if self._note(stage, after, True) or not (self._before - after >= LEAST_GAIN * after):
                break
            self._before = after
        self._end(stage, self.history.train[-1])

    def _end(self, stage: Stage, loss: float) -> None:
        """Restore the best parameters of a stage with patience; record its loss."""
        if stage.patience is not None and self._best is not None:
            self.module.load_state_dict(self._best)
            loss = self._loss_at_best
        self.losses[stage.name] = loss

    def _note(self, stage: Stage, loss: float, look: bool) -> bool:
        """Record the loss; return True if the stage should stop."""
        if not math.isfinite(loss) and stage.retries and self._best is not None:
            self._gained = False
            return True
        if not math.isfinite(loss):
            where = 'the loss is not finite at the start of L-BFGS' \
                if stage.rate is None and not self._taken else \
                f'the loss is {loss} after {self._taken} steps'
            raise DataError(f'{stage.name}: {where}; {stage.remedy}')
        history, step = self.history, self.step
        history.train.append(loss)
        history.train_step.append(step)
        what = f'{self._name}: {stage.name}'.lstrip(': ')
        self._progress.show(self._taken / max(stage.steps, 1), (
            f'{what}: {self._taken} of {stage.steps} steps, loss {loss:.2e}'))
        look = look and stage.held_out is not None
        stop = look and self._look(stage, loss)
        epoch = Epoch(stage.name, step, loss, history.validation[-1] if look else None,
                      self.module)
        # A list, so that each one is called.
        return any([stop, *(callback(epoch) is True for callback in self._callbacks)])

    def _look(self, stage: Stage, loss: float) -> bool:
        """Record the held-out loss; return True if patience is exhausted."""
        assert stage.held_out is not None
        history, step, held_out = self.history, self.step, stage.held_out(self.module)
        history.validation.append(held_out)
        history.validation_step.append(step)
        if stage.patience is None:
            history.best_step = step
            return False
        if held_out < self._least:
            self._least, self._loss_at_best, self._waited = held_out, loss, 0
            self._gained = self._taken > 0
            self._best, history.best_step = deepcopy(self.module.state_dict()), step
        else:
            self._waited += 1
        return self._waited >= stage.patience

    @property
    def state(self) -> dict[str, Any]:
        """Return the state needed to resume: tensors, numbers and lists of them."""
        adam = not isinstance(self._optimiser, torch.optim.LBFGS)
        return {**{name: getattr(self, f'_{name}') for name in _KEPT},
                'weights': self.module.state_dict(), 'history': asdict(self.history),
                'losses': self.losses, 'optimiser': self._optimiser.state_dict(),
                'schedule': self._schedule.state_dict() if adam else None,
                'drawn_from': self._drawn_from, 'generator': self._generator.get_state()}

    @state.setter
    def state(self, state: Mapping[str, Any]) -> None:
        """Restore a state; the steps that follow are bit-identical to the original ones."""
        self.module.load_state_dict(state['weights'])
        self.history = LossHistory(**state['history'])
        self.losses.update(state['losses'])
        for name in _KEPT:
            setattr(self, f'_{name}', state[name])
        # Reproduce the random draws of the stage; then restore the generator of the batches.
        self._generator.set_state(state['drawn_from'])
        self._begin()
        self._optimiser.load_state_dict(state['optimiser'])
        if state['schedule'] is not None:
            self._schedule.load_state_dict(state['schedule'])
        self._generator.set_state(state['generator'])


# Wall time between saved states [s].
PERIOD = 30.0


class TrainingCheckpoint:
    """
    File with the state of a running training.

    The file is written every PERIOD and when Ctrl-C stops the run, and removed when the run
    ends. Only tensors and numbers are read from it; no code is executed.

    Parameters
    ----------
    path : Path
        Path of the file.
    config : TrainingConfig
        Configuration of the training.
    arrays : iterable of np.ndarray
        The training data.
    device : str
        Device of the training.
    resumes : bool
        True if the saved run is to be resumed.

    """

    def __init__(self, path: Path, config: TrainingConfig, arrays: Iterable[np.ndarray],
                 device: str, resumes: bool = False):
        self.path, self.resumes = path, resumes
        self._saved, self._stopping = time.monotonic(), False
        digest = sha256(
            f'{config.model_dump_json()} {device} {torch.__version__} {_KEPT}'.encode())
        for part in arrays:
            digest.update(np.ascontiguousarray(part).tobytes())
        self._digest = digest.hexdigest()

    def load(self, run: TrainingRun) -> None:
        """
        Restore the saved run.

        Raises
        ------
        ParameterError
            There is no saved run, or its configuration, data, device or version differ.

        """
        try:
            saved = load_tensors(self.path, _MAX_STATE_SIZE)
            of_this = saved['digest'] == self._digest
        except FileNotFoundError as problem:
            raise ParameterError(f'--resume: no interrupted run at {self.path}; start one without '
                                 '--resume') from problem
        except Exception as problem:  # damaged pickles raise exceptions without a common class
            raise ParameterError(f'--resume: {self.path} cannot be read; remove it and start '
                                 'again without --resume') from problem
        if not of_this:
            raise ParameterError(f'--resume: {self.path} is from another configuration, other '
                                 'data, another device or version; use those again, or remove it '
                                 'and start again')
        run.state = saved['state']

    def __call__(self, run: TrainingRun) -> None:
        """
        Save the state if the period has elapsed.

        Raises
        ------
        Interrupted
            Ctrl-C was pressed.

        """
        if not self._stopping and time.monotonic() - self._saved < PERIOD:
            return
        try:
            with written(self.path) as stream:
                torch.save({'digest': self._digest, 'state': run.state}, stream)
        except (OSError, RuntimeError) as problem:  # torch raises its own error for a full disk
            if self._stopping:
                raise ParameterError(f'stopped at step {run.step}; its state cannot be written '
                                     f'to {self.path} ({one_line(problem)})') from problem
            print(f'warning: {self.path}: the state of the run cannot be written '
                  f'({one_line(problem)}); training continues', file=sys.stderr, flush=True)
        self._saved = time.monotonic()
        if self._stopping:
            raise Interrupted(f'stopped at step {run.step}, state in {self.path}; resume with the '
                              'same command and --resume')

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Stop at the next pause after Ctrl-C, and at once after a second one."""
        def stop(number: int, frame: object) -> None:
            self._stopping = True
            signal.signal(signal.SIGINT, before)

        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
        self.path.unlink(missing_ok=True)


@contextmanager
def kept(model: Path, checkpoint: Checkpoint) -> Iterator[None]:
    """
    Save a trained model; errors in the body, where it is judged, mention that it is saved.

    Parameters
    ----------
    model : Path
        Path of the file; if it cannot be written, as on a full disk, a folder for temporary
        files is used instead and named in the error.
    checkpoint : Checkpoint
        The trained model.

    Raises
    ------
    DataError, RecordingError
        Raised instead of errors of this package, of a card, or of a file in the body.
    ModelError
        The file cannot be written.

    """
    try:
        save_checkpoint(model, checkpoint)
    except ModelError as problem:
        instead = Path(mkdtemp(prefix='hnn_vi_ros_')) / model.name
        save_checkpoint(instead, checkpoint)
        raise ModelError(f'{problem}; the trained model is in {instead}') from problem
    still = f'; the trained model is in {model}, but its evaluation is incomplete'
    try:
        yield
    except ValidationError as problem:
        raise DataError(f'the model card: {in_plain_words(problem)}{still}') from problem
    except HnnViRosError as problem:
        raise DataError(f'{problem}{still}') from problem
    except OSError as problem:
        raise RecordingError(f'{problem.filename}: cannot be written: {problem.strerror}{still}'
                             ) from problem


def member_files(model: Path, count: int) -> list[Path]:
    """Return the paths of ensemble members that are saved if training is interrupted."""
    return [model.with_suffix(f'.member{k}.safetensors') for k in range(1, count + 1)]


@contextmanager
def members_kept(model: Path, members: Sequence[Checkpoint]) -> Iterator[None]:
    """Save the trained members of an ensemble, each as a model, if training another one fails."""
    try:
        yield
    except BaseException:
        files = member_files(model, len(members))
        for file, member in zip(files, members, strict=True):
            save_checkpoint(file, member)
        if files:
            print(f'members trained so far: {", ".join(map(str, files))}', flush=True)
        raise
