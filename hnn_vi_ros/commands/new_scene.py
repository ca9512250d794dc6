# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Write a new scene file: a copy of a shipped one, a scene of a robot or of a formula."""

from argparse import Namespace
from collections.abc import Iterable
import json
import math
import os
from pathlib import Path
import re
import sys
import warnings

from hnn_vi_ros.errors import ModelError, prefixed, RecordingError, SceneError, StepFailure
from hnn_vi_ros.files import (
    dump_yaml, one_line, package_file, Parser, SCHEME, share_folder, write_new_scene)
from hnn_vi_ros.hamiltonians import (
    CONSTANTS, Formula, Graph, Joint, MOST_JOINTS, read_urdf, Reader, RigidBodyTree, Robot,
    SLIDING, TIMES)
from hnn_vi_ros.scene import described_scene, load_scene, Scene
import numpy as np
from scipy.optimize import minimize

# Number of steps per shortest period of small oscillations about equilibrium; and maximum share of
# a velocity that friction removes in a step.
_STEPS_PER_PERIOD, _MAX_FRICTION_SHARE = 100, 0.5
# Shortest time in which damping stops a joint [s]: real gears with more of it have rotors, too.
_MIN_DAMPING_TIME = 1e-3
_MAX_STEP_SIZE, _MIN_STEP_SIZE = 0.01, 1e-5
# Largest change of the first second by half the step, relative to the motion; and trials for that.
_MAX_CHANGE, _MAX_TRIALS = 0.01, 4
# Speed of dry friction, the default of the effect, unless the step size needs a larger one.
_DRY_FRICTION_SPEED = 0.01


def write_scene(file: str, out: Path | None, force: bool = False) -> Path:
    """
    Write a scene for a robot, and return its path.

    Parameters
    ----------
    file : str
        URDF of the robot: a path, or package://PACKAGE/PATH.
    out : Path or None
        Path of the scene; by default named after the URDF, in the working directory.
    force : bool, optional
        True if an existing file may be replaced.

    Raises
    ------
    ModelError
        The URDF cannot be read or simulated.
    SceneError
        The file exists already, or cannot be written.

    """
    urdf = _find(file)
    out = Path(f'{urdf.stem}.yaml') if out is None else out
    robot = read_urdf(urdf)
    reasons = fixed_joints(robot)
    locked = {name: place for name, (place, _) in reasons.items()}
    why_fixed = '; '.join(f'{name} at {place:g}: {why}' for name, (place, why) in reasons.items())
    if reasons and not any(joint.moves and joint.mimic is None and joint.name not in locked
                           for joint in robot.joints.values()):
        raise ModelError(f'{urdf}: no joint moves ({why_fixed}); set the limits of joints, make '
                         'them continuous, or remove lower and upper')

    def built(rotors: dict[str, float]) -> RigidBodyTree:
        return RigidBodyTree(str(urdf), locked=locked, rotor_inertia=rotors)
    with prefixed(str(urdf), ModelError):
        tree = built({})
        # Rotors change how fast the robot falls, but not its equilibrium.
        rest = resting_state(tree)
        rotors, own = missing_rotors(tree, rest), rates(tree, rest)[1]
        tree = built(rotors)
    held = '; '.join(f'{name} at {value:g}' for name, value in tree.robot.locked.items()
                     if name not in locked)
    for title, content in (
            ('moves', ', '.join(joint.name for joint in tree.joints)),
            ('rotor inertia of the URDF', '; '.join(
                f'{joint.name} {joint.rotor:.3g} {joint.units.rotor}' for joint in tree.joints
                if joint.rotor and joint.name not in rotors)),
            ('rotor inertia guessed (see rotor_inertia in the scene)', '; '.join(
                f'{joint.name} {rotors[joint.name]:g} {joint.units.rotor}, beside {inertia:.2g} '
                'of its links' for joint, inertia in zip(tree.joints, own, strict=True)
                if joint.name in rotors)),
            ('follows', '; '.join(followers_of(tree))),
            ('closes', ', '.join(dict.fromkeys(tree.loops.names)) if tree.loops else ''),
            ('fixed (see locked in the scene)', why_fixed), ('fixed with its leader', held)):
        if content:
            print(f'{title}: {content}', file=sys.stderr)
    name = file if file.startswith(SCHEME) else os.path.relpath(urdf, out.parent)
    text = scene_text(name, out, tree, locked, rotors, rest)
    write_new_scene(out, text, force)
    with warnings.catch_warnings():
        # Those with a line of the URDF were raised above.
        warnings.filterwarnings('ignore', r'.*:\d+: ')
        scene = load_scene(out)
        step_size = resolving_step(scene)
    if step_size != scene.step_size:
        write_new_scene(out, text.replace(f'\nstep_size: {scene.step_size:g} ',
                                          f'\nstep_size: {step_size:g} '), True)
    return out


