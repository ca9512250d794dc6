# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a scene and its robot that can be identified, and the scene with other values."""

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import lru_cache
import math
import os
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from hnn_vi_ros.errors import did_you_mean, HnnViRosError, ModelError, ParameterError, SceneError
from hnn_vi_ros.files import (
    root_node, share_folder, units_in, write_bytes, write_new_scene, write_text)
from hnn_vi_ros.hamiltonians import (
    ElasticDrive, Hamiltonian, JointUnits, parse_urdf, read_urdf)
from hnn_vi_ros.identify.loads import Load, load_numbers, load_of, with_load
from hnn_vi_ros.learning import DELAY, ModelParts, Number
from hnn_vi_ros.scene import load_scene, numbers_of, Parts, Scene, with_numbers
import numpy as np
import yaml

# Name of the initial states of the windows, which are no numbers of the scene.
STATES = 'initial_state'


@dataclass(frozen=True)
class FreeScene:
    """
    A scene with free numbers.

    Parameters
    ----------
    scene : Scene
        Scene with all other values.
    numbers : tuple of Number
        Tuple of n numbers.
    folder : Path
        Folder for temporary URDF files of a robot with free numbers.
    robot : frozenset of str
        Places of numbers that belong to the robot.
    held : tuple of Number
        Numbers fixed at their start.
    loads : mapping of str to Load
        Loads of the logs by name; none if they do not differ.
    load : str
        Name of the load that the scene carries; '' for that of the scene.

    """

    scene: Scene
    numbers: tuple[Number, ...]
    folder: Path
    robot: frozenset[str] = frozenset()
    held: tuple[Number, ...] = ()
    loads: Mapping[str, Load] = field(default_factory=dict)
    load: str = ''

    @property
    def name(self) -> str:
        """Return the name of the scene."""
        return self.scene.name

    def parts_at(self, values: Sequence[float] | np.ndarray) -> ModelParts:
        """Return the parts of the scene at values of the numbers; see ParametricModel."""
        scene, delay = self.at(values)
        _, hamiltonian, integrator, effects = scene.parts()
        return ModelParts(hamiltonian, integrator, effects, scene.known_step_size,
                          scene.on_failure, delay)

    def load_of(self, motion: str) -> str:
        """Return the name of the load of a motion."""
        return load_of(self.loads, motion)

    def carrying(self, load: str) -> 'FreeScene':
        """Return the scene with one of the loads."""
        return replace(self, load=load)

    def holding(self, k: int) -> 'FreeScene':
        """Return the scene with one number fixed at its initial guess."""
        return replace(self, numbers=self.numbers[:k] + self.numbers[k + 1:],
                       held=(*self.held, self.numbers[k]))

    def starting_at(self, values: Sequence[float] | np.ndarray) -> 'FreeScene':
        """Return the scene with other initial guesses of its numbers."""
        return replace(self, numbers=tuple(replace(number, start=float(value)) for number, value in
                                           zip(self.numbers, values, strict=True)))

    def at_step(self, step_size: float) -> 'FreeScene':
        """Return the scene with another step size [s]."""
        return replace(self, scene=self.scene.with_overrides(step_size))

    def at(self, values: Sequence[float] | np.ndarray) -> tuple[Scene, float]:
        """Return the scene with values of the free numbers, and the delay of its input [s]."""
        given = dict(zip((number.place for number in self.numbers), map(float, values),
                         strict=True)) | {number.place: number.start for number in self.held}
        delay = given.pop(DELAY, 0.0)
        robot = {place: given.pop(place) for place in [*given] if place in self.robot}
        carried = {place: given.pop(place) for place in load_numbers(self.loads) if place in given}
        scene = with_numbers(self.scene, given)
        if robot:
            scene = with_robot_numbers(scene, robot, self.folder / 'robot.urdf')
        if self.load:
            before, own = f'{self.load}.payload.', self.loads[self.load]
            scene = with_load(scene, own, {
                place.removeprefix(before): value for place, value in carried.items()
                if place.startswith(before)})
        return scene, delay


