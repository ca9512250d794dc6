# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run one row of the hard cases: step, look, watch, and measure what the gates ask for."""

from collections.abc import Iterator
import math

from hnn_vi_ros.diagnostics import (
    block_maxima, energy_band, reversal_defect, rounding_walk, secular_change,
    stationary_energy, symplectic_defect)
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.guards import energies_in_play, make_guards
from hnn_vi_ros.guards.base import Alarm
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.sinks.sample import Sample
from hnn_vi_ros.studies.hard_cases_gates import Measured
from hnn_vi_ros.studies.hard_cases_plan import Job
import numpy as np

# Steps at the start that are taken, and looked at, one by one.
FIRST = 1000
BLOCKS = 100
# States of a run that are recorded at most, and states of a block that the guards see.
_STATES, _WATCHED = 1_000_000, 50
# States at which single steps are judged; each costs a hundred uncompiled steps.
_JUDGED = 2
_RESCUED = 'steps in parts'
_EPS = float(np.finfo(np.float64).eps)
_TRIANGLE = np.array([[0.0, -2.0], [math.sqrt(3.0), 1.0], [-math.sqrt(3.0), 1.0]])


class Watch:
    """
    The guards of one run, and the first alarm of each.

    Parameters
    ----------
    job : Job
        Whose limits they have.
    simulation : Simulation
        In its initial state.

    """

    def __init__(self, job: Job, simulation: Simulation):
        self.alarms = []
        self._guards = list(make_guards(
            simulation, job.guards.under_resolved, job.guards.drift, _barrier(job, simulation)))
        self._heard: set[str] = set()

    def update(self, sample: Sample) -> None:
        """Show a sample to all guards."""
        for guard in self._guards:
            alarm = guard.update(sample)
            if alarm is not None and alarm.kind not in self._heard:
                self._heard.add(alarm.kind)
                self.alarms.append(alarm)


def run_motion(job: Job) -> Measured:
    """Run a conservative set-up; see Measured."""
    simulation, measured = job.simulation(), Measured()
    unknowns = simulation.integrator.unknowns(simulation.hamiltonian.dimension)
    measured.residual_limit = max(8, *unknowns) * _EPS if unknowns else math.nan
    # Some states are on their way to infinity.
    with np.errstate(over='ignore', invalid='ignore'):
        _run_first(job, simulation, measured)
        if measured.failure is None:
            simulation.restart(job.set_up.q, job.set_up.p)
            _run_all(job, simulation, measured)
    within = job.set_up.within
    if within is not None and simulation.integrator.symplectic \
            and within < measured.first_word < math.inf:
        measured.broken.append(f'said only at step {measured.first_word:.0f}')
    return measured


def _run_first(job: Job, simulation: Simulation, measured: Measured) -> None:
    """Take the first steps one by one, under the eyes of the guards."""
    watch, start = Watch(job, simulation), simulation.energy
    watch.update(observe(simulation))
    errors = [0.0]
    try:
        for _ in range(min(FIRST, job.steps)):
            simulation.advance(1)
            sample = observe(simulation)
            watch.update(sample)
            errors.append(sample.energy - start)
            measured.residual = max(measured.residual, simulation.residual)
    except StepFailure as failure:
        measured.failure = failure
        errors = np.array(errors)
        measured.band = energy_band(errors)
        measured.t = simulation.step_size * np.arange(errors.size)
        measured.error = np.abs(errors)
    measured.largest = float(np.abs([*simulation.q, *simulation.p]).max())
    measured.alarms = watch.alarms