def resolving_step(scene: Scene) -> float:
    """
    Return a step size that resolves the first second of a scene [s]: half of it changes little.

    If no trial does, as after many impacts, return the smallest one, and print why.
    """
    # Imported lazily: other new scenes need no compiled code.
    from hnn_vi_ros.simulation import build
    assert scene.step_size is not None, 'scenes of robots have a step size'
    tried, step_size, coarse, left = 0.0, scene.step_size, None, ''
    for _ in range(_MAX_TRIALS):
        simulation = build(scene.model_copy(update={'step_size': step_size}))
        try:
            q, _ = simulation.record(20, round(0.05 / step_size))
        except StepFailure as problem:
            coarse, left = None, f'does not resolve the first second: {problem}'
        else:
            if coarse is not None:
                change = np.abs(q - coarse).max() / (np.ptp(q, axis=0).max() or 1.0)
                if change <= _MAX_CHANGE:
                    return tried
                left = (f'changes the first second by {100.0 * change:.2g} % against the next '
                        'larger one, as after many impacts; reduce it for more')
            coarse = q
        tried, step_size = step_size, _round(0.5 * step_size, up=False)
    print(f'step_size: {tried:g} s {left}', file=sys.stderr)
    return tried


def _find(file: str) -> Path:
    if not file.startswith(SCHEME):
        return Path(file)
    try:
        return package_file(file)
    except ValueError as problem:
        raise ModelError(str(problem)) from problem


def fixed_joints(robot: Robot) -> dict[str, tuple[float, str]]:
    """
    Return the joints to be fixed, with the value and the reason for each.

    They are joints whose limits leave no room, the last of too many, and those that mimic joints
    that do not exist.
    """
    moving, locked = 0, {}
    waiting = list(reversed(robot.links[robot.root].joints))
    while waiting:
        joint = waiting.pop()
        waiting += reversed(robot.links[joint.child].joints)
        low, high = joint.bounds
        if joint.moves:
            why, counts = '', joint.mimic is None
            if joint.mimic is not None:
                try:
                    robot.followed(joint, {})
                except ModelError:
                    why = f'it mimics {joint.mimic.joint}, which is not a joint that can lead it'
            elif low is not None and low == high:
                # CAD exports mark missing limits like this.
                why = f'its limits {low:g} and {high:g} are equal'
            elif moving == MOST_JOINTS:
                why = f'at most {MOST_JOINTS} joints move'
            if why:
                place = float(np.clip(0.0, low, high)) if low is not None else 0.0
                locked[joint.name] = place, why
            else:
                moving += counts
    return locked


def resting_state(tree: RigidBodyTree) -> np.ndarray:
    """
    Return the equilibrium of a robot within its limits, shape (d,): a minimum of V(q), p = 0.

    Joints that gravity does not move are at zero, or at the nearest limit. A slide without limits
    on which gravity acts would fall for ever; it is at zero as well.
    """
    low, high = _range(tree)
    start = np.clip(np.zeros(tree.dimension), low, high)
    zero, scale = np.zeros(tree.dimension), tree.kernel.energy_scale or 1.0

    def potential(q: np.ndarray) -> float:
        return float(tree.energy(q, zero)) / scale

    best = start
    # A second start next to zero, where the robot may be in unstable equilibrium.
    for kick in (0.0, 0.1):
        found = minimize(
            potential, np.clip(start + kick, low, high), method='L-BFGS-B',
            jac=lambda q: tree.gradient(q, zero)[0] / scale,
            bounds=list(zip(low, high, strict=True)), options={'ftol': 1e-15, 'gtol': 1e-9}).x
        if potential(found) < potential(best) - 1e-9:
            best = found
    for i in range(len(best)):
        other = best.copy()
        other[i] = start[i]
        if potential(other) <= potential(best) + 1e-12:
            best = other
    turns = [joint.kind == 'continuous' for joint in tree.joints]
    best = np.where(turns, np.remainder(best + np.pi, 2.0 * np.pi) - np.pi, best)
    return np.clip(np.round(best, 6) + 0.0, low, high)


