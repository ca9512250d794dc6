# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a scene's Hamiltonian and effects, by name."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from hnn_vi_ros.errors import listed
from hnn_vi_ros.scene import Scene

_KEYS = ('hamiltonian', 'effects')


def numbers_of(scene: Scene) -> dict[str, float]:
    """Return them: ``hamiltonian.mass``; ``effects.0.stiffness`` of the first effect."""
    values = scene.model_dump(include=set(_KEYS))
    return {name: value for key in _KEYS for name, value in _numbers(key, values[key])}


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
        *path, last = name.split('.')
        place: Any = values
        for key in path:
            place = place[_index(place, key)]
        place[_index(place, last)] = number
    return scene.changed(values)


def check_names(scene: Scene, names: Iterable[str]) -> None:
    """Raise ValueError, which names the numbers that there are, unless a scene has these."""
    known = numbers_of(scene)
    for name in names:
        if name not in known:
            raise ValueError(f'{scene.name} has no number {name!r}; it has: '
                             f'{listed(known) or "none"}')


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a value, however deep."""
    if isinstance(value, float):
        yield name, value
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from _numbers(f'{name}.{key}', part)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from _numbers(f'{name}.{i}', part)


def _index(place: Any, key: str) -> str | int:
    return int(key) if isinstance(place, list) else key
