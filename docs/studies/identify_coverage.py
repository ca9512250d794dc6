# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Count how often intervals of ``identify`` contain the true values.

Synthetic logs of shipped scenes, each from an initial state of its own and with noise of some
kind; the search begins with other numbers than the true ones. Or, by ``--samples``, logs of a
damped oscillation with four unknowns, two of its start and two that grow with time:
these are linear, and take a tenth of the time.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
import tempfile
import time
from typing import Any

from hnn_vi_ros.files import Parser
from hnn_vi_ros.identify.free_numbers import free_scene
from hnn_vi_ros.identify.intervals import errors_of, estimates_of, quantile
from hnn_vi_ros.learning import covariances, EvenMotion, fit_numbers, MeasuredColumns, processes
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import simulate
import numpy as np
from scipy.signal import butter, lfilter

# Noise of angles [rad] and of their rates [rad/s].
NOISE = 0.005, 0.05
# Samples before the first one of a log, after which noise has forgotten where it began.
_BEFORE = 4000
# Relative error of the initial values of the search; range of initial angles [rad].
_OFF, _SPREAD = 0.05, 0.2


def _mixture(random: np.random.Generator, shape: tuple[int, ...], shares: Sequence[float]
             ) -> np.ndarray:
    """Return the sum of processes as strong as each other, each with a memory of its own."""
    white = random.normal(size=(len(shares), *shape))
    return sum((lfilter([np.sqrt((1.0 - share**2) / len(shares))], [1.0, -share], one, axis=0)
                for share, one in zip(shares, white, strict=True)), np.zeros(()))


def _filtered(b: Sequence[float], a: Sequence[float]) -> Callable[..., np.ndarray]:
    """Return a function that makes filtered white noise of variance 1."""
    size = np.sqrt((lfilter(b, a, np.eye(1, _BEFORE)[0])**2).sum())
    return lambda random, shape: lfilter(b, a, random.normal(size=shape), axis=0) / size


# Kinds of noise of variance 1: of first order by its correlation; resonant, with a period of 12
# samples; moving averages; both; behind an analogue filter; the sum of white noise and one with a
# memory of 20 samples; and about 1 / f from a period of 3 samples to one of 1600.
NOISES: dict[str, Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]] = {
    'white': _filtered([1.0], [1.0]), 'ar_0.5': _filtered([1.0], [1.0, -0.5]),
    'ar_0.8': _filtered([1.0], [1.0, -0.8]), 'ar_0.9': _filtered([1.0], [1.0, -0.9]),
    'ar_2': _filtered([1.0], [1.0, -1.8 * np.cos(np.pi / 6.0), 0.81]),
    'ma': _filtered([1.0, 0.9, 0.6, 0.3], [1.0]), 'mean_of_5': _filtered([1.0] * 5, [1.0]),
    'arma': _filtered([1.0, 0.7], [1.0, -0.8]), 'low_pass': _filtered(*butter(2, 0.2)),
    'mixture': lambda random, shape: _mixture(random, shape, (0.0, 0.95)),
    'pink': lambda random, shape: _mixture(
        random, shape, [np.exp(-1.0 / 4.0**k) for k in range(-1, 5)])}
# White noise of half the size, and quantised positions, with an error that adds the other half.
QUANTISED = 'quantised'


