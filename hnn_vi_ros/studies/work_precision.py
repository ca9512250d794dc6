# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure what accuracy costs: methods, step sizes and horizons against error and time."""

from dataclasses import replace
import math
from pathlib import Path
import sys

from hnn_vi_ros.studies import arguments as command_lines
from hnn_vi_ros.studies.arguments import SCENES
from hnn_vi_ros.studies.measuring import measure_row, MethodRun, StudyRow, TOO_LONG
from hnn_vi_ros.studies.references import make_reference, model_error, Reference, true_hamiltonian
from hnn_vi_ros.studies.work_precision_plan import prepare, Setting, Study
from tqdm import tqdm

# Timed runs at all but the shortest horizon.
FEW_RUNS = 3
# The reference's first step over the scene's own.
_REFERENCE = 10.0
# About what one gradient takes [s], for the progress bar before anything is known.
_GRADIENT, _GRADIENTS_PER_STAGE = 1e-6, 6


def main(argv: list[str]) -> int:
    """Measure what is not measured yet, then write tables and pictures."""
    arguments = command_lines.work_precision().parse_args(argv)
    if arguments.draw:
        # Here and below: matplotlib and rerun take a second, which a mistake should not wait for.
        from hnn_vi_ros.studies.accuracy_page import draw_again
        print(*draw_again(arguments.docs), sep='\n')
        return 0
    base = arguments.out or Path('work_precision')
    if arguments.scene is not None:
        studies = [prepare(arguments, arguments.scene, arguments.out)]
    else:
        # All of them before the first is measured: a mistake shows at once.
        studies = [prepare(arguments, scene, base / scene) for scene in SCENES]
    try:
        for study in studies:
            measure(study)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f'stopped: {len(study.results.rows)} rows are kept in {study.results.folder}; the '
            'same command goes on from there') from None
    from hnn_vi_ros.studies.accuracy_page import write_page
    from hnn_vi_ros.studies.work_precision_report import write_report
    written = [path for study in studies for path in write_report(study.results, study.scene.name)]
    for path in written if arguments.scene is not None else write_page(base, arguments.docs):
        print(path)
    return 0


def measure(study: Study) -> None:
    """Measure every row that is not there yet, horizon by horizon, and show the time left."""
    runs: dict[int, MethodRun] = {}
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
            reference = _reference(study, horizon)
            row = _known_row(study, horizon, setting)
            if row is None:
                run = runs[i] if i in runs else runs.setdefault(i, setting.create())
                row = measure_row(run, horizon, reference, _timed_runs(study, horizon))
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
    """Return what one run will take [s], None if nothing is known."""
    for row in _shorter_rows(study, horizon, setting):
        if row.finished:
            return row.seconds_per_simulated_second * horizon
    return None


def _expected(study: Study, horizon: float, i: int) -> float:
    """Return about what a row will take [s]."""
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


def _reference(study: Study, horizon: float) -> Reference:
    """Return what a horizon is measured against, from the folder if it is there."""
    results = study.results
    if horizon in results.references:
        return results.references[horizon]
    before = [results.references[T] for T in study.horizons[:study.horizons.index(horizon)]]
    truth, h = true_hamiltonian(study.hamiltonian), _REFERENCE * study.scene.step_size
    if before and not before[-1].verified:
        reference = replace(before[-1], accuracy=math.inf, path=before[-1].path[:0],
                            how='none: the motion is chaotic')
        model = results.model_errors.get(study.horizons[study.horizons.index(horizon) - 1])
    else:
        reference = make_reference(study.hamiltonian, *study.start, horizon, h)
        model = truth and replace(
            model_error(reference, truth, *study.start, horizon, h),
            box=study.hamiltonian.checkpoint.card.energy_error)
    results.keep_reference(horizon, reference, model)
    return reference


def _as_duration(seconds: float) -> str:
    minutes = seconds / 60.0
    return f'{seconds:.0f} s' if minutes < 1.5 else f'{minutes:.0f} min'


def _as_step(step_size: float) -> str:
    return '' if math.isnan(step_size) else f'h = {step_size:g} s'


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
