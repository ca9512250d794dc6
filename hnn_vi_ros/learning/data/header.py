# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find the coordinates, velocities and forces of a log by the names of its columns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
import re
from typing import Any
from unicodedata import normalize

from hnn_vi_ros.errors import counted, DataError, listed
from hnn_vi_ros.learning.data.faults import unwrap_beside_glitches
from hnn_vi_ros.learning.data.sampling import repeated_text
from hnn_vi_ros.learning.data.text import COLUMN, LogFormat, read_log, without_sentinels
from hnn_vi_ros.learning.data.units import parse_unit, split_unit
from hnn_vi_ros.phase_space import Coordinate
import numpy as np
from yaml import safe_dump

TIME, TRIAL, Q, V, A, TAU, UNUSED, UNKNOWN = 'time', 'trial', 'q', 'v', 'a', 'tau', 'unused', ''
COMMAND, ENABLED = 'command', 'enabled'
ANGLE, LENGTH = 'rad', 'm'
# Coordinates of a configuration by their kind.
COORDINATES = {ANGLE: {'q_unit': 'rad', 'p_unit': 'N m s', 'kind': 'revolute'},
               LENGTH: {'q_unit': 'm', 'p_unit': 'N s', 'kind': 'prismatic'}}
_GREEK = str.maketrans({'θ': 'theta', 'ϑ': 'theta', 'φ': 'phi', 'ϕ': 'phi', 'ψ': 'psi',
                        'ω': 'omega', 'τ': 'tau', '\u03b1': 'alpha', 'β': 'beta'})
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+')
_ROLES = {word: role for role, words in {
    TIME: ('t ts time times timestamp stamp elapsed seconds secs sec clock millis date datum '
           'fecha zeit uhrzeit temps heure tiempo hora tempo tijd'),
    TRIAL: 'trial run experiment episode swing segment repetition',
    UNUSED: ('index sample samples n seq row id frame unnamed error err temperature temp status '
             'mode flag raw filtered smoothed sin sine cos cosine'),
    COMMAND: 'action desired des reference ref setpoint target goal command cmd',
    ENABLED: 'enabled enable',
    A: 'acc accel acceleration',
    V: ('v vel velocity velocities speed omega w rate gyro angvel geschwindigkeit drehzahl '
        'winkelgeschwindigkeit vitesse velocidad velocita snelheid'),
    TAU: ('u tau torque force f effort efforts moment input voltage current drive kraft strom '
          'drehmoment spannung couple courant tension fuerza corriente forza coppia'),
    Q: ('q theta th angle phi psi alpha beta pitch roll yaw heading tilt azimuth rotation winkel '
        'x y z s displacement distance height elongation extension deflection pos position '
        'positions encoder enc angulo angolo hoek weg auslenkung deplacement posicion '
        'posizione'),
}.items() for word in words.split()}
# Words that tell an angle from a length.
_KINDS = {word: kind for kind, words in {
    ANGLE: ('theta th angle phi psi alpha beta pitch roll yaw heading tilt azimuth rotation '
            'winkel omega w gyro angular angvel torque tau moment joint shoulder elbow wrist hip '
            'knee ankle arm pendulum pole link wheel motor rotor shaft servo revolute angulo '
            'angolo hoek winkelgeschwindigkeit drehmoment coppia drehzahl'),
    LENGTH: ('x y z s displacement distance height elongation extension force f cart slider slide '
             'linear prismatic carriage stage piston mass weg auslenkung kraft fuerza forza '
             'deplacement'),
}.items() for word in words.split()}
# Name that a program for data gives a run, such as Run #1 of PASCO or Latest: of Vernier.
_SET = re.compile(r'\b(?:run ?#? ?\d+:?|data set ?\d*:|latest:)', re.IGNORECASE)
# Numbers of the machine in lines above the names: counts per turn of the encoder, the ratio of the
# gear between motor and coordinate, and the torque constant of the motor.
_SETTINGS = {name: re.compile(
    rf'(?:{words}) *(?:[\[(](?P<of>[^\])]*)[\])])? *[:=,;\t]? *(?P<x>\d[\d.]*(?:e[-+]?\d+)?)'
    r'(?: *: *(?P<to>\d[\d.]*))? *(?P<unit>[^\s,;]*)', re.IGNORECASE) for name, words in {
    'counts': r'(?:counts?|ticks?)[ _]*(?:per|/)[ _]*(?:turn|rev\w*|rotation)|\bcpr\b',
    'gear': r'\bgear[ _]*(?:ratio)?', 'torque_constant': r'torque[ _]*constant|\bk_?t\b'}.items()}