@dataclass(frozen=True)
class Case:
    """
    A scene, which of its numbers are free, the length of a log [s] and steps per sample.

    A case with effects of its own, instead of the scene's, is named after the first one.
    One with gears, from a start q, is named drives; its rotors are not measured. With a push, a
    force [N], [N m] whose sign changes every 0.6 s is commanded.
    """

    scene: str
    free: tuple[str, ...]
    duration: float
    every: int
    effects: tuple[dict[str, Any], ...] = ()
    hamiltonian: dict[str, Any] = field(default_factory=dict)
    q: tuple[float, ...] = ()
    push: float = 0.0

    @property
    def name(self) -> str:
        """Return the name of the case."""
        own = self.effects[0]['kind'] if self.effects else self.scene
        return 'drives' if self.hamiltonian else own

    def load(self) -> Scene:
        """Return the scene."""
        scene = load_scene(self.scene)
        if self.hamiltonian:
            own = scene.model_dump(include={'hamiltonian'})['hamiltonian']
            return scene.changed({
                'hamiltonian': own | self.hamiltonian, 'step_size': 0.0025,
                'initial_state': {'q': [*self.q], 'p': [0.0] * len(self.q)}})
        return scene.with_overrides(0.005, 'implicit_midpoint', effects=[*self.effects]) \
            if self.effects else scene

    def seen(self) -> MeasuredColumns | None:
        """Return the measured coordinates; None for all."""
        coordinates = self.load().create_hamiltonian().coordinates
        names, d = [one.name for one in coordinates], len(coordinates)
        rotors = [(i, names.index(one.rotor_of)) for i, one in enumerate(coordinates)
                  if one.rotor_of]
        return MeasuredColumns(np.delete(np.arange(d), [i for i, _ in rotors]), np.zeros((2, d)),
                               np.zeros(d), rotors) if rotors else None


CASES = (
    Case('exact_damped_driven_pendulum', ('mass', 'length', 'damping.rate'), 1.6, 2),
    Case('exact_double_pendulum', ('mass2', 'length1', 'length2'), 1.2, 4),
    Case('two_joint_arm', ('forearm.mass', 'forearm.centre_z', 'upper_arm.centre_z'), 1.0, 4),
    Case('exact_pendulum', ('lugre_friction.stiffness', 'lugre_friction.friction',
                            'lugre_friction.stribeck', 'lugre_friction.damping'), 3.0, 2, (
        {'kind': 'lugre_friction', 'coordinate': 'angle', 'stiffness': 60.0, 'friction': 0.6,
         'stribeck': 0.3, 'speed': 0.5, 'damping': 0.15},)),
    Case('exact_pendulum', ('motor.time_constant', 'motor.torque_limit', 'motor.no_load_speed'),
         3.0, 2, ({'kind': 'motor', 'coordinate': 'angle', 'time_constant': 0.1,
                   'torque_limit': 4.0, 'no_load_speed': 8.0},
                  {'kind': 'external_force', 'coordinates': ['angle']}), push=5.0),
    Case('two_joint_arm', tuple(f'drives.elbow.{name}' for name in (
        'stiffness', 'damping', 'rotor_inertia', 'backlash')), 1.5, 2, (), {
            'locked': {'shoulder': 0.0}, 'drives': {'elbow': {
                'stiffness': 60.0, 'damping': 0.1, 'rotor_inertia': 1e-5, 'gear': 50.0,
                'backlash': 0.04, 'smoothing': 0.002}}}, (1.2, 1.0)),
)


def measured(kind: str, values: np.ndarray, noise: float, random: np.random.Generator
             ) -> np.ndarray:
    """Return values over time, axis 0, with noise of a kind and of a standard deviation."""
    if kind == QUANTISED:
        step = noise * np.sqrt(12.0 * 0.75)
        return step * np.round((values + 0.5 * noise * random.normal(size=values.shape)) / step)
    before, *rest = values.shape
    return values + noise * NOISES[kind](random, (_BEFORE + before, *rest))[_BEFORE:]


