# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure accuracy and cost: error and time of methods, step sizes and horizons."""

from dataclasses import replace
import math
from pathlib import Path

from hnn_vi_ros.files.command_line import Parser, seconds
from hnn_vi_ros.simulation.accuracy.path_reference import Instants, PathReference
import numpy as np
from studies.measuring import measure_row, MethodRun, StudyRow, TOO_LONG
from studies.references import Floor, floor_of, make_reference
from studies.work_precision_plan import HALVINGS, LONGEST, prepare, Setting, Study
from tqdm import tqdm

# Scenes of the page on accuracy and cost: learned ones, then exact ones.
SCENES = ('harmonic_oscillator', 'pendulum', 'double_pendulum', 'learned_kepler',
          'learned_henon_heiles', 'exact_harmonic_oscillator', 'exact_pendulum',
          'exact_double_pendulum', 'kepler', 'henon_heiles')
# Timed runs at all but the shortest horizon.
FEW_RUNS = 3
# Estimated time of one gradient [s], for the first progress bar.
_GRADIENT, _GRADIENTS_PER_STAGE = 1e-6, 6


def main(argv: list[str]) -> int:
    """Measure missing rows, then write tables and pictures."""
    arguments = parser().parse_args(argv)
    # Imported late: matplotlib takes a second, and errors should appear at once.
    if not arguments.draw:
        base = arguments.out or Path('work_precision')
        named = {arguments.scene: arguments.out} if arguments.scene is not None else {
            scene: base / scene for scene in SCENES}
        # All of them before the first is measured: a mistake shows at once.
        studies = [prepare(arguments, scene, out) for scene, out in named.items()]
        try:
            for study in studies:
                measure(study)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f'stopped: {len(study.results.rows)} rows are kept in {study.results.folder}; '
                'the same command goes on from there') from None
        from studies.work_precision_report import write_report
        written = [path for study in studies
                   for path in write_report(study.results, study.scene.name)]
        if arguments.scene is not None:
            print(*written, sep='\n')
            return 0
    from studies.accuracy_page import keep_results, write_pages
    if not arguments.draw:
        keep_results(arguments.docs, {study.scene.name: study.results for study in studies})
    print(*write_pages(arguments.docs), sep='\n')
    return 0


def measure(study: Study) -> None:
    """Measure every row that is not there yet, horizon by horizon, and show the time left."""
    runs: dict[int, MethodRun] = {}
    references: dict[float, PathReference] = {}
    todo = [(horizon, i) for horizon in study.horizons for i in range(len(study.settings))
            if not _is_settled(study, horizon, i)]
    with tqdm(total=1.0, bar_format='{desc} {percentage:3.0f}% |{bar}|{postfix}',
              disable=None) as bar:
        for done, (horizon, i) in enumerate(todo):
            setting = study.settings[i]
            left = sum(_expected(study, *item) for item in todo[done:])
            bar.total = max(bar.n + left, 1e-9)
            bar.set_description_str(f'{study.scene.name}, T = {horizon:g} s', refresh=False)
            bar.set_postfix_str(f'about {_as_duration(left)} left, {len(todo) - done} rows: '
                                f'{setting.label} {_as_step(setting.step_size)}')
            reference = references.get(horizon) or references.setdefault(
                horizon, _reference(study, horizon))
            row = _known_row(study, horizon, setting)
            if row is None:
                run = runs[i] if i in runs else runs.setdefault(i, setting.create())
                row = measure_row(run, reference, _timed_runs(study, horizon))
            study.results.add(row)
            bar.update(_expected(study, horizon, i))
        bar.set_postfix_str(f'done, {len(todo)} rows')
    study.results.tidy()


def _timed_runs(study: Study, horizon: float) -> int:
    return study.runs if horizon == study.horizons[0] else min(FEW_RUNS, study.runs)


def _is_settled(study: Study, horizon: float, i: int) -> bool:
    """Return whether a row is there; one that was too long is tried under another limit."""
    setting = study.settings[i]
    row = study.results.find(_key(setting, horizon))
    return row is not None and not (
        row.status.startswith(TOO_LONG) and (_seconds(study, horizon, setting) or 0.0)
        <= study.limit)


def _key(setting: Setting, horizon: float) -> tuple:
    return StudyRow(setting.label, setting.step_size, horizon, *[math.nan] * 5, status='').key