_COUNTED = frozenset(('encoder', 'enc', 'counts', 'count', 'ticks', 'tick'))
# Words that each name a coordinate.
_LETTERS = frozenset((
    'theta', 'th', 'phi', 'psi', 'alpha', 'beta', 'pitch', 'roll', 'yaw', 'x', 'y', 'z', 's'))
_DERIVED = re.compile(r'(?P<before>d*?)(?P<of>q|theta|th|phi|psi|alpha|beta|x|y|z|angle|pos)'
                      r'(?P<after>(?:dot|d)*)')
# A field of sensor_msgs/JointState behind its topic and joint, as PlotJuggler names it.
_JOINT_STATE = re.compile(r'/.+/(?P<joint>[^/]+)/(?:position|velocity|effort)')
# Units of currents, and a word in brackets after a name, which is a unit.
_CURRENTS = parse_unit('A'), parse_unit('mA')
_BRACKETED = re.compile(r' \[[^\W\d]')
# Largest angle [rad] and length [m] that need no unit: degrees of a small swing go further.
_MOST = {ANGLE: np.pi * 1.01, LENGTH: 10.0}
# Intervals of samples [s] from this one on may be of another unit; and the times [s] since 1970 of
# the years 2000 to 2100, which tell theirs.
_DOUBTFUL, _DATES = 0.5, (9.4e8, 4.2e9)


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
        Names of all columns if they differ from the header, else empty.
    time, trial : Column, Column or None
        Times, and the number of the run.
    q, v, tau : list of Column
        Coordinates, velocities (or none), and forces, which may be fewer.
    command, enabled : list of Column
        Commanded positions of the coordinates, and whether motors are on; each may be empty.
    turns : list of bool
        True for coordinates that make a whole turn.
    settings : dict of str to float
        Counts per turn and force per current, by their keys in the data section.
    still : list of str
        Columns of coordinates, velocities and forces that are left out, since they are constant or
        without numbers.

    """

    path: Path
    columns: list[str]
    time: Column
    trial: Column | None
    q: list[Column]
    v: list[Column]
    tau: list[Column]
    turns: list[bool]
    command: list[Column] = field(default_factory=list)
    enabled: list[Column] = field(default_factory=list)
    settings: Mapping[str, float] = field(default_factory=dict)
    still: list[str] = field(default_factory=list)

    @property
    def data(self) -> dict[str, Any]:
        """Return the data section of a configuration."""
        groups = {key: [one.name for one in getattr(self, key)] for key in ('q', 'v', 'tau')}
        section: dict[str, Any] = {'kind': 'log', 'path': str(self.path)}
        if self.columns:
            section['columns'] = self.columns
        if self.trial is not None:
            section['trial'] = self.trial.name
        section['time'] = self.time.name
        return section | {key: names for key, names in groups.items() if names} | {**self.settings}

    @property
    def commanded(self) -> dict[str, Any]:
        """Return the data section with commanded positions instead of forces."""
        section = {key: value for key, value in self.data.items() if key != 'tau'}
        return section | {key: names for key in ('command', 'enabled') if (
            names := [one.name for one in getattr(self, key)])}

    @property
    def configuration(self) -> dict[str, Any]:
        """Return a training configuration."""
        coordinates, names = [], list[str]()
        for one, turns in zip(self.q, self.turns, strict=True):
            alone = [other.key for other in self.q].count(one.key) == 1
            short = alone and re.search('[a-z]', one.key)
            name = re.sub(r'\W+', '_', one.key if short else _SET.sub(
                '', split_unit(one.name)[0]).strip()).strip('_')
            name = f'q_{name}' if not name or name[0].isdigit() else name
            names.append(name if name not in names else f'{name}_{len(names) + 1}')
            units = COORDINATES.get(one.kind, {'q_unit': one.kind, 'kind': 'prismatic'})
            coordinates.append({'name': names[-1]} | units | (
                {'kind': 'continuous'} if turns else {}))
        forces = [parse_unit(one.unit) for one in self.tau]
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
    base = _SET.sub('', base).strip() or base
    for coordinate, q_unit in known.items():
        # Whole, or as a part of a path: /joint_states/elbow/velocity.
        _, found, rest = f'/{base.lower()}/'.partition(f'/{coordinate.lower()}/')
        if found:
            role = column_of(rest, {}).role if rest else Q
            return Column(name, role, coordinate, coordinate, _kind_of(q_unit), unit)
    words = _words_of(base)
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
    # The name of a joint tells its kind, that of its topic only that it is one.
    state = _JOINT_STATE.fullmatch(base)
    own = _words_of(state['joint']) if state else []
    kind = kind or next((_KINDS[word] for word in [*own, *words, letter] if word in _KINDS), '')
    role = next((role for role in (
        UNUSED, ENABLED, COMMAND, TIME, TRIAL, A, V, TAU, Q) if role in roles), by_unit)
    if role == COMMAND and (roles & {A, V, TAU} or order):
        role = UNUSED
    if role == Q and order:
        role = V if order == 1 else A
    return Column(name, TIME if by_unit == TIME else role, ' '.join(key), letter, kind, unit)


def _words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, without accents."""
    return [word.lower() for word in _WORD.findall(
        normalize('NFKD', name.translate(_GREEK)).encode('ascii', 'ignore').decode())]


