# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Closed chains: accelerations, motions, energy, derivatives; what is dropped, and refused."""

import copy
import json
import re
import warnings

from helpers import EPS, long
from hnn_vi_ros.control import BatchStep
from hnn_vi_ros.errors import HnnViRosError, StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum
from hnn_vi_ros.identify.free_numbers import free_scene
from hnn_vi_ros.identify.identify import main
from hnn_vi_ros.learning import Prediction
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.fit.windows import cut_windows
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import (
    build, Change, derivative, DifferentiableRun, lyapunov_time, Numbers, SceneRun, simulate,
    simulate_many)
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp

SCENES = ['four_bar', 'five_bar', 'delta_robot']
FRAMES = load_scene('four_bar').hamiltonian.loops[0].frames
POINTS = [frame[:3] for frame in FRAMES]
FRICTION = [{'kind': 'joint_friction', 'damping': {'crank_joint': 0.1}},
            {'kind': 'damping', 'rate': 0.2}]
DRIVE = [{'kind': 'external_force', 'coordinates': ['crank_joint'], 'timeout': 1e6}]


def changed(name: str, **other) -> Scene:
    """Return a scene with other keys of its loop, of hamiltonian, or of the scene."""
    scene = load_scene(name)
    data = copy.deepcopy(scene.model_dump()['hamiltonian'])
    for key in [*other]:
        if key in ('links', 'joint', 'points', 'frames'):
            data['loops'][0][key] = other.pop(key)
        elif key in data:
            data[key] = other.pop(key)
    return scene.changed({'hamiltonian': data, **other})


def four_bar(joint: str, **other) -> Scene:
    ends = {'points': POINTS, 'frames': None} if joint == 'point' else {}
    return changed('four_bar', joint=joint, **{**ends, **other})


