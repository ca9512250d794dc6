# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find the coordinates, velocities and forces of a log by the names of its columns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
import re
from typing import Any, Protocol

from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.learning.data.faults import unwrapped
from hnn_vi_ros.learning.data.sampling import repeated_text, unexplained
from hnn_vi_ros.learning.data.text import COLUMN, lacking, LogFormat, read_log
from hnn_vi_ros.learning.data.units import parsed, split_unit
import numpy as np

TIME, TRIAL, Q, V, A, TAU, UNUSED, UNKNOWN = 'time', 'trial', 'q', 'v', 'a', 'tau', 'unused', ''
ANGLE, LENGTH = 'rad', 'm'
# Coordinates of a configuration by their kind.
COORDINATES = {ANGLE: {'q_unit': 'rad', 'p_unit': 'N m s', 'kind': 'revolute'},
               LENGTH: {'q_unit': 'm', 'p_unit': 'N s', 'kind': 'prismatic'}}
_GREEK = str.maketrans({'θ': 'theta', 'ϑ': 'theta', 'φ': 'phi', 'ϕ': 'phi', 'ψ': 'psi',
                        'ω': 'omega', 'τ': 'tau', '\u03b1': 'alpha', 'β': 'beta'})
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+')
_ROLES = {word: role for role, words in {
    TIME: 't time times timestamp stamp zeit temps elapsed seconds secs clock millis',
    TRIAL: 'trial run experiment episode swing segment repetition',
    UNUSED: ('index sample samples n seq row id frame unnamed desired des reference ref setpoint '
             'target goal command cmd error err temperature temp status mode flag raw filtered '
             'smoothed sin sine cos cosine'),
    A: 'acc accel acceleration',
    V: 'v vel velocity velocities speed omega w rate gyro angvel',
    TAU: 'u tau torque force f effort efforts moment input voltage current drive',
    Q: ('q theta th angle phi psi alpha beta pitch roll yaw heading tilt azimuth rotation winkel '
        'x y z s displacement distance height elongation extension deflection pos position '
        'positions encoder enc'),
}.items() for word in words.split()}
# Words that tell an angle from a length.
_KINDS = {word: kind for kind, words in {
    ANGLE: ('theta th angle phi psi alpha beta pitch roll yaw heading tilt azimuth rotation '
            'winkel omega w gyro angular angvel torque tau moment joint shoulder elbow wrist hip '
            'knee ankle arm pendulum pole link wheel motor rotor shaft servo revolute'),
    LENGTH: ('x y z s displacement distance height elongation extension force f cart slider slide '
             'linear prismatic carriage stage piston mass'),
}.items() for word in words.split()}
# Words of which each names a coordinate of its own.
_LETTERS = frozenset((
    'theta', 'th', 'phi', 'psi', 'alpha', 'beta', 'pitch', 'roll', 'yaw', 'x', 'y', 'z', 's'))
_DERIVED = re.compile(r'(?P<before>d*?)(?P<of>q|theta|th|phi|psi|alpha|beta|x|y|z|angle|pos)'
                      r'(?P<after>(?:dot|d)*)')
# Largest angle [rad] and length [m] that need no unit: degrees of a small swing go further.
_MOST = {ANGLE: np.pi * 1.01, LENGTH: 10.0}
# Intervals [s] of samples that are usual, the shortest that may be another unit, and the times [s]
# since 1970 of the years 2000 to 2100.
_USUAL, _DOUBTFUL, _DATES = (1e-4, 10.0), 0.5, (9.4e8, 4.2e9)
# Tolerance of the ratio of positions to integrated velocities, which tells the unit of these.
_RATIO = 0.2


class Named(Protocol):
    """A coordinate with a name and a unit."""

    @property
    def name(self) -> str:
        """Return the name."""

    @property
    def q_unit(self) -> str:
        """Return the unit."""


@dataclass(frozen=True)
class Column:
    """
    Column of a log.

    Parameters
    ----------
    name : str
        Name in the log.
    role : str
        Channel of the motion, or TIME, TRIAL, UNUSED, UNKNOWN.
    key : str
        Words that tell one joint from another, such as ``'shoulder'`` or ``'1'``.
    letter : str
        Letter of the coordinate, such as ``'theta'``; '' if the name has none.
    kind : str
        ANGLE or LENGTH; '' if the name does not tell.
    unit : str
        Unit in the name, or ''.

    """

    name: str
    role: str
    key: str = ''
    letter: str = ''
    kind: str = ''
    unit: str = ''