def free_scene(parts: Parts, names: Sequence[str], bounds: Mapping[str, tuple[float, float]],
               folder: Path, driven: bool, loads: Mapping[str, Load] | None = None) -> FreeScene:
    """
    Return a scene in which the named numbers are free.

    Parameters
    ----------
    parts : Parts
        Parts of the scene.
    names : sequence of str
        ``mass`` of H; ``damping.rate`` of the effect of that kind, ``damping.1.rate`` of the
        second one; ``forearm.mass`` of a link of a URDF; input_delay; or places, such as
        ``hamiltonian.mass`` and ``effects.0.rate``.
    bounds : mapping of str to (float, float)
        Bounds by name; the others have the bounds that the scene allows.
    folder : Path
        Folder for temporary files; see FreeScene.
    driven : bool
        True if the motions have measured forces, which input_delay needs.
    loads : mapping of str to Load, optional
        Loads of the logs, whose free numbers are free too.

    Raises
    ------
    ParameterError
        A name is unknown or repeated, or bounds do not contain the number.

    """
    scene = parts.scene
    known, robot = _known(scene), robot_numbers(scene)
    units = _units(scene, parts.hamiltonian)
    valid = {**known, **{name: name for name in robot}, **({DELAY: DELAY} if driven else {})}
    values = {**numbers_of(scene), **{name: value for name, (value, _) in robot.items()},
              DELAY: 0.0}
    numbers: list[Number] = []
    for name in names:
        place = valid.get(name) or (name if name in values and name != DELAY else None)
        if place is None:
            late = '; the data contain no forces that could be delayed' * (name == DELAY)
            raise ParameterError(f'--free {name}: {scene.name} has no such number'
                                 f'{did_you_mean(name, valid)}{late}; valid: '
                                 f'{", ".join([*valid, STATES])}')
        if place in [number.place for number in numbers]:
            raise ParameterError(f'--free {name}: is named twice; name it once')
        numbers.append(_number(name, place, values[place], units.get(place, ''), bounds))
    numbers += [_number(name, name, value, unit, bounds)
                for name, (value, unit) in load_numbers(loads or {}).items()]
    free = FreeScene(scene, tuple(numbers), folder, frozenset(robot), loads=loads or {})
    return replace(free, numbers=tuple(_within(free, k) for k in range(len(numbers))))


def _number(name: str, place: str, start: float, unit: str,
            bounds: Mapping[str, tuple[float, float]]) -> Number:
    low, high = bounds.get(name, (-math.inf, math.inf))
    if not low < high:
        raise ParameterError(f'--bounds {name} {low:g} {high:g}: expected two numbers, the lower '
                             'first')
    if not low <= start <= high:
        if name not in bounds or not (math.isfinite(low) and math.isfinite(high)):
            raise ParameterError(f'--bounds {name} {low:g} {high:g}: they do not enclose its '
                                 f'value in the scene, {start:g}; change the bounds or the scene')
        start = 0.5 * (low + high)
    return Number(name, place, unit, start, low, high)


def _within(free: FreeScene, k: int) -> Number:
    """Return a number with the bounds within which the scene accepts it."""
    number = free.numbers[k]
    if number.place == DELAY or number.place.endswith('.payload.mass'):
        return replace(number, low=max(number.low, 0.0))
    if number.start < 0.0 or number.low >= 0.0:
        return number
    values = [float(other.start) for other in free.numbers]
    values[k] = -(number.start or 1e-3)
    try:
        free.at(values)[0].parts()
    except HnnViRosError:
        return replace(number, low=0.0)
    return number


def _known(scene: Scene) -> dict[str, str]:
    """Return the place of each number by short name; repeated effects are numbered."""
    kinds = [effect.kind for effect in scene.effects]
    named: dict[str, str] = {}
    for place in numbers_of(scene):
        key, _, rest = place.partition('.')
        if key == 'hamiltonian':
            named[rest] = place
            continue
        index, _, rest = rest.partition('.')
        kind, number = kinds[int(index)], kinds[:int(index)].count(kinds[int(index)])
        own = kind if kinds.count(kind) == 1 else f'{kind}.{number}'
        named[f'{own}.{rest}'] = place
    return named


