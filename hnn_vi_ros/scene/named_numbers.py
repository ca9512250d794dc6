# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a scene's Hamiltonian and effects by name; setting values of any key."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from hnn_vi_ros.errors import listed
from hnn_vi_ros.scene.scene import Scene

_KEYS = ('hamiltonian', 'effects')


def numbers_of(scene: Scene) -> dict[str, float]:
    """Return the numbers: ``hamiltonian.mass``; ``effects.0.stiffness`` of the first effect."""
    values = scene.model_dump(include=set(_KEYS))
    return {name: value for key in _KEYS for name, value in numbers_in(key, values[key])}


def with_numbers(scene: Scene, numbers: Mapping[str, float]) -> Scene:
    """
    Return a scene with other values of some numbers.

    Parameters
    ----------
    scene : Scene
        Scene to change.
    numbers : mapping of str to float
        Values by name, as in ``numbers_of``.

    Raises
    ------
    ValueError
        A number does not exist; the message names those that do.
    SceneError
        A value is out of range.

    """
    check_names(scene, numbers)
    return with_known_numbers(scene, numbers)


def with_known_numbers(scene: Scene, numbers: Mapping[str, float]) -> Scene:
    """Return the scene with other numbers, whose names have already been checked."""
    return with_values(scene, {tuple(name.split('.')): value for name, value in numbers.items()})


def with_values(scene: Scene, values: Mapping[tuple[str | int, ...], Any]) -> Scene:
    """
    Return a scene with other values of some keys.

    Parameters
    ----------
    scene : Scene
        Scene to change.
    values : mapping
        Values by path, such as ``('effects', 0, 'rate')``.

    Raises
    ------
    SceneError
        The schema rejects a value.

    """
    if not values:
        return scene
    data = scene.model_dump(include={str(path[0]) for path in values})
    for path, value in values.items():
        set_value(data, path, value)
    return scene.changed(data)


def set_value(place: Any, path: Sequence[str | int], value: Any) -> None:
    """Set a value in plain data at a path of names and indices."""
    for key in path[:-1]:
        place = place[_index(place, key)]
    place[_index(place, path[-1])] = value


def check_names(scene: Scene, names: Iterable[str]) -> None:
    """Raise ValueError, with the existing names, if a scene lacks one of these numbers."""
    check_known(scene.name, names, numbers_of(scene))


def check_known(owner: str, names: Iterable[str], known: Mapping[str, float]) -> None:
    """Raise ValueError, with the known names, if a name is unknown."""
    for name in names:
        if name not in known:
            raise ValueError(f'{owner} has no number {name!r}; it has: {listed(known) or "none"}')


def numbers_in(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield all numbers in a nested value, with names."""
    if isinstance(value, float):
        yield name, value
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from numbers_in(f'{name}.{key}', part)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from numbers_in(f'{name}.{i}', part)


def _index(place: Any, key: str | int) -> str | int:
    return int(key) if isinstance(place, list) else key
