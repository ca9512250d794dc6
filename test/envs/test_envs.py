# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gymnasium environments: by gymnasium's checker, and bit by bit those of simulations."""

from functools import partial
import re
import warnings

from hnn_vi_ros.errors import StateError
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build
from messages import refused
import numpy as np
import pytest
from scene_files import write_scene

gymnasium = pytest.importorskip('gymnasium', reason='gymnasium is not installed')

from gymnasium.utils.env_checker import check_env  # noqa: E402,I100
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv  # noqa: E402
from hnn_vi_ros.envs import SceneEnv, SceneVectorEnv  # noqa: E402

FORCE = [{'kind': 'external_force', 'coordinates': ['angle']}]
PENDULUM = 'pendulum, mass: 1.0, length: 1.0, gravity: 9.81'
PUSHED = '{kind: external_force, coordinates: [angle]}'


def reward(step):
    return -(step.q @ step.q) - 1e-3 * (step.action @ step.action)


def somewhere(rng):
    return rng.uniform(0.2, 1.0, 1), rng.uniform(-1.0, 1.0, 1)


@pytest.fixture
def events(tmp_path):
    """Return a scene whose runs end at an angle."""
    return write_scene(
        tmp_path / 'events.yaml', PENDULUM, PUSHED, 'variational_euler',
        more='events: [{when: angle = -0.5, then: stop}, {when: angle = 0}]\n')


@pytest.fixture
def noisy(tmp_path):
    """Return a scene with noise, whose failed steps are not taken otherwise."""
    bath = '{kind: thermostat, temperature: 0.1, rate: 0.5}'
    return write_scene(tmp_path / 'noisy.yaml', PENDULUM, f'{bath}, {PUSHED}', 'stormer_verlet',
                       more='on_failure: stop\n')


def test_environment_satisfies_the_checker_of_gymnasium():
    env = SceneEnv('exact_pendulum', reward, effects=FORCE, limits=2.0, initial_state=somewhere)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        check_env(env)
    # A phase space has no bounds, a force is in newtons, and who makes it registers no name.
    known = ('is -?infinity|symmetric and normalized space|not having a spec')
    assert [str(one.message) for one in caught if not re.search(known, str(one.message))] == []
    assert env.observation_space.dtype == env.action_space.dtype == np.float64
    assert env.action_space.high == [2.0] and env.action_space.low == [-2.0]


def test_steps_are_those_of_simulations_bit_by_bit():
    envs = SceneVectorEnv('exact_pendulum', 3, reward, effects=FORCE, every=3, threads=2,
                          initial_state=somewhere)
    observations, _ = envs.reset(seed=5)
    assert len({tuple(one) for one in observations}) == 3
    scene = load_scene('exact_pendulum').with_overrides(effects=FORCE)
    simulations = [build(scene) for _ in range(3)]
    for simulation, (q, p) in zip(simulations, observations, strict=True):
        simulation.restart([q], [p])
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.normal(size=(3, 1))
        observations, rewards, terminations, truncations, _ = envs.step(actions)
        for k, simulation in enumerate(simulations):
            simulation.set_command(actions[k])
            simulation.advance(3)
            assert observations[k].tolist() == [*simulation.q, *simulation.p]
            assert rewards[k] == -simulation.q[0]**2 - 1e-3 * actions[k, 0]**2
        assert not terminations.any() and not truncations.any()
    envs.close()


@pytest.mark.parametrize('mode', AutoresetMode, ids=lambda mode: mode.value)
def test_environments_are_reset_as_gymnasium_does(events, mode):
    settings = {'every': 4, 'max_episode_steps': 16, 'initial_state': somewhere}
    ours = SceneVectorEnv(events, 4, reward, threads=2, autoreset_mode=mode, **settings)
    theirs = SyncVectorEnv([lambda: SceneEnv(events, reward, **settings)] * 4,
                           autoreset_mode=mode)
    assert ours.metadata['autoreset_mode'] == mode
    rng, ends = np.random.default_rng(1), np.zeros((2, 4), dtype=int)
    outcomes = [envs.reset(seed=[3, 1, 4, 15]) for envs in (ours, theirs)]
    for _ in range(40):
        # They come to the angle at different times, and some do not.
        actions = rng.uniform(-9.0, 3.0, (4, 1))
        outcomes = [envs.step(actions) for envs in (ours, theirs)]
        one, other = outcomes
        for mine, yours in zip(one[:4], other[:4], strict=True):
            assert np.array_equal(mine, yours)
        # Texts, and events and last states of those that ended.
        assert str(one[4]) == str(other[4])
        ends += one[2:4]
        mask = one[2] | one[3]
        if mode is AutoresetMode.DISABLED and mask.any():
            first, second = (envs.reset(options={'reset_mask': mask.copy()})
                             for envs in (ours, theirs))
            assert np.array_equal(first[0], second[0])
    assert (ends.sum(axis=1) > 0).all()


