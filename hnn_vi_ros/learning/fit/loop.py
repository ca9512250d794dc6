# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The training loop: Adam, then L-BFGS, with early stopping; it can be stopped and resumed."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, dataclass, field
import math
from typing import Any

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.fit.config import TrainingConfig
from hnn_vi_ros.learning.fit.problem import TrainingProblem
import torch
from tqdm import tqdm

# torch's L-BFGS drops curvature pairs below an absolute 1e-10: unscaled, it stops learning once
# the loss is below 1e-7.
LBFGS_SCALE = 1e8
# Steps from one look at the validation loss to the next; L-BFGS ends when as many steps gain
# less than this share of the loss.
INTERVAL = 20
LEAST_GAIN = 1e-6


@dataclass
class LossHistory:
    """Losses over the steps of a run: training, and validation every so often."""

    train: list[float] = field(default_factory=list)
    train_step: list[int] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    validation_step: list[int] = field(default_factory=list)
    adam_steps: int = 0
    best_step: int = 0


class Loop:
    """
    A training run, from its first step or from where one was stopped.

    With ``patience``, the weights of the least validation loss are kept: either method ends when
    that many looks bring no lower one, L-BFGS begins from the best weights so far, and the model
    ends with them. Without it, both run through, and the last weights count.

    Parameters
    ----------
    problem : TrainingProblem
        Its model is changed.
    config : TrainingConfig
        Numbers of steps, the learning rate and the patience.

    Attributes
    ----------
    history : LossHistory
        How the losses fell.
    step : int
        The next step to take.

    """

    def __init__(self, problem: TrainingProblem, config: TrainingConfig):
        self._problem, self._config = problem, config
        self.history, self.step = LossHistory(adam_steps=config.adam_steps), 0
        self._before, self._least, self._best, self._waited = math.inf, math.inf, None, 0
        parameters = [*problem.family.parameters()]
        self._adam = torch.optim.Adam(parameters, lr=config.learning_rate)
        self._schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self._adam, config.adam_steps)
        self._lbfgs = torch.optim.LBFGS(
            parameters, max_iter=INTERVAL, max_eval=10 * INTERVAL,
            history_size=config.lbfgs_history, tolerance_grad=0.0, tolerance_change=0.0,
            line_search_fn='strong_wolfe')

    def run(self, progress: tqdm, pause: Callable[['Loop'], None] = lambda loop: None
            ) -> LossHistory:
        """
        Train to the end.

        Parameters
        ----------
        progress : tqdm
            Counts the steps and shows the loss.
        pause : callable
            Called with the loop every INTERVAL steps, when its ``state`` is one to go on from.

        Raises
        ------
        DataError
            The loss is not finite any more.

        """
        self._progress = progress
        self._run_adam(pause)
        self._run_lbfgs(pause)
        if self._best is not None:
            self._problem.family.load_state_dict(self._best)
        return self.history

    def _run_adam(self, pause: Callable[['Loop'], None]) -> None:
        while self.step < self._config.adam_steps:
            look = self.step % INTERVAL == 0
            if look:
                pause(self)
            self._adam.zero_grad()
            loss = self._problem.loss()
            loss.backward()
            if self._note(self.step, float(loss.detach()), look):
                self.step = self._config.adam_steps
                return
            self._adam.step()
            self._schedule.step()
            self.step += 1

    def _run_lbfgs(self, pause: Callable[['Loop'], None]) -> None:
        first = self._config.adam_steps
        if self.step == first and not math.isfinite(self._before):
            if self._best is not None:
                self._problem.family.load_state_dict(self._best)
            self._waited, self._before = 0, float(self._problem.loss().detach())
            self._note(first, self._before, True)
        while self.step + INTERVAL <= first + self._config.lbfgs_steps:
            pause(self)
            self._lbfgs.step(self._scaled_loss)
            after = float(self._problem.loss().detach())
            self.step += INTERVAL
            if (self._note(self.step, after, True)
                    or self._before - after < LEAST_GAIN * self._before):
                return
            self._before = after

    def _scaled_loss(self) -> torch.Tensor:
        self._lbfgs.zero_grad()
        scaled = LBFGS_SCALE * self._problem.loss()
        scaled.backward()
        return scaled

    def _note(self, step: int, loss: float, look: bool) -> bool:
        """Note the loss; say whether the validation loss has not fallen for too long."""
        if not math.isfinite(loss):
            raise DataError(f'the loss is {loss} after {step} steps; lower learning_rate, and '
                            'look for outliers in the data')
        self.history.train.append(loss)
        self.history.train_step.append(step)
        self._progress.update(step - self._progress.n)
        self._progress.set_postfix_str(f'loss {loss:.2e}', refresh=False)
        if not look:
            return False
        validation = self._problem.validation_loss()
        self.history.validation.append(validation)
        self.history.validation_step.append(step)
        if self._config.patience is None:
            self.history.best_step = step
            return False
        if validation < self._least:
            self._least, self._waited, self.history.best_step = validation, 0, step
            self._best = deepcopy(self._problem.family.state_dict())
        else:
            self._waited += 1
        return self._waited >= self._config.patience

    @property
    def state(self) -> dict[str, Any]:
        """Return all that the next steps depend on: tensors, numbers and lists of them."""
        return {'weights': self._problem.family.state_dict(), 'history': asdict(self.history),
                'step': self.step, 'before': self._before, 'least': self._least,
                'best': self._best, 'waited': self._waited, 'adam': self._adam.state_dict(),
                'schedule': self._schedule.state_dict(), 'lbfgs': self._lbfgs.state_dict()}

    @state.setter
    def state(self, state: dict[str, Any]) -> None:
        """Go back to a state; the steps that follow are those that followed it, bit by bit."""
        self._problem.family.load_state_dict(state['weights'])
        self.history, self.step = LossHistory(**state['history']), state['step']
        self._before, self._least, self._best, self._waited = (
            state[name] for name in ('before', 'least', 'best', 'waited'))
        self._adam.load_state_dict(state['adam'])
        self._schedule.load_state_dict(state['schedule'])
        self._lbfgs.load_state_dict(state['lbfgs'])
