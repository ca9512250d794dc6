# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The hard cases with effects: dissipation, a constraint, and the same bits twice."""

from collections.abc import Callable
import io
import math

from hnn_vi_ros.accuracy.diagnostics import energy_band, rounding_walk
from hnn_vi_ros.effects.damping import Damping
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.studies.hard_cases_gates import Measured
from hnn_vi_ros.studies.hard_cases_plan import Job
from hnn_vi_ros.studies.hard_cases_run import blocks, FIRST, run_motion, scale_of, summarise
import numpy as np

# What the energy of a damped system may rise by from block to block, and a rod be off by.
RISE, LENGTH, RATE = 1e-9, 1e-10, 1e-9
_EPS = float(np.finfo(np.float64).eps)


def run_job(job: Job) -> Measured:
    """Run a job by the check of its case."""
    return _CHECKS[job.case.check](job)


def run_dissipation(job: Job) -> Measured:
    """
    Run a damped set-up: the largest H of a block is not above that of the block before.

    Within a block, which holds many swings, H oscillates as the method's band does. With a rate
    of zero, the bits are those of the scene without the effect.
    """
    simulation, measured = _start(job)
    start, peaks = simulation.energy, []
    balance = 0.0
    try:
        for q, p in blocks(job, simulation):
            energy = simulation.hamiltonian.energy(q, p)
            peaks.append(float(energy.max()))
            balance = max(balance, abs(simulation.energy_balance))
            _note(measured, simulation, q, p)
    except StepFailure as failure:
        measured.failure = failure
        return measured
    rises = np.array(peaks[1:]) / np.array(peaks[:-1]) - 1.0
    measured.band = balance
    measured.measures = {'rise': float(max(rises.max(), 0.0)), 'left': peaks[-1] / start}
    if measured.measures['rise'] > RISE:
        measured.broken.append('energy rises')
    if not _is_identical_without(job):
        measured.broken.append('other bits with a rate of 0')
    measured.t = job.set_up.step_size * job.steps / len(peaks) * np.arange(1, len(peaks) + 1)
    measured.error = np.array(peaks)
    return measured


def _is_identical_without(job: Job, steps: int = 2000) -> bool:
    """Return whether damping of rate zero leaves every bit as it is without the effect."""
    hamiltonian, integrator, _ = job.parts()
    paths = []
    for effects in ([], [Damping(0.0)]):
        simulation = Simulation(hamiltonian, integrator, job.set_up.step_size, job.set_up.q,
                                job.set_up.p, effects)
        paths.append(np.hstack(simulation.record(steps, 1)))
    return np.array_equal(*paths)


def run_constraint(job: Job) -> Measured:
    """Run a rod: its length and the rate of its length are looked at in every step."""
    simulation, measured = _start(job)
    rod = next(effect for effect in job.set_up.effects
               if effect['kind'] == 'holonomic_constraint')
    anchor, length = np.array(rod['anchor']), rod['length']
    start, errors, worst = simulation.energy, [], np.zeros(2)
    scale = scale_of(simulation)
    try:
        for q, p in blocks(job, simulation):
            _, velocity = simulation.hamiltonian.gradient(q, p)
            rods = q - anchor
            r = np.linalg.norm(rods, axis=1)
            rates = np.sum(rods * velocity, axis=1) / r
            worst = np.maximum(worst, [np.abs(r - length).max(), np.abs(rates).max()])
            errors.append(simulation.hamiltonian.energy(q, p) - start)
            _note(measured, simulation, q, p)
    except StepFailure as failure:
        measured.failure = failure
        return measured
    measured.rounding = rounding_walk(scale, simulation.steps)
    summarise(np.concatenate(errors), measured)
    measured.measures = {'length': float(worst[0]), 'rate': float(worst[1])}
    measured.broken += [f'{name} > {limit:g}' for name, value, limit in zip(
        ('length', 'rate'), worst, (LENGTH, RATE), strict=True) if value > limit]
    measured.t = job.set_up.step_size * job.steps / len(errors) * np.arange(1, len(errors) + 1)
    measured.error = np.array([energy_band(block) for block in errors])
    return measured


def run_repeatability(job: Job) -> Measured:
    """Run twice, and once with a snapshot on disk midway that another simulation resumes."""
    simulation, measured = _start(job)
    start, half = simulation.energy, max(FIRST, job.steps // 2)
    first, rest = simulation.record(half, 1), simulation.record(half, 1)
    once = np.hstack([np.vstack(parts) for parts in zip(first, rest, strict=True)])
    _note(measured, simulation, *rest)
    again = job.simulation()
    if not np.array_equal(once, np.hstack(again.record(2 * half, 1))):
        measured.broken.append('other bits when repeated')
    if not np.array_equal(np.hstack(rest), np.hstack(_resumed(job, half))):
        measured.broken.append('other bits when resumed')
    d = simulation.hamiltonian.dimension
    errors = simulation.hamiltonian.energy(once[:, :d], once[:, d:]) - start
    if simulation.conservative:
        measured.band = energy_band(errors)
    picked = slice(len(errors) // 100 - 1, None, len(errors) // 100)
    measured.t = (job.set_up.step_size * np.arange(1, len(errors) + 1))[picked]
    measured.error = np.abs(errors[picked])
    return measured


def _resumed(job: Job, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the second half of a run that is saved midway and resumed by another simulation."""
    before, after, file = job.simulation(), job.simulation(), io.BytesIO()
    before.record(half, 1)
    np.savez(file, **before.snapshot())
    file.seek(0)
    with np.load(file) as snapshot:
        after.restore(dict(snapshot))
    return after.record(half, 1)


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
    'repeatability': run_repeatability}
