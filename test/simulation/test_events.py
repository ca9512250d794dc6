# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Events of scenes: what their conditions may be, and that each is found, once and in time."""

from helpers import effect, free, kepler_orbit, long, plain_run
from hnn_vi_ros.commands.scene_tool import explain
from hnn_vi_ros.errors import SceneError, StoppedByEvent
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators.time_transformed import TimeTransformed
from hnn_vi_ros.scene import Condition, load_scene
from hnn_vi_ros.simulation import simulate, simulate_many, Simulation, WatchedSimulation
from hnn_vi_ros.simulation.events import EventFunction
from messages import refused
import numpy as np
import pytest

SCENE = """\
hamiltonian: {kind: harmonic_oscillator}
integrator: {kind: gauss8}
step_size: 0.05
initial_state: {q: [0.0], p: [1.0]}
events:
  - {when: x = 0.5, direction: up}
  - {when: 'x ** 2 + 3 * p_x = 0', direction: down, then: log}
"""


@pytest.fixture
def path(tmp_path):
    """Return the file of a scene with events."""
    file = tmp_path / 'mine.yaml'
    file.write_text(SCENE)
    return file


def oscillator(method: str, h: float, *functions: EventFunction, phase: float = 0.0
               ) -> WatchedSimulation:
    """Return x = cos(t + phase), watched."""
    return WatchedSimulation(plain_run('harmonic_oscillator', method, h, [np.cos(phase)],
                                       [-np.sin(phase)]), functions)


# Conditions.

@pytest.mark.parametrize('text, expected', [
    ('x = 1', 1.0), ('p_x = x', -5.0), ('2 * x - p_x / 3 = 1', 4.0), ('-x = +2', -4.0),
    ('v_x = 0', -1.5), ('H = 3.25', 0.0), ('(x + 1) ** 2 = 9', 0.0), ('(x + 1)^2 = 9', 0.0),
    ('abs(p_x) = sqrt(9)', 0.0),
    ('cos(pi * x) = sin(0)', 1.0), ('1e1 = x', 8.0)])
def test_condition_is_left_less_right_side(text, expected):
    hamiltonian = HAMILTONIANS['harmonic_oscillator'](mass=2.0, stiffness=0.5)
    condition = Condition(text)
    condition.check(hamiltonian)
    q, p = np.array([[2.0], [2.0]]), np.array([[-3.0], [-3.0]])
    assert condition.values(hamiltonian, q, p, 0.0).tolist() == pytest.approx(
        [expected] * 2, abs=1e-15)
    assert float(condition.values(hamiltonian, q[0], p[0], 0.0)) == pytest.approx(
        expected, abs=1e-15)


@pytest.mark.parametrize('text', [
    'x', 'x == 1', 'x = y = 1', 'x = ', '= 1', 'x < 1', 'x = 1; y = 2', 'x = open("f")',
    'x = __import__("os")', 'x = (1).real', 'x = [1][0]', 'x = y if y else 0', 'x = lambda: 1',
    'x = "1"', 'x = 1j', 'x = sin()', 'x = sin(1, 2)', 'x = exit(x)',
    'x = x.__class__', 'x = sin(*x)', 'x = 1 @ 2', 'x = ' + '(' * 150 + ')' * 40,
    'x' * 300 + ' = 1', 'x = \0', 'x = (y := 1)', 'cos(pi) = 1',
    # In float64 huge powers are infinite, not numbers of many digits.
    'x = 1 / 0', 'x = 0 / 0', 'x + sqrt(-1) = 0', '1 / 0 * x = 1', 'x = 9 ** 9 ** 9 ** 9',
    'x = 1e999', '-1e999 = x'])
def test_condition_that_is_no_plain_equation_of_numbers_is_refused_at_once(text):
    with refused(ValueError):
        Condition(text)


# Scenes.

@pytest.mark.parametrize('old, new', [
    ('x = 0.5', 'y = 0.5'), ('x = 0.5', 'x'), ('x = 0.5', 'x = import_(os)'),
    ('direction: up', 'direction: left'), ('then: log', 'then: jump')])
def test_scene_event_mistake_is_answered_with_file_line_and_what_is_valid(path, old, new):
    path.write_text(SCENE.replace(old, new))
    with refused(SceneError):
        simulate(path, 0.1)


