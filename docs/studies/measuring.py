# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of work-precision studies: one method, step size and horizon, with its time."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import math
import time
from typing import NamedTuple

from hnn_vi_ros.simulation import InitialValueProblem, measure_costs, MethodCost
from hnn_vi_ros.simulation.accuracy.path_reference import PathReference
import numpy as np

# solve(z0, duration, setting) returns (q, p) at the end, shape (2 d,), and gradients evaluated;
# the setting is a tolerance, relative and absolute, or a step size.
Solve = Callable[[np.ndarray, float, float], tuple[np.ndarray, int]]

OK, ENERGY_ONLY, TOO_LONG = 'ok', 'energy only', 'too long'
# Number of states of a peer for its energy error, and number of timed runs.
_LOOKS, _RUNS = 10, 3
# Tolerances of adaptive peers; the longest fixed step over the one that resolves the path, and
# its halvings; time of a run of a peer [s], and ratio to the fastest row with at most its error,
# after which no smaller tolerance or step follows; time of timed runs after which none follows.
TOLERANCES = tuple(10.0 ** -k for k in range(3, 14))
_LONGEST, _HALVINGS, _LONGEST_RUN, _SLOWEST, _TIMED = 4.0, 8, 30.0, 12.0, 10.0


@dataclass(frozen=True)
class StudyRow:
    """
    Measurements of one row; a figure that there is none for is NaN.

    Parameters
    ----------
    method : str
        The label of a method or a peer, with its tolerance if it is adaptive.
    step_size : float
        h [s]; NaN for an adaptive method.
    horizon : float
        T, how long was simulated [s].
    path_error : float
        Largest abs((q, p) - reference) over the instants at which a step ends, of a peer at ten;
        not below the accuracy of the reference, beyond which nothing is known.
    energy_band : float
        Largest abs(H - H0) [J], over about a thousand states; of a peer, over ten.
    seconds_per_simulated_second : float
        Least processor time of some runs, over T; of stored rows with `p95_seconds` the median
        of wall times.
    p95_seconds : float
        95th percentile of wall times, over T, of stored rows; NaN for others.
    gradients_per_simulated_second : float
        Gradients and Hessian-vector products over T.
    status : str
        'ok'; 'energy only' where no path can be verified; 'too long: ...' in stored rows of runs
        that were skipped; else why the run failed, and when.

    """

    method: str
    step_size: float
    horizon: float
    path_error: float
    energy_band: float
    seconds_per_simulated_second: float
    p95_seconds: float
    gradients_per_simulated_second: float
    status: str

    @property
    def us_per_simulated_second(self) -> float:
        """Return the median of the wall time [us per simulated second]."""
        return 1e6 * self.seconds_per_simulated_second

    @property
    def is_peer(self) -> bool:
        """Return whether it is a peer's, not one of ours, whose names have no spaces."""
        return ' ' in self.family

    @property
    def family(self) -> str:
        """Return the label without the tolerance."""
        return self.method.partition(' tolerance=')[0]

    def setting(self, form: str = '{:.2g} s') -> str:
        """Return the tolerance, or the step size in a format."""
        if math.isnan(self.step_size):
            return 'tol ' + self.method.partition(' tolerance=')[2]
        return form.format(self.step_size)

    @property
    def is_ours(self) -> bool:
        """Return whether it is of one of our methods."""
        return not self.is_peer

    @property
    def was_run(self) -> bool:
        """Return whether it was measured, a failed run included, and not left for its time."""
        return not self.status.startswith(TOO_LONG)

    @property
    def finished(self) -> bool:
        """Return whether the run came to its end."""
        return self.status.startswith((OK, ENERGY_ONLY))

    @property
    def failed(self) -> bool:
        """Return whether the run started and did not finish."""
        return not self.finished and self.was_run


class Peer(NamedTuple):
    """A peer's method: its name, whether it chooses its own steps, and how it is called."""

    name: str
    adaptive: bool
    solve: Solve


