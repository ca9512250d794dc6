# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Write a scene with other numbers, and keep the rest of its file unchanged."""

from collections.abc import Mapping, Sequence
import os
from pathlib import Path
import re
import shutil

from hnn_vi_ros.errors import HnnViRosError, SceneError
from hnn_vi_ros.files.regular_file import write_new_scene
from hnn_vi_ros.files.resources import share_folder
from hnn_vi_ros.files.yaml_text import root_node
from hnn_vi_ros.learning.scene_numbers.free_numbers import DELAY, FreeScene
from hnn_vi_ros.learning.scene_numbers.robot import robot_file
from hnn_vi_ros.scene import load_scene
import yaml

_SCHEMA = re.compile(r'(?m)^# yaml-language-server: \$schema=.*$')


def write_fitted(path: Path, free: FreeScene, values: Sequence[float],
                 initial_state: Mapping[str, Sequence[float]] | None) -> None:
    """
    Write a scene, and next to it the URDF of its robot if numbers of that were free.

    Parameters
    ----------
    path : Path
        A new file.
    free : FreeScene
        The scene, from a file.
    values : sequence of float
        Of its free numbers; a delay is no number of a scene, and is told in a comment.
    initial_state : mapping of str to sequence of float, or None
        q and p, in place of the scene's.

    Raises
    ------
    SceneError
        The file exists already, or cannot be written.

    """
    scene, delay = free.at(values)
    text = free.scene.source.read_text(encoding='utf-8')
    changes: dict[tuple[str, ...], str] = {
        tuple(number.place.split('.')): repr(float(value))
        for number, value in zip(free.numbers, values, strict=True)
        if number.place != DELAY and number.place not in free.robot}
    if initial_state is not None:
        changes |= {('initial_state', key): str([float(one) for one in part])
                    for key, part in initial_state.items()}
    if free.robot & {number.place for number in free.numbers}:
        robot = path.with_suffix('.urdf')
        if robot.exists():
            raise SceneError(f'{robot}: exists already; name another scene file')
        changes['hamiltonian', 'file'] = robot.name
    for name, file in free.scene.model_files().items():
        # Paths relative to its own folder would not lead anywhere from the new file's folder.
        if '/' in name and '://' not in name:
            text = text.replace(name, os.path.relpath(file.resolve(), path.resolve().parent))
    text = edited(text, changes)
    schema = f'# yaml-language-server: $schema={share_folder() / "config" / "scene.schema.json"}'
    text = _SCHEMA.sub(lambda line: schema, text)
    if any(number.place == DELAY for number in free.numbers):
        text += f'# Measured forces acted {delay:.9g} s late.\n'
    write_new_scene(path, text)
    if ('hamiltonian', 'file') in changes:
        shutil.copy(robot_file(scene), path.with_suffix('.urdf'))
    try:
        load_scene(path).create_hamiltonian()
    except HnnViRosError as problem:
        raise SceneError(f'{path}: was written, but is no scene: {problem}') from problem


def edited(text: str, changes: Mapping[tuple[str, ...], str]) -> str:
    """Return YAML with other values of some keys; missing keys are added."""
    root = root_node(text)
    spans: list[tuple[int, int, str]] = []
    for key, value in changes.items():
        node = root
        for k, part in enumerate(key):
            if isinstance(node, yaml.SequenceNode):
                node = node.value[int(part)]
                continue
            own = {name.value: item for name, item in node.value}
            if part not in own:
                spans.append(_added(text, node, '.'.join(key[k:]), value))
                break
            node = own[part]
        else:
            spans.append((node.start_mark.index, node.end_mark.index, value))
    for start, end, value in sorted(spans, reverse=True):
        text = text[:start] + value + text[end:]
    return text


def _added(text: str, node: yaml.MappingNode, key: str, value: str) -> tuple[int, int, str]:
    """Return where a key is added to a mapping, and what."""
    if node.flow_style:
        end = node.end_mark.index - 1
        return end, end, f', {key}: {value}'
    first, item = node.value[0]
    end = text.find('\n', item.end_mark.index - (item.end_mark.column == 0))
    end = len(text) if end < 0 else end
    return end, end, f'\n{" " * first.start_mark.column}{key}: {value}'