@dataclass(frozen=True)
class Reading:
    """
    Columns of a log by their roles.

    Parameters
    ----------
    path : Path
        Path of the log.
    columns : list of str
        Names of all columns; `renamed` maps those whose units were inferred to names with units.
    time, trial : Column, Column or None
        Times, and the number of the run.
    q, v, tau : list of Column
        Coordinates, velocities (or none), and forces, which may be fewer.
    turns : list of bool
        True for coordinates that make a whole turn.

    """

    path: Path
    columns: list[str]
    time: Column
    trial: Column | None
    q: list[Column]
    v: list[Column]
    tau: list[Column]
    renamed: dict[str, str] = field(default_factory=dict)
    turns: list[bool] = field(default_factory=list)

    def _name(self, one: Column) -> str:
        return self.renamed.get(one.name, one.name)

    @property
    def data(self) -> dict[str, Any]:
        """Return the data section of a configuration."""
        groups = {key: [self._name(one) for one in getattr(self, key)]
                  for key in ('q', 'v', 'tau')}
        found: dict[str, Any] = {'kind': 'log', 'path': str(self.path)}
        if self.renamed or self.columns[0] == COLUMN.format(1):
            found['columns'] = [self.renamed.get(name, name) for name in self.columns]
        if self.trial is not None:
            found['trial'] = self.trial.name
        found['time'] = self._name(self.time)
        return found | {key: names for key, names in groups.items() if names}

    @property
    def configuration(self) -> dict[str, Any]:
        """Return a training configuration."""
        coordinates, names = [], list[str]()
        for one, turns in zip(self.q, self.turns, strict=True):
            alone = [other.key for other in self.q].count(one.key) == 1
            short = alone and re.search('[a-z]', one.key)
            name = re.sub(r'\W+', '_', one.key if short else split_unit(one.name)[0]).strip('_')
            name = f'q_{name}' if not name or name[0].isdigit() else name
            names.append(name if name not in names else f'{name}_{len(names) + 1}')
            units = COORDINATES.get(one.kind, {'q_unit': one.kind, 'kind': 'prismatic'})
            coordinates.append({'name': names[-1]} | units | (
                {'kind': 'continuous'} if turns else {}))
        forces = [parsed(one.unit) for one in self.tau]
        others = [[*unit[1]] for unit in forces if unit and 'kg' not in unit[1]]
        mapped = len(self.q) > 1 and others
        if len(self.q) == 1 and len(others) == 1:
            # Volts, for example: without a gain, all numbers are those for a force in volts.
            coordinates[0]['p_unit'] = f'{others[0][0]} s'
        family = {'kind': 'mechanical'}
        if mapped or 0 < len(forces) < len(self.q):
            family['input_map'] = 'learned'
        return {'coordinates': coordinates, 'data': self.data, 'family': family}


def column_of(name: str, known: Mapping[str, str]) -> Column:
    """Return the meaning of a column's name; `known` has the units of coordinates by name."""
    base, unit = split_unit(name)
    for coordinate, q_unit in known.items():
        # Whole, or as a part of a path: /joint_states/elbow/velocity.
        _, found, rest = f'/{base.lower()}/'.partition(f'/{coordinate.lower()}/')
        if found:
            role = column_of(rest, {}).role if rest else Q
            return Column(name, role, coordinate, coordinate, _kind_of(q_unit), unit)
    words = [word.lower() for word in _WORD.findall(base.translate(_GREEK))]
    roles, key, letter, order = set[str](), list[str](), '', 0
    for word in words:
        derived = _DERIVED.fullmatch(word)
        if word in _ROLES:
            roles.add(_ROLES[word])
            letter = letter or word * (word in _LETTERS)
        elif word in ('d', 'dd', 'dot', 'ddot', 'dt'):
            order += word.count('d') * (word != 'dt')
        elif derived:
            roles.add(Q)
            order += len(derived['before']) + derived['after'].count('d')
            letter = letter or derived['of'] * (derived['of'] in _LETTERS)
        else:
            key.append(word)
    kind, by_unit = _by_unit(unit)
    kind = kind or next((_KINDS[word] for word in [*words, letter] if word in _KINDS), '')
    role = next((role for role in (UNUSED, TIME, TRIAL, A, V, TAU, Q) if role in roles), by_unit)
    if role == Q and order:
        role = V if order == 1 else A
    return Column(name, TIME if by_unit == TIME else role, ' '.join(key), letter, kind, unit)


