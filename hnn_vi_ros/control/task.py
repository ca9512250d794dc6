# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Tasks: their YAML schema, and the construction of a scene's controller from a task."""

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from functools import cached_property, reduce
import math
from operator import add
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Protocol

from hnn_vi_ros.control.balance import Balance, weights_of
from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import Cost, Energy, Kinetic, Point, Quadratic
from hnn_vi_ros.control.energy_shaping import EnergyShaping
from hnn_vi_ros.control.hover import Hover
from hnn_vi_ros.control.ilqr import Ilqr, Regulator
from hnn_vi_ros.control.linear import find_equilibrium, momentum, velocity
from hnn_vi_ros.control.mppi import Mppi
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import (
    DataError, did_you_mean, listed, prefixed, SceneError, UnsupportedSystem)
from hnn_vi_ros.files import find_yaml, KeyPlaces, read_yaml, StrictModel
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import choose, System
import numpy as np
from pydantic import Field

Name = Annotated[str, Field(min_length=1, max_length=256)]
Place = Annotated[list[float], Field(min_length=3, max_length=3)]
Weight = Annotated[float, Field(ge=0.0, le=1e9)]
Weights = Annotated[list[Weight], Field(min_length=1, max_length=100)]
_ROTORS = ['body_fz', 'body_rx', 'body_ry', 'body_rz']
# Relative tolerance: a command must be held for a whole number of the model's steps [1].
_HOLD_TOLERANCE = 1e-6
# Maximum number of model steps per command, and maximum memory of a plan [bytes].
_MAX_STEPS, _MAX_PLAN_BYTES = 1000, 1 << 30