def _units(scene: Scene, hamiltonian: Hamiltonian) -> dict[str, str]:
    """Return the unit of each number whose description contains one."""
    parts: dict[str, Any] = {'hamiltonian': scene.hamiltonian} | {
        f'effects.{i}': effect for i, effect in enumerate(scene.effects)}
    own = {coordinate.name: coordinate.q_unit for coordinate in hamiltonian.coordinates}
    if hamiltonian.robot is not None:
        own |= {joint.name: joint.units.q for joint in hamiltonian.robot.joints.values()
                if joint.moves}
    units = {name: unit for name, (_, unit) in robot_numbers(scene).items()}
    units[DELAY] = 's'
    for place in numbers_of(scene):
        owner = next(key for key in sorted(parts, key=len, reverse=True)
                     if place.startswith(f'{key}.'))
        name, _, item = place.removeprefix(f'{owner}.').partition('.')
        described, named = type(parts[owner]).model_fields.get(name), _named(parts[owner], item)
        if name == 'drives':
            joint, _, key = item.partition('.')
            described, named = ElasticDrive.model_fields[key], [joint]
        units[place] = _unit(units_in(described.description) if described else (), {
            own[one] for one in (own if named is None else named) if one in own})
    return units


def _named(part: Any, item: str) -> list[str] | None:
    """Return the coordinates of an item of H or of an effect; None for any."""
    given = getattr(part, 'coordinates', None)
    if item.isdecimal() and isinstance(given, list):
        return given[int(item):int(item) + 1]
    if item:
        return [item]
    one = getattr(part, 'coordinate', None)
    return [one] if isinstance(one, str) else given if isinstance(given, list) else None


def _unit(among: Sequence[str], kinds: set[str]) -> str:
    """Return the unit of angles or of lengths that applies to coordinates of these kinds."""
    if len(among) > 1 and kinds in ({'rad'}, {'m'}):
        turning = [one for one in among if 'rad' in one or one in ('N m', 'kg m2', 'kg m^2')]
        among = turning if 'rad' in kinds else [one for one in among if one not in turning]
    return ' or '.join(among)


_SCHEMA = re.compile(r'(?m)^# yaml-language-server: \$schema=.*$')


