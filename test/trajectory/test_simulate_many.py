# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Many trajectories at once against each of them alone."""

from pathlib import Path
import warnings

from helpers import EPS
from hnn_vi_ros.errors import AlarmWarning, SceneError, StepFailure
from hnn_vi_ros.guards.watch import look, Watch
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.build import build
from hnn_vi_ros.simulation.system import System
from hnn_vi_ros.trajectory.simulate import BLOCK, simulate, simulate_many
from messages import refused
import numpy as np
import pytest

SCENE = """\
hamiltonian: {{kind: {kind}}}
integrator: {{kind: {integrator}}}
step_size: 0.05
initial_state: {{q: {q}, p: {q}}}
"""


@pytest.mark.parametrize('threads, kind, integrator, d', [
    (2, 'tao', 'variational_euler', 1), (1, 'double_pendulum', 'variational_euler', 2),
    *(pytest.param(threads, *row, marks=pytest.mark.long) for threads, rows in (
        (1, [('tao', 'variational_euler', 1)]), (2, [('double_pendulum', 'variational_euler', 2)]),
        *((threads, [('tao', 'gauss6', 1), ('tao', 'generalized_leapfrog', 1),
                     ('tao', 'discrete_gradient', 1)]) for threads in (1, 2))) for row in rows)])
def test_many_trajectories_are_those_of_each_alone(tmp_path, kind, integrator, d, threads):
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE.format(kind=kind, integrator=integrator, q=[0.0] * d))
    scene = load_scene(path)
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
        many = simulate_many(scene, q, p, 0.1, threads=1)
        counts.append(len(calls))
        assert any(found == many.energy[0, -BLOCK:].tolist() for found in calls)
    assert counts[1] - counts[0] == 2


def test_many_trajectories_report_the_failure_of_one(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE.format(kind='tao', integrator='variational_euler, solver: fixed_point',
                                 q=[0.0]))
    q = np.zeros((20, 1))
    q[17] = 1e3
    with pytest.raises(StepFailure):
        simulate_many(load_scene(path), q, q, 1.0)


def test_many_trajectories_refuse_bad_arguments():
    scene = load_scene('harmonic_oscillator')
    with refused(ValueError):
        simulate_many(scene, [[1.0, 2.0]], [[0.0, 0.0]], 1.0)
    with refused(ValueError):
        simulate_many(scene, [1.0, 2.0], [0.0, 0.0], 1.0)
    with refused(SceneError):
        simulate(scene, 1.0, integrator='auto')
    with refused(ValueError):
        simulate_many(scene, [[np.nan]], [[0.0]], 1.0)
    with refused(ValueError):
        simulate_many(scene, [[1.0]], [[0.0]], 0.0)
    with refused(ValueError):
        simulate_many(scene, np.empty((0, 1)), np.empty((0, 1)), 1.0)
    with refused(ValueError):
        simulate_many(scene, [[1.0]], [[0.0]], 1.0, threads=-1)
    with refused(TypeError):
        simulate_many(scene, [[1.0]], [[0.0]], 1.0, samples=1.5)
    with refused(ValueError):
        simulate_many(scene, [[1.0]], [[0.0]], 1.0, samples=10 ** 12)
    with refused(TypeError):
        simulate_many(scene, 'a', [[0.0]], 1.0)


def scene_of(tmp_path: Path, kind: str, integrator: str, h: float, d: int, effects: str = ''
             ) -> Scene:
    (tmp_path / 'scene.yaml').write_text(
        f'hamiltonian: {{kind: {kind}}}\nintegrator: {{kind: {integrator}}}\nstep_size: {h}\n'
        f'initial_state: {{q: {[1.0] * d}, p: {[0.0] * d}}}\n{effects}')
    return load_scene(tmp_path / 'scene.yaml')


# The orbits of e = 0.9 and 0.1 from their pericentres.
CLOSE, FAR = ([0.1, 0.0], [0.0, 19.0 ** 0.5]), ([0.9, 0.0], [0.0, (1.1 / 0.9) ** 0.5])


def test_simulate_warns_of_what_the_guards_find_and_returns_it(tmp_path):
    scene = scene_of(tmp_path, 'kepler', 'variational_euler', 0.01, 2)
    with pytest.warns(AlarmWarning, match='under-resolved: .*; use .* step_size 0.00') as caught:
        trajectory = simulate(scene, 6.28, initial_state=CLOSE)
    assert [alarm.kind for alarm in trajectory.alarms] == ['under-resolved']
    assert caught[0].filename == __file__
    # Of the very guards of the node, sample by sample.
    simulation = build(scene.with_overrides(
        initial_state=dict(zip('qp', CLOSE, strict=True))))
    watch = Watch(simulation, None)
    watch.update(look(simulation))
    for _ in range(628):
        simulation.advance(1)
        watch.update(look(simulation))
    assert tuple(watch.alarms) == trajectory.alarms