def _by_unit(unit: str) -> tuple[str, str]:
    """Return the kind of coordinate and the role that a unit tells, or ''."""
    known = parse_unit(unit)
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


def read_header(path: Path, coordinates: Sequence[Coordinate] = (), counts: float | None = None
                ) -> Reading:
    """
    Find out what the columns of a log are.

    Parameters
    ----------
    path : Path
        Path of the log.
    coordinates : sequence of Coordinate
        Coordinates of the scene or model, which the log is to have; none: as in the log.
    counts : float, optional
        Counts per turn of a coordinate; default: those in the lines above the names.

    Raises
    ------
    DataError
        The log has no times or no coordinates, or there are two readings; the message has the
        ``data`` section of one of them.

    """
    table, doubts = read_log(path, LogFormat()), list[str]()
    _check_named(path, table.names, coordinates)
    names = [COLUMN.format(k + 1) if name in table.names[:k] else name
             for k, name in enumerate(table.names)]
    doubts += [f'two columns are called {name!r}' for k, name in enumerate(table.names)
               if name in table.names[:k]]
    columns = [column_of(name, {one.name: one.q_unit for one in coordinates}) for name in names]
    # Momenta, as in logs of this package.
    columns = [replace(one, role=UNUSED) if one.name.startswith('p_')
               and one.name.removeprefix('p_') in names else one for one in columns]
    values = dict(zip(names, table.numbers.T, strict=True))
    time = _time_of(path, columns, values)
    t = values[time.name]
    values = {name: without_sentinels(x, t, name, []) for name, x in values.items()}
    moves = [bool(np.nanmax(values[one.name], initial=-np.inf)
                  > np.nanmin(values[one.name], initial=np.inf)) for one in columns]
    named, still = columns, [one.name for one, changes in zip(columns, moves, strict=True)
                             if one.role in (Q, V, TAU) and not changes]
    columns = [one for one, changes in zip(columns, moves, strict=True)
               if changes or one.role in (COMMAND, ENABLED)]
    trials = [one for one in columns if one.role == TRIAL]
    q = _coordinates(path, columns, coordinates, still, doubts)
    others = {_joint(one) for one in named if one.role == Q} - {_joint(one) for one in q}
    rates, forces, commands = ([one for one in columns if one.role == role
                                and _joint(one) not in others] for role in (V, TAU, COMMAND))
    settings = _settings(table.above) | ({} if counts is None else {'counts': counts})
    if parse_unit('count') not in [parse_unit(one.q_unit) for one in coordinates]:
        q = [_counted(path, one, values[one.name], settings) for one in q]
    if not coordinates:
        q = [_with_kind(path, one, len(q), rates + forces, doubts) for one in q]
        q.sort(key=lambda one: one.kind == ANGLE)  # carts come first in a chain
    v = _columns_of(q, rates, 'velocity', doubts)
    tau = _forces_of(path, q, forces, 'torque_constant' in settings, doubts)
    doubts += [f'{one.name!r} has an unknown unit' for one in [*q, *v, *tau]
               if not one.unit and _BRACKETED.search(one.name)]
    units = {time.name: _time_unit(time, t, bool(coordinates), doubts)} | {
        one.name: _unit(one, values[one.name], doubts) for one in q}
    units |= {one.name: one.unit for one in q if one.unit and not split_unit(one.name)[1]}
    renamed = {name: f'{name} [{unit}]' if unit else name for name, unit in units.items()}
    turns = [one.kind == ANGLE and _turns(t, values[one.name] * (
        2.0 * np.pi / settings['counts'] if one.unit == 'count' else _size(renamed[one.name])))
             for one in q]
    commands = _columns_of(q, commands, 'command', [])
    # Beside forces, commands of some joints are of another controller.
    commands = commands if len(commands) == len(q) or not tau else []
    # A command has the unit of its coordinate, unless it has one of its own.
    renamed |= {one.name: f'{one.name} [{unit}]' for k, one in enumerate(commands) for other in (
        q[k:k + 1] if len(commands) == len(q) else [own for own in q if own.key == one.key])
        if not one.unit and (unit := units[other.name] or other.unit)}
    commands, enabled = ([replace(one, name=renamed.get(one.name, one.name)) for one in ones]
                         for ones in (commands, [one for one in columns if one.role == ENABLED]))
    uses = {'counts': any(one.unit == 'count' for one in q),
            'torque_constant': any(split_unit(one.name)[1] != one.unit for one in tau)}
    time, *q = (replace(one, name=renamed[one.name]) for one in (time, *q))
    names = [renamed.get(name, name) for name in names]
    reading = Reading(path, names if names != table.names else [], time, [*trials, None][0], q,
                      v if len(v) == len(q) else [], tau, turns,
                      commands, enabled,
                      {key: x for key, x in settings.items() if uses[key]}, still)
    if doubts:
        raise _refusal(doubts[0], reading)
    return reading