def write_fitted(path: Path, free: FreeScene, values: Sequence[float],
                 initial_state: Mapping[str, Sequence[float]] | None) -> None:
    """
    Write a scene, and next to it the URDF of its robot if numbers of the robot were free.

    Parameters
    ----------
    path : Path
        Path of a new file.
    free : FreeScene
        Scene, which was read from a file.
    values : sequence of float
        Values of the free numbers; a delay is not part of a scene and goes into a comment.
    initial_state : mapping of str to sequence of float, or None
        q and p that replace the scene's initial state.

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
        if number.place != DELAY and number.place not in free.robot | {*load_numbers(free.loads)}}
    if load_scene(free.scene.source).step_size not in (None, free.scene.step_size):
        changes['step_size',] = repr(free.scene.step_size)
    if initial_state is not None:
        if scene.initial_state.v:
            q, p = map(np.array, initial_state.values())
            initial_state = {'q': initial_state['q'],
                             'v': scene.create_hamiltonian().gradient(q, p)[1].tolist()}
        changes |= {('initial_state', key): str([float(one) for one in part])
                    for key, part in initial_state.items()}
    if free.robot & {number.place for number in free.numbers}:
        robot = path.with_suffix('.urdf')
        if os.path.lexists(robot):
            raise SceneError(f'{robot}: exists already; choose another scene file')
        changes['hamiltonian', 'file'] = robot.name
    for name, file in free.scene.model_files().items():
        # A path relative to the old file's folder would be wrong in the new file's folder.
        if '/' in name and '://' not in name:
            text = text.replace(name, os.path.relpath(file.resolve(), path.resolve().parent))
    text = edited(text, changes)
    schema = f'# yaml-language-server: $schema={share_folder() / "config" / "scene.schema.json"}'
    text = _SCHEMA.sub(lambda line: schema, text)
    if any(number.place == DELAY for number in free.numbers):
        text += f'# Measured forces acted with a delay of {delay:.9g} s.\n'
    if ('hamiltonian', 'file') in changes:
        write_bytes(path.with_suffix('.urdf'), robot_file(scene).read_bytes(), new=True)
    write_new_scene(path, text)
    try:
        load_scene(path).create_hamiltonian()
    except HnnViRosError as problem:
        raise SceneError(f'{path}: was written, but is not a valid scene: {problem}') from problem


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
    """Return the position at which a key is added to a mapping, and the text."""
    if node.flow_style:
        end = node.end_mark.index - 1
        return end, end, f', {key}: {value}'
    first, item = node.value[0]
    end = text.find('\n', item.end_mark.index - (item.end_mark.column == 0))
    end = len(text) if end < 0 else end
    return end, end, f'\n{" " * first.start_mark.column}{key}: {value}'


_MOMENTS = 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'
_AXES = 'xyz'
# Location of a number in a link or a joint: tags, an attribute, and the index of the word.
_LINK = {
    'mass': ('inertial/mass', 'value', 0),
    **{f'centre_{axis}': ('inertial/origin', 'xyz', k) for k, axis in enumerate(_AXES)},
    **{name: ('inertial/inertia', name, 0) for name in _MOMENTS}}
_JOINT = {name: ('dynamics', name, 0) for name in ('damping', 'friction')}
_UNITS = {'mass': 'kg', **{f'centre_{axis}': 'm' for axis in _AXES},
          **dict.fromkeys(_MOMENTS, 'kg m2')}


def robot_numbers(scene: Scene) -> dict[str, tuple[float, str]]:
    """Return value and unit by name: ``forearm.mass``, ``forearm.centre_z``, ``elbow.damping``."""
    if scene.hamiltonian.kind != 'urdf':
        return {}
    root = _parsed(robot_file(scene))
    own = {joint.get('name'): JointUnits.of(joint.get('type', ''))
           for joint in root.findall('joint')}
    return {f'{owner}.{name}': (
        float(element.attrib[attribute].split()[word]),
        _UNITS.get(name) or (own[owner].damping if name == 'damping' else own[owner].force))
            for owner, name, element, attribute, word in _numbers(root)}


def robot_file(scene: Scene) -> Path:
    """Return the URDF file of the scene's robot."""
    return scene.model_files()[scene.hamiltonian.file]


def with_robot_numbers(scene: Scene, numbers: Mapping[str, float], file: Path) -> Scene:
    """
    Return a scene whose robot has other numbers, and write the URDF for it.

    Raises
    ------
    ModelError
        The numbers do not describe a rigid body, even combined with the links fixed to it.

    """
    root = _parsed(robot_file(scene))
    for owner, name, element, attribute, word in _numbers(root):
        place = f'{owner}.{name}'
        if place not in numbers:
            continue
        words = element.attrib[attribute].split()
        words[word] = repr(float(numbers[place]))
        element.set(attribute, ' '.join(words))
    text = ElementTree.tostring(root, encoding='unicode') + '\n'
    write_text(file, text)
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
    # Use the safe reader of robots: it rejects XML beyond plain elements.
    text = read_urdf(file).text
    builder = ElementTree.TreeBuilder(insert_comments=True)
    return ElementTree.fromstring(text, ElementTree.XMLParser(target=builder))


def _numbers(root: ElementTree.Element
             ) -> Iterator[tuple[str, str, ElementTree.Element, str, int]]:
    """Yield the owner, the name and the place of each number given in the file."""
    for tag, places in (('link', _LINK), ('joint', _JOINT)):
        for owner in root.findall(tag):
            for name, (path, attribute, word) in places.items():
                element = owner.find(path)
                if element is not None and attribute in element.attrib:
                    yield owner.get('name', ''), name, element, attribute, word
