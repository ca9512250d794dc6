# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Keys of a scene, with dots: which there are, and a scene with other values of some."""

from collections.abc import Mapping, Sequence
from typing import Any

from hnn_vi_ros.errors import DataError, did_you_mean, listed
from hnn_vi_ros.scene import Scene

_STATE = 'initial_state'


def find_key(scene: Scene, key: str, names: Mapping[str, Sequence[str]], place: str
             ) -> tuple[str | int, ...]:
    """
    Return the parts of a key, such as ``('effects', 0, 'rate')``.

    Parameters
    ----------
    scene : Scene
        Of which it is a key.
    key : str
        With dots. In the initial state the name of a coordinate is a key as well.
    names : mapping of sequence of str
        Names of the columns of q and of p, under these two.
    place : str
        Where the key stands, for errors.

    Raises
    ------
    DataError
        No such key; names those that are valid.

    """
    value: Any = scene.model_dump()
    parts: list[str | int] = []
    for part in key.split('.'):
        if isinstance(value, Mapping):
            valid = list(value)
        elif isinstance(value, list):
            valid = [str(k) for k in range(len(value))]
            own = names[str(parts[1])] if len(parts) == 2 and parts[0] == _STATE else []
            valid += own
        else:
            raise DataError(f'{place}: {key!r}: {".".join(map(str, parts))} is a value, which '
                            'has no further keys')
        if part not in valid:
            raise DataError(f'{place}: {key!r}: unknown key {part!r}'
                            f'{did_you_mean(part, valid)}; valid keys: {listed(valid) or "none"}')
        if isinstance(value, list):
            parts.append(own.index(part) if part in own else int(part))
        else:
            parts.append(part)
        value = value[parts[-1]]
    if parts[0] in ('description', 'mechanism', 'uncertainty'):
        raise DataError(f'{place}: {key!r} changes no trajectory')
    return tuple(parts)


def with_values(scene: Scene, values: Mapping[tuple[str | int, ...], Any]) -> Scene:
    """
    Return a scene with other values of some keys.

    Parameters
    ----------
    scene : Scene
        As it is.
    values : mapping
        By the parts of a key; see ``find_key``.

    Raises
    ------
    SceneError
        A value that the schema refuses.

    """
    data = scene.model_dump()
    for key, value in values.items():
        owner: Any = data
        for part in key[:-1]:
            owner = owner[part]
        owner[key[-1]] = value
    changed = dict.fromkeys(str(key[0]) for key in values)
    return scene.changed({name: data[name] for name in changed}) if changed else scene