def _check_named(path: Path, names: list[str], coordinates: Sequence[Coordinate]) -> None:
    """Raise DataError unless a log has a header above several columns."""
    if len(names) < 2:
        raise DataError(f'{path}: one column of numbers, expected times and coordinates')
    if names[0] == COLUMN.format(1):
        first = ['t [s]', *([one.name for one in coordinates] or ['angle [rad]'])][:len(names)]
        q = [Column(name, Q) for name in first[1:]]
        raise _refusal(f'has no header above its {counted(len(names), "column")}', Reading(
            path, first + names[len(first):], Column(first[0], TIME), None, q, [], [], []))


def _refusal(doubt: str, reading: Reading) -> DataError:
    """Return the error of a log that may be read in another way, with the data of this one."""
    section = safe_dump(reading.data, default_flow_style=True, width=np.inf, sort_keys=False,
                        allow_unicode=True).strip()
    return DataError(f'{reading.path}: {doubt}; rename columns, or write the data of a '
                     f'configuration, such as data: {section}')


def _settings(above: Sequence[str]) -> dict[str, float]:
    """Return the counts per turn and the force per current of a coordinate, as far as known."""
    found = dict[str, float]()
    for line in above:
        for name, pattern in _SETTINGS.items():
            if match := pattern.search(line):
                size, _ = parse_unit(match['of'] or match['unit']) or (1.0, {})
                x, to = float(match['x']), float(match['to'] or 1.0)
                found[name] = max(x / to, to / x) if match['to'] else x * size
    gear = found.pop('gear', 1.0)
    return {name: gear * x for name, x in found.items()}


