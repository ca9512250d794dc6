# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot whose log has commanded positions: its scene with servos, and what such a log tells."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path

from hnn_vi_ros.effects import LARGEST
from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.files import make_folder, write_text
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum, read_urdf, RigidBodyTree
from hnn_vi_ros.identify.free_numbers import FreeScene
from hnn_vi_ros.identify.intervals import Estimate, Estimates
from hnn_vi_ros.learning import (
    CannotFollow, EvenMotion, EVIDENCE, evidence_of, first_length, fit_numbers, FittedNumbers,
    held_commands, MeasuredColumns)
from hnn_vi_ros.scene import load_scene, Scene
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import minimum_filter1d
from scipy.optimize import nnls
from yaml import safe_dump

# Speed at which dry friction is nearly full [rad/s], [m/s], and the bounds within which it is
# fitted: steps do not resolve lower ones, and beyond the higher one it is viscous friction.
SPEED, SPEEDS, SPEED_NAME = 0.05, (0.02, 1.0), 'joint_friction.speed'
# Longest delay that is tried for the initial guess [s], and largest step size [s].
_LATEST, _LARGEST_STEP = 0.15, 0.01
# Residuals in units of the noise that leave nothing to explain, share of the squared residuals
# beyond noise that ramps may leave, and tolerance of the fits that tell it.
_NOISE_ALONE, _LEFT, _ROUGH = 1.1, 0.5, 1e-4
# Names of the delay and of the rate of ramps; names of the frictions in gears, and value from
# which they are fitted.
DELAY, RATE, LOADS, _LOAD = 'servo.delay', 'servo.rate_limit', 'servo.load', 0.1
# Rates of ramps that are tried for the initial guess, relative to the largest speed that is kept
# for this time [s].
_RATES, _SUSTAINED = (1.2, 1.0, 0.85, 0.7, 0.5), 0.05


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
    make_folder(folder)
    write_text(path, safe_dump({
        'hamiltonian': {'kind': 'urdf', 'file': str(robot.resolve()), **more},
        'integrator': {'kind': 'implicit_midpoint'}, 'step_size': step_size,
        'initial_state': {'q': rest, 'p': rest[:]}, 'effects': [*effects]}, sort_keys=False))
    return load_scene(path)


def commanded_scene(robot: Path, folder: Path, robots: Sequence[tuple[Hamiltonian, float]],
                    motions: Sequence[EvenMotion], known: Mapping[str, float],
                    limited: bool = False) -> tuple[Scene, list[str]]:
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
    limited : bool
        True for servos that make ramps of commands.

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
    loads = {f'{LOADS}.{k}': None for k in range(len(names))}
    spacing, places = motions[0].spacing, {DELAY: None, RATE: None, **loads} | {
        f'{key}.{name}': (k, column) for column, key in enumerate((
            'servo.stiffness', 'servo.damping', 'joint_friction.friction', 'rotor_inertia',
            'servo.offset')) for k, name in enumerate(
                range(len(names)) if key.startswith('servo') else names)}
    for name in known:
        if name not in places:
            raise ParameterError(f'--known {name}: not among the numbers of the servos: '
                                 f'{", ".join(places)}')
    rates = [known[RATE]] if RATE in known else [
        share * _sustained_speed(motions) for share in _RATES] if limited else [math.inf]
    numbers, delay, rate = _guess(robots, motions, rates, known)
    for name, value in known.items():
        if places[name] is not None:
            numbers[places[name]] = value
    stiffness, damping, friction, rotor, offset = numbers.T.tolist()
    limits = _effort_limits(robot, robots, motions)
    off = any((np.abs(motion.tau) > LARGEST).any() for motion in motions)
    load = [known.get(name, 0.0) for name in loads]
    effects = [
        {'kind': 'servo', 'coordinates': names, 'stiffness': stiffness, 'damping': damping,
         'offset': offset, 'delay': delay,
         **({'load': load, 'speed': SPEED} if off or any(load) else {}),
         **({'rate_limit': rate} if rate < math.inf else {}),
         **({'effort_limit': limits.tolist()} if (limits < LARGEST).any() else {})},
        {'kind': 'joint_friction', 'friction': dict(zip(names, friction, strict=True)),
         'speed': SPEED, **({'damping': {name: 0.1 * b for name, b in zip(
             names, damping, strict=True)}} if off else {})}]
    scene = _scene(robot, folder, effects,
                   {'rotor_inertia': dict(zip(names, rotor, strict=True))},
                   min(spacing, _LARGEST_STEP))
    free = [*places, SPEED_NAME,
            *(f'joint_friction.damping.{name}' for name in names if off)]
    return scene, [name for name in free if name not in known and (
        off if name in loads else rate < math.inf or name != RATE)]