def _run_all(job: Job, simulation: Simulation, measured: Measured) -> None:
    """Take all steps in blocks, and measure energies over the whole run."""
    watch = Watch(job, simulation)
    start, modified_start = simulation.energy, simulation.modified_energy
    scale = scale_of(simulation)
    energies, modified, seen = [], [], []
    try:
        for q, p in blocks(job, simulation):
            _hear_of_rescue(simulation, measured)
            energy, others = _energies(simulation, q, p)
            energies.append(energy - start)
            modified.append(others)
            _show(watch, simulation, (q, p), stride(job), energy, others)
            measured.residual = max(measured.residual, simulation.residual)
            measured.largest = max(measured.largest, float(np.abs([q, p]).max()))
            _look(job, q, measured)
            seen.append((q[-1], p[-1]))
            _measure(job, simulation, q, p, measured)
            scale = max(scale, scale_of(simulation))
    except StepFailure as failure:
        measured.failure = failure
    heard = {alarm.kind for alarm in measured.alarms}
    measured.alarms += [alarm for alarm in watch.alarms if alarm.kind not in heard]
    measured.rounding = rounding_walk(scale, simulation.steps)
    if energies:
        summarise(np.concatenate(energies), measured)
        times = simulation.step_size * simulation.steps / len(energies)
        measured.t = times * np.arange(1, len(energies) + 1)
        measured.error = np.array([energy_band(block) for block in energies])
        if modified_start is not None:
            measured.modified_band = energy_band(np.concatenate(modified) - modified_start)
    _finish(job, simulation, measured, energies if modified_start is None else modified)
    _judge_steps(simulation, job, seen, measured)


def _hear_of_rescue(simulation: Simulation, measured: Measured) -> None:
    """Note the first steps that were taken otherwise than by the method, as the node tells it."""
    if simulation.rescued and all(alarm.kind != _RESCUED for alarm in measured.alarms):
        measured.alarms.append(Alarm(_RESCUED, simulation.steps, simulation.rescued, 0.0, ''))


def blocks(job: Job, simulation: Simulation) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Step block by block; yield the q and p of many states of each, shape (n, d)."""
    samples = max(1, job.steps // (BLOCKS * stride(job)))
    for _ in range(BLOCKS):
        yield simulation.record(samples, stride(job))


def stride(job: Job) -> int:
    """Return the steps from one recorded state to the next."""
    return max(1, job.steps // _STATES)


def observe(simulation: Simulation) -> Sample:
    """Return the present state as a sample."""
    energy, modified = simulation.energy, simulation.modified_energy
    return Sample(simulation.steps, 0, simulation.q, simulation.p, simulation.dH_dq,
                  simulation.dH_dp, energy, math.nan if modified is None else modified, 0.0,
                  simulation.work)


def scale_of(simulation: Simulation) -> float:
    """Return the size of the energies in play [J]; see guards."""
    return energies_in_play(simulation, simulation.q, simulation.p)


def _barrier(job: Job, simulation: Simulation) -> tuple[str, float] | None:
    """Return name and energy of the barrier that the case is about: that of the lowest saddle."""
    if not job.set_up.saddles:
        return None
    hamiltonian = simulation.hamiltonian
    d = hamiltonian.dimension
    return job.case.barrier, min(
        stationary_energy(hamiltonian, z[:d], z[d:]) for z in job.set_up.saddles)


def _energies(simulation: Simulation, q: np.ndarray, p: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return H and H~ of states; H~ is NaN where there is none."""
    hamiltonian = simulation.hamiltonian
    energy = hamiltonian.energy(q, p)
    if simulation.modified_energy is None:
        return energy, np.full(energy.shape, math.nan)
    return energy, simulation.integrator.modified_energy(
        simulation.step_size, energy, *hamiltonian.gradient(q, p))