def moving_state(tree: RigidBodyTree, rest: np.ndarray) -> np.ndarray:
    """
    Return a state off equilibrium, shape (d,), from which gravity moves the joints it acts on.

    Each joint is a fifth of the way from equilibrium to the middle of its limits, or to its upper
    limit if it rests near the middle; a joint without limits is 0.3 rad away.
    """
    low, high = _range(tree)
    bounded = np.isfinite(high - low)
    low, high = np.where(bounded, low, rest), np.where(bounded, high, rest + 1.5)
    middle = 0.5 * (low + high)
    near = ~bounded | (np.abs(middle - rest) < 0.1 * (high - low))
    return np.round(rest + 0.2 * (np.where(near, high, middle) - rest), 6) + 0.0


def missing_rotors(tree: RigidBodyTree, rest: np.ndarray) -> dict[str, float]:
    """
    Return rotor inertias for joints with almost no inertia; real motors have some.

    A joint with less than a thousandth of the largest inertia of its kind, or one that its damping
    would stop within a millisecond, would make motions so fast that they dictate the step size.
    """
    inertia = rates(tree, rest)[1]
    kinds = np.array([joint.kind == SLIDING for joint in tree.joints])
    least = [max(1e-3 * inertia[kinds == kind].max(), _MIN_DAMPING_TIME * joint.damping)
             for kind, joint in zip(kinds, tree.joints, strict=True)]
    return {joint.name: _round(need, up=True) for joint, own, need in zip(
        tree.joints, inertia, least, strict=True) if own < need}


def _range(tree: RigidBodyTree) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds of q, each of shape (d,)."""
    ends = []
    for joint in tree.joints:
        low, high = joint.bounds
        if low is None or high is None:
            low, high = (0.0, 0.0) if joint.kind == SLIDING else (-math.inf, math.inf)
        ends.append((low, high))
    low, high = np.array(ends).T
    return low, high


def rates(tree: RigidBodyTree, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the largest angular frequency of small motions [rad/s], and 1 / (M^-1)_jj."""
    zero = np.zeros(q.size)
    curvature = np.column_stack([tree.hessian_vector(q, zero, unit, zero)[0]
                                 for unit in np.eye(q.size)])
    mass = tree.masses(q[None])[0]
    # In units of each joint's own inertia: arm and gripper differ by orders of magnitude.
    size = np.sqrt(np.diag(mass))
    try:
        with np.errstate(all='ignore'):
            inverse = np.linalg.inv(mass / size / size[:, None])
            squares = np.linalg.eigvals(inverse @ (curvature / size / size[:, None])).real
    except np.linalg.LinAlgError as problem:
        raise ModelError(f'{tree.robot.where}: at equilibrium the ratios of masses and lengths '
                         f'exceed the floating-point precision ({problem}); check their '
                         'units') from problem
    return math.sqrt(max(0.0, squares.max())), size**2 / np.diag(inverse)


def followers_of(tree: RigidBodyTree) -> list[str]:
    """Return a line on each joint that follows another: ``finger = -0.5 m/rad * motor + 0 m``."""
    lines = []
    for name, (leader, multiplier, offset) in tree.robot.followers.items():
        unit, other = (tree.robot.joints[one].units.q for one in (name, leader))
        rate = '' if unit == other else f' {unit}/{other}'
        lines.append(f'{name} = {multiplier:g}{rate} * {leader} + {offset:g} {unit}')
    return lines


