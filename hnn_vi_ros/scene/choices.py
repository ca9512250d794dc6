# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of a scene in YAML: classes by kind, initial state, conditions, invariants."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from inspect import cleandoc, Parameter, signature
import math
from typing import Annotated, Any, Literal, Union

from hnn_vi_ros.effects import Effect, EFFECTS, Joined
from hnn_vi_ros.errors import did_you_mean, HnnViRosError, listed, prefixed, SceneError
from hnn_vi_ros.files import find_beside, import_named, NAMES_CODE, StrictModel
from hnn_vi_ros.hamiltonians import (
    Code, DESCRIBED, GRAMMAR, Graph, Hamiltonian, HAMILTONIANS, momentum, Reader)
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.phase_space import columns
import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    BaseModel, BeforeValidator, ConfigDict, create_model, Field, field_validator,
    model_serializer, SerializerFunctionWrapHandler, StringConstraints)


class InvariantChoice(StrictModel):
    """A quantity that is conserved in addition to H."""

    name: str = Field(pattern=r'^[^\W\d]\w*$', max_length=100, description=(
        'name; without a function, that of a known invariant of the system'))
    function: Annotated[str, NAMES_CODE, StringConstraints(
        pattern=r'^[\w.]+:\w+$')] | None = Field(None, description=(
            'package.module:function of q and p, arrays of d numbers each, that returns a number'))


class Invariant:
    """
    A user's function of the state; it gets copies of the arrays.

    Parameters
    ----------
    function : callable
        Function of q and p, each of shape (d,).
    where : str
        Place in the scene, for error messages.

    """

    def __init__(self, function: Callable[[np.ndarray, np.ndarray], float], where: str):
        self._function, self._where = function, where

    def __call__(self, q: np.ndarray, p: np.ndarray) -> float:
        """Return the value, NaN for arithmetic errors; raise SceneError if it is not a number."""
        try:
            value = self._function(q.copy(), p.copy())
            # A power of a negative number is complex.
            return math.nan if isinstance(value, complex) else float(value)
        except (ArithmeticError, ValueError):
            # For example from math.sqrt and math.acos.
            return math.nan
        except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
            raise SceneError(f'{self._where}: {type(problem).__name__}: '
                             f'{" ".join(str(problem).split())}, at q = {q.tolist()}, '
                             f'p = {p.tolist()}') from problem


def invariants_of(choices: Sequence[InvariantChoice], hamiltonian: Hamiltonian, alone: bool,
                  state: tuple[np.ndarray, np.ndarray], place: Callable[..., str],
                  folder: str | None) -> dict[str, Callable[[np.ndarray, np.ndarray], float]]:
    """
    Return the invariants of a scene by name, each a function of q and p of shape (d,).

    Parameters
    ----------
    choices : sequence of InvariantChoice
        The scene's invariants.
    hamiltonian : Hamiltonian
        H, whose known invariants are included if no effect acts.
    alone : bool
        True if no effect acts on the system.
    state : tuple of np.ndarray, shape (d,)
        Initial q and p, at which each function is tested.
    place : callable
        Function that returns the place of a key in the scene, for error messages.
    folder : str or None
        Folder for modules that are not installed, None for none.

    Raises
    ------
    SceneError
        A name is repeated or unknown, or a function cannot be imported or called.

    """
    known = hamiltonian.known_invariants
    found = dict(known) if alone else {}
    for index, choice in enumerate(choices):
        where = place('invariants', index)
        if choice.name in [other.name for other in choices[:index]]:
            raise SceneError(f'{where}: {choice.name} occurs twice; rename one')
        if choice.function is not None:
            where = f'{where}: {choice.function}'
            found[choice.name] = own = Invariant(
                load_code(choice.function, place('invariants', index), folder), where)
            if not math.isfinite(value := own(*state)):
                raise SceneError(f'{where}: is {value} at the initial state; return a finite '
                                 'number')
        elif choice.name in known:
            found[choice.name] = known[choice.name]
        else:
            raise SceneError(f'{where}: unknown invariant {choice.name!r} of this system; known: '
                             f'{listed(known) or "none"}; or give a function')
    return found


