# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The controller node: states that it hears, and simulators that it commands."""

import math
from pathlib import Path
import signal

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros import load_scene
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.ros.controller_node import state_of
from hnn_vi_ros.run.recorded_run import RecordedRun
from hnn_vi_ros.ros.topics.messages import encode_state
from hnn_vi_ros.run import Sampler
from hnn_vi_ros.simulation import build
from messages import assert_message, refused
import numpy as np
from peer import peer, SIMULATOR
from processes import finish, refusal, standard_error, start, start_executable, wait_until
import pytest
from rclpy.serialization import deserialize_message
from recorded import assert_agrees
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


def joints(names: list[str], position: list[float], velocity: list[float]) -> JointState:
    return JointState(name=names, position=position, velocity=velocity)


def test_state_is_that_of_joints_in_any_order_and_of_the_simulators_own_topic():
    model = load_scene('realaigym_double_pendulum').create_hamiltonian()
    q, v = state_of(joints(['gripper', 'elbow', 'shoulder'], [9.0, 2.0, 1.0], [9.0, 4.0, 3.0]),
                    model)
    assert (q.tolist(), v.tolist()) == ([1.0, 2.0], [3.0, 4.0])
    run = build(load_scene('quadrotor'))
    run.set_command([9.0, 0.1, 0.0, 0.0])
    run.advance(50)
    payload, = encode_state(run.hamiltonian.coordinates)(Sampler(run, 50.0).sample())
    q, v = state_of(deserialize_message(payload, JointState), run.hamiltonian)
    assert np.array_equal(q, run.q)
    assert np.array_equal(v, run.hamiltonian.gradient(run.q, run.p)[1]) and v[3] > 0.0


def test_state_that_cannot_be_used_is_refused_in_a_line():
    model = load_scene('motor_pendulum').create_hamiltonian()
    for message in (
            joints(['angel'], [1.0], [0.0]), joints(['angle', 'angle'], [1.0, 2.0], [0.0, 0.0]),
            joints(['angle'], [1.0, 2.0], [0.0]), joints(['angle'], [1.0], []),
            joints(['angle'], [math.nan], [0.0]), joints(['angle'], [1.0], [math.inf]),
            joints(['p_angle', 'angle'], [math.nan, 1.0], []), joints([], [], [])):
        with refused(ValueError):
            state_of(message, model)
    with refused(ValueError):
        state_of(joints(['body_x'], [0.0], [0.0]), load_scene('quadrotor').create_hamiltonian())


def commanding(folder: Path, **parameters: object):
    return start_executable('controller', '--ros-args', *(
        word for name, value in parameters.items() for word in ('-p', f'{name}:={value}')),
        folder=folder)


def test_controller_swings_up_a_pendulum_and_what_neither_can_use_changes_nothing(tmp_path):
    """In lockstep: a step is asked for when its command has come, however long that takes."""
    simulator = start(tmp_path, scene='motor_pendulum', record_path='bag')
    (tmp_path / 'task.yaml').write_text(shipped_file('task', 'swing_up').read_text().replace(
        'period:', 'silence: 1.0\nperiod:'))
    controller = commanding(tmp_path, task='task.yaml')
    with peer() as other:
        heard = other.hear(JointState, '~/joint_commands', 100)
        other.spin_until(lambda: heard and other.states)
        assert other.pause().success
        wait_until(lambda: 'no usable state for 1 s: commands are zero' in standard_error(
            controller))
        assert other.set_parameters(step_count=5, reset_time=True).successful
        assert other.trigger('reset').success
        told = other.hear(DiagnosticArray, '/diagnostics')
        hostile = other.publisher(JointState, '/joint_states', 10)
        there = 0
        for k in range(1500):
            if k == 10:
                # Older stamps come at once, which ~/scene announces.
                assert other.trigger('reset').success
            if k == 20:
                hostile.publish(joints(['angle'], [math.nan], [0.0]))
                wait_until(lambda: 'joint_states: message ignored' in standard_error(controller))
            count = len(other.states)
            assert other.trigger('step').success
            # By stamps: of two states that come together, the newer alone is answered.
            other.spin_until(lambda count=count: heard[-1].header.stamp in [
                state.header.stamp for state in other.states[count:]])
            assert heard[-1].name == ['angle'] and abs(heard[-1].effort[0]) <= 4.0
            there = there + 1 if math.cos(other.states[-1].position[0]) < -0.9999 else 0
            if there == 50:
                break
        assert there == 50
        other.spin_until(lambda: 'mode' in figures(told))
        assert float(figures(told)['plan_time_median [s]']) < 1.0
        for process in (controller, simulator):
            process.send_signal(signal.SIGINT)
            assert finish(process)[0] == 0
    # It says once per silence that it has nothing to answer; a busy machine adds some.
    error = standard_error(controller)
    assert 0 <= error.count('no usable state') - error.count('usable states again') <= 1
    bag = tmp_path / 'bag-3'
    assert_agrees(bag)
    topics = {topic for _, topic, _ in RecordedRun(bag).commands()}
    assert topics == {f'{SIMULATOR}/joint_commands'}


def figures(told: list[DiagnosticArray]) -> dict[str, str]:
    """Return what a controller tells of itself, the newest of each."""
    return {item.key: item.value for message in told for status in message.status
            if status.name == 'hnn_controller: control' for item in status.values}


@pytest.mark.long
def test_time_out_of_the_simulator_ends_the_command_of_a_controller_that_hangs_or_dies(tmp_path):
    simulator = start(tmp_path, scene='quadrotor', publish_rate=50.0)
    controller = commanding(tmp_path, task='hover', commands='commands')
    with peer() as other:
        told = other.hear(DiagnosticArray, '/diagnostics')
        heard = other.hear(Float64MultiArray, '~/commands', 100)
        other.spin_until(lambda: float(figures(told).get('commands [1]', 0)) > 10)
        assert figures(told)['mode'] == 'hover'
        assert len(heard[-1].data) == 4
        states = other.hear(JointState, '~/state', 100)

        def falls() -> bool:
            """Look at the last states: they lose momentum freely, but for the drag."""
            momenta = [dict(zip(one.name, one.position, strict=True))['p_body_z']
                       for one in states[-10:]]
            return bool((np.diff(momenta) < -0.5 * 0.8 * 9.81 / 50.0).all())

        for end in (signal.SIGSTOP, signal.SIGCONT, signal.SIGKILL):
            controller.send_signal(end)
            count = len(states)
            other.spin_until(lambda count=count: len(states) > count + 30)
            assert falls() == (end != signal.SIGCONT)
        simulator.send_signal(signal.SIGINT)
        assert finish(simulator)[0] == 0


def test_controller_that_cannot_begin_says_why_in_one_line():
    # The last at a line of the file of the shipped task.
    for parameter in ('task:=swing_upp', 'simulator:=not a name', 'commands:=torques',
                      'scene:=kepler'):
        assert_message(refusal('controller', '--ros-args', '-p', parameter))
