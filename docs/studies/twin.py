# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Evaluate a twin on measured runs.

The test runs of a training configuration are replayed to a scene as observations, sample by
sample, with the measured forces as commands. The twin's report is printed with the figure of
``evaluate``, whose predictions begin every 0.05 s at smoothed states.
"""

from collections.abc import Sequence
from pathlib import Path

from hnn_vi_ros.effects import Observation
from hnn_vi_ros.files import Parser
from hnn_vi_ros.learning import EvenMotion, load_machine, read_motions
from hnn_vi_ros.learning.data.motions import train_and_test
from hnn_vi_ros.learning.fit.config import find_config
from hnn_vi_ros.learning.judging.evaluation import score, variance_of
from hnn_vi_ros.learning.judging.predictors import parts_of, simulated
from hnn_vi_ros.run import AccompaniedSimulation, Twin
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build
import numpy as np

_HORIZONS, _EVERY, _LONGEST = (0.1, 0.5), 0.05, 2.0
_AT_ONCE = round(_LONGEST / _EVERY)


def observing(scene: Scene, names: Sequence[str], spacing: float, variance: np.ndarray) -> Scene:
    """Return a scene with an observer, which steps from sample to sample of the data."""
    assert scene.step_size is not None, 'a scene of a machine names its step'
    steps = max(1, int(np.ceil(spacing / scene.step_size - 1e-9)))
    observer = {'kind': 'observer', 'coordinates': list(names),
                'deviations': np.sqrt(variance).tolist(), 'predictions': _AT_ONCE}
    return scene.changed({'step_size': spacing / steps, 'effects': [
        *(effect.model_dump() for effect in scene.effects), observer]})


def replay(twin: Twin, simulation: AccompaniedSimulation, motion: EvenMotion, q: np.ndarray,
           v: np.ndarray) -> list[float]:
    """Return the valid prediction times [s] of a twin that observes q and v along a motion."""
    steps = round(motion.spacing / simulation.step_size)
    simulation.restart(simulation.q.copy(), simulation.p.copy())
    for k in range(len(motion.t) - 1):
        simulation.set_command(Observation(tuple(twin.names), 0.0, q[k], v[k]))
        simulation.set_command(motion.forces[k])
        simulation.advance(steps)
    # Predictions at the end of the run count with their age, as in evaluate.
    return [*twin.times, *(age for age in twin.running if age >= min(_HORIZONS))]


def main(argv: Sequence[str]) -> None:
    """Print the figures of the twin and of evaluate."""
    parser().parse_args(argv)
    scene, config = load_scene(argv[0]), load_machine(find_config(argv[1]))
    names = [coordinate.name for coordinate in config.coordinates]
    motions, _ = read_motions(Path(argv[2]), config.data, names, [argv[2]])
    _, test = train_and_test(motions, config.data.test_runs)
    variance, spacing = variance_of(test), test[0].spacing
    judged = score(simulated(parts_of(argv[0])), test, _HORIZONS, _EVERY, _LONGEST)
    print(f'evaluate: {judged.valid_prediction_time:.3f} s (median of starts every {_EVERY:g} s)')
    scene = observing(scene, names, spacing, variance)
    for what, of_q, of_v in (('as measured', 'q', 'v'), ('smoothed', 'q_smooth', 'v_smooth')):
        simulation = build(scene)
        twin = Twin(scene, simulation)
        accompanied, times = AccompaniedSimulation(simulation, [twin]), []
        for motion in test:
            times += replay(twin, accompanied, motion, getattr(motion, of_q),
                            getattr(motion, of_v))
        found = float(np.median(times))
        print(f'twin, states {what}: {found:.3f} s ({len(times)} predictions), '
              f'{found / judged.valid_prediction_time - 1.0:+.1%}', flush=True)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('twin', __doc__, [
        'make study NAME=twin ARGS="dfki_double_pendulum dfki_double_pendulum sysid.npz"'])
    found.add_argument('scene', help='scene of the twin')
    found.add_argument('config', help='training configuration')
    found.add_argument('data', help='data of the training configuration')
    return found
