# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The guards of a run outside of ROS: its energy scale, a screening, and what they find."""

import math
import warnings

from hnn_vi_ros.errors import AlarmWarning
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.models import domain_of
from hnn_vi_ros.simulation.accuracy.diagnostics import (
    EnergyScale, follow, RECORD, rounding_walk, scales_along)
from hnn_vi_ros.simulation.guards.bands import EnergyGuard, InvariantGuard, plain_share
from hnn_vi_ros.simulation.guards.base import (
    Alarm, Block, BlockGuard, Guard, judge, Look, StateGuard, Waiting)
from hnn_vi_ros.simulation.guards.bounds import BoxGuard
from hnn_vi_ros.simulation.guards.selection import BAND_LIMIT, CHANGE_LIMIT, make_guards
from hnn_vi_ros.simulation.guards.steps import CostGuard, RescueGuard, SolutionGuard
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# An error of energy must be this many times larger, over the scale, to differ from rounding: a
# share of a fiftieth is the smallest that can be watched.
_FLOOR = 50.0 * rounding_walk(1.0, 1.0)
# From rest, energies grow as the square of the time, and an error of the first order in h by the
# share 1 / (2 n) of them in n steps: less than a fortieth beyond this many.
_EARLY = 20.0


@kept(error_model='numpy')
def _follow_samples(record: np.ndarray, own: np.ndarray, step: np.ndarray, potential: np.ndarray,
                    virial: np.ndarray, accounted: np.ndarray, work: np.ndarray,
                    rounding: float) -> np.ndarray:
    """Return the scales of the next samples; own are first and newest step, and largest size."""
    scales = np.empty(len(step))
    for i in range(len(step)):
        if math.isnan(own[0]):
            own[0] = own[1] = step[i]
        scale, turned = follow(record, potential[i], virial[i], max(step[i] - own[1], 1.0))
        own[1] = step[i]
        size = abs(accounted[i]) + abs(work[i]) + rounding
        if own[2] < size < math.inf:
            own[2] = size
        steps = step[i] - own[0] + 1.0
        scales[i] = max(_FLOOR * own[2] * math.sqrt(steps),
                        scale if turned else scale * (1.0 + _EARLY / steps))
    return scales


class SampledScale:
    """
    Energy scale by which the guards of a run measure: one for all of them.

    It is the EnergyScale of the samples so far, but no less than what rounding makes of H, as
    for a system at rest. As long as energy has not been turned over, the first n steps may have
    seen too little of it, as from a start at rest where the potential is zero: they count
    1 + 20 / n times.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of the run.

    Attributes
    ----------
    value : float
        The scale as of the last sample [J].

    """

    def __init__(self, hamiltonian: Hamiltonian):
        self.value = math.nan
        self._scale, self._rounding = EnergyScale(hamiltonian), hamiltonian.kernel.energy_scale
        self._record, self._own = np.zeros(RECORD), np.array([math.nan, math.nan, 0.0])
        # The block that it was last asked for, and its scales; those of samples of the next one.
        self._block: Block | None = None
        self._values = np.zeros(0)
        self._ahead: list[float] = []

    def __call__(self, block: Block) -> np.ndarray:
        """Return the scale at each sample of the next block [J], or of that before it again."""
        if block is not self._block:
            ahead, self._ahead, self._block = self._ahead, [], block
            later = self._take(Block(*(part[len(ahead):] for part in block)) if ahead else block)
            self._values = np.array([*ahead, *later]) if ahead else later
        return self._values

    def ahead(self, waiting: Waiting) -> float:
        """Return the scale [J] at the last of the samples so far of what will be a block."""
        if (new := waiting.block(len(self._ahead))) is not None:
            self._ahead.extend(self._take(new))
        return self.value

    def _take(self, block: Block) -> np.ndarray:
        potential, virial = self._scale.virials(block.q, block.p, block.dH_dq, block.dH_dp)
        if potential.ndim > 1:
            # The energies of trajectories that step together add up.
            potential, virial = potential.sum(axis=1), virial.sum(axis=1)
        scales = _follow_samples(self._record, self._own, block.step, potential, virial,
                                 block.accounted, block.work, self._rounding)
        if scales.size:
            self.value = float(scales[-1])
        return scales


