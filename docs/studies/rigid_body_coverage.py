# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Count how often intervals of ``rigid_body`` contain the true parameters.

Computed motions of the shipped arm of two joints along sums of sines, with noise of the forces
that remembers itself for some samples; identified from a URDF whose masses are wrong. Motors are
off by nothing.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
import re
import tempfile
import time

from hnn_vi_ros.files import Parser, share_folder
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.learning import EvenMotion, ExcitationData
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.excitation import excited_motions
from hnn_vi_ros.learning.fit.inertias import identify_inertias
from hnn_vi_ros.learning.fit.machine import scales_of
from hnn_vi_ros.models import tree_card, values_of
import numpy as np
from scipy.signal import lfilter

# True masses in the URDF [kg], and the wrong ones that the identification starts from.
_WRONG = (('<mass value="1.2"/>', '<mass value="1.9"/>'),
          ('<mass value="2"/>', '<mass value="1.5"/>'))
# Standard errors of half an interval of 95 %.
_HALF = 1.96
# Noise of forces, of their root mean square, and for how many samples it remembers itself.
_NOISE, _MEMORY = 0.02, 5
_DATA = {'kind': 'excitation', 'runs': 2, 'duration': 10.0, 'interval': 0.01}


def noisy(motion: EvenMotion, random: np.random.Generator) -> EvenMotion:
    """Return a motion whose forces have noise that decays by 1/e in _MEMORY samples."""
    keep = np.exp(-1.0 / _MEMORY)
    white = random.normal(size=(len(motion.t) + 20 * _MEMORY, motion.tau.shape[1]))
    noise = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)[20 * _MEMORY:]
    size = _NOISE * np.sqrt(np.mean(motion.tau**2, axis=0))
    return replace(motion, tau=motion.tau + size * noise)


def held(runs: Iterable[int], seed: int) -> Iterator[tuple[list[str], list[bool]]]:
    """Yield for each run the base parameters, and whether the interval of each holds its value."""
    file = share_folder() / 'config' / 'robots' / 'two_joint_arm.urdf'
    # Dry friction has another width than that of the model, which no interval holds anything of.
    text = re.sub(r' friction="[^"]*"', '', file.read_text(encoding='utf-8'))
    with tempfile.TemporaryDirectory() as folder:
        right, wrong = (Path(folder) / f'{name}.urdf' for name in ('right', 'wrong'))
        right.write_text(text, encoding='utf-8')
        for old, new in _WRONG:
            if old not in text:
                raise ValueError(f'{file} has no {old}: other masses are to be wrong')
            text = text.replace(old, new)
        wrong.write_text(text, encoding='utf-8')
        robot = RigidBodyTree(str(right))
        card = tree_card(robot.bodies, dict(enumerate(robot.joints)), robot.robot.name)
        truth = values_of(card, robot.bodies)
        config = MachineConfig.model_validate({
            'coordinates': [{'name': joint.name, 'kind': 'continuous'} for joint in robot.joints],
            'data': {'kind': 'excitation'}, 'loss': {'kind': 'inverse'},
            'family': {'kind': 'rigid_body', 'file': str(wrong)}})
        structure = config.structure()
        for run in runs:
            random = np.random.default_rng([seed, run])
            motions = [noisy(motion, random) for motion in excited_motions(
                ExcitationData.model_validate(_DATA), robot, seed + run)[0]]
            network = MechanicalNetwork(structure, config.hidden, scales_of(motions), 0)
            tree = identify_inertias(network, config, motions).module.prior
            true_of = dict(zip(tree.names, truth.ravel(), strict=False))
            found = tree.identification.base_parameters
            yield ([next(iter(one.combination)) for one in found],
                   [abs(one.value - sum(factor * true_of.get(name, 0.0)
                                        for name, factor in one.combination.items()))
                    <= _HALF * one.standard_error for one in found])


def main(argv: Sequence[str]) -> None:
    """Print the share of all intervals, and of each parameter's."""
    options = parser().parse_args(argv)
    start = time.process_time()
    counts: dict[str, list[bool]] = {}
    for names, hits in held(range(options.runs), options.seed):
        for name, hit in zip(names, hits, strict=True):
            counts.setdefault(name, []).append(hit)
    seconds = (time.process_time() - start) / options.runs
    print('| base parameter, by its first term | runs | intervals that hold the truth |\n'
          '|---|---:|---:|')
    for name, hits in counts.items():
        print(f'| {name} | {len(hits)} | {100.0 * np.mean(hits):.1f} % |')
    whole = [hit for hits in counts.values() for hit in hits]
    print(f'| all | {options.runs} | {100.0 * np.mean(whole):.1f} % |\n\n'
          f'{seconds:.2f} s of processor time for a run')


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('rigid_body_coverage', __doc__, [
        'make study NAME=rigid_body_coverage ARGS="--runs 200 --seed 1"'])
    found.add_argument('--runs', type=int, default=200, help='number of runs (default: 200)')
    found.add_argument('--seed', type=int, default=1, help='seed of the noise (default: 1)')
    return found
