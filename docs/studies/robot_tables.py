# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Identify the family rigid_body on measured data: ``python -m`` this module.

The networks next to the rigid body are chosen on the last quarter of the training data;
the tables give all of them, judged by data that neither fit nor choice has seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import json
from pathlib import Path
import tempfile
from typing import Any

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.learning import EvenMotion, read_motions
from hnn_vi_ros.learning.data.arrays import Archive
from hnn_vi_ros.learning.data.motions import train_and_test
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.inertias import force_errors
from hnn_vi_ros.learning.fit.model_files import describe_machine
from hnn_vi_ros.learning.tasks.machine import learn
from hnn_vi_ros.models import save_checkpoint
import numpy as np
from studies.machine_tables import CASES, dfki_errors, predicted
from studies.published_page import ROBOTS
from tqdm import tqdm

# In the folder of the tables: the measures of each model.
RUNS = 'robot_runs.json'
# Share of the UR10's samples that is learned from, and how many are left out behind it.
_LEARNED, _GAP = 0.6, 60
# Share of the training data that the choice is made by.
_CHOICE = 0.25
_RIGID = 'rigid_body'

Measures = dict[str, list[float]]

_ROD = """\
<link name="{name}"><inertial><origin xyz="0 0 {centre}"/><mass value="0.6"/>
  <inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="1e-5"/></inertial></link>
"""
# Two rods of 0.6 kg, of 0.2 and 0.3 m.
DFKI_URDF = (
    '<robot name="dfki_double_pendulum"><link name="base"/>\n'
    + _ROD.format(name='upper', centre=-0.1, inertia=0.002)
    + _ROD.format(name='lower', centre=-0.15, inertia=0.0045) + ''.join(
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {height}"/><axis xyz="0 1 0"/></joint>\n'
        for name, parent, child, height in (
            ('shoulder', 'base', 'upper', 0.0), ('elbow', 'upper', 'lower', -0.2))) + '</robot>\n')


@dataclass(frozen=True)
class Robot:
    """
    A robot whose motions were measured.

    Parameters
    ----------
    file : str
        File of its motions, in the folder of the data.
    settings : dict
        Settings of its configuration.
    measure : callable
        Function of a model, its configuration, the test motions and the folder of the data.
    chosen_by : str
        The measure that the networks are chosen by.
    references : dict
        Published values.

    """

    file: str
    settings: dict[str, Any]
    measure: Callable[[MechanicalNetwork, MachineConfig, list[EvenMotion], list[EvenMotion], Path],
                      Measures]
    chosen_by: str
    references: Measures


def _forces(network: MechanicalNetwork, config: MachineConfig, train: list[EvenMotion],
            test: list[EvenMotion], data: Path) -> Measures:
    """Return the squared error of the force of each joint over its variance."""
    return {_FORCES: force_errors(network, test)[0]}


def _paths(network: MechanicalNetwork, config: MachineConfig, train: list[EvenMotion],
           test: list[EvenMotion], data: Path) -> Measures:
    """Return errors of free simulations, as of the other models of this machine."""
    checkpoint = describe_machine(network, config, train)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'model.safetensors'
        save_checkpoint(file, checkpoint)
        return dfki_errors(predicted(CASES[_DFKI], file, checkpoint, train), test, data)


_FORCES = 'squared error of the force over its variance, joints 1 to 6'
_UR10, _DFKI = 'real UR10', 'real actuated double pendulum'
ROBOTS_MEASURED = {
    _UR10: Robot(
        'ur10_unisa/ur10_exciting.npz',
        {'data': {'kind': 'arrays', 'smoothing': 3.0}, 'loss': {'kind': 'inverse'}},
        _forces, _FORCES, {_FORCES: [.023, .007, .004, .013, .019, .116]}),
    _DFKI: Robot(
        'dfki_double_pendulum/sysid.npz',
        {'data': {'kind': 'arrays', 'test_runs': ['143524', '143704', '144115', '154548']}},
        _paths, 'RMS error [rad] after 0.1 s, test', CASES[_DFKI].references),
}
MODELS: dict[str, list[str]] = {
    _RIGID: [], f'{_RIGID}, residual: friction': ['friction'],
    f'{_RIGID}, residual: potential': ['potential']}


def main(argv: Sequence[str]) -> None:
    """Measure missing results, and write the tables."""
    options = parser().parse_args(argv)
    file = options.out / RUNS
    runs = read_runs(file)
    known = {(run['robot'], run['model'], run['use']) for run in runs}
    jobs = [(name, model, use) for name in ROBOTS_MEASURED for model in MODELS
            for use in ('choice', 'test') if options.robot in (None, name)]
    jobs = [job for job in jobs if job not in known]
    if options.ur10 is None and any(name == _UR10 for name, *_ in jobs):
        parser().error(f'--ur10 is required for the {_UR10}: give its URDF, or --robot {_DFKI!r}')
    for name, model, use in tqdm(jobs, disable=None):
        measures = measure(name, model, use, options.data, options.ur10)
        runs.append({'robot': name, 'model': model, 'use': use, 'measures': measures})
        file.write_text(json.dumps(runs, indent=1) + '\n', encoding='utf-8')
    out = options.out / ROBOTS
    out.write_text(json.dumps(rows_of(runs), indent=1) + '\n', encoding='utf-8')
    print(f'{out}: write the page by published_tables --page')


