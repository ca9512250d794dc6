# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Chains of point masses and a pendulum over magnets, as in the tables of CHNN.

M. Finzi, K. Wang, A. Wilson, Simplifying Hamiltonian and Lagrangian neural networks via explicit
constraints, NeurIPS 2020. Masses and lengths are random from 0.6 to 1.4, and g = 1. The published
model knows which bodies are joined and learns masses and a potential; ours is a URDF of rigid
links of known length, with unknown masses, centres of mass and gravity.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from hnn_vi_ros.files.command_line import Parser
from matplotlib.figure import Figure
import numpy as np
from studies.known_tables import CLAIMS, CSV, keep, parser_of, save
from studies.published_page import read_results, ResultTable
from studies.short_motions import chain_acceleration, followed, Mechanism

TABLE = 'chnn'
LINKS, SEEDS = (1, 2, 3, 5), 5
INTERVAL, TRAIN_SAMPLES, TEST_SAMPLES = 0.1, 21, 101
TRAIN, TEST = 20, 100
# The public code adds this to each relative error.
_LEAST = 1e-8
_LINK = """<link name="l{0}"><inertial><origin xyz="0 0 -1"/><mass value="1"/>
  <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
<joint name="j{0}" type="continuous"><parent link="{1}"/><child link="l{0}"/>
  <origin xyz="0 0 {2}"/><axis xyz="0 1 0"/></joint>
"""


def chain(links: int, random: np.random.Generator) -> tuple[Mechanism, np.ndarray]:
    """Return a chain of point masses, in the angles of its joints, and its lengths [m]."""
    masses, lengths = random.uniform(0.6, 1.4, (2, links))
    own = chain_acceleration(masses, lengths, 1.0)

    def acceleration(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        absolute = own(np.cumsum(q, axis=1), np.cumsum(v, axis=1), u)
        return np.diff(absolute, axis=1, prepend=0.0)
    parts = ''.join(_LINK.format(k, f'l{k - 1}' if k else 'base', -lengths[k - 1] if k else 0.0)
                    for k in range(links))
    return Mechanism(
        ' {kind: urdf, file: robot.urdf, gravity: [0.0, 0.0, -2.0]}',
        # Without forces a factor of all masses changes no motion: one mass is fixed.
        ('gravity.2', *(f'l{k}.centre_z' for k in range(links)),
         *(f'l{k}.mass' for k in range(1, links))),
        tuple(f'j{k}' for k in range(links)), acceleration,
        f'<robot name="chain"><link name="base"/>{parts}</robot>'), lengths


def cartesian(states: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return positions and velocities of the masses, shape (..., 4 n), of joint angles."""
    q, v = (np.cumsum(part, axis=-1) for part in np.split(states, 2, axis=-1))
    parts = np.sin(q), -np.cos(q), np.cos(q) * v, np.sin(q) * v
    return np.concatenate([np.cumsum(lengths * part, axis=-1) for part in parts], axis=-1)


def relative_error(found: np.ndarray, true: np.ndarray) -> float:
    """Return the geometric mean over runs and times of |x - y| / |x + y|, as published."""
    errors = np.linalg.norm(found - true, axis=-1) / np.linalg.norm(found + true, axis=-1)
    return float(np.exp(np.mean(np.log(errors + _LEAST))))


def measure(links: Sequence[int], seeds: int, train: int, test: int
            ) -> Iterator[tuple[str, int, str, float]]:
    """Yield the error of each chain and seed."""
    t = INTERVAL * np.arange(TEST_SAMPLES)
    for seed in range(seeds):
        for n in links:
            random = np.random.default_rng(seed)
            mechanism, lengths = chain(n, random)
            starts = np.diff(random.normal(size=(2, train + test, n)) * [[[1.0]], [[0.6]]],
                             prepend=0.0, axis=2)
            force = np.zeros((train + test, n))
            short = mechanism.motions(*starts[:, :train], force[:train], t[:TRAIN_SAMPLES])
            true = mechanism.motions(*starts[:, train:], force[train:], t)
            with TemporaryDirectory() as folder:
                scene = mechanism.identified(Path(folder), short, force[:train],
                                             t[:TRAIN_SAMPLES], INTERVAL)
                found = followed(scene, true[:, 0], force[train:], t)
            yield f'{n} links', seed, 'rigid links', relative_error(
                cartesian(found, lengths), cartesian(true, lengths))


def draw(results: ResultTable) -> Figure:
    """Draw our errors over the published ones, of this table and of that of SymODEN."""
    figure = Figure(figsize=(7.0, 3.0), layout='constrained')
    axes = figure.subplots()
    claims = [claim for claim in CLAIMS if claim.table in ('symoden', TABLE)]
    for k, claim in enumerate(claims):
        ratios = results.values(claim.table, claim.system, claim.measure) / claim.published
        axes.plot(ratios, [k] * len(ratios), 'o', color='#0072b2', markersize=4)
    axes.axvline(1.0, color='grey', linestyle=':')
    axes.set(xscale='log', xlabel='our error over the published one, each seed',
             yticks=range(len(claims)), yticklabels=[claim.system for claim in claims])
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    return figure


def main(argv: Sequence[str]) -> None:
    """Measure the table, and write it with its picture and the page."""
    arguments = parser().parse_args(argv)
    print(keep(arguments.out, TABLE, measure(
        *((1, 2), 1, 5, 3) if arguments.quick else (LINKS, SEEDS, TRAIN, TEST))))
    save(draw(ResultTable(read_results(arguments.out, CSV))), arguments.out, TABLE)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = parser_of(TABLE, __doc__)
    found.add_argument('--quick', action='store_true', help='few motions, to test the program')
    return found