class Constrained:
    """The constrained equations of a simulation: G^T lambda from the second derivative of g."""

    def __init__(self, scene: Scene):
        self.simulation = build(scene)
        self.hamiltonian = self.simulation.hamiltonian
        self.loops = self.simulation.system.constraints

    def slope(self, t: float, z: np.ndarray) -> np.ndarray:
        q, p = np.split(z, 2)
        H_q, v = self.hamiltonian.gradient(q, p)
        inverse = self.hamiltonian.inverse_mass(q, p)
        normal = self.loops.gradients(q[None])[0]
        turned = derivative(lambda e: self.loops.gradients((q + e * v)[None])[0] @ v, 1.0)
        moved = self.hamiltonian.hessian_vector(q, p, v, -H_q)[1]
        multipliers = np.linalg.solve(normal @ inverse @ normal.T, normal @ moved + turned)
        return np.concatenate([v, -H_q - normal.T @ multipliers])

    def acceleration(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        v, force = np.split(self.slope(0.0, np.concatenate([q, p])), 2)
        return self.hamiltonian.hessian_vector(q, p, v, force)[1]


def states(scene: Scene, count: int = 20) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return random states on the loops of a scene, near its initial state."""
    system, rng, found = build(changed_to_assemble(scene)).system, np.random.default_rng(1), []
    while len(found) < count:
        q = np.array(scene.initial_state.q)
        q = q + rng.normal(0.0, 0.1, q.size)
        found.append(system.check_state(q, rng.normal(0.0, 0.05, q.size)))
    return found


def changed_to_assemble(scene: Scene) -> Scene:
    data = scene.model_dump()['hamiltonian']
    return scene.changed({'hamiltonian': {**data, 'assemble': True}})


class Peer:
    """The robot of a scene in Pinocchio, whose loops are points: in a plane a hinge is one."""

    def __init__(self, scene: Scene, hamiltonian: Hamiltonian):
        self.lib = lib = pytest.importorskip(
            'pinocchio', reason='pin is not installed; see `make test`')
        self.model = model = lib.buildModelFromXML(hamiltonian.robot.text)
        self.places = [model.joints[model.getJointId(c.name)] for c in hamiltonian.coordinates]
        self.contacts = lib.StdVec_RigidConstraintModel()
        self.ends = []
        for loop in scene.hamiltonian.loops:
            frames = [model.frames[model.getFrameId(link, lib.FrameType.BODY)]
                      for link in loop.links]
            ends = [frame.placement.act(lib.SE3(np.eye(3), np.array(end[:3])))
                    for frame, end in zip(frames, loop.points or loop.frames, strict=True)]
            self.contacts.append(lib.RigidConstraintModel(
                lib.ContactType.CONTACT_3D, model, frames[0].parentJoint, ends[0],
                frames[1].parentJoint, ends[1], lib.ReferenceFrame.LOCAL))
            self.ends.append([model.addFrame(lib.Frame(
                f'{loop.links}{k}', frame.parentJoint, end, lib.FrameType.OP_FRAME))
                for k, (frame, end) in enumerate(zip(frames, ends, strict=True))])
        self.data = model.createData()

    def state(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a state in the order of Pinocchio."""
        q_peer, v_peer = self.lib.neutral(self.model), np.zeros(self.model.nv)
        for place, angle, rate in zip(self.places, q, v, strict=True):
            q_peer[place.idx_q:place.idx_q + place.nq] = angle if place.nq == 1 else (
                np.cos(angle), np.sin(angle))
            v_peer[place.idx_v] = rate
        return q_peer, v_peer

    def dynamics(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accelerations, and the forces on the first links of the loops, (L, 3)."""
        held = self.lib.StdVec_RigidConstraintData([c.createData() for c in self.contacts])
        self.lib.initConstraintDynamics(self.model, self.data, self.contacts, held)
        a = self.lib.constraintDynamics(
            self.model, self.data, *self.state(q, v), np.zeros(self.model.nv), self.contacts,
            held, self.lib.ProximalSettings(1e-14, 1e-12, 100))
        forces = [self.data.oMi[c.joint1_id].rotation @ c.joint1_placement.rotation
                  @ own.contact_force.linear for c, own in zip(self.contacts, held, strict=True)]
        return np.array([a[place.idx_v] for place in self.places]), np.array(forces)

    def jacobians(self, q: np.ndarray) -> np.ndarray:
        """Return those of the joint's frames on both links along the axes of the base."""
        q_peer, _ = self.state(q, q)
        columns = [place.idx_v for place in self.places]
        return np.array([[self.lib.computeFrameJacobian(
            self.model, self.data, q_peer, frame, self.lib.LOCAL_WORLD_ALIGNED)[:, columns]
            for frame in ends] for ends in self.ends])


@pytest.mark.parametrize('name', SCENES)
def test_accelerations_are_those_of_pinocchio(name: str, measured):
    scene = load_scene(name).changed({'effects': []})
    own, worst = Constrained(scene), 0.0
    peer = Peer(scene, own.hamiltonian)
    for q, p in states(scene):
        expected, _ = peer.dynamics(q, own.hamiltonian.gradient(q, p)[1])
        worst = max(worst, np.abs(own.acceleration(q, p) - expected).max()
                    / np.abs(expected).max())
    measured('acceleration against pinocchio, relative', name, worst, '<= 1e-11')
    assert worst <= 1e-11


@pytest.mark.parametrize('name', ['four_bar', long('five_bar'), 'delta_robot'])
def test_forces_in_loops_are_those_of_pinocchio(name: str, measured):
    h = 1e-4
    scene = load_scene(name).changed({'effects': [], 'step_size': h})
    simulation = build(scene)
    simulation.advance(500)
    (q, v), before = (simulation.q.copy(), simulation.dH_dp.copy()), simulation.loop_forces
    simulation.advance(1)
    # The mean of both steps has an error of order h^2, with rates below 30 rad/s.
    found = 0.5 * (before + simulation.loop_forces)
    _, expected = Peer(scene, simulation.hamiltonian).dynamics(q, v)
    error = np.abs(found[:, :3] - expected).max() / np.abs(expected).max()
    measured('forces in loops against pinocchio, relative', name, error, '<= 1e-5')
    assert error <= 1e-5


@pytest.mark.parametrize('joint', ['point', 'hinge', 'weld'])
def test_forces_in_loops_do_the_work_of_their_multipliers(joint: str):
    scene = bent_five_bar() if joint == 'weld' else four_bar(joint)
    simulation, rng = build(scene), np.random.default_rng(1)
    loops, d = simulation.system.constraints, simulation.q.size
    multipliers = rng.normal(size=loops.constraints.dropped.size)
    jacobians = Peer(scene, simulation.hamiltonian).jacobians(simulation.q)
    found = np.einsum('lk,lki->i', loops.forces(simulation.q, multipliers),
                      jacobians[:, 0] - jacobians[:, 1])
    gradient = np.array([derivative(
        lambda e, unit=unit: loops._at(simulation.q + e * unit)[0], 1.0)
        for unit in np.eye(d)])
    assert np.abs(found + gradient @ multipliers).max() <= 1e-9


def test_trajectory_has_the_forces_in_loops():
    scene = load_scene('four_bar')
    run, simulation = simulate(scene, 0.02, every=5), build(scene)
    found = run.loop_forces()
    assert found.shape == (3, 1, 6) and np.isnan(found[0]).all()
    simulation.advance(10)
    assert np.array_equal(found[2], simulation.loop_forces)
    # The same after a trial of other steps.
    simulation.probe.trial(simulation.row, 1e-3)
    assert np.array_equal(found[2], simulation.loop_forces)
    driven = scene.changed({'effects': DRIVE})
    with refused(ValueError):
        simulate(driven, 0.02, commands=lambda t: [0.3]).loop_forces()
    with refused(ValueError):
        simulate('exact_pendulum', 0.02).loop_forces()


def bent_five_bar() -> Scene:
    """Return the forearms as one bar, bent by the angle that they have at the start."""
    scene = load_scene('five_bar')
    bend = sum(scene.initial_state.q[2:]) - sum(scene.initial_state.q[:2])
    return changed('five_bar', joint='weld', points=None, frames=[
        [0.25, 0.0, 0.0, 0.0, bend, 0.0], [0.25, 0.06, 0.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize('name, joint', [
    ('four_bar', 'point'), ('four_bar', 'hinge'), long('five_bar', 'weld'),
    long('five_bar', 'point'), long('delta_robot', 'point')])
def test_motion_is_that_of_the_constrained_equations(name: str, joint: str, measured):
    scene = four_bar(joint) if name == 'four_bar' else load_scene(name)
    scene = (bent_five_bar() if joint == 'weld' else scene).changed({'effects': []})
    h, duration = 2e-5, 0.1
    own = Constrained(scene.changed({'step_size': h}))
    z = np.concatenate([own.simulation.q, own.simulation.p])
    expected = solve_ivp(own.slope, (0.0, duration), z, 'DOP853', rtol=1e-12, atol=1e-14).y[:, -1]
    own.simulation.advance(round(duration / h))
    found = np.concatenate([own.simulation.q, own.simulation.p])
    error = np.abs(found - expected).max()
    measured('error against DOP853 of the constrained equations', f'{name}, {joint}', error,
             '<= 1e-8')
    assert error <= 1e-8


@pytest.mark.parametrize('name', ['four_bar', *(long(name) for name in SCENES[1:])])
@pytest.mark.parametrize('method', ['generalized_leapfrog', 'implicit_midpoint'])
def test_rattle_keeps_loops_closed_in_every_step_and_the_energy_in_a_band(
        name: str, method: str, measured):
    scene = load_scene(name).changed({'effects': [], 'integrator': {'kind': method}})
    simulation = build(scene)
    loops, worst, energies, kinetic = simulation.system.constraints, 0.0, [], []
    for _ in range(2000):
        simulation.advance(1)
        worst = max(worst, np.abs(loops.errors(simulation.q)).max())
        energies.append(simulation.energy)
        kinetic.append(0.5 * simulation.p @ simulation.dH_dp)
    measured('largest error of closure in 2000 steps', f'{name}, {method}', worst, '<= 64 eps')
    assert worst <= 64.0 * EPS
    assert np.ptp(energies) <= 0.01 * np.ptp(kinetic)


def test_dependent_equations_are_dropped_and_reported():
    reports = [build(scene).system.constraints.report.partition(';')[0] for scene in (
        four_bar('hinge'), four_bar('point'), load_scene('delta_robot'))]
    assert reports == ['2 independent equations of 5', '2 independent equations of 3',
                       '9 independent equations of 9']


def test_hinge_moves_a_plane_linkage_as_a_point_does():
    runs = [build(four_bar(joint)) for joint in ('hinge', 'point')]
    for run in runs:
        run.advance(500)
    assert np.abs(runs[0].q - runs[1].q).max() <= 1e-11


def test_initial_state_is_moved_onto_the_loops():
    scene = load_scene('five_bar')
    simulation = build(scene)
    assert np.abs(simulation.system.constraints.errors(simulation.q)).max() <= 16.0 * EPS
    assert 0.0 < np.abs(simulation.q - scene.initial_state.q).max() <= 1e-6


@pytest.mark.parametrize('effects, commands', [([], None), (DRIVE, np.ones((2, 2, 1)))])
def test_many_motions_begin_on_the_loops(effects, commands):
    scene = changed_to_assemble(load_scene('four_bar')).changed({'effects': effects})
    q, p = np.array([scene.initial_state.q, [-1.1, 0.7, -1.6]]), np.zeros((2, 3))
    many = simulate_many(scene, q, p, 0.04, samples=2, commands=commands)
    for k in range(2):
        one = simulate(scene, 0.04, every=10, initial_state=(q[k], p[k]),
                       commands=None if commands is None else commands[k])
        assert np.array_equal(many.q[:, k], one.q) and np.array_equal(many.p[:, k], one.p)


def test_nearest_state_is_kept_by_another_projection():
    system = build(changed_to_assemble(load_scene('delta_robot'))).system
    for q, p in states(load_scene('delta_robot'), 3):
        again = system.check_state(q, p)
        assert np.abs(np.subtract(again, (q, p))).max() <= 1e-14


@pytest.mark.parametrize('change', [
    {'links': ['coupler', 'nothing']}, {'links': ['base', 'base']}, {'joint': 'weld'},
    {'frames': [FRAMES[0], [3.0, *FRAMES[1][1:]]]},
    {'frames': [FRAMES[0], [*FRAMES[1][:3], 0.5, 0.0, 0.0]]},
    {'initial_state': {'q': [-1.2, 0.74, -1.6], 'p': [0.0, 0.0, 0.0]}},
    {'initial_state': {'q': [-1.2, 0.730616, -1.682696], 'p': [0.1, 0.0, 0.0]}},
    {'integrator': {'kind': 'gauss4'}}, {'integrator': {'kind': 'variational_euler'}},
    {'effects': [{'kind': 'joint_limits', 'from': 'urdf'}]},
    {'effects': [{'kind': 'thermostat', 'temperature': 1.0, 'rate': 1.0}]},
    {'effects': [{'kind': 'holonomic_constraint', 'point': ['crank_joint'], 'anchor': [0.0]}]}],
    ids=range(12))
def test_loop_that_cannot_be_simulated_is_refused(change):
    with refused(HnnViRosError):
        build(changed('four_bar', **change))


@pytest.mark.parametrize('change', [
    {'points': POINTS}, {'frames': None}, {'joint': 'ball'}, {'links': ['coupler']},
    {'frames': [FRAMES[0], [1.0]]}], ids=range(5))
def test_loop_that_does_not_fit_the_schema_is_refused(change):
    with refused(HnnViRosError):
        changed('four_bar', **change)


@pytest.mark.parametrize('effects', [FRICTION, DRIVE, [
    {'kind': 'servo', 'coordinates': ['crank_joint'], 'stiffness': 2.0, 'damping': 0.1,
     'position': [-0.5]}]],
    ids=['friction', 'force', 'servo'])
def test_work_of_effects_accounts_for_the_energy(effects):
    scene = load_scene('four_bar').changed({'effects': effects, 'step_size': 1e-3})
    balances = []
    for h in (1e-3, 5e-4):
        simulation = build(scene.changed({'step_size': h}))
        if effects is DRIVE:
            simulation.motors.command(np.array([0.3]), simulation.q)
        simulation.advance(round(0.4 / h))
        assert abs(simulation.work) > 1e-3
        balances.append(abs(simulation.energy_balance))
    assert balances[0] <= 1e-4 and balances[1] <= 0.3 * balances[0]


@pytest.mark.parametrize('name, effects', [
    ('four_bar', []), ('four_bar', FRICTION), long('delta_robot', [])])
@pytest.mark.parametrize('method', ['generalized_leapfrog', 'implicit_midpoint'])
def test_derivatives_are_those_of_differences(name, effects, method, measured):
    scene = changed_to_assemble(load_scene(name)).changed({
        'effects': effects, 'integrator': {'kind': method}, 'step_size': 0.005})
    _, hamiltonian, integrator, made = scene.parts()
    run = DifferentiableRun(hamiltonian, integrator, 0.005, made)
    (q, p), steps, rng = states(scene, 1)[0], 20, np.random.default_rng(2)
    z = np.concatenate([q, p])
    direction, weights = rng.normal(size=z.size), rng.normal(size=z.size)
    # The projection of the initial state belongs to what is differentiated.
    expected = derivative(
        lambda e: run.record((z + e * direction)[None], 1, steps)[1, 0], 0.02)
    run.record(z[None], 1, steps)
    forward = run.push_forward([Change(direction[None])])[0, 1, 0]
    backward, _ = run.pull_back(np.stack([np.zeros_like(z), weights])[:, None])
    errors = (np.abs(forward - expected).max() / np.abs(expected).max(),
              abs(backward[0] @ direction - weights @ expected) / abs(weights @ expected))
    measured('derivative with loops against differences, relative', f'{name}, {method}',
             max(errors), '<= 1e-8')
    assert max(errors) <= 1e-8


def test_derivatives_by_masses_and_friction_are_those_of_differences():
    scene = changed_to_assemble(load_scene('four_bar')).changed({'effects': FRICTION})
    run, h = SceneRun(scene.parts()), 0.002
    # In motion and closed to round-off: the projection depends on the masses, first on momenta.
    z = np.concatenate(states(scene, 1)[0])
    for name, value in (('urdf.rocker.mass', 0.4), ('effects.0.damping.crank_joint', 0.1),
                        ('effects.1.rate', 0.2)):
        def last(e: float) -> np.ndarray:
            run.hold(Numbers({name: value + e}, h))
            return run.run.record(z[None], 1, 50)[:, 0]
        expected = derivative(last, value)
        last(0.0)
        dependence = run.on_number(name)
        forward = run.run.push_forward([Change(np.zeros((1, z.size)), [
            (dependence, np.array(1.0))])])[0, :, 0]
        _, (backward,) = run.run.pull_back(np.ones((2, 1, z.size)), [dependence])
        assert np.abs(forward - expected).max() <= 1e-7 * np.abs(expected).max()
        assert abs(backward - forward.sum()) <= 1e-9 * np.abs(forward).max()


def test_points_of_loops_are_refused_as_numbers():
    run, name = SceneRun(load_scene('five_bar').parts()), 'hamiltonian.loops.0.points.0.0'
    run.hold(Numbers({name: 0.25}, 0.002))
    with refused(ValueError):
        run.on_number(name)


def test_lyapunov_time_of_loops_is_refused():
    with refused(ValueError):
        lyapunov_time(load_scene('four_bar'))


def test_control_of_loops_is_refused():
    with refused(UnsupportedSystem):
        BatchStep(load_scene('four_bar'))


def parallelogram(longer: float, h: float) -> Scene:
    """Return a linkage that is folded flat twice a turn, exactly if its rocker is no longer."""
    return four_bar(
        'point', points=[[0.4, 0.0, 0.0], [0.15 + longer, 0.03, 0.0]], assemble=True, step_size=h,
        gravity=[0.0, -9.81, 0.0], integrator={'kind': 'generalized_leapfrog'},
        initial_state={'q': [-1.2, 1.2, -1.2], 'p': [0.1, 0.0, 0.1]})


@pytest.mark.parametrize('longer, h, told', [
    (0.0, 0.002, True), (0.002, 0.01, True), (0.02, 0.0005, False)])
def test_singular_position_is_an_alarm_or_ends_the_run_unless_steps_resolve_it(longer, h, told):
    ended = False
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        try:
            simulate(parallelogram(longer, h), 2.0)
        except StepFailure:
            ended = True
    kinds = {str(warning.message).partition(':')[0] for warning in caught}
    assert (ended or 'singular position' in kinds) == told
    assert 'loop open' not in kinds


def test_trials_of_other_steps_are_not_watched_for_singular_positions():
    simulation = build(load_scene('four_bar'))
    simulation.advance(5)
    watched = simulation.system.constraints.constraints.sine
    before = watched.copy()
    assert before[1] > 0.0
    simulation.probe.trial(simulation.row, 10.0 * simulation.step_size, 3)
    assert watched.tolist() == before.tolist()


def test_derivatives_of_a_fit_keep_loops_closed(tmp_path):
    scene = load_scene('four_bar').changed({'effects': FRICTION})
    run = simulate(scene, 0.2, every=10)
    v = run.hamiltonian().gradient(run.q, run.p)[1]
    windows = cut_windows([smoothed('log', run.t, run.q, v, np.zeros_like(v), 40.0)], 0.1)
    names = ['rocker.mass', 'joint_friction.damping.crank_joint',
             'hamiltonian.loops.0.frames.1.0']
    free = free_scene(scene.parts(), names, {}, tmp_path, False)
    prediction = Prediction(free, np.array([one.start for one in free.numbers]), windows)
    q, v = windows.start.swapaxes(0, 1)
    q = q + np.random.default_rng(1).normal(0.0, 0.01, q.shape)
    starts, usable = prediction.log.closed(np.hstack([
        q, momentum(prediction.log.hamiltonian, q, v, np.zeros_like(q))]))
    directions, (_, slopes) = prediction.directions(starts), prediction.by_starts(starts)
    # One degree of freedom: an angle and a momentum.
    assert usable.all() and len(directions) == 2 == slopes.shape[3]
    for k, way in enumerate(directions):
        expected = derivative(lambda e, way=way: prediction.log.predict(starts + e * way), 0.1)
        np.testing.assert_allclose(slopes[..., k], expected, atol=1e-7 * np.abs(expected).max())
    for k, found in enumerate(np.moveaxis(prediction.parameter_jacobian(starts), -1, 0)):
        expected = prediction._difference(starts, k)
        assert np.abs(expected).max() > 0.0
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.long
def test_identify_finds_a_mass_and_friction_of_a_linkage(tmp_path):
    truth = {'rocker.mass': 0.4, 'joint_friction.damping.crank_joint': 0.1}
    scene = load_scene('four_bar').changed({'effects': FRICTION[:1]})
    run, rng = simulate(scene, 2.0, every=5), np.random.default_rng(1)
    np.savez(tmp_path / 'run.npz', t=run.t, q=run.q + rng.normal(0.0, 1e-3, run.q.shape))
    robot = scene.create_hamiltonian().robot.text
    (tmp_path / 'bar.urdf').write_text(robot.replace('mass value="0.4"', 'mass value="0.45"'))
    text = scene.changed({'effects': [{'kind': 'joint_friction', 'damping': {
        'crank_joint': 0.07}}]}).to_yaml()
    (tmp_path / 'bar.yaml').write_text(re.sub('file: .*', 'file: bar.urdf', text))
    main([str(tmp_path / 'bar.yaml'), '--data', str(tmp_path / 'run.npz'), '--free', *truth,
          '--json', str(tmp_path / 'found.json')])
    found = json.loads((tmp_path / 'found.json').read_text())
    for name, value in truth.items():
        assert found[name]['low'] < value < found[name]['high']
        assert found[name]['high'] - found[name]['low'] < 0.1 * value


@pytest.mark.parametrize('name', ['initial_state', 'input_delay'])
def test_numbers_that_a_fit_of_loops_does_not_support_are_refused(name, tmp_path):
    with refused(UnsupportedSystem):
        main(['four_bar', '--data', str(tmp_path / 'none.npz'), '--free', 'rocker.mass', name])
