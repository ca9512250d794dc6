# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Elastic gears with backlash: closed forms, DOP853, the energy account, and who is commanded."""

from pathlib import Path

from helpers import assert_derivatives_of_energy, difference, plain_run, Uncompiled
from hnn_vi_ros.effects import EFFECTS, EffectState, JointCommand
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.run import joints_of
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build, look, RunFacts, Simulation, Watch
from hnn_vi_ros.simulation.guards.steps import StiffnessGuard
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp

URDF = """\
<robot name="lever">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="1.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="continuous"><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/></joint>
</robot>
"""
# A fixed joint, a follower, one that the scene locks, and one whose name a rotor would take.
MORE = ''.join(f"""\
  <link name="{name}"><inertial><mass value="0.1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="{name}" type="{kind}"><parent link="arm"/><child link="{name}"/>
    <axis xyz="0 0 1"/>{more}<limit lower="-4" upper="4" effort="1" velocity="1"/></joint>
""" for name, kind, more in (
    ('mount', 'fixed', ''), ('finger', 'continuous', '<mimic joint="elbow"/>'),
    ('slide', 'prismatic', ''), ('wrist', 'revolute', ''), ('wrist_motor', 'revolute', '')
)) + '</robot>\n'
# Inertias of the arm about its joint, and of the rotor on its side of the gear [kg m2].
ARM, ROTOR, STIFFNESS = 0.02 + 1.5 * 0.2**2, 50.0**2 * 2e-5, 30.0


@pytest.fixture
def lever(tmp_path: Path):
    """Return a function that makes scenes of a lever behind a gear."""
    (tmp_path / 'lever.urdf').write_text(URDF)

    def make(effects: str = '', integrator: str = 'gauss4', q: str = '0.1, 0.0',
             step: float = 1e-3, g: float = 0.0, **drive: float) -> Scene:
        numbers = {'stiffness': STIFFNESS, 'rotor_inertia': 2e-5, 'gear': 50.0} | drive
        (tmp_path / 'scene.yaml').write_text(
            f'hamiltonian: {{kind: urdf, file: lever.urdf, gravity: [0.0, {-g}, 0.0], drives: '
            f'{{elbow: {numbers}}}}}\neffects: [{effects}]\nintegrator: {integrator}\n'
            f'step_size: {step}\ninitial_state: {{q: [{q}], p: [0.0, 0.0]}}\n')
        return load_scene(tmp_path / 'scene.yaml')
    return make


def torque(s: float, b: float, w: float, k: float = STIFFNESS) -> float:
    """Return U'(s) by its definition."""
    if b == 0.0:
        return k * s

    def edge(x: float) -> float:
        return w * np.logaddexp(0.0, x / w) / (1.0 + np.exp(-x / w))
    return k * (edge(s - b) - edge(-s - b))


def plain(scene: Scene) -> Simulation:
    """Return a simulation of a scene in plain Python."""
    _, hamiltonian, integrator, effects = scene.parts()
    return plain_run(Uncompiled(hamiltonian), integrator, scene.step_size, scene.initial_state.q,
                     scene.initial_state.p, *effects)


def test_twist_of_a_linear_gear_oscillates_at_its_natural_frequency(lever):
    simulation = plain(lever(step=0.005))
    t, start = 0.005 * np.arange(1, 101), simulation.energy
    q = simulation.record(100, 1)[0]
    omega = np.sqrt(STIFFNESS * (1.0 / ARM + 1.0 / ROTOR))
    # gauss4 has a relative phase error of (omega h)^4 / 720 [8.3e-7, over 15.6 rad].
    np.testing.assert_allclose(q[:, 1] - q[:, 0], -0.1 * np.cos(omega * t), atol=1.5e-6)
    assert abs(simulation.energy - start) < 1e-12