def suspects(simulation: Simulation, steps: np.ndarray, q: np.ndarray, p: np.ndarray,
             energy: np.ndarray, modified: np.ndarray) -> np.ndarray:
    """
    Return which trajectories may raise an alarm.

    The bounds match the guards', with the whole band of a trajectory against the least energy
    scale along it: a trajectory within them raises no alarm at any sample.

    Parameters
    ----------
    simulation : Simulation
        Of any of them.
    steps : np.ndarray, shape (n,)
        Steps since the start.
    q, p : np.ndarray, shape (n, m, d)
        The trajectories.
    energy, modified : np.ndarray, shape (n, m)
        H and H~ there; see ``energies_of``.

    Returns
    -------
    np.ndarray, shape (m,)
        True where the guards must look.

    """
    hamiltonian, m = simulation.hamiltonian, q.shape[1]
    if not hamiltonian.canonical or hamiltonian.invariants or len(steps) < 2:
        return np.ones(m, bool)
    found = np.zeros(m, bool)
    domain = domain_of(hamiltonian)
    if domain is not None:
        velocities = hamiltonian.gradient(q, p)[1]
        for k in range(m):
            found[k] = domain.excess(q[:, k], velocities[:, k]).any()
    elif hamiltonian.box is not None:
        found |= hamiltonian.outside(q, p).any(axis=0)
    if not simulation.conservative:
        return found
    known = modified if simulation.modification is not None else energy
    weights = np.maximum(np.diff(np.round(steps), prepend=steps[0]), 1.0)
    # Written so that what is not finite is suspect. A change for good is less than the band.
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
    return found | ~good


# Most samples of a path that the guards see, besides its extremes. They need half as many to
# recognise a lasting change; see EnergyGuard.
SHOWN = 10_000
# Coordinates of the looks that wait until guards look at them together.
_WAITING = 4096
# Trajectories that are screened at a time, which takes several times the memory of their states.
_SCREENED = 1024