def scene_text(file: str, out: Path, tree: RigidBodyTree, locked: dict[str, float],
               rotors: dict[str, float], rest: np.ndarray) -> str:
    """Return the YAML of the scene of a robot."""
    joints, q = tree.joints, moving_state(tree, rest)
    stops = [joint.name for joint, at in zip(joints, rest, strict=True) if at in joint.bounds]
    start = (f'Off equilibrium, which is {rest.tolist()}'
             + f', with {", ".join(stops)} at a stop' * bool(stops) + '.')
    if tree.loops is not None:
        # Most are drawn closed.
        zero = np.clip(np.zeros(len(joints)), *_range(tree))
        q, start = moving_state(tree, zero), f'Near {zero.tolist()}; closed by assemble.'
    frequency, inertia = rates(tree, rest)
    damping, friction = (np.array([getattr(joint, name) for joint in joints])
                         for name in ('damping', 'friction'))
    periods = 2.0 * np.pi / frequency / _STEPS_PER_PERIOD if frequency > 0.0 else math.inf
    with np.errstate(divide='ignore', over='ignore'):
        step_size = _round(max(_MIN_STEP_SIZE, min(
            _MAX_STEP_SIZE, periods, (_MAX_FRICTION_SHARE * inertia / damping).min())), up=False)
    speed = max(_DRY_FRICTION_SPEED,
                (friction * step_size / (_MAX_FRICTION_SHARE * inertia)).max())
    effects = []
    if damping.any() or friction.any():
        effects.append('# f = -b v - F tanh(v / speed), with damping b and friction F of the URDF')
        effects.append(f'- {{kind: joint_friction, from: urdf, speed: {_round(speed, up=True):g}}}'
                       f'   # {_units(f"{joint.units.q}/s" for joint in joints)}')
    if tree.loops is None and any(joint.bounds[0] is not None for joint in joints):
        effects.append('# Rigid stops; restitution: 0.5 lets joints bounce off them.')
        effects.append('- {kind: joint_limits, from: urdf}')
    names = [_quoted(joint.name) for joint in joints]
    wide = max(map(len, names))
    return _template('robot').format(
        robot=one_line(Path(file).name), scene=one_line(out), file=_quoted(file),
        description=_quoted(f'{Path(file).stem}, from its URDF'), rotors=_rotors(rotors, names[0]),
        names=', '.join(names), locked=_locked_text(tree.robot, locked),
        loops='' if tree.loops is None else
        '  # Move the initial state onto the closed chains of the URDF, which joint_limits do\n'
        '  # not support; loops: [] opens them.\n  assemble: true\n',
        followers=''.join(f'  # Follows another: {line}\n' for line in followers_of(tree)),
        rotor_units=_units(joint.units.rotor for joint in joints),
        force_units=_units_text(joint.units.force for joint in joints),
        joints='\n'.join(f'    - {name:{wide}}   # {_comment(joint)}'
                         for name, joint in zip(names, joints, strict=True)),
        effects=''.join(f'\n  {line}' for line in effects) or ' []', step_size=f'{step_size:g}',
        q=q.tolist(), start=start, p=[0.0] * q.size,
        units=_units_text(coordinate.q_unit for coordinate in tree.coordinates),
        p_units=_units_text(coordinate.p_unit for coordinate in tree.coordinates))


def _template(name: str) -> str:
    """Return the text of a scene with placeholders in braces."""
    path = share_folder() / 'config' / 'templates' / f'{name}.yaml.in'
    return path.read_text(encoding='utf-8')


def _locked_text(robot: Robot, locked: dict[str, float]) -> str:
    if not locked:
        return ''
    lines = ''.join(f'    {_quoted(name)}: {value}   # [{robot.joints[name].units.q}]\n'
                    for name, value in locked.items())
    return ('  # Fixed: they have equal limits, are too many, or follow what cannot move.\n'
            f'  locked:\n{lines}')


def _rotors(rotors: dict[str, float], first: str) -> str:
    """Return the lines on rotors; rotors of light links are required."""
    if not rotors:
        return f'\n  # rotor_inertia: {{{first}: 0.1}}'
    named = ', '.join(f'{_quoted(name)}: {value:g}' for name, value in rotors.items())
    return ('\n  # Guessed for joints with almost no inertia: 1 / 1000 of the largest, or 1 ms of '
            'damping.\n'
            f'  rotor_inertia: {{{named}}}')


def _units(units: Iterable[str]) -> str:
    """Return the distinct units in brackets."""
    return ', '.join(f'[{unit}]' for unit in dict.fromkeys(units))


def _units_text(units: Iterable[str]) -> str:
    """Return the unit of each number in brackets, or that of all."""
    every = [f'[{unit}]' for unit in units]
    return every[0] if len(set(every)) == 1 else ', '.join(every)


def _comment(joint: Joint) -> str:
    """Return the comment on a joint."""
    low, high = joint.bounds
    parts = [joint.kind if low is None else f'{joint.kind}, {low:g} to {high:g} {joint.units.q}']
    if joint.damping or joint.friction:
        parts.append(f'damping {joint.damping:g} {joint.units.damping}, '
                     f'friction {joint.friction:g} {joint.units.force}')
    return ', '.join(parts)


def _round(value: float, up: bool) -> float:
    """Return the next of 1, 2 and 5 times a power of ten, in the given direction."""
    power = math.floor(math.log10(value))
    steps = [float(f'{digit}e{power + more}') for more in (-1, 0, 1) for digit in (1, 2, 5)]
    near = 1e-9 * value
    return min(step for step in steps if step >= value - near) if up else max(
        step for step in steps if step <= value + near)


def _quoted(text: str) -> str:
    """Return a text quoted for YAML, also valid inside of brackets."""
    plain = dump_yaml([text]).removeprefix('- ').strip()
    return plain if plain == text and not set(text) & set(',:#[]{}') else json.dumps(text)


