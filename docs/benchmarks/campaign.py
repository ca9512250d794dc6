# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compare the choice of `integrator: auto` with the best of a sweep, on systems not shipped.

Run it in the folder docs with ``python -m benchmarks.campaign --out FILE.json``: each row is
written when it is finished, and an interrupted run continues with the next row. With
``--table FILE.md`` the rows become a page.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
import json
import math
from operator import itemgetter
from pathlib import Path
import time

from benchmarks.choosing import path_run
from benchmarks.measurement import interleave
from benchmarks.systems import System, systems
from hnn_vi_ros.errors import CalibrationError, StepFailure, UnsupportedSystem
from hnn_vi_ros.simulation.accuracy.automatic_choice import calibrate
from hnn_vi_ros.simulation.accuracy.diagnostics import energy_scale
from hnn_vi_ros.simulation.accuracy.trials import (
    CalibrationTask, InitialValueProblem, Method, Tolerance, work)
import numpy as np
from scipy.integrate import solve_ivp
from studies.results import commit, machine

# Horizons in periods, and errors.
TOLERANCES = (
    ('energy_error', 1e-3, 30.0), ('energy_error', 1e-8, 30.0), ('path_error', 1e-5, 6.0))
_METHODS = [*(Method('time_transformed', {'base': base, 'force': force})
              for base in ('gauss8', 'gauss6', 'gauss4') for force in (1.0, 0.2)),
            *(Method(f'gauss{order}') for order in range(16, 2, -2)), Method('stormer_verlet'),
            Method('generalized_leapfrog'), Method('variational_euler')]
# Steps of the sweep: the horizon over round(ratio^k), down to these; each by at most this many
# gradients, or a multiple of the gradients of the best so far.
_RATIO, _MOST, _GRADIENTS, _DEARER = 1.19, 4_000_000, 20_000_000, 1.1
_SAMPLES, _RUNS = 20_000, 5
_PAGE = """\
# The automatic choice on systems that are not shipped

`integrator: auto` met its tolerance at no more than 1.5 times the best cost in {good} of
{measured} rows. No system on this page was used to develop its rules.

The best row is the cheapest row of a sweep over {methods} methods, with steps up to half a period
and a factor of {ratio} between steps. The error of each choice is measured again at every step,
against an exact orbit or DOP853 of scipy at 3e-14. Energies are relative to the energy scale.
Each cell contains the method that auto chose, and its {counted} per simulated second relative to
the best row. Energies are held for 30 periods and paths for 6. The ratios of times (runs of each:
{runs}) are {least:.2g} to {most:.2g}, with the median {median:.2g}.
[automatic-choice.json](automatic-choice.json) contains steps, errors, times and the best rows.

The commits are from before `dop853` and `rk4` were among the methods of auto, which takes them
today for path errors where they are cheaper, and before it counted the fixed cost of steps.

{table}

Machine: {machine}; commits {commits}.
To measure missing rows, run in `docs/`:

```bash
python -m benchmarks.campaign --out evidence/automatic-choice.json \\
    --table evidence/automatic-choice.md
```
"""


@dataclass(frozen=True)
class Row:
    """
    A system and a tolerance.

    Parameters
    ----------
    chosen, best : str
        Method and step of auto (or the reason for its refusal) and of the sweep.
    error : float
        Error of the choice of auto, measured again.
    gradients, best_gradients : float
        A simulated second [1/s].
    seconds, best_seconds : float
        Wall time of one [s/s].
    took : float
        Wall time of the choice [s].
    counted : str
        Costs counted by auto and the sweep.
    runs : int
        Number of runs whose median the times are.
    commit, machine : str
        Commit and machine of the measurement.

    """

    system: str
    tolerance: str
    allowed: float
    chosen: str
    error: float
    gradients: float
    seconds: float
    best: str
    best_gradients: float
    best_seconds: float
    took: float
    counted: str
    runs: int
    commit: str
    machine: str

    @property
    def good(self) -> bool:
        """Return whether the tolerance was met with at most 1.5 times the best gradients."""
        if math.isnan(self.error):
            return math.isnan(self.best_gradients)
        return self.error <= self.allowed and not self.gradients > 1.5 * self.best_gradients


