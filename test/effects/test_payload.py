# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Payloads of robots, their changes during a run, and the compensation of gravity."""

from helpers import plain_run, Uncompiled
from hnn_vi_ros.effects import EFFECTS, JointCommand
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS, payload_of, RigidBodyTree
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import DifferentiableRun, Simulation
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from urdf_robots import SHIPPED

ARM = next(str(path) for path in SHIPPED if path.stem == 'six_joint_arm')
SMALL, GRIPPER = (next(str(path) for path in SHIPPED if path.stem == stem)
                  for stem in ('two_joint_arm', 'gripper'))
ROTORS = {'shoulder_pan': 0.5, 'shoulder_lift': 0.5, 'elbow': 0.3, 'wrist_1': 0.05,
          'wrist_2': 0.05, 'wrist_3': 0.02}
START = np.array([0.2, 0.3, 0.6, 0.1, 0.4, 0.0])
LOAD = {'link': 'flange', 'mass': 1.5, 'centre': [0.02, -0.03, 0.08],
        'inertia': [0.004, 0.0002, 0.0, 0.005, -0.0003, 0.003]}


def arm(payload=None, **more) -> RigidBodyTree:
    return RigidBodyTree(ARM, rotor_inertia=ROTORS, payload=payload, **more)


def held(robot, kind='external_force', integrator='gauss8', h=0.002, p=0.0, **arguments
         ) -> Simulation:
    """Return an arm whose motors bear its weight."""
    names = [joint.name for joint in robot.joints]
    q = np.resize(START, robot.dimension)
    return plain_run(robot, integrator, h, q, np.full(robot.dimension, p), EFFECTS[kind](
        coordinates=names, **{'gravity_compensation': 'model', **arguments}))


@pytest.mark.parametrize('robot, arguments', [
    (arm(), {}), (arm(LOAD), {}), (arm(), {'gravity_compensation': 'urdf', 'file': ARM}),
    (RigidBodyTree(SMALL), {})], ids=['arm', 'payload', 'urdf', 'small'])
def test_torque_arm_with_gravity_compensation_does_not_move_in_100_s(robot, arguments):
    simulation = held(robot, integrator='generalized_leapfrog', **arguments)
    before = simulation.q.copy()
    simulation.advance(50_000)
    # V' of the same numbers cancels to the last bit, but of others in rounding.
    assert np.abs(simulation.q - before).max() < 1e-6


@pytest.mark.parametrize('kind', ['unloaded', 'urdf'])
def test_arm_with_a_payload_unknown_to_gravity_compensation_sags_as_the_reference(kind):
    pinocchio = pytest.importorskip('pinocchio', reason='pin is not installed; see `make test`')
    simulation = held(arm(LOAD), gravity_compensation=kind, file=ARM if kind == 'urdf' else None)
    bare = pinocchio.buildModelFromUrdf(ARM)
    bare.armature = np.array([*ROTORS.values()])
    loaded, moments = bare.copy(), np.zeros((3, 3))
    moments[np.triu_indices(3)] = LOAD['inertia']
    frame = loaded.frames[loaded.getFrameId('flange')]
    inertia = pinocchio.Inertia(LOAD['mass'], np.array(LOAD['centre']),
                                moments + np.triu(moments, 1).T)
    loaded.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    own, other = bare.createData(), loaded.createData()

    def rates(t, z):
        q, v = np.split(z, 2)
        bearing = pinocchio.computeGeneralizedGravity(bare, own, q)
        return np.append(v, pinocchio.aba(loaded, other, q, v, bearing))
    found = solve_ivp(rates, (0.0, 0.5), np.append(START, np.zeros(6)), method='DOP853',
                      rtol=1e-12, atol=1e-12)
    simulation.advance(250)
    assert np.abs(found.y[:6, -1] - START).max() > 0.1
    # Both methods err by less than 1e-11 of a radian.
    assert np.abs(simulation.q - found.y[:6, -1]).max() < 1e-9