class Controller(Protocol):
    """Interface of controllers: each call returns the next command."""

    mode: str
    cost: float
    plan: Any

    def __call__(self, q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        """Return the command, shape (c,), for coordinates and velocities at a time [s]."""


class Goal(StrictModel):
    """A state at rest."""

    near: dict[Name, float] = Field(max_length=100, description=(
        'coordinates by name at which the search starts; the others start at the initial state'))
    held: bool = Field(False, description=(
        'hold the coordinates exactly there with commands; otherwise the goal is an equilibrium '
        'without commands'))
    position: Weight | Weights = Field(1.0, description=(
        'weights of position errors in the linear regulator: one number, or one per coordinate'))
    velocity: Weight | Weights = Field(0.1, description='weights of velocity errors, likewise')


class Stepping(StrictModel):
    """Step size and integrator of the controller's model, if they differ from the scene's."""

    integrator: Name | None = Field(None, description='name of an integrator')
    step_size: float = Field(gt=0.0, le=1e6, description='step size h [s]')


class ControlContext:
    """
    Material of controllers and costs, created lazily and cached.

    Parameters
    ----------
    task : Task
        Task with inputs and goal.
    scene : Scene
        Model with these inputs.
    hold : int
        Number of model steps per command.

    Attributes
    ----------
    limits : np.ndarray, shape (c,)
        Maximum size of each command.

    """

    def __init__(self, task: 'Task', scene: Scene, hold: int):
        self.task, self.scene, self._hold = task, scene, hold
        self.limits = np.array([*task.inputs.values()])

    @cached_property
    def steps(self) -> BatchStep:
        """Return the steps of the model, each as long as a command is held."""
        return BatchStep(self.scene, self._hold)

    @cached_property
    def goal(self) -> Balance:
        """Return the regulator of the goal, or raise ValueError."""
        goal, steps = self.task.goal, self.steps
        if goal is None:
            raise ValueError('requires a goal; add one, for example goal: {near: {angle: 3.14}}')
        names, near = columns(steps.hamiltonian.coordinates)[0], [*self.scene.initial_state.q]
        for name, value in goal.near.items():
            if name not in names:
                raise ValueError(f'the goal names {name}{did_you_mean(name, names)}; '
                                 f'coordinates: {listed(names)}')
            near[names.index(name)] = value
        at = find_equilibrium(steps, near, [] if goal.held else None, goal.held)
        return Balance(steps, at, self.limits,
                       coordinate_weights(steps, 'goal.position', goal.position),
                       coordinate_weights(steps, 'goal.velocity', goal.velocity))


def coordinate_weights(steps: BatchStep, key: str, weights: float | Sequence[float]) -> np.ndarray:
    """Return a weight for each coordinate, shape (d,), or raise ValueError."""
    found = np.array(weights, dtype=np.float64)
    if found.shape not in ((), (steps.dimension,)):
        names = listed(one.name for one in steps.hamiltonian.coordinates)
        raise ValueError(f'{key} has {found.size} weights, expected one, or one per coordinate: '
                         f'{names}')
    return np.broadcast_to(found, steps.dimension)


class _Term(StrictModel):
    """A cost with a weight."""

    weight: float = Field(1.0, ge=0.0, le=1e12, description='factor of the cost')
    half: float | None = Field(None, gt=0.0, le=1e12, description=(
        'saturate the cost as cost / (cost + half), so that distant states do not dominate'))

    @abstractmethod
    def cost(self, means: ControlContext) -> Cost:
        """Return the cost without its weight."""

    def make(self, means: ControlContext) -> Cost:
        """Return the weighted cost."""
        cost = self.cost(means)
        return self.weight * (cost if self.half is None else cost.saturating(self.half))


class QuadraticChoice(_Term):
    """Squared deviations from the goal, and squared commands."""

    kind: Literal['quadratic'] = Field(description='weighted squared deviations from the goal')
    position: Weight | Weights = Field(0.0, description=(
        'weights of coordinates: one number, or one per coordinate'))
    velocity: Weight | Weights = Field(0.0, description=(
        'weights of velocities: one number, or one per coordinate'))
    command: float = Field(0.0, ge=0.0, description='weight of each command relative to its limit')

    def cost(self, means: ControlContext) -> Cost:
        """Return the cost."""
        at = means.goal.at
        return Quadratic(means.steps.hamiltonian, at, weights_of(
            means.steps, at, coordinate_weights(means.steps, 'position', self.position),
            coordinate_weights(means.steps, 'velocity', self.velocity)),
            self.command * np.diag(means.limits**-2.0))


class EffortChoice(_Term):
    """Squared commands."""

    kind: Literal['effort'] = Field(description='squared commands relative to their limits')

    def cost(self, means: ControlContext) -> Cost:
        """Return the cost."""
        n, c = 2 * means.steps.dimension, means.steps.commands
        return Quadratic(means.steps.hamiltonian, (np.zeros(n), np.zeros(c)), np.zeros((n, n)),
                         np.diag(means.limits**-2.0))


class RegulatedChoice(_Term):
    """The cost-to-go of the linear regulator."""

    kind: Literal['regulated'] = Field(description=(
        'cost-to-go x^T P x of the linear regulator, for the end of a plan'))

    def cost(self, means: ControlContext) -> Cost:
        """Return the cost."""
        c = means.steps.commands
        return Quadratic(means.steps.hamiltonian, means.goal.at, means.goal.value,
                         np.zeros((c, c)))


class EnergyCostChoice(_Term):
    """The squared deviation from the goal's energy."""

    kind: Literal['energy'] = Field(description='(H - H*)^2 with the energy H* of the goal')

    def cost(self, means: ControlContext) -> Cost:
        """Return the cost."""
        return Energy(means.steps.hamiltonian, means.goal.at[0])


class KineticChoice(_Term):
    """The kinetic energy."""

    kind: Literal['kinetic'] = Field(description='kinetic energy [J]')

    def cost(self, means: ControlContext) -> Cost:
        """Return the cost."""
        return Kinetic(means.steps.hamiltonian)


class PointChoice(_Term):
    """The squared distance of a point of a robot from its goal."""

    kind: Literal['point'] = Field(description=(
        'squared distance of a point of a URDF from its goal'))
    link: Name = Field(description='link of the point')
    goal: Place = Field(description='goal of the point in the frame of the root [m]')
    offset: Place = Field([0.0, 0.0, 0.0], description='point in the frame of the link [m]')
    length: float = Field(1.0, gt=0.0, description='unit of the distance [m]')

    def cost(self, means: ControlContext) -> Cost:
        """Return the cost."""
        return Point(means.steps.hamiltonian, self.link, self.goal, self.offset, self.length)


class TipChoice(_Term):
    """The squared distance of the tip of a chain of rods from its goal."""

    kind: Literal['tip'] = Field(description=(
        'squared distance of the tip of hanging rods from its goal, relative to their length'))
    lengths: Weights = Field(description=(
        'lengths of the rods [m]; the first coordinates are their angles'))
    goal: Place = Field(description='x, y and height of the tip above the first joint [m]')
    relative: bool = Field(False, description='measure angles from the previous rod')

    def cost(self, means: ControlContext) -> Cost:
        """Return the cost."""
        return Point.chain(self.lengths, self.goal, relative=self.relative)


CostChoice = Annotated[
    QuadraticChoice | EffortChoice | RegulatedChoice | EnergyCostChoice | KineticChoice
    | PointChoice | TipChoice, Field(discriminator='kind')]
Costs = Annotated[list[CostChoice], Field(min_length=1, max_length=20)]


class LqrChoice(StrictModel):
    """The linear regulator; use it near the goal, and one of the others to get there."""

    kind: Literal['lqr'] = Field(description='linear regulator of the goal')

    def make(self, means: ControlContext) -> Controller:
        """Return the controller."""
        return means.goal


class EnergyShapingChoice(StrictModel):
    """Energy shaping for swing-ups; it needs no horizon, but a regulator at the goal."""

    kind: Literal['energy_shaping'] = Field(description=(
        'commands drive the energy to that of the goal; near the goal the linear regulator takes '
        'over'))
    gain: float = Field(1.0, gt=0.0, le=1e9, description='command per energy and velocity [s]')
    stiffness: float = Field(0.0, ge=0.0, le=1e9, description=(
        'stiffness of springs that keep the driven coordinates near the goal [N/m] or [N m/rad]'))

    def make(self, means: ControlContext) -> Controller:
        """Return the controller."""
        return EnergyShaping(means.goal, self.gain, self.stiffness)


class HoverChoice(StrictModel):
    """Flight of a quadrotor to a position."""

    kind: Literal['hover'] = Field(description='a quadrotor flies to a position and hovers there')
    place: Place = Field(description='position x, y and z (upwards) [m]')

    def make(self, means: ControlContext) -> Controller:
        """Return the controller."""
        body = means.scene.hamiltonian
        if body.kind != 'quadrotor' or [*means.task.inputs] != _ROTORS:
            raise ValueError(f'hover requires a quadrotor with the inputs {listed(_ROTORS)}, not '
                             f'{body.kind} with {listed(means.task.inputs)}')
        return Hover(body.mass, body.mass * body.gravity, body.inertia, self.place)


class _Planning(StrictModel):
    """Common options of planners over a horizon."""

    horizon: int = Field(ge=2, le=10_000, description='number of commands in a plan')
    running: Costs = Field(description='costs of each state and command; they are added')
    final: Costs = Field(description='costs of the last state; they are added')
    seed: int = Field(0, ge=0, lt=2**63, description='seed of the random commands')

    def parts(self, means: ControlContext) -> tuple[BatchStep, Cost, Cost, int, Any]:
        """Return the arguments that planners have in common."""
        d, c = means.steps.dimension, means.steps.commands
        # Random plans store states and commands; a plan of iLQR stores derivatives as well.
        each = max(getattr(self, 'samples', 1), means.steps.hold * 2 * d) * (2 * d + c)
        if (size := 8 * self.horizon * each) > _MAX_PLAN_BYTES:
            raise ValueError(f'a plan of {self.horizon} commands requires {1e-9 * size:.3g} GB, '
                             f'at most {1e-9 * _MAX_PLAN_BYTES:.2g} GB; reduce horizon or '
                             'samples, or set a larger step size in stepping')
        running, final = (reduce(add, [term.make(means) for term in terms])
                          for terms in (self.running, self.final))
        return means.steps, running, final, self.horizon, (-means.limits, means.limits)


class IlqrChoice(_Planning):
    """iLQR: planning with derivatives; the first choice if the model is differentiable."""

    kind: Literal['ilqr'] = Field(description=(
        'a plan that is improved with derivatives in each period'))
    budget: float = Field(gt=0.0, le=1e3, description='time limit of a plan [s]')
    regulate_below: float | None = Field(None, gt=0.0, description=(
        'let the linear regulator take over if the running cost stays below this in a rollout'))
    restarts: int = Field(24, ge=1, le=10_000, description=(
        'number of random plans after a disturbance'))
    refined: int = Field(4, ge=1, le=1000, description='number of these plans that are improved')

    def make(self, means: ControlContext) -> Controller:
        """Return the controller."""
        regulator = None if self.regulate_below is None else Regulator(
            means.goal.at, means.goal.gain, self.regulate_below)
        return Ilqr(*self.parts(means), regulator, self.budget, restarts=self.restarts,
                    refined=self.refined, seed=self.seed)


class MppiChoice(_Planning):
    """MPPI: planning with random commands, for models without derivatives."""

    kind: Literal['mppi'] = Field(description='weighted mean of random plans')
    spread: float = Field(0.3, gt=0.0, le=10.0, description=(
        'standard deviation of random commands, relative to the limits [1]'))
    temperature: float = Field(gt=0.0, description=(
        'temperature of the weights, in units of the cost'))
    samples: int = Field(256, ge=1, le=100_000, description='number of random plans in a period')

    def make(self, means: ControlContext) -> Controller:
        """Return the controller."""
        return Mppi(*self.parts(means), self.spread * means.limits, self.temperature,
                    self.samples, seed=self.seed)


class Task(StrictModel):
    """A control task in a scene: inputs, period and controller."""

    description: str = Field('', max_length=1000, description='one line for lists and titles')
    scene: str = Field(min_length=1, max_length=4096, description=(
        'the model: name of a shipped scene, or path of a YAML file relative to this one'))
    inputs: dict[Name, Annotated[float, Field(gt=0.0, le=1e12)]] = Field(
        min_length=1, max_length=100, description=(
            'driven coordinates, and the maximum magnitude of each command [N], [N m]'))
    period: float = Field(gt=0.0, le=1e3, description='interval between commands [s]')
    plan_time: float = Field(0.0, ge=0.0, le=10.0, description=(
        'time from a state until its command is sent, at most a period; the plan starts from the '
        'state predicted for then [s]'))
    delay: float = Field(0.0, ge=0.0, le=10.0, description=(
        'further delay until the command acts, in the machine and on the way to it; predicted too '
        '[s]'))
    silence: float = Field(0.2, ge=0.01, le=1e6, description=(
        'wall time without a usable state after which `on_silence` applies [s]'))
    on_silence: Literal['stop', 'hold'] = Field('stop', description=(
        'stop: commands become zero; hold: the last command is repeated'))
    goal: Goal | None = Field(None, description='state at rest to reach')
    stepping: Stepping | None = Field(None, description='integrator and step size of the model')
    controller: LqrChoice | EnergyShapingChoice | HoverChoice | IlqrChoice | MppiChoice = Field(
        discriminator='kind', description='algorithm that computes the commands')

    def _check(self) -> None:
        if self.plan_time > self.period:
            raise ValueError(f'plan_time: {self.plan_time:g} s is longer than the period, '
                             f'{self.period:g} s')
        if self.delay > 100.0 * self.period:
            raise ValueError(f'delay: {self.delay:g} s is longer than 100 periods of '
                             f'{self.period:g} s')


class Assignment(NamedTuple):
    """
    A task with its controller, ready to run.

    Parameters
    ----------
    task : Task
        Task as read.
    scene : Scene
        Model with the task's inputs and steps.
    hamiltonian : Hamiltonian
        Hamiltonian of the model.
    controller : Controller
        Controller of the task.
    prediction : Prediction
        Prediction of the state at which a command will act.
    numbers : tuple of str
        Coordinates of the scene's whole command, including those that are not inputs.
    left_out : tuple of str
        Effects of the scene with rigid stops, which the model lacks: stops have no derivatives.

    """

    task: Task
    scene: Scene
    hamiltonian: Hamiltonian
    controller: Controller
    prediction: 'CommandPrediction'
    numbers: Sequence[str]
    left_out: Sequence[str]

    @property
    def limits(self) -> np.ndarray:
        """Return the maximum size of each command, shape (c,)."""
        return np.array([*self.task.inputs.values()])


class CommandPrediction:
    """
    Prediction of the state at which a command will act, under the commands sent before.

    Parameters
    ----------
    steps : BatchStep or None
        Single steps of the model; None without a delay.
    delay : float
        Time from a state until its command acts [s], rounded to steps.

    """

    def __init__(self, steps: BatchStep | None, delay: float):
        self._steps, self._count = steps, round(delay / steps.duration) if steps else 0
        self.delay = self._count * steps.duration if steps else 0.0
        # Times at which commands act, and the commands, newest last.
        self._sent: deque[tuple[float, np.ndarray]] = deque()

    def reset(self) -> None:
        """Discard pending commands."""
        self._sent.clear()

    def send(self, t: float, u: np.ndarray) -> None:
        """Queue the command, shape (c,), computed from the state at a time [s]."""
        self._sent.append((t + self.delay, u))

    def __call__(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v, shape (d,) each, at the time the command for a state at t [s] acts."""
        if self._steps is None or not self._count:
            return q, v
        z, h = np.concatenate([q, momentum(self._steps, q, v)]), self._steps.duration
        # A command acts from the step that starts nearest to its time.
        while len(self._sent) > 1 and self._sent[1][0] < t + 0.5 * h:
            self._sent.popleft()
        for begin in t + h * np.arange(self._count):
            acting = [u for since, u in self._sent if since < begin + 0.5 * h]
            z = self._steps(z, acting[-1] if acting else np.zeros(self._steps.commands), begin)
        q, p = np.split(z, 2)
        return q, velocity(self._steps, q, p)


def load_task(task: str | Path) -> tuple[Task, KeyPlaces, Path]:
    """
    Read and validate a task.

    Parameters
    ----------
    task : str or Path
        Name of a shipped task, or path of a YAML file.

    Returns
    -------
    tuple of (Task, KeyPlaces, Path)
        The task, the places of its keys, and the folder its paths are relative to.

    Raises
    ------
    DataError
        The task does not exist or is not valid; the message names file, line and key.

    """
    path = find_yaml('task', str(task), DataError)
    loaded, places = read_yaml(path, Task, DataError)
    return loaded, places, path.parent


def assign(task: str | Path, scene: str | Path | Scene = '', lockstep: bool = False) -> Assignment:
    """
    Return a task with its controller, which is compiled on its first call.

    Parameters
    ----------
    task : str or Path
        See ``load_task``.
    scene : str, Path or Scene, optional
        Model that replaces the task's; its coordinates must have the same names.
    lockstep : bool, optional
        True if the machine waits for commands: they act at once, and plans are limited by their
        number of iterations instead of time.

    Raises
    ------
    DataError
        The task does not fit the scene; the message names file, line and key.
    HnnViRosError
        The scene cannot be read or built, or has effects without differentiable steps.

    """
    loaded, places, folder = load_task(task)
    if lockstep:
        endless = {'budget': math.inf} if hasattr(loaded.controller, 'budget') else {}
        loaded = loaded.model_copy(update={
            'plan_time': 0.0, 'controller': loaded.controller.model_copy(update=endless)})
    if not isinstance(scene, Scene):
        beside = folder / loaded.scene
        try:
            scene = load_scene(scene or (beside if beside.is_file() else loaded.scene))
        except SceneError as problem:
            if scene:
                raise
            raise DataError(f'{places.place("scene")}: {problem}') from problem
    refusals = ValueError, SceneError, UnsupportedSystem
    with prefixed(places.place('stepping'), DataError, refusals):
        model, _ = choose(_scene_of_task(scene, loaded))
    with prefixed(places.place('inputs'), DataError, refusals):
        parts = model.parts()
        System(parts.hamiltonian, parts.effects, parts.integrator)
    h = model.known_step_size
    hold = round(loaded.period / h)
    with prefixed(places.place('period'), DataError, refusals):
        if hold < 1 or abs(hold * h - loaded.period) > _HOLD_TOLERANCE * loaded.period:
            raise ValueError(f"{loaded.period:g} s must be a multiple of the model's step size, "
                             f'{h:g} s; change it in stepping')
        if hold > _MAX_STEPS:
            raise ValueError(f'{hold} model steps of {h:g} s per command, at most {_MAX_STEPS}; '
                             'set a larger step size in stepping')
    with prefixed(places.place('controller'), DataError, refusals):
        controller = loaded.controller.make(ControlContext(loaded, model, hold))
    with prefixed(places.place('delay'), DataError, refusals):
        delay = loaded.plan_time + loaded.delay
        prediction = CommandPrediction(BatchStep(model) if delay else None, delay)
    own = next((effect.coordinates for effect in scene.effects
                if effect.kind == 'external_force'), None) or [*loaded.inputs]
    numbers = [*own, *(name for name in loaded.inputs if name not in own)]
    left_out = [effect.kind for effect in scene.effects if EFFECTS[effect.kind].stops]
    return Assignment(loaded, model, parts.hamiltonian, controller, prediction, numbers, left_out)


def _scene_of_task(scene: Scene, task: Task) -> Scene:
    """Return the scene without stops, with a task's inputs as commands, and its step size."""
    others = [effect.model_dump(by_alias=True) for effect in scene.effects
              if effect.kind != 'external_force' and not EFFECTS[effect.kind].stops]
    force = {'kind': 'external_force', 'coordinates': [*task.inputs], 'timeout': 1e6}
    scene = scene.changed({'effects': [*others, force]})
    return scene if task.stepping is None else scene.with_overrides(
        task.stepping.step_size, task.stepping.integrator)
