# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes: their YAML schema, and the construction of Hamiltonian, integrator and effects."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from keyword import iskeyword
import os
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from hnn_vi_ros.effects import Effect, EffectError, EFFECTS, gear_effects
from hnn_vi_ros.errors import (
    CalibrationError, listed, ModelError, offered, prefixed, SceneError, UnsupportedSystem)
from hnn_vi_ros.files import dump_yaml, find_yaml, KeyPlaces, read_yaml, StrictModel, validate
from hnn_vi_ros.hamiltonians import (
    COORDINATES, DESCRIBED, Hamiltonian, HAMILTONIANS, MECHANISMS, ROTATING, slopes_differ, trace)
from hnn_vi_ros.integrators import Integrator, INTEGRATORS, ON_FAILURE
from hnn_vi_ros.models import file_digest
from hnn_vi_ros.phase_space import columns, Coordinate
from hnn_vi_ros.scene.choices import (
    AutoChoice, call_factory, choices, EventChoice, InitialState, InvariantChoice, invariants_of,
    LearnedChoice, MeasurementsChoice, PythonChoice, UncertaintyChoice)
from hnn_vi_ros.scene.origin import Origin
import numpy as np
from pydantic import BeforeValidator, BaseModel, Field, PrivateAttr

# A part of a scene that is selected by its kind.
Choice = str | Mapping[str, Any] | BaseModel


def plain_data(value: Any) -> Any:
    """Convert nested mappings, sequences, arrays, paths and parts of scenes to plain data."""
    if isinstance(value, BaseModel):
        return plain_data(value.model_dump())
    if isinstance(value, Mapping):
        return {key: plain_data(part) for key, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, list | tuple | range):
        return [plain_data(part) for part in value]
    return value


_EXACT: dict[str, type] = {**HAMILTONIANS, **DESCRIBED}


