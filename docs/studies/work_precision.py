# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure accuracy and cost: errors and times of methods and peers over several horizons."""

import math
from pathlib import Path

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser, ProgressLine, seconds
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import InitialValueProblem, problem_of
from studies.measuring import measure_rows, Peer
from studies.references import Floor, floor_of
from studies.results import commit, keep_results, machine, Results

# Scenes of the page on accuracy and cost: learned ones, then exact ones.
SCENES = ('harmonic_oscillator', 'pendulum', 'double_pendulum', 'learned_kepler',
          'learned_henon_heiles', 'exact_harmonic_oscillator', 'exact_pendulum',
          'exact_double_pendulum', 'kepler', 'henon_heiles')
# Their ratio is a power of 2, so that methods take the same steps up to both.
HORIZONS = (10.0, 1280.0)


def main(argv: list[str]) -> int:
    """Measure scenes one by one, then write the page with its tables and pictures."""
    options = parser().parse_args(argv)
    # Imported late: matplotlib takes a second, and errors should appear at once.
    from studies.accuracy_page import FOLDER, write_pages
    if not options.draw:
        for name, values in (('horizons', options.horizons), ('seconds', [options.seconds])):
            if not all(0.0 < value < math.inf for value in values):
                raise ParameterError(f'--{name}: must be positive numbers')
        # Before any time is spent: a scene may be unsuitable, a package or a folder missing.
        problems = {name: _problem(name) for name in options.scenes}
        peers = {name: _peers(problem) if options.peers else []
                 for name, problem in problems.items()}
        folder = options.docs / FOLDER
        keep_results(folder, {})
        for name, problem in problems.items():
            keep_results(folder, {load_scene(name).name: measure(
                problem, peers[name], options.horizons, options.seconds)})
    print(*write_pages(options.docs), sep='\n')
    return 0


def measure(problem: InitialValueProblem, peers: list[Peer], horizons: list[float], budget: float
            ) -> Results:
    """Return the rows of all methods and peers, each horizon within a budget of time [s]."""
    floors, rows, line = dict[float, Floor](), [], ProgressLine()
    try:
        for horizon in sorted(horizons):
            found, reference = measure_rows(problem, peers, horizon, budget, line.show)
            rows += found
            floors[reference.horizon] = floor_of(
                reference, problem.hamiltonian, problem.q, problem.p)
    finally:
        line.close()
    return Results({'machine': machine(), 'number of --seconds': f'{budget:g}'}, [commit()],
                   floors, rows)


def _problem(name: str) -> InitialValueProblem:
    problem = problem_of(scene := load_scene(name))
    if problem.effects:
        raise ParameterError(f'{scene.source}: lists effects; accuracy is studied on the motion '
                             'of H alone: give a scene without effects')
    return problem


def _peers(problem: InitialValueProblem) -> list[Peer]:
    from studies.peers import create_peers
    return create_peers(problem.hamiltonian)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('work_precision', __doc__, [
        'make study NAME=work_precision ARGS="--scenes pendulum --horizons 10 --docs try"',
        'make study NAME=work_precision ARGS="--scenes kepler --peers"'])
    found.add_argument('--scenes', nargs='+', metavar='NAME', default=SCENES, help=(
        f'shipped scenes, or files (default: {", ".join(SCENES)}); other scenes keep their rows'))
    found.add_argument('--draw', action='store_true', help=(
        'only write the page, its pictures and the explorer, from the rows in the folder of '
        '--docs'))
    found.add_argument('--horizons', nargs='+', type=seconds, metavar='SECONDS',
                       default=HORIZONS, help=(
                           'simulated times up to which errors are measured (default: '
                           f'{" ".join(f"{horizon:g}" for horizon in HORIZONS)})'))
    found.add_argument('--seconds', type=seconds, default=600.0, help=(
        'processor time for our methods, for each scene and horizon (default: 600)'))
    found.add_argument('--docs', type=Path, metavar='DIR', default=Path('docs/evidence'),
                       help='folder of the rows and the page (default: docs/evidence)')
    found.add_argument('--peers', action='store_true',
                       help='also measure scipy, torchdiffeq and diffrax')
    return found
