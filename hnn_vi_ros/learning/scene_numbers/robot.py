# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a URDF, by name: of its links, and of the friction in its joints."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.hamiltonians.rigid_body.robot import Units
from hnn_vi_ros.hamiltonians.rigid_body.urdf import parse_urdf, read_urdf
from hnn_vi_ros.scene import Scene

_MOMENTS = 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'
_AXES = 'xyz'
# Where a number stands in a link or a joint: tags, an attribute, and which word of it.
_Place = tuple[tuple[str, ...], str, int | None]
_LINK: dict[str, _Place] = {
    'mass': (('inertial', 'mass'), 'value', None),
    **{f'centre_{axis}': (('inertial', 'origin'), 'xyz', k) for k, axis in enumerate(_AXES)},
    **{name: (('inertial', 'inertia'), name, None) for name in _MOMENTS}}
_JOINT: dict[str, _Place] = {
    'damping': (('dynamics',), 'damping', None), 'friction': (('dynamics',), 'friction', None)}
_UNITS = {'mass': 'kg', **{f'centre_{axis}': 'm' for axis in _AXES},
          **dict.fromkeys(_MOMENTS, 'kg m2')}


def robot_numbers(scene: Scene) -> dict[str, tuple[float, str]]:
    """Return value and unit of each: ``forearm.mass``, ``forearm.centre_z``, ``elbow.damping``."""
    if scene.hamiltonian.kind != 'urdf':
        return {}
    root = _parsed(robot_file(scene))
    own = {joint.get('name'): Units.of(joint.get('type', '')) for joint in root.findall('joint')}
    return {f'{owner}.{name}': (_value(element, attribute, word), _UNITS.get(name) or (
        own[owner].damping if name == 'damping' else own[owner].force))
            for owner, name, element, attribute, word in _numbers(root)}


def robot_file(scene: Scene) -> Path:
    """Return the file of the robot of a scene."""
    return scene.model_files()[scene.hamiltonian.file]


def with_robot_numbers(scene: Scene, numbers: Mapping[str, float], file: Path) -> Scene:
    """
    Return a scene whose robot has other numbers, from a URDF that is written for it.

    Raises
    ------
    ModelError
        No body could be a link with these numbers, whatever it is fixed to.

    """
    root = _parsed(robot_file(scene))
    for owner, name, element, attribute, word in _numbers(root):
        place = f'{owner}.{name}'
        if place not in numbers:
            continue
        text = repr(float(numbers[place]))
        if word is not None:
            words = element.get(attribute, '0 0 0').split()
            words[word] = text
            text = ' '.join(words)
        element.set(attribute, text)
    text = ElementTree.tostring(root, encoding='unicode') + '\n'
    file.write_text(text, encoding='utf-8')
    links = parse_urdf(text.encode(), str(file)).links
    for owner, _, name in (place.rpartition('.') for place in numbers):
        inertial = links[owner].inertial if name in _LINK else None
        if inertial is not None and inertial.fault:
            raise ModelError(f'{links[owner].place}: {inertial.fault}')
    choice = scene.hamiltonian.model_dump()
    return scene.changed({'hamiltonian': {**choice, 'file': str(file.resolve())}})


def _parsed(file: Path) -> ElementTree.Element:
    return deepcopy(_read(file, file.stat().st_mtime_ns))


@lru_cache(4)
def _read(file: Path, changed: int) -> ElementTree.Element:
    # The reader of robots first: it refuses all that XML could do besides holding elements.
    text = read_urdf(file).text
    builder = ElementTree.TreeBuilder(insert_comments=True)
    return ElementTree.fromstring(text, ElementTree.XMLParser(target=builder))


def _numbers(root: ElementTree.Element
             ) -> Iterator[tuple[str, str, ElementTree.Element, str, int | None]]:
    """Yield the owner, the name and the place of each number that the file gives."""
    for tag, places in (('link', _LINK), ('joint', _JOINT)):
        for owner in root.findall(tag):
            for name, (path, attribute, word) in places.items():
                element = owner.find('/'.join(path))
                if element is not None and attribute in element.attrib:
                    yield owner.get('name', ''), name, element, attribute, word


def _value(element: ElementTree.Element, attribute: str, word: int | None) -> float:
    text = element.attrib[attribute]
    return float(text if word is None else text.split()[word])