_MAX_CONDITION = 200
_VALID_CONDITION = ('an equation of the coordinates c, their momenta p_c and velocities v_c, and '
                    f'H, with {GRAMMAR}')


class Condition:
    """
    An equation between numbers and quantities of a system, such as ``angle1 - angle2 = pi / 2``.

    Quantities are the coordinates c, their momenta ``p_c``, their velocities ``v_c`` (dH/dp), and
    the energy ``H``.

    Parameters
    ----------
    text : str
        The equation, at most 200 characters.

    Raises
    ------
    ValueError
        The text is not an equation, or too long; the message describes a valid one.

    """

    def __init__(self, text: str):
        self.text = text
        sides = text.split('=')
        if len(text) > _MAX_CONDITION or len(sides) != 2:
            raise ValueError(f'{text[:_MAX_CONDITION]!r} is not an equation of at most '
                             f'{_MAX_CONDITION} characters: expected {_VALID_CONDITION}')
        self._graph = Graph()
        with prefixed(repr(text), ValueError):
            left, right = (Reader(self._graph, side, start) for side, start in zip(
                sides, (1, len(sides[0]) + 2), strict=True))
        self._names = left.names.keys() | right.names.keys()
        if not self._names:
            raise ValueError(f'{self.text!r} does not depend on the state: expected '
                             f'{_VALID_CONDITION}')
        self._difference = self._graph.plus(left.root, self._graph.scaled(-1.0, right.root))

    def check(self, hamiltonian: Hamiltonian) -> None:
        """Raise ValueError, with the valid names, for a quantity the system does not have."""
        names, momenta = columns(hamiltonian.coordinates)
        valid = [*names, *(f'{kind}_{name}' for kind in 'pv' for name in momenta), 'H']
        unknown = sorted(self._names - set(valid))
        if unknown:
            raise ValueError(f'{self.text!r}: unknown quantity '
                             f'{unknown[0]!r}{did_you_mean(unknown[0], valid)}; valid: '
                             f'{listed(valid)}')

    def function(self, hamiltonian: Hamiltonian) -> Callable[..., float]:
        """Return left minus right side as a function of (), q, p, v and H, to be compiled."""
        names, momenta = columns(hamiltonian.coordinates)
        inputs = {'H': 'H'} | {f'{kind}_{name}': f'{kind}[{i}]'
                               for kind in 'vp' for i, name in enumerate(momenta)}
        inputs |= {name: f'q[{i}]' for i, name in enumerate(names)}
        return Code(self._graph, [], inputs).function(
            'condition', 'q, p, v, H', [], [self._difference])

    def values(self, hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray, t: ArrayLike
               ) -> np.ndarray:
        """
        Return the left side minus the right side, of shape (...).

        Parameters
        ----------
        hamiltonian : Hamiltonian
            Hamiltonian of the system.
        q, p : np.ndarray, shape (..., d)
            States.
        t : array_like, shape (...)
            Times [s].

        """
        values: dict[str, np.ndarray] = {}
        names, momenta = columns(hamiltonian.coordinates)
        if 'H' in self._names:
            values['H'] = hamiltonian.energy(q, p, t)
        if any(f'v_{name}' in self._names for name in momenta):
            _, velocity = hamiltonian.gradient(q, p, t)
            values |= {f'v_{name}': velocity[..., i] for i, name in enumerate(momenta)}
        for i, name in enumerate(momenta):
            values[f'p_{name}'] = p[..., i]
        # Added last, since a coordinate may have the name of another's momentum.
        values |= {name: q[..., i] for i, name in enumerate(names)}
        difference = self._graph.values([self._difference], values)[self._difference]
        shape = np.shape(q)[:-1]
        return np.asarray(difference) if np.shape(difference) == shape \
            else np.broadcast_to(difference, shape)