def test_scene_events_are_found_and_the_path_is_that_without_them(path):
    run = simulate(path, 13.0, every=4)
    # x = sin t reaches 1/2 upwards at pi/6, and sin^2 + 3 cos = 0 downwards where
    # cos = (3 - sqrt(13)) / 2.
    times = {event.when: [] for event in run.events}
    for event in run.events:
        times[event.when].append(event.t)
        assert event.q[0] == pytest.approx(np.sin(event.t), abs=1e-12)
        assert event.energy == pytest.approx(0.5, abs=1e-12)
    turn = np.arccos(0.5 * (3.0 - np.sqrt(13.0)))
    # gauss8 errs by 1e-14 a step of a twentieth of a radian; rounding of 260 steps.
    assert times['x = 0.5'] == pytest.approx(np.pi * np.array([1, 13]) / 6.0, abs=1e-12)
    assert times['x ** 2 + 3 * p_x = 0'] == pytest.approx(
        turn + 2.0 * np.pi * np.arange(2), abs=1e-12)
    assert [event.t for event in run.events] == sorted(event.t for event in run.events)
    assert {event.direction for event in run.events} == {'up', 'down'}
    path.write_text(SCENE.partition('events:')[0])
    plain = simulate(path, 13.0, every=4)
    assert plain.events == ()
    assert np.array_equal(plain.q, run.q) and np.array_equal(plain.p, run.p)


@pytest.mark.parametrize('arguments, samples', [
    ({'every': 4}, 3), ({'times': [0.1, 0.33, 0.7]}, 2), ({'commands': lambda t: [0.0]}, 11)])
def test_event_that_stops_ends_the_trajectory_there(path, arguments, samples):
    path.write_text(SCENE.replace('direction: up', 'then: stop'))
    more = {'effects': [{'kind': 'external_force', 'coordinates': ['x']}]} \
        if 'commands' in arguments else {}
    run = simulate(path, 2.0, **arguments, **more)
    assert run.t[-1] == pytest.approx(np.pi / 6.0, abs=1e-12)
    assert (run.q[-1, 0], run.events[-1].t) == (run.events[-1].q[0], run.t[-1])
    assert run.q[-1, 0] == pytest.approx(0.5, abs=1e-15)
    assert len(run.t) == len(run.q) == len(run.energy) == samples + 1
    assert len(run.events) == 1


# x = sin t is 1/2 at 0.5236 s, in the step from 0.4 s to 0.8 s.
@pytest.mark.parametrize('duration, times, expected', [
    (0.5, None, [0.0, 0.4, 0.5]), (0.5, [0.1, 0.45, 0.5], [0.1, 0.45, 0.5]),
    (0.7, [0.1, 0.45, 0.5, 0.6], [0.1, 0.45, 0.5, np.pi / 6.0]),
    (0.7, None, [0.0, 0.4, np.pi / 6.0])])
@pytest.mark.parametrize('then', ['log', 'stop'])
def test_events_after_the_last_sample_are_none_and_samples_before_them_are_taken(
        path, then, duration, times, expected):
    path.write_text(SCENE.replace('direction: up', f'then: {then}').replace('0.05', '0.4'))
    run = simulate(path, duration, times=times)
    if then == 'log':
        expected = [*expected[:-1], duration if times is None else times[-1]]
    # gauss8 errs by 1e-10 in two steps of 0.4.
    assert run.t == pytest.approx(expected, abs=1e-9)
    assert run.q[:, 0] == pytest.approx(np.sin(run.t), abs=1e-9)
    assert len(run.events) == (duration > 0.6)


def test_many_trajectories_with_events_are_refused(path):
    with refused(ValueError):
        simulate_many(path, [[0.0]], [[1.0]], 1.0)


def test_scene_explained_tells_its_events(path):
    assert any(line == 'event x = 0.5 (up): log' for line in explain(load_scene(path)))


# How well events are found.

@pytest.mark.parametrize('h', [0.3, 1.0, 3.0])
def test_events_are_found_to_round_off_in_long_steps(h):
    """Of gauss16, at steps up to half a period, the path is cos t to 1e-11."""
    simulation = oscillator('gauss16', h, EventFunction(Condition('x = 0.2')),
                            EventFunction(Condition('v_x = 0'), 'down'))
    simulation.advance(round(18.0 / h))
    crossings = [event.t for event in simulation.events if event.when == 'x = 0.2']
    turns = [event.t for event in simulation.events if event.when == 'v_x = 0']
    first = np.arccos(0.2)
    expected = np.sort([sign * first + 2.0 * np.pi * k for k in range(4) for sign in (-1, 1)])[1:]
    assert crossings == pytest.approx(expected[expected < 18.0], abs=1e-9 if h > 2 else 1e-12)
    assert turns == pytest.approx(2.0 * np.pi * np.arange(1, 3), abs=1e-9 if h > 2 else 1e-12)


