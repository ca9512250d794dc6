# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Many trajectories at once against each of them alone."""

import warnings

from helpers import EPS, long
from hnn_vi_ros.errors import AlarmWarning, SceneError, StepFailure
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import (
    BLOCK, build, look, RunFacts, simulate, simulate_many, Simulation, System, Watch)
from messages import refused
import numpy as np
import pytest


def scene_of(kind: str, integrator: str | dict, d: int = 1, h: float = 0.05, *effects: dict
             ) -> Scene:
    """Return a scene of a system of d coordinates."""
    return Scene.build(hamiltonian=kind, integrator=integrator, step_size=h, effects=effects,
                       initial_state=([1.0] * d, [0.0] * d))


def free_particle() -> Scene:
    """Return the scene of a mass of 1 kg at rest, in steps of 0.01 s."""
    return Scene.build(hamiltonian='free_particle', integrator='stormer_verlet', step_size=0.01,
                       initial_state=([0.0], [0.0]))


@pytest.mark.parametrize('threads, kind, integrator, d', [
    (2, 'tao', 'variational_euler', 1), (1, 'double_pendulum', 'variational_euler', 2),
    long(1, 'tao', 'variational_euler', 1), long(2, 'double_pendulum', 'variational_euler', 2),
    *(long(threads, 'tao', method, 1) for threads in (1, 2)
      for method in ('gauss6', 'generalized_leapfrog', 'discrete_gradient'))])
def test_many_trajectories_are_those_of_each_alone(kind, integrator, d, threads):
    scene = scene_of(kind, integrator, d)
    m, samples, every = 2 * BLOCK + 3, 4, 10
    q, p = np.random.default_rng(0).uniform(-0.8, 0.8, (2, m, d))
    many = simulate_many(scene, q, p, samples * every * 0.05, samples=samples, threads=threads)
    assert many.q.shape == (samples + 1, m, d)
    assert many.energy.shape == (samples + 1, m)
    assert many.t[-1] == pytest.approx(2.0)
    for i in (0, BLOCK - 1, BLOCK, m - 1):
        alone = Simulation(scene.create_hamiltonian(), scene.create_integrator(), 0.05, q[i], p[i])
        q_alone, p_alone = alone.record(samples, every)
        # Both are solved to 8 eps a step, and the flow stretches that less than 100 times.
        tolerance = 100 * 8 * EPS * samples * every
        assert np.abs(many.q[1:, i] - q_alone).max() <= tolerance
        assert np.abs(many.p[1:, i] - p_alone).max() <= tolerance


@pytest.mark.parametrize('kind', ['kepler', 'pendulum'])
@pytest.mark.parametrize('duration, samples', [(3.0, 10), (3.1, 7)])
def test_trajectories_of_dop853_take_steps_of_their_own_whatever_the_threads(
        kind, duration, samples):
    """Bit by bit; between steps of the clock the dense output of one is rounded otherwise."""
    d = {'kepler': 2, 'pendulum': 1}[kind]
    scene = scene_of(kind, 'dop853', d, 0.3)
    random = np.random.default_rng(0)
    q, p = random.uniform(0.5, 1.5, (BLOCK + 5, d)), random.uniform(-0.5, 0.5, (BLOCK + 5, d))
    runs = [simulate_many(scene, q, p, duration, samples=samples, threads=threads)
            for threads in (1, 2, 3)]
    for run in runs[1:]:
        assert np.array_equal(run.q, runs[0].q) and np.array_equal(run.p, runs[0].p)
    for i in (0, BLOCK - 1, BLOCK):
        alone = simulate(scene, duration, initial_state=(q[i], p[i]), times=runs[0].t)
        rounding = 0.0 if duration == 3.0 else 100 * EPS
        assert np.abs(alone.q - runs[0].q[:, i]).max() <= rounding


def test_energies_of_a_block_are_those_of_each_and_evaluated_once(monkeypatch):
    scene, calls = load_scene('harmonic_oscillator'), []
    energies = System.energies

    def counted(system, z):
        calls.append(energies(system, z))
        return calls[-1]
    monkeypatch.setattr(System, 'energies', counted)
    counts = []
    for blocks in (1, 3):
        q, p = np.random.default_rng(0).uniform(-0.5, 0.5, (2, blocks * BLOCK, 1))
        calls.clear()
        many = simulate_many(scene, q, p, 0.1, threads=1, path_error='off')
        counts.append(len(calls))
        assert any(found == many.energy[0, -BLOCK:].tolist() for found in calls)
    assert counts[1] - counts[0] == 2


