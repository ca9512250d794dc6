# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit the parameters of real pendulums with ``identify`` and evaluate them.

The data are published, and not shipped; see docs/evidence/fits.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import tempfile
import time

from hnn_vi_ros.files import Parser
from hnn_vi_ros.identify.free_numbers import free_scene
from hnn_vi_ros.identify.intervals import estimates_of
from hnn_vi_ros.learning import ArraysData, EvenMotion, fit_numbers, read_motions
from hnn_vi_ros.learning.data.arrays import Archive
from hnn_vi_ros.learning.data.motions import train_and_test
from hnn_vi_ros.learning.fit.windows import ModelParts
from hnn_vi_ros.learning.judging.predictors import Predict, simulated
from hnn_vi_ros.scene import load_scene, Scene
import numpy as np
from studies.machine_tables import dfki_errors, Measure, multiarm_errors

_FOREVER = 1e9
# Every tenth sample of the swinging arms is used.
_EVERY = 10

# A chain of one or two links that hang down and turn about y; joint angles are relative. About
# other axes nothing turns: those moments leave that about y its range, as some body can have it.
_LINK = """  <link name="{name}"><inertial><origin xyz="0 0 {centre}"/><mass value="{mass}"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="1"/></inertial></link>
  <joint name="{joint}" type="continuous"><parent link="{parent}"/><child link="{name}"/>
    <origin xyz="0 0 {offset}"/><axis xyz="0 1 0"/>
    <dynamics damping="{damping}" friction="{friction}"/></joint>
"""


@dataclass(frozen=True)
class Link:
    """A link and the joint before it, where the search for its numbers begins."""

    name: str
    joint: str
    mass: float
    centre: float
    moment: float
    offset: float
    damping: float
    friction: float


@dataclass(frozen=True)
class Case:
    """
    A real machine, its free parameters, and its evaluation.

    Parameters
    ----------
    file : str
        Below the folder of the data.
    links : tuple of Link
        From the base on.
    free : tuple of str
        Names as for ``--free``.
    scene : str
        More of its YAML.
    horizon : float
        Length of the windows [s].
    data : dict
        Keys of the arrays, as in a training configuration.
    test : tuple of str
        The runs to judge by, with which nothing is fitted.
    measure : callable
        See machine_tables.
    relative : bool
        True if the angles in the file are absolute, zero upright.

    """

    file: str
    links: tuple[Link, ...]
    free: tuple[str, ...]
    scene: str
    horizon: float
    data: dict[str, str | float | None]
    test: tuple[str, ...]
    measure: Measure
    relative: bool = False


CASES = {
    'dfki': Case(
        'dfki_double_pendulum/sysid.npz',
        (Link('upper', 'shoulder', 0.52346, -0.2, 0.011, 0.0, 0.01, 0.1),
         Link('lower', 'elbow', 0.62557, -0.2557, 0.01, -0.2, 0.01, 0.1)),
        ('upper.centre_z', 'upper.iyy', 'lower.centre_z', 'lower.iyy', 'rotor_inertia.elbow',
         'shoulder.damping', 'elbow.damping', 'shoulder.friction', 'elbow.friction'),
        'rotor_inertia: {elbow: 0.002}', 0.5,
        {'tau': 'tau'}, ('143524', '143704', '144115', '154548'),
        measure=dfki_errors),
    'single': Case(
        'multiarm_pendulum/single.npz',
        (Link('arm', 'joint', 0.1, -0.1, 1e-3, 0.0, 1e-4, 1e-4),),
        # Without forces a common factor of all parameters changes no motion: one is fixed.
        ('arm.iyy', 'joint.damping', 'joint.friction'), '', 9.0,
        {'tau': None, 'interval': 0.01}, ('val_00', 'val_01'), relative=True,
        measure=multiarm_errors),
    'double': Case(
        'multiarm_pendulum/double.npz',
        (Link('first', 'joint1', 0.1, -0.1, 5e-4, 0.0, 1e-4, 1e-4),
         Link('second', 'joint2', 0.1, -0.1, 5e-4, -0.1727, 1e-4, 1e-4)),
        ('first.iyy', 'second.centre_z', 'second.iyy', 'joint1.damping', 'joint2.damping',
         'joint1.friction', 'joint2.friction'), '', 2.6,
        {'tau': None, 'interval': 0.01}, ('val_00', 'val_01', 'val_02', 'val_03'), relative=True,
        measure=multiarm_errors),
}