def synthetic_log(case: Case, kind: str, random: np.random.Generator
                  ) -> tuple[EvenMotion, np.ndarray]:
    """Return a log of a scene from an initial state that chance chooses, and that state."""
    scene = case.load()
    q, p = np.array(scene.initial_state.q), scene.initial_state.p
    t = case.every * scene.known_step_size * np.arange(
        round(case.duration / (case.every * scene.known_step_size)) + 1)
    commands = case.push * (1.0 - 2.0 * (t // 0.6 % 2.0))[:, None]
    motion = simulate(scene, case.duration, every=case.every, initial_state=(
        (q + _SPREAD * random.normal(size=q.size)).tolist(), p),
        commands=commands[:-1] if case.push else None)
    velocity = scene.create_hamiltonian().gradient(motion.q, motion.p)[1]
    seen = case.seen()
    columns = slice(None) if seen is None else seen.columns
    q, v = (measured(kind, part[:, columns], noise, random)
            for part, noise in zip((motion.q, velocity), NOISE, strict=True))
    log = smoothed('log', motion.t, q, v, commands if case.push else np.zeros_like(q), 40.0)
    return (replace(log, inputs='held'),
            np.concatenate([motion.q[0], motion.p[0]]))


def held(case: Case, kind: str, logs: int, seed: int) -> Iterator[tuple[bool, ...]]:
    """Yield for each log which intervals, of its numbers and its start, hold the truth."""
    scene = case.load()
    coordinates = scene.create_hamiltonian().coordinates
    for log in range(logs):
        random = np.random.default_rng([seed, log])
        motion, start = synthetic_log(case, kind, random)
        with tempfile.TemporaryDirectory() as folder:
            true = free_scene(scene.parts(), case.free, {}, Path(folder), False)
            truth = np.array([number.start for number in true.numbers])
            off = truth * (1.0 + _OFF * random.uniform(-1.0, 1.0, truth.size))
            free = true.starting_at(off)
            fitted = fit_numbers([free], [motion], case.duration, False, seen=case.seen())
            solution, problem = fitted.solution, fitted.problem
            found = estimates_of(solution, problem, free, coordinates, True).estimates
        yield tuple(one.low is not None and one.high is not None and one.low <= value <= one.high
                    for one, value in zip(found, [*truth, *start], strict=True))


def held_by_regression(samples: int, kind: str, logs: int, seed: int
                       ) -> Iterator[tuple[bool, ...]]:
    """Yield the same for the four numbers of a damped oscillation."""
    t = 0.02 * np.arange(samples)
    waves = np.exp(-0.15 * t) * np.array([np.cos(3.13 * t), np.sin(3.13 * t)])
    slopes = np.concatenate([waves, t * waves]).T
    taken = np.linalg.qr(slopes)[0]
    inverse = np.linalg.pinv(slopes)
    truth = np.array([20.0, 10.0, 0.0, 0.0])
    freedom = samples - len(truth)
    for log in range(logs):
        y = measured(kind, slopes @ truth, 1.0, np.random.default_rng([seed, log]))
        error = inverse @ y - truth
        residuals = y - slopes @ (truth + error)
        noise = processes(residuals[None], np.array([samples]), taken[None],
                          np.random.default_rng(0))
        spread = errors_of(covariances(inverse.T[None, :, None], [noise]), freedom)
        yield tuple(np.abs(error) <= quantile(freedom) * spread)


def main(argv: Sequence[str]) -> None:
    """Print a row for each scene, or length of a log, and kind of noise."""
    options = parser().parse_args(argv)
    print('| log | noise | logs | coverage | each | time of one |\n|---|---|---:|---:|---|---:|')
    ways = {str(samples): partial(held_by_regression, samples) for samples in options.samples} or {
        case.name: partial(held, case) for case in CASES if options.scene in (None, case.name)}
    for name, way in ways.items():
        for kind in options.noise:
            start = time.process_time()
            rows = np.array(list(way(kind, options.logs, options.seed)))
            seconds = (time.process_time() - start) / options.logs
            each = ', '.join(f'{100.0 * share:.1f}' for share in rows.mean(axis=0))
            print(f'| {name} | {kind} | {options.logs} | {100.0 * rows.mean():.1f} % | {each} | '
                  f'{seconds:.2f} s |', flush=True)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('identify_coverage', __doc__, [
        'make study NAME=identify_coverage ARGS="--logs 200 --seed 1"',
        'make study NAME=identify_coverage ARGS="--samples 100 1000 --noise white ar_0.8"'])
    found.add_argument('--logs', type=int, default=200, help='logs of each kind (default: 200)')
    found.add_argument('--seed', type=int, default=1, help='seed of the noise (default: 1)')
    found.add_argument('--scene', choices=[case.name for case in CASES], help='only this scene')
    found.add_argument('--noise', nargs='+', default=['white'], choices=[*NOISES, QUANTISED],
                       help='kinds of noise (default: white)')
    found.add_argument('--samples', type=int, nargs='+', default=[],
                       help='lengths of logs of a damped oscillation, instead of scenes')
    return found