def test_many_trajectories_report_the_failure_of_one():
    scene = scene_of('tao', {'kind': 'variational_euler', 'solver': 'fixed_point'})
    q = np.zeros((20, 1))
    q[17] = 1e3
    with pytest.warns(AlarmWarning, match='^failed in 1 of 20 trajectories; in trajectory 17,'):
        found = simulate_many(scene, q, q, 1.0, samples=2)
    assert np.isnan(found.q).any(axis=(0, 2)).nonzero()[0].tolist() == [17]
    assert [k for k, own in enumerate(found.alarms) if 'failed' in {
        alarm.kind for alarm in own}] == [17]
    with pytest.raises(StepFailure):
        simulate_many(scene, q[17:18], q[17:18], 1.0)


@pytest.mark.parametrize('commands', [None, np.zeros((3, 20, 1))])
def test_trajectory_that_fails_is_kept_until_then_and_the_others_are_those_alone(commands):
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x'], 'H': 'p_x^2/2 + sqrt(1 - x^2)'},
        integrator='gauss8', step_size=0.01, initial_state=([0.5], [0.0]),
        effects=[] if commands is None else [{'kind': 'external_force', 'coordinates': ['x']}])
    q, p = [[0.3], [0.9], [0.4]], [[0.1], [3.0], [-0.2]]
    with pytest.warns(AlarmWarning, match='in trajectory 1, t = 0.03 s: step failed'):
        many = simulate_many(scene, q, p, 0.2, samples=20, commands=commands)
    for k in range(3):
        n = 4 if k == 1 else 21
        alone = simulate(scene, (n - 1) * 0.01, initial_state=(q[k], p[k]), commands=(
            None if commands is None else commands[k]))
        assert np.array_equal(many.q[:n, k], alone.q) and np.isnan(many.q[n:, k]).all()
        assert np.array_equal(many.energy[:n, k], alone.energy)


def test_duration_of_zero_gives_the_initial_states():
    found = simulate_many('harmonic_oscillator', [[1.0], [2.0]], [[0.0], [0.5]], 0.0, samples=3)
    assert found.q.tolist() == [[[1.0], [2.0]]] and found.t.tolist() == [0.0]


@pytest.mark.parametrize('kind, arguments', [
    (ValueError, {'q': [[1.0, 2.0]], 'p': [[0.0, 0.0]]}),
    (ValueError, {'q': [1.0, 2.0], 'p': [0.0, 0.0]}),
    (ValueError, {'q': [[np.nan]]}), (ValueError, {'duration': -1.0}),
    (ValueError, {'q': np.empty((0, 1)), 'p': np.empty((0, 1))}), (ValueError, {'threads': -1}),
    (TypeError, {'samples': 1.5}), (ValueError, {'samples': 10 ** 12}), (TypeError, {'q': 'a'})],
    ids=range(9))
def test_many_trajectories_refuse_bad_arguments(kind, arguments):
    with refused(kind):
        simulate_many('harmonic_oscillator', **{'q': [[1.0]], 'p': [[0.0]], 'duration': 1.0}
                      | arguments)


def test_simulate_refuses_to_choose_a_method_by_itself():
    with refused(SceneError):
        simulate('harmonic_oscillator', 1.0, integrator='auto')


# The orbits of e = 0.9 and 0.1 from their pericentres.
CLOSE, FAR = ([0.1, 0.0], [0.0, 19.0 ** 0.5]), ([0.9, 0.0], [0.0, (1.1 / 0.9) ** 0.5])
KEPLER = scene_of('kepler', 'variational_euler', 2, 0.01)