class Truth:
    """
    The path of a system by scipy's DOP853, or exact, which nothing of auto's is used for.

    Parameters
    ----------
    problem : InitialValueProblem
        The initial value problem.
    horizon : float
        Until when [s].

    """

    def __init__(self, problem: InitialValueProblem, horizon: float):
        self._problem, d = problem, problem.hamiltonian.dimension

        def field(t: float, z: np.ndarray) -> np.ndarray:
            dH_dq, dH_dp = problem.hamiltonian.gradient(z[:d], z[d:])
            return np.concatenate([dH_dp, -dH_dq])
        self._solution = solve_ivp(
            field, (0.0, horizon * (1.0 + 1e-9)), np.concatenate([problem.q, problem.p]),
            method='DOP853', rtol=3e-14, atol=1e-14, dense_output=True).sol
        states = self._solution(np.linspace(0.0, horizon, 4001)).T
        self.scale = energy_scale(problem.hamiltonian, *np.split(states, 2, axis=1))

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return (q, p) at times, shape (n, 2 d)."""
        exact = self._problem.hamiltonian.exact_motion(self._problem.q, self._problem.p, times)
        return self._solution(times).T if exact is None else exact.path


def measure(problem: InitialValueProblem, truth: Truth, tolerance: Tolerance, method: Method,
            steps: int, most: float) -> tuple[float, float]:
    """
    Return the error at every step, or some thousand, and the work of a simulated second.

    Both are inf if the error is too large, and the work alone if it is too much.
    """
    simulation = problem.simulation(method, tolerance.horizon / steps)
    every, start, worst = math.ceil(steps / _SAMPLES), simulation.energy, 0.0
    while simulation.steps < steps:
        first = simulation.steps
        count = min(200, (steps - first) // every) or 1
        states = np.hstack(simulation.record(count, every))
        if tolerance.kind == 'energy_error':
            energy = problem.hamiltonian.energy(*np.split(states, 2, axis=1))
            error = np.abs(energy - start).max() / truth.scale
        else:
            times = simulation.step_size * (first + every * np.arange(1, count + 1))
            inside = times <= tolerance.horizon * (1.0 + 1e-12)
            error = np.abs(states - truth.at(times))[inside].max(initial=0.0)
        worst = max(worst, float(error))
        if worst > tolerance.error:
            return math.inf, math.inf
        if work(simulation) > most:
            return worst, math.inf
    return worst, work(simulation) / simulation.time


def swept(problem: InitialValueProblem, truth: Truth, tolerance: Tolerance, least: float = 1.0
          ) -> list[tuple[Method, float, float]]:
    """
    Return methods, the cheapest step [s] of each and its work, with a minimum of steps.

    One step from next to an equilibrium to the horizon may end at the same energy by accident. A
    method is given up where it costs more than the best so far, and a tenth.
    """
    found: dict[int, tuple[Method, float, float]] = {}
    limit = _GRADIENTS
    counts = sorted(n for n in {round(_RATIO ** k) for k in range(100)} if least <= n <= _MOST)
    for place, method in enumerate(_METHODS):
        held = 0
        for steps in counts:
            try:
                error, cost = measure(problem, truth, tolerance, method, steps, limit)
            except StepFailure:
                continue
            except UnsupportedSystem:
                break
            held += error <= tolerance.error
            if cost < math.inf:
                if place not in found or cost < found[place][2]:
                    found[place] = method, tolerance.horizon / steps, cost
                limit = min(limit, _DEARER * cost * tolerance.horizon)
            # More steps cost more: one gradient each at least.
            if held == 3 or steps > limit:
                break
    return sorted(found.values(), key=itemgetter(2))


def sweep(problem: InitialValueProblem, truth: Truth, tolerance: Tolerance, least: float = 1.0
          ) -> tuple[str, float, float]:
    """Return the cheapest of all methods and steps, its gradients and its time."""
    for method, h, cost in swept(problem, truth, tolerance, least):
        return f'{method}, h = {h:.3g}', cost, seconds(problem, method, h, tolerance.horizon)
    return 'none', math.nan, math.nan


def seconds(problem: InitialValueProblem, method: Method, h: float, horizon: float) -> float:
    """Return the wall time per simulated second [s/s], the median of all runs."""
    steps = max(1, round(min(horizon, 0.2 * horizon + 20.0 * h) / h))
    simulation = problem.simulation(method, h)
    times = interleave([path_run(problem, simulation, 1, steps)], _RUNS, one_thread=False)
    return float(np.median(times)) / (steps * h)


def row(name: str, system: System, kind: str, error: float, periods: float) -> Row:
    """Measure one system with one tolerance."""
    problem, tolerance = system.problem, Tolerance(kind, error, periods * system.period)
    text = f'{kind} {error:g} up to {tolerance.horizon:.4g} s'
    truth = Truth(problem, tolerance.horizon)
    begin = time.perf_counter()
    try:
        choice = calibrate(CalibrationTask(problem, tolerance))
    except CalibrationError as refusal:
        taken = time.perf_counter() - begin
        chosen = f'refused: {refusal}', math.nan, math.nan, math.nan
    else:
        taken = time.perf_counter() - begin
        method = Method(choice.method, choice.arguments)
        steps = math.ceil(tolerance.horizon / choice.step_size * (1.0 - 1e-12))
        wide = Tolerance(kind, math.inf, steps * choice.step_size)
        chosen = (f'{method}, h = {choice.step_size:.3g}',
                  *measure(problem, truth, wide, method, steps, math.inf),
                  seconds(problem, method, choice.step_size, tolerance.horizon))
    return Row(name, text, error, *chosen, *sweep(problem, truth, tolerance, 2.0 * periods),
               taken, 'gradients and the fixed cost of steps', _RUNS, commit(), machine())


def run(out: Path, names: list[str], say: Callable[[str], None]) -> list[Row]:
    """Measure what the file lacks, and return all rows."""
    rows = [Row(**entry) for entry in json.loads(out.read_text())] if out.exists() else []
    done = {(row.system, row.tolerance.split()[0], row.allowed) for row in rows}
    for name, system in systems().items():
        for kind, error, periods in TOLERANCES:
            if (name, kind, error) in done or (names and name not in names):
                continue
            rows.append(row(name, system, kind, error, periods))
            part = out.with_suffix('.part')
            part.write_text(json.dumps([asdict(entry) for entry in rows], indent=1))
            part.replace(out)
            say(f'{"good" if rows[-1].good else "MISS"} {rows[-1]}')
    return rows


def page(rows: list[Row]) -> str:
    """Return the page."""
    times = sorted(entry.seconds / entry.best_seconds for entry in rows)
    return _PAGE.format(
        good=sum(entry.good for entry in rows), measured=len(rows), methods=len(_METHODS),
        ratio=_RATIO, least=times[0], most=times[-1], median=times[len(times) // 2],
        table='\n'.join(table(rows)), **{name: ', '.join(dict.fromkeys(
            str(getattr(row, field)) for row in rows)) for name, field in (
                ('counted', 'counted'), ('runs', 'runs'), ('machine', 'machine'),
                ('commits', 'commit'))})


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of the table: each method chosen, and its gradients over the best's."""
    yield f'| system | {" | ".join(f"{kind} {error:g}" for kind, error, _ in TOLERANCES)} |'
    yield f'|---|{"---|" * len(TOLERANCES)}'
    for name in dict.fromkeys(row.system for row in rows):
        cells = dict.fromkeys(((kind, error) for kind, error, _ in TOLERANCES), '')
        for entry in (row for row in rows if row.system == name):
            cells[entry.tolerance.split()[0], entry.allowed] = (
                f'{entry.chosen.split(" ")[0].strip(",")} '
                f'{entry.gradients / entry.best_gradients:.2f}'
                + ('' if entry.good else ' **missed**'))
        yield f'| {name} | {" | ".join(cells.values())} |'


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, required=True, help='JSON file of the rows')
    parser.add_argument('--table', type=Path, help='Markdown file to write the table to')
    parser.add_argument('systems', nargs='*', help='names of systems (default: all)')
    options = parser.parse_args()
    rows = run(options.out, options.systems, lambda text: print(text, flush=True))
    if options.table:
        options.table.write_text(page(rows))


if __name__ == '__main__':
    main()