def _counted(path: Path, one: Column, x: np.ndarray, settings: Mapping[str, float]) -> Column:
    """Return a coordinate as an angle if it is in counts; DataError without counts per turn."""
    whole = not one.unit and _COUNTED & {*_words_of(one.name)} and (
        np.nanmax(np.abs(x)) > _MOST[LENGTH] and not np.nanmax(np.abs(x - np.round(x))))
    if not whole and parse_unit(one.unit) != parse_unit('count'):
        return one
    if 'counts' not in settings:
        raise DataError(f'{path}: {one.name!r} is in counts; give those of a turn with --counts '
                        'N, or in a line above the names, such as # counts per turn: N')
    return replace(one, kind=ANGLE, unit='count')


def _size(name: str) -> float:
    """Return the size of the unit in a name, 1 if it has none."""
    return (parse_unit(split_unit(name)[1]) or (1.0,))[0]


def _time_of(path: Path, columns: Sequence[Column], values: Mapping[str, np.ndarray]) -> Column:
    """Return the column of times, which mostly increase."""
    times = [one for one in columns if one.role == TIME]
    places = [one.name for one in columns if one.role == Q] or ['']
    # The stamp in the header of the coordinates' topic comes before the clock of a receiver.
    times.sort(key=lambda one: not ({'header', 'stamp'} <= {*_words_of(one.name)} and places[
        0].startswith(one.name.partition('header')[0])))
    for one in times:
        steps = np.diff(values[one.name][np.isfinite(values[one.name])])
        if (steps > 0.0).sum() > 0.5 * len(steps):
            return one
    for one in times:
        if text := repeated_text(values[one.name]):
            raise DataError(f'{path}: column {one.name!r}: {text}')
    back = [one.name for one in times if np.isfinite(values[one.name]).any()]
    raise DataError(f'{path}: no column of times that increase: ' + (
        f'{listed(back)} goes back; sort the rows by time' if back else
        f'{listed(one.name for one in columns)}; name it t [s], and write seconds'))


def _time_unit(time: Column, t: np.ndarray, known: bool, doubts: list[str]) -> str:
    """Return the unit of times without one, '' if it is s; inferred from times since 1970."""
    interval, latest = float(np.nanmedian(np.abs(np.diff(t)))), float(np.nanmax(t))
    sizes = {unit: _size(f't [{unit}]') for unit in ('s', 'ms', 'us', 'ns')}
    dates = [unit for unit, size in sizes.items() if _DATES[0] < latest * size < _DATES[1]]
    if time.unit or dates == ['s'] or (not dates and (known or interval < _DOUBTFUL)):
        return ''
    if not dates:
        doubts.append(f'the times {time.name!r} lie {interval:.6g} apart, in s or another unit')
    short = [unit for unit, size in sizes.items() if interval * size < _DOUBTFUL]
    return [*dates, *short, 'ns'][0]


