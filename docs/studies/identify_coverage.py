# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Count how often intervals of ``identify`` hold the truth.

Synthetic logs of shipped scenes, each from an initial state of its own and with white noise; the
search begins with other numbers than the true ones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
import tempfile
import time

from hnn_vi_ros.command_line import Parser
from hnn_vi_ros.learning.data.runs import Motion, smoothed
from hnn_vi_ros.learning.identify_fit import fit
from hnn_vi_ros.learning.identify_numbers import free_scene
from hnn_vi_ros.learning.identify_statistics import estimates_of
from hnn_vi_ros.run.ensemble import simulate
from hnn_vi_ros.scene import load_scene
import numpy as np

# Noise of angles [rad] and of their rates [rad/s].
NOISE = 0.005, 0.05
# How far off numbers the search begins, relatively; and initial angles are apart [rad].
_OFF, _SPREAD = 0.05, 0.2


@dataclass(frozen=True)
class Case:
    """A scene, which of its numbers are free, the length of a log [s] and steps per sample."""

    scene: str
    free: tuple[str, ...]
    duration: float
    every: int


CASES = (
    Case('exact_damped_driven_pendulum', ('mass', 'length', 'damping.rate'), 1.6, 2),
    Case('exact_double_pendulum', ('mass2', 'length1', 'length2'), 1.2, 4),
    Case('two_joint_arm', ('forearm.mass', 'forearm.centre_z', 'upper_arm.centre_z'), 1.0, 4),
)


def synthetic_log(case: Case, random: np.random.Generator) -> Motion:
    """Return a log of a scene from an initial state that chance chooses, with white noise."""
    scene = load_scene(case.scene)
    q, p = np.array(scene.initial_state.q), scene.initial_state.p
    motion = simulate(scene, case.duration, every=case.every, initial_state=(
        (q + _SPREAD * random.normal(size=q.size)).tolist(), p))
    velocity = scene.create_hamiltonian().gradient(motion.q, motion.p)[1]
    q, v = (part + noise * random.normal(size=part.shape)
            for part, noise in zip((motion.q, velocity), NOISE, strict=True))
    return smoothed('log', motion.t, q, v, np.zeros_like(q), 40.0)


def held(case: Case, logs: int, seed: int) -> Iterator[tuple[bool, ...]]:
    """Yield for each log whether the interval of each number holds the true one."""
    scene = load_scene(case.scene)
    for log in range(logs):
        random = np.random.default_rng([seed, log])
        motion = synthetic_log(case, random)
        with tempfile.TemporaryDirectory() as folder:
            true = free_scene(scene, case.free, {}, Path(folder), False)
            truth = np.array([number.start for number in true.numbers])
            off = truth * (1.0 + _OFF * random.uniform(-1.0, 1.0, truth.size))
            free = true.starting_at(off)
            solution, problem, _ = fit(free, [motion], True, case.duration, False)
            found = estimates_of(solution, problem, free, (), False).estimates
        yield tuple(one.low is not None and one.high is not None and one.low <= value <= one.high
                    for one, value in zip(found, truth, strict=True))


def main(argv: Sequence[str]) -> None:
    """Print a row for each scene."""
    options = parser().parse_args(argv)
    print('| scene | numbers | logs | intervals that hold the truth | time of one fit |\n'
          '|---|---|---:|---|---:|')
    for case in CASES:
        if options.scene in (None, case.scene):
            start = time.process_time()
            rows = np.array(list(held(case, options.logs, options.seed)))
            seconds = (time.process_time() - start) / options.logs
            each = ', '.join(f'{100.0 * share:.1f}' for share in rows.mean(axis=0))
            print(f'| `{case.scene}` | {", ".join(case.free)} | {options.logs} | '
                  f'{100.0 * rows.mean():.1f} % ({each}) | {seconds:.2f} s |', flush=True)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('identify_coverage', __doc__, [
        'make study NAME=identify_coverage ARGS="--logs 200 --seed 1"'])
    found.add_argument('--logs', type=int, default=200, help='logs of each scene (default: 200)')
    found.add_argument('--seed', type=int, default=1, help='of their noise (default: 1)')
    found.add_argument('--scene', choices=[case.scene for case in CASES], help='only this one')
    return found