def test_servo_with_gravity_compensation_stays_at_its_position():
    simulation = held(arm(LOAD), 'servo', stiffness=20.0, damping=1.0, position=START.tolist())
    assert simulation.motors.servo_target is not None
    simulation.advance(500)
    assert np.abs(simulation.q - START).max() < 1e-12
    # Within its limit, it sags.
    weak = held(arm(LOAD), 'servo', stiffness=20.0, position=START.tolist(), effort_limit=0.1)
    weak.advance(100)
    assert np.abs(weak.q - START).max() > 1e-3


def test_compensation_bears_the_joints_behind_elastic_gears():
    drives = {'elbow': {'stiffness': 400.0, 'rotor_inertia': 0.1}}
    simulation = held(arm(drives=drives))
    forces = simulation.motors.forces(0.0, simulation.q, simulation.p, simulation.dH_dp)
    rigid = arm().gradient(START, np.zeros(6))[0]
    # The motor of the elbow bears what the joint weighs.
    assert forces[:2] == pytest.approx(rigid[:2], abs=1e-12)
    assert (forces[2], forces[6]) == (0.0, pytest.approx(rigid[2], abs=1e-12))


@pytest.mark.parametrize('file, link', [
    (ARM, 'flange'), (SMALL, 'forearm'), (GRIPPER, 'left_tip')])
def test_payload_is_a_link_of_the_same_numbers_in_the_urdf(file, link, tmp_path):
    base, rng = RigidBodyTree(file), np.random.default_rng(2)
    load = LOAD | {'link': link}
    xx, xy, xz, yy, yz, zz = load['inertia']
    x, y, z = load['centre']
    text = base.robot.text.replace('</robot>', f"""<link name="load"><inertial>
      <origin xyz="{x} {y} {z}"/><mass value="{load['mass']}"/><inertia ixx="{xx}" ixy="{xy}"
      ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial></link>
      <joint name="grip" type="fixed"><parent link="{link}"/><child link="load"/></joint>
      </robot>""")
    (tmp_path / 'loaded.urdf').write_text(text)
    expected, own = RigidBodyTree(str(tmp_path / 'loaded.urdf')), RigidBodyTree(file, payload=load)
    q, p = rng.normal(size=(2, base.dimension))
    # Rounding of sums of ten terms.
    assert own.energy(q, p) == pytest.approx(expected.energy(q, p), rel=1e-13)
    np.testing.assert_allclose(own.gradient(q, p), expected.gradient(q, p), rtol=1e-11, atol=1e-12)
    assert abs(own.energy(q, p) - base.energy(q, p)) > 0.1


@pytest.mark.parametrize('integrator, error', [
    # Measured 1.5e-4 J at order 2, and with the others, of order 4 and 8, below 1e-6 J.
    ('generalized_leapfrog', 1e-3), ('gauss4', 1e-5), ('dop853', 1e-5), ('rk4', 1e-5)])
def test_payload_changes_at_constant_velocity_and_its_work_is_the_jump_of_the_energy(
        integrator, error):
    simulation = plain_run(arm({'link': 'flange'}), integrator, 0.002, START, np.full(6, 0.3),
                           EFFECTS['external_force']([*ROTORS], gravity_compensation='model'))
    simulation.advance(100)
    velocity, q, energy = simulation.dH_dp.copy(), simulation.q.copy(), simulation.energy
    simulation.set_command(payload_of(LOAD))
    np.testing.assert_allclose(simulation.dH_dp, velocity, rtol=1e-12)
    assert (simulation.q == q).all()
    jump = arm(LOAD).energy(q, simulation.p) - energy
    assert simulation.works['payload'] == pytest.approx(jump, rel=1e-12) != 0.0
    saved = simulation.snapshot()
    simulation.advance(100)
    # Gravity is borne with the payload too, and the account closes within the method's error.
    assert abs(simulation.energy_balance) < error
    end, now = simulation.snapshot(), simulation.q.copy()
    simulation.restore(saved)
    simulation.advance(100)
    assert all((end[name] == other).all() for name, other in simulation.snapshot().items())
    # From the state alone, with the payload from the start.
    other = plain_run(arm(LOAD), integrator, 0.002, saved['point.q'][:6], saved['point.p'][:6],
                      EFFECTS['external_force']([*ROTORS], gravity_compensation='model'))
    other.advance(100)
    assert np.abs(other.q - now).max() < 1e-6
    simulation.restart(START, np.zeros(6))
    assert simulation.energy == arm({'link': 'flange'}).energy(START, np.zeros(6))
    assert simulation.works == {'external_force': 0.0, 'payload': 0.0}


