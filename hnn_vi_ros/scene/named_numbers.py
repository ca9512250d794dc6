# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a scene's Hamiltonian and effects, by name."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from hnn_vi_ros.errors import listed
from hnn_vi_ros.scene import Scene

_KEYS = ('hamiltonian', 'effects')


def numbers_of(scene: Scene) -> dict[str, float]:
    """Return them: ``hamiltonian.mass``; ``effects.0.stiffness`` of the first effect."""
    values = scene.model_dump(include=set(_KEYS))
    return {name: value for key in _KEYS for name, value in numbers_in(key, values[key])}


def with_numbers(scene: Scene, numbers: Mapping[str, float]) -> Scene:
    """
    Return a scene with other values of some numbers.

    Parameters
    ----------
    scene : Scene
        Any.
    numbers : mapping of str to float
        By the names of ``numbers_of``.

    Raises
    ------
    ValueError
        There is no such number; names those that there are.
    SceneError
        A value is out of its range.

    """
    check_names(scene, numbers)
    return with_known_numbers(scene, numbers)


def with_known_numbers(scene: Scene, numbers: Mapping[str, float]) -> Scene:
    """Return what with_numbers does, of names that were checked."""
    if not numbers:
        return scene
    values = scene.model_dump(include={name.partition('.')[0] for name in numbers})
    for name, number in numbers.items():
        set_number(values, name.split('.'), number)
    return scene.changed(values)


def set_number(place: Any, path: Sequence[str], number: float) -> None:
    """Set a number in plain data by the names and indices that lead to it."""
    for key in path[:-1]:
        place = place[_index(place, key)]
    place[_index(place, path[-1])] = number


def check_names(scene: Scene, names: Iterable[str]) -> None:
    """Raise ValueError, which names the numbers that there are, unless a scene has these."""
    check_known(scene.name, names, numbers_of(scene))


def check_known(owner: str, names: Iterable[str], known: Mapping[str, float]) -> None:
    """Raise ValueError, which lists the numbers that are known, unless all names are of these."""
    for name in names:
        if name not in known:
            raise ValueError(f'{owner} has no number {name!r}; it has: {listed(known) or "none"}')


def numbers_in(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a value, however deep."""
    if isinstance(value, float):
        yield name, value
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from numbers_in(f'{name}.{key}', part)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from numbers_in(f'{name}.{i}', part)


def _index(place: Any, key: str) -> str | int:
    return int(key) if isinstance(place, list) else key