class Watch:
    """
    The guards of one run, and the first alarm of each kind.

    Parameters
    ----------
    simulation : Simulation
        The simulation to watch, from any initial state.
    barrier : tuple of (str, float) or None
        Name and energy [J] of a barrier; see ``Hamiltonian.barrier``.
    band_limit, change_limit : float, optional
        See ResolutionGuard and EnergyGuard.
    kinds : tuple of type, optional
        The guards that are wanted; all that apply by default.

    Attributes
    ----------
    works : dict of int to float
        The work done [J] after each number of steps at which it was looked at.

    """

    def __init__(self, simulation: Simulation, barrier: tuple[str, float] | None,
                 band_limit: float = BAND_LIMIT, change_limit: float = CHANGE_LIMIT,
                 kinds: tuple[type[Guard], ...] = (Guard,)):
        self.works: dict[int, float] = {}
        guards = [guard for guard in make_guards(
            simulation, SampledScale(simulation.hamiltonian), band_limit, change_limit, barrier)
            if isinstance(guard, kinds)]
        self._of_blocks = [guard for guard in guards if isinstance(guard, BlockGuard)]
        self._of_states = [guard for guard in guards if isinstance(guard, StateGuard)]
        self._kinds = [guard.kind for guard in guards]
        # What was found in which step, by kind.
        self._found: dict[str, tuple[int, Alarm]] = {}
        self._waiting = Waiting(_WAITING)

    @property
    def alarms(self) -> list[Alarm]:
        """Return the first alarm of each kind by its step, in the order of the guards."""
        waiting, self._waiting = self._waiting, Waiting(_WAITING)
        for alarm in judge(self._of_blocks, waiting.block()):
            self._found.setdefault(alarm.kind, (alarm.step, alarm))
        return [alarm for _, alarm in sorted(
            self._found.values(), key=lambda one: (one[0], self._kinds.index(one[1].kind)))]

    def update(self, look: Look) -> None:
        """Show the next state to all guards."""
        self.works[look.step] = look.work
        for guard in self._of_states:
            if (alarm := guard.update(look)) is not None:
                self._found.setdefault(alarm.kind, (look.step, alarm))
        if self._of_blocks:
            self._waiting.add(look)
            if self._waiting.full:
                _ = self.alarms

    def show(self, simulation: Simulation, steps: np.ndarray, states: tuple[np.ndarray, ...],
             energies: tuple[np.ndarray, np.ndarray], most: int = SHOWN) -> None:
        """
        Show a path: states at equal distances, the extremes of energy, the first outside a box.

        Parameters
        ----------
        simulation : Simulation
            That took it, with no work done.
        steps : np.ndarray, shape (n,)
            Steps since the start, and shares of steps.
        states : tuple of np.ndarray, shape (n, d)
            q and p there.
        energies : tuple of np.ndarray, shape (n,)
            H and H~ there; see ``energies_of``.
        most : int, optional
            States to show at equal distances.

        """
        (q, p), (energy, modified), hamiltonian = states, energies, simulation.hamiltonian
        chosen = set(range(0, len(steps), max(1, len(steps) // most)))
        for values in (energy, modified):
            if np.isfinite(values).all():
                chosen |= {int(values.argmin()), int(values.argmax())}
        if hamiltonian.box is not None:
            chosen.add(int(hamiltonian.outside(q, p).argmax()))
        shown = np.array(sorted(chosen))
        slopes = hamiltonian.gradient(q[shown], p[shown])
        for i, H_q, H_p in zip(shown, *slopes, strict=True):
            self.update(Look(round(steps[i]), q[i], p[i], H_q, H_p, float(energy[i]),
                             float(modified[i])))


def energies_of(simulation: Simulation, q: np.ndarray, p: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray]:
    """Return H and H~, shape (...), of states of shape (..., d); H~ is NaN where none is."""
    hamiltonian = simulation.hamiltonian
    energy = hamiltonian.energy(q, p)
    modified = None if simulation.modification is None else \
        simulation.integrator.modified_energy(
            hamiltonian, simulation.step_size, q, p, energy, *hamiltonian.gradient(q, p))
    return energy, np.full(energy.shape, math.nan) if modified is None else modified


def look(simulation: Simulation) -> Look:
    """Return the present state as guards look at it; of m trajectories, in shape (m, d)."""
    energy, modified = simulation.energies
    return Look(simulation.steps, simulation.q.copy(), simulation.p.copy(),
                simulation.dH_dq.copy(), simulation.dH_dp.copy(), energy,
                math.nan if modified is None else modified, simulation.work)


def look_at_block(simulation: Simulation) -> Look:
    """Return what the guards of ``watch_of_block`` look at: energies only where work is done."""
    if not simulation.conservative:
        return look(simulation)
    return Look(simulation.steps, simulation.q, simulation.p, simulation.dH_dq, simulation.dH_dp,
                math.nan, math.nan)


def look_at_rows(simulation: Simulation, rows: np.ndarray, q: np.ndarray, p: np.ndarray) -> Look:
    """Return what ``watch_of_block`` looks at, of rows whose states are q and p, (m, d)."""
    energy, modified = energies_of(simulation, q, p)
    return Look(int(rows[0, 1]), q, p, *simulation.hamiltonian.gradient(q, p),
                float(energy.sum()), float(modified.sum()), simulation.work_in(rows))


def show_many(simulation: Simulation, steps: np.ndarray, q: np.ndarray, p: np.ndarray,
              alarms: list[list[Alarm]]) -> np.ndarray:
    """
    Show each of m trajectories to guards of its own; return H, shape (n, m).

    Parameters
    ----------
    simulation : Simulation
        Of any of them.
    steps : np.ndarray, shape (n,)
        Steps since the start.
    q, p : np.ndarray, shape (n, m, d)
        The trajectories.
    alarms : list of list of Alarm
        One list for each trajectory, to which what is found is added.

    """
    energy, modified = energies_of(simulation, q, p)
    # Where work is done it is known of a block only, which was watched while it stepped.
    kinds = (Guard,) if simulation.conservative else (BoxGuard, InvariantGuard)
    hamiltonian = simulation.hamiltonian
    if simulation.conservative or hamiltonian.box is not None or hamiltonian.invariants:
        found = np.ones(len(alarms), bool)
        # Guards see only a part of longer paths, which the screening does not know.
        if len(steps) < 2 * SHOWN:
            for first in range(0, len(found), _SCREENED):
                block = np.s_[:, first:first + _SCREENED]
                found[block[1]] = suspects(simulation, steps, q[block], p[block], energy[block],
                                           modified[block])
        for k in np.flatnonzero(found):
            watch = Watch(simulation, hamiltonian.barrier, kinds=kinds)
            watch.show(simulation, steps, (q[:, k], p[:, k]), (energy[:, k], modified[:, k]))
            alarms[k] += watch.alarms
    return energy


def tell(alarms: list[Alarm], step_size: float) -> None:
    """Warn the caller of the caller of alarms."""
    for alarm in alarms:
        # Its kind is the name under which the page on troubleshooting has its remedy.
        warnings.warn(f'{alarm.kind}: t = {alarm.step * step_size:.9g} s: {alarm.message}',
                      AlarmWarning, stacklevel=3)


def tell_many(alarms: list[list[Alarm]], step_size: float) -> None:
    """Warn the caller of the caller of the alarms of many trajectories, once of each kind."""
    for kind in dict.fromkeys(alarm.kind for own in alarms for alarm in own):
        found = {k: alarm for k, own in enumerate(alarms) for alarm in own if alarm.kind == kind}
        first, alarm = next(iter(found.items()))
        warnings.warn(
            f'{kind} in {len(found)} of {len(alarms)} trajectories; in number {first}, '
            f't = {alarm.step * step_size:.9g} s: {alarm.message}', AlarmWarning, stacklevel=3)


def watch_of_block(simulation: Simulation) -> Watch:
    """Return the guards whose alarms concern all trajectories of a block; see show_many."""
    return Watch(simulation, None, kinds=(
        CostGuard, RescueGuard, SolutionGuard, *[EnergyGuard] * (not simulation.conservative)))