@pytest.mark.parametrize('phase', [0.05, 0.4, 0.8])
@pytest.mark.parametrize('level', [0.999, 1.0 - 1e-9])
@pytest.mark.parametrize('method', ['gauss16', 'gauss8', 'implicit_midpoint'])
def test_condition_that_comes_true_twice_within_a_step_is_found_twice(method, level, phase):
    """The top of x = cos t lies inside of a step of 1 s, which begins and ends below the level."""
    simulation = oscillator(method, 1.0, EventFunction(Condition(f'x = {level!r}')), phase=-phase)
    simulation.advance(1)
    up, down = simulation.events
    assert (up.direction, down.direction) == ('up', 'down')
    assert up.t < phase < down.t if method != 'implicit_midpoint' else up.t < down.t
    assert [up.q[0], down.q[0]] == pytest.approx([level] * 2, abs=1e-15)


@pytest.mark.parametrize('texts, phase', [
    (['x = 1.000000001'], -0.4), (['x = 1', 'v_x = 0'], 0.0)],
    ids=['all but true', 'true at the initial state'])
def test_condition_that_never_comes_true_is_no_event(texts, phase):
    simulation = oscillator('gauss16', 1.0, *(EventFunction(Condition(text)) for text in texts),
                            phase=phase)
    simulation.advance(20 if phase else 3)
    assert simulation.events == []


@pytest.mark.parametrize('direction, expected', [('up', 1), ('down', 1), ('both', 2)])
def test_event_at_the_end_of_a_step_is_found_once(direction, expected):
    """A free body, x = t / 4 - 1 and then back, is at zero exactly where a step ends."""
    simulation = WatchedSimulation(
        plain_run(free('x'), 'stormer_verlet', 0.25, [-1.0], [0.25],
                  effect('impact', 'x', 0.5, 'below')),
        [EventFunction(Condition('x = 0'), direction)])
    simulation.advance(60)
    assert [event.t for event in simulation.events] == [
        t for t, way in ((4.0, 'up'), (8.0, 'down')) if direction in (way, 'both')]
    assert len(simulation.events) == expected


def test_events_between_impacts_in_a_step_lie_on_the_path_that_bounces():
    simulation = WatchedSimulation(
        plain_run(free('x'), 'stormer_verlet', 1.0, [0.5], [-1.0], effect('impact', 'x')),
        [EventFunction(Condition('x = 0.25'))])
    simulation.advance(1)
    assert [event.t for event in simulation.events] == pytest.approx([0.25, 0.75], abs=1e-15)


@pytest.mark.parametrize('method, h', [
    ('stormer_verlet', 0.1), ('gauss6', 0.5), ('stormer_verlet', 0.37)])
@pytest.mark.parametrize('when, at', [
    ('x = 0.05', np.sqrt(2.0 * 0.95)), ('p_x = 1.3', np.sqrt(2.0) - 1.3), ('v_x = 0', 0.0)])
def test_events_beside_impacts_are_found(method, h, when, at):
    """A ball that falls from 1 m at 1 m/s^2, whose steps all these methods take exactly."""
    simulation = WatchedSimulation(
        plain_run(free('x'), method, h, [1.0], [0.0], effect('gravity', 'x', 1.0, 1.0),
                  effect('impact', 'x')), [EventFunction(Condition(when))])
    simulation.advance(int(20.0 / h))
    end, fall = int(20.0 / h) * h, np.sqrt(2.0)
    bounces = fall * np.arange(1, 15, 2)
    both = {'x = 0.05': np.concatenate([bounces - fall + at, bounces + fall - at]),
            'p_x = 1.3': np.concatenate([bounces, bounces + at]),
            'v_x = 0': np.concatenate([bounces, bounces + fall])}[when]
    assert [event.t for event in simulation.events] == pytest.approx(
        np.sort(both[both <= end]), abs=1e-12)