def _sustained_speed(motions: Sequence[EvenMotion]) -> float:
    """Return the largest speed that a joint keeps for a while with its motor on."""
    count = max(1, round(_SUSTAINED / motions[0].spacing))
    return max(float(minimum_filter1d(np.where(
        np.abs(motion.tau) > LARGEST, 0.0, np.abs(motion.v_smooth)), count, axis=0).max())
        for motion in motions)


def better_servos(free: FreeScene, limited: FreeScene | None, motions: Sequence[EvenMotion],
                  seen: MeasuredColumns) -> FreeScene:
    """
    Return a scene of servos, or another one whose servos make ramps of commands.

    It is that with ramps if these take half of what is not noise from the squared residuals in
    short windows, and certainly: what only resembles ramps, such as a limit of the effort, takes
    less. Its numbers begin at the fit in these windows without friction in gears: from a guess,
    a fit with it ends in false minima.
    """
    def shortly(one: FreeScene) -> tuple[FittedNumbers, FreeScene]:
        held = one
        for number in one.numbers:
            if number.name.startswith(LOADS):
                held = held.holding(held.numbers.index(number))
        fitted = fit_numbers([held], motions, first_length(motions), False, seen, _ROUGH)
        values = dict(zip(held.numbers, fitted.solution.values, strict=True))
        return fitted, one.starting_at([values.get(number, _LOAD) for number in one.numbers])
    found, plain = shortly(free)
    if limited is None or found.stages[-1][1] < _NOISE_ALONE:
        return plain
    try:
        other, with_ramps = shortly(limited)
    except CannotFollow:
        return plain
    noise = float(np.exp(np.log(other.noise).mean()))
    left, before = (one.size**2 - noise**2 for one in (other, found))
    certain = evidence_of(found.solution.freedom, other.size / found.size) > EVIDENCE
    return with_ramps if certain and left < _LEFT * before else plain


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


def columns_of(motion: EvenMotion, gain: float, delay: float, rate: float = math.inf
               ) -> np.ndarray:
    """Return the columns of k, c, F, J, k o of the forces of servos, shape (N, d, 5)."""
    q, v, commands = motion.q_smooth, motion.v_smooth, held_commands(motion, rate)
    times = motion.t - motion.t[0]
    off = commands._replace(positions=commands.off.astype(float), rate=math.inf).at(times) > 0.0
    return np.stack([np.where(off, 0.0, gain * (commands.at(times - delay) - q)), -v,
                     -np.tanh(v / SPEED), -motion.a_smooth, -gain * ~off], axis=-1)


def _guess(robots: Sequence[tuple[Hamiltonian, float]], motions: Sequence[EvenMotion],
           rates: Sequence[float], known: Mapping[str, float]) -> tuple[np.ndarray, float, float]:
    """Return k, c, F, J, o of each joint, (d, 5), and the delay and the rate that fit best."""
    needed = np.concatenate([forces_needed(hamiltonian, motion) for (hamiltonian, _), motion in
                             zip(robots, motions, strict=True)])
    fits = []
    for rate in rates:
        for delay in [known[DELAY]] if DELAY in known else delays_of(motions):
            columns = np.concatenate([columns_of(motion, gain, delay, rate) for (_, gain), motion
                                      in zip(robots, motions, strict=True)])
            # The offset may have either sign.
            columns = np.concatenate([columns, -columns[..., 4:]], axis=-1)
            own = [nnls(columns[:, k], needed[:, k]) for k in range(needed.shape[1])]
            fits.append((sum(rest**2 / float((needed[:, k]**2).sum() or 1.0)
                             for k, (_, rest) in enumerate(own)), own, delay, rate))
    _, best, delay, rate = min(fits, key=lambda fit: fit[0])
    hamiltonian, d = robots[0][0], len(best)
    found, zero = np.empty((d, 5)), np.zeros(d)
    for k, (own, _) in enumerate(best):
        size = float(np.abs(hamiltonian.hessian_vector(zero, zero, zero, np.eye(d)[k])[1][k]))
        # Numbers that this leaves at zero start small, not at the end of their range; rotors do
        # not, because dry friction on little inertia is too fast for the steps.
        stiffness = max(own[0], 10.0 / size)
        found[k] = (stiffness, max(own[1], 1e-2 * stiffness), max(own[2], 1e-4 * stiffness),
                    max(own[3], 0.3 / size), (own[4] - own[5]) / stiffness)
    return found, delay, rate


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
        if k < 0 or {'offset', 'load'} & {*before} or not one.known:
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
