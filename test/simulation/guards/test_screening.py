# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Of many trajectories the guards look at those in which they can find something."""

import warnings

from helpers import long
from hnn_vi_ros import load_scene, simulate_many
from hnn_vi_ros.errors import AlarmWarning
from hnn_vi_ros.simulation import build, RunFacts, Watch
from hnn_vi_ros.simulation.guards.watch import energies_of, suspects
import numpy as np
import pytest


def shown(name: str, integrator: str, step_size: float, steps: int, every: int
          ) -> tuple[np.ndarray, np.ndarray]:
    """Return which of 60 trajectories are suspect, and which raise alarms if all are shown."""
    scene = load_scene(name).with_overrides(step_size=step_size, integrator=integrator)
    simulation = build(scene)
    d = simulation.hamiltonian.dimension
    rng = np.random.default_rng(4)
    q, p = np.empty((2, steps // every + 1, 60, d))
    # Beyond 0.3 some of Hénon and Heiles' trajectories escape.
    largest = 0.3 if name == 'henon_heiles' else 1.5
    for k, size in enumerate(np.geomspace(0.01, largest, 60)):
        start = size * rng.uniform(-1.0, 1.0, (2, d))
        simulation.restart(*start)
        q[0, k], p[0, k] = start
        q[1:, k], p[1:, k] = simulation.record(steps // every, every)
    times = np.arange(len(q)) * every
    energy, modified = energies_of(simulation, q, p, 0.0)
    alarmed = []
    for k in range(60):
        watch = Watch(RunFacts(simulation))
        watch.show(times, (q[:, k], p[:, k]), (energy[:, k], modified[:, k]))
        alarmed.append(bool(watch.alarms))
    outside, others = suspects(simulation, times, q, p, energy, modified)
    return outside | others, np.array(alarmed)


@pytest.mark.parametrize('integrator, step_size', [
    ('variational_euler', 0.01), ('variational_euler', 0.3), ('rk4', 0.3), ('rk4', 0.6),
    ('explicit_euler', 0.01)])
@pytest.mark.parametrize('name', [long('pendulum'), 'exact_pendulum', long('henon_heiles')])
@pytest.mark.parametrize('steps, every', [(100, 100), (60, 1), long(2000, 1)])
def test_who_is_not_suspect_raises_no_alarm(name, integrator, step_size, steps, every):
    suspect, alarmed = shown(name, integrator, step_size, steps, every)
    assert not (alarmed & ~suspect).any()


def test_most_trajectories_of_a_resolved_run_are_not_looked_at():
    suspect, alarmed = shown('pendulum', 'variational_euler', 0.01, 100, 10)
    # The wide ones leave the training box.
    assert not suspect[:50].any() and suspect.sum() <= 10 and alarmed.sum() <= suspect.sum()


def test_energies_that_overflow_are_suspect_without_a_warning():
    simulation = build(load_scene('harmonic_oscillator'))
    q = np.array([[[0.5], [0.5]], [[0.5], [1e200]]])
    energy = np.array([[0.125, 0.125], [0.125, np.inf]])
    with warnings.catch_warnings(), np.errstate(over='raise', invalid='raise'):
        warnings.simplefilter('error')
        _, found = suspects(simulation, np.array([0, 1]), q, 0.0 * q, energy, energy)
    assert found[1]


def test_who_raises_an_alarm_is_suspect_among_others_who_do_not():
    suspect, alarmed = shown('henon_heiles', 'variational_euler', 0.5, 100, 1)
    assert 0 < alarmed.sum() < 60 and (suspect | ~alarmed).all()


def test_trajectory_that_only_leaves_the_training_box_raises_no_other_alarm():
    scene = load_scene('pendulum')
    with pytest.warns(AlarmWarning, match='out of the training box in 1 of 2'):
        simulate_many(scene, [[0.1], [3.0]], [[0.0], [2.5]], 1.0)