class InitialState(StrictModel):
    """The state at t = 0; `p` of a state given by its velocities is found with H."""

    # Not a nullable list: `p` holds numbers in every scene that was read.
    model_config = ConfigDict(json_schema_extra={
        'oneOf': [{'required': ['p']}, {'required': ['v']}]})

    q: list[float] = Field(min_length=1, max_length=10_000, description=(
        "coordinates, in the Hamiltonian's order and units"))
    p: list[float] = Field(default_factory=list, min_length=1, max_length=10_000, description=(
        "conjugate momenta, in the Hamiltonian's order and units"))
    v: list[float] = Field(default_factory=list, min_length=1, max_length=10_000, description=(
        "velocities q' in place of p, which solves H_p(q, p) = v; of a rotation the angular "
        'velocity in the body frame [rad/s]'))

    def _check(self) -> None:
        if bool(self.p) == bool(self.v):
            raise ValueError('expected q and either momenta p or velocities v')

    @model_serializer(mode='wrap')
    def _given(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return q, and of p and v the one that was given."""
        return {key: own for key, own in dump(self).items() if key != ('p' if self.v else 'v')}

    def find_momenta(self, hamiltonian: Hamiltonian, effects: Sequence[Effect]) -> None:
        """Set p to the momenta of the velocities, or raise ValueError."""
        for effect in effects:
            if isinstance(effect, Joined) and not effect.keeps_separable:
                raise ValueError(f'v does not determine p with {type(effect).__name__}; give p')
        q, v = np.array(self.q), np.array(self.v)
        # The class is frozen for its users.
        object.__setattr__(self, 'p', momentum(hamiltonian, q, v, np.zeros_like(v)).tolist())


class LearnedChoice(StrictModel):
    """The Hamiltonian of a trained model of any family."""

    kind: Literal['hnn', 'learned'] = Field(description=(
        'Hamiltonian of a trained model: a Hamiltonian neural network or a model of another '
        'family'))
    model: str = Field(min_length=1, max_length=4096, description=(
        'name of a shipped model or of a model in models/ of the working directory, or path of a '
        '.safetensors file'))
    confine: bool | None = Field(None, description=(
        'continue H as a smooth convex wall outside the training domain, where a network does '
        'not confine the state; default: given by the model card'))
    member: int | None = Field(None, ge=1, description=(
        'use one member of an ensemble, from 1; default: the mean of all members'))


class UncertaintyChoice(StrictModel):
    """Options of the spread of an ensemble's members."""

    limit: float = Field(0.1, gt=0.0, description=(
        'spread of a coordinate or momentum, in half-widths of its training interval, beyond '
        'which an alarm is raised [1]'))


# Limits of errors and resolutions, beyond which readings are not numbers or need no rounding.
_LARGEST, _FINEST = 1e9, 1e-15
_Size = Annotated[float, Field(ge=0.0, le=_LARGEST)]
_Bias = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
# One number for all joints, or one for each.
_OfJoints = _Size | list[_Size]


class JointSensorChoice(StrictModel):
    """Sensor of the joints: what it makes of the simulated positions, velocities and efforts."""

    noise: _OfJoints = Field(0.0, description=(
        'standard deviation of a position, of all joints or as a list [rad] or [m]'))
    bias: _Bias | list[_Bias] = Field(0.0, description='constant error of a position [rad] or [m]')
    quantisation: _OfJoints = Field(0.0, description=(
        'resolution of an encoder: positions are rounded to its multiples [rad] or [m]'))
    velocity: Literal['sensor', 'encoder', 'none'] = Field('sensor', description=(
        'sensor: measured, with its own noise; encoder: difference of the last two measured '
        'positions by their time; none: messages have no velocities'))
    velocity_noise: _OfJoints = Field(0.0, description=(
        'standard deviation of a velocity of a sensor [rad/s] or [m/s]'))
    effort_noise: _OfJoints = Field(0.0, description=(
        'standard deviation of an effort [N] or [N m]'))
    delay: float = Field(0.0, ge=0.0, le=100.0, description=(
        'age of what a message holds, at its stamp [s]'))
    rate: float | None = Field(None, gt=0.0, description=(
        'readings per second, publish_rate divided by a whole number; default: publish_rate [Hz]'))
    dropout: float = Field(0.0, ge=0.0, lt=1.0, description=(
        'probability that a reading is lost [1]'))
    seed: int = Field(0, ge=0, lt=2**63, description='seed of the random numbers')

    def check(self, joints: int) -> None:
        """Raise ValueError unless lists have one entry for each joint, and encoders a step."""
        if ((0.0 < np.array(self.quantisation)) & (np.array(self.quantisation) < _FINEST)).any():
            raise ValueError(f'quantisation = {self.quantisation}: expected 0, or at least '
                             f'{_FINEST:g}')
        for name, value in self:
            if isinstance(value, list) and len(value) != joints:
                raise ValueError(f'{name} has {len(value)} values, expected 1, or one for each of '
                                 f'the {joints} joints')


class MeasurementsChoice(StrictModel):
    """Sensors that replace exact values on topics of the simulator."""

    joint_states: JointSensorChoice = Field(description=(
        'sensor of joint_states; the true state stays on ~/state'))


class PythonChoice(StrictModel):
    """A Hamiltonian returned by a user's Python function."""

    kind: Literal['python'] = Field(description='Hamiltonian returned by a Python function')
    factory: Annotated[str, NAMES_CODE] = Field(pattern=r'^[\w.]+:\w+$', description=(
        'package.module:function without arguments that returns a Hamiltonian'))


class EventChoice(StrictModel):
    """A condition whose instants are detected."""

    when: str = Field(max_length=200, description=(
        'equation that holds at the event, with coordinates c, momenta p_c, velocities v_c, H, '
        'pi, numbers, + - * / ^ ( ) and functions such as sin and sqrt: angle1 = 0'))
    direction: Literal['up', 'down', 'both'] = Field('both', description=(
        'direction in which the left side minus the right side crosses zero'))
    then: Literal['log', 'stop'] = Field('log', description=(
        'log: publish, record and show the event; stop: also end the run there'))

    @field_validator('when')
    @classmethod
    def _check_when(cls, text: str) -> str:
        Condition(text)
        return text


class AutoChoice(StrictModel):
    """The cheapest method and step size within a tolerance, determined by trials."""

    kind: Literal['auto'] = Field(
        description='cheapest method and step size within a tolerance; give one of the two errors')
    energy_error: float | None = Field(None, gt=0.0, description=(
        'largest abs(H - H0 - W) relative to the energy scale, the mean of abs(p . H_p) along the '
        'path, which is independent of constants in H [1]'))
    path_error: float | None = Field(None, gt=0.0, description=(
        'largest deviation of a coordinate or momentum from the exact path, in its own unit; '
        'checked after every step, or at some hundred times'))
    horizon: float = Field(gt=0.0, le=1e9, description='time until which the error is limited [s]')

    def _check(self) -> None:
        if (self.energy_error is None) == (self.path_error is None):
            raise ValueError('give either energy_error or path_error')


class PartChoice(StrictModel):
    """Base of the schemas of classes: the kind, and the arguments of the constructor."""

    kind: str

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the kind, since no module contains the schema, which is created."""
        return _unset, (self.kind,), self.__getstate__()


# No two registries contain the same kind.
_CLASSES: dict[str, type] = {**EFFECTS, **HAMILTONIANS, **DESCRIBED, **INTEGRATORS}


def _unset(kind: str) -> PartChoice:
    """Return an instance for pickle, which sets its state."""
    schema = schema_of(kind, _CLASSES[kind])
    return schema.__new__(schema)


def choices(classes: Mapping[str, type], *more: type[BaseModel]) -> Any:
    """
    Return a discriminated union of one schema per class, selected by ``kind`` or given by it.

    Parameters
    ----------
    classes : mapping of str to type
        Classes by kind. The arguments of a constructor become keys, and their descriptions come
        from the numpydoc of the class.
    *more : type of BaseModel
        Further schemas without such classes.

    """
    schemas = [*more, *(schema_of(kind, cls) for kind, cls in classes.items())]
    # Union of a list, since `|` needs the types one by one.
    chosen: Any = Annotated[Union[tuple(schemas)], Field(discriminator='kind')]  # noqa: UP007
    return Annotated[chosen, BeforeValidator(of_kind, Literal[tuple(classes)] | chosen)]


def of_kind(choice: Any) -> Any:
    """Return the mapping for a kind given only by its name."""
    return {'kind': choice} if isinstance(choice, str) else choice


@cache
def schema_of(kind: str, cls: type) -> type[PartChoice]:
    """Return the schema of a class: a key for each argument, with the description of numpydoc."""
    texts = parameter_texts(cls)
    fields: dict[str, Any] = {'kind': (Literal[kind], Field(description=summary(cls)))}
    for parameter in signature(cls).parameters.values():
        if parameter.kind is Parameter.POSITIONAL_OR_KEYWORD:
            default = ... if parameter.default is Parameter.empty else parameter.default
            # A key that is a keyword of Python, such as from, has the argument from_.
            fields[parameter.name.removesuffix('_')] = (parameter.annotation, Field(
                default, description=texts.get(parameter.name)))
    return create_model(cls.__name__, __base__=PartChoice, __doc__=summary(cls), **fields)


def summary(cls: type) -> str:
    """Return the first line of the docstring of a class."""
    return cleandoc(cls.__doc__ or '').partition('\n')[0]


def parameter_texts(cls: type) -> dict[str, str]:
    """Return the numpydoc description of each parameter, including base classes, on one line."""
    texts: dict[str, str] = {}
    for owner in reversed(cls.__mro__):
        texts |= _parameters(owner.__dict__.get('__doc__') or '')
    return texts


def _parameters(docstring: str) -> dict[str, str]:
    section = cleandoc(docstring).partition('\nParameters\n----------\n')[2]
    texts: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        if line.startswith(' '):
            texts |= {name: f'{texts[name]} {line.strip()}'.strip() for name in names}
        elif ' : ' in line:
            names = line.partition(' : ')[0].split(', ')
            texts |= dict.fromkeys(names, '')
        elif line:
            break  # the next section
    return {name: text.replace('``', '') for name, text in texts.items()}


def call_factory(factory: str, place: str, folder: str | None) -> Hamiltonian:
    """
    Return the Hamiltonian created by a user's function.

    Parameters
    ----------
    factory : str
        ``package.module:function``.
    place : str
        Place in the scene, for error messages.
    folder : str or None
        Folder for modules that are not installed, None for none.

    Raises
    ------
    HnnViRosError
        The function cannot be imported, fails, or returns something else.

    """
    with _blamed(factory, place, folder):
        hamiltonian = import_named(factory)()
    if not isinstance(hamiltonian, Hamiltonian):
        raise SceneError(f'{place}: {factory} returned a {type(hamiltonian).__name__}, expected a '
                         'Hamiltonian')
    return hamiltonian


def load_code(name: str, place: str, folder: str | None) -> Any:
    """Return the object ``package.module:function``; raise as in ``call_factory``."""
    with _blamed(name, place, folder):
        return import_named(name)


@contextmanager
def _blamed(name: str, place: str, folder: str | None) -> Iterator[None]:
    """Add the place in the scene to errors of the user's code."""
    find_beside(folder)
    try:
        yield
    except HnnViRosError:
        raise
    except ModuleNotFoundError as problem:
        remedy = '' if folder else '; add its folder to PYTHONPATH'
        raise SceneError(f'{place}: {name}: {problem}{remedy}') from problem
    except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
        raise SceneError(f'{place}: {name}: {type(problem).__name__}: '
                         f'{" ".join(str(problem).split())}') from problem
