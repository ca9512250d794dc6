# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the family mechanical on published data of machines, beside what others reached."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import itertools
import json
from pathlib import Path
import tempfile
from typing import Any

from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.effects.learned_friction import LearnedFriction
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.learning.config import find_config
from hnn_vi_ros.learning.evaluate import simulation_of
from hnn_vi_ros.learning.evaluation import Predict, score, simulated, variance_of
from hnn_vi_ros.learning.machine_config import load_machine, MachineConfig
from hnn_vi_ros.learning.machine_train import describe, fix_scale, learn
from hnn_vi_ros.learning.machine_training import fit, split_motions
from hnn_vi_ros.learning.motion_sources import read_motions
from hnn_vi_ros.learning.motions import Motion
from hnn_vi_ros.learning.plain_network import PlainNetwork, predicted_by
from hnn_vi_ros.models.checkpoint import Checkpoint, save_checkpoint
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
import numpy as np
from tqdm import tqdm

_FOREVER = 1e9
# Where a prediction of the letters ends to be valid (M. Lutter, J. Peters, 2021), and the steps
# that each of its samples is simulated in: forces are held over 0.04 s.
_VALID, _LETTER_STEPS = 0.01, 20
_EVERY = 0.05

# The models of a case, by their names in the tables.
NETWORKS, WITH_PRIOR = 'networks', 'rigid body and networks'
RIGID_BODY, PLAIN = 'rigid body', 'plain network'

# Values by the name of the measure; of several coordinates, one each.
Measures = dict[str, list[float]]
Measure = Callable[[Predict, Sequence[Motion], Path], Measures]


@dataclass(frozen=True)
class Case:
    """
    A published data set, with what is measured on it.

    Parameters
    ----------
    config : str
        The shipped training configuration.
    file : str
        Below the folder of the data.
    measure : callable
        Of a prediction, the motions to test with, and the folder of the data.
    references : dict
        Of each measure, what others reached.
    goals : dict
        Of each model and measure, what ours is to reach, where it is another value.
    prior : str, optional
        The rigid body that is fitted as well, alone and with networks.
    steps : int
        In which a model is simulated from each sample to the next.
    longer : bool
        Whether more is better; else less is.

    """

    config: str
    file: str
    measure: Measure
    references: dict[str, list[float]]
    goals: dict[str, Measures]
    prior: str | None = None
    steps: int = 1
    longer: bool = False


def valid_times(predict: Predict, test: Sequence[Motion], folder: Path) -> Measures:
    """Return how long each letter is followed from its first sample [s], as published."""
    variance = variance_of(test)
    times = []
    for motion in test:
        n = len(motion.t)
        error = predict(motion, np.array([0]), n - 1)[0] - motion.q
        beyond = np.flatnonzero((error**2 / variance).sum(axis=1) >= _VALID)
        times.append(motion.spacing * (beyond[0] if len(beyond) else n))
    by_name = dict(zip([motion.name for motion in test], times, strict=True))
    return {'valid prediction time [s], e and v': [float(np.mean([by_name['e'], by_name['v']]))],
            'valid prediction time [s], e, q and v': [float(np.mean(times))]}


def dfki_errors(predict: Predict, test: Sequence[Motion], folder: Path) -> Measures:
    """Return errors at the end of horizons, on the test runs and on runs of later."""
    found = score(predict, test, [0.1, 0.5], _EVERY, 0.5).horizons
    measures = {f'RMS error [rad] after {horizon:g} s, test': found[horizon].tolist()
                for horizon in (0.1, 0.5)}
    config = load_machine(find_config('dfki_double_pendulum'))
    names = [coordinate.name for coordinate in config.coordinates]
    later = folder / 'dfki_double_pendulum' / 'later.npz'
    with np.load(later, allow_pickle=False) as archive:
        runs = sorted({key.partition('/')[0] for key in archive})
    for task in ('acrobot', 'pendubot'):
        # One task after the other: they were sampled at rates of their own.
        ours = ','.join(run for run in runs if run.startswith(task))
        motions, _ = read_motions(later, config.data, names, [f'{later}:{ours}'])
        measures[f'RMS error [rad] after 0.1 s, later {task}'] = score(
            predict, motions, [0.1], _EVERY, 0.1).horizons[0.1].tolist()
    return measures