def test_simulate_warns_of_what_the_guards_find_and_returns_it():
    with pytest.warns(AlarmWarning, match='under-resolved: .*; use ') as caught:
        trajectory = simulate(KEPLER, 6.28, initial_state=CLOSE)
    assert {alarm.kind for alarm in trajectory.alarms} == {'under-resolved', 'path not resolved'}
    assert caught[0].filename == __file__
    # Of the very guards of the node, sample by sample; the path error is that of the whole run.
    simulation = build(KEPLER.with_overrides(
        initial_state=dict(zip('qp', CLOSE, strict=True))))
    watch = Watch(RunFacts(simulation))
    watch.update(look(simulation))
    for _ in range(628):
        simulation.advance(1)
        watch.update(look(simulation))
    assert watch.alarms == [
        alarm for alarm in trajectory.alarms if alarm.kind != 'path not resolved']


def test_simulate_is_silent_where_all_is_well():
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert simulate(KEPLER, 6.28, initial_state=FAR).alarms == ()
        assert simulate_many(KEPLER, [FAR[0]] * 3, [FAR[1]] * 3, 6.28, samples=50).alarms == (
            (), (), ())


@pytest.mark.xfail(strict=True, reason=(
    'a path of 0.2 s is h / 2 off by a large share of its small amplitude'))
def test_ends_of_many_trajectories_alone_raise_no_alarm_where_each_path_is_resolved():
    """Two samples have no mean: the later one may lie at a turning point, where p . H_p is 0."""
    q, p = np.random.default_rng(2).uniform(-1.0, 1.0, (2, 400, 1))
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for duration in (0.2, 1.0):
            simulate_many('pendulum', q, p, duration)


def test_simulate_many_warns_once_and_tells_the_alarms_of_each_trajectory():
    q, p = zip(FAR, CLOSE, FAR, CLOSE, strict=True)
    with pytest.warns(AlarmWarning, match='in 2 of 4 .*; in trajectory 1, t = ') as caught:
        many = simulate_many(KEPLER, q, p, 6.28, samples=628)
    assert [len(own) for own in many.alarms] == [0, 2, 0, 2] and len(caught) == 2
    assert caught[0].filename == __file__
    with pytest.warns(AlarmWarning):
        assert simulate(KEPLER, 6.28, initial_state=CLOSE).alarms == many.alarms[1]


@pytest.mark.parametrize('integrator, said', [
    ('explicit_euler', {'energy not accounted for', 'path not resolved'}),
    ('variational_euler', set())])
def test_energy_that_no_work_accounts_for_is_told_by_simulate_and_simulate_many(
        integrator, said):
    """
    Explicit Euler multiplies an oscillator's energy by 1 + h^2 in each step, by 7.4 here.

    The path of variational_euler is h / 2 off, 0.5 %, by a displacement that does not add up.
    """
    drive = {'kind': 'periodic_drive', 'coordinate': 'x', 'amplitude': 0.01, 'frequency': 0.3}
    scene = scene_of('harmonic_oscillator', integrator, 1, 0.01, drive)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore' if said else 'error')
        one = simulate(scene, 200.0)
        many = simulate_many(scene, [[1.0], [0.5]], [[0.0], [0.0]], 200.0, samples=20_000)
    assert {alarm.kind for alarm in one.alarms} == said
    assert [{alarm.kind for alarm in own} for own in many.alarms] == [said, said]


@pytest.mark.filterwarnings('ignore:t = .* a step took')
def test_steps_that_were_rescued_are_told_at_the_time_by_which_they_are_counted():
    """A step of 0.5 s is too long for the pericentre, 3 s after the apocentre."""
    start = ([1.9, 0.0], [0.0, (0.1 / 1.9) ** 0.5])
    with pytest.warns(AlarmWarning, match=(
            '^rescued steps: t = 10 s: on_failure replaced .* steps so far')):
        run = simulate('kepler', 10.0, initial_state=start, integrator='gauss8', step_size=0.5)
    assert [alarm.step for alarm in run.alarms if alarm.kind == 'rescued steps'] == [20]