def _shorter_rows(study: Study, horizon: float, setting: Setting) -> list[StudyRow]:
    """Return the rows of the same setting at shorter horizons, the longest of them first."""
    rows = (study.results.find(_key(setting, shorter))
            for shorter in reversed(study.horizons) if shorter < horizon)
    return [row for row in rows if row is not None]


def _seconds(study: Study, horizon: float, setting: Setting) -> float | None:
    """Return the expected time of one run [s], None if unknown."""
    for row in _shorter_rows(study, horizon, setting):
        if row.finished:
            return row.seconds_per_simulated_second * horizon
    return None


def _expected(study: Study, horizon: float, i: int) -> float:
    """Return the estimated time of a row [s]."""
    setting = study.settings[i]
    seconds = _seconds(study, horizon, setting)
    if seconds is None:
        step = study.scene.step_size if math.isnan(setting.step_size) else setting.step_size
        seconds = horizon / step * setting.stages * _GRADIENTS_PER_STAGE * _GRADIENT
    return 0.05 if seconds > study.limit else 0.05 + seconds * (1 + _timed_runs(study, horizon))


def _known_row(study: Study, horizon: float, setting: Setting) -> StudyRow | None:
    """Return a row that needs no run: it fails as the shorter one did, or takes too long."""
    for row in _shorter_rows(study, horizon, setting):
        if row.failed:
            return replace(row, horizon=horizon)
    seconds = _seconds(study, horizon, setting)
    if seconds is None or seconds <= study.limit:
        return None
    return StudyRow(setting.label, setting.step_size, horizon, *[math.nan] * 5,
                    status=f'{TOO_LONG}: about {seconds:.3g} s')


def _reference(study: Study, horizon: float) -> PathReference:
    """Return the reference of a horizon: no path from the first chaotic horizon on."""
    floors = study.results.floors
    lost = [floor for other, floor in floors.items() if other <= horizon and not floor.verified]
    if lost:
        reference = PathReference(Instants.of(horizon, horizon, 1), np.empty((0, 2)), math.inf,
                                  'none: the motion is chaotic')
        floor = Floor(reference.how, model=lost[-1].model)
    else:
        reference = make_reference(study.hamiltonian, *study.start, horizon)
        floor = floor_of(reference, study.hamiltonian, *study.start)
    if horizon not in floors:
        study.results.keep_floor(horizon, floor)
    return reference


def _as_duration(seconds: float) -> str:
    minutes = seconds / 60.0
    return f'{seconds:.0f} s' if minutes < 1.5 else f'{minutes:.0f} min'


def _as_step(step_size: float) -> str:
    return '' if math.isnan(step_size) else f'h = {step_size:g} s'


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('work_precision', __doc__, [
        'make study NAME=work_precision ARGS="--scene pendulum --horizons 10 --runs 3"',
        'make study NAME=work_precision ARGS="--scene kepler --methods gauss8 yoshida4 --peers"'])
    what = found.add_mutually_exclusive_group(required=True)
    what.add_argument('--scene', metavar='NAME', help='name of a shipped scene, or file')
    what.add_argument('--all', action='store_true', help=(
        f'measure {", ".join(SCENES)}, and write the page on accuracy and cost'))
    what.add_argument('--draw', action='store_true', help=(
        'write that page, its pictures and the explorer from the rows in the folder of --docs, '
        'without measuring'))
    found.add_argument('--methods', nargs='+', metavar='METHOD', help=(
        'integrators; METHOD@1e-4 solves its equations only to this residual, METHOD@3 with 3 '
        'iterations; METHOD@float32 computes gradients in single precision'))
    found.add_argument('--horizons', nargs='+', type=seconds, metavar='SECONDS', help=(
        'simulated times after which errors are measured'))
    found.add_argument('--steps', nargs='+', type=seconds, metavar='SECONDS', help=(
        f'step sizes (default: {LONGEST:g} times that of the scene, and {HALVINGS} halvings)'))
    found.add_argument('--out', type=Path, metavar='DIR', help=(
        'folder of the results (default: work_precision/SCENE; with --all work_precision, with '
        'one folder for each scene)'))
    found.add_argument('--docs', type=Path, metavar='DIR', default=Path('docs/evidence'),
                       help='folder of the page that --all writes (default: docs/evidence)')
    found.add_argument('--peers', action='store_true',
                       help='also measure scipy, torchdiffeq and diffrax')
    found.add_argument('--runs', type=int, help='timed runs at the shortest horizon')
    found.add_argument('--limit', type=seconds, metavar='SECONDS',
                       help='do not start a run that would take longer')
    return found