@pytest.mark.parametrize('h', [0.05, 0.37, 0.6])
def test_events_are_found_in_steps_where_the_condition_is_no_number_elsewhere(h: float):
    """The root is of a negative number while abs(x) < 1/2; events are at x = +-sqrt(1/2)."""
    simulation = oscillator('gauss8', h, EventFunction(Condition('sqrt(x ** 2 - 0.25) = 0.5')))
    simulation.advance(int(7.0 / h))
    all_of_them = 0.25 * np.pi * np.arange(1, 9, 2)
    # The error of gauss8 in the time of a crossing, from its path error at h = 0.6.
    assert [event.t for event in simulation.events] == pytest.approx(
        all_of_them[all_of_them < int(7.0 / h) * h], abs=1e-6)


def test_simulation_stands_before_the_step_of_an_event_that_stops_it():
    simulation = oscillator('gauss8', 0.1, EventFunction(Condition('x = 0'), stops=True))
    with pytest.raises(StoppedByEvent, match=r'x = 0 \(down\) at t = 1\.57') as raised:
        simulation.record(30, 1)
    assert (simulation.steps, raised.value.q.shape) == (15, (15, 1))
    assert simulation.q[0] > 0.0
    simulation.restart([1.0], [0.0])
    assert simulation.events == []


def test_pole_of_a_condition_is_no_event():
    """Where x = cos t goes through zero, 1 / x goes from infinity to minus infinity."""
    poles, roots = (oscillator('gauss4', 0.1, EventFunction(Condition(text)))
                    for text in ('1 / x = 0', '1 / x = 2'))
    poles.advance(20)
    roots.advance(20)
    assert not poles.events
    assert [event.t for event in roots.events] == pytest.approx([np.pi / 3], abs=1e-5)


# Steps of the clock that are filled with steps of the method's own.

def encounters(method: TimeTransformed, e: float, h: float, **events: str) -> WatchedSimulation:
    """Return three orbits from the apocentre of a comet, watched for events by direction."""
    q0, p0 = (part[0] for part in kepler_orbit(np.array([-np.pi]), e))
    simulation = WatchedSimulation(
        plain_run('kepler', method, h, q0, p0),
        [EventFunction(Condition(when), direction) for direction, when in events.items()])
    simulation.advance(round(6.0 * np.pi / h))
    return simulation


@pytest.mark.parametrize('e', [long(0.6), 0.9, long(0.99)])
@pytest.mark.parametrize('base, control, h', [
    ('gauss8', 'hamiltonian', 0.5), ('stormer_verlet', 'integrating', 0.1)])
def test_each_pericentre_within_steps_of_the_clock_is_found_to_the_order(base, control, h, e):
    method = TimeTransformed(base, control=control)
    # The energy is -1/2 all the time.
    runs = [encounters(method, e, step, up='x * p_x + y * p_y = 0', both='H = 0')
            for step in (h, 0.5 * h)]
    passages = np.pi * np.array([1.0, 3.0, 5.0])
    coarse, fine = (np.abs([event.t for event in run.events] - passages).max() for run in runs)
    assert np.log2(coarse / fine) >= method.order - 0.35


def test_event_that_comes_and_goes_between_steps_of_the_clock_is_found_twice():
    """A comet is nearer than 1.02 times its least distance for 2 % of a step."""
    run = encounters(TimeTransformed('gauss8'), 0.99, 0.75, down='x ** 2 + y ** 2 = 0.0102 ** 2',
                     up='x ** 2 + y ** 2 = 0.0102 ** 2')
    assert [event.direction for event in run.events] == ['down', 'up'] * 3
    # r = 1 - e cos E and t = E - e sin E; 1e-4 of a second is what the passages are late.
    anomaly = np.arccos((1.0 - 0.0102) / 0.99)
    half = anomaly - 0.99 * np.sin(anomaly)
    assert np.diff([event.t for event in run.events])[::2] == pytest.approx(2.0 * half, rel=0.01)


def test_looking_within_steps_of_the_clock_changes_no_later_step():
    seen = encounters(TimeTransformed('gauss8'), 0.9, 0.75, both='x = 0')
    plain = Simulation(seen.hamiltonian, TimeTransformed('gauss8'), 0.75,
                       *(part[0] for part in kepler_orbit(np.array([-np.pi]), 0.9)))
    plain.advance(seen.steps)
    assert np.array_equal([seen.q, seen.p], [plain.q, plain.p])
    assert (seen.gradients, seen.time) == (plain.gradients, plain.time)


def test_run_of_a_comet_that_ends_between_steps_has_its_energy():
    run = simulate('kepler_close', 3.15, every=40)
    # gauss8 in steps of its own: 3e-10 of the energy at the clock.
    assert run.energy[-1] == pytest.approx(run.energy[0], abs=1e-8)