def multiarm_errors(predict: Predict, test: Sequence[Motion], folder: Path) -> Measures:
    """Return errors over the first seconds of each segment."""
    measures = {}
    for duration in (0.5, 1.0, 2.0):
        squares = []
        for motion in test:
            n = round(duration / motion.spacing)
            q = predict(motion, np.array([0]), n)[0, 1:]
            squares.append(np.mean((q - motion.q[1:n + 1])**2, axis=0))
        measures[f'RMS error [rad] over {duration:g} s, validation'] = np.sqrt(
            np.mean(squares, axis=0)).tolist()
    return measures


CASES = {
    'two-link arm that writes letters': Case(
        'two_link_arm_characters', 'lutter_peters_2021/two_link_arm_characters.npz', valid_times,
        {'valid prediction time [s], e and v': [2.90],
         'valid prediction time [s], e, q and v': [2.73]},
        {NETWORKS: {'valid prediction time [s], e and v': [3.2],
                    'valid prediction time [s], e, q and v': [3.1]}},
        steps=_LETTER_STEPS, longer=True),
    'real actuated double pendulum': Case(
        'dfki_double_pendulum', 'dfki_double_pendulum/sysid.npz', dfki_errors,
        {'RMS error [rad] after 0.1 s, test': [.0105, .0155],
         'RMS error [rad] after 0.5 s, test': [.124, .248],
         'RMS error [rad] after 0.1 s, later acrobot': [.011, .019],
         'RMS error [rad] after 0.1 s, later pendubot': [.025, .020]},
        {NETWORKS: {'RMS error [rad] after 0.5 s, test': [.090, .140],
                    'RMS error [rad] after 0.1 s, later acrobot': [.0085, .0120],
                    'RMS error [rad] after 0.1 s, later pendubot': [.030, .037]},
         WITH_PRIOR: {'RMS error [rad] after 0.5 s, test': [.110, .205],
                      'RMS error [rad] after 0.1 s, later acrobot': [.0076, .0111],
                      'RMS error [rad] after 0.1 s, later pendubot': [.0235, .0220]}},
        prior='double_pendulum'),
    'real free double pendulum': Case(
        'multiarm_double_pendulum', 'multiarm_pendulum/double.npz', multiarm_errors,
        {'RMS error [rad] over 0.5 s, validation': [.0038, .0045],
         'RMS error [rad] over 1 s, validation': [.0039, .0054],
         'RMS error [rad] over 2 s, validation': [.0044, .0064]},
        {NETWORKS: {'RMS error [rad] over 2 s, validation': [.0050, .0072]},
         WITH_PRIOR: {'RMS error [rad] over 2 s, validation': [.0036, .0055]}},
        prior='double_pendulum'),
}


def measure_machines(data: Path, out: Path, seeds: Sequence[int], quick: bool) -> Path:
    """
    Train and measure every case whose data are there, and write docs/learning/machines.json.

    Cases whose data are not there keep what the file says of them.

    Parameters
    ----------
    data : Path
        Folder of the data sets, each in a folder of its own.
    out : Path
        The file to write.
    seeds : sequence of int
        Of the models of each case.
    quick : bool
        Whether a few steps are enough.

    Raises
    ------
    ParameterError
        No data set is there.

    """
    there = {name: case for name, case in CASES.items() if (data / case.file).is_file()}
    if not there:
        raise ParameterError(f'--data {data}: none of {", ".join(c.file for c in CASES.values())} '
                             'is there; give the folder that holds them')
    rows = json.loads(out.read_text(encoding='utf-8')) if out.is_file() else []
    by_case = {name: [row for row in rows if row['case'] == name] for name in CASES}
    with tqdm(total=len(there) * len(seeds), unit='model', disable=None) as progress:
        for name, case in there.items():
            results = []
            for seed in seeds:
                results.append(run_case(case, data, seed, quick))
                progress.update()
            by_case[name] = [*rows_of(name, case, results)]
            rows = [row for found in by_case.values() for row in found]
            out.write_text(json.dumps(rows, indent=1) + '\n', encoding='utf-8')
    return out


