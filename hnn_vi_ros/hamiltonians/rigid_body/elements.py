# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers, vectors, frames and names of XML elements."""

import math
import re
import warnings

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import Element
import numpy as np

# Without backtracking: the time is proportional to the length.
_NUMBER = re.compile(r'[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\Z')
_MAX_NAME_LENGTH = 200
# In SI units; larger numbers, whose products overflow, are mistakes. Limits may be any number.
_MAX_NUMBER = 1e12
# Elements that may repeat; the first counts, as in urdfdom.
_FIRST = ('inertial', 'origin', 'axis', 'limit', 'dynamics')


def frame_in(element: Element, place: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the origin and the rotation, about fixed axes x, y, z in turn, of its <origin>."""
    # Imported lazily: the import is slow, and scenes without robots do not need it.
    from scipy.spatial.transform import Rotation
    origin = only_child(element, 'origin', place)
    xyz = vector_of(origin, 'xyz', place, (0.0, 0.0, 0.0))
    if origin is None or 'quat_xyzw' not in origin.attributes:
        turn = Rotation.from_euler('xyz', vector_of(origin, 'rpy', place, (0.0, 0.0, 0.0)))
        return xyz, turn.as_matrix()
    if 'rpy' in origin.attributes:
        raise ModelError(f'{place}: origin has rpy and quat_xyzw; remove one of them')
    # As in urdfdom, it need not be normalised.
    quaternion = vector_of(origin, 'quat_xyzw', place, (0.0, 0.0, 0.0, 1.0))
    size = np.abs(quaternion).max()
    if not size > 0.0:
        raise ModelError(f'{place}: origin quat_xyzw = 0 0 0 0 is not a rotation; the identity is '
                         '0 0 0 1')
    return xyz, Rotation.from_quat(quaternion / size).as_matrix()


def vector_of(element: Element | None, key: str, place: str, default: tuple[float, ...]
              ) -> np.ndarray:
    """Return the numbers of an attribute, of the length of the default."""
    if element is None or key not in element.attributes:
        return np.array(default)
    number = len(default)
    words = element.attributes[key].split(maxsplit=number)
    if len(words) != number:
        count = f'more than {number}' if len(words) > number else len(words)
        raise ModelError(f'{place}: {element.tag} {key} has {count} numbers, expected {number}')
    return np.array([_float(word, f'{element.tag} {key}', place) for word in words])


def number_of(element: Element | None, key: str, place: str, default: float | None = None,
              largest: float = _MAX_NUMBER) -> float:
    """Return the number of an attribute; without a default it is required."""
    if element is None or key not in element.attributes:
        if default is None:
            assert element is not None, 'only a number that is optional may have no element'
            raise ModelError(f'{place}: {element.tag} without {key}; expected {key}="..."')
        return default
    return _float(element.attributes[key].strip(), f'{element.tag} {key}', place, largest)


def _float(word: str, name: str, place: str, largest: float = _MAX_NUMBER) -> float:
    value = float(word) if _NUMBER.match(word) else math.nan
    if not (math.isfinite(value) and abs(value) <= largest):
        bound = '' if largest == math.inf else f' of at most {largest:g}'
        raise ModelError(f'{place}: {name} = {word[:40]!r} must be a finite number{bound}')
    return value


def only_child(element: Element, tag: str, place: str) -> Element | None:
    """Return the child with a tag, None if there is none."""
    found = element.named(tag)
    if len(found) > 1 and tag in _FIRST:
        warnings.warn(f'{place}: {len(found)} times <{tag}>: the first counts, as in urdfdom',
                      stacklevel=2)
    elif len(found) > 1:
        raise ModelError(f'{place}: {len(found)} times <{tag}>, expected once; remove the others')
    return found[0] if found else None


def name_of(element: Element, where: str) -> str:
    """Return the name of a link or joint."""
    name = element.attributes.get('name', '')
    if not (name and name.isprintable() and len(name) <= _MAX_NAME_LENGTH):
        raise ModelError(f'{where}:{element.line}: {element.tag} name={name[:60]!r} must be 1 to '
                         f'{_MAX_NAME_LENGTH} printable characters')
    return name


def place_of(element: Element, where: str) -> str:
    """Return file, line, tag and name of an element, for errors."""
    name = element.attributes.get('name', '')
    return f'{where}:{element.line}: {element.tag}{f" {name!r}" * bool(name)}'