class Scene(StrictModel):
    """Simulated scene: a Hamiltonian, effects, an integrator, a step size, an initial state."""

    description: str = Field('', max_length=1000, description='one line for lists and titles')
    hamiltonian: choices(  # type: ignore[valid-type]
        _EXACT, LearnedChoice, PythonChoice) = Field(description='H(q, p) [J]')
    effects: list[choices(EFFECTS)] = Field(  # type: ignore[valid-type]
        [], max_length=100, description=(
            'effects in addition to H(q, p); nothing else is simulated'))
    integrator: choices(INTEGRATORS, AutoChoice) = Field(  # type: ignore[valid-type]
        description='one-step map of (q, p)')
    step_size: float | None = Field(None, gt=0.0, le=1e6, description=(
        'h [s]; for the integrator auto, which chooses h, a time that h must divide'))
    initial_state: InitialState = Field(description='(q, p) at t = 0 s')
    duration: float = Field(10.0, gt=0.0, le=1e9, description=(
        'simulated time of `hnn run` and `simulate` without one [s]; nodes have a parameter'))
    on_failure: Literal[ON_FAILURE] = Field('substep', description=(  # type: ignore[valid-type]
        'remedy for a failed step: substep divides it; implicit takes it, and all steps beyond '
        'the stability limit of an explicit method, with implicit_midpoint; stop ends the run'))
    events: list[EventChoice] = Field([], max_length=100, description='events to detect')
    invariants: list[InvariantChoice] = Field([], max_length=20, description=(
        'quantities conserved in addition to H: published with the accuracy, and monitored'))
    uncertainty: UncertaintyChoice | None = Field(None, description=(
        'run all members of an ensemble beside their mean, and report their spread'))
    measurements: MeasurementsChoice | None = Field(None, description=(
        'sensors whose readings are published in place of exact values'))
    # YAML reads the word off as false.
    path_error: Annotated[Literal['measured', 'off'], BeforeValidator(
        lambda value: 'off' if value is False else value)] = Field('measured', description=(
        'measured: the run is taken again with other steps, and reports the error of its path; '
        'off: it is taken once'))
    path_tolerance: float | None = Field(None, gt=0.0, le=1e9, description=(
        'time until which a path error of 10 % of the amplitude is an alarm [s]; by default ten '
        'turns of the slowest coordinate that oscillates, one in chaos, or the whole run'))
    energy_by_cause: bool = Field(False, description=(
        'account for the energy by cause: the work, the stored energy and the heat of each effect '
        'and of its joints'))
    mechanism: Literal[tuple(MECHANISMS)] | None = Field(  # type: ignore[valid-type]
        None, description='mechanism to draw; without it only states are shown')

    def _check(self) -> None:
        if self.step_size is None and not isinstance(self.integrator, AutoChoice):
            raise ValueError('step_size: required: h [s]')

    _origin: Origin = PrivateAttr(default_factory=Origin)

    @classmethod
    def build(cls, *, hamiltonian: Choice | Callable[[Any, Any], Any], integrator: Choice,
              initial_state: Mapping[str, Any] | tuple[Any, Any],
              step_size: float | None = None, effects: Sequence[Choice] = (),
              events: Sequence[Mapping[str, Any]] = (),
              invariants: Sequence[Mapping[str, Any]] = (),
              uncertainty: Mapping[str, Any] | None = None, on_failure: str = 'substep',
              measurements: Mapping[str, Any] | None = None, mechanism: str | None = None,
              description: str = '', name: str = 'scene', duration: float = 10.0,
              energy_by_cause: bool = False, path_error: str = 'measured',
              path_tolerance: float | None = None) -> 'Scene':
        """
        Return a scene created without a file, validated as a YAML file is.

        Parameters
        ----------
        hamiltonian, integrator : str or mapping
            As in YAML, ``{'kind': 'pendulum', 'length': 2.0}``; or the name of a kind; or a part
            of another scene. A Hamiltonian may be a function; see ``simulate``.
        initial_state : tuple of (q, p), or mapping
            Coordinates and momenta, in the order and units of the Hamiltonian; a mapping with
            'q' and 'v' has velocities, for which p solves H_p(q, p) = v.
        step_size : float, optional
            Step size h [s]; required unless the integrator is auto.
        effects : sequence of str or mapping, optional
            Effects in addition to H, each as in YAML: ``{'kind': 'damping', 'rate': 0.1}``.
        events, invariants : sequence of mapping, optional
            Events to detect, and invariants of the motion in addition to H.
        uncertainty : mapping, optional
            Options of an ensemble: how the spread of its members is reported.
        on_failure : str, optional
            Reaction to a failed step: ``'substep'``, ``'implicit'`` or ``'stop'``.
        measurements : mapping, optional
            Sensors whose readings are published in place of exact values.
        mechanism : str, optional
            Drawing of the system.
        description : str, optional
            One line for titles.
        name : str, optional
            Name of the scene, used in the names of a run's files.
        duration : float, optional
            Simulated time of ``simulate`` without one [s].
        energy_by_cause : bool, optional
            Account for the energy by cause; see ``Trajectory.energy_by_cause``.
        path_error : str, optional
            ``'measured'`` or ``'off'``; see PathError.
        path_tolerance : float, optional
            Time until which a path error of 10 % is an alarm [s], by default ten turns.

        Raises
        ------
        SceneError
            A part does not fit the schema; the message names its key and the expected value.

        Examples
        --------
        >>> scene = Scene.build(hamiltonian='pendulum', integrator='gauss8', step_size=0.1,
        ...                     initial_state=([1.0], [0.0]), effects=[{'kind': 'damping',
        ...                                                             'rate': 0.1}])
        >>> scene.effects[0].rate
        0.1

        """
        state = dict(zip('qp', initial_state, strict=True)) if isinstance(
            initial_state, tuple | list) and len(initial_state) == 2 else initial_state
        if callable(hamiltonian):
            hamiltonian, state = _traced(hamiltonian, state, name)
        data = plain_data({
            'description': description, 'hamiltonian': hamiltonian, 'effects': effects,
            'integrator': integrator, 'step_size': step_size, 'initial_state': state,
            'on_failure': on_failure, 'events': events, 'invariants': invariants,
            'uncertainty': uncertainty, 'measurements': measurements, 'mechanism': mechanism,
            'duration': duration, 'energy_by_cause': energy_by_cause, 'path_error': path_error,
            'path_tolerance': path_tolerance})
        return _validated(data, f'Scene.build {name}')._placed_at(Origin(Path(name)))

    def _placed_at(self, origin: Origin) -> 'Scene':
        """Set the origin, and with it the momenta of given velocities; return the scene."""
        self._origin = origin
        if self.initial_state.v:
            self.create_hamiltonian()
        return self

    @property
    def source(self) -> Path:
        """Return the path of the scene's file."""
        return self._origin.path

    @property
    def name(self) -> str:
        """Return the name of the file without its suffix."""
        return self.source.stem

    def place(self, *key: str | int) -> str:
        """Return ``file:line: key`` for an error; the key of an effect is ``effects, 0``."""
        return self._origin.place(*key)

    def changed(self, changes: Mapping[str, Any]) -> 'Scene':
        """Return this scene with other values of some keys, or raise SceneError."""
        # Code named in the scene was approved when it was read.
        return _validated({**self.model_dump(exclude=set(changes)), **changes},
                          f'{self.name} with overrides')._placed_at(
            replace(self._origin, replaced=self._origin.replaced | changes.keys()))

    def to_yaml(self) -> str:
        """
        Return the scene as YAML, without keys that have their defaults.

        Examples
        --------
        >>> print(load_scene('exact_pendulum').to_yaml().splitlines()[-1])
        mechanism: pendulum

        """
        return dump_yaml(self.model_dump(exclude_defaults=True))

    def with_overrides(self, step_size: float | None = None, integrator: Choice | None = None,
                       initial_state: Mapping[str, Sequence[float]] | None = None,
                       effects: Sequence[Mapping[str, Any]] | None = None) -> 'Scene':
        """
        Return this scene with the given parts replaced.

        Raises
        ------
        SceneError
            The integrator is unknown, or a part does not fit the schema.

        """
        if integrator == 'auto':
            raise SceneError('integrator auto needs a tolerance: write it into the scene, as '
                             'integrator: {kind: auto, path_error: 1.0e-6, horizon: 100.0}')
        if isinstance(integrator, str) and integrator not in INTEGRATORS:
            raise SceneError(f'unknown integrator {integrator!r}'
                             f'{offered(str(integrator), sorted(INTEGRATORS))}')
        given = {'step_size': step_size, 'integrator': integrator,
                 'initial_state': initial_state, 'effects': effects}
        changes = {name: plain_data(value) for name, value in given.items() if value is not None}
        return self.changed(changes) if changes else self

    @property
    def known_step_size(self) -> float:
        """Return the step size [s]; raise SceneError if `auto` has not chosen it yet."""
        if self.step_size is None:
            raise SceneError(f'{self.place("integrator")}: auto has not chosen a step size yet; '
                             'simulation.resolve(scene) chooses one')
        return self.step_size

    def parts(self) -> 'Parts':
        """
        Create the Hamiltonian, the integrator and the effects.

        Raises
        ------
        ModelError, SceneError
            See ``create_hamiltonian``, ``create_integrator`` and ``create_effects``.

        """
        return Parts(self, self.create_hamiltonian(), self.create_integrator(),
                     self.create_effects())

    def create_integrator(self) -> Integrator:
        """
        Create the integrator.

        Raises
        ------
        SceneError
            A parameter is out of range, or the integrator is still auto.

        """
        if isinstance(self.integrator, AutoChoice):
            raise SceneError(f'{self.place("integrator")}: auto has not chosen a method yet; '
                             'simulation.resolve(scene) chooses one')
        return self._construct(INTEGRATORS, self.integrator, 'integrator')

    def create_effects(self) -> list[Effect]:
        """
        Create the effects in order, followed by a robot's drives.

        Raises
        ------
        ModelError
            A model does not exist or is damaged.
        SceneError
            A parameter is out of range.

        """
        drives = getattr(self.hamiltonian, 'drives', None)
        return [*(self._construct(EFFECTS, choice, 'effects', i)
                  for i, choice in enumerate(self.effects)),
                *(gear_effects(drives) if drives else ())]

    def create_hamiltonian(self) -> Hamiltonian:
        """
        Create or load the Hamiltonian.

        Raises
        ------
        ModelError
            The model does not exist or is damaged.
        SceneError
            A parameter is out of range, or the user's code cannot be called.

        """
        choice = self.hamiltonian
        if isinstance(choice, LearnedChoice):
            file = self._origin.model_file(choice.model, 'hamiltonian')
            # Imported lazily: reading a scene needs no compiled networks.
            from hnn_vi_ros.models import load_learned
            with self.placed('hamiltonian'):
                hamiltonian = load_learned(file, choice.confine, choice.member)
        elif isinstance(choice, PythonChoice):
            hamiltonian = call_factory(choice.factory, self.place('hamiltonian', 'factory'),
                                       self._origin.code_folder)
        else:
            hamiltonian = self._construct(_EXACT, choice, 'hamiltonian')
        self._check_dimension(hamiltonian.coordinates)
        if self.initial_state.v:
            with self.placed('initial_state'):
                self.initial_state.find_momenta(hamiltonian, self.create_effects())
        state = np.array(self.initial_state.q), np.array(self.initial_state.p)
        with self.placed('hamiltonian'):
            hamiltonian.check_state(*state)
            if isinstance(choice, PythonChoice) and slopes_differ(hamiltonian, *state):
                raise ValueError('the gradient differs from differences of the energy; mend the '
                                 'kernel of the Hamiltonian that the factory returns')
        hamiltonian.invariants = invariants_of(
            self.invariants, hamiltonian, not self.effects, state, self.place,
            self._origin.code_folder)
        return hamiltonian

    def model_files(self) -> dict[str, Path]:
        """
        Return the files of the scene's models and robots.

        Raises
        ------
        ModelError
            A file does not exist.

        """
        placed = [(self.hamiltonian, 'hamiltonian'), (self.integrator, 'integrator'), *(
            (choice, 'effects', i) for i, choice in enumerate(self.effects))]
        finders = {'model': self._origin.model_file, 'file': self._origin.robot_file}
        return {name: find(name, *key) for choice, *key in placed
                for field, find in finders.items() if (name := getattr(choice, field, None))}

    @cached_property
    def model_digests(self) -> dict[str, str]:
        """Return the SHA-256 of each model file; for a file changed later, the earlier value."""
        return {name: file_digest(file) for name, file in self.model_files().items()}

    def _check_dimension(self, coordinates: Sequence[Coordinate]) -> None:
        names, momenta = columns(coordinates)
        for key, values in self.initial_state.model_dump().items():
            own = names if key == 'q' else momenta
            if len(values) != len(own):
                raise SceneError(
                    f'{self.place("initial_state", key)}: {len(values)} values, expected '
                    f'{len(own)}, one for each coordinate: {listed(own)}')
        if self.mechanism and (self.mechanism in ROTATING) != (len(names) != len(momenta)):
            raise SceneError(
                f'{self.place("mechanism")}: {self.mechanism} draws '
                f'{"a body that turns" if self.mechanism in ROTATING else "scalar coordinates"}, '
                f'but H has {listed(c.name for c in coordinates)}; remove it or choose another')
        if self.mechanism and len(names) not in COORDINATES[self.mechanism]:
            numbers = [str(number) for number in COORDINATES[self.mechanism]]
            if len(numbers) > 3:
                numbers[2:-1] = ['...']
            raise SceneError(
                f'{self.place("mechanism")}: {self.mechanism} draws {", ".join(numbers)} '
                f'coordinates, but H has {len(names)}; remove it or choose another')

    def _construct(self, classes: Mapping[str, type], choice: BaseModel, *key: str | int) -> Any:
        arguments = choice.model_dump()
        kind = arguments.pop('kind')
        self._origin.find_code(arguments)
        if arguments.get('model'):
            arguments['model'] = self._origin.model_file(arguments['model'], *key)
        if arguments.get('file'):
            arguments['file'] = self._origin.robot_file(arguments['file'], *key)
        with self.placed(*key):
            return classes[kind](**{
                f'{name}_' if iskeyword(name) else name: value
                for name, value in arguments.items()})

    @contextmanager
    def placed(self, *key: str | int) -> Iterator[None]:
        """
        Add the place of the cause in the scene's file to errors raised inside.

        Parameters
        ----------
        *key : str or int
            Key of the object created inside; ``'initial_state'`` for the simulation of the scene.

        Raises
        ------
        CalibrationError, ModelError, SceneError, UnsupportedSystem
            Raised in place of the original error.

        """
        try:
            yield
        except (ValueError, OverflowError) as problem:
            if isinstance(problem, EffectError):
                # Drives and loops follow the effects of the scene.
                key = ('effects', problem.index) if problem.index < len(self.effects) else (
                    'hamiltonian',)
            raise SceneError(self._blame(key, str(problem))) from problem
        except (CalibrationError, ModelError) as problem:
            raise type(problem)(self._blame(key, str(problem))) from problem
        except UnsupportedSystem as problem:
            raise UnsupportedSystem(f'{self.place("integrator")}: {problem}') from problem

    def _blame(self, key: tuple[str | int, ...], message: str) -> str:
        value: Any = self
        for part in key:
            value = value[part] if isinstance(part, int) else getattr(value, part)
        # The message starts with the invalid key if there is only one.
        name = message.partition(' ')[0]
        own = name in type(value).model_fields
        kind = f'{value.kind}: ' if hasattr(value, 'kind') else ''
        return f'{self.place(*key, *[name] * own)}: {kind}{message}'