def scene_of(case: Case, folder: Path, speed: float) -> Scene:
    """Write the robot and the scene of a case, and return it."""
    parents = ['base', *(link.name for link in case.links)]
    robot = ''.join(_LINK.format(parent=parent, **vars(link))
                    for parent, link in zip(parents, case.links, strict=False))
    (folder / 'pendulum.urdf').write_text(
        f'<robot name="pendulum">\n  <link name="base"/>\n{robot}</robot>\n', encoding='utf-8')
    more = f', {case.scene}' if case.scene else ''
    names, zeros = ', '.join(link.joint for link in case.links), [0.0] * len(case.links)
    driven = f'\n  - {{kind: external_force, coordinates: [{names}], timeout: {_FOREVER:g}}}' \
        if case.data['tau'] else ''
    (folder / 'scene.yaml').write_text(
        f'hamiltonian: {{kind: urdf, file: pendulum.urdf{more}}}\n'
        f'effects:\n  - {{kind: joint_friction, from: urdf, speed: {speed:g}}}{driven}\n'
        'integrator: {kind: implicit_midpoint}\nstep_size: 0.002\n'
        f'initial_state: {{q: {zeros}, p: {zeros}}}\n', encoding='utf-8')
    return load_scene(folder / 'scene.yaml')


def motions_of(case: Case, data: Path, folder: Path) -> tuple[list[EvenMotion], list[EvenMotion]]:
    """Return the motions to fit and the motions to test with."""
    file, names = data / case.file, [link.joint for link in case.links]
    if case.relative:
        file = _relative(file, folder / 'relative.npz')
    motions, _ = read_motions(file, ArraysData.model_validate(case.data), names,
                              [str(file)])
    return train_and_test(motions, case.test)


def _relative(file: Path, out: Path) -> Path:
    """Write runs whose angles are zero hanging down, each from the link before."""
    runs = Archive(file).arrays
    # 1 kHz is far above the bandwidth of the arms: every tenth sample is sufficient.
    np.savez(out, **{key: _steps(values[::_EVERY]) - np.pi * (key.endswith('/q') * (
        np.arange(values.shape[1]) == 0)) for key, values in runs.items() if values.ndim == 2})
    return out


def _steps(angles: np.ndarray) -> np.ndarray:
    """Return angles from the link before, of absolute ones."""
    return np.diff(angles, axis=-1, prepend=0.0)


def predicted(scene: Scene, case: Case) -> Predict:
    """Return the predictions of a scene; angles are absolute if those of the case are."""
    own = simulated(ModelParts(scene.create_hamiltonian(), scene.create_integrator(),
                               scene.create_effects(), scene.known_step_size))

    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        if not case.relative:
            return own(motion, starts, count)
        joints = replace(motion, q_smooth=_steps(motion.q_smooth), v_smooth=_steps(
            motion.v_smooth), q=_steps(motion.q))
        return np.cumsum(own(joints, starts, count), axis=-1)
    return predict


def main(argv: Sequence[str]) -> None:
    """Print the numbers of a machine with their intervals, and how well it is predicted."""
    options = parser().parse_args(argv)
    case = CASES[options.case]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = scene_of(case, folder, options.speed)
        train, test = motions_of(case, options.data, folder)
        free = free_scene(scene.parts(), case.free, {}, folder, bool(case.data['tau']))
        start = time.process_time()
        found = fit_numbers([free], train, options.horizon or case.horizon, options.robust)
        solution, problem, stages = found.solution, found.problem, found.stages
        seconds = time.process_time() - start
        estimates = estimates_of(solution, problem, free, (), False)
        print('| number | value | 95 % interval |\n|---|---:|---|')
        for one in estimates.estimates:
            print(f'| {one.name} [{one.unit}] | {one.value:.5g} | ' + (
                f'{one.low:.5g} to {one.high:.5g} |' if one.known else 'not identifiable |'))
        print(f'\n{seconds:.1f} s of one core; windows, misfit: {stages}; not identifiable: '
              f'{estimates.unknown}; correlated: {estimates.correlated}\n', flush=True)
        fitted, _ = free.at(solution.values)
        if case.relative:
            test = [replace(motion, q=np.cumsum(motion.q, axis=1), v=np.cumsum(motion.v, axis=1))
                    for motion in test]
        for measure, values in case.measure(
                predicted(fitted, case), test, options.data).items():
            print(f'{measure}: {" ".join(f"{value:.4f}" for value in values)}', flush=True)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('identify_real', __doc__, [
        'make study NAME=identify_real ARGS="dfki --data FOLDER"'])
    found.add_argument('case', choices=CASES, help='the machine')
    found.add_argument('--data', type=Path, required=True, help='folder of the data sets')
    found.add_argument('--horizon', type=float, help='length of the windows [s]')
    found.add_argument('--speed', type=float, default=0.05, help='speed of dry friction [rad/s]')
    found.add_argument('--robust', action='store_true', help='reduce the weight of outliers')
    return found
