# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of a run outside ROS: judgement of its samples, screening of many, and warnings."""

from collections.abc import Iterator
import math
import warnings

from hnn_vi_ros.errors import AlarmWarning
from hnn_vi_ros.models import domain_of
from hnn_vi_ros.phase_space import energy_unit
from hnn_vi_ros.simulation.accuracy.diagnostics import scales_along
from hnn_vi_ros.simulation.guards.bands import (
    BarrierGuard, EnergyGuard, InvariantGuard, plain_share, ResolutionGuard)
from hnn_vi_ros.simulation.guards.base import Alarm, BlockGuard, Guard, judge_block, StateGuard
from hnn_vi_ros.simulation.guards.bounds import BoxGuard
from hnn_vi_ros.simulation.guards.facts import BAND_LIMIT, CHANGE_LIMIT, RunFacts
from hnn_vi_ros.simulation.guards.loops import ClosureGuard, SingularGuard
from hnn_vi_ros.simulation.guards.poles import PoleGuard
from hnn_vi_ros.simulation.guards.samples import GuardState, SampleBuffer
from hnn_vi_ros.simulation.guards.steps import (
    CostGuard, DriveGuard, RescueGuard, SolutionGuard, StabilityGuard, StiffnessGuard, TimeGuard)
from hnn_vi_ros.simulation.run_samples import MAX_OBSERVED, RunSamples
from hnn_vi_ros.simulation.second_run import PathGuard
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np
from numpy.typing import ArrayLike

# Alarms of the same step are reported in this order.
GUARDS: tuple[type[Guard], ...] = (
    BoxGuard, ResolutionGuard, EnergyGuard, CostGuard, StiffnessGuard, StabilityGuard, DriveGuard,
    TimeGuard, InvariantGuard, BarrierGuard, PathGuard, PoleGuard, ClosureGuard, SingularGuard,
    SolutionGuard, RescueGuard)


def make_guards(run: RunFacts, kinds: tuple[type[Guard], ...] = (Guard,)) -> Iterator[Guard]:
    """
    Yield the guards that apply to a run, in a study and in the node alike.

    Parameters
    ----------
    run : RunFacts
        Facts of the run.
    kinds : tuple of type, optional
        Classes of the guards to make; by default all that apply.

    """
    for kind in GUARDS:
        if issubclass(kind, kinds):
            for guard in kind.of_run(run):
                guard.energy_unit = energy_unit(run.hamiltonian.coordinates)
                if run.simulation.integrator.tolerances:
                    guard.smaller = 'smaller tolerances'
                yield guard