def _coordinates(path: Path, columns: Sequence[Column], coordinates: Sequence[Coordinate],
                 still: Sequence[str], doubts: list[str]) -> list[Column]:
    """Return the columns of the coordinates, in the order of the given ones."""
    others = f' (left out, constant or without numbers: {listed(still)})' if still else ''
    q = [one for one in columns if one.role == Q]
    if not q:
        unknown = [one for one in columns if one.role == UNKNOWN]
        q = unknown if len(unknown) == 1 else [one for one in unknown if one.kind]
    if not q:
        raise DataError(f'{path}: no column of a coordinate: '
                        f'{listed(one.name for one in columns)}{others}; '
                        f'{"move it, or " * bool(still)}name it angle [rad] or x [m]')
    if coordinates:
        exact = [[one for one in q if one.letter == other.name] or [
            one for one in q if _joint(one) == _joint(column_of(other.name, {}))]
                 for other in coordinates]
        if all(len(ones) == 1 for ones in exact):
            return [replace(ones[0], kind=ones[0].kind or _kind_of(other.q_unit))
                    for ones, other in zip(exact, coordinates, strict=True)]
        fits = len(q) == len(coordinates) and all(
            not one.kind or not _kind_of(other.q_unit) or one.kind == _kind_of(other.q_unit)
            for one, other in zip(q, coordinates, strict=True))
        if not (fits and (len(q) == 1 or all(one.key.isdigit() for one in q))):
            doubts.append(f'the columns {listed(one.name for one in columns)}{others} do not say '
                          'which is '
                          f'{listed(one.name for one in coordinates)}')
        return [replace(one, kind=_kind_of(other.q_unit))
                for one, other in zip(q, coordinates, strict=False)]
    distinct = list[Column]()
    for one in q:
        same = [other for other in distinct if one.key == other.key and (
            one.letter == other.letter or '' in (one.letter, other.letter))]
        if same:
            doubts.append(f'{same[0].name!r} and {one.name!r} may be the same coordinate')
        distinct += [] if same else [one]
    return distinct


def _joint(one: Column) -> tuple[str, str]:
    return one.key, one.letter


def _with_kind(path: Path, one: Column, count: int, others: Sequence[Column],
               doubts: list[str]) -> Column:
    """Return a coordinate with its kind, by its name, velocity or force."""
    kinds = {other.kind for other in others if other.kind and (count == 1 or other.key == one.key)}
    if one.unit and not one.kind:
        raise DataError(f'{path}: {one.name!r} is in {one.unit}, which is no unit of angles or '
                        f'lengths; convert it, or write a configuration with q_unit: {one.unit}')
    if not one.kind and len(kinds) != 1:
        doubts.append(f'{one.name!r} may be an angle [rad] or a length [m]')
    return one if one.kind else replace(one, kind=[*kinds, ANGLE][0])


def _columns_of(q: Sequence[Column], found: Sequence[Column], what: str, doubts: list[str]
                ) -> list[Column]:
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
        doubts.append(f'the {what} of {q[0].name!r} may be '
                      f'{" or ".join(one.name for one in found[:3])}')
        return [*found][:len(q)]
    return [taken[k] for k in sorted(taken)]


def _forces_of(path: Path, q: Sequence[Column], found: Sequence[Column], by_current: bool,
               doubts: list[str]) -> list[Column]:
    """Return the forces of the coordinates; currents are torques if their constant is given."""
    tau = _columns_of(q, found, 'force', doubts)
    if by_current:
        tau = [replace(one, unit='N m') if parse_unit(one.unit) in _CURRENTS else one
               for one in tau]
    for one in tau:
        # Datasheets write kg cm for kgf cm.
        known = parse_unit(one.unit)
        if known is not None and 'kg' in known[1] and 's' not in known[1]:
            raise DataError(f'{path}: {one.name!r} is in {one.unit}, which is no unit of a force; '
                            'write one in its name, such as N m, kgf or kgf cm')
    return tau


def _unit(one: Column, x: np.ndarray, doubts: list[str]) -> str:
    """Return the likely unit of a coordinate without one, '' if its range is that of rad or m."""
    if one.unit or one.kind not in _MOST or _JOINT_STATE.fullmatch(one.name) or \
            np.nanquantile(np.abs(x), 0.99) <= _MOST[one.kind]:
        return ''
    other = 'deg' if one.kind == ANGLE else 'mm'
    doubts.append(f'{one.name!r} goes from {np.nanmin(x):.4g} to {np.nanmax(x):.4g}, in '
                  f'{one.kind} or {other}')
    # A whole turn at most: of an angle that is kept within it.
    return one.kind if one.kind == ANGLE and np.nanmax(x) <= 2.0 * np.pi else other


def _turns(t: np.ndarray, x: np.ndarray) -> bool:
    """Return whether an angle [rad] makes a whole turn."""
    x = x[np.isfinite(t) & np.isfinite(x)]
    return bool(np.ptp(unwrap_beside_glitches(np.arange(len(x)), x)) > 2.0 * np.pi)
