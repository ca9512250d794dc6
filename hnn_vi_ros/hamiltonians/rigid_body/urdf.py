# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Parser for URDF of version 1.0 to 1.2: links and joints of a robot, without its appearance.

The format is that of urdfdom 6.0. Content that urdfdom ignores with a warning, or reads as zero,
such as a quaternion in a file of version 1.0, is refused: it would be another robot.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path
import warnings

from hnn_vi_ros.errors import did_you_mean, listed, ModelError
from hnn_vi_ros.files import Element, MAX_XML_BYTES, parse_xml, read_limited
from hnn_vi_ros.hamiltonians.rigid_body.closures import closures_in, is_closure
from hnn_vi_ros.hamiltonians.rigid_body.elements import (
    frame_in, name_of, number_of, only_child, place_of, vector_of)
from hnn_vi_ros.hamiltonians.rigid_body.extensions import (
    below, EXTENSION, extensions_in, has_meaning, MEANINGS, rotors_in)
from hnn_vi_ros.hamiltonians.rigid_body.robot import (
    Inertial, Joint, Limits, Link, Mimic, Robot, SLIDING, TURNING)
import numpy as np

# Ten times as many links as the largest published humanoids.
_MAX_LINKS = 2000
# Ten times the largest distance in published robots, and a tenth of an arm's in mm [m].
_MAX_LENGTH = 30.0
_MOMENTS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
_MIMIC = {'multiplier': 1.0, 'offset': 0.0}
# Version 1.0 has no quaternions; 1.2 requires both limits of a joint, or none.
_VERSIONS = ('1.0', '1.1', '1.2')
# Elements with physical meaning: their attributes, and their child elements.
_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    'robot': ('name', 'version'), 'link': ('name', 'type'), 'joint': ('name', 'type'),
    'inertial': (), 'mass': ('value',), 'inertia': _MOMENTS,
    'origin': ('xyz', 'rpy', 'quat_xyzw'), 'parent': ('link',), 'child': ('link',),
    'axis': ('xyz',), 'dynamics': ('damping', 'friction'),
    'limit': ('lower', 'upper', 'velocity', 'effort', 'acceleration', 'deceleration', 'jerk'),
    'mimic': ('joint', *_MIMIC), 'calibration': (
        'rising', 'falling', 'reference_position'), 'safety_controller': (
        'soft_lower_limit', 'soft_upper_limit', 'k_position', 'k_velocity')}
# Further elements without physical meaning by their parents; others are reported.
_KNOWN: dict[str, tuple[str, ...]] = {
    'robot': ('material', 'gazebo', 'transmission', 'ros2_control', 'sensor', 'mujoco'),
    'link': ('visual', 'collision', 'contact', 'material', 'origin', 'sensor'),
    'joint': ('drake:rotor_inertia', 'drake:gear_ratio')}
# Other formats, and tools that write URDFs of them.
_FORMATS = {'sdf': ('SDF', 'sdf2urdf of pysdf'),
            'mujoco': ('MJCF', 'the Python package mjcf-urdf-simple-converter')}
_ELEMENTS: dict[str, tuple[str, ...]] = {
    'robot': ('link', 'joint'), 'link': ('inertial',), 'inertial': ('origin', 'mass', 'inertia'),
    'joint': ('origin', 'parent', 'child', 'axis', 'limit', 'dynamics', 'mimic', 'calibration',
              'safety_controller')}
# Further attributes of published robots, for Gazebo, Bullet, Drake and drivers, which are not in
# the format.
_FOREIGN: dict[str, tuple[str, ...]] = {
    'link': ('concave',), 'joint': ('dont_collapse',), 'inertia': ('iyx', 'izx', 'izy'),
    'axis': ('rpy',), 'limit': ('command_effort', 'current', 'gear_velocity', 'twist'),
    'dynamics': ('D', 'K', 'mu_coulomb', 'mu_viscous', 'spring_reference', 'spring_stiffness')}
