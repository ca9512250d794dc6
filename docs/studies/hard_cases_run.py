# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run one row of the hard cases: step, run the guards, and measure the values of the gates."""

from collections.abc import Iterator
import math

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation import (
    BoxGuard, EnergyGuard, look, PoleGuard, RunFacts, secular_change, Simulation, Watch)
from hnn_vi_ros.simulation.accuracy.diagnostics import energy_band, rounding_walk
from hnn_vi_ros.simulation.guards.bands import BarrierGuard, ResolutionGuard
from hnn_vi_ros.simulation.guards.steps import RescueGuard, StiffnessGuard
from hnn_vi_ros.simulation.guards.watch import energies_of
import numpy as np
from studies.hard_cases_gates import Measured
from studies.hard_cases_plan import Job
from studies.structure import (
    block_maxima, BLOCKS, reversal_defect, rounding_scale, stationary_energy, symplectic_defect)

# Steps at the start that are taken, and looked at, one by one.
FIRST = 1000
# States of a run that are recorded at most, and states of a block that the guards see.
_STATES, WATCHED = 1_000_000, 50
# States at which single steps are judged; each costs a hundred uncompiled steps.
_JUDGED = 2
# Guards of the motion; a slow step says nothing about it.
_GUARDS = (BarrierGuard, BoxGuard, EnergyGuard, RescueGuard, ResolutionGuard, StiffnessGuard)
# Guards of the path count only if events are counted: accuracy is not judged otherwise.
_OF_PATHS = (PoleGuard,)
_EPS = float(np.finfo(np.float64).eps)
_TRIANGLE = np.array([[0.0, -2.0], [math.sqrt(3.0), 1.0], [-math.sqrt(3.0), 1.0]])


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
    if within is not None and simulation.integrator.requirements.symplectic \
            and within < measured.first_word < math.inf:
        measured.broken.append(f'said only at step {measured.first_word:.0f}')
    return measured


def _run_first(job: Job, simulation: Simulation, measured: Measured) -> None:
    """Take the first steps one by one, under the eyes of the guards."""
    watch, start = watch_of(job, simulation), simulation.energy
    watch.update(look(simulation))
    errors = [0.0]
    try:
        for _ in range(min(FIRST, job.steps)):
            simulation.advance(1)
            sample = look(simulation)
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
    watch = watch_of(job, simulation)
    start, modified_start = simulation.energy, simulation.modified_energy
    scale = scale_of(simulation)
    energies, modified, seen = [], [], []
    try:
        for q, p in blocks(job, simulation):
            steps = simulation.steps - stride(job) * np.arange(len(q) - 1, -1, -1)
            energy, others = energies_of(simulation, q, p, simulation.step_size * steps)
            energies.append(energy - start)
            modified.append(others)
            watch.show(steps, (q, p), (energy, others), WATCHED)
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


def blocks(job: Job, simulation: Simulation) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Step block by block; yield the q and p of many states of each, shape (n, d)."""
    samples = max(1, job.steps // (BLOCKS * stride(job)))
    for _ in range(BLOCKS):
        yield simulation.record(samples, stride(job))


def stride(job: Job) -> int:
    """Return the steps from one recorded state to the next."""
    return max(1, job.steps // _STATES)


def scale_of(simulation: Simulation) -> float:
    """Return the rounding error of the energy of the present state [J]."""
    return rounding_scale(simulation.energy, simulation.q, simulation.p, simulation.dH_dq,
                          simulation.dH_dp)


def watch_of(job: Job, simulation: Simulation) -> Watch:
    """Return the guards of one run, with the limits of the job."""
    kinds = _GUARDS + (_OF_PATHS if job.set_up.events else ())
    simulation.hamiltonian.barrier = _barrier(job, simulation)
    return Watch(RunFacts(simulation, job.guards.under_resolved, job.guards.drift), kinds)


def _barrier(job: Job, simulation: Simulation) -> tuple[str, float] | None:
    """Return name and energy of the barrier that the case is about: that of the lowest saddle."""
    if not job.set_up.saddles:
        return None
    hamiltonian = simulation.hamiltonian
    d = hamiltonian.dimension
    return job.case.barrier, min(
        stationary_energy(hamiltonian, z[:d], z[d:]) for z in job.set_up.saddles)


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
    """Measure the values of the case in every block."""
    if job.case.measure == 'angular momentum':
        momenta = q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]
        (x, y), (p_x, p_y) = job.set_up.q, job.set_up.p
        change = float(np.abs(momenta - (x * p_y - y * p_x)).max())
        name = job.case.measure
        measured.measures[name] = max(measured.measures.get(name, 0.0), change)


def _finish(job: Job, simulation: Simulation, measured: Measured, judged: list[np.ndarray]
            ) -> None:
    """Measure the final values of the case, of H~ or H per block if needed."""
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
        measured.measures[RescueGuard.kind] = simulation.rescued
    most = job.case.at_most
    if most is not None and measured.measures.get(name, 0.0) > most:
        measured.broken.append(f'{name} > {most:g}')


def lyapunov_time(job: Job, every: int = 20) -> float:
    """
    Return the time in which neighbours separate by a factor e [s], with Benettin's method.

    A second trajectory is brought back to 1e-8 of the first after each interval. Together they
    take at most two fifths of the steps of the run.
    """
    intervals = min(job.steps // (5 * every), 10_000)
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
            if 'G4' in job.case.gates and method.requirements.symmetric:
                measured.reversal = _worse(measured.reversal, reversal_defect(*arguments))
            if 'G5' in job.case.gates and method.requirements.symplectic:
                measured.symplectic = _worse(measured.symplectic, symplectic_defect(*arguments))
        except StepFailure:
            # Beyond the method's limit single steps may fail where the run found a way.
            measured.broken.append('a single step fails')
            return


def _worse(old: float, new: float) -> float:
    return new if math.isnan(old) else max(old, new)
