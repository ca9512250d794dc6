# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pages docs/accuracy/<scene>.md: what accuracy costs in one scene, horizon by horizon."""

from collections.abc import Iterator

from studies.results import Results
from studies.work_precision_report import (
    best_table, circumstances, drift_table, horizons_of, of_horizon, ours, was_run)

# Step sizes of each variant that are shown.
_DRIFT_STEPS = 3
_DRIFT = """\
## Steps that are not solved, gradients that are rounded

A name with `@1e-4` is the method with its equations solved to a residual of 1e-4 only; with
`@float32`, the method with a gradient in single precision. Neither is a method of the simulator,
which solves every step to round-off. A band that grows with the horizon is a drift.
"""


def scene_page(name: str, results: Results) -> str:
    """
    Return the page of one scene.

    Parameters
    ----------
    name : str
        Of the scene.
    results : Results
        Of it.

    """
    return '\n'.join(_lines(name, results)).rstrip('\n') + '\n'


def picture_name(scene: str, horizon: float) -> str:
    """Return the file name of the picture of a scene and a horizon [s]."""
    return f'{scene}_{horizon:g}s.png'.replace('+', '')


def title(scene: str, horizon: float) -> str:
    """Return the title of the picture of a scene and a horizon [s]."""
    return f'{scene}: what accuracy costs over {horizon:g} s'


def shown(results: Results) -> list[float]:
    """Return the horizons that at least half of our rows were run to: less shows nothing."""
    return [horizon for horizon in horizons_of(results) if _share_run(results, horizon) >= 0.5]


def _share_run(results: Results, horizon: float) -> float:
    rows = ours(of_horizon(results, horizon))
    return sum(map(was_run, rows)) / len(rows)


def _lines(name: str, results: Results) -> Iterator[str]:
    yield f'# What accuracy costs: {name}\n'
    yield ('A part of [what accuracy costs in time](../accuracy-and-cost.md), which says what '
           f'the columns mean.\nEvery run: [{name}.csv]({name}.csv).\n')
    for horizon in shown(results):
        yield f'## T = {horizon:g} s\n'
        yield f'![{name}, T = {horizon:g} s]({picture_name(name, horizon)})\n'
        yield from (f'- {line}' for line in circumstances(results, horizon))
        yield '\n' + best_table(of_horizon(results, horizon))
    drift = drift_table(results, _DRIFT_STEPS)
    if drift:
        yield _DRIFT
        yield drift
