# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Differentiable simulations for torch: exact derivatives of the compiled steps.

Requires the extra ``train``. See docs/how-to/gradients.md.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import listed, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.models import Checkpoint, FAMILIES, LearnedHamiltonian, Network, warn_of_scheme
from hnn_vi_ros.scene import check_names, LearnedChoice, load_scene, Scene
from hnn_vi_ros.simulation import (
    base_of, Change, check_count, check_in_files, check_memory, check_seconds, Dependence, Numbers,
    OnHamiltonian, OnLagrangian, resolve, RunRecord, SceneRun, StateSequence, whole_steps)
import numpy as np
import torch

# Inputs of each network of H, for families whose H or Lagrangian consists of networks and of terms
# without weights; for a mechanism, of features of these inputs.
_INPUTS = {
    'hnn': {'energy': 'both'}, 'dissipative_hnn': {'energy': 'both'}, 'dgnet': {'energy': 'both'},
    'separable_hnn': {'kinetic': 'p', 'potential': 'q'}, 'vin': {'potential': 'q'},
    'mechanical': {'mass': 'q', 'potential': 'q', 'friction': 'q'}}
# Number of states differentiated together.
_BLOCK_STATES = 4096


def with_weights(hamiltonian: Hamiltonian, weights: Mapping[str, np.ndarray]) -> Checkpoint:
    """
    Return the model of a trained H with other weights.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of a scene.
    weights : mapping of str to np.ndarray
        Weights by the names of tensors in the model file: ``linear1.weight``, or
        ``potential.linear1.weight`` in a family with several networks.

    Raises
    ------
    UnsupportedSystem
        H is not a trained model, the weights of its family are not differentiable yet, or walls
        confine it.
    ValueError
        A tensor does not exist, or has another shape.

    """
    known = check_weights(hamiltonian, weights)
    assert isinstance(hamiltonian, LearnedHamiltonian)
    for name, value in weights.items():
        if value.shape != known[name].shape:
            raise ValueError(f'{name} has shape {value.shape}, expected {known[name].shape}')
    return hamiltonian.checkpoint.with_tensors(weights)