def _by_unit(unit: str) -> tuple[str, str]:
    """Return the kind of coordinate and the role that a unit tells, or ''."""
    known = parsed(unit)
    if known is None:
        return '', UNKNOWN
    text = ' '.join(f'{name}{power if power != 1 else ""}' for name, power in sorted(
        known[1].items()))
    if text == 's':
        return '', TIME
    return {'': (ANGLE, Q), 'm': (LENGTH, Q), 'px': ('px', Q), 'm s-1': (LENGTH, V),
            'px s-1': ('px', V), 's-1': (ANGLE, V), 'kg m2 s-2': (ANGLE, TAU),
            'kg m s-2': (LENGTH, TAU)}.get(text, ('', UNKNOWN))


def _kind_of(q_unit: str) -> str:
    return _by_unit(q_unit)[0] if q_unit != '1' else ''


def read_header(path: Path, coordinates: Sequence[Named] = ()) -> Reading:
    """
    Find out what the columns of a log are.

    Parameters
    ----------
    path : Path
        Path of the log.
    coordinates : sequence of Named
        Coordinates of the scene or model, which the log is to have; none: those of the log.

    Raises
    ------
    DataError
        The log has no times or no coordinates, or there are two readings; the message has both.

    """
    table = read_log(path, LogFormat())
    for name in table.names:
        if table.names.count(name) > 1:
            raise DataError(f'{path}: two columns are called {name!r}; rename one of them')
    values = dict(zip(table.names, table.numbers.T, strict=True))
    if table.names[0] == COLUMN.format(1):
        columns = _by_place(path, values, coordinates)
    else:
        columns = [column_of(name, {one.name: one.q_unit for one in coordinates})
                   for name in table.names]
    time = _time_of(path, columns, values)
    values = {name: lacking(x, values[time.name], name, []) for name, x in values.items()}
    columns = [one for one in columns if np.nanmax(values[one.name], initial=-np.inf)
               > np.nanmin(values[one.name], initial=np.inf)]

    def having(role: str) -> list[Column]:
        return [one for one in columns if one.role == role]
    q = _coordinates(path, columns, coordinates)
    if not coordinates:
        q = [_with_kind(path, one, len(q), having(V) + having(TAU)) for one in q]
        q.sort(key=lambda one: one.kind == ANGLE)  # carts come first in a chain
    v = _matched(path, q, having(V), 'velocity')
    tau = _matched(path, q, having(TAU), 'force')
    renamed = {} if coordinates and not time.unit and np.nanmax(values[time.name]) < _DATES[0] \
        else _time_unit(path, time, values[time.name])
    t = values[time.name] * _size(renamed.get(time.name, time.name))
    turns = []
    for k, one in enumerate(q):
        renamed |= _unit(path, one, values[one.name])
        x = values[one.name] * _size(renamed.get(one.name, one.name))
        good = np.isfinite(t) & np.isfinite(x)
        x = x[good] if one.kind != ANGLE else unwrapped(np.arange(good.sum()), x[good])
        turns.append(one.kind == ANGLE and bool(np.ptp(x) > 2.0 * np.pi))
        if len(v) == len(q) and not v[k].unit:
            renamed |= _rate_unit(v[k].name, one.kind, t[good], x, values[v[k].name][good])
    trials = having(TRIAL)
    return Reading(path, table.names, time, trials[0] if trials else None, q,
                   v if len(v) == len(q) else [], tau, renamed, turns)


def _size(name: str) -> float:
    """Return the size of the unit in a name, 1 if it has none."""
    return (parsed(split_unit(name)[1]) or (1.0,))[0]


