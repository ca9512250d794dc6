# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Units in the names of columns, and their conversion."""

from collections import Counter
import math
import re

Dimensions = dict[str, int]
_FORCE: Dimensions = {'kg': 1, 'm': 1, 's': -2}
_TORQUE: Dimensions = {'kg': 1, 'm': 2, 's': -2}
# Spellings of each unit, its size in SI units, and its dimensions; angles have none.
_UNITS: tuple[tuple[str, float, Dimensions], ...] = (
    ('s sec secs second seconds sek sekunden secondes segundos secondi', 1.0, {'s': 1}),
    ('ms msec msecs millis millisecond milliseconds', 1e-3, {'s': 1}),
    ('us usec usecs µs μs micros microsecond microseconds', 1e-6, {'s': 1}),
    ('ns nsec nsecs nanos nanosecond nanoseconds', 1e-9, {'s': 1}),
    ('min minute minutes', 60.0, {'s': 1}), ('h hour hours', 3600.0, {'s': 1}),
    ('rad rads radian radians 1', 1.0, {}), ('mrad', 1e-3, {}),
    # Grad is German; no logger counts the 400 gon of a turn.
    ('deg degs degree degrees ° º grad degré degrés degre degres grado grados gradi graden grader '
     'graus', math.pi / 180.0, {}),
    ('rev revs turn turns', 2.0 * math.pi, {}), ('rpm', math.pi / 30.0, {'s': -1}),
    ('dps', math.pi / 180.0, {'s': -1}), ('m meter meters metre metres', 1.0, {'m': 1}),
    ('cm', 1e-2, {'m': 1}), ('mm', 1e-3, {'m': 1}), ('um µm μm', 1e-6, {'m': 1}),
    ('km', 1e3, {'m': 1}), ('in inch', 0.0254, {'m': 1}), ('ft', 0.3048, {'m': 1}),
    ('kg', 1.0, {'kg': 1}), ('N newton newtons', 1.0, _FORCE), ('mN', 1e-3, _FORCE),
    ('kN', 1e3, _FORCE), ('kgf kp', 9.80665, _FORCE), ('gf', 9.80665e-3, _FORCE),
    ('lbf', 4.4482216152605, _FORCE), ('ozf', 0.27801385095378125, _FORCE),
    ('Nm nm NM', 1.0, _TORQUE), ('mNm Nmm', 1e-3, _TORQUE),
    ('Ncm', 1e-2, _TORQUE), ('kNm', 1e3, _TORQUE),
    ('J', 1.0, _TORQUE), ('V volt volts', 1.0, {'V': 1}), ('mV', 1e-3, {'V': 1}),
    ('A amp amps ampere', 1.0, {'A': 1}), ('mA', 1e-3, {'A': 1}), ('% percent', 1.0, {'%': 1}),
    ('px pixel pixels', 1.0, {'px': 1}), ('count counts tick ticks', 1.0, {'count': 1}))
_TABLE = {name: (size, dimensions) for names, size, dimensions in _UNITS for name in names.split()}
# Words that are units wherever they stand in a name; other words are so in brackets or at the end.
_CLEAR = frozenset((
    'deg', 'degs', 'degree', 'degrees', '°', 'º', 'rad', 'mrad', 'mm', 'cm', 'ms', 'msec', 'us',
    'usec', 'µs', 'ns', 'nsec', 'millis', 'micros', 'nanos', 'milliseconds', 'microseconds',
    'nanoseconds', 'rpm', 'dps'))
_BRACKETED = re.compile(r'[\[(]([^\[\]()]*)[\])]')
# A name up to a place that is in brackets, behind another word.
_BEHIND_WORD = re.compile(r'.*[\[(][^\[\]()]*\w[^\[\]()]*')
_WORD = re.compile(r'[^\W\d_]+|[°º%]')
_FACTOR = re.compile(r'([^\W\d_]+|[°º%1])\^?([-+]?\d)?')
# Longest name that is searched for a unit [characters]: words are compared with those before.
_LONGEST_NAME = 500
# Number of words at the end of a name that may form a unit.
_MOST_WORDS = 8
_POWERS = str.maketrans('⁰¹²³⁴⁵⁶⁷⁸⁹⁻', '0123456789-')


def _base_unit(word: str) -> tuple[float, Dimensions] | None:
    return _TABLE.get(word) or _TABLE.get(word.lower())


def parse_unit(unit: str) -> tuple[float, Dimensions] | None:
    """Return the size of a unit in SI units and its dimensions; None if it is unknown."""
    size, dimensions = 1.0, Counter[str]()
    for number, part in enumerate(unit.translate(_POWERS).split('/')):
        factors = [factor for factor in re.split(r'[\s*·.⋅]+', part.strip()) if factor]
        for factor in factors:
            match = _FACTOR.fullmatch(factor)
            found = match and _base_unit(match[1])
            if not (match and found):
                return None
            power = int(match[2] or 1) * (-1 if number else 1)
            size *= found[0]**power
            for name, exponent in found[1].items():
                dimensions[name] += exponent * power
        if not (factors and 0.0 < size < math.inf):
            return None
    return size, {name: power for name, power in dimensions.items() if power}


def conversion(unit: str, target: str) -> float | None:
    """Return the factor from a unit to another; None if they measure different quantities."""
    one, other = parse_unit(unit), parse_unit(target)
    return None if one is None or other is None or one[1] != other[1] else one[0] / other[0]


def split_unit(name: str) -> tuple[str, str]:
    """
    Split a column's name, such as ``x [mm]``, ``theta_deg`` or ``rate_deg_s``, from its unit.

    Returns
    -------
    str, str
        Name without unit; unit as ``parsed`` reads it, '' if the name has none.

    """
    if len(name) > _LONGEST_NAME:
        return name, ''
    for match in _BRACKETED.finditer(name):
        if parse_unit(match[1]):
            return (name[:match.start()] + name[match.end():]).strip(), match[1].strip()
    words = [*_WORD.finditer(name)]
    for first, word in enumerate(words):
        if _BEHIND_WORD.fullmatch(name[:word.start()]):
            continue
        # A limit, because the words of a long name would be compared in pairs.
        rest = [other[0] for other in words[first:first + _MOST_WORDS]
                if other[0] not in ('per', 'in')]
        ending = 0 < first >= len(words) - _MOST_WORDS and rest and all(map(_base_unit, rest)) \
            and words[-1].end() >= len(name) - 1
        if ending or (word[0].lower() in _CLEAR and name[word.end():word.end() + 1] != '^'):
            # A second unit divides: deg_s, m_per_s2; N_m is a product.
            taken = rest if ending else rest[:1]
            over = [other for other in taken[1:] if _base_unit(other) == _TABLE['s']]
            power = name[words[-1].end():] if ending and over else ''
            unit = ' '.join(taken[:len(taken) - len(over)]) + ''.join(f'/{one}' for one in over)
            if parse_unit(unit + power):
                return name[:word.start()].rstrip('_ /,-'), unit + power
    return name, ''
