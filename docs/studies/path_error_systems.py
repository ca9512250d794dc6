# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Systems of the study of path errors, and their paths by other means."""

from collections.abc import Callable, Mapping
from functools import cached_property
import math
from typing import Any, NamedTuple

from hnn_vi_ros import load_scene, Scene, simulate
from hnn_vi_ros.effects import JointCommand
from hnn_vi_ros.simulation import build
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline, make_interp_spline

METHODS = ('implicit_midpoint', 'variational_euler', 'rk4', 'gauss4', 'kahan_li8', 'gauss8',
           'gauss16', 'dop853')
_LIE_METHODS = ('lie_leapfrog', 'lie_symplectic_euler', *METHODS)
# Instants of a path.
INSTANTS = 80_000
Force = Callable[[float, np.ndarray, np.ndarray], Any]


class System(NamedTuple):
    """
    A motion.

    Parameters
    ----------
    kind : str
        Class in the table.
    scene : str or mapping
        Name of a shipped scene, or arguments of Scene.build without method and step size.
    duration : float
        [s].
    force : callable, optional
        Force of the effects, a function of t, q and the velocity, if the path is integrated by
        DOP853 of scipy.
    reference : tuple of (str, int), optional
        Method and number of steps by which the path is integrated otherwise.
    starts : tuple of (q, p), optional
        Initial states of a batch.
    commands : callable, optional
        Commands as a function of time.
    hold : float, optional
        Time for which each command is held [s]; steps are parts of it.
    methods : tuple of str, optional
        Methods.

    """

    kind: str
    scene: str | Mapping[str, Any]
    duration: float
    force: Force | None = None
    reference: tuple[str, int] = ('gauss8', 20_000)
    starts: tuple[Any, ...] = ()
    commands: Callable[[float], Any] | None = None
    hold: float = math.inf
    methods: tuple[str, ...] = METHODS


def _formula(H: str, q: Mapping[str, float], p: Any, *effects: Mapping[str, Any]
             ) -> dict[str, Any]:
    return {'hamiltonian': {'kind': 'formula', 'coordinates': [*q], 'H': H},
            'initial_state': ([*q.values()], list(p)), 'effects': list(effects)}


def _drive(coordinate: str, amplitude: float, rate: float) -> dict[str, Any]:
    return {'kind': 'periodic_drive', 'coordinate': coordinate, 'amplitude': amplitude,
            'frequency': rate / (2.0 * math.pi)}


def _damping(rate: float) -> dict[str, Any]:
    return {'kind': 'damping', 'rate': rate}


def _friction(friction: float, speed: float) -> dict[str, Any]:
    return {'kind': 'joint_friction', 'friction': {'x': friction}, 'speed': speed}


def _orbit(H: str, *effects: Mapping[str, Any]) -> dict[str, Any]:
    return _formula(H, {'x': 0.3, 'y': 0.0}, [0.0, math.sqrt(17.0 / 3.0)], *effects)


def _no_force(t: float, q: np.ndarray, v: np.ndarray) -> float:
    return 0.0


def _damped(rate: float, amplitude: float = 0.0, frequency: float = 0.0) -> Force:
    """Return a damping of unit mass, with a drive of the first coordinate."""
    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        found = -rate * v
        found[0] += amplitude * math.cos(frequency * t)
        return found
    return force


def _dry(friction: float, speed: float, amplitude: float, frequency: float) -> Force:
    return lambda t, q, v: (amplitude * math.cos(frequency * t)
                            - friction * np.tanh(v / speed))


_KEPLER = '(p_x^2 + p_y^2) / 2 - 1 / sqrt(x^2 + y^2)'
_PENDULUM = 'p_x^2 / 2 - cos(x)'
_WELLS = 'p_x^2 / 2 - x^2 / 2 + x^4 / 4'
_MORSE = 'p_x^2 / 2 + 10 * (1 - exp(-x))^2'
_LENNARD_JONES = 'p_x^2 / 2 + 4 * (x^-12 - x^-6)'
_OSCILLATOR = 'p_x^2 / 2 + x^2 / 2'
_FALL = 'p_x^2 / 2 + x'
_TWO = ('(p_a^2 + p_b^2) / 2 + (a^2 + b^2) / 2 + a^2 * b - b^3 / 3')
_SERVO = {'kind': 'servo', 'coordinates': ['x'], 'position': [0.5], 'stiffness': 400.0,
          'damping': 4.0}