def suspects(simulation: Simulation, steps: np.ndarray, q: np.ndarray, p: np.ndarray,
             energy: np.ndarray, modified: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return masks of the trajectories that leave the training box, and that may raise other alarms.

    The guards' limits are applied to the whole band of a trajectory and the smallest energy scale
    along it: a trajectory within them raises no alarm at any sample.

    Parameters
    ----------
    simulation : Simulation
        Simulation of any of the trajectories.
    steps : np.ndarray, shape (n,)
        Steps since the start.
    q, p : np.ndarray, shape (n, m, d)
        The trajectories.
    energy, modified : np.ndarray, shape (n, m)
        H and H~ along them; see ``energies_of``.

    Returns
    -------
    outside, others : np.ndarray, shape (m,)
        True for trajectories that the guard of the box, or all guards, must check.

    """
    hamiltonian, m = simulation.hamiltonian, q.shape[1]
    if not hamiltonian.canonical or hamiltonian.invariants or len(steps) < 2:
        return np.ones(m, bool), np.ones(m, bool)
    found, times = np.zeros(m, bool), steps * simulation.step_size
    domain = domain_of(hamiltonian)
    if domain is not None:
        velocities = hamiltonian.gradient(q, p, times[:, None])[1]
        for k in range(m):
            found[k] = domain.excess(q[:, k], velocities[:, k]).any()
    elif hamiltonian.box is not None:
        found |= hamiltonian.outside(q, p).any(axis=0)
    if not simulation.conservative:
        return found, np.zeros(m, bool)
    known = modified if simulation.modification is not None else energy
    weights = np.maximum(np.diff(np.round(steps), prepend=steps[0]), 1.0)
    # Non-finite values compare false, so are suspect. The band bounds every lasting change.
    with np.errstate(invalid='ignore', over='ignore'):
        scale = scales_along(hamiltonian, q, p, weights)[1:].min(axis=0)
        good = np.ptp(known, axis=0) <= min(BAND_LIMIT, CHANGE_LIMIT) * scale
        good &= np.ptp(energy, axis=0) <= plain_share(simulation) * BAND_LIMIT * scale
        if hamiltonian.barrier is not None:
            _, height = hamiltonian.barrier
            kept = energy if simulation.integrator.order > 1 else known
            gap = np.where((height - energy[0]) * (height - kept[0]) > 0.0,
                           np.abs(height - kept[0]), 0.0)
            good &= np.ptp(kept, axis=0) <= gap
    return found, ~good


# Capacity of the buffer of samples, in coordinates.
_BUFFER_NUMBERS = 4096
# Number of trajectories screened at a time; screening takes several times their memory.
_SCREENED_TRAJECTORIES = 1024


class Watch:
    """
    Guards of one run, and the first alarm of each kind.

    Parameters
    ----------
    run : RunFacts
        Facts of the run.
    kinds : tuple of type, optional
        Classes of the guards to use; by default all that apply.

    Attributes
    ----------
    simulation : Simulation
        The simulation that is watched.

    """

    def __init__(self, run: RunFacts, kinds: tuple[type[Guard], ...] = (Guard,)):
        self.simulation = run.simulation
        guards = list(make_guards(run, kinds))
        self._of_blocks = [guard for guard in guards if isinstance(guard, BlockGuard)]
        self._of_states = [guard for guard in guards if isinstance(guard, StateGuard)]
        self._kinds = [guard.kind for guard in guards]
        # Step and first alarm by kind.
        self._found: dict[str, tuple[int, Alarm]] = {}
        self._waiting = SampleBuffer(_BUFFER_NUMBERS)

    @property
    def alarms(self) -> list[Alarm]:
        """Return the first alarm of each kind by its step, in the order of the guards."""
        waiting, self._waiting = self._waiting, SampleBuffer(_BUFFER_NUMBERS)
        for alarm in judge_block(self._of_blocks, waiting.block()):
            self._found.setdefault(alarm.kind, (alarm.step, alarm))
        return [alarm for _, alarm in sorted(
            self._found.values(), key=lambda one: (one[0], self._kinds.index(one[1].kind)))]

    def update(self, look: GuardState) -> None:
        """Check the next state with all guards."""
        for guard in self._of_states:
            if (alarm := guard.update(look)) is not None:
                self._found.setdefault(alarm.kind, (look.step, alarm))
        if self._of_blocks:
            self._waiting.add(look)
            if self._waiting.full:
                _ = self.alarms

    def observe(self) -> None:
        """Check the current state of the simulation; see ``record``."""
        self.update(look(self.simulation))

    def show(self, steps: np.ndarray, states: tuple[np.ndarray, ...],
             energies: tuple[np.ndarray, np.ndarray], most: int = MAX_OBSERVED) -> None:
        """
        Check a path at equidistant states, at its energy extremes, and at its first exit of a box.

        No effect may do work along it.

        Parameters
        ----------
        steps : np.ndarray, shape (n,)
            Steps since the start, possibly fractional.
        states : tuple of np.ndarray, shape (n, d)
            q and p along the path.
        energies : tuple of np.ndarray, shape (n,)
            H and H~ along the path; see ``energies_of``.
        most : int, optional
            Approximate maximum number of equidistant states.

        """
        (q, p), (energy, modified) = states, energies
        hamiltonian = self.simulation.hamiltonian
        chosen = set(range(0, len(steps), max(1, len(steps) // most)))
        for values in (energy, modified):
            if np.isfinite(values).all():
                chosen |= {int(values.argmin()), int(values.argmax())}
        if hamiltonian.box is not None:
            chosen.add(int(hamiltonian.outside(q, p).argmax()))
        shown = np.array(sorted(chosen))
        times = steps[shown] * self.simulation.step_size
        slopes = hamiltonian.gradient(q[shown], p[shown], times)
        for i, H_q, H_p in zip(shown, *slopes, strict=True):
            self.update(GuardState(round(steps[i]), q[i], p[i], H_q, H_p, float(energy[i]),
                                   float(modified[i])))


def energies_of(simulation: Simulation, q: np.ndarray, p: np.ndarray, t: ArrayLike
                ) -> tuple[np.ndarray, np.ndarray]:
    """Return H and H~, shape (...), at states (..., d) at times (...); H~ is NaN if unknown."""
    hamiltonian = simulation.hamiltonian
    energy = hamiltonian.energy(q, p, t)
    modified = None if simulation.modification is None else \
        simulation.integrator.modified_energy(
            hamiltonian, simulation.step_size, q, p, energy, *hamiltonian.gradient(q, p, t))
    return energy, np.full(energy.shape, math.nan) if modified is None else modified


def look(simulation: Simulation) -> GuardState:
    """Return the current state for guards; for m trajectories, with shape (m, d)."""
    energy, modified = simulation.energies
    return GuardState(simulation.steps, simulation.q.copy(), simulation.p.copy(),
                      simulation.dH_dq.copy(), simulation.dH_dp.copy(), energy,
                      math.nan if modified is None else modified, simulation.work)


def look_at_block(simulation: Simulation) -> GuardState:
    """Return the state for the guards of ``watch_of_block``; energies only if work is done."""
    if not simulation.conservative:
        return look(simulation)
    return GuardState(simulation.steps, simulation.q, simulation.p, simulation.dH_dq,
                      simulation.dH_dp, math.nan, math.nan)


def look_at_rows(simulation: Simulation, rows: np.ndarray, q: np.ndarray, p: np.ndarray
                 ) -> GuardState:
    """Return the state for ``watch_of_block`` of rows with states q and p, (m, d)."""
    t = rows[0, 1] * simulation.step_size
    energy, modified = energies_of(simulation, q, p, t)
    return GuardState(int(rows[0, 1]), q, p, *simulation.hamiltonian.gradient(q, p, t),
                      float(energy.sum()), float(modified.sum()), simulation.work_in(rows))


def judge(found: RunSamples, watch: Watch) -> tuple[np.ndarray, list[Alarm]]:
    """Return H at the samples of a run [J], shape (n,), and the alarms of its guards."""
    simulation = watch.simulation
    energies = energies_of(simulation, found.q, found.p, found.t)
    if simulation.conservative:
        watch.show(found.t / simulation.step_size, (found.q, found.p), energies)
    # Otherwise the guards have observed the run, because its samples do not show work.
    return energies[0], watch.alarms


def judge_many(simulation: Simulation, t: np.ndarray, q: np.ndarray, p: np.ndarray,
               alarms: list[list[Alarm]]) -> np.ndarray:
    """
    Check each of m trajectories with its own guards; return H, shape (n, m).

    Parameters
    ----------
    simulation : Simulation
        Simulation of any of the trajectories.
    t : np.ndarray, shape (n,)
        Times of the samples [s].
    q, p : np.ndarray, shape (n, m, d)
        The trajectories.
    alarms : list of list of Alarm
        One list for each trajectory, to which its alarms are appended.

    """
    energy, modified = energies_of(simulation, q, p, t[:, None])
    steps = t / simulation.step_size
    # Work is known only for whole blocks, whose energy was checked while they were stepped.
    kinds = (Guard,) if simulation.conservative else (BoxGuard, InvariantGuard)
    hamiltonian = simulation.hamiltonian
    if simulation.conservative or hamiltonian.box is not None or hamiltonian.invariants:
        outside, others = np.ones((2, len(alarms)), bool)
        # Guards check only a part of the samples of longer paths, unlike the screening.
        if len(steps) < 2 * MAX_OBSERVED:
            for first in range(0, len(others), _SCREENED_TRAJECTORIES):
                block = np.s_[:, first:first + _SCREENED_TRAJECTORIES]
                outside[block[1]], others[block[1]] = suspects(
                    simulation, steps, q[block], p[block], energy[block], modified[block])
        for k in np.flatnonzero(outside | others):
            watch = Watch(RunFacts(simulation), kinds if others[k] else (BoxGuard,))
            watch.show(steps, (q[:, k], p[:, k]), (energy[:, k], modified[:, k]))
            alarms[k] += watch.alarms
    return energy


def tell(alarms: list[Alarm], step_size: float) -> None:
    """Emit a warning for each alarm, attributed to the caller's caller."""
    for alarm in alarms:
        # The page on troubleshooting lists remedies by `kind`.
        warnings.warn(f'{alarm.kind}: t = {alarm.step * step_size:.9g} s: {alarm.message}',
                      AlarmWarning, stacklevel=3)


def tell_many(alarms: list[list[Alarm]], step_size: float) -> None:
    """Emit one warning per kind of alarm, for many trajectories, to the caller's caller."""
    for kind in dict.fromkeys(alarm.kind for own in alarms for alarm in own):
        found = {k: alarm for k, own in enumerate(alarms) for alarm in own if alarm.kind == kind}
        first, alarm = next(iter(found.items()))
        warnings.warn(
            f'{kind} in {len(found)} of {len(alarms)} trajectories; in trajectory {first}, '
            f't = {alarm.step * step_size:.9g} s: {alarm.message}', AlarmWarning, stacklevel=3)


def watch_of_block(simulation: Simulation, in_rows: bool = False) -> Watch:
    """Return the guards that apply to a block of trajectories as a whole; see judge_many."""
    return Watch(RunFacts(simulation, in_rows=in_rows), (
        CostGuard, RescueGuard, SolutionGuard, TimeGuard,
        *[EnergyGuard] * (not simulation.conservative)))