def run_case(case: Case, data: Path, seed: int, quick: bool) -> dict[str, Measures]:
    """Train the models of a case, and a plain network, and measure each of them."""
    config = load_machine(find_config(case.config))
    if quick:
        config = _quick(config)
    config = config.model_copy(update={'seed': seed})
    names = [coordinate.name for coordinate in config.coordinates]
    with tempfile.TemporaryDirectory() as folder:
        file = data / case.file
        if case.measure is valid_times:
            file = letters_by_name(file, Path(folder) / 'letters.npz')
        motions, description = read_motions(file, config.data, names, [str(file)])
        train, test = split_motions(motions, config.data.test_runs)
        measures = {}
        for name, variant in _variants(case, config):
            network, losses = learn(variant, train)
            if not any(motion.tau.any() for motion in train):
                fix_scale(network, train)
            checkpoint = describe(network, variant, train, description, losses, case.config, '')
            model = Path(folder) / f'{name}.safetensors'
            save_checkpoint(model, checkpoint)
            measures[name] = case.measure(_predicted(case, model, checkpoint, train, test), test,
                                          data)
        plain = PlainNetwork(network.structure.kinds, config.hidden, network.scales, seed)
        fit(plain, config, train)
        return measures | {PLAIN: case.measure(predicted_by(plain), test, data)}


def _variants(case: Case, config: MachineConfig) -> Iterator[tuple[str, MachineConfig]]:
    """Yield the models of a case, by name, with what trains them."""
    yield NETWORKS, config
    if case.prior is not None:
        for name, residual in ((WITH_PRIOR, True), (RIGID_BODY, False)):
            family = config.family.model_copy(update={'prior': case.prior, 'residual': residual})
            yield name, config.model_copy(update={'family': family})


def _predicted(case: Case, model: Path, checkpoint: Checkpoint, train: Sequence[Motion],
               test: Sequence[Motion]) -> Predict:
    """Return what a saved model predicts, in the simulation that a scene of it would run."""
    names = [coordinate.name for coordinate in checkpoint.card.coordinates]
    driven = any(motion.tau.any() for motion in train)
    effects = [LearnedFriction(str(model)), *(
        [ExternalForce(names, timeout=_FOREVER)] if driven else [])]
    hamiltonian, variance = MechanicalHamiltonian(checkpoint), variance_of(test)

    def predict(motion: Motion, starts: np.ndarray, count: int) -> np.ndarray:
        simulation = simulation_of(hamiltonian, ImplicitMidpoint(), effects, [motion],
                                   motion.spacing / case.steps)
        return simulated(simulation, motion.spacing, _FOREVER, variance)(motion, starts, count)
    return predict


def _quick(config: MachineConfig) -> MachineConfig:
    loss = {'kind': 'trajectory', 'forward_steps': 2, 'windows': [{'duration': 0.08, 'steps': 2}]}
    return MachineConfig.model_validate(config.model_dump() | {'loss': loss})


def letters_by_name(file: Path, out: Path) -> Path:
    """Write the letters, which stand one after another, as runs that have their names."""
    with np.load(file, allow_pickle=False) as archive:
        ends = np.cumsum(archive['length'])
        runs = {f'{label}/{key}': archive[key][end - length:end]
                for label, length, end in zip(archive['label'], archive['length'], ends,
                                              strict=True)
                for key in ('t', 'q', 'dq_dt', 'ddq_dt2', 'tau')}
    np.savez(out, **runs)
    return out


def rows_of(name: str, case: Case, results: Sequence[dict[str, Measures]]
            ) -> Iterator[dict[str, Any]]:
    """Yield a row for each model and measure: means over seeds, and whether the goal is met."""
    sign = -1.0 if case.longer else 1.0
    models = [model for model in (NETWORKS, WITH_PRIOR) if model in results[0]]
    for model, measure in itertools.product(models, case.references):
        seeds = [measures[model][measure] for measures in results]
        ours = np.mean(seeds, axis=0)
        goal = case.goals[model].get(measure, case.references[measure])
        worst = np.min(seeds, axis=0) if case.longer else np.max(seeds, axis=0)
        baselines = {baseline: np.mean([measures[baseline][measure] for measures in results],
                                       axis=0).tolist()
                     for baseline in (RIGID_BODY, PLAIN) if baseline in results[0]}
        yield {'case': name, 'measure': measure, 'model': model, 'ours': ours.tolist(),
               'worst': worst.tolist(), 'baselines': baselines,
               'reference': case.references[measure], 'goal': goal,
               'met': bool(np.all(sign * ours <= sign * np.array(goal))), 'seeds': seeds}