# Suffixes of the files of bags.
BAG_SUFFIXES = ('.mcap',)
# Line that points editors to the schema; shipped scenes have a relative path in it.
_SCHEMA = re.compile(r'(?m)^# yaml-language-server: \$schema=.*$')


def formula_text(text: str, schema: str) -> tuple[str, list[str]]:
    """
    Return the YAML of a formula's scene, and its parameters; coordinates follow from momenta.

    Raises
    ------
    SceneError
        The formula cannot be read, has no momentum, or is not finite at the initial state.

    """
    with prefixed('--formula', SceneError):
        names = Reader(Graph(), text).names
        # p_x belongs to x, and p1 to q1.
        owners = {name: f'q{name[1:]}' if f'q{name[1:]}' in names or name[1:].isdecimal() else
                  name[2:] for name in names if re.match(r'p(_\w|\d+$|$)', name)}
        # Formula refuses other names, and those that differ from a coordinate in case alone.
        parameters = {name: 1.0 for name in sorted(names.keys() - owners.keys() - TIMES)
                      if name.lower() not in {*map(str.lower, owners.values()), *CONSTANTS}}
        if not owners:
            raise ValueError('no momentum: write p_x for the momentum of the coordinate x')
        hamiltonian, d = Formula([*owners.values()], text, parameters), len(owners)
        q, p = 0.1 * np.arange(1.0, d + 1.0), np.zeros(d)
        hamiltonian.check_state(q, p)
    hessian, kernel = np.empty((2 * d, 2 * d)), hamiltonian.kernel
    for unit, row in zip(np.eye(2 * d), hessian, strict=True):
        # Run as plain Python: a few calls take less time than compilation.
        kernel.hessian_vector.py_func(  # type: ignore[attr-defined]
            kernel.parameters, q, p, unit[:d], unit[d:], row[:d], row[d:])
    rate = np.abs(np.linalg.eigvals(np.vstack([hessian[d:], -hessian[:d]]))).max()
    return _template('formula').format(
        schema=schema, description=_quoted('scene of a formula'),
        coordinates=f'[{", ".join(owners.values())}]', H=json.dumps(text, ensure_ascii=False),
        parameters=json.dumps(parameters, ensure_ascii=False),
        steps=_STEPS_PER_PERIOD,
        step_size=_round(2.0 * math.pi / max(rate, 1.0) / _STEPS_PER_PERIOD, up=False),
        q=np.round(q, 6).tolist(), p=p.tolist()), [*parameters]


def write_new(options: Namespace, parser: Parser) -> int:
    """Run `scene --new`: write the file, and print the next steps."""
    if options.file is None and options.robot is None:
        parser.error('FILE is missing: name the file to write')
    path = options.file if options.file is None or options.file.suffix in ('.yaml', '.yml') else \
        options.file.with_name(f'{options.file.name}.yaml')
    if options.robot is not None:
        return _print_next_steps(write_scene(options.robot, path, options.force))
    parameters = list[str]()
    schema = f'# yaml-language-server: $schema={share_folder() / "config" / "scene.schema.json"}'
    if options.formula is not None:
        text, parameters = formula_text(options.formula, schema)
    else:
        like = Path(options.like or 'exact_pendulum')
        if like.is_dir() or like.suffix in BAG_SUFFIXES:
            scene = recorded_scene(like)
            text = f'{schema}\n' + dump_yaml(scene.model_dump(
                by_alias=True, exclude_defaults=True))
        else:
            scene = load_scene(like)
            text = _SCHEMA.sub(lambda line: schema, scene.source.read_text(encoding='utf-8'))
        for name, file in scene.model_files().items():
            # Paths relative to the folder of the original would be wrong for the copy.
            if '/' in name and '://' not in name:
                text = text.replace(name, str(file.resolve()))
    write_new_scene(path, text, options.force)
    _print_next_steps(path)
    if parameters:
        print(f'  parameters set to 1: {", ".join(parameters)}')
    return 0


def recorded_scene(bag: Path) -> Scene:
    """Return the scene in a bag of the simulator; RecordingError if there is none."""
    # Imported lazily: other new scenes need no bags.
    from hnn_vi_ros.recording import BagReader
    text = BagReader(bag).attachment('scene.yaml')
    if text is None:
        raise RecordingError(f'{bag}: contains no scene.yaml; give a bag that the simulator '
                             'recorded itself')
    return described_scene(text, f'{bag}: its scene')[0]


def _print_next_steps(path: Path) -> int:
    """Print the next steps with a scene."""
    print(path)
    print(f'  edit it; check it with: hnn scene --check {path}')
    print(f'  run it with: hnn run {path}')
    return 0