def _by_place(path: Path, values: Mapping[str, np.ndarray], coordinates: Sequence[Named]
              ) -> list[Column]:
    """Return the meaning of columns without names: times, coordinates, velocities, forces."""
    names, d = [*values], len(coordinates)
    rest = names[1:]
    if not coordinates:
        if len(rest) == 1 and _wrapped(values[rest[0]]):
            return [Column(names[0], TIME), Column(rest[0], Q, 'angle', kind=ANGLE)]
        examples = [', '.join(['t [s]', *words][:len(names)]) for words in (
            ['angle [rad]', 'rate [rad/s]', 'torque [N m]'], ['x [m]', 'v [m/s]', 'force [N]'])]
        raise DataError(f'{path}: has no header; write one above its {len(names)} columns, such '
                        f'as {examples[0]!r} or {examples[1]!r}')
    if not d <= len(rest) <= 3 * d:
        raise DataError(f'{path}: has no header, and {len(names)} columns, expected times and '
                        f'{d} coordinates, then velocities and forces; name them in a first line')
    t, blocks = values[names[0]], [rest[k:k + d] for k in range(0, len(rest), d)]
    x, rate = (np.stack([values[name] for name in block], axis=-1) if len(block) == d else None
               for block in [*blocks, []][:2])
    moving = len(rest) == 3 * d or (x is not None and rate is not None and bool(
        np.nanmedian(unexplained(t, x, rate)) < 0.5))
    roles = [Q, V, TAU] if moving else [Q, TAU]
    return [Column(names[0], TIME), *(
        Column(name, role, str(k), coordinates[k].name if role == Q else '')
        for role, block in zip(roles, blocks, strict=False) for k, name in enumerate(block))]


def _time_of(path: Path, columns: Sequence[Column], values: Mapping[str, np.ndarray]) -> Column:
    """Return the column of times, which mostly increase."""
    for one in columns:
        steps = np.diff(values[one.name][np.isfinite(values[one.name])])
        if one.role == TIME and (steps > 0.0).sum() > 0.5 * len(steps):
            return one
        if one.role == TIME and (text := repeated_text(values[one.name])):
            raise DataError(f'{path}: column {one.name!r}: {text}')
    raise DataError(f'{path}: no column of times that increase: '
                    f'{listed(one.name for one in columns)}; name it t [s], and write seconds')


def _time_unit(path: Path, time: Column, t: np.ndarray) -> dict[str, str]:
    """Return the name of the times with a unit that their size tells; {} if it is s."""
    if time.unit:
        return {}
    interval, latest = float(np.nanmedian(np.abs(np.diff(t)))), float(np.nanmax(t))
    sizes = {unit: size for unit in ('s', 'ms', 'us', 'ns')
             if (size := _size(f't [{unit}]')) and _USUAL[0] <= interval * size <= _USUAL[1]}
    dates = [unit for unit, size in sizes.items() if _DATES[0] < latest * size < _DATES[1]]
    if len(dates) == 1 or (interval < _DOUBTFUL and latest < _DATES[0]):
        unit = [*dates, 's'][0]
        return {} if unit == 's' else {time.name: f'{time.name} [{unit}]'}
    ways = ' or '.join(f"'{time.name} [{unit}]'" for unit in [*sizes][:2] or ('s', 'ms'))
    raise DataError(f'{path}: the times {time.name!r} lie {interval:.6g} apart, in s or another '
                    f'unit; name the column {ways}')


def _coordinates(path: Path, columns: Sequence[Column], coordinates: Sequence[Named]
                 ) -> list[Column]:
    """Return the columns of the coordinates, in the order of the given ones."""
    found = [one for one in columns if one.role == Q]
    if not found:
        unknown = [one for one in columns if one.role == UNKNOWN]
        found = unknown if len(unknown) == 1 else [one for one in unknown if one.kind]
    if coordinates:
        exact = [[one for one in found if one.letter == other.name] for other in coordinates]
        if all(len(ones) == 1 for ones in exact):
            return [ones[0] for ones in exact]
        fits = len(found) == len(coordinates) and all(
            not one.kind or not _kind_of(other.q_unit) or one.kind == _kind_of(other.q_unit)
            for one, other in zip(found, coordinates, strict=True))
        if fits and (len(found) == 1 or all(one.key.isdigit() for one in found)):
            return [replace(one, kind=_kind_of(other.q_unit))
                    for one, other in zip(found, coordinates, strict=True)]
        raise DataError(f'{path}: the columns {listed(one.name for one in columns)} do not say '
                        f'which is {listed(one.name for one in coordinates)}; rename them after '
                        'the coordinates')
    if not found:
        raise DataError(f'{path}: no column of a coordinate: '
                        f'{listed(one.name for one in columns)}; name it angle [rad] or x [m]')
    for k, one in enumerate(found):
        for other in found[:k]:
            if one.key == other.key and (one.letter == other.letter or '' in (
                    one.letter, other.letter)):
                raise DataError(f'{path}: {other.name!r} and {one.name!r} may be the same '
                                f'coordinate; take one of data.q: [{other.name}] or data.q: '
                                f'[{one.name}] in a configuration, or leave a column out')
    return found


