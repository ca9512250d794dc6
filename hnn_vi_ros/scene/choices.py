# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The YAML of classes that a scene names by kind: the schema is the constructor's signature."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from inspect import cleandoc, Parameter, signature
from typing import Annotated, Any, Literal, Union

from hnn_vi_ros.errors import HnnViRosError, SceneError
from hnn_vi_ros.files.named_code import find_beside, import_named, NAMES_CODE
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.scene.conditions import Condition
from pydantic import BaseModel, create_model, Field, field_validator, model_validator


class InitialState(StrictModel):
    """The state at t = 0."""

    q: list[float] = Field(min_length=1, max_length=10_000, description=(
        "coordinates, in the Hamiltonian's order and units"))
    p: list[float] = Field(min_length=1, max_length=10_000, description=(
        "conjugate momenta, in the Hamiltonian's order and units"))


class LearnedChoice(StrictModel):
    """The Hamiltonian of a trained model of any family."""

    kind: Literal['hnn', 'learned'] = Field(description=(
        'that of a trained model, a Hamiltonian neural network or one of another family'))
    model: str = Field(min_length=1, max_length=4096, description=(
        'a shipped model, one trained into models/ of the working directory, or the path of a '
        '.safetensors file'))
    confine: bool | None = Field(None, description=(
        'whether H continues as a smooth convex wall outside of the box that the model was '
        'trained in, where a network holds no state; default: as the model card says'))
    member: int | None = Field(None, ge=1, description=(
        'of an ensemble, that member alone, from 1 on; default: the mean of all'))


class UncertaintyChoice(StrictModel):
    """Options on how far the members of an ensemble come apart."""

    limit: float = Field(0.1, gt=0.0, description=(
        'spread of a coordinate or momentum, in half-widths of its training interval, beyond '
        'which an alarm is raised [1]'))


class PythonChoice(StrictModel):
    """A Hamiltonian that a Python function of the user's returns."""

    kind: Literal['python'] = Field(description='what a Python function of yours returns')
    factory: Annotated[str, NAMES_CODE] = Field(pattern=r'^[\w.]+:\w+$', description=(
        'package.module:function; called without arguments, returns a Hamiltonian'))


class EventChoice(StrictModel):
    """An instant that is watched for."""

    when: str = Field(max_length=200, description=(
        'an equation that comes true at the event, of coordinates c, momenta p_c, velocities v_c, '
        'H, pi and numbers, with + - * / ** ( ) abs cos sin sqrt: angle1 = 0'))
    direction: Literal['up', 'down', 'both'] = Field('both', description=(
        'which changes of its left less its right side count'))
    then: Literal['log', 'stop'] = Field('log', description=(
        'log: it is published, recorded and shown; stop: and the run ends there'))

    @field_validator('when')
    @classmethod
    def _check_when(cls, text: str) -> str:
        Condition(text)
        return text


class AutoChoice(StrictModel):
    """The cheapest method and step size that hold a tolerance, found by trying them."""

    kind: Literal['auto'] = Field(
        description='the cheapest method and step size that hold a tolerance; give one error')
    energy_error: float | None = Field(None, gt=0.0, description=(
        'largest abs(H - H0 - W) over the energies in play: the mean of abs(p . H_p) along the '
        'path, which no constant in H changes [1]'))
    path_error: float | None = Field(None, gt=0.0, description=(
        'largest deviation of a coordinate or momentum from the exact path, in its own unit; '
        'looked at after every step, or at some hundred instants'))
    horizon: float = Field(gt=0.0, le=1e9, description='until when the error must be held [s]')

    @model_validator(mode='after')
    def _check_errors(self) -> 'AutoChoice':
        if (self.energy_error is None) == (self.path_error is None):
            raise ValueError('give either energy_error or path_error')
        return self


def choices(classes: Mapping[str, type], *more: type[BaseModel]) -> Any:
    """
    Return a union of one schema for each class, told apart by ``kind``.

    Parameters
    ----------
    classes : mapping of str to type
        The kinds. A constructor's arguments are the keys, what the numpydoc of the class says of
        each is its description.
    *more : type of BaseModel
        Schemas that have no such class.

    """
    schemas = [*more, *(_schema(kind, cls) for kind, cls in classes.items())]
    if len(schemas) == 1:
        return schemas[0]
    # Made of a list: `|` joins types that are named.
    return Annotated[Union[tuple(schemas)], Field(discriminator='kind')]  # noqa: UP007


def _schema(kind: str, cls: type) -> type[BaseModel]:
    texts = parameter_texts(cls)
    fields: dict[str, Any] = {'kind': (Literal[kind], Field(description=summary(cls)))}
    for parameter in signature(cls).parameters.values():
        if parameter.kind is Parameter.POSITIONAL_OR_KEYWORD:
            default = ... if parameter.default is Parameter.empty else parameter.default
            # A key that is a keyword of Python, such as from, is from_ there.
            fields[parameter.name.removesuffix('_')] = (parameter.annotation, Field(
                default, description=texts.get(parameter.name)))
    made = create_model(cls.__name__, __base__=StrictModel, __doc__=summary(cls), **fields)
    # Where pickle looks for a class, by its module and its name.
    return globals().setdefault(made.__name__, made)


def summary(cls: type) -> str:
    """Return the first line of the docstring of a class."""
    return cleandoc(cls.__doc__ or '').partition('\n')[0]


def parameter_texts(cls: type) -> dict[str, str]:
    """Return what the numpydoc of a class and of its bases says of each parameter, on one line."""
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
    Return the Hamiltonian that a user's function makes.

    Parameters
    ----------
    factory : str
        ``package.module:function``.
    place : str
        Where the scene names it, for errors.
    folder : str or None
        Where a module is found that is not installed, if anywhere.

    Raises
    ------
    HnnViRosError
        It cannot be imported, fails, or returns something else.

    """
    with _blamed(factory, place, folder):
        hamiltonian = import_named(factory)()
    if not isinstance(hamiltonian, Hamiltonian):
        raise SceneError(f'{place}: {factory} returned a {type(hamiltonian).__name__}, expected a '
                         'Hamiltonian')
    return hamiltonian


def load_code(name: str, place: str, folder: str | None) -> Any:
    """Return what ``package.module:function`` names, or raise as ``call_factory``."""
    with _blamed(name, place, folder):
        return import_named(name)


@contextmanager
def _blamed(name: str, place: str, folder: str | None) -> Iterator[None]:
    """Say of errors in the user's code where the scene names it."""
    find_beside(folder)
    try:
        yield
    except HnnViRosError:
        raise
    except ModuleNotFoundError as problem:
        remedy = '' if folder else '; put the folder that holds it on PYTHONPATH'
        raise SceneError(f'{place}: {name}: {problem}{remedy}') from problem
    except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
        raise SceneError(f'{place}: {name}: {type(problem).__name__}: '
                         f'{" ".join(str(problem).split())}') from problem