def test_simulate_is_silent_where_all_is_well(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        scene = scene_of(tmp_path, 'kepler', 'variational_euler', 0.01, 2)
        assert simulate(scene, 6.28, initial_state=FAR).alarms == ()
        assert simulate_many(scene, [FAR[0]] * 3, [FAR[1]] * 3, 6.28, samples=50).alarms == (
            (), (), ())


def test_ends_of_many_trajectories_alone_raise_no_alarm_where_each_path_is_resolved():
    """Two samples have no mean: the later one may lie at a turning point, where p . H_p is 0."""
    q, p = np.random.default_rng(2).uniform(-1.0, 1.0, (2, 400, 1))
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for duration in (0.2, 1.0):
            simulate_many('pendulum', q, p, duration)


def test_simulate_many_warns_once_and_tells_the_alarms_of_each_trajectory(tmp_path):
    scene = scene_of(tmp_path, 'kepler', 'variational_euler', 0.01, 2)
    q, p = zip(FAR, CLOSE, FAR, CLOSE, strict=True)
    with pytest.warns(AlarmWarning, match='in 2 of 4 trajectories; in number 1, t = ') as caught:
        many = simulate_many(scene, q, p, 6.28, samples=628)
    assert [len(own) for own in many.alarms] == [0, 1, 0, 1] and len(caught) == 1
    assert caught[0].filename == __file__
    with pytest.warns(AlarmWarning):
        assert simulate(scene, 6.28, initial_state=CLOSE).alarms == many.alarms[1]


@pytest.mark.parametrize('integrator, said', [
    ('explicit_euler', ('energy not accounted for',)), ('variational_euler', ())])
def test_energy_that_no_work_accounts_for_is_told_by_simulate_and_simulate_many(
        tmp_path, integrator, said):
    """Explicit Euler multiplies an oscillator's energy by 1 + h^2 in each step, by 7.4 here."""
    drive = ('effects: [{kind: periodic_drive, coordinate: x, amplitude: 0.01, frequency: 0.3, '
             'phase: 0.0}]\n')
    scene = scene_of(tmp_path, 'harmonic_oscillator', integrator, 0.01, 1, drive)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore' if said else 'error')
        one = simulate(scene, 200.0)
        many = simulate_many(scene, [[1.0], [0.5]], [[0.0], [0.0]], 200.0, samples=20_000)
    assert tuple(alarm.kind for alarm in one.alarms) == said
    assert [tuple(alarm.kind for alarm in own) for own in many.alarms] == [said, said]


@pytest.mark.filterwarnings('ignore:t = .* a step took')
def test_steps_that_were_rescued_are_told_at_the_time_by_which_they_are_counted():
    """A step of 0.5 s is too long for the pericentre, 3 s after the apocentre."""
    start = ([1.9, 0.0], [0.0, (0.1 / 1.9) ** 0.5])
    with pytest.warns(AlarmWarning, match=(
            '^rescued steps: t = 10 s: .* steps so far were taken otherwise')):
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
    # Paths are tried of single trajectories only.
    said -= {'path not resolved'}
    assert [{alarm.kind for alarm in own} for own in many.alarms] == [said, said]


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_state_whose_energy_is_infinite_is_an_alarm(tmp_path):
    with pytest.warns(AlarmWarning, match='the energy is infinite, or no number'):
        run = simulate(free_particle(tmp_path), 0.2, initial_state=([0.0], [1e200]))
    assert 'under-resolved' in {alarm.kind for alarm in run.alarms}


PUSHED = [{'kind': 'external_force', 'coordinates': ['x']}]


@pytest.mark.parametrize('more', [0, 1, 3])
def test_last_part_of_a_run_takes_the_command_of_its_own_row(tmp_path, more):
    """A row for each sample is one more than is needed; what comes later is not used."""
    scene = free_particle(tmp_path)
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
def test_simulate_takes_whole_numbers_of_numpy(tmp_path, every):
    assert simulate(free_particle(tmp_path), 0.2, every=every).t.tolist() == [0.0, 0.1, 0.2]


@pytest.mark.parametrize('argument, value', [
    ('times', 'ab'), ('commands', {'a': 1}), ('commands', [[1.0], [2.0, 3.0]]),
    ('initial_state', ([0.0], ['x'])),
    ('initial_state', (np.array([1j]), [0.0])), ('initial_state', ([0.0], ['1.0'])),
    ('initial_state', ([0.0], [10 ** 400])),
    ('initial_state', (np.array(['2020-01-01'], 'datetime64[D]'), [0.0])),
    ('initial_state', ([1j], [0.0]))])
def test_arguments_that_are_no_numbers_are_named(tmp_path, argument, value):
    with refused(TypeError):
        simulate(free_particle(tmp_path), 0.2, effects=PUSHED, **{argument: value})


@pytest.mark.parametrize('times', [
    (0.1 * k for k in range(2)), np.ma.array([0.1], mask=[True])], ids=['generator', 'masked'])
def test_times_that_are_no_numbers_are_named(tmp_path, times):
    with pytest.raises(TypeError, match='times = (<generator|masked_array).* must be numbers'):
        simulate(free_particle(tmp_path), 0.2, times=times)


@pytest.mark.parametrize('every', [100, 10 ** 12, 10 ** 30, 10 ** 400])
def test_sample_at_the_duration_is_taken_however_large_every_is(tmp_path, every):
    assert simulate(free_particle(tmp_path), 0.2, every=every).t.tolist() == [0.0, 0.2]


def free_particle(tmp_path: Path) -> Scene:
    """Return the scene of a mass of 1 kg at rest, in steps of 0.01 s."""
    file = tmp_path / 'free.yaml'
    file.write_text("""
hamiltonian: {kind: free_particle, mass: 1.0, names: [x]}
integrator: {kind: stormer_verlet}
step_size: 0.01
initial_state: {q: [0.0], p: [0.0]}
""")
    return load_scene(file)


def test_duration_that_no_float_holds_is_refused(tmp_path):
    with refused(ValueError):
        simulate(free_particle(tmp_path), 10 ** 400)


def test_trajectories_that_step_together_raise_no_slow_step_that_none_raises_alone(tmp_path):
    """Newton's method of a block takes a column of the Jacobian for each of its unknowns."""
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE.format(kind='double_pendulum', integrator='variational_euler',
                                 q=[0.0, 0.0]))
    q, p = np.random.default_rng(0).uniform(-0.8, 0.8, (2, BLOCK, 2))
    many = simulate_many(path, q, p, 2.0, samples=4)
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