# Elements that have attributes alone.
_LEAVES = _ATTRIBUTES.keys() - _ELEMENTS.keys()
# Elements of SDF with a meaning that URDF writes otherwise.
_HINTS = {'pose': ', of SDF; write <origin xyz="..." rpy="..."/>'}
# Words with a meaning in one place are misplaced elsewhere.
_WORDS = {*_ATTRIBUTES, *(name for names in _ATTRIBUTES.values() for name in names)}
# Prefixes of the attributes of tools that read URDFs, on any element.
_TOOLS = ('drake_', 'gazebo_', 'mujoco_', 'isaac_')


def read_urdf(path: Path) -> Robot:
    """
    Return the robot in a file.

    Parameters
    ----------
    path : Path
        A URDF file.

    Raises
    ------
    ModelError
        The file is invalid or describes no tree of links; one line gives file, line, problem and
        remedy.

    """
    return parse_urdf(_read(path), str(path))


def parse_urdf(text: bytes, where: str) -> Robot:
    """Return the robot that a URDF describes; see ``read_urdf``."""
    root = parse_xml(text, where, ModelError)
    if root.tag in _FORMATS:
        name, tool = _FORMATS[root.tag]
        raise ModelError(f'{where}:{root.line}: {name}, not a URDF; convert it with {tool}: see '
                         'docs/how-to/robots.md')
    if root.tag != 'robot':
        raise ModelError(f'{where}:{root.line}: not a URDF: <{root.tag}>, expected <robot>')
    macro = next((one for one in below(root) if one.tag.startswith('xacro:')), None)
    if macro is not None:
        raise ModelError(f'{where}:{macro.line}: <{macro.tag}>: this is a xacro file; convert it '
                         'to a URDF with: xacro FILE > robot.urdf')
    links, between = root.named('link'), root.named('joint')
    if max(len(links), len(between)) > _MAX_LINKS:
        raise ModelError(f'{where}: {len(links)} links and {len(between)} joints, at most '
                         f'{_MAX_LINKS} of each are supported; remove those that do not move')
    version = root.attributes.get('version', _VERSIONS[0])
    if version not in _VERSIONS:
        raise ModelError(f'{where}:{root.line}: robot version={version[:40]!r} is not supported; '
                         f'valid: {", ".join(_VERSIONS)}')
    foreign: dict[str, list[str]] = {}
    for place, remark in (*_foreign(root, where, version), *extensions_in(root, where)):
        foreign.setdefault(remark, []).append(place)
    for remark, places in foreign.items():
        warnings.warn(f'{places[0]}{f" and {len(places) - 1} more" * (len(places) > 1)}: {remark}',
                      stacklevel=4)
    rotors = rotors_in(root, where)
    joints = [_joint(element, where, version, rotors) for element in between]
    _check_names([name_of(element, where) for element in links], 'link', where)
    _check_names([joint.name for joint in joints], 'joint', where)
    carried: dict[str, list[Joint]] = {name_of(element, where): [] for element in links}
    if not links:
        raise ModelError(f'{where}: the robot has no links; expected <link name="..."/>')
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in carried:
                raise ModelError(f'{joint.place}: no link {end!r}; links: {listed(carried)}')
        carried[joint.parent].append(joint)
    first = _root(list(carried), joints, where)
    robot = Robot(root.attributes.get('name', ''), {
        name: Link(name, place_of(element, where), _inertial(element, where), tuple(own))
        for element, (name, own) in zip(links, carried.items(), strict=True)}, first,
        where, text.decode(errors='replace'))
    _warn_of_units(robot)
    return replace(robot, closures=tuple(closures_in(root, robot)))


def _warn_of_units(robot: Robot) -> None:
    """Warn if lengths appear to be in mm."""
    lengths = [(float(np.abs(joint.origin).max()), joint.place, 'origin')
               for joint in robot.joints.values()]
    for link in robot.links.values():
        if (body := link.inertial) is not None and body.mass > 0.0:
            lengths += [(float(np.abs(body.centre).max()), link.place, 'centre of mass'), (
                math.sqrt(abs(np.trace(body.moments)) / body.mass), link.place,
                'radius of gyration')]
    length, place, what = max(lengths, default=(0.0, '', ''))
    if length > _MAX_LENGTH:
        warnings.warn(f'{place}: {what} of {length:.3g} m: URDFs are in m, kg and kg m2; if this '
                      'one is in mm and g, divide lengths and masses by 1e3 and moments of '
                      'inertia by 1e9', stacklevel=4)


