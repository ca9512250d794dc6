# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs as functions that torch differentiates once, and refuses to differentiate twice."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.gradients.checkpoints import Recorded
from hnn_vi_ros.gradients.dependences import Dependence
from hnn_vi_ros.gradients.derivatives import Change
from hnn_vi_ros.gradients.scene_run import Numbers, SceneRun
import numpy as np
import torch

# The name of h among the tensors that a run depends on.
STEP = 'step_size'
_TWICE = ('a simulation is differentiable once: detach its gradient or tangent, or take '
          'differences of gradients; for torch.autograd.functional.jvp, which differentiates '
          'twice, take torch.func.jvp')
_HIDDEN = ('a simulation takes no tensors that vmap batches, nor weights in torch.func: use '
           'torch.autograd.grad, torch.autograd.functional.jacobian without vectorize, and q0, p0 '
           'of shape (m, d) for many trajectories')


class Lender(Protocol):
    """A lender of runs, which knows what they depend on."""

    def holding(self, numbers: Numbers) -> AbstractContextManager[SceneRun]:
        """Lend a run with these values."""

    def dependence(self, held: SceneRun, numbers: Numbers, name: str) -> Dependence:
        """Return the dependence of a run on the tensor with this name in a ``Call``."""


@dataclass(frozen=True, eq=False)
class Call:
    """
    A call, without the tensors by which it is differentiated.

    It is not a tuple, since torch.func copies those.

    Parameters
    ----------
    simulation : Lender
        What runs.
    numbers : Numbers
        The values of tensors that are numbers.
    names : list of str
        The name of each further tensor.
    samples, every, checkpoints : int
        Number of samples, steps from one to the next, and most snapshots.
    recorded : list of Recorded
        The record of the run, once it has been made.

    """

    simulation: Lender
    numbers: Numbers
    names: list[str]
    samples: int
    every: int
    checkpoints: int | None
    recorded: list[Recorded] = field(default_factory=list)


class _Function(torch.autograd.Function):
    """A function of arrays, which torch cannot batch."""

    @staticmethod
    def vmap(*_: object) -> NoReturn:
        raise UnsupportedSystem(_HIDDEN)


class Run(_Function):
    """A run, by its initial states (m, 2 d) and by what else it depends on."""

    @staticmethod
    def forward(call: Call, z0: torch.Tensor, commands: torch.Tensor | None,
                *_: torch.Tensor) -> torch.Tensor:
        rows = None if commands is None else array(commands)
        with call.simulation.holding(call.numbers) as held:
            if STEP in call.names:
                held.run.on_step_size  # noqa: B018  refused before a step is taken
            z = held.run.record(array(z0), call.samples, call.every, rows,
                                checkpoints=call.checkpoints)
            call.recorded.append(held.run.recorded)
        return torch.from_numpy(z)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        ctx.call, *tensors = inputs
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)

    @staticmethod
    def backward(ctx: Any, cotangents: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        return None, *_Gradient.apply(
            ctx.call, ctx.needs_input_grad[2:], cotangents, *ctx.saved_tensors)

    @staticmethod
    def jvp(ctx: Any, _: None, *tangents: torch.Tensor | None) -> torch.Tensor:
        return _Tangent.apply(ctx.call, *tangents, *ctx.saved_tensors)


class _Derivative(_Function):
    """
    A product with the derivatives of a run, which has no derivatives itself.

    The tensors that the run depends on are among its arguments. Otherwise torch would take the
    gradient of a loss that is linear in the states for a constant, since its cotangents are.
    """

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: object) -> None:
        pass

    @staticmethod
    def backward(*_: object) -> NoReturn:
        raise UnsupportedSystem(_TWICE)

    @staticmethod
    def jvp(*_: object) -> NoReturn:
        raise UnsupportedSystem(_TWICE)


class _Gradient(_Derivative):
    """The gradient by the inputs of a run, as far as torch needs it."""

    @staticmethod
    def forward(call: Call, needed: Sequence[bool], cotangents: torch.Tensor,
                *_: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        recorded, = call.recorded
        wanted = [k for k, one in enumerate(needed[1:]) if one]
        by_commands = None
        if needed[0] and recorded.commands is not None:
            by_commands = np.empty(recorded.commands.shape)
        with call.simulation.holding(call.numbers) as held:
            held.run.go_back_to(recorded)
            gradient, found = held.run.pull_back(array(cotangents), [
                call.simulation.dependence(held, call.numbers, call.names[k]) for k in wanted],
                by_commands)
        others: list[torch.Tensor | None] = [None] * len(call.names)
        for k, part in zip(wanted, found, strict=True):
            others[k] = torch.from_numpy(part)
        pushed = None if by_commands is None else torch.from_numpy(by_commands)
        return torch.from_numpy(gradient), pushed, *others


class _Tangent(_Derivative):
    """The change of the states with the inputs of a run: their changes, then these tensors."""

    @staticmethod
    def forward(call: Call, *tensors: torch.Tensor | None) -> torch.Tensor:
        recorded, = call.recorded
        z0, commands, *others = (None if change is None else array(change)
                                 for change in tensors[:len(tensors) // 2])
        with call.simulation.holding(call.numbers) as held:
            held.run.go_back_to(recorded)
            changes = [(call.simulation.dependence(held, call.numbers, name), change)
                       for name, change in zip(call.names, others, strict=True)
                       if change is not None and change.any()]
            first = np.zeros(recorded.z.shape) if z0 is None else z0
            return torch.from_numpy(
                held.run.push_forward([Change(first, changes, commands)])[0])


def array(tensor: torch.Tensor) -> np.ndarray:
    """Return the numbers of a tensor, or raise UnsupportedSystem."""
    try:
        return tensor.detach().contiguous().numpy()
    except RuntimeError as problem:
        raise UnsupportedSystem(_HIDDEN) from problem
