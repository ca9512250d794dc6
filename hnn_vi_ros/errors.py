# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Errors reported to users; each message is one line: place, problem, remedy."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches, SequenceMatcher
from math import isnan
import re
import sys
from typing import Any, ClassVar, TYPE_CHECKING

if TYPE_CHECKING:
    from hnn_vi_ros.phase_space import Event
    import numpy as np

# Maximum number of names in a list; below, of characters of a message, and of its kept end.
_MAX_LISTED = 20
# Maximum number of letters to list all names; otherwise number of similar names listed.
_MAX_LETTERS, _MAX_SIMILAR = 200, 8
_MAX_MESSAGE, _MESSAGE_TAIL = 2000, 400
# Control characters of terminals (C0, DEL and C1), which can make them write files or hide output;
# and characters that are invisible, end lines, or change the reading direction.
_CONTROL = re.compile('[\x00-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f'
                      '\ufeff\ufff9-\ufffb\U000e0000-\U000e007f]')


def printable(text: str, keep: str = '') -> str:
    """
    Return a text as one printable line, with control characters escaped.

    Names and texts from bags, scenes, models and other nodes may contain any character.

    Parameters
    ----------
    text : str
        Untrusted text.
    keep : str, optional
        Control characters to keep.

    """
    return _CONTROL.sub(lambda found: found[0] if found[0] in keep else
                        found[0].encode('unicode_escape').decode(), text)


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.7) -> str:
    """Return ``'; did you mean ...?'`` if a word resembles a known one, else ''."""
    names = {name.lower(): name for name in known}
    nearest = get_close_matches(word.lower(), names, n=1, cutoff=cutoff)
    return f'; did you mean {names[nearest[0]]}?' if nearest else ''


def offered(word: str, known: Iterable[str], what: str = 'valid') -> str:
    """
    Return ``'; did you mean ...?; valid: ...'``; of many names, only the most similar.

    Parameters
    ----------
    word : str
        Unknown name.
    known : iterable of str
        Valid names.
    what : str, optional
        Label of the list.

    """
    names = [*known]
    text = ', '.join(names)
    if len(text) > _MAX_LETTERS:
        near = sorted(names, key=lambda name: -SequenceMatcher(None, name, word).ratio())
        shown = near[:_MAX_SIMILAR]
        text = f'{", ".join(shown)}, ... ({len(names) - len(shown)} more)'
    return f'{did_you_mean(word, names)}; {what}: {text}'


def listed(names: Iterable[object]) -> str:
    """Return names for a message: the first ones, and the number of the remaining ones."""
    every = [*names]
    more = len(every) - _MAX_LISTED
    return ', '.join(map(str, every[:_MAX_LISTED])) + (f', ... ({more} more)' if more > 0 else '')


def counted(number: int, noun: str) -> str:
    """Return ``'1 run'`` or ``'2 runs'``."""
    return f'{number} {noun}' if number == 1 else f'{number} {noun}s'


def reduce_error(error: BaseException) -> tuple[Any, ...]:
    """Make pickle bypass constructors, whose arguments may differ from the message."""
    return _without_constructor, (type(error), error.args), vars(error)


def _without_constructor(cls: type[BaseException], args: tuple[Any, ...]) -> BaseException:
    """Return an error for pickle, which sets its attributes."""
    return cls.__new__(cls, *args)


def _shortened(message: object) -> str:
    text = str(message)
    return text if len(text) <= _MAX_MESSAGE else (
        f'{text[:_MAX_MESSAGE - _MESSAGE_TAIL]} ... {text[-_MESSAGE_TAIL:]}')


class HnnViRosError(Exception):
    """
    Base class of all intended errors of this package; their text is one printable line.

    A message of more than 2000 characters is shortened in the middle, since quotes may be long.

    Parameters
    ----------
    message : object
        Place, problem, remedy.
    *more : object
        The same of further problems, such as others in a file; ``lines`` has one each.

    Attributes
    ----------
    remedy : str
        Remedy for errors of this class, listed on the troubleshooting page.

    """

    remedy: ClassVar[str] = ''
    __reduce__ = reduce_error

    def __init__(self, message: object = '', *more: object):
        # Libraries construct an error from another one, as gymnasium does across processes.
        super().__init__(*map(_shortened, (message, *more)))

    @property
    def lines(self) -> list[str]:
        """Return a printable line for each problem."""
        return [printable(str(text)) for text in self.args]

    def __str__(self) -> str:
        return _shortened('; '.join(self.lines))


class SceneError(HnnViRosError):
    """A scene file cannot be read, or requests something that does not exist."""

    remedy = ('correct the key at the file and line in the message; `hnn scene --check FILE` '
              'checks a scene without running it, and the page on scene files lists all keys')


class ModelError(HnnViRosError):
    """A model file is missing, damaged, or is not a model of this package."""

    remedy = ('name a shipped model or the path of a .safetensors file; `hnn import` '
              'converts torch modules, and `hnn train` trains a missing model again')


class DataError(HnnViRosError):
    """A data or training configuration file cannot be used."""

    remedy = ('correct the column, topic or key that the message names; shipped '
              'configurations in config/training are examples of every kind of data')


class ParameterError(HnnViRosError):
    """A ROS parameter or an argument has an invalid value."""

    remedy = ('give a value in the range that the message states; `--help` of the '
              'executable lists its parameters with ranges and units')


class RecordingError(HnnViRosError):
    """A recording cannot be created or written, for example because the file exists."""

    remedy = ('name a new path in a writable folder; if the disk is full, free space, or run with '
              '`record:=false` and `rerun_sink:=none`; `recover_bag` repairs an interrupted bag')