def _show(watch: Watch, simulation: Simulation, states: tuple[np.ndarray, np.ndarray],
          every: int, energy: np.ndarray, modified: np.ndarray) -> None:
    """Show a block to the guards: states at equal distances, extremes, the first outside."""
    (q, p), n, box = states, energy.size, simulation.hamiltonian.box
    judged = energy if np.isnan(modified).any() else modified
    chosen = {*range(0, n, max(1, n // _WATCHED)), int(judged.argmin()), int(judged.argmax())}
    if box is not None:
        low, high = np.concatenate(box).T
        z = np.hstack([q, p])
        chosen.add(int(((z < low) | (z > high)).any(axis=1).argmax()))
    nothing = np.empty(0)
    for i in sorted(chosen):
        watch.update(Sample(simulation.steps - (n - 1 - i) * every, 0, q[i], p[i], nothing,
                            nothing, float(energy[i]), float(modified[i]), 0.0))


def _look(job: Job, q: np.ndarray, measured: Measured) -> None:
    """Note a coordinate that is where the case forbids it to be."""
    where = job.set_up.inside
    if where is None or measured.broken:
        return
    outside = {'swing': lambda: np.abs(q) >= math.pi,
               'triangle': lambda: q @ _TRIANGLE.T > 1.0}[where]()
    if outside.any():
        measured.broken.append(f'leaves the {where}')


def summarise(error: np.ndarray, measured: Measured) -> None:
    """Fill in band, slope and growth of an energy error at equal distances."""
    tenth = max(1, error.size // 10)
    measured.band = energy_band(error)
    if measured.band > 0.0:
        measured.slope = secular_change(block_maxima(error)) / measured.band
    first = float(np.ptp(error[:tenth]))
    measured.growth = float(np.ptp(error[-tenth:])) / first if first > 0.0 else math.nan


def _measure(job: Job, simulation: Simulation, q: np.ndarray, p: np.ndarray,
             measured: Measured) -> None:
    """Measure what the case asks for in every block."""
    if job.case.measure == 'angular momentum':
        momenta = q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]
        (x, y), (p_x, p_y) = job.set_up.q, job.set_up.p
        change = float(np.abs(momenta - (x * p_y - y * p_x)).max())
        name = job.case.measure
        measured.measures[name] = max(measured.measures.get(name, 0.0), change)


def _finish(job: Job, simulation: Simulation, measured: Measured, judged: list[np.ndarray]
            ) -> None:
    """Measure what the case asks for at the end, of H~ or H block by block where it is that."""
    name, method = job.case.measure, simulation.integrator
    equations = len(method.unknowns(simulation.hamiltonian.dimension))
    if name == 'gradients' and getattr(method, 'scalar', False):
        measured.measures[name] = simulation.gradients / (simulation.steps * equations)
    elif name == 'drift' and judged:
        means = np.array([block.mean() for block in judged])
        measured.measures[name] = abs(secular_change(means))
    elif name == 'Lyapunov time' and measured.failure is None:
        measured.measures[name] = lyapunov_time(job)
    if simulation.rescued:
        measured.measures[_RESCUED] = simulation.rescued
    most = job.case.at_most
    if most is not None and measured.measures.get(name, 0.0) > most:
        measured.broken.append(f'{name} > {most:g}')


def lyapunov_time(job: Job, every: int = 20) -> float:
    """
    Return how long it takes until neighbours are e times as far apart [s], by Benettin's method.

    A second trajectory is brought back to 1e-8 of the first after each interval.
    """
    intervals = min(job.steps // every, 10_000)
    first, second = job.simulation(), job.simulation()
    gap, total = 1e-8, 0.0
    d = first.hamiltonian.dimension
    offset = np.full(2 * d, gap / math.sqrt(2 * d))
    for _ in range(intervals):
        z = np.concatenate([first.q, first.p])
        second.restart(z[:d] + offset[:d], z[d:] + offset[d:])
        first.advance(every)
        second.advance(every)
        offset = np.concatenate([second.q - first.q, second.p - first.p])
        distance = float(np.linalg.norm(offset))
        total += math.log(distance / gap)
        offset *= gap / distance
    return intervals * every * first.step_size / total if total > 0.0 else math.inf


def _judge_steps(simulation: Simulation, job: Job, seen: list, measured: Measured) -> None:
    """Take single steps at states of the run, back and forth and with neighbours."""
    method, h = simulation.integrator, simulation.step_size
    for q, p in seen[::max(1, len(seen) // _JUDGED)][:_JUDGED]:
        arguments = simulation.hamiltonian, method, h, q, p
        try:
            if 'G4' in job.case.gates and method.symmetric:
                measured.reversal = _worse(measured.reversal, reversal_defect(*arguments))
            if 'G5' in job.case.gates and method.symplectic:
                measured.symplectic = _worse(measured.symplectic, symplectic_defect(*arguments))
        except StepFailure:
            # Beyond the method's limit single steps may fail where the run found a way.
            measured.broken.append('a single step fails')
            return


def _worse(old: float, new: float) -> float:
    return new if math.isnan(old) else max(old, new)