@pytest.mark.parametrize(('backlash', 'damping'), [(0.0, 0.02), (0.04, 0.0), (0.04, 0.02)])
def test_path_with_backlash_is_that_of_dop853(lever, backlash: float, damping: float):
    simulation = plain(lever(backlash=backlash, smoothing=0.01, damping=damping, g=9.81,
                             step=0.005, integrator='gauss8'))

    def rates(t: float, y: np.ndarray) -> list[float]:
        q, theta, v, omega = y
        push = torque(theta - q, 0.5 * backlash, 0.01) + damping * (omega - v)
        return [v, omega, (push - 1.5 * 9.81 * 0.2 * np.cos(q)) / ARM, -push / ROTOR]
    path = solve_ivp(rates, (0.0, 0.5), [0.1, 0.0, 0.0, 0.0], 'DOP853',
                     np.linspace(0.005, 0.5, 100), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(simulation.record(100, 1)[0], path.y[:2].T, atol=1e-7)


def test_energy_account_closes_with_the_order_of_the_method(lever):
    errors = []
    for step in (0.01, 0.005):
        simulation = plain(lever(damping=0.05, backlash=0.02, smoothing=0.004, step=step,
                                 integrator='implicit_midpoint'))
        simulation.advance(round(0.3 / step))
        errors.append(abs(simulation.energy_balance))
        assert simulation.work < 0.0
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.parametrize('drive', [{}, {'backlash': 0.1, 'smoothing': 0.02}, {'backlash': 0.1}])
def test_hessian_vector_product_is_the_derivative_of_the_gradient(lever, drive: dict):
    hamiltonian = plain(lever(**drive)).system.hamiltonian
    # Round-off of energies of some 10 J over 1e-4, and (1e-4 / w)^6 of the curvature.
    assert_derivatives_of_energy(hamiltonian, *0.3 * np.random.default_rng(3).normal(
        size=(2, 5, 2)), 1e-7)


def test_command_to_a_joint_acts_on_its_rotor_and_joint_states_are_of_links(lever):
    simulation = plain(lever('{kind: external_force, coordinates: [elbow]}', q='0.0, 0.0'))
    simulation.set_command([0.6])
    simulation.advance(1)
    assert simulation.p[1] == pytest.approx(0.6e-3, rel=1e-3)
    assert abs(simulation.p[0]) < 1e-3 * simulation.p[1]
    coordinates = simulation.hamiltonian.coordinates
    assert [c.name for c in coordinates] == ['elbow', 'elbow_motor']
    names, _ = joints_of(coordinates)
    assert names == ['elbow']


ELBOW = 'elbow: {stiffness: 30.0, rotor_inertia: 2.0e-5'


@pytest.mark.parametrize('drives', [
    'elbow: {stiffness: 0.0, rotor_inertia: 1.0}', 'elbow: {stiffness: -3.0, rotor_inertia: 1.0}',
    'elbow: {stiffness: .inf, rotor_inertia: 1.0}', 'elbow: {stiffness: 3.0, rotor_inertia: 0.0}',
    'elbow: {stiffness: 3.0, rotor_inertia: -1.0}', 'elbow: {stiffness: soft, rotor_inertia: 1.0}',
    'elbow: {stiffness: 30.0}', 'elbow: {rotor_inertia: 1.0, backlash: 0.1}', 'elbow: 30.0',
    'elbow: [30.0, 1.0]', 'elbow: null', '3', f'{ELBOW}, gears: 3.0}}', f'{ELBOW}, gear: 0.0}}',
    f'{ELBOW}, gear: 1.0e+200}}', f'{ELBOW}, gear: 1.0e-170}}', f'{ELBOW}, damping: -1.0}}',
    f'{ELBOW}, backlash: -0.1}}', f'{ELBOW}, smoothing: -0.1}}', f'{ELBOW}, drive: mx64}}',
    f'{ELBOW.replace("elbow", "elbows")}}}', f'{ELBOW.replace("elbow", "elbow_motor")}}}',
    f'{ELBOW.replace("elbow", "mount")}}}', f'{ELBOW.replace("elbow", "finger")}}}',
    f'{ELBOW.replace("elbow", "slide")}}}', f'{ELBOW.replace("elbow", "wrist")}}}'])
def test_drive_that_cannot_be_is_refused_in_a_line(tmp_path, drives: str):
    (tmp_path / 'hand.urdf').write_text(URDF.replace('</robot>', MORE))
    given = drives if drives == '3' else f'{{{drives}}}'
    (tmp_path / 'scene.yaml').write_text(
        f'hamiltonian:\n  kind: urdf\n  file: hand.urdf\n  locked: {{slide: 0.1}}\n'
        f'  drives: {given}\nintegrator: gauss4\nstep_size: 0.001\n'
        'initial_state: {q: [0.0, 0.0, 0.0, 0.0], p: [0.0, 0.0, 0.0, 0.0]}\n')
    with refused(HnnViRosError):
        build(load_scene(tmp_path / 'scene.yaml'))


@pytest.mark.parametrize('stiffness', [1e12, 1e300])
def test_gear_of_any_stiffness_runs_with_an_alarm_or_stops(lever, stiffness: float):
    simulation = plain(lever(stiffness=stiffness))
    watch = Watch(RunFacts(simulation), (StiffnessGuard,))
    watch.update(look(simulation))
    assert [alarm.kind for alarm in watch.alarms] == ['stiffness not resolved']


@pytest.mark.parametrize('name', ['gripper', 'six_joint_arm'])
def test_rotor_adds_its_own_kinetic_energy_only(name: str):
    robot = str(Path(__file__).parents[2] / 'config' / 'robots' / f'{name}.urdf')
    plain = Uncompiled(RigidBodyTree(robot))
    first, d = plain.coordinates[0].name, plain.dimension
    driven = Uncompiled(RigidBodyTree(robot, drives={first: {
        'stiffness': 3.0, 'rotor_inertia': 1e-4, 'gear': 20.0}}))
    q, p = 0.5 * np.random.default_rng(1).normal(size=(2, d + 1))
    expected = plain.gradient(q[:d], p[:d])
    for found, own, rotor in zip(driven.gradient(q, p), expected, (0.0, p[d] / 0.04), strict=True):
        assert found == pytest.approx([*own, rotor], rel=1e-12, abs=1e-12)
    with refused(ValueError):
        RigidBodyTree(robot, loops=[{}], drives={first: {'stiffness': 3.0, 'rotor_inertia': 1.0}})


def test_friction_acts_on_joints_also_under_the_load_of_their_motors(lever):
    """Add F + k abs(a) at the speed of the joint, while its rotor turns the other way."""
    coordinates = lever().create_hamiltonian().coordinates
    kind = EFFECTS['joint_friction']
    state, velocity, (f_q, f_p) = EffectState.empty(1, 2, 0), np.array([1.0, -1.0]), np.zeros((
        2, 2))
    own = kind('urdf', {'elbow': 0.3}, {'elbow': 0.2}, load={'elbow': 0.1}).resolve(
        coordinates, state)
    state.command[:] = 0.0, -2.0, 1.0  # of the rotor, and its expiry
    kind.add_force(own, 0.0, velocity, velocity, velocity, f_q, f_p)
    assert f_p == pytest.approx([-0.3 - 0.2 - 0.1 * 2.0, 0.0], rel=1e-15)


def test_position_beyond_the_limit_of_a_geared_joint_is_refused(lever):
    simulation = plain(lever('{kind: servo, coordinates: [elbow], stiffness: 5.0}, '
                             '{kind: joint_limits, upper: {elbow: 0.5}}', 'implicit_midpoint'))
    simulation.set_command(JointCommand(('elbow',), *np.array([[0.4], [0.0], [np.nan]])))
    with refused(ValueError):
        simulation.set_command(JointCommand(('elbow',), *np.array([[0.6], [0.0], [np.nan]])))


def test_guard_names_a_gear_that_steps_do_not_resolve(lever):
    omega = np.sqrt(STIFFNESS * (1.0 / ARM + 1.0 / ROTOR))
    for reach, known in ((0.9, []), (1.1, [pytest.approx(1.1)])):
        simulation = plain(lever(step=reach / omega, backlash=0.02))
        watch = Watch(RunFacts(simulation), (StiffnessGuard,))
        watch.update(look(simulation))
        assert [alarm.value for alarm in watch.alarms] == known


NUMBERS = {'stiffness': STIFFNESS, 'damping': 0.04, 'rotor_inertia': 2e-5, 'backlash': 0.02}


@pytest.mark.long
def test_derivatives_by_numbers_of_a_drive_are_differences_of_order_6(lever):
    torch = pytest.importorskip('torch', reason='torch is not installed')
    from hnn_vi_ros.torch import simulate as differentiable
    scene = lever('{kind: external_force, coordinates: [elbow]}', 'implicit_midpoint', step=0.005,
                  smoothing=0.002, **NUMBERS)
    commands = 2.0 * np.sin(0.5 * np.arange(80))[:, None]

    def last(shares: torch.Tensor) -> torch.Tensor:
        motion = differentiable(
            scene, *torch.tensor([[[0.1, 0.0]], [[0.0, 0.0]]]).double(), duration=0.4, every=1,
            commands=torch.tensor(commands), parameters={
                f'hamiltonian.drives.elbow.{name}': value * share
                for (name, value), share in zip(NUMBERS.items(), shares, strict=True)})
        return motion.q[-1].sum() + 0.3 * motion.p[-1].sum()
    ones = torch.ones(len(NUMBERS), dtype=torch.float64, requires_grad=True)
    found, = torch.autograd.grad(last(ones), ones)
    for i, one in enumerate(torch.eye(len(NUMBERS), dtype=torch.float64)):
        expected = difference(lambda k, one=one: float(last(1.0 + k * one)), 1e-3)
        # Damping is differenced by velocities to 1e-7.
        assert float(found[i]) == pytest.approx(expected, rel=1e-6, abs=1e-8), i