def _steps(t: float) -> list[float]:
    """Return a command that changes every half second."""
    return [0.5 * math.cos(2.0 * math.floor(2.0 * t + 1e-9))]


def _targets(t: float) -> JointCommand:
    """Return a target of a servo that changes every half second."""
    return JointCommand(['x'], position=np.array(_steps(t)))


SYSTEMS = {
    'orbit': System('orbits', _orbit(_KEPLER), 20.0, _no_force),
    'orbit with drag': System('orbits', _orbit(_KEPLER, _damping(0.01)), 20.0, _damped(0.01)),
    'orbit, driven': System(
        'orbits', _orbit(_KEPLER, _drive('x', 0.02, 1.3)), 20.0, _damped(0.0, 0.02, 1.3)),
    'orbit with thrust': System('orbits', _orbit(f'{_KEPLER} - 0.01 * y'), 20.0, _no_force),
    'orbit of a mass that varies': System('orbits', _orbit(
        '(p_x^2 + p_y^2) / 2 - (1 + 0.05 * sin(0.7 * t)) / sqrt(x^2 + y^2)'), 20.0, _no_force),
    'Morse, damped': System('wells', _formula(
        _MORSE, {'x': 2.5}, [0.0], _damping(0.002)), 100.0, _damped(0.002)),
    'Lennard-Jones, driven': System('wells', _formula(
        _LENNARD_JONES, {'x': 1.9}, [0.0], _damping(0.01), _drive('x', 0.05, 1.0)), 30.0,
        _damped(0.01, 0.05, 1.0)),
    'double well, driven': System('wells', _formula(
        _WELLS, {'x': 0.8}, [0.0], _damping(0.25), _drive('x', 0.2, 1.0)), 60.0,
        _damped(0.25, 0.2, 1.0)),
    'pendulum from 2.8 rad, damped': System('wells', _formula(
        _PENDULUM, {'x': 2.8}, [0.0], _damping(0.002)), 150.0, _damped(0.002)),
    'pendulum over the top, driven': System('wells', _formula(
        _PENDULUM, {'x': 0.0}, [2.5], _drive('x', 0.1, 0.5)), 40.0, _damped(0.0, 0.1, 0.5)),
    'Henon-Heiles, damped': System('wells', _formula(
        _TWO, {'a': 0.1, 'b': 0.3}, [0.2, 0.1], _damping(0.01)), 60.0, _damped(0.01)),
    'Mathieu': System('linear, time in H', _formula(
        'p_x^2 / 2 + (1 + 0.4 * cos(2 * t)) * x^2 / 2', {'x': 0.1}, [0.0]), 40.0, _no_force),
    'beats from rest': System('linear, time in H', _formula(
        _OSCILLATOR, {'x': 0.0}, [0.0], _drive('x', 0.1, 1.05)), 200.0, _damped(0.0, 0.1, 1.05)),
    'resonance from rest': System('linear, time in H', _formula(
        _OSCILLATOR, {'x': 0.0}, [0.0], _damping(0.02), _drive('x', 0.1, 1.0)), 100.0,
        _damped(0.02, 0.1, 1.0)),
    'growth': System('linear, time in H', _formula(
        'p_x^2 / 2 - x^2 / 2', {'x': 0.1}, [0.0], _damping(0.1)), 8.0, _damped(0.1)),
    'overdamped': System('linear, time in H', _formula(
        'p_x^2 / 2 + 50 * x^2', {'x': 1.0}, [0.0], _damping(60.0)), 3.0, _damped(60.0)),
    'moving equilibrium': System('linear, time in H', _formula(
        'p_x^2 / 2 + 2 * (x - sin(0.8 * t))^2', {'x': 0.0}, [0.0], _damping(0.1)), 40.0,
        _damped(0.1)),
    'dry friction, wide': System('dry friction', _formula(
        'p_x^2 / 2 + 2 * x^2', {'x': 1.0}, [0.0], _friction(0.3, 0.05), _drive('x', 1.0, 1.3)),
        30.0, _dry(0.3, 0.05, 1.0, 1.3)),
    'dry friction, sharp': System('dry friction', _formula(
        'p_x^2 / 2 + 2 * x^2', {'x': 1.0}, [0.0], _friction(0.3, 0.005), _drive('x', 1.0, 1.3)),
        30.0, _dry(0.3, 0.005, 1.0, 1.3)),
    'pendulum with dry friction': System('dry friction', _formula(
        _PENDULUM, {'x': 2.0}, [0.0], _friction(0.1, 0.005), _drive('x', 0.8, 0.7)), 60.0,
        _dry(0.1, 0.005, 0.8, 0.7)),
    'fall from rest': System('few steps', _formula(
        _FALL, {'x': 1.0}, [0.0], _damping(0.5)), 4.0, _damped(0.5)),
    'fall with quadratic drag': System('few steps', _formula(
        _FALL, {'x': 1.0}, [0.0],
        {'kind': 'quadratic_drag', 'coordinates': ['x'], 'coefficient': 0.5}), 6.0,
        lambda t, q, v: -0.5 * v * np.abs(v)),
    'one swing': System('few steps', _formula(
        _PENDULUM, {'x': 1.0}, [0.0], _damping(0.2)), 5.0, _damped(0.2)),
    'bouncing mass': System('impacts', 'bouncing_mass', 6.0, reference=('gauss4', 80_000)),
    'pendulum against a wall': System('impacts', _formula(
        _PENDULUM, {'x': 1.5}, [0.0], _damping(0.02),
        {'kind': 'impact', 'coordinate': 'x', 'position': -0.3, 'restitution': 0.9}), 40.0,
        reference=('gauss8', 80_000)),
    'servo': System('servos, commands', _formula(
        _PENDULUM, {'x': 0.0}, [0.0], _SERVO), 4.0),
    'servo with delay': System('servos, commands', _formula(
        _PENDULUM, {'x': 0.0}, [0.0], _SERVO | {'delay': 0.03}), 6.0, commands=_targets,
        hold=0.5),
    'pendulum with commands': System('servos, commands', _formula(
        _PENDULUM, {'x': 0.5}, [0.0], {
            'kind': 'external_force', 'coordinates': ['x'], 'timeout': 10.0}), 30.0,
        lambda t, q, v: _steps(t), commands=_steps, hold=0.5),
    'four-bar': System('closed chains', 'four_bar', 6.0,
                       reference=('generalized_leapfrog', 120_000),
                       methods=('generalized_leapfrog', *METHODS)),
    'five-bar': System('closed chains', 'five_bar', 4.0,
                       reference=('generalized_leapfrog', 120_000),
                       methods=('generalized_leapfrog', *METHODS)),
    'rigid body': System('bodies that turn', 'free_rigid_body', 20.0,
                         reference=('lie_leapfrog', 200_000), methods=_LIE_METHODS),
    'heavy top': System('bodies that turn', 'heavy_top', 10.0,
                        reference=('lie_leapfrog', 200_000), methods=_LIE_METHODS),
    'ball joint': System('bodies that turn', 'ball_joint_pendulum', 15.0,
                         reference=('lie_leapfrog', 200_000), methods=_LIE_METHODS),
    'learned pendulum': System('networks', 'pendulum', 15.0, reference=('gauss16', 20_000)),
    'learned double pendulum': System('networks', 'double_pendulum', 5.0,
                                      reference=('gauss16', 20_000)),
    'learned orbit': System('networks', 'learned_kepler', 10.0, reference=('gauss16', 20_000)),
    'batch of damped orbits': System(
        'batches', _orbit(_KEPLER, _damping(0.01)), 20.0, _damped(0.01), starts=(
            ([0.3, 0.0], [0.0, 2.38]), ([0.6, 0.0], [0.0, 1.53]), ([0.9, 0.0], [0.0, 1.1]))),
    'batch of driven pendulums': System(
        'batches', _formula(_PENDULUM, {'x': 1.0}, [0.0], _damping(0.05), _drive('x', 0.3, 0.7)),
        60.0, _damped(0.05, 0.3, 0.7), starts=(([0.5], [0.0]), ([2.0], [0.0]), ([2.9], [0.0])))}