def check_weights(hamiltonian: Hamiltonian, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return the tensors of a trained H by name; raise as in ``with_weights``."""
    if not isinstance(hamiltonian, LearnedHamiltonian):
        raise UnsupportedSystem(
            f'weights of {type(hamiltonian).__name__} are not differentiable yet: it is not a '
            'trained model, or it is confined to its training domain (set confine: false)')
    checkpoint = hamiltonian.checkpoint
    if checkpoint.card.family not in _INPUTS:
        raise UnsupportedSystem(f'weights of the family {checkpoint.card.family} are not '
                                f'differentiable yet; supported families: {", ".join(_INPUTS)}')
    if checkpoint.members:
        raise UnsupportedSystem('weights of an ensemble are not differentiable yet: use one of '
                                'its members, with member: K in hamiltonian')
    known = _of_H(checkpoint).tensors
    for name in names:
        if name not in known:
            raise ValueError(f'the model has no tensor {name!r}; it has: {listed(known)}')
    return known


def _of_H(checkpoint: Checkpoint) -> Checkpoint:
    """Return a model with only the networks that are part of H or of a machine's friction."""
    sees = _INPUTS[checkpoint.card.family]
    return replace(checkpoint, networks={
        network: layers for network, layers in checkpoint.networks.items() if network in sees})


class _Slopes(torch.nn.Module):
    """
    The networks' part of H', shape (N, 2 d), at states of that shape.

    For a machine: (-L_q + D(q) v, -L_v) with the network's friction D v, at (q, v).
    """

    def __init__(self, checkpoint: Checkpoint):
        super().__init__()
        card = checkpoint.card
        self._inputs, self._lagrangian = _INPUTS[card.family], None
        self.networks = torch.nn.ModuleDict({
            name: Network(layers, card.activation)
            for name, layers in checkpoint.networks.items()})
        if card.mechanical is not None:
            machine = FAMILIES[card.family].trainer.of_model(card.mechanical, self.networks)
            # Not the machine itself, which would register its networks twice.
            self._lagrangian, self._friction = machine.lagrangian, machine.friction.forward

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        """Return the slopes."""
        z = states.detach().requires_grad_()
        q, p = z.chunk(2, dim=1)
        if self._lagrangian is not None:
            slopes = _gradient(-self._lagrangian(q, p), z)
            return slopes + torch.cat([self._friction(q, p), 0.0 * p], dim=1)
        seen = {'q': q, 'p': p, 'both': z}
        return _gradient(torch.cat([
            network(seen[self._inputs[name]]) for name, network in self.networks.items()]), z)


def _gradient(values: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
    """Return the gradient of the sum of values, which can be differentiated again."""
    (slopes,) = torch.autograd.grad(values.sum(), z, create_graph=True)
    return slopes


class OnWeights:
    """
    Derivatives of a trained H with respect to some of its weights; see Dependence.

    For a machine: of -L(q, v) and of its friction, at velocities in place of momenta; see
    OnLagrangian.

    Parameters
    ----------
    checkpoint : Checkpoint
        Model from ``with_weights``.
    names : sequence of str
        Names of the tensors, whose weights are concatenated.

    """

    def __init__(self, checkpoint: Checkpoint, names: Sequence[str]):
        card = checkpoint.card
        first, *others = card.layout
        prefix = 'networks.' if others else f'networks.{first}.'
        self._names, self._d = [prefix + name for name in names], len(card.coordinates)
        self._module = _Slopes(_of_H(checkpoint))

    def contracted(self, at: StateSequence, weights: np.ndarray) -> np.ndarray:
        """Return the gradient, shape (W,); see Dependence."""
        total = np.zeros(())
        for states, directions in zip(self._rows(at.q, at.p), self._rows(*weights), strict=True):
            flat, slopes = self._slopes(states)
            (part,) = torch.autograd.grad(
                slopes, flat, directions, allow_unused=True, materialize_grads=True)
            total = total + part.numpy()
        return total

    def changed(self, at: StateSequence, change: np.ndarray) -> np.ndarray:
        """Return the change due to weight changes of shape (W,); see Dependence."""
        parts = []
        for states in self._rows(at.q, at.p):
            flat, slopes = self._slopes(states)
            # The result is linear in the seed; its derivative is the change, for any seed.
            seed = torch.zeros_like(slopes, requires_grad=True)
            (pulled,) = torch.autograd.grad(slopes, flat, seed, create_graph=True,
                                            allow_unused=True, materialize_grads=True)
            (part,) = torch.autograd.grad(pulled, seed, torch.tensor(change),
                                          allow_unused=True, materialize_grads=True)
            parts.append(part)
        both = torch.cat(parts).reshape(-1, 2, self._d).transpose(0, 1)
        return both.reshape(2, -1).numpy()

    def _rows(self, q: np.ndarray, p: np.ndarray) -> tuple[torch.Tensor, ...]:
        """Return states, shape (N, 2 d), split into blocks."""
        states = np.hstack([q.reshape(-1, self._d), p.reshape(-1, self._d)])
        return torch.from_numpy(states).split(_BLOCK_STATES)

    def _slopes(self, states: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the weights, (W,), and the networks' H' as their function, (N, 2 d)."""
        with torch.enable_grad():
            own = [self._module.get_parameter(name) for name in self._names]
            flat = torch.cat([tensor.reshape(-1) for tensor in own]).requires_grad_()
            parts = flat.split([tensor.numel() for tensor in own])
            return flat, torch.func.functional_call(self._module, {
                name: part.view_as(tensor) for name, part, tensor in zip(
                    self._names, parts, own, strict=True)}, (states,))


__all__ = ['DifferentiableSimulation', 'SimulatedMotion', 'simulate']

# Names for all weights, and for h, among the tensors of a run.
_WEIGHTS, _STEP = 'weights', 'step_size'
_ONLY_ONCE = ('a simulation is differentiable only once: detach its gradient or tangent, or use '
              'differences of gradients; torch.autograd.functional.jvp differentiates twice, so '
              'use torch.func.jvp instead')
_NO_VMAP = ('a simulation supports neither tensors batched by vmap, nor weights in torch.func: '
            'use torch.autograd.grad, torch.autograd.functional.jacobian without vectorize, and '
            'q0, p0 of shape (m, d) for many trajectories')


@dataclass(frozen=True, eq=False)
class _Call:
    """
    A call without the tensors with respect to which it is differentiated.

    It is not a tuple, since torch.func copies tuples.

    Parameters
    ----------
    simulation : DifferentiableSimulation
        Simulation that is called.
    numbers : Numbers
        Values of the tensors that are numbers.
    names : list of str
        Names of the other tensors.
    samples, every : int
        Number of samples, and steps from one to the next.
    recorded : list of Recorded
        Record of the run, once it has been made.

    """

    simulation: 'DifferentiableSimulation'
    numbers: Numbers
    names: list[str]
    samples: int
    every: int
    recorded: list[RunRecord] = field(default_factory=list)


class _Function(torch.autograd.Function):
    """Base class of functions of arrays, without vmap."""

    @staticmethod
    def vmap(*_: object) -> NoReturn:
        raise UnsupportedSystem(_NO_VMAP)


class _Run(_Function):
    """A run as a function of its initial states (m, 2 d) and its other tensors."""

    @staticmethod
    def forward(call: _Call, z0: torch.Tensor, commands: torch.Tensor | None,
                *_: torch.Tensor) -> torch.Tensor:
        rows = None if commands is None else _array(commands)
        with call.simulation.holding(call.numbers) as held:
            if _STEP in call.names:
                held.run.on_step_size  # noqa: B018  refused before a step is taken
            z = held.run.record(_array(z0), call.samples, call.every, rows)
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
    Base class of products with the derivatives of a run, which have no derivatives themselves.

    The tensors of the run are among the arguments. Otherwise torch would treat the gradient of a
    loss that is linear in the states as constant, because its cotangents are.
    """

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: object) -> None:
        pass

    @staticmethod
    def backward(*_: object) -> NoReturn:
        raise UnsupportedSystem(_ONLY_ONCE)

    @staticmethod
    def jvp(*_: object) -> NoReturn:
        raise UnsupportedSystem(_ONLY_ONCE)


class _Gradient(_Derivative):
    """Gradient with respect to those inputs of a run that torch needs."""

    @staticmethod
    def forward(call: _Call, needed: Sequence[bool], cotangents: torch.Tensor,
                *_: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        recorded, = call.recorded
        wanted = [k for k, one in enumerate(needed[1:]) if one]
        by_commands = None
        if needed[0] and recorded.commands is not None:
            by_commands = np.empty(recorded.commands.shape)
        with call.simulation.holding(call.numbers) as held:
            held.run.recorded = recorded
            gradient, found = held.run.pull_back(_array(cotangents), [
                call.simulation.dependence(held, call.numbers, call.names[k]) for k in wanted],
                by_commands)
        others: list[torch.Tensor | None] = [None] * len(call.names)
        for k, part in zip(wanted, found, strict=True):
            others[k] = torch.from_numpy(part)
        pushed = None if by_commands is None else torch.from_numpy(by_commands)
        return torch.from_numpy(gradient), pushed, *others


class _Tangent(_Derivative):
    """Tangent of the states, given the tangents of a run's inputs, then these inputs."""

    @staticmethod
    def forward(call: _Call, *tensors: torch.Tensor | None) -> torch.Tensor:
        recorded, = call.recorded
        z0, commands, *others = (None if change is None else _array(change)
                                 for change in tensors[:len(tensors) // 2])
        with call.simulation.holding(call.numbers) as held:
            held.run.recorded = recorded
            changes = [(call.simulation.dependence(held, call.numbers, name), change)
                       for name, change in zip(call.names, others, strict=True)
                       if change is not None and change.any()]
            first = np.zeros(recorded.z.shape) if z0 is None else z0
            return torch.from_numpy(held.run.push_forward([Change(first, changes, commands)])[0])


def _array(tensor: torch.Tensor) -> np.ndarray:
    """Return a tensor as an array, or raise UnsupportedSystem."""
    try:
        return tensor.detach().contiguous().numpy()
    except RuntimeError as problem:
        raise UnsupportedSystem(_NO_VMAP) from problem


class SimulatedMotion(NamedTuple):
    """
    Result of ``simulate``.

    Parameters
    ----------
    t : torch.Tensor, shape (N + 1,)
        Times of the samples [s].
    q, p : torch.Tensor, shape (N + 1, d) or (N + 1, m, d)
        States, starting with the initial ones.

    """

    t: torch.Tensor
    q: torch.Tensor
    p: torch.Tensor


def simulate(scene: Scene | str | Path, q0: torch.Tensor, p0: torch.Tensor, *, duration: float,
             parameters: Mapping[str, torch.Tensor] | None = None,
             commands: torch.Tensor | None = None, step_size: float | torch.Tensor | None = None,
             every: int = 1) -> SimulatedMotion:
    """
    Simulate a scene differentiably in torch, once, in reverse or forward mode.

    The states of each trajectory equal those from ``hnn_vi_ros.simulate`` bit by bit. The
    derivatives are those of the compiled steps, exact to round-off: torch records no steps. Memory
    grows with the square root of the number of steps.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``hnn_vi_ros.simulate``. Supported effects are those that join H, forces that depend on
        time and state, damping, and external_force on coordinates.
    q0, p0 : torch.Tensor, shape (d,) or (m, d)
        Initial state, or m initial states of trajectories, float64.
    duration : float
        Simulated time [s], a multiple of the sampling interval.
    parameters : mapping of str to torch.Tensor, optional
        Values that replace the scene's. Numbers of shape () are named by their place:
        ``'hamiltonian.mass'``, ``'effects.0.stiffness'``. Tensors of the model have their names in
        the file: ``'hamiltonian.linear1.weight'``. Numbers of the card of a machine's model, in H
        and in effects of the same model: ``'model.friction.viscous.0'``. Links of a URDF:
        ``'urdf.forearm.mass'``, ``centre_x`` to ``centre_z``, and ``ixx`` to ``izz`` about the
        centre of mass in the axes of the link.
    commands : torch.Tensor, shape (N, c) or (N, m, c), optional
        Commands of external_force: one row per sample, held until the next; for all trajectories
        or for each of m.
    step_size : float or torch.Tensor, shape (), optional
        Step size h [s] that overrides the scene's. With respect to a tensor, the motion and the
        times are differentiated at a fixed number of steps.
    every : int, optional
        Number of steps per sample.

    Returns
    -------
    SimulatedMotion
        Times and states. Guards are not evaluated: see ``hnn_vi_ros.simulate`` for alarms.

    Raises
    ------
    UnsupportedSystem
        The scene's method, an effect or the model's weights are not differentiable yet; the
        message names those that are. Raised later if a second derivative is requested.
    HnnViRosError
        The scene is unknown, its model cannot be loaded, a step fails, or a step has no derivative
        when derivatives are requested.
    ValueError, TypeError
        An argument is invalid.

    """
    _check_mapping(parameters)
    if step_size is not None and not isinstance(step_size, torch.Tensor):
        scene = scene if isinstance(scene, Scene) else load_scene(scene)
        scene, step_size = scene.with_overrides(step_size), None
    return DifferentiableSimulation(scene, tuple(parameters or ()))(
        q0, p0, duration=duration, parameters=parameters, commands=commands, step_size=step_size,
        every=every)


class DifferentiableSimulation:
    """
    A scene prepared for repeated differentiable simulation in torch.

    It is read, checked and compiled once. A call writes its numbers into the memory of the
    compiled loops, and runs them; states and derivatives equal those of ``simulate`` bit by bit.
    Calls are independent of each other, even if they are differentiated later, and calls in
    several threads run concurrently.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``simulate``.
    parameters : sequence of str, optional
        Names of the values passed with each call; see ``simulate``.

    Raises
    ------
    UnsupportedSystem, HnnViRosError, ValueError
        See ``simulate``.

    """

    def __init__(self, scene: Scene | str | Path, parameters: Sequence[str] = ()):
        self._parts = resolve(scene if isinstance(scene, Scene) else load_scene(scene))
        self._scene = self._parts.scene
        if self._scene.events:
            raise ValueError('events are not differentiable yet: remove the events of '
                             f'{self._scene.name}')
        # The scene itself has no numbers of a trained H: they are in its file.
        self._weights = [name for name in parameters if name.startswith('hamiltonian.')
                         and isinstance(self._scene.hamiltonian, LearnedChoice)]
        self._names = [name for name in parameters if name not in self._weights]
        inside = check_in_files(self._parts, self._names)
        check_names(self._scene, [name for name in self._names if name not in inside])
        if self._weights:
            check_weights(self._parts.hamiltonian, map(_in_file, self._weights))
            if any(name.startswith('hamiltonian.friction.') for name in self._weights) and not any(
                    isinstance(effect, EFFECTS['learned_friction'])
                    for effect in self._parts.effects):
                raise ValueError(f'{self._scene.name} has no learned_friction, the only effect '
                                 'that uses weights of friction')
        # Runs that no thread is using at the moment.
        self._idle = [SceneRun(self._parts)]

    def __call__(self, q0: torch.Tensor, p0: torch.Tensor, *, duration: float,
                 parameters: Mapping[str, torch.Tensor] | None = None,
                 commands: torch.Tensor | None = None,
                 step_size: float | torch.Tensor | None = None, every: int = 1) -> SimulatedMotion:
        """
        Simulate with tensors for all declared parameters.

        Parameters
        ----------
        q0, p0, duration, parameters, commands, step_size, every
            See ``simulate``.

        Returns
        -------
        SimulatedMotion
            Times and states.

        Raises
        ------
        HnnViRosError, ValueError, TypeError
            See ``simulate``.

        """
        _check_mapping(parameters)
        given, parameters = {'q0': q0, 'p0': p0}, parameters or {}
        if commands is not None:
            given['commands'] = commands
        _check_tensors(given)
        _check_tensors(parameters)
        check_count('every', every)
        check_seconds('duration', duration)
        names, tensors = self._arranged(parameters, step_size)
        h = self._scene.known_step_size if step_size is None else self._step(step_size)
        warn_of_scheme(self._parts.hamiltonian, self._scene.integrator.kind, h)
        samples, d = _samples(duration, h, every), len(self._scene.initial_state.q)
        if q0.shape != p0.shape or q0.ndim not in (1, 2) or q0.shape[-1] != d or not len(q0):
            raise ValueError(f'q0 and p0 have shapes {tuple(q0.shape)} and {tuple(p0.shape)}, '
                             f'expected ({d},) or (m, {d}) twice')
        check_memory(duration, every * h, q0.numel())
        z0 = torch.cat([q0, p0], dim=-1)
        trajectories = 1 if q0.ndim == 1 else len(q0)
        if commands is not None and (commands.ndim not in (2, 3) or len(commands) != samples or (
                commands.ndim == 3 and commands.shape[1] != trajectories)):
            raise ValueError(f'commands have shape {tuple(commands.shape)}, expected ({samples}, '
                             f'c) or ({samples}, {trajectories}, c)')
        learned = None
        if self._weights:
            learned = with_weights(self._parts.hamiltonian, {
                _in_file(name): _array(parameters[name]).copy() for name in self._weights})
        values = {name: float(parameters[name].detach()) for name in self._names}
        call = _Call(self, Numbers(values, h, learned), names, samples, every)
        # Copies are saved for the derivatives, because callers may modify their tensors.
        z = _Run.apply(call, z0.reshape(-1, 2 * d), *(
            None if tensor is None else tensor.clone() for tensor in (commands, *tensors)))
        q, p = z.reshape(samples + 1, *z0.shape).chunk(2, dim=-1)
        return SimulatedMotion(torch.arange(samples + 1, dtype=torch.float64) * every * (
            step_size if isinstance(step_size, torch.Tensor) else h), q, p)

    def _arranged(self, parameters: Mapping[str, torch.Tensor],
                  step_size: float | torch.Tensor | None
                  ) -> tuple[list[str], list[torch.Tensor]]:
        """Return names and tensors of a run's inputs; all weights are concatenated to one."""
        expected = [*self._names, *self._weights]
        if parameters.keys() != set(expected):
            raise ValueError(f'parameters are {listed(parameters) or "none"}; expected those of '
                             f'this simulation: {listed(expected) or "none"}')
        single = {name: parameters[name] for name in self._names}
        if isinstance(step_size, torch.Tensor):
            _check_tensors({_STEP: step_size})
            single[_STEP] = step_size
        for name, tensor in single.items():
            if tensor.ndim:
                raise ValueError(f'{name} has shape {tuple(tensor.shape)}, expected (): one '
                                 'number')
        names, tensors = [*single], [*single.values()]
        if self._weights:
            names.append(_WEIGHTS)
            tensors.append(torch.cat([parameters[name].reshape(-1) for name in self._weights]))
        return names, tensors

    def _step(self, step_size: float | torch.Tensor) -> float:
        """Return a step size that overrides the scene's [s]; raise SceneError if it is invalid."""
        h = float(step_size.detach() if isinstance(step_size, torch.Tensor) else step_size)
        return self._scene.with_overrides(h).known_step_size

    @contextmanager
    def holding(self, numbers: Numbers) -> Iterator[SceneRun]:
        """Lend a run with these values for exclusive use."""
        try:
            held = self._idle.pop()
        except IndexError:
            held = SceneRun(self._parts)
        try:
            held.hold(numbers)
            yield held
        finally:
            self._idle.append(held)

    def dependence(self, held: SceneRun, numbers: Numbers, name: str) -> Dependence:
        """Return the dependence of a run on a tensor named in a ``_Call``."""
        if name == _STEP:
            return held.run.on_step_size
        if name == _WEIGHTS:
            assert numbers.model is not None
            own: Dependence = OnWeights(numbers.model, [*map(_in_file, self._weights)])
            if numbers.model.card.mechanical is not None:
                own = OnLagrangian(own, base_of(held.run.kernel))
            return OnHamiltonian(own, held.run.kernel)
        return held.on_number(name)


def _in_file(name: str) -> str:
    """Return the name of a tensor in its model file."""
    return name.removeprefix('hamiltonian.')


def _check_mapping(parameters: Mapping[str, torch.Tensor] | None) -> None:
    """Raise an error unless parameters map names to tensors."""
    if not isinstance(parameters, Mapping | None):
        raise TypeError(f'parameters is a {type(parameters).__name__}: give a mapping of names '
                        "to tensors, such as {'hamiltonian.mass': mass}")


def _check_tensors(tensors: Mapping[str, torch.Tensor]) -> None:
    """Raise an error unless the arguments are tensors of a supported kind."""
    for name, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor):
            raise TypeError(f'{name} is a {type(tensor).__name__}: give a tensor of float64')
        if tensor.dtype != torch.float64 or tensor.device.type != 'cpu':
            raise TypeError(f'{name} is {tensor.dtype} on {tensor.device}: give a float64 tensor '
                            'on the CPU, as from .double().cpu()')


def _samples(duration: float, h: float, every: int) -> int:
    """Return the number of samples in a duration."""
    steps, share = whole_steps(duration, h)
    if share or steps % every:
        raise ValueError(f'duration = {duration:g} s is {duration / (h * every):g} sample '
                         f'intervals of {every * h:g} s: give a whole number of them')
    return steps // every