def measure_rows(problem: InitialValueProblem, peers: Sequence[Peer], horizon: float,
                 seconds: float, show: Callable[[float, str], None] = lambda share, what: None
                 ) -> tuple[list[StudyRow], PathReference]:
    """
    Return the rows of our methods, by ``measure_costs``, and of peers, with their reference.

    Parameters
    ----------
    problem : InitialValueProblem
        A problem without effects.
    peers : sequence of Peer
        Peers to measure.
    horizon : float
        Simulated time [s]; shorter if the path cannot be computed that far.
    seconds : float
        Approximate budget of processor time of our methods [s].
    show : callable, optional
        Progress callback, see ``measure_costs``.

    """
    study = measure_costs(problem, horizon, seconds, show=show)
    reference, status = study.reference, ENERGY_ONLY if study.no_path else OK
    rows = [StudyRow(*_label(cost), reference.horizon, cost.path_error,
                     cost.energy_error * study.known.energy_scale, cost.seconds, math.nan,
                     cost.gradients, cost.failure or status) for cost in study.costs]
    # Each step of a peer divides the time between two of its looks.
    most = _LOOKS * math.ceil(reference.horizon / (_LOOKS * _LONGEST * study.known.step_size))
    steps = [reference.horizon / (most * 2 ** k) for k in range(_HALVINGS + 1)]
    column = 'path_error' if reference.verified else 'energy_band'
    for peer in peers:
        for setting in TOLERANCES if peer.adaptive else steps:
            show(1.0, f'{peer.name} {setting:g}')
            rows.append(row := peer_row(peer, setting, problem, reference))
            best = cheapest(rows, getattr(row, column), column)
            if best is not None and row.seconds_per_simulated_second > min(
                    _LONGEST_RUN / reference.horizon,
                    _SLOWEST * best.seconds_per_simulated_second):
                break
    return rows, reference


def cheapest(rows: Iterable[StudyRow], error: float, column: str = 'path_error'
             ) -> StudyRow | None:
    """Return the fastest row with at most this error."""
    good = [row for row in rows if row.finished and getattr(row, column) <= error]
    return min(good, key=lambda row: row.seconds_per_simulated_second, default=None)


def _label(cost: MethodCost) -> tuple[str, float]:
    """Return the label of one of our methods, and its step size."""
    tolerance = cost.method.tolerance
    return (cost.method.kind, cost.step_size) if tolerance is None else (
        f'{cost.method.kind} tolerance={tolerance:g}', math.nan)


def peer_row(peer: Peer, setting: float, problem: InitialValueProblem, reference: PathReference
             ) -> StudyRow:
    """
    Measure a peer at one tolerance [1] or step size [s].

    The path error is the largest at the horizon, of a run like those that are timed, and at the
    looks of another run, which stops there: between its own steps a peer would show the error of
    its interpolation. The energy band is that at the same states.
    """
    states, horizon = [np.concatenate([problem.q, problem.p])], reference.horizon
    row = StudyRow(f'{peer.name} tolerance={setting:g}' if peer.adaptive else peer.name,
                   math.nan if peer.adaptive else setting, horizon, *[math.nan] * 5, OK)
    try:
        for _ in range(_LOOKS):
            states.append(_solve(peer, states[-1], horizon / _LOOKS, setting)[0])
        end, gradients = _solve(peer, states[0], horizon, setting)
    except (ArithmeticError, AssertionError, RuntimeError) as problem_of_peer:
        # The first words: the rest is advice on options.
        reason = ' '.join(str(problem_of_peer).split())[:60] or type(problem_of_peer).__name__
        done = min(len(states) - 1, _LOOKS - 1) * horizon / _LOOKS
        return replace(row, status=f'{reason} after t = {done:g} s')
    # A rotation has one column less in p than in q.
    energies = problem.hamiltonian.energy(
        *np.split(np.array([*states, end]), [problem.q.size], axis=1))
    times, path_error = list[float](), math.nan
    if reference.verified:
        # The instants at the looks: a shortened path has none at some of them.
        count = reference.instants.count
        found = [(states[k], reference.states[k * count // _LOOKS - 1])
                 for k in range(1, _LOOKS + 1) if k * count % _LOOKS == 0]
        found.append((end, reference.states[-1]))
        path_error = max(float(np.abs(state - true).max()) for state, true in found)
    while len(times) < _RUNS and sum(times) < _TIMED:
        start = time.process_time()
        peer.solve(states[0], horizon, setting)
        times.append(time.process_time() - start)
    return replace(
        row, path_error=max(path_error, reference.accuracy),
        energy_band=float(np.abs(energies - energies[0]).max()),
        seconds_per_simulated_second=min(times) / horizon,
        gradients_per_simulated_second=gradients / horizon,
        status=OK if reference.verified else ENERGY_ONLY)


def _solve(peer: Peer, z: np.ndarray, duration: float, setting: float) -> tuple[np.ndarray, int]:
    """Return the end of a run of a peer, and its gradients; FloatingPointError if not finite."""
    with np.errstate(over='ignore', invalid='ignore'):
        end, gradients = peer.solve(z, duration, setting)
    if not np.isfinite(end).all():
        raise FloatingPointError('not finite')
    return end, gradients