def test_copies_of_a_robot_have_payloads_of_their_own():
    first = arm(LOAD)
    other, q = first.copy(), np.zeros(6)
    other.change_payload(first.payload_numbers(payload_of({'link': 'flange', 'mass': 9.0})))
    assert first.energy(START, q) == arm(LOAD).energy(START, q) != other.energy(START, q)
    joined = plain_run(other, 'gauss4', 0.01, START, q, EFFECTS['gravity']('elbow'))
    assert joined.snapshot()['payload.inertia'].shape == (7, 10)


@pytest.mark.parametrize('payload', [
    {'link': 'base'}, {'link': 'flange', 'mass': -1.0}, {'mass': 1.0},
    {'link': 'flange', 'inertia': [1.0, 0.0, 0.0, 1.0, 0.0, 1.0]},
    {'link': 'flange', 'mass': 1.0, 'centre': [1e300, 0.0, 0.0]},
    {'link': 'flange', 'mass': 1.0, 'inertia': [1e308, 0.0, 0.0, 1e308, 0.0, 1e308]},
    {'link': 'flange', 'mass': 1.0, 'inertia': [1.0, 0.0, 0.0, 0.1, 0.0, 0.1]}])
def test_impossible_payloads_are_refused(payload):
    with refused(ValueError):
        arm(payload)


@pytest.mark.parametrize('payload', [
    {'link': 'tool', 'mass': 1.0},
    {'link': 'flange', 'mass': 1.0, 'inertia': [1.0, 0.0, 0.0, 0.1, 0.0, 0.1]},
    # No momentum is finite with it.
    {'link': 'flange', 'mass': 1e6, 'centre': [1e6, 0.0, 0.0]}])
def test_impossible_changes_of_the_payload_change_nothing(payload):
    simulation = held(arm(LOAD), p=0.2)
    before = simulation.snapshot()
    with refused(ValueError):
        simulation.set_command(payload_of(payload))
    assert all((before[name] == other).all() for name, other in simulation.snapshot().items())


def test_robot_without_a_payload_takes_none():
    with refused(ValueError):
        held(arm()).set_command(payload_of(LOAD))


@pytest.mark.parametrize('arguments', [
    {'gravity_compensation': 'urdf'}, {'gravity_compensation': 'model', 'file': ARM},
    {'gravity_compensation': 'model', 'coordinates': None, 'model': 'x.safetensors'}])
def test_options_of_gravity_compensation_that_contradict_each_other_are_refused(arguments):
    with refused(ValueError):
        EFFECTS['external_force'](**{'coordinates': ['elbow'], **arguments})


@pytest.mark.parametrize('kind', ['model', 'unloaded'])
def test_gravity_compensation_of_other_systems(kind):
    force = EFFECTS['external_force'](['angle'], gravity_compensation=kind)
    if kind == 'model':
        simulation = plain_run(Uncompiled(HAMILTONIANS['pendulum']()), 'gauss4', 0.01, [0.7],
                               [0.0], force)
        simulation.advance(100)
        assert simulation.q.tolist() == [0.7]
        return
    with refused(ValueError):
        plain_run(Uncompiled(HAMILTONIANS['pendulum']()), 'gauss4', 0.01, [0.7], [0.0], force)


def test_derivatives_of_compensated_runs_are_refused():
    force = EFFECTS['external_force']([*ROTORS], gravity_compensation='model')
    with refused(UnsupportedSystem):
        DifferentiableRun(arm(), INTEGRATORS['generalized_leapfrog'](), 0.01, [force])


def test_path_of_a_joint_command_moves_a_compensated_servo():
    simulation = held(arm(), 'servo', stiffness=900.0, damping=60.0, position=START.tolist())
    wanted = START + 0.1
    simulation.set_command(JointCommand([*ROTORS], wanted, np.full(6, np.nan), np.full(6, np.nan)))
    simulation.advance(3000)
    # Without an error at rest: gravity needs no deviation.
    assert np.abs(simulation.q - wanted).max() < 1e-3