class Parts(NamedTuple):
    """
    Scene with all its objects, created once and passed to simulations.

    Simulations can share an integrator and effects, since per-step state is in the simulation. The
    kernel of H has working memory, so simulations in several threads, or with changing parameter
    values, need a copy of H.
    """

    scene: Scene
    hamiltonian: Hamiltonian
    integrator: Integrator
    effects: list[Effect]

    def copy(self) -> 'Parts':
        """Return the parts with a copy of H."""
        return self._replace(hamiltonian=self.hamiltonian.copy())


def _traced(function: Callable[[Any, Any], Any], state: Any, name: str) -> tuple[Any, Any]:
    """Return the formula of H, and the state at which it starts with lists of numbers."""
    if not isinstance(state, Mapping) or state.keys() not in ({'q', 'p'}, {'q', 'v'}):
        raise SceneError(f'Scene.build {name}: initial_state: a function H needs q and p, or v')
    q = np.asarray(state['q'])
    with prefixed(f'Scene.build {name}', SceneError):
        names, text = trace(function, q)
    return ({'kind': 'formula', 'coordinates': names, 'H': text},
            {half: np.atleast_1d(own) for half, own in state.items()})


def _validated(data: dict[str, Any], where: str) -> Scene:
    """Return the scene of plain data trusted by the user, or raise SceneError."""
    return validate(data, partial(KeyPlaces.of_data, data, where), Scene, SceneError,
                    trust_code=True)


def load_scene(scene: str | Path, trust_code: bool = True) -> Scene:
    """
    Read and validate a scene.

    Parameters
    ----------
    scene : str or Path
        Name of a shipped scene, or path of a YAML file.
    trust_code : bool, optional
        False to reject a scene that names Python code, for example if others name the file.

    Returns
    -------
    Scene
        Validated scene; its model is loaded when a simulation is created.

    Raises
    ------
    SceneError
        The scene does not exist or is not valid; the message names file, line and key.

    Examples
    --------
    >>> load_scene('pendulum').integrator.kind
    'variational_euler'

    """
    path = find_yaml('scene', str(scene), SceneError)
    loaded, places = read_yaml(path, Scene, SceneError, trust_code)
    # A module next to the scene is found like an installed one.
    return loaded._placed_at(Origin(path, places, code_folder=str(path.resolve().parent)))
