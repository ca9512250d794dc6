# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the family mechanical on published data of machines, and compare with others."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
import itertools
import json
from pathlib import Path
import tempfile
from typing import Any, NamedTuple

from hnn_vi_ros.effects import ExternalForce, LearnedFriction
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.integrators import ImplicitMidpoint
from hnn_vi_ros.learning import EvenMotion, load_machine, read_motions
from hnn_vi_ros.learning.data.arrays import Archive
from hnn_vi_ros.learning.data.motions import train_and_test
from hnn_vi_ros.learning.families.choices import AUTO
from hnn_vi_ros.learning.families.mechanical import PlainNetwork
from hnn_vi_ros.learning.fit.config import find_config, MachineConfig
from hnn_vi_ros.learning.fit.machine import fit_network, scales_of
from hnn_vi_ros.learning.fit.model_files import describe_machine
from hnn_vi_ros.learning.fit.windows import FOREVER, ModelParts
from hnn_vi_ros.learning.judging.evaluation import score, variance_of
from hnn_vi_ros.learning.judging.predictors import Predict, predicted_by, simulated
from hnn_vi_ros.learning.tasks.machine import learn, with_scale
from hnn_vi_ros.models import Checkpoint, save_checkpoint
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
import numpy as np
from studies.simulated_arm import followed_times, LEAST, MEAN, write_arm
from tqdm import tqdm

# Limit of a valid prediction of the letters (M. Lutter, J. Peters, 2021), and the steps
# that each of its samples is simulated in: forces are held over 0.04 s.
_VALID, _LETTER_STEPS = 0.01, 20
_EVERY = 0.05

# Names of the models in the tables.
DEFAULT, NETWORKS, WITH_PRIOR = 'default', 'networks', 'rigid body and networks'
RIGID_BODY, PLAIN = 'rigid body', 'plain network'

# In the folder of the tables: the measures of each model and seed.
RUNS = 'machine_runs.json'

# Values by the name of the measure; of several coordinates, one each.
Measures = dict[str, list[float]]
Measure = Callable[[Predict, Sequence[EvenMotion], Path], Measures]


class CaseMotions(NamedTuple):
    """Training motions, test motions, and their description."""

    train: list[EvenMotion]
    test: list[EvenMotion]
    description: str


@dataclass(frozen=True)
class Case:
    """
    A data set and its measures.

    Parameters
    ----------
    config : str
        The shipped training configuration.
    file : str or callable
        Below the folder of the data; or what writes it to a path, where it is simulated.
    measure : callable
        Function of a prediction, the test motions and the folder of the data.
    references : dict
        Published value of each measure.
    goals : dict
        Target of each model and measure, if it differs from the published value.
    prior : str, optional
        The rigid body that is fitted as well, alone and with networks.
    prior_config : str, optional
        The shipped training configuration of those, where it is another.
    steps : int
        In which a model is simulated from each sample to the next.
    longer : bool
        True if larger values are better.

    """

    config: str
    file: str | Callable[[Path], None]
    measure: Measure
    references: dict[str, list[float]]
    goals: dict[str, Measures]
    prior: str | None = None
    prior_config: str | None = None
    steps: int = 1
    longer: bool = False


def valid_times(predict: Predict, test: Sequence[EvenMotion], folder: Path) -> Measures:
    """Return the valid prediction time of each letter [s], as published."""
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


def dfki_errors(predict: Predict, test: Sequence[EvenMotion], folder: Path) -> Measures:
    """Return errors at the end of horizons, on the test runs and on runs of later."""
    found = score(predict, test, [0.1, 0.5], _EVERY, 0.5).horizons
    measures = {f'RMS error [rad] after {horizon:g} s, test': found[horizon].tolist()
                for horizon in (0.1, 0.5)}
    config = load_machine(find_config('dfki_double_pendulum'))
    names = [coordinate.name for coordinate in config.coordinates]
    later = folder / 'dfki_double_pendulum' / 'later.npz'
    runs = sorted({key.partition('/')[0] for key in Archive(later).arrays})
    for task in ('acrobot', 'pendubot'):
        # One task after the other: they were sampled at rates of their own.
        ours = ','.join(run for run in runs if run.startswith(task))
        motions, _ = read_motions(later, config.data, names, [f'{later}:{ours}'])
        measures[f'RMS error [rad] after 0.1 s, later {task}'] = score(
            predict, motions, [0.1], _EVERY, 0.1).horizons[0.1].tolist()
    return measures


