# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations that torch can differentiate: exact derivatives of the compiled steps.

Takes the extra ``train``. See docs/gradients.md.
"""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
import re
from typing import Any, NamedTuple

from hnn_vi_ros.accuracy.automatic_choice import resolve
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.kernels.addresses import by_address
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.learning.weights import OnWeights, with_weights
from hnn_vi_ros.models.learned import warn_of_scheme
from hnn_vi_ros.run.acting_effects import flow_rates
from hnn_vi_ros.run.dependences import Dependence, on_number
from hnn_vi_ros.run.derivatives import Change, DifferentiableRun
from hnn_vi_ros.run.recorders import check_memory
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.scene.named_numbers import with_numbers
from hnn_vi_ros.simulation.checks import check_count, check_seconds
from hnn_vi_ros.simulation.dense_step import whole_steps
from hnn_vi_ros.simulation.system import System
import numpy as np
import torch
from torch.autograd.function import once_differentiable

__all__ = ['Motion', 'simulate']

# Names of tensors of a model, among those of numbers of a scene.
_WEIGHT = re.compile(r'hamiltonian\.(\w+\.)?linear\d+\.(weight|bias)')


class Motion(NamedTuple):
    """
    Result of ``simulate``.

    Parameters
    ----------
    t : torch.Tensor, shape (N + 1,)
        Times of the samples [s].
    q, p : torch.Tensor, shape (N + 1, d) or (N + 1, m, d)
        States, the initial ones first.

    """

    t: torch.Tensor
    q: torch.Tensor
    p: torch.Tensor


def simulate(scene: Scene | str | Path, q0: torch.Tensor, p0: torch.Tensor, *, duration: float,
             parameters: Mapping[str, torch.Tensor] | None = None,
             commands: torch.Tensor | None = None, step_size: float | torch.Tensor | None = None,
             every: int = 1, checkpoints: int | None = None) -> Motion:
    """
    Simulate a scene, as a function that torch differentiates, once, in reverse or forward mode.

    The states are those of ``hnn_vi_ros.simulate``, or of ``simulate_many``, bit by bit. Their
    derivatives are those of the compiled steps, exact to round-off: no steps are recorded by
    torch. Memory grows with the square root of the number of steps.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``hnn_vi_ros.simulate``. Of effects it may have those that join H, forces that depend
        on time and state, damping, and external_force on coordinates.
    q0, p0 : torch.Tensor, shape (d,) or (m, d)
        The initial state, or those of m trajectories, of float64.
    duration : float
        Simulated time [s], a whole number of samples.
    parameters : mapping of str to torch.Tensor, optional
        Numbers in place of the scene's, of shape (), by their place in it:
        ``'hamiltonian.mass'``, ``'effects.0.stiffness'``; and tensors in place of those of its
        model, by their names in the file: ``'hamiltonian.linear1.weight'``.
    commands : torch.Tensor, shape (N, c) or (N, m, c), optional
        Of external_force: a row for each of N samples, which holds until the next; for all
        trajectories or for each of m.
    step_size : float or torch.Tensor, shape (), optional
        h [s], in place of the scene's. By a tensor the motion is differentiated with the number
        of steps as it is, and so are the times.
    every : int, optional
        Steps from one sample to the next.
    checkpoints : int, optional
        Most snapshots that are kept for the gradient, of each block of trajectories: fewer take
        less memory, and steps are taken more often. By default the square root of the number of
        steps, up to a thousand.

    Returns
    -------
    Motion
        Times and states. No guard looks at them: see ``hnn_vi_ros.simulate`` for alarms.

    Raises
    ------
    UnsupportedSystem
        The scene's method, an effect or the model's weights are not differentiable yet; names
        what is.
    HnnViRosError
        An unknown scene, a model that cannot be loaded, a StepFailure, or, when derivatives are
        asked for, a step that has none.
    ValueError, TypeError
        An argument that is not usable.

    """
    if not isinstance(parameters, Mapping | None):
        raise TypeError(f'parameters is a {type(parameters).__name__}: give a mapping of names '
                        "to tensors, such as {'hamiltonian.mass': mass}")
    given = {} if commands is None else {'commands': commands}
    _check_tensors({'q0': q0, 'p0': p0, **given, **(parameters or {})})
    check_count('every', every)
    if checkpoints is not None:
        check_count('checkpoints', checkpoints)
    check_seconds('duration', duration)
    scene, run, others = _prepared(
        scene if isinstance(scene, Scene) else load_scene(scene), parameters or {}, step_size)
    samples, d = _samples(duration, scene.known_step_size, every), len(scene.initial_state.q)
    if q0.shape != p0.shape or q0.ndim not in (1, 2) or q0.shape[-1] != d or not len(q0):
        raise ValueError(f'q0 and p0 have shapes {tuple(q0.shape)} and {tuple(p0.shape)}, '
                         f'expected ({d},) or (m, {d}) twice')
    check_memory(duration, every * scene.known_step_size, q0.numel())
    z0 = torch.cat([q0, p0], dim=-1)
    trajectories = 1 if q0.ndim == 1 else len(q0)
    if commands is not None and (commands.ndim not in (2, 3) or len(commands) != samples or (
            commands.ndim == 3 and commands.shape[1] != trajectories)):
        raise ValueError(f'commands have shape {tuple(commands.shape)}, expected ({samples}, c) '
                         f'or ({samples}, {trajectories}, c)')
    how = _How(samples, every, checkpoints)
    z = _Run.apply(run, [dependence for dependence, _ in others], how,
                   z0.reshape(-1, z0.shape[-1]), commands, *(tensor for _, tensor in others))
    q, p = z.reshape(samples + 1, *z0.shape).chunk(2, dim=-1)
    h = step_size if isinstance(step_size, torch.Tensor) else scene.known_step_size
    return Motion(torch.arange(samples + 1, dtype=torch.float64) * every * h, q, p)


def _prepared(scene: Scene, parameters: Mapping[str, torch.Tensor],
              step_size: float | torch.Tensor | None
              ) -> tuple[Scene, DifferentiableRun, list[tuple[Dependence, torch.Tensor]]]:
    """Return the scene with its method and numbers, its run, and all that this depends on."""
    weights = {name.removeprefix('hamiltonian.'): tensor for name, tensor in parameters.items()
               if _WEIGHT.fullmatch(name)}
    numbers = {name: tensor for name, tensor in parameters.items()
               if not _WEIGHT.fullmatch(name)}
    single = numbers | ({'step_size': step_size} if isinstance(step_size, torch.Tensor) else {})
    _check_tensors(single)
    for name, tensor in single.items():
        if tensor.ndim:
            raise ValueError(f'{name} has shape {tuple(tensor.shape)}, expected (): one number')
    scene = with_numbers(scene, {name: float(number.detach()) for name, number in numbers.items()})
    if isinstance(step_size, torch.Tensor):
        step_size = float(step_size.detach())
    scene, _ = resolve(scene.with_overrides(step_size))
    if scene.events:
        raise ValueError(f'events are not differentiable yet: leave those of {scene.name} out')
    hamiltonian, h = scene.create_hamiltonian(), scene.known_step_size
    warn_of_scheme(hamiltonian, scene.integrator.kind, h)
    if weights:
        hamiltonian = with_weights(hamiltonian, {
            name: tensor.detach().numpy().copy() for name, tensor in weights.items()})
    run = DifferentiableRun(hamiltonian, scene.create_integrator(), h, scene.create_effects())
    others: list[tuple[Dependence, torch.Tensor]] = [
        (_OnNumberOfScene(scene, hamiltonian, name, float(number.detach())), number)
        for name, number in numbers.items()]
    if 'step_size' in single:
        others.append((run.on_step_size, single['step_size']))
    if weights:
        others.append((OnWeights(hamiltonian, list(weights)),
                       torch.cat([tensor.reshape(-1) for tensor in weights.values()])))
    return scene, run, others


class _How(NamedTuple):
    """Number of samples, steps from one to the next, and most snapshots."""

    samples: int
    every: int
    checkpoints: int | None


class _Run(torch.autograd.Function):
    """A run, by its initial states (m, 2 d) and by what else it depends on."""

    @staticmethod
    def forward(run: DifferentiableRun, dependences: list[Dependence], how: _How,
                z0: torch.Tensor, commands: torch.Tensor | None, *others: torch.Tensor
                ) -> torch.Tensor:
        return torch.from_numpy(run.record(
            z0.detach().numpy(), how.samples, how.every,
            None if commands is None else commands.detach().numpy(),
            checkpoints=how.checkpoints))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple, output: torch.Tensor) -> None:
        ctx.run, ctx.dependences, _, z0, commands, *_ = inputs
        ctx.shape = tuple(z0.shape)
        ctx.commands = None if commands is None else tuple(commands.shape)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangents: torch.Tensor) -> tuple:
        wanted = [k for k, needed in enumerate(ctx.needs_input_grad[5:]) if needed]
        by_commands = np.empty(ctx.commands) if ctx.needs_input_grad[4] else None
        gradient, found = ctx.run.pull_back(
            cotangents.contiguous().numpy(), [ctx.dependences[k] for k in wanted], by_commands)
        others: list[torch.Tensor | None] = [None] * len(ctx.dependences)
        for k, part in zip(wanted, found, strict=True):
            others[k] = torch.from_numpy(part)
        pushed = None if by_commands is None else torch.from_numpy(by_commands)
        return None, None, None, torch.from_numpy(gradient), pushed, *others

    @staticmethod
    def jvp(ctx: Any, *tangents: torch.Tensor | None) -> torch.Tensor:
        z0, commands, *others = (
            None if change is None else change.detach().contiguous().numpy()
            for change in tangents[3:])
        changes = [(dependence, change) for dependence, change in zip(
            ctx.dependences, others, strict=True) if change is not None and change.any()]
        tangents = np.zeros(ctx.shape) if z0 is None else z0
        return torch.from_numpy(
            ctx.run.push_forward([Change(tangents, changes, commands)])[0])


class _OnNumberOfScene:
    """The dependence on a number of a scene; what it takes is made when it is first asked for."""

    def __init__(self, scene: Scene, hamiltonian: Hamiltonian, name: str, value: float):
        self._scene, self._hamiltonian = scene, hamiltonian
        self._name, self._value = name, value

    def contracted(self, q: np.ndarray, p: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the gradient; see Dependence."""
        return self._made.contracted(q, p, weights)

    def changed(self, q: np.ndarray, p: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Return the change; see Dependence."""
        return self._made.changed(q, p, change)

    @property
    def rates(self) -> np.ndarray | None:
        """Return how rates of damping change with the number."""
        return getattr(self._made, 'rates', None)

    @cached_property
    def _made(self) -> Dependence:
        try:
            # Rates are those of effects, on which numbers of H have no influence.
            return on_number(self._kernel, self._value,
                             self._rates if self._name.startswith('effects.') else None)
        except SceneError as problem:
            raise ValueError(f'{self._name} = {self._value:g} is too near to the end of its '
                             f'range to be differentiated by: {problem}') from problem

    def _rates(self, value: float) -> np.ndarray:
        """Return the rates of damping around the steps with another value."""
        scene = with_numbers(self._scene, {self._name: value})
        return flow_rates(self._hamiltonian, scene.create_integrator(), scene.create_effects())

    def _kernel(self, value: float) -> Kernel:
        """Return the kernel of H with another value."""
        scene = with_numbers(self._scene, {self._name: value})
        hamiltonian = self._hamiltonian if self._name.startswith('effects.') \
            else scene.create_hamiltonian()
        if not scene.effects:
            # Then a system is H and the method themselves, which the run has checked.
            return by_address(hamiltonian.kernel)
        return System(hamiltonian, scene.create_effects(), scene.create_integrator()).kernel


def _check_tensors(tensors: Mapping[str, torch.Tensor]) -> None:
    """Raise unless arguments are tensors that can be simulated with."""
    for name, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor):
            raise TypeError(f'{name} is a {type(tensor).__name__}: give a tensor of float64')
        if tensor.dtype != torch.float64 or tensor.device.type != 'cpu':
            raise TypeError(f'{name} is of {tensor.dtype} on {tensor.device}: give one of float64 '
                            'on the processor, as by .double().cpu()')


def _samples(duration: float, h: float, every: int) -> int:
    """Return how many samples a duration is."""
    steps, share = whole_steps(duration, h)
    if share or steps % every:
        raise ValueError(f'duration = {duration:g} s is {duration / (h * every):g} samples, one '
                         f'every {every * h:g} s: give a whole number of them')
    return steps // every
