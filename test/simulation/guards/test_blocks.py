# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards that look at many samples together find what they find in each, to the last bit."""

from dataclasses import replace

from hnn_vi_ros import load_scene
from hnn_vi_ros.run import Monitor, Sampler
from hnn_vi_ros.simulation import build, EnergyGuard, make_guards, RunFacts
import numpy as np
import pytest

# With a box, of several coordinates, with work, and with steps that are too large for the motion.
SCENES = {
    'learned': ('harmonic_oscillator', {}),
    'two coordinates': ('exact_double_pendulum', {}),
    'driven': ('damped_driven_pendulum', {}),
    'under-resolved': ('exact_harmonic_oscillator', {
        'integrator': {'kind': 'variational_euler'}, 'step_size': 0.9}),
    'drifting': ('exact_harmonic_oscillator', {'integrator': {'kind': 'rk4'}, 'step_size': 0.9}),
    'outside of the box': ('harmonic_oscillator', {'initial_state': {'q': [2.2], 'p': [0.0]}}),
}


def monitor_of(simulation) -> Monitor:
    facts = RunFacts(simulation)
    return Monitor(simulation, 1, simulation.step_size, None, pytest.fail, make_guards(facts),
                   facts.scale)


def state_of(monitor: Monitor) -> dict:
    """Return the numbers that guards and scale have by now, in all their bits."""
    scale = monitor._scale
    return {f'{type(thing).__name__}.{name}': value for thing in [*monitor.guards, scale]
            for name, value in vars(thing).items()
            if isinstance(value, float | int | bool | list | np.generic)
            } | {f'{type(guard).__name__}.{name}': value.ravel().tolist()
                 for guard in monitor.guards for name, value in vars(guard).items()
                 if isinstance(value, np.ndarray)
                 } | {'records': [*scale._record, *scale._own]}


@pytest.mark.parametrize('name, changes', SCENES.values(), ids=SCENES)
def test_samples_that_wait_for_each_other_are_judged_as_each_by_itself(name, changes):
    simulation = build(load_scene(name).changed(changes))
    sampler = Sampler(simulation, 1.0 / simulation.step_size)
    alone, together = monitor_of(simulation), monitor_of(simulation)
    found, waited = ([], []), 0
    for _ in range(4000):
        sample = sampler.sample()
        found[0].extend(alone.watch(sample))
        found[1].extend(together.watch(sample, at_once=False))
        waited = max(waited, len(together._waiting))
        simulation.advance(1)
    found[1].extend(together.look())
    assert state_of(together) == state_of(alone)
    order = [sorted(one, key=str) for one in found]
    assert order[0] == order[1]
    assert waited >= 60
    assert bool(found[0]) == (changes != {})


@pytest.mark.parametrize('energy', [1e9, np.inf, np.nan])
def test_energy_that_jumps_is_found_in_its_own_sample(energy):
    simulation = build(load_scene('exact_pendulum'))
    sampler, monitor = Sampler(simulation, 1000.0), monitor_of(simulation)
    for _ in range(500):
        assert monitor.watch(sampler.sample(), at_once=False) == []
        simulation.advance(1)
    jumped = replace(sampler.sample(), energy=energy, modified_energy=np.nan)
    alarms = monitor.watch(jumped, at_once=False)
    assert EnergyGuard.kind in {alarm.kind for alarm, step in alarms if step == jumped.step}


def test_scale_that_is_asked_for_takes_each_sample_once_and_in_order():
    simulation = build(load_scene('exact_pendulum'))
    sampler = Sampler(simulation, 1.0 / simulation.step_size)
    alone, together = monitor_of(simulation), monitor_of(simulation)
    for step in range(1500):
        sample = sampler.sample()
        for monitor in (alone, together):
            monitor.newest = sample
            monitor.watch(sample, at_once=monitor is alone)
        if step % 37 == 0:
            assert together.energy_scale == alone.energy_scale
        simulation.advance(1)
    together.look()
    assert state_of(together) == state_of(alone)


def test_scale_of_a_sample_that_is_published_first_is_its_own_and_counts_it_once():
    simulation = build(load_scene('exact_pendulum'))
    sampler = Sampler(simulation, 1.0 / simulation.step_size)
    alone, published = monitor_of(simulation), monitor_of(simulation)
    for _ in range(500):
        sample = sampler.sample()
        alone.watch(sample)
        # As in a message, which is out before the guards look.
        published.add(sample)
        scale = published.energy_scale
        published.watch(sample, at_once=False)
        assert scale == alone.energy_scale
        simulation.advance(1)
    published.look()
    assert state_of(published) == state_of(alone)
