# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""One row of a work-precision study: one method, step size and horizon, with its time."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
import gc
import math
import time
from typing import NamedTuple

from hnn_vi_ros.errors import reduce_error, StepFailure
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.accuracy.cost import run_errors, RunErrors
from hnn_vi_ros.simulation.accuracy.path_reference import PathReference
import numpy as np

# solve(z0, duration, setting) returns (q, p) at the end, shape (2 d,), and gradients evaluated;
# the setting is a tolerance, relative and absolute, or a step size.
Solve = Callable[[np.ndarray, float, float], tuple[np.ndarray, int]]

OK, ENERGY_ONLY, TOO_LONG = 'ok', 'energy only', 'too long'
# Number of states of a peer for its energy error.
_LOOKS = 10


@dataclass(frozen=True)
class StudyRow:
    """
    Measurements of one row; a figure that there is none for is NaN.

    Parameters
    ----------
    method : str
        The label of a method, a variant of one, or a peer with its tolerance.
    step_size : float
        h [s]; NaN for a peer that chooses its own.
    horizon : float
        T, how long was simulated [s].
    path_error : float
        Largest abs((q, p) - reference) over the instants at which a step ends, of a peer at the
        end; not below the accuracy of the reference, beyond which nothing is known.
    energy_band : float
        Largest abs(H - H0) [J], over about a thousand states; of a peer, over ten.
    seconds_per_simulated_second, p95_seconds : float
        Median and 95th percentile of the wall time of the timed runs, over T.
    gradients_per_simulated_second : float
        Gradients and Hessian-vector products over T.
    status : str
        'ok'; 'energy only' where no path can be verified; either with how many steps converged
        only in parts; 'too long: ...' for one that was not run; else why the run failed, and when.

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
    def key(self) -> tuple[str, float | None, float]:
        """Return the key of the row."""
        return (self.method, None if math.isnan(self.step_size) else self.step_size,
                self.horizon)

    @property
    def us_per_simulated_second(self) -> float:
        """Return the median of the wall time [us per simulated second]."""
        return 1e6 * self.seconds_per_simulated_second

    @property
    def is_peer(self) -> bool:
        """Return whether it is a peer's, not one of ours, whose names have no spaces."""
        return ' ' in self.method

    @property
    def is_ours(self) -> bool:
        """Return whether it is of one of our methods, solved to round-off in double precision."""
        return not self.is_peer and '@' not in self.method

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


class RunFailure(Exception):
    """A run ended before its horizon: reason, time [s] and number of gradients."""

    def __init__(self, reason: str, t: float, gradients: int):
        super().__init__(reason)
        self.reason, self.t, self.gradients = reason, t, gradients

    __reduce__ = reduce_error


class MethodRun(ABC):
    """A method at one setting, ready to be run to any horizon that its step divides."""

    label: str
    step_size: float

    @abstractmethod
    def measure(self, reference: PathReference) -> RunErrors:
        """Run once, looking at the states on the way; RunFailure if it does not arrive."""

    @property
    def note(self) -> str:
        """Return a note on the last run."""
        return ''

    @abstractmethod
    def prepare(self, horizon: float) -> Callable[[], object]:
        """Return a run that looks at nothing but the end, to be timed."""


class OwnRun(MethodRun):
    """
    One of our methods, compiled.

    Parameters
    ----------
    label : str
        See variants.
    simulation : Simulation
        At its initial state.
    hamiltonian : Hamiltonian
        By which energies are judged; not always the one that is integrated.

    """

    def __init__(self, label: str, simulation: Simulation, hamiltonian: Hamiltonian):
        self.label, self.step_size = label, simulation.step_size
        self._simulation, self._hamiltonian = simulation, hamiltonian
        self._start = simulation.q.copy(), simulation.p.copy()
        simulation.compile()

    def measure(self, reference: PathReference) -> RunErrors:
        """See MethodRun."""
        simulation = self._simulation
        simulation.restart(*self._start)
        try:
            return run_errors(simulation, reference, hamiltonian=self._hamiltonian)
        except StepFailure as failure:
            raise RunFailure(failure.reason, failure.t, simulation.gradients) from failure

    @property
    def note(self) -> str:
        """Return a note with the number of rescued steps."""
        rescued = self._simulation.rescued
        return f' ({rescued} steps in parts)' if rescued else ''

    def prepare(self, horizon: float) -> Callable[[], object]:
        """See MethodRun."""
        self._simulation.restart(*self._start)
        steps = whole_steps(horizon, self.step_size)
        return lambda: self._simulation.advance(steps)