def _with_kind(path: Path, one: Column, count: int, others: Sequence[Column]) -> Column:
    """Return a coordinate with its kind, by its name or those of its velocity and force."""
    if one.kind:
        return one
    kinds = {other.kind for other in others
             if other.kind and (count == 1 or other.key == one.key)}
    if one.unit:
        raise DataError(f'{path}: {one.name!r} is in {one.unit}, which is no unit of angles or '
                        f'lengths; convert it, or write a configuration with q_unit: {one.unit}')
    if len(kinds) == 1:
        return replace(one, kind=kinds.pop())
    raise DataError(
        f'{path}: {one.name!r} may be an angle or a length; name the column '
        f"'{one.name} [rad]' (q_unit: rad, p_unit: N m s), or '{one.name} [m]' (q_unit: m, p_unit:"
        ' N s, kind: prismatic)')


def _matched(path: Path, q: Sequence[Column], found: Sequence[Column], what: str) -> list[Column]:
    """Return the velocities or forces of the coordinates, as far as there are any, in order."""
    taken: dict[int, Column] = {}
    fitting = {k: [other for other in found if (
        other.key == one.key or len(q) == 1) and other.letter in ('', one.letter)
        and (not other.kind or not one.kind or other.kind == one.kind)] for k, one in enumerate(q)}
    if len(q) == 1 and len(fitting[0]) > 1:
        fitting[0] = [one for one in fitting[0] if one.key == q[0].key]
    for _ in q:
        for k, ones in fitting.items():
            ones = [one for one in ones if one not in taken.values()]
            if k not in taken and len(ones) == 1:
                taken[k] = ones[0]
    left = [one for one in found if one not in taken.values()]
    if not taken and len(left) == len(q) and all(one.key.isdigit() for one in left):
        return left
    if left and (len(taken) < len(q) or len(q) == 1):
        if what == 'force' and len(found) <= len(q):
            return [taken[k] for k in sorted(taken)] + left
        both = ' or '.join(f'data.{"v" if what == "velocity" else "tau"}: [{one.name}]'
                           for one in found[:3])
        raise DataError(f'{path}: the {what} of {q[0].name!r} may be {both}; name the others '
                        'otherwise, or write a configuration')
    return [taken[k] for k in sorted(taken)]


def _wrapped(x: np.ndarray) -> str:
    """Return the unit of an angle that is kept within a turn, by its jumps, or ''."""
    x = x[np.isfinite(x)]
    low, high = np.quantile(x, [0.001, 0.999])
    steps = np.abs(np.diff(x))
    for unit, turn in (('rad', 2.0 * np.pi), ('deg', 360.0)):
        jumps = (0.8 * turn < steps) & (steps < 1.01 * turn)
        if high - low < 1.01 * turn and jumps.any() and (steps[~jumps] < 0.5 * turn).all():
            return unit
    return ''


def _unit(path: Path, one: Column, x: np.ndarray) -> dict[str, str]:
    """Return the name of a coordinate with the unit that its range tells; {} for rad and m."""
    if one.unit or one.kind not in _MOST or (
            np.nanquantile(np.abs(x), 0.99) <= _MOST[one.kind]):
        return {}
    other = 'deg' if one.kind == ANGLE else 'mm'
    if one.kind == ANGLE and (unit := _wrapped(x)):
        return {one.name: f'{one.name} [{unit}]'}
    raise DataError(f'{path}: {one.name!r} goes from {np.nanmin(x):.4g} to {np.nanmax(x):.4g}, in '
                    f"{one.kind} or {other}; name the column '{one.name} [{one.kind}]' or "
                    f"'{one.name} [{other}]'")


def _rate_unit(name: str, kind: str, t: np.ndarray, x: np.ndarray, v: np.ndarray
               ) -> dict[str, str]:
    """Return the name of a velocity with the unit in which it is the rate of x; {} if it is SI."""
    moved, rates = np.diff(x), 0.5 * (v[1:] + v[:-1]) * np.diff(t)
    good = np.isfinite(rates) & (np.abs(moved) <= 5.0 * np.quantile(np.abs(moved), 0.9))
    ratio = moved[good] @ rates[good] / max(rates[good] @ rates[good], 1e-300)
    for unit in {ANGLE: ('rad/s', 'deg/s', 'rpm'), LENGTH: ('m/s', 'mm/s', 'cm/s')}.get(kind, ()):
        if abs(ratio / _size(f'v [{unit}]') - 1.0) < _RATIO:
            return {} if unit in ('rad/s', 'm/s') else {name: f'{name} [{unit}]'}
    return {}