@pytest.mark.filterwarnings('ignore')
def test_steps_that_were_rescued_or_slow_are_told_by_simulate_many_as_well():
    """The trajectories are of one block, whose steps are taken together."""
    q, p = [1.9, 0.0], [0.0, (0.1 / 1.9) ** 0.5]
    scene = load_scene('kepler').with_overrides(0.5, 'gauss8')
    said = {alarm.kind for alarm in simulate(scene, 10.0, initial_state=(q, p)).alarms}
    assert {'rescued steps', 'slow step'} <= said
    many = simulate_many(scene, [q] * 2, [p] * 2, 10.0, samples=20)
    assert [{alarm.kind for alarm in own} for own in many.alarms] == [said, said]


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_state_whose_energy_is_infinite_is_an_alarm():
    with pytest.warns(AlarmWarning, match='the energy is not finite'):
        run = simulate(free_particle(), 0.2, initial_state=([0.0], [1e200]))
    assert 'under-resolved' in {alarm.kind for alarm in run.alarms}


PUSHED = [{'kind': 'external_force', 'coordinates': ['x']}]


@pytest.mark.parametrize('more', [0, 1, 3])
def test_last_part_of_a_run_takes_the_command_of_its_own_row(more):
    """A row for each sample is one more than is needed; what comes later is not used."""
    scene = free_particle()
    rows = [[1.0], [2.0], [3.0], *[[100.0]] * more]
    run = simulate(scene, 0.255, effects=PUSHED, commands=rows, every=10)
    # Impulses of forces that are constant in parts: nothing but rounding.
    assert run.p[:, 0] == pytest.approx([0.0, 0.1, 0.3, 0.3 + 3.0 * 0.055], abs=1e-14)


def test_quadrotor_hovers_until_the_first_command():
    run = simulate('quadrotor', 10.0)
    # The thrust is its weight to a rounding, 1e-15 N, in each of 5000 steps.
    assert abs(run.q - run.q[0]).max() < 1e-12


def test_commands_of_a_run_hold_a_quadrotor_where_it_is():
    run = simulate('quadrotor', 0.1, commands=lambda t: [0.8 * 9.81, 0.0, 0.0, 0.0], every=10)
    assert run.q.shape == (6, 7) and run.p.shape == (6, 6)
    assert (run.q == run.q[0]).all() and (run.p == 0.0).all()


@pytest.mark.parametrize('every', [np.int64(10), np.int32(10), 10])
def test_simulate_takes_whole_numbers_of_numpy(every):
    assert simulate(free_particle(), 0.2, every=every).t.tolist() == [0.0, 0.1, 0.2]


@pytest.mark.parametrize('argument, value', [
    ('times', 'ab'), ('commands', {'a': 1}), ('commands', [[1.0], [2.0, 3.0]]),
    ('initial_state', ([0.0], ['x'])),
    ('initial_state', (np.array([1j]), [0.0])), ('initial_state', ([0.0], ['1.0'])),
    ('initial_state', ([0.0], [10 ** 400])),
    ('initial_state', (np.array(['2020-01-01'], 'datetime64[D]'), [0.0])),
    ('initial_state', ([1j], [0.0]))])
def test_arguments_that_are_no_numbers_are_named(argument, value):
    with refused(TypeError):
        simulate(free_particle(), 0.2, effects=PUSHED, **{argument: value})


@pytest.mark.parametrize('times', [
    (0.1 * k for k in range(2)), np.ma.array([0.1], mask=[True])], ids=['generator', 'masked'])
def test_times_that_are_no_numbers_are_named(times):
    with pytest.raises(TypeError, match='times = (<generator|masked_array).* must be numbers'):
        simulate(free_particle(), 0.2, times=times)


@pytest.mark.parametrize('every', [100, 10 ** 12, 10 ** 30, 10 ** 400])
def test_sample_at_the_duration_is_taken_however_large_every_is(every):
    assert simulate(free_particle(), 0.2, every=every).t.tolist() == [0.0, 0.2]


def test_trajectories_that_step_together_raise_no_slow_step_that_none_raises_alone():
    """Newton's method of a block takes a column of the Jacobian for each of its unknowns."""
    q, p = np.random.default_rng(0).uniform(-0.8, 0.8, (2, BLOCK, 2))
    many = simulate_many(
        scene_of('double_pendulum', 'variational_euler', 2), q, p, 2.0, samples=4)
    assert 'slow step' not in {alarm.kind for alarm in many.alarms[0]}


FORCE = {'kind': 'external_force', 'coordinates': ['angle2'], 'timeout': 0.06}