class Peer(NamedTuple):
    """A peer's method: its name, whether it chooses its own steps, and how it is called."""

    name: str
    adaptive: bool
    solve: Solve


class PeerRun(MethodRun):
    """
    A peer at one tolerance or step size.

    Its path error is that at the horizon, of the very run that is timed. Its energy band is that
    of another run as well, which stops at each of the instants: between its own steps a peer
    would show the error of its interpolation.

    Parameters
    ----------
    peer : Peer
        The peer to run.
    setting : float
        Its tolerance [1] or step size [s].
    hamiltonian : Hamiltonian
        By which energies are judged.
    z0 : np.ndarray, shape (2 d,)
        Initial (q, p); of rotations 2 d less one for each.

    """

    def __init__(self, peer: Peer, setting: float, hamiltonian: Hamiltonian, z0: np.ndarray):
        self.label = f'{peer.name} tolerance={setting:g}' if peer.adaptive else peer.name
        self.step_size = math.nan if peer.adaptive else setting
        self._peer, self._setting, self._hamiltonian = peer, setting, hamiltonian
        self._z0 = z0

    def measure(self, reference: PathReference) -> RunErrors:
        """See MethodRun."""
        states, spent, horizon = [self._z0], 0, reference.horizon
        for part in range(_LOOKS):
            z, gradients = self._solve(
                states[-1], horizon / _LOOKS, part * horizon / _LOOKS, spent)
            states.append(z)
            spent += gradients
        end, spent = self._solve(self._z0, horizon, 0.0, 0)
        # A rotation has one column less in p than in q.
        energies = self._hamiltonian.energy(
            *np.split(np.array([*states, end]), [self._hamiltonian.dimension], axis=1))
        error = float(np.abs(end - reference.states[-1]).max()) if reference.verified else math.nan
        return RunErrors(error, float(np.abs(energies - energies[0]).max()), spent)

    def prepare(self, horizon: float) -> Callable[[], object]:
        """See MethodRun."""
        return lambda: self._peer.solve(self._z0, horizon, self._setting)

    def _solve(self, z: np.ndarray, duration: float, t: float, spent: int
               ) -> tuple[np.ndarray, int]:
        try:
            end, gradients = self._peer.solve(z, duration, self._setting)
        except (ArithmeticError, AssertionError, RuntimeError) as problem:
            # The first words: the rest is advice on options.
            reason = ' '.join(str(problem).split())[:60] or type(problem).__name__
            raise RunFailure(reason, t, spent) from problem
        if not np.isfinite(end).all():
            raise RunFailure('not finite', t, spent)
        return end, gradients


def whole_steps(horizon: float, step_size: float) -> int | None:
    """Return the number of steps of a horizon; None if it is not a whole number."""
    steps = round(horizon / step_size)
    return steps if steps > 0 and abs(steps * step_size - horizon) <= 1e-9 * horizon else None


def measure_row(run: MethodRun, reference: PathReference, runs: int) -> StudyRow:
    """
    Run once to measure errors, and so often as asked to measure time.

    Parameters
    ----------
    run : MethodRun
        The method to run.
    reference : PathReference
        To the horizon.
    runs : int
        Timed runs, at least 1; the one that measures errors comes before them and warms up.

    """
    horizon, start = reference.horizon, time.perf_counter()
    try:
        with np.errstate(over='ignore', invalid='ignore'):
            errors = run.measure(reference)
        if not math.isfinite(errors.energy) or math.isinf(errors.path):
            raise RunFailure('not finite', horizon, errors.gradients)
    except RunFailure as failure:
        seconds, t = time.perf_counter() - start, failure.t
        rates = (seconds / t, failure.gradients / t) if t > 0.0 else (math.nan, math.nan)
        return StudyRow(run.label, run.step_size, horizon, math.nan, math.nan, rates[0], math.nan,
                        rates[1], f'{failure.reason} at t = {t:.6g} s')
    status = (OK if reference.verified else ENERGY_ONLY) + run.note
    times = _times(run, horizon, runs) / horizon
    return StudyRow(run.label, run.step_size, horizon,
                    np.maximum(errors.path, reference.accuracy), errors.energy,
                    float(np.median(times)), float(np.quantile(times, 0.95)),
                    errors.gradients / horizon, status)


def _times(run: MethodRun, horizon: float, runs: int) -> np.ndarray:
    """Return the wall time of each of some runs [s]."""
    times = np.empty(runs)
    gc.collect()
    gc.disable()
    try:
        for i in range(runs):
            timed = run.prepare(horizon)
            start = time.perf_counter()
            timed()
            times[i] = time.perf_counter() - start
    finally:
        gc.enable()
    return times