def _read(path: Path) -> bytes:
    try:
        return read_limited(path, MAX_XML_BYTES)
    except OSError as problem:
        raise ModelError(f'{path}: {problem.strerror}; give the path of a URDF, or '
                         'package://PACKAGE/PATH') from problem


def _foreign(element: Element, where: str, version: str, label: str = 'robot'
             ) -> Iterator[tuple[str, str]]:
    """
    Yield the attributes and elements of other tools, each with a remark.

    Raise for other unknown attributes, and for misspelt or misplaced elements.
    """
    tag, place = element.tag, f'{where}:{element.line}: {label}'
    valid, inside = _ATTRIBUTES[tag], _ELEMENTS.get(tag, ())
    for name, value in element.attributes.items():
        # Attributes with a namespace are of other tools.
        if name in (*valid, *_FOREIGN.get(tag, ()), 'xmlns') or ':' in name:
            if tag == 'dynamics' and has_meaning(name, value):
                yield f'{place}: attribute {name!r}', MEANINGS[name]
            continue
        hint = did_you_mean(name, valid, 0.6)
        if name.startswith(_TOOLS) or (
                tag in ('robot', 'link', 'joint') and not hint and name not in _WORDS):
            yield f'{place}: attribute {name[:60]!r}', EXTENSION
        else:
            raise ModelError(f'{place}: unknown attribute {name[:60]!r}{hint}; valid: '
                             f'{listed(valid) or "none"}')
    if 'quat_xyzw' in element.attributes and version == '1.0':
        raise ModelError(f'{place}: quat_xyzw needs version 1.1, but the version of this file is '
                         '1.0; write <robot version="1.1">, or use rpy instead')
    inner = next((child.tag for child in element.children if child.tag in valid), element.text)
    if tag in _LEAVES and inner:
        raise ModelError(f'{place}: {inner[:40]!r} in <{tag}> is not read; URDF has attributes: '
                         f'{listed(valid)}')
    for child in element.children:
        at = f'{where}:{child.line}: {label}'
        misplaced = next((one for one in below(child) if one.tag == 'inertial'), None)
        if child.tag in inside:
            named = f'{child.tag} {child.attributes.get("name", "")!r}'
            yield from _foreign(child, where, version,
                                named if tag == 'robot' else f'{label}: {child.tag}')
        elif is_closure(child.tag) and tag == 'robot':
            continue
        elif (hint := _HINTS.get(child.tag) or did_you_mean(child.tag.lower(), inside)) or (
                child.tag in _ATTRIBUTES and (tag, child.tag) != ('link', 'origin')):
            raise ModelError(f'{at}: unknown element <{child.tag[:60]}>{hint}; valid: '
                             f'{listed(inside) or "none"}')
        elif misplaced is not None and tag == 'link':
            raise ModelError(f'{where}:{misplaced.line}: {label}: <inertial> in <{child.tag}>; '
                             'move it into the link')
        elif child.tag not in _KNOWN.get(tag, ()):
            yield f'{at}: element <{child.tag[:60]}>', EXTENSION


def _root(links: Sequence[str], joints: Sequence[Joint], where: str) -> str:
    """Return the single link that is not carried by a joint, the root of all others."""
    carriers: dict[str, Joint] = {}
    for joint in joints:
        if joint.child in carriers:
            raise ModelError(f'{joint.place}: link {joint.child!r} is already the child of '
                             f'joint {carriers[joint.child].name!r}; in a tree each link has one '
                             'parent')
        carriers[joint.child] = joint
    roots = [link for link in links if link not in carriers]
    if len(roots) > 1:
        raise ModelError(f'{where}: several links have no parent: {listed(roots)}; join all but '
                         'one to others, for example with fixed joints')
    # Towards the base, each link once.
    known = set(roots)
    for link in links:
        path: dict[str, Joint] = {}
        while link not in known:
            if link in path:
                raise ModelError(f'{path[link].place}: the joints form a loop: '
                                 f'{listed(joint.name for joint in path.values())}; remove one '
                                 'of them to get a tree')
            path[link] = carriers[link]
            link = carriers[link].parent
        known.update(path)
    return roots[0]