@pytest.mark.parametrize('method', ['rk4', 'variational_euler', 'implicit_midpoint'])
@pytest.mark.parametrize('threads', [1, 2])
def test_commanded_rows_are_those_of_simulate_bit_by_bit(method, threads):
    # A command lasts a sample, beyond its time-out.
    scene = load_scene('exact_double_pendulum').with_overrides(0.02, method, effects=[
        {'kind': 'damping', 'rate': 0.2}, FORCE])
    rng = np.random.default_rng(2)
    q, p, commands = (*rng.uniform(-0.8, 0.8, (2, BLOCK + 2, 2)),
                      rng.normal(size=(BLOCK + 2, 3, 1)))
    many = simulate_many(scene, q, p, 0.3, samples=3, commands=commands, threads=threads)
    by_time = simulate_many(scene, q, p, 0.3, samples=3, commands=lambda t: commands[
        :, min(int((t + 1e-9) / 0.1), 2)])
    for k in (0, 1, BLOCK, BLOCK + 1):
        alone = simulate(scene, 0.3, every=5, initial_state=(q[k], p[k]), commands=commands[k])
        assert np.array_equal(many.q[:, k], alone.q) and np.array_equal(many.p[:, k], alone.p)
    assert np.array_equal(many.q, by_time.q) and np.array_equal(many.p, by_time.p)


def test_one_row_of_a_function_commands_every_trajectory_with_all_of_its_numbers():
    scene = load_scene('exact_double_pendulum').with_overrides(0.02, 'rk4', effects=[
        FORCE | {'coordinates': ['angle1', 'angle2'], 'timeout': 1.0}])
    many = simulate_many(scene, np.zeros((3, 2)), np.zeros((3, 2)), 0.2,
                         commands=lambda t: [1.0, -0.5])
    alone = simulate(scene, 0.2, initial_state=([0.0] * 2, [0.0] * 2),
                     commands=lambda t: [1.0, -0.5])
    assert np.array_equal(many.q[-1], np.tile(alone.q[-1], (3, 1)))


@pytest.mark.filterwarnings('ignore')
def test_a_commanded_step_that_fails_is_taken_as_simulate_takes_it():
    # Its equation has no solution where the arm is so fast, and steps are taken in parts.
    scene = load_scene('exact_double_pendulum').with_overrides(
        0.2, 'variational_euler', effects=[{**FORCE, 'timeout': 1.0}])
    q, p = np.array([[1.0, 1.0], [0.1, 0.2]]), np.array([[20.0, -10.0], [0.0, 0.0]])
    simulation = build(scene)
    simulation.restart(q[0], p[0])
    simulation.advance(10)
    assert simulation.rescued
    commands = np.full((2, 10, 1), 3.0)
    many = simulate_many(scene, q, p, 2.0, samples=10, commands=commands)
    for k in range(2):
        alone = simulate(scene, 2.0, initial_state=(q[k], p[k]), commands=commands[k])
        assert np.array_equal(many.q[:, k], alone.q)


@pytest.mark.parametrize('changes', [
    {'commands': np.zeros((2, 3, 1))}, {'commands': np.full((2, 5, 1), np.nan)},
    {'commands': lambda t: [0.0, 0.0]}, {'commands': np.zeros((2, 5, 1)), 'duration': 0.33},
    {'commands': np.zeros((2, 5, 1)), 'device': 'cpu'},
    {'commands': np.zeros((2, 5, 1)), 'scene': 'exact_pendulum', 'q': [[1.0]], 'p': [[0.0]]}])
def test_commands_that_do_not_fit_are_refused(changes):
    scene = load_scene('exact_double_pendulum').with_overrides(0.02, 'rk4', effects=[FORCE])
    arguments = {'scene': scene, 'q': np.zeros((2, 2)), 'p': np.zeros((2, 2)), 'duration': 0.5,
                 'samples': 5} | changes
    with refused(ValueError):
        simulate_many(**arguments)


def test_changed_effect_is_not_told_as_a_line_of_the_file():
    with refused(SceneError):
        simulate('pendulum', 0.2, effects=[{'kind': 'damping', 'rate': -0.1}])