def multiarm_errors(predict: Predict, test: Sequence[EvenMotion], folder: Path) -> Measures:
    """
    Return errors over the first seconds of each segment, the mean over all segments.

    Each is simulated from its first recorded sample, in the way the authors fitted their model.
    """
    durations = (0.5, 1.0, 2.0)
    errors = []
    for motion in test:
        first = replace(motion, q_smooth=motion.q, v_smooth=motion.v)
        n = round(max(durations) / motion.spacing)
        errors.append(predict(first, np.array([0]), n)[0, 1:] - motion.q[1:n + 1])
    spacing = test[0].spacing
    return {f'RMS error [rad] over {duration:g} s, validation': np.mean([
        np.sqrt(np.mean(error[:round(duration / spacing)]**2, axis=0)) for error in errors
    ], axis=0).tolist() for duration in durations}


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
        {DEFAULT: {},
         NETWORKS: {'RMS error [rad] after 0.5 s, test': [.090, .140],
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
        {DEFAULT: {},
         NETWORKS: {'RMS error [rad] over 2 s, validation': [.0050, .0072]},
         WITH_PRIOR: {'RMS error [rad] over 2 s, validation': [.0036, .0055]}},
        prior='double_pendulum', prior_config='multiarm_rigid_body'),
    'simulated arm with friction': Case(
        'two_link_arm_chirps', write_arm, followed_times,
        {MEAN: [20.0], LEAST: [20.0]}, {DEFAULT: {}, NETWORKS: {}, WITH_PRIOR: {}},
        prior='double_pendulum', longer=True),
}


def measure_machines(data: Path, out: Path, seeds: Sequence[int], quick: bool) -> Path:
    """
    Train and measure every case whose data are there, and write machines.json.

    Data that are simulated are made here. Those that are not there are named.

    Each model is written to machine_runs.json when it is measured, and not trained again:
    an interrupted run continues from there. Cases without a run in that file keep their rows.

    Parameters
    ----------
    data : Path
        Folder of the data sets, each in a folder of its own.
    out : Path
        The file to write.
    seeds : sequence of int
        Seeds of the models of each case.
    quick : bool
        Train all models again with a few steps only.

    Raises
    ------
    ParameterError
        The runs cannot be read.

    """
    files = {name: case.file for name, case in CASES.items() if isinstance(case.file, str)}
    missing = {name: file for name, file in files.items() if not (data / file).is_file()}
    if missing:
        print(f'--data {data}: {", ".join(missing.values())} not there, so not measured',
              flush=True)
    there = {name: case for name, case in CASES.items() if name not in missing}
    file = out.with_name(RUNS)
    runs = [] if quick or not file.is_file() else read_runs(file)
    known = {(run['case'], run['model'], run['seed']) for run in runs}
    # Seed after seed, so that one that is stopped has as many of each as of the others.
    jobs = [(name, model, seed) for seed in seeds for name, case in there.items()
            for model in models_of(case)
            # Least squares know no seed.
            if model != RIGID_BODY or seed == seeds[0]]
    motions: dict[str, CaseMotions] = {}
    for name, model, seed in tqdm([job for job in jobs if job not in known], unit='model',
                                  disable=None):
        case = CASES[name]
        if name not in motions:
            motions[name] = read_case(case, data)
        measures = run_case(case, model, motions[name], data, seed, quick)
        runs.append({'case': name, 'model': model, 'seed': seed, 'measures': measures})
        if not quick:
            _write(file, runs)
        _write(out, rows_of_runs(runs, out))
    return out


def read_runs(file: Path) -> list[dict[str, Any]]:
    """Read the measures of each model and seed, or raise ParameterError."""
    try:
        runs: list[dict[str, Any]] = json.loads(file.read_text(encoding='utf-8'))
        for run in runs:
            if run['model'] not in models_of(CASES[run['case']]) or not (
                    run['measures'].keys() >= CASES[run['case']].references.keys()):
                raise ValueError(f'no {run["model"]} of {run["case"]} has these measures')
            int(run['seed'])
    except (OSError, KeyError, TypeError, ValueError) as problem:
        raise ParameterError(f'{file}: cannot be read ({problem}); move it away, to measure all '
                             'anew') from problem
    return runs


def rows_of_runs(runs: Sequence[dict[str, Any]], out: Path) -> list[dict[str, Any]]:
    """Return the rows of all runs, and the rows in a file for cases without runs."""
    rows = json.loads(out.read_text(encoding='utf-8')) if out.is_file() else []
    found = []
    for name, case in CASES.items():
        results: dict[str, list[Measures]] = {}
        for run in sorted(runs, key=lambda run: int(run['seed'])):
            if run['case'] == name:
                results.setdefault(run['model'], []).append(run['measures'])
        found += [*rows_of(name, case, results)] if results else [
            row for row in rows if row['case'] == name]
    return found


def _write(file: Path, content: Sequence[dict[str, Any]]) -> None:
    file.write_text(json.dumps(content, indent=1) + '\n', encoding='utf-8')