def _joint(element: Element, where: str, version: str, rotors: Mapping[str, float]) -> Joint:
    name, place = name_of(element, where), place_of(element, where)
    kind = element.attributes.get('type')
    if not kind:
        raise ModelError(f'{place}: type is missing; valid: revolute, continuous, prismatic, '
                         'fixed')
    origin, rotation = frame_in(element, place)
    limit, dynamics, mimic = (only_child(element, tag, place)
                              for tag in ('limit', 'dynamics', 'mimic'))
    damping, friction = (number_of(dynamics, key, place, default=0.0)
                         for key in ('damping', 'friction'))
    _check_not_negative(place, {'damping': damping, 'friction': friction})
    if mimic is not None and not mimic.attributes.get('joint'):
        raise ModelError(f'{place}: mimic without joint; expected <mimic joint="..."/>')
    parent, child = (_end(element, end, place) for end in ('parent', 'child'))
    return Joint(name, kind, place, parent, child, origin, rotation, _axis(element, kind, place),
                 _limits(limit, place, version == '1.2' and kind in ('revolute', SLIDING)),
                 damping, friction, None if mimic is None else Mimic(
                     mimic.attributes['joint'], *(number_of(mimic, key, place, default=default)
                                                  for key, default in _MIMIC.items())),
                 rotors.get(name, 0.0))


def _end(element: Element, end: str, place: str) -> str:
    found = only_child(element, end, place)
    if found is None or not found.attributes.get('link'):
        raise ModelError(f'{place}: {end} is missing; expected <{end} link="..."/>')
    return found.attributes['link']


def _axis(element: Element, kind: str, place: str) -> np.ndarray:
    given, moves = only_child(element, 'axis', place), kind in (*TURNING, SLIDING)
    if moves and given is not None and 'xyz' not in given.attributes:
        raise ModelError(f'{place}: axis without xyz; expected <axis xyz="0 0 1"/>, for example')
    axis = vector_of(given, 'xyz', place, (1.0, 0.0, 0.0))
    length = math.sqrt(axis @ axis)
    if moves and not length > 0.0:
        raise ModelError(f'{place}: axis xyz = 0 0 0 has no direction; give one, such as 0 0 1')
    return axis / length if length > 0.0 else axis


def _limits(element: Element | None, place: str, both: bool) -> Limits:
    """Return the limits of a joint; with ``both``, lower and upper limit are required."""
    found = {key: None if element is None or key not in element.attributes
             else number_of(element, key, place, largest=math.inf) for key in _ATTRIBUTES['limit']}
    lower, upper = found.pop('lower'), found.pop('upper')
    if both and element is not None and (lower is None or upper is None):
        raise ModelError(f'{place}: limit without {"lower" if lower is None else "upper"}; '
                         'version 1.2 requires both, or no <limit>')
    if lower is not None and upper is not None and lower > upper:
        raise ModelError(f'{place}: the lower limit {lower:g} is above the upper one {upper:g}; '
                         'exchange them')
    _check_not_negative(place, {f'limit {key}': value for key, value in found.items()})
    return Limits(lower, upper, found['velocity'], found['effort'])


def _check_not_negative(place: str, values: Mapping[str, float | None]) -> None:
    for key, value in values.items():
        if value is not None and value < 0.0:
            raise ModelError(f'{place}: {key} = {value:g} must not be negative')


def _inertial(link: Element, where: str) -> Inertial | None:
    place = place_of(link, where)
    element = only_child(link, 'inertial', place)
    if element is None:
        return None
    masses, inertia = (only_child(element, tag, place) for tag in ('mass', 'inertia'))
    if masses is None or inertia is None:
        raise ModelError(f'{place}: inertial without {"mass" if masses is None else "inertia"}; '
                         'give both, or remove inertial from a link without mass')
    xx, xy, xz, yy, yz, zz = (number_of(inertia, key, place) for key in _MOMENTS)
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    centre, rotation = frame_in(element, place)
    return Inertial(number_of(masses, 'value', place), centre, rotation @ moments @ rotation.T)


def _check_names(names: Sequence[str], tag: str, where: str) -> None:
    name, count = max(Counter(names).items(), key=lambda item: item[1], default=('', 0))
    if count > 1:
        raise ModelError(f'{where}: {count} {tag}s are named {name!r}; give each a unique '
                         'name')
