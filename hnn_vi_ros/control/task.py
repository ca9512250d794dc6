# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Tasks: the schema of their YAML, and how one becomes a controller of a scene."""

from collections import deque
from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Protocol, Self

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.energy_shaping import EnergyShaping
from hnn_vi_ros.control.linear import find_equilibrium, momentum, velocity
from hnn_vi_ros.control.regulator import Regulator
from hnn_vi_ros.errors import DataError, did_you_mean, listed
from hnn_vi_ros.files.resources import find_yaml
from hnn_vi_ros.files.yaml_file import read_yaml, StrictModel
from hnn_vi_ros.files.yaml_text import KeyPlaces
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.scene import load_scene, Scene
import numpy as np
from pydantic import Field, model_validator

Name = Annotated[str, Field(min_length=1, max_length=256)]
Numbers = Annotated[list[float], Field(min_length=1, max_length=100)]
Weights = Annotated[list[Annotated[float, Field(ge=0.0, le=1e9)]], Field(
    min_length=1, max_length=100)]
# Commands are held while a model takes steps that fit into their time [1].
_FITS = 1e-6


class Controller(Protocol):
    """What acts on a scene: one call a command."""

    mode: str
    cost: float
    plan: Any

    def __call__(self, q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        """Return the command, shape (c,), at coordinates and velocities at a time [s]."""


class Goal(StrictModel):
    """A state at rest."""

    near: dict[Name, float] = Field(max_length=100, description=(
        'coordinates by name, from which it is searched; others begin at the initial state'))
    held: bool = Field(False, description=(
        'whether commands hold the coordinates exactly there, against forces; without it the '
        'state is one that needs none'))
    position: Weights | None = Field(None, description=(
        'weight of the deviation of each coordinate; default: 1'))
    velocity: Weights | None = Field(None, description=(
        'weight of the deviation of each velocity; default: 0.1'))


class Stepping(StrictModel):
    """Steps of the model that a controller plans by, where they are not those of the scene."""

    integrator: Name | None = Field(None, description='name of a method')
    step_size: float = Field(gt=0.0, le=1e6, description='h [s]')


class RegulatorChoice(StrictModel):
    """The linear regulator alone."""

    kind: Literal['lqr'] = Field(description='the linear regulator of the goal')

    def make(self, regulator: Regulator) -> Controller:
        """Return the controller."""
        return regulator


class EnergyChoice(StrictModel):
    """Energy shaping."""

    kind: Literal['energy_shaping'] = Field(description=(
        'the energy of the goal, by what commands pump in; near the goal the linear regulator'))
    gain: float = Field(1.0, gt=0.0, le=1e9, description='command per energy and velocity [s]')
    stiffness: float = Field(0.0, ge=0.0, le=1e9, description=(
        'of springs that hold the driven coordinates near the goal [N/m] or [N m/rad]'))

    def make(self, regulator: Regulator) -> Controller:
        """Return the controller."""
        return EnergyShaping(regulator, self.gain, self.stiffness)


class Task(StrictModel):
    """What is to be done with a scene, by which commands, how often."""

    description: str = Field('', max_length=1000, description='one line for lists and titles')
    scene: str = Field(min_length=1, max_length=4096, description=(
        'the model: name of a shipped scene, or a YAML file, from the folder of this one'))
    inputs: dict[Name, Annotated[float, Field(gt=0.0, le=1e12)]] = Field(
        min_length=1, max_length=100, description=(
            'the coordinates that motors drive, and the largest size of each command [N], [N m]'))
    period: float = Field(gt=0.0, le=1e3, description='from one command to the next [s]')
    delay: float = Field(0.0, ge=0.0, le=10.0, description=(
        'from a state to when its command acts, which the model predicts [s]'))
    silence: float = Field(0.2, ge=0.01, le=1e6, description=(
        'wall time without a usable state, after which the commands are as `on_silence` says [s]'))
    on_silence: Literal['stop', 'hold'] = Field('stop', description=(
        'stop: they are zero; hold: the last one is repeated'))
    goal: Goal = Field(description='the state at rest to reach')
    stepping: Stepping | None = Field(None, description='the steps of the model')
    controller: RegulatorChoice | EnergyChoice = Field(
        discriminator='kind', description='what computes the commands')

    @model_validator(mode='after')
    def _check_delay(self) -> Self:
        if self.delay > 100.0 * self.period:
            raise ValueError(f'delay: {self.delay:g} s are more than 100 periods of '
                             f'{self.period:g} s')
        return self


class Assignment(NamedTuple):
    """
    A task, ready: its controller and what belongs to it.

    Parameters
    ----------
    task : Task
        As it was read.
    scene : Scene
        The model, with the task's inputs and steps.
    hamiltonian : Hamiltonian
        Its H.
    controller : Controller
        What acts.
    prediction : Prediction
        Where the state will be when a command acts.
    numbers : tuple of str
        The coordinates of the numbers of a whole command to the scene, inputs or not.

    """

    task: Task
    scene: Scene
    hamiltonian: Hamiltonian
    controller: Controller
    prediction: 'Prediction'
    numbers: Sequence[str]

    @property
    def limits(self) -> np.ndarray:
        """Return the largest size of each command, shape (c,)."""
        return np.array([*self.task.inputs.values()])


class Prediction:
    """
    The state that a command will find: some time on, under the commands that act until then.

    Parameters
    ----------
    steps : BatchStep
        Single steps of the model.
    delay : float
        From a state to when its command acts [s], rounded to steps.

    """

    def __init__(self, steps: BatchStep, delay: float):
        self._steps, self._count = steps, round(delay / steps.duration)
        self.delay = self._count * steps.duration
        # When commands act, and they, newest last.
        self._sent: deque[tuple[float, np.ndarray]] = deque()

    def forget(self) -> None:
        """Begin anew: no command is under way."""
        self._sent.clear()

    def send(self, t: float, u: np.ndarray) -> None:
        """Keep the command, shape (c,), that answers the state of a time [s]."""
        self._sent.append((t + self.delay, u))

    def __call__(self, t: float, q: np.ndarray, v: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v, shape (d,) each, when the command to a state at a time [s] acts."""
        if not self._count:
            return q, v
        z = np.concatenate([q, momentum(self._steps, q, v)])
        h, half = self._steps.duration, 0.5 * self._steps.duration
        for k in range(self._count):
            begin = t + k * h
            while len(self._sent) > 1 and self._sent[1][0] < begin + half:
                self._sent.popleft()
            acting = self._sent and self._sent[0][0] < begin + half
            z = self._steps(z, self._sent[0][1] if acting else np.zeros(self._steps.commands),
                            begin)
        q, p = np.split(z, 2)
        return q, velocity(self._steps, q, p)


def load_task(task: str | Path) -> tuple[Task, KeyPlaces, Path]:
    """
    Read and validate a task.

    Parameters
    ----------
    task : str or Path
        The name of a shipped task, or the path of a YAML file.

    Returns
    -------
    tuple of (Task, KeyPlaces, Path)
        The task, where its keys stand, and the folder that its paths start from.

    Raises
    ------
    DataError
        No such task, or one that is not valid; names file, line and key.

    """
    path = find_yaml('task', str(task), DataError)
    loaded, places = read_yaml(path, Task, DataError)
    return loaded, places, path.parent


def assign(task: str | Path, scene: str | Path | Scene = '') -> Assignment:
    """
    Return a task with its controller, which is compiled on its first call.

    Parameters
    ----------
    task : str or Path
        See ``load_task``.
    scene : str, Path or Scene, optional
        The model in the place of the task's; its coordinates must have the same names.

    Raises
    ------
    DataError
        The task does not fit the scene; names file, line and key.
    HnnViRosError
        The scene cannot be read, or built, or has effects whose steps have no derivatives.

    """
    loaded, places, folder = load_task(task)
    if not scene:
        beside = folder / loaded.scene
        scene = beside if beside.is_file() else loaded.scene
    model = scene if isinstance(scene, Scene) else load_scene(scene)
    return _Assigning(loaded, places, model).assignment()


class _Assigning:
    """A task and the scene that it is for; errors name the place in the task."""

    def __init__(self, task: Task, places: KeyPlaces, scene: Scene):
        self._task, self._places = task, places
        own = [effect for effect in scene.effects if effect.kind == 'external_force']
        others = [effect.model_dump(by_alias=True) for effect in scene.effects
                  if effect.kind != 'external_force']
        force = {'kind': 'external_force', 'coordinates': [*task.inputs], 'timeout': 1e6}
        self.scene = scene.changed({'effects': [*others, force]})
        if task.stepping is not None:
            self.scene = self.scene.with_overrides(
                task.stepping.step_size, task.stepping.integrator)
        numbers = own[0].coordinates if own and own[0].coordinates else [*task.inputs]
        self._numbers = [*numbers, *(name for name in task.inputs if name not in numbers)]

    def assignment(self) -> Assignment:
        task, step = self._task, BatchStep(self.scene)
        hold = round(task.period / step.duration)
        if hold < 1 or abs(hold * step.duration - task.period) > _FITS * task.period:
            raise self._wrong(f'{task.period:g} s must be a multiple of the step size of the '
                              f'model, {step.duration:g} s; see stepping', 'period')
        steps = BatchStep(step.scene, hold)
        try:
            regulator = Regulator(
                steps, self._goal(step), [*task.inputs.values()],
                self._weights('position', step, 1.0), self._weights('velocity', step, 0.1))
            controller = task.controller.make(regulator)
        except ValueError as problem:
            if isinstance(problem, DataError):
                raise
            raise self._wrong(str(problem), 'goal') from problem
        return Assignment(task, self.scene, steps.hamiltonian, controller,
                          Prediction(step, task.delay), self._numbers)

    def _goal(self, step: BatchStep) -> tuple[np.ndarray, np.ndarray]:
        goal, (names, _) = self._task.goal, columns(step.hamiltonian.coordinates)
        near = np.array(self.scene.initial_state.q)
        for name, value in goal.near.items():
            if name not in names:
                raise self._wrong(f'no such coordinate{did_you_mean(name, names)}; valid: '
                                  f'{listed(names)}', 'goal', 'near', name)
            near[names.index(name)] = value
        return find_equilibrium(step, near, [] if goal.held else None, goal.held)

    def _weights(self, key: Literal['position', 'velocity'], step: BatchStep, default: float
                 ) -> Sequence[float]:
        given = getattr(self._task.goal, key)
        if given is not None and len(given) != step.dimension:
            raise self._wrong(f'{len(given)} weights, expected {step.dimension}, one for each '
                              'coordinate', 'goal', key)
        return [default] * step.dimension if given is None else given

    def _wrong(self, text: str, *key: str) -> DataError:
        return DataError(f'{self._places.place(*key)}: {text}')