def at_the_sun(rng):
    return [1e-300, 0.0], [0.0, 0.0]


@pytest.mark.parametrize('context', ['fork', pytest.param('spawn', marks=pytest.mark.long)])
@pytest.mark.filterwarnings('ignore')
def test_environments_of_other_processes_are_those_of_this_one(events, context):
    """Of gymnasium's AsyncVectorEnv, from a scene that is handed over as it is."""
    makers = [partial(SceneEnv, load_scene(events), reward, every=4, max_episode_steps=16,
                      initial_state=somewhere)] * 2
    theirs, ours = AsyncVectorEnv(makers, context=context), SyncVectorEnv(makers)
    rng = np.random.default_rng(1)
    try:
        one, other = theirs.reset(seed=5), ours.reset(seed=5)
        assert np.array_equal(one[0], other[0])
        for _ in range(40):
            actions = rng.uniform(-9.0, 3.0, (2, 1))
            one, other = theirs.step(actions), ours.step(actions)
            for mine, yours in zip(one[:4], other[:4], strict=True):
                assert np.array_equal(mine, yours)
            assert str(one[4]) == str(other[4])
        with refused(ValueError):
            theirs.step(np.full((2, 1), np.nan))
    finally:
        theirs.close(terminate=True)


@pytest.mark.long
@pytest.mark.filterwarnings('ignore')
def test_failure_in_another_process_comes_here(tmp_path):
    envs = AsyncVectorEnv([partial(
        SceneEnv, 'kepler', reward, initial_state=at_the_sun,
        effects=[{'kind': 'external_force', 'coordinates': ['x', 'y']}])], context='fork')
    try:
        with refused(StateError):
            envs.reset(seed=1)
    finally:
        envs.close(terminate=True)


def test_episode_ends_where_an_event_stops_the_run(events):
    env = SceneEnv(events, lambda step: step.t, every=10)
    env.reset()
    told = []
    for _ in range(50):
        observation, time, terminated, truncated, info = env.step([0.0])
        told += info.get('events', [])
        if terminated:
            break
    assert not truncated and info['event'].startswith('angle = -0.5 (down) at t = ')
    assert observation[0] == pytest.approx(-0.5, abs=1e-12)
    # Not at the end of a step: the time of the event.
    assert time == pytest.approx(float(info['event'].split()[-2]), rel=1e-8)
    assert len(told) == 1 and told[0].startswith('angle = 0 (down)')
    with refused(gymnasium.error.ResetNeeded):
        env.step([0.0])


def test_episode_ends_where_a_step_fails(noisy):
    # At such a momentum no angle stays finite.
    env = SceneEnv(noisy, lambda step: step.t, every=50, max_episode_steps=100,
                   initial_state=lambda rng: ([0.0], [1.7e308]))
    env.reset()
    terminated = truncated = False
    while not (terminated or truncated):
        observation, time, terminated, truncated, info = env.step([0.0])
    assert terminated and not truncated and 'step failed at t' in info['failure']
    # The last good state, and its time.
    assert np.isfinite(observation).all() and f't = {time:.9g} s' in info['failure']


def test_seed_tells_the_noise_and_the_initial_state(noisy):
    envs = SceneVectorEnv(noisy, 2, reward)
    runs = []
    for seed in (7, 7, 8):
        envs.reset(seed=seed)
        runs.append(np.array([envs.step(np.zeros((2, 1)))[0] for _ in range(5)]))
    assert np.array_equal(runs[0], runs[1])
    # One environment's seed is the next number of the one before.
    assert np.array_equal(runs[0][:, 1], runs[2][:, 0])
    assert not np.array_equal(runs[0][:, 0], runs[0][:, 1])


@pytest.mark.parametrize('settings', [
    {'effects': ()}, {'every': 0}, {'every': 51}, {'limits': [1.0, 2.0]}, {'limits': -1.0},
    {'max_episode_steps': 0}], ids=str)
def test_arguments_that_cannot_be_used_are_told(settings):
    with refused(ValueError):
        SceneEnv('exact_pendulum', reward, **{'effects': FORCE} | settings)


def test_actions_that_cannot_be_taken_are_refused_whole():
    envs = SceneVectorEnv('exact_pendulum', 2, reward, effects=FORCE, limits=1.0)
    start, _ = envs.reset(seed=0)
    for actions in ([[0.0], [1.5]], [[0.0], [np.nan]], [0.0, 0.0]):
        with refused(ValueError):
            envs.step(actions)
    with refused(ValueError):
        envs.reset(options={'q': [1.0]})
    # No environment has moved.
    simulation = build(load_scene('exact_pendulum').with_overrides(effects=FORCE))
    simulation.advance(1)
    envs.reset(seed=0)
    assert envs.step(np.zeros((2, 1)))[0][1].tolist() == [*simulation.q, *simulation.p]
    assert start[0].tolist() == [2.5, 0.0]