def read_case(case: Case, data: Path) -> CaseMotions:
    """Return the training motions and the test motions."""
    config = load_machine(find_config(case.config))
    names = [coordinate.name for coordinate in config.coordinates]
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(case.file, str):
            file = data / case.file
        else:
            file = Path(folder) / f'{case.config}.npz'
            case.file(file)
        if case.measure is valid_times:
            file = letters_by_name(file, Path(folder) / 'letters.npz')
        motions, description = read_motions(file, config.data, names, [str(file)])
    return CaseMotions(*train_and_test(motions, config.data.test_runs), description)


def models_of(case: Case) -> list[str]:
    """Return the names of a case's models in the tables."""
    return [*case.goals, *([RIGID_BODY] if case.prior else []), PLAIN]


def run_case(case: Case, model: str, motions: CaseMotions, data: Path, seed: int, quick: bool
             ) -> Measures:
    """Train a model of a case and measure it."""
    rigid = model in (WITH_PRIOR, RIGID_BODY)
    config = load_machine(find_config(
        case.prior_config if rigid and case.prior_config else case.config))
    if quick:
        config = _quick(config)
    config = config.model_copy(update={'seed': seed})
    if model == PLAIN:
        plain = PlainNetwork([coordinate.kind for coordinate in config.coordinates],
                             config.hidden, scales_of(motions.train), seed)
        plain = fit_network(plain, config, motions.train).module
        return case.measure(predicted_by(plain), motions.test, data)
    config = config.model_copy(update={'family': config.family.model_copy(update={
        'prior': AUTO if model == DEFAULT else case.prior if rigid else None,
        'residual': model != RIGID_BODY})})
    fitted = learn(config, motions.train)
    if not any(motion.tau.any() for motion in motions.train):
        fitted = with_scale(fitted, motions.train)
    checkpoint = describe_machine(fitted.module, config, motions.train, motions.description,
                                  fitted.losses, case.config)
    with tempfile.TemporaryDirectory() as folder:
        # Effects read the learned forces of a model from a file.
        file = Path(folder) / 'model.safetensors'
        save_checkpoint(file, checkpoint)
        return case.measure(predicted(case, file, checkpoint, motions[0]), motions.test, data)


def predicted(case: Case, model: Path, checkpoint: Checkpoint, train: Sequence[EvenMotion]
              ) -> Predict:
    """Return the predictions of a saved model, simulated as in a scene."""
    names = [coordinate.name for coordinate in checkpoint.card.coordinates]
    driven = any(motion.tau.any() for motion in train)
    effects = [LearnedFriction(str(model)), *(
        [ExternalForce(names, timeout=FOREVER)] if driven else [])]
    return simulated(ModelParts(MechanicalHamiltonian(checkpoint), ImplicitMidpoint(), effects,
                                train[0].spacing / case.steps))


def _quick(config: MachineConfig) -> MachineConfig:
    loss = {'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 32,
            'windows': [{'duration': 0.04, 'steps': 2}]}
    return MachineConfig.model_validate(config.model_dump() | {'loss': loss})


def letters_by_name(file: Path, out: Path) -> Path:
    """Write the consecutive letters as named runs."""
    arrays = Archive(file).arrays
    ends = np.cumsum(arrays['length'])
    runs = {f'{label}/{key}': arrays[key][end - length:end]
            for label, length, end in zip(arrays['label'], arrays['length'], ends, strict=True)
            for key in ('t', 'q', 'dq_dt', 'ddq_dt2', 'tau')}
    np.savez(out, **runs)
    return out


def rows_of(name: str, case: Case, results: dict[str, list[Measures]]
            ) -> Iterator[dict[str, Any]]:
    """Yield a row for each model and measure: means over seeds, and whether the goal is met."""
    sign = -1.0 if case.longer else 1.0
    models = [model for model in case.goals if model in results]
    for model, measure in itertools.product(models, case.references):
        seeds = [measures[measure] for measures in results[model]]
        ours = np.mean(seeds, axis=0)
        goal = case.goals[model].get(measure, case.references[measure])
        worst = np.min(seeds, axis=0) if case.longer else np.max(seeds, axis=0)
        others = {baseline: [measures[measure] for measures in results[baseline]]
                  for baseline in (RIGID_BODY, PLAIN) if baseline in results}
        yield {'case': name, 'measure': measure, 'model': model, 'ours': ours.tolist(),
               'worst': worst.tolist(),
               'baselines': {key: np.mean(found, axis=0).tolist()
                             for key, found in others.items()},
               'baseline_seeds': {key: len(found) for key, found in others.items()
                                  if key != RIGID_BODY},
               'reference': case.references[measure], 'goal': goal,
               'met': bool(np.all(sign * ours <= sign * np.array(goal))), 'seeds': seeds}
