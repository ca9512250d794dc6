# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hard cases with effects, checks of repeatability, and counts of events."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
import io
import math

from hnn_vi_ros.effects import Damping, LoopManifold
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.integrators import Gauss, INTEGRATORS
from hnn_vi_ros.simulation import Alarm, look, PathError, PathReport, Simulation, Watch
from hnn_vi_ros.simulation.accuracy.diagnostics import energy_band, rounding_walk
from hnn_vi_ros.simulation.guards.watch import energies_of
import numpy as np
from studies.coarse_steps import counts, reference
from studies.hard_cases_gates import Measured
from studies.hard_cases_plan import Job
from studies.hard_cases_run import (
    blocks, FIRST, run_motion, scale_of, summarise, watch_of, WATCHED)
from studies.structure import BLOCKS

# Limits: the rise of a damped system's energy from block to block, and the errors of a rod.
RISE, LENGTH, RATE = 1e-9, 1e-10, 1e-9
# Torques of a motor [N m], and steps of each. Limits of what no cause explains, as a share of the
# largest energy of a cause, and of the fall of a heat [J].
_TORQUES, _HELD, SHARE = (8.0, -8.0, 0.0, 4.0, -4.0), 1000, 1e-3
# Its energy is the exact one to round-off at the steps of case 12: halving them changes nothing.
_EXACT = 'gauss16'
# Steps of the reference of a driven run, for one of its own.
_FINER = 16
# Likewise of the reference of a path, of order 16. A path error that is wrong [1]; the largest
# factor between an estimate below one half and the true error.
_FINER_PATH, _WRONG, _KNOWN, _FACTOR = 4, 0.3, 0.5, 2.5
# Times of a picture, each as many times the one before.
_TIMES = 100
_EPS = float(np.finfo(np.float64).eps)
# Steps compared with those without damping, and the change that rounding of the stages allows.
_COMPARED = 2000
_CHANGE = 8.0 * _EPS * _COMPARED


def run_job(job: Job) -> Measured:
    """Run a job by the check of its case."""
    return _CHECKS[job.case.check](job)


def run_dissipation(job: Job) -> Measured:
    """
    Run a damped set-up: the largest H of a block is not above that of the block before.

    Within a block, which holds many swings, H oscillates as the method's band does. With a rate
    of zero, the run is bit-identical to the scene without the effect; that of a Gauss method on a
    formula of constant mass differs by rounding, because without forces another iteration solves
    its stages.
    """
    simulation, measured = _start(job)
    start, peaks, energies = simulation.energy, [], []
    watch, balance = watch_of(job, simulation), 0.0
    watch.update(look(simulation))
    try:
        for q, p in blocks(job, simulation):
            energy = simulation.hamiltonian.energy(q, p)
            energies.append(energy)
            peaks.append(float(energy.max()))
            balance = max(balance, abs(simulation.energy_balance))
            _note(measured, simulation, q, p)
            watch.update(look(simulation))
    except StepFailure as failure:
        measured.failure = failure
        return measured
    finally:
        measured.alarms = watch.alarms
    rises = np.array(peaks[1:]) / np.array(peaks[:-1]) - 1.0
    measured.band = balance
    measured.measures = {'rise': float(max(rises.max(), 0.0)), 'left': peaks[-1] / start}
    if measured.measures['rise'] > RISE:
        measured.broken.append('energy rises')
    hamiltonian, integrator, _ = job.parts()
    iterates_anew = isinstance(integrator, Gauss) and hamiltonian.kernel.quadratic
    if not _change_by_no_damping(job) <= (_CHANGE if iterates_anew else 0.0):
        measured.broken.append('another path with a rate of 0')
    path = np.concatenate(energies)
    measured.t, measured.error = _thinned(
        job, np.abs(path - _exact_energies(_SetUp(job), path.size)))
    return measured


class _SetUp:
    """Set-up of a job that determines the exact motion, the same for all methods."""

    def __init__(self, job: Job):
        self.job, self.key = job, (repr(job.set_up), job.steps)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SetUp) and self.key == other.key