class Judge:
    """
    Runs of one system, and its path.

    Parameters
    ----------
    name : str
        Key of SYSTEMS.

    """

    def __init__(self, name: str):
        self.system = SYSTEMS[name]
        self.parts = self._scene()
        self._simulation = build(self.parts)
        self.hamiltonian = self._simulation.hamiltonian

    def _scene(self) -> Scene:
        scene = self.system.scene
        return load_scene(scene) if isinstance(scene, str) else Scene.build(
            **scene, integrator='implicit_midpoint', step_size=0.01)

    @cached_property
    def paths(self) -> list[BSpline]:
        """Return the path of each start as a function of time, beyond the duration."""
        starts = self.system.starts or [(self._simulation.q, self._simulation.p)]
        return [self._between(self.times, self._path(np.array(q), np.array(p)))
                for q, p in starts]

    @cached_property
    def times(self) -> np.ndarray:
        """Return the times of the paths [s]."""
        return np.linspace(0.0, 1.3 * self.system.duration, INSTANTS)

    def _between(self, t: np.ndarray, q: np.ndarray) -> BSpline:
        """Return a path as a function of time; cubic polynomials would swing beside impacts."""
        return make_interp_spline(t, q, 1 if self.system.kind == 'impacts' else 3)

    def _path(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        if self.system.force is not None:
            return self._solved(q, p, self.system.force)
        method, steps = self.system.reference
        end = float(self.times[-1])
        # Each command is held for whole steps.
        held = min(self.system.hold, end)
        found = simulate(self.parts, end, integrator=method,
                         step_size=held / math.ceil(held / end * steps),
                         commands=self.system.commands, path_error='off')
        return self._between(found.t, found.q)(self.times)

    def _solved(self, q: np.ndarray, p: np.ndarray, force: Force) -> np.ndarray:
        d, gradient = len(q), self.hamiltonian.gradient

        def slope(t: float, z: np.ndarray) -> np.ndarray:
            H_q, H_p = gradient(z[:d], z[d:], t)
            return np.concatenate([H_p, force(t, z[:d], H_p) - H_q])
        z, parts = np.concatenate([q, p]), list[np.ndarray]()
        # Commands jump: the solver starts anew after each.
        hold, end = min(self.system.hold, self.times[-1]), float(self.times[-1])
        for k in range(math.ceil(end / hold - 1e-9)):
            last = min((k + 1) * hold, end)
            inside = self.times[(self.times >= k * hold) & (self.times < last)]
            found = solve_ivp(slope, (k * hold, last * (1.0 - 1e-12)), z, method='DOP853',
                              rtol=1e-12, atol=1e-13, dense_output=True)
            parts.append(found.sol(np.minimum(inside, found.t[-1]))[:d].T)
            z = found.y[:, -1]
        found = np.concatenate(parts)
        return np.concatenate([found, np.repeat(z[None, :d], INSTANTS - len(found), axis=0)])

    def error(self, t: np.ndarray, q: np.ndarray, row: int = 0) -> float:
        """Return the largest error of a path over the amplitude of its coordinate."""
        truth = self.paths[row](t)
        rotations = self.hamiltonian.rotations
        inside = {first + i for first in rotations for i in range(4)}
        shares = []
        scalars = [k for k in range(q.shape[1]) if k not in inside]
        turning = self._simulation.system.turning
        amplitudes = [0.5 * float(np.ptp(truth[:, k])) for k in scalars]
        for k, amplitude in zip(scalars, amplitudes, strict=True):
            most = math.pi if turning[k] else math.inf
            scale = max(min(amplitude, most), 1e-3 * max(amplitudes))
            shares.append(min(float(np.abs(q[:, k] - truth[:, k]).max()), most) / scale)
        for first in rotations:
            columns = slice(first, first + 4)
            away = _angles(truth[:, columns], truth[:1, columns]).max()
            shares.append(float(_angles(q[:, columns], truth[:, columns]).max() / away))
        return max(shares)


def _angles(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angles between rotations, (n, 4)."""
    inner = np.abs((one * other).sum(axis=1)) / (
        np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1))
    return 2.0 * np.arccos(np.minimum(inner, 1.0))
