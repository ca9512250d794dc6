# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot whose log has commanded positions: its scene with servos, and what such a log tells."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hnn_vi_ros.effects import LARGEST
from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.files import write_text
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum, read_urdf, RigidBodyTree
from hnn_vi_ros.identify.intervals import Estimate, Estimates
from hnn_vi_ros.learning import commands_and_off, EvenMotion
from hnn_vi_ros.scene import load_scene, Scene
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import nnls
from yaml import safe_dump

# Speed at which dry friction is nearly full [rad/s], [m/s].
SPEED = 0.05
# Longest delay that is tried for the initial guess [s], and largest step size [s].
_LATEST, _LARGEST_STEP = 0.15, 0.01


def robot_of(urdf: Path) -> RigidBodyTree:
    """Return the robot of a URDF, or raise ParameterError if none of its joints can be driven."""
    try:
        return RigidBodyTree(str(urdf))
    except ValueError as problem:
        raise ParameterError(f'--robot {urdf}: {problem}') from problem


def first_scene(robot: Path, folder: Path) -> Scene:
    """Return a scene of a robot at rest, with which its log is read."""
    return _scene(robot, folder, [], {})


def _scene(robot: Path, folder: Path, effects: Sequence[Mapping[str, object]],
           more: Mapping[str, object], step_size: float = _LARGEST_STEP) -> Scene:
    path, rest = folder / f'{robot.stem}.yaml', [0.0] * robot_of(robot).dimension
    write_text(path, safe_dump({
        'hamiltonian': {'kind': 'urdf', 'file': str(robot.resolve()), **more},
        'integrator': {'kind': 'implicit_midpoint'}, 'step_size': step_size,
        'initial_state': {'q': rest, 'p': rest[:]}, 'effects': [*effects]}, sort_keys=False))
    return load_scene(path)


def commanded_scene(robot: Path, folder: Path, robots: Sequence[tuple[Hamiltonian, float]],
                    motions: Sequence[EvenMotion], known: Mapping[str, float]
                    ) -> tuple[Scene, list[str]]:
    """
    Return the scene of a robot with servos and friction, near a log of commanded positions.

    The numbers are the least-squares fit of the forces that the measured motion needs, with the
    delay that explains them best.

    Parameters
    ----------
    robot, folder : Path
        URDF, and folder for the scene's file.
    robots : sequence of (Hamiltonian, float)
        H of the robot with the load of each motion, and the factor on its stiffness.
    motions : sequence of EvenMotion
        Motions of all d coordinates, with commanded positions.
    known : mapping of str to float
        Known numbers by name, such as ``servo.stiffness.0``.

    Returns
    -------
    Scene, list of str
        The scene, and the names of the numbers that the log may tell.

    """
    names = [one.name for one in robots[0][0].coordinates]
    if motions[0].tau.shape[1] != len(names):
        raise DataError(f'{motions[0].where}: {motions[0].tau.shape[1]} commands, but {robot} has '
                        f'the joints {", ".join(names)}; name one command for each')
    if all((np.abs(motion.tau) > LARGEST).all() for motion in motions):
        raise DataError(f'{motions[0].where}: the motors are off in all samples, which tells '
                        'nothing of servos; give a log in which they are on')
    spacing = motions[0].spacing
    fits = [(*_guess(robots, motions, delay), delay) for delay in delays_of(motions)]
    _, numbers, delay = min(fits, key=lambda fit: fit[0])
    places = {'servo.delay': None} | {
        f'{key}.{name}': (k, column) for column, key in enumerate((
            'servo.stiffness', 'servo.damping', 'joint_friction.friction', 'rotor_inertia',
            'servo.offset')) for k, name in enumerate(
                range(len(names)) if key.startswith('servo') else names)}
    for name, value in known.items():
        if name not in places:
            raise ParameterError(f'--known {name}: not among the numbers of the servos: '
                                 f'{", ".join(places)}')
        if places[name] is None:
            delay = value
        else:
            numbers[places[name]] = value
    stiffness, damping, friction, rotor, offset = numbers.T.tolist()
    limits = _effort_limits(robot, robots, motions)
    off = any((np.abs(motion.tau) > LARGEST).any() for motion in motions)
    effects = [
        {'kind': 'servo', 'coordinates': names, 'stiffness': stiffness, 'damping': damping,
         'offset': offset, 'delay': delay,
         **({'effort_limit': limits.tolist()} if (limits < LARGEST).any() else {})},
        {'kind': 'joint_friction', 'friction': dict(zip(names, friction, strict=True)),
         'speed': SPEED, **({'damping': {name: 0.1 * b for name, b in zip(
             names, damping, strict=True)}} if off else {})}]
    scene = _scene(robot, folder, effects,
                   {'rotor_inertia': dict(zip(names, rotor, strict=True))},
                   min(spacing, _LARGEST_STEP))
    free = [*places, 'joint_friction.speed',
            *(f'joint_friction.damping.{name}' for name in names if off)]
    return scene, [name for name in free if name not in known]


def rated_efforts(robot: Path, names: Sequence[str]) -> np.ndarray:
    """Return the limits of efforts in a URDF [N m] or [N]; LARGEST for those without."""
    # Joints of several coordinates have names of their own.
    efforts = {name: joint.limits.effort for name, joint in read_urdf(robot).joints.items()}
    return np.array([efforts.get(name) or LARGEST for name in names])