def read_runs(file: Path) -> list[dict[str, Any]]:
    """Read the runs of a file, none if it does not exist, or raise ParameterError."""
    if not file.is_file():
        return []
    try:
        runs: list[dict[str, Any]] = json.loads(file.read_text(encoding='utf-8'))
        for run in runs:
            if run['model'] not in MODELS or run['use'] not in ('choice', 'test') or (
                    ROBOTS_MEASURED[run['robot']].chosen_by not in run['measures']):
                raise ValueError(f'no {run["model"]} of {run["robot"]} has these measures')
    except (OSError, KeyError, TypeError, ValueError) as problem:
        raise ParameterError(f'{file}: cannot be read ({problem}); move it away, to measure all '
                             'anew') from problem
    return runs


def rows_of(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each robot, measure and model, and mark the chosen model."""
    by_use = {use: {(run['robot'], run['model']): run['measures'] for run in runs
                    if run['use'] == use} for use in ('choice', 'test')}
    rows = []
    for name, robot in ROBOTS_MEASURED.items():
        errors = {model: float(np.mean(by_use['choice'][name, model][robot.chosen_by]))
                  for model in MODELS if (name, model) in by_use['choice']}
        best = min(errors, key=lambda model: errors[model]) if len(errors) == len(MODELS) else None
        rows += [{'robot': name, 'measure': kind, 'model': model,
                  'ours': by_use['test'][name, model][kind], 'reference': reference,
                  'choice': errors.get(model), 'chosen': model == best}
                 for kind, reference in robot.references.items() for model in MODELS
                 if (name, model) in by_use['test']]
    return rows


def measure(name: str, model: str, use: str, data: Path, ur10: Path | None) -> Measures:
    """Identify a robot, and return its measures on the test data or on the data of the choice."""
    robot = ROBOTS_MEASURED[name]
    with tempfile.TemporaryDirectory() as folder:
        urdf = ur10
        if name == _DFKI:
            urdf = Path(folder) / 'robot.urdf'
            urdf.write_text(DFKI_URDF, encoding='utf-8')
        assert urdf is not None
        config, motions = read_robot(robot, MODELS[model], urdf, data / robot.file, Path(folder))
        train, test = train_and_test(motions, config.data.test_runs)
        if use == 'choice':
            train, test = _choice(train)
        network = learn(config, train).module
        if use == 'choice' and name == _DFKI:
            return {robot.chosen_by: _short_error(network, config, train, test)}
        return robot.measure(network, config, train, test, data)


def read_robot(robot: Robot, residual: list[str], urdf: Path, file: Path, folder: Path
               ) -> tuple[MachineConfig, list[EvenMotion]]:
    """Return the configuration of a robot and its motions; the UR10's in two runs."""
    settings = dict(robot.settings)
    if not settings['data'].get('test_runs'):
        file = two_runs(file, folder / 'runs.npz')
        settings['data'] = settings['data'] | {'test_runs': ['test']}
    joints = [{'name': joint.name, 'kind': 'continuous'} for joint in _joints(urdf)]
    config = MachineConfig.model_validate(settings | {
        'coordinates': joints, 'family': {
            'kind': _RIGID, 'file': str(urdf), 'friction': {'coulomb': 2}, 'residual': residual}})
    names = [coordinate.name for coordinate in config.coordinates]
    return config, read_motions(file, config.data, names, [str(file)])[0]


def two_runs(file: Path, out: Path) -> Path:
    """Split one run into a training run and a test run with a gap between them."""
    arrays = Archive(file).arrays
    n = len(arrays['t'])
    first = int(_LEARNED * n)
    runs = {f'{run}/{key}': values[rows] for key, values in arrays.items()
            for run, rows in (('train', slice(0, first)), ('test', slice(first + _GAP, n)))}
    np.savez(out, **runs)
    return out


def _joints(urdf: Path) -> Any:
    from hnn_vi_ros.hamiltonians.rigid_body_tree import RigidBodyTree
    return RigidBodyTree(str(urdf)).joints


def _choice(train: list[EvenMotion]) -> tuple[list[EvenMotion], list[EvenMotion]]:
    """Split the training data: the last quarter of each run selects the model."""
    from hnn_vi_ros.learning.data.motions import part_of
    ends = [round((1.0 - _CHOICE) * len(motion.t)) for motion in train]
    pairs = list(zip(train, ends, strict=True))
    return ([part_of(motion, slice(None, end)) for motion, end in pairs],
            [part_of(motion, slice(end + _GAP, None)) for motion, end in pairs])


def _short_error(network: MechanicalNetwork, config: MachineConfig, train: list[EvenMotion],
                 test: list[EvenMotion]) -> list[float]:
    from hnn_vi_ros.learning.judging.evaluation import score
    checkpoint = describe_machine(network, config, train)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'model.safetensors'
        save_checkpoint(file, checkpoint)
        predict = predicted(CASES[_DFKI], file, checkpoint, train)
        return score(predict, test, [0.1], 0.05, 0.1).horizons[0.1].tolist()


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('robot_tables', __doc__, [
        'make study NAME=robot_tables ARGS="--data DATA --ur10 URDF"'])
    found.add_argument('--data', type=Path, required=True, help='folder of the data sets')
    found.add_argument('--ur10', type=Path, help=(
        'URDF of the UR10: robots/ur_description/urdf/ur10_robot.urdf of example-robot-data'))
    found.add_argument('--out', type=Path, default=Path('docs/evidence/learning'),
                       help='folder of the tables (default: docs/evidence/learning)')
    found.add_argument('--robot', choices=list(ROBOTS_MEASURED), help='measure only this robot')
    return found
