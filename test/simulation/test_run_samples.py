# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a run are the same whoever observes it, and in whatever way they are taken."""

import warnings

from hnn_vi_ros import load_scene
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import (
    build, judge, make_guards, record, resolve, RunFacts, Schedule, simulate, simulate_many,
    watched)
from hnn_vi_ros.simulation.guards.watch import Watch
from messages import assert_message
import numpy as np
import pytest

H = 0.05
PUSHED = Scene.build(
    hamiltonian='pendulum', integrator='gauss4', step_size=H, initial_state=([0.5], [0.0]),
    effects=[{'kind': 'external_force', 'coordinates': ['angle'], 'timeout': 1.0}],
    events=[{'when': 'angle = 0'}])


def samples_of(scene: Scene, schedule: Schedule, commands=None) -> tuple[np.ndarray, ...]:
    return record(watched(build(scene), scene), schedule, commands)[:3]


def test_four_steps_are_those_of_simulate():
    parts = resolve(load_scene('damped_driven_pendulum'))
    simulation = build(parts)
    watch = Watch(RunFacts(simulation))
    found = record(simulation, Schedule.until(1.0, 2, simulation), observe=watch.observe)
    energy, alarms = judge(found, watch)
    run = simulate(parts, 1.0, every=2)
    for mine, other in ((found.t, run.t), (found.q, run.q), (found.p, run.p), (energy, run.energy),
                        (found.work, run.work)):
        np.testing.assert_array_equal(mine, other)
    assert tuple(alarms) == run.alarms


def test_observed_run_has_the_samples_of_one_without_guards():
    """Its guards repeat steps with half of the step size, and restore the state."""
    scene, schedule = load_scene('damped_driven_pendulum'), Schedule(300, 1, np.empty(0))
    simulation = build(scene)
    watch, plain = Watch(RunFacts(simulation)), build(scene)
    found, other = record(simulation, schedule, observe=watch.observe), record(plain, schedule)
    for mine, its in zip(found, other, strict=True):
        np.testing.assert_array_equal(mine, its)
    assert simulation.row.tobytes() == plain.row.tobytes()


@pytest.mark.parametrize('as_rows', [True, False])
def test_commands_are_held_from_sample_to_sample_or_asked_before_each_step(as_rows):
    """The last sample is in a step, and an event is found on the way."""
    rows = np.linspace(-1.0, 1.0, 7)[:, None]
    commands = rows if as_rows else lambda t: rows[int((t + 1e-9) / (3 * H))]
    simulation = build(PUSHED)
    states = [np.append(simulation.q, simulation.p)]
    for k in range(20):
        simulation.set_command(rows[k // 3])
        simulation.advance(1)
        if k % 3 == 2:
            states.append(np.append(simulation.q, simulation.p))
    simulation.set_command(rows[6])
    states.append(np.concatenate(simulation.dense_step().state(0.5)))
    schedule = Schedule(6, 3, np.array([20.5 * H]))
    t, q, p = samples_of(PUSHED, schedule, commands)
    np.testing.assert_array_equal(np.hstack([q, p]), states)
    np.testing.assert_array_equal(t, schedule.times(H))


def test_samples_at_given_times_need_not_begin_with_the_initial_state():
    t, q, _ = samples_of(PUSHED, Schedule.at([2.5 * H, 4.0 * H], 10 * H))
    _, whole, _ = samples_of(PUSHED, Schedule(4, 1, np.empty(0)))
    np.testing.assert_array_equal(t, [2.5 * H, 4.0 * H])
    np.testing.assert_array_equal(q[1], whole[4])


def test_work_is_known_at_whole_steps_only():
    scene = load_scene('damped_driven_pendulum')
    simulation, h = build(scene), scene.step_size
    found = record(simulation, Schedule.at([0.5 * h, h, 2.5 * h], 3 * h))
    assert np.isnan(found.work[[0, 2]]).all()
    whole = build(scene)
    whole.advance(1)
    assert found.work[1] == whole.work != 0.0
    assert record(build(load_scene('exact_pendulum')), Schedule(2, 1, np.empty(0))).work is None


def test_guards_of_the_given_classes_are_made_and_no_others():
    facts = RunFacts(build(load_scene('exact_pendulum')))
    every = [*make_guards(facts)]
    for kind in {type(guard) for guard in every}:
        assert [type(guard) for guard in make_guards(facts, (kind,))] == [kind]


def told_of(function, many: bool) -> list[str]:
    """Return the warnings about commands for a function of time in 200 steps, with their file."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        if many:
            simulate_many(PUSHED.changed({'events': []}), [[0.5], [0.6]], [[0.0], [0.0]],
                          200 * H, samples=20, commands=function)
        else:
            simulate(PUSHED, 200 * H, commands=function)
    found = [one for one in caught if str(one.message).startswith('commands change')]
    assert all(one.filename == __file__ for one in found)
    return [str(one.message) for one in found]


@pytest.mark.parametrize('many', [False, True], ids=['one', 'many'])
def test_smooth_function_that_its_held_values_do_not_follow_is_told(many):
    # Held values lag by a share w h / 2 of a radian: 12 % of the amplitude.
    told, = told_of(lambda t: [0.2 * np.cos(0.25 / H * t)], many)
    assert_message(told)
    rng = np.random.default_rng(0)
    # Slow, random, and stepwise commands, and a few steps of one that ends.
    for function in (lambda t: [0.2 * np.cos(0.05 / H * t)], lambda t: [0.1 * rng.normal()],
                     lambda t: [0.1 * (-1.0) ** int(t)], lambda t: [min(t, 5.0 * H)]):
        assert not told_of(function, many)