class UnsupportedSystem(HnnViRosError):
    """The chosen integrator cannot integrate the system."""

    remedy = ('use one of the methods that the message names; an explicit method needs H = T(p) + '
              'V(q), and rotating bodies need a method `lie_...`')


class CalibrationError(HnnViRosError):
    """No method reaches the requested error."""

    remedy = ('allow a larger error or a shorter horizon; in a chaotic motion no method limits '
              'the trajectory error beyond a few Lyapunov times, but the energy error can be '
              'limited')


class MissingPackage(HnnViRosError, ImportError):
    """A Python package needed for the requested work is not installed."""

    remedy = ('run the pip command in the message, in the environment of hnn_vi_ros; `hnn doctor` '
              'lists the installed packages')


class AlarmWarning(UserWarning):
    """A guard reports that a run is unreliable; see ``Trajectory.alarms``."""

    remedy = 'see the alarm of that name below: the warning carries its message'


class Interrupted(HnnViRosError):
    """Training was stopped with Ctrl-C after saving its state."""

    remedy = 'none is needed: the same command with `--resume` continues, bit-identically'


class StateError(HnnViRosError, ValueError):
    """An invalid initial state, such as one behind a wall or off its constraints."""

    remedy = ('choose another initial state: finite, within the limits of joints and walls, and '
              'on the constraints')


# Remedy for most failed steps.
ADVICE = 'use a smaller step_size or another integrator'


class StepFailure(HnnViRosError):
    """
    A step of the integrator failed; the state before it is the last valid one.

    Parameters
    ----------
    reason : str
        Reason, such as ``'no convergence'`` or ``'not finite'``.
    t : float
        Simulated time at the start of the failed step [s].
    h : float
        Step size [s].
    relative_residual : float
        Largest residual of the unsolved equation relative to the scale of its unknowns [1], after
        the first attempt; NaN if the step failed for another reason.
    evaluations : int
        Number of gradients and Hessian-vector products over all attempts of the step.
    advice : str, optional
        Remedy.

    """

    remedy = ('use a smaller step_size or another integrator; `on_failure: substep`, the default, '
              'or `implicit` takes such steps differently; a state far outside the training '
              'domain needs a better model or `confine: true`')

    def __init__(self, reason: str, t: float, h: float, relative_residual: float,
                 evaluations: int, advice: str = ADVICE):
        self.reason, self.t, self.h = reason, t, h
        self.relative_residual, self.evaluations = relative_residual, evaluations
        self.advice = advice
        residual = '' if isnan(relative_residual) else (
            f', relative residual {relative_residual:.3g}')
        super().__init__(
            f'step failed at t = {t:.9g} s ({reason}): h = {h:g} s{residual} after {evaluations} '
            f'evaluations of gradients and Hessian-vector products; {advice}')

    def dated(self, t: float) -> 'StepFailure':
        """Return the failure with another time [s], such as that of a stamp."""
        return StepFailure(self.reason, t, self.h, self.relative_residual, self.evaluations,
                           self.advice)


class StoppedByEvent(HnnViRosError):
    """
    An event ended the run; the simulation is at the state before the step with the event.

    Parameters
    ----------
    event : Event
        Event that ended the run.
    q, p : np.ndarray, shape (N, d)
        Samples taken before the event.
    state : callable
        Function that returns q and p at a fraction of the event's step; see ``DenseStep.state``.

    """

    remedy = 'none is needed: the scene requests it; with `then: log` the run continues'

    def __init__(self, event: 'Event', q: 'np.ndarray', p: 'np.ndarray',
                 state: 'Callable[[float], tuple[np.ndarray, np.ndarray]]'):
        self.event, self.q, self.p, self.state = event, q, p, state
        super().__init__(f'the event {event} ended the run')

    def after(self, q: 'np.ndarray', p: 'np.ndarray') -> 'StoppedByEvent':
        """Return the exception with samples that were taken before."""
        return StoppedByEvent(self.event, q, p, self.state)


# Requirements for pip that differ from the import name. Each version of rerun changes its API; the
# range equals that in setup.py.
_TORCH_FOR_CPUS = 'https://download.pytorch.org/whl/cpu'
_REQUIREMENTS = {'rerun': 'rerun-sdk>=0.41,<0.42', 'yaml': 'pyyaml'}


def pip_command(*packages: str) -> str:
    """
    Return the command that installs packages for this Python; torch in its build for CPUs.

    Parameters
    ----------
    packages : str
        Import names, or requirements for pip.

    """
    index = f' --extra-index-url {_TORCH_FOR_CPUS}' * ('torch' in packages)
    return f'{sys.executable} -m pip install ' + ' '.join(
        f'"{_REQUIREMENTS.get(package, package)}"' for package in packages) + index


@contextmanager
def prefixed(place: str, error: type[Exception],
             caught: type[Exception] | tuple[type[Exception], ...] = ValueError) -> Iterator[None]:
    """Raise errors of these classes as another one, with the place before their text."""
    try:
        yield
    except caught as problem:
        raise error(f'{place}: {problem}') from problem


@contextmanager
def optional(package: str, what: str) -> Iterator[None]:
    """
    Replace the error of a failed import by a one-line message on the missing package.

    Parameters
    ----------
    package : str
        Import name of the package.
    what : str
        Feature that needs the package.

    Raises
    ------
    MissingPackage
        The package is not installed.

    """
    try:
        yield
    except ModuleNotFoundError as problem:
        # A dependency of the package is missing: a different problem.
        if problem.name is None or problem.name.partition('.')[0] != package:
            raise
        raise MissingPackage(f'{what} needs the Python package {package}; install it with: '
                             f'{pip_command(package)}') from problem