@lru_cache(maxsize=2)
def _exact_energies(set_up: _SetUp, samples: int) -> np.ndarray:
    """Return H of the exact motion at the instants of a run, shape (samples,) [J]."""
    job = set_up.job
    hamiltonian, _, effects = job.parts()
    simulation = Simulation(hamiltonian, INTEGRATORS[_EXACT](), job.set_up.step_size,
                            job.set_up.q, job.set_up.p, effects)
    return hamiltonian.energy(*simulation.record(samples, job.steps // samples))


def _times(job: Job, steps: int) -> np.ndarray:
    """Return the times after each of the first steps [s]."""
    return job.set_up.step_size * np.arange(1, steps + 1)


def _thinned(job: Job, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times that grow geometrically [s], and the largest error since the one before."""
    ends = np.unique(np.geomspace(1, len(errors), _TIMES).round().astype(int))
    every = job.set_up.step_size * job.steps / len(errors)
    return every * ends, np.maximum.reduceat(errors, np.concatenate([[0], ends[:-1]]))


def _change_by_no_damping(job: Job) -> float:
    """Return the largest change of q and p by damping of rate zero."""
    hamiltonian, integrator, _ = job.parts()
    paths = []
    for effects in ([], [Damping(0.0)]):
        simulation = Simulation(hamiltonian, integrator, job.set_up.step_size, job.set_up.q,
                                job.set_up.p, effects)
        paths.append(np.hstack(simulation.record(_COMPARED, 1)))
    return float(np.abs(np.subtract(*paths)).max())


def run_constraint(job: Job) -> Measured:
    """Run a rod or loops: their lengths and the rates of these are looked at in every step."""
    simulation, measured = _start(job)
    start, errors, broken = simulation.energy, [], []
    scale = scale_of(simulation)
    try:
        for q, p in blocks(job, simulation):
            broken.append(_broken(job, simulation, q, p))
            errors.append(simulation.hamiltonian.energy(q, p) - start)
            _note(measured, simulation, q, p)
    except StepFailure as failure:
        measured.failure = failure
        return measured
    measured.rounding = rounding_walk(scale, simulation.steps)
    summarise(np.concatenate(errors), measured)
    lengths, rates = np.hstack(broken)
    worst = lengths.max(), rates.max()
    measured.measures = {'length': float(worst[0]), 'rate': float(worst[1])}
    measured.broken += [f'{name} > {limit:g}' for name, value, limit in zip(
        ('length', 'rate'), worst, (LENGTH, RATE), strict=True) if value > limit]
    measured.t, measured.error = _thinned(job, np.maximum.accumulate(lengths))
    measured.other = _thinned(job, np.maximum.accumulate(rates))[1]
    return measured


def _broken(job: Job, simulation: Simulation, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the errors of the length of a rod or of loops and of their rates, shape (2, n)."""
    _, velocity = simulation.hamiltonian.gradient(q, p)
    loops = simulation.system.constraints
    if isinstance(loops, LoopManifold):
        return np.array([[np.abs(loops.errors(one)).max() for one in q], np.abs(np.einsum(
            'nki,ni->nk', loops.gradients(q), velocity)).max(axis=1)])
    rod = next(effect for effect in job.set_up.effects
               if effect['kind'] == 'holonomic_constraint')
    rods = q - np.array(rod['anchor'])
    r = np.linalg.norm(rods, axis=1)
    return np.abs([r - rod['length'], np.sum(rods * velocity, axis=1) / r])


def run_repeatability(job: Job) -> Measured:
    """
    Run twice, and once with a snapshot on disk midway that another simulation resumes.

    Guards see the energy of a conservative run: bits that repeat do not make it stable.
    """
    simulation, measured = _start(job)
    watch = watch_of(job, simulation)
    watch.update(look(simulation))
    start, half = simulation.energy, max(FIRST, job.steps // 2)
    first, rest = simulation.record(half, 1), simulation.record(half, 1)
    once = np.hstack([np.vstack(parts) for parts in zip(first, rest, strict=True)])
    _note(measured, simulation, *rest)
    again = np.hstack(job.simulation().record(2 * half, 1))
    resumed = np.hstack(_resumed(job, half))
    if not np.array_equal(once, again):
        measured.broken.append('other bits when repeated')
    if not np.array_equal(once[half:], resumed):
        measured.broken.append('other bits when resumed')
    d = simulation.hamiltonian.dimension
    if simulation.conservative:
        path = once[:, :d], once[:, d:]
        energies = energies_of(simulation, *path, _times(job, 2 * half))
        measured.band = energy_band(energies[0] - start)
        for part in np.array_split(np.arange(2 * half), BLOCKS):
            watch.show(part + 1, tuple(z[part] for z in path),
                       tuple(energy[part] for energy in energies), WATCHED)
        measured.alarms = watch.alarms
    apart = np.abs(again - once).max(axis=1)
    apart[half:] = np.maximum(apart[half:], np.abs(resumed - once[half:]).max(axis=1))
    measured.t, measured.error = _thinned(job, apart)
    measured.other = _thinned(
        job, np.abs(_neighbour(job, 2 * half) - once).max(axis=1))[1]
    return measured


def _neighbour(job: Job, steps: int) -> np.ndarray:
    """Return the states of a run whose first coordinate starts one rounding error off."""
    simulation = job.simulation()
    q = np.array(job.set_up.q, dtype=float)
    q[0] = np.nextafter(q[0], math.inf)
    simulation.restart(q, job.set_up.p)
    return np.hstack(simulation.record(steps, 1))


def _resumed(job: Job, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the second half of a run that is saved midway and resumed by another simulation."""
    before, after, file = job.simulation(), job.simulation(), io.BytesIO()
    before.record(half, 1)
    np.savez(file, **before.snapshot())
    file.seek(0)
    with np.load(file) as snapshot:
        after.restore(dict(snapshot))
    return after.record(half, 1)


def run_counts(job: Job) -> Measured:
    """Run a set-up with guards at every step; compare the counts of events with DOP853."""
    simulation, measured = _start(job)
    if not simulation.conservative:
        return _run_driven(job, simulation, measured)
    watch, start = watch_of(job, simulation), simulation.energy
    z = np.concatenate([simulation.q, simulation.p])
    watch.update(look(simulation))
    report = _report(job, simulation)
    with np.errstate(over='ignore', invalid='ignore'):
        try:
            q, p = simulation.record(job.steps, 1)
        except StepFailure as failure:
            measured.failure = failure
            measured.alarms = _alarms(watch, report)
            taken = simulation.steps
            simulation.follow_by(None)
            simulation.restart(*np.split(z, 2))
            if taken:
                energies, _ = energies_of(simulation, *simulation.record(taken, 1),
                                          _times(job, taken))
                _draw_energies(job, energies - start, measured)
            return measured
        energies = energies_of(simulation, q, p, _times(job, job.steps))
        watch.show(np.arange(1, job.steps + 1), (q, p), energies, job.steps)
    _note(measured, simulation, q, p)
    summarise(energies[0] - start, measured)
    measured.alarms = _alarms(watch, report)
    _compare(job, simulation, np.vstack([z, np.hstack([q, p])]),
             reference(simulation.hamiltonian, z, simulation.time)[0], measured)
    _draw_energies(job, energies[0] - start, measured)
    return measured


def _run_driven(job: Job, simulation: Simulation, measured: Measured) -> Measured:
    """Run a set-up with work, with guards at every step; compare with much smaller steps."""
    watch, looks = watch_of(job, simulation), [look(simulation)]
    watch.update(looks[0])
    report = _report(job, simulation)
    try:
        for _ in range(job.steps):
            simulation.advance(1)
            looks.append(look(simulation))
            watch.update(looks[-1])
    except StepFailure as failure:
        measured.failure = failure
    measured.alarms = _alarms(watch, report)
    q, p = np.array([one.q for one in looks]), np.array([one.p for one in looks])
    errors = np.array([one.energy - one.work for one in looks[1:]]) - looks[0].energy
    _note(measured, simulation, q, p)
    summarise(errors, measured)
    _draw_energies(job, errors, measured)
    if measured.failure is None:
        finer = replace(job, method='implicit_midpoint', set_up=job.set_up.model_copy(
            update={'step_size': job.set_up.step_size / _FINER})).simulation()
        path = np.hstack(finer.record(job.steps * _FINER, 1))
        _compare(job, simulation, np.hstack([q, p]), path, measured)
    return measured


def _report(job: Job, simulation: Simulation) -> PathReport:
    """Have a run take its steps a second time; return the report of its path error."""
    report = PathReport()
    report.follow(simulation, job.steps, period=None)
    return report


def _alarms(watch: Watch, report: PathReport) -> list[Alarm]:
    """Return the alarms of the guards and of the path error, in order of time."""
    found = [*watch.alarms, *(alarm for _, alarm in report.finish())]
    return sorted(found, key=lambda alarm: alarm.step)


def run_paths(job: Job) -> Measured:
    """
    Compare the path error that a run tells with the true one.

    Both are the largest so far, over the amplitude of the coordinate. The true path has a quarter
    of the step size and order 16. A run that is more than 30 % off must raise the alarm; an
    estimate below one half is right within a factor of 2.5, and a bound holds.
    """
    simulation, measured = _start(job)
    watch, report = watch_of(job, simulation), _report(job, simulation)
    start = simulation.q[None].copy()
    watch.update(look(simulation))
    q, p = simulation.record(job.steps, 1)
    watch.update(look(simulation))
    measured.alarms = _alarms(watch, report)
    _note(measured, simulation, q, p)
    finer = replace(job, method=_EXACT, set_up=job.set_up.model_copy(
        update={'step_size': job.set_up.step_size / _FINER_PATH})).simulation()
    path, _ = finer.record(job.steps, _FINER_PATH)
    amplitude = 0.5 * np.ptp(np.concatenate([start, path]), axis=0)
    true = np.maximum.accumulate((np.abs(q - path) / amplitude).max(axis=1))
    told, t = report.errors()[0], _times(job, job.steps)
    measured.t, measured.error = _thinned(job, true)
    measured.other = np.interp(measured.t, told.t, told.value, right=math.nan)
    _judge_path(true[np.searchsorted(t, told.t[-1], side='right') - 1], true[-1], told, measured)
    return measured


def _judge_path(error: float, last: float, told: PathError, measured: Measured) -> None:
    """Judge what a run tells of its path, given its true error there and at its end."""
    measured.measures = {'path error': float(last), 'told': told.largest}
    if last > _WRONG and not measured.alarms:
        measured.broken.append('no alarm')
    ratio = told.largest / error
    if told.estimated and told.largest < _KNOWN and not 1.0 / _FACTOR < ratio < _FACTOR:
        measured.broken.append('estimate')
    if not told.estimated and told.largest < error:
        measured.broken.append('bound')


def run_books(job: Job) -> Measured:
    """
    Run a set-up with motors, whose energies by cause are looked at after each command.

    The share is the largest abs(H - H0 - W) of the largest work or heat of a cause; the fall is
    the largest one of a heat between two commands.
    """
    hamiltonian, integrator, effects = job.parts()
    simulation = Simulation(hamiltonian, integrator, job.set_up.step_size, job.set_up.q,
                            job.set_up.p, effects, energy_by_cause=True)
    measured, (ledger, before) = _start(job)[1], (simulation.ledger, simulation.causes)
    watch, errors, sizes = watch_of(job, simulation), list[float](), list[float]()
    heats = [k for k, name in enumerate(ledger.names) if name.startswith('heat/')]
    fall = 0.0
    watch.update(look(simulation))
    try:
        for k in range(job.steps // _HELD):
            simulation.set_command([_TORQUES[k % len(_TORQUES)]] * simulation.command_size)
            simulation.advance(_HELD)
            watch.update(look(simulation))
            found = simulation.causes
            errors.append(found[-1])
            fall = max(fall, float((before - found)[heats].max()))
            sizes.append(float(np.abs(found[:-1]).max()))
            before = found
            _note(measured, simulation, simulation.q, simulation.p)
    except StepFailure as failure:
        measured.failure = failure
    measured.alarms, measured.band = watch.alarms, float(np.abs(errors).max(initial=0.0))
    measured.measures = {'share': measured.band / max(sizes), 'fall': fall}
    measured.broken += [f'{name} > {SHARE:g}' for name, value in measured.measures.items()
                        if value > SHARE]
    t, measured.error = _thinned(job, np.maximum.accumulate(np.abs(errors))
                                 / np.maximum.accumulate(sizes))
    measured.t = t * (len(errors) * _HELD / job.steps)
    return measured


def _compare(job: Job, simulation: Simulation, found: np.ndarray, path: np.ndarray,
             measured: Measured) -> None:
    """Compare the counts of events on a path from the start, (n, 2 d), with those on another."""
    own, expected = (counts(simulation.hamiltonian, job.set_up.events, np.vstack(
        [found[:1], states])) for states in (found, path))
    measured.broken += [f'{text} {times} times, not {right}' for text, times, right in zip(
        job.set_up.events, own, expected, strict=True) if times != right]


def _draw_energies(job: Job, errors: np.ndarray, measured: Measured) -> None:
    """Fill in the curve of the largest error so far, of a run that may have stopped early."""
    t, measured.error = _thinned(job, np.maximum.accumulate(np.abs(errors)))
    measured.t = t * (len(errors) / job.steps)


def _start(job: Job) -> tuple[Simulation, Measured]:
    simulation = job.simulation()
    unknowns = simulation.integrator.unknowns(simulation.hamiltonian.dimension)
    return simulation, Measured(
        residual_limit=max(8, *unknowns) * _EPS if unknowns else math.nan)


def _note(measured: Measured, simulation: Simulation, q: np.ndarray, p: np.ndarray) -> None:
    measured.largest = max(measured.largest, float(np.abs([q, p]).max()))
    measured.residual = max(measured.residual, simulation.residual)


_CHECKS: dict[str, Callable[[Job], Measured]] = {
    'motion': run_motion, 'dissipation': run_dissipation, 'constraint': run_constraint,
    'repeatability': run_repeatability, 'counts': run_counts, 'books': run_books,
    'paths': run_paths}
