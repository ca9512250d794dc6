# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Wrenches on links of robots against Pinocchio's J^T F, their time-out, and their errors."""

from helpers import plain_run
from hnn_vi_ros.effects import EffectError, EFFECTS, LinkWrench
from hnn_vi_ros.hamiltonians import fill_frames, RigidBodyTree
from messages import refused
import numpy as np
import pytest
from urdf_robots import SHIPPED

ARM, SEVEN, GRIPPER = (
    next(str(path) for path in SHIPPED if path.stem == stem)
    for stem in ('six_joint_arm', 'seven_joint_arm', 'gripper'))
FORCE, TORQUE = [3.0, -2.0, 5.0], [0.3, 0.7, -0.4]


def pushed(file=ARM, h=0.01, timeout=0.0495, **arguments):
    robot = RigidBodyTree(file, **arguments)
    q, p = np.random.default_rng(3).normal(size=(2, robot.dimension))
    return plain_run(robot, 'rk4', h, q, 0.01 * p, EFFECTS['link_wrench'](timeout))


def force_of(simulation, frame):
    """Return the generalised force of the wrench in a frame."""
    simulation.set_command(LinkWrench(frame, FORCE, TORQUE))
    return simulation.motors.forces(0.0, simulation.q, simulation.p, simulation.dH_dp)


@pytest.mark.parametrize('file, link, arguments', [
    (ARM, 'tool', {}), (ARM, 'forearm', {'joints': [
        'elbow', 'wrist_3', 'shoulder_pan', 'wrist_1', 'wrist_2', 'shoulder_lift']}),
    (SEVEN, 'flange', {})], ids=['tool', 'forearm, other order', 'seven joints'])
@pytest.mark.parametrize('own', [True, False], ids=['own axes', 'axes of the base'])
def test_wrench_on_a_link_is_that_of_pinocchio(file, link, arguments, own):
    pinocchio = pytest.importorskip('pinocchio', reason='pin is not installed; see `make test`')
    simulation = pushed(file, **arguments)
    model = pinocchio.buildModelFromUrdf(file)
    data, q = model.createData(), np.empty(model.nq)
    places = [model.joints[model.getJointId(joint.name)].idx_q
              for joint in simulation.hamiltonian.joints]
    q[places] = simulation.q
    pinocchio.computeJointJacobians(model, data, q)
    pinocchio.updateFramePlacements(model, data)
    jacobian = pinocchio.getFrameJacobian(
        model, data, model.getFrameId(link),
        pinocchio.LOCAL if own else pinocchio.LOCAL_WORLD_ALIGNED)
    expected = (jacobian.T @ [*FORCE, *TORQUE])[places]
    base = simulation.hamiltonian.base_link
    # Rounding of sums of some ten terms of size 10.
    assert force_of(simulation, link if own else f'{base}/{link}') == pytest.approx(
        expected, abs=1e-13)


def test_wrench_on_a_follower_moves_its_leader():
    simulation, h = pushed(GRIPPER), 1e-6
    tip = simulation.hamiltonian

    def power(q):
        """Return F . x of the origin of the tip, whose derivative is J^T F without torques."""
        work = EFFECTS['link_wrench'](1.0).resolve_on(tip, simulation.system.effect_state)
        joints = work.following.multiplier * q[work.following.leader] + work.following.offset
        fill_frames(work.bodies, work.work, joints, 0)
        row, _, origin = tip.links['left_tip']
        point = work.work.rotation[row].reshape(3, 3) @ origin
        while row:
            point, row = point + work.work.offset[row], work.bodies.parent[row]
        return point @ FORCE
    simulation.set_command(LinkWrench('palm/left_tip', FORCE, [0.0] * 3))
    force = simulation.motors.forces(0.0, simulation.q, simulation.p, simulation.dH_dp)
    for i, unit in enumerate(h * np.eye(len(simulation.q))):
        slope = (power(simulation.q + unit) - power(simulation.q - unit)) / (2.0 * h)
        # Rounding of a difference of sums of size 1.
        assert force[i] == pytest.approx(slope, abs=1e-8)
    assert np.abs(force).max() > 0.01


def test_wrench_ends_after_its_timeout_and_its_work_is_the_change_of_the_energy():
    simulation = pushed(h=0.001)
    force_of(simulation, 'tool')
    saved = simulation.snapshot()
    simulation.advance(50)
    assert not simulation.motors.forces(
        0.0, simulation.q, simulation.p, simulation.dH_dp).any()
    work = simulation.works['link_wrench']
    simulation.advance(50)
    assert simulation.works['link_wrench'] == work != 0.0
    # The error of order 4.
    assert abs(simulation.energy_balance) < 1e-6 * abs(work)
    end = simulation.snapshot()
    simulation.restore(saved)
    simulation.advance(100)
    assert all((end[name] == other).all() for name, other in simulation.snapshot().items())
    force_of(simulation, 'tool')
    simulation.restart(simulation.q, simulation.p)
    simulation.advance(10)
    assert simulation.works == {'link_wrench': 0.0}


@pytest.mark.parametrize('command', [
    LinkWrench('base', FORCE, TORQUE), LinkWrench('hand', FORCE, TORQUE),
    LinkWrench('tool', [1.0, float('nan'), 0.0], TORQUE), LinkWrench('tool', FORCE[:2], TORQUE),
    LinkWrench('tool', 'xyz', TORQUE), LinkWrench('tool', FORCE, None),
    LinkWrench(3, FORCE, TORQUE), [1.0]])
def test_wrenches_that_cannot_act_are_refused(command):
    with refused(ValueError):
        pushed().set_command(command)


def test_wrench_needs_a_robot():
    with refused(EffectError):
        plain_run('pendulum', 'rk4', 0.01, [0.0], [0.0], EFFECTS['link_wrench']())