def _effort_limits(robot: Path, robots: Sequence[tuple[Hamiltonian, float]],
                   motions: Sequence[EvenMotion]) -> np.ndarray:
    """
    Return the limits of efforts in a URDF, shape (d,) [N m] or [N]; LARGEST for those without.

    A limit below a force that the measured motion needs is a placeholder, and does not count.
    """
    rated = rated_efforts(robot, [one.name for one in robots[0][0].coordinates])
    needed = np.max([np.abs(forces_needed(own, motion)).max(axis=0)
                     for (own, _), motion in zip(robots, motions, strict=True)], axis=0)
    return np.where(rated > needed, rated, LARGEST)


def delays_of(motions: Sequence[EvenMotion]) -> list[float]:
    """Return the delays that are tried for the initial guess [s]."""
    spacing = motions[0].spacing
    return np.arange(0.0, max(_LATEST, 2.0 * spacing), 0.5 * spacing).tolist()


def forces_needed(hamiltonian: Hamiltonian, motion: EvenMotion) -> np.ndarray:
    """Return the forces p' + H_q that a measured motion needs, shape (N, d)."""
    t, q, v = motion.t, motion.q_smooth, motion.v_smooth
    p = momentum(hamiltonian, q, v, np.zeros_like(q))
    return CubicSpline(t, p)(t, 1) + hamiltonian.gradient(q, p)[0]


def regression(robots: Sequence[tuple[Hamiltonian, float]], motions: Sequence[EvenMotion],
               delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns of k, c, F, J, k o, shape (N, d, 5), and the forces needed, (N, d)."""
    rows, forces = [], []
    for (hamiltonian, gain), motion in zip(robots, motions, strict=True):
        t, q, v = motion.t, motion.q_smooth, motion.v_smooth
        at = np.clip(np.floor((t - t[0] - delay) / motion.spacing + 1e-6).astype(int), 0, None)
        commands, off = commands_and_off(motion)
        command, on = commands[at], ~off
        rows.append(np.stack([
            np.where(on, gain * (command - q), 0.0), -v, -np.tanh(v / SPEED), -motion.a_smooth,
            -gain * on], axis=-1))
        forces.append(forces_needed(hamiltonian, motion))
    return np.concatenate(rows), np.concatenate(forces)


def _guess(robots: Sequence[tuple[Hamiltonian, float]], motions: Sequence[EvenMotion],
           delay: float) -> tuple[float, np.ndarray]:
    """Return the relative squared residuals, and k, c, F, J, o of each joint, shape (d, 5)."""
    columns, needed = regression(robots, motions, delay)
    # The offset may have either sign.
    columns = np.concatenate([columns, -columns[..., 4:]], axis=-1)
    hamiltonian, share = robots[0][0], 0.0
    d = hamiltonian.dimension
    found = np.empty((d, 5))
    for k in range(d):
        own, rest = nnls(columns[:, k], needed[:, k])
        share += rest**2 / float((needed[:, k]**2).sum() or 1.0)
        size = float(np.abs(hamiltonian.hessian_vector(
            np.zeros(d), np.zeros(d), np.zeros(d), np.eye(d)[k])[1][k]))
        # Numbers that this leaves at zero start small, not at the end of their range.
        stiffness = max(own[0], 10.0 / size)
        found[k] = (stiffness, max(own[1], 1e-2 * stiffness), max(own[2], 1e-4 * stiffness),
                    max(own[3], 1e-2 / size), (own[4] - own[5]) / stiffness)
    return share, found


def as_ratios(estimates: Estimates, hamiltonian: Hamiltonian, q: np.ndarray) -> Estimates:
    """
    Divide estimates of numbers that scale with the masses by the inertias of their joints.

    A log of commands and positions does not change if masses, stiffness, damping and friction are
    multiplied by one factor: without known masses only k / M, c / M, F / M and J / M are known,
    where M is M_ii(q), with the rotor's J.

    Parameters
    ----------
    estimates : Estimates
        Estimates with the masses of the URDF.
    hamiltonian : Hamiltonian
        H with the fitted rotor inertias.
    q : np.ndarray, shape (d,)
        Coordinates at which M is taken.

    """
    names = [one.name for one in hamiltonian.coordinates]
    zero, places = np.zeros(len(names)), [one.name for one in estimates.estimates]
    inertia = np.diag(np.linalg.inv([
        hamiltonian.hessian_vector(q, zero, zero, unit)[1] for unit in np.eye(len(names))]))
    found, slopes = list[Estimate](), np.eye(len(places))
    for i, one in enumerate(estimates.estimates):
        *before, last = one.name.split('.')
        k = int(last) if last.isdecimal() else names.index(last) if last in names else -1
        if k < 0 or 'offset' in before or not one.known:
            found.append(one)
            continue
        M, rotor = float(inertia[k]), f'rotor_inertia.{names[k]}'
        slopes[i] /= M
        if rotor in places:
            slopes[i, places.index(rotor)] -= one.value / M**2
        error = float(np.sqrt(slopes[i] @ estimates.covariance @ slopes[i]))
        width = (one.high - one.value) / one.standard_error if one.standard_error and one.high \
            is not None else 0.0
        value = one.value / M
        found.append(replace(one, name=f'{one.name} / inertia', value=value, standard_error=error,
                             low=value - width * error, high=value + width * error,
                             unit={'N m/rad': '1/s2', 'N m s/rad': '1/s', 'N m': '1/s2',
                                   'kg m2': '1'}.get(one.unit, f'{one.unit} / inertia')))
    return replace(estimates, estimates=found,
                   covariance=slopes @ estimates.covariance @ slopes.T)
