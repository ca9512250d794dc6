# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes whose time is that of /clock, and times there that cannot be."""

from pathlib import Path
import signal

from hnn_vi_ros.ros.replay.replay_check import check_replay
from peer import peer, SIMULATOR
from processes import finish, standard_error, start, start_executable
import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

# Seconds and nanoseconds of times that are none, and of some that jump forth and back.
NONE = ((-1, 0), (-2**31, 0), (-1, 4 * 10**9), (0, 10**9), (2**31 - 1, 2**32 - 1), (5, 2**32 - 1))
JUMPS = ((7, 0), (2**31 - 1, 999_999_999), (0, 0), (2**31 - 1, 0), (1, 5), (1_700_000_000, 0))
TWIN = """\
hamiltonian: {kind: pendulum}
effects: [{kind: observer, coordinates: [angle], gain: 5.0, damping: 4.0}]
integrator: {kind: implicit_midpoint}
step_size: 0.01
initial_state: {q: [0.3], p: [0.0]}
"""


def tell(publisher: Publisher, seconds: int, nanoseconds: int) -> None:
    message = Clock()
    message.clock.sec, message.clock.nanosec = seconds, nanoseconds
    publisher.publish(message)


def executable_of(name: str, folder: Path) -> list[object]:
    """Return the words that start a node which goes on until it is stopped."""
    if name != 'replay':
        return [name] + ['--ros-args', '-p', 'rerun_sink:=file', '-p', 'rerun_path:=run.rrd'] * (
            name == 'rerun_bridge')
    process = start(folder, scene='exact_pendulum', record_path='bag', duration=1.0,
                    rerun_sink='none', real_time_factor=0.0)
    assert finish(process)[0] == 0
    return [name, folder / 'bag', '--loop']


@pytest.mark.parametrize('name', ['hover', 'listener', 'replay', 'rerun_bridge'])
def test_time_that_cannot_be_is_told_and_ends_no_node(tmp_path: Path, name: str):
    words = executable_of(name, tmp_path)
    process = start_executable(*words, *['--ros-args'] * ('--ros-args' not in words), '-p',
                               'use_sim_time:=true', folder=tmp_path)
    with peer() as other:
        clock = other.node.create_publisher(Clock, '/clock', qos_profile_sensor_data)
        other.spin_until(clock.get_subscription_count)
        survives(other, clock, f'hnn_{name}')
        assert standard_error(process).count('/clock: message ignored') >= 1
        process.send_signal(signal.SIGINT)
        status, _, error = finish(process)
    assert status == 0 and 'Traceback' not in error


def survives(other, clock: Publisher, node: str) -> None:
    """Assert that a node answers after each of many times."""
    asked = other.node.create_client(GetParameters, f'/{node}/get_parameters')
    changed = other.node.create_client(SetParameters, f'/{node}/set_parameters')
    other.spin_until(lambda: asked.service_is_ready() and changed.service_is_ready())
    for at in (*NONE, *JUMPS, *NONE):
        tell(clock, *at)
        other.spin(0.1)
        future = asked.call_async(GetParameters.Request(names=['use_sim_time']))
        other.spin_until(future.done, 30.0)
        assert future.result().values[0].bool_value, at
    # Whose event is stamped by the time of the node.
    for value in (False, True):
        request = SetParameters.Request(parameters=[
            Parameter('use_sim_time', value=value).to_parameter_msg()])
        future = changed.call_async(request)
        other.spin_until(future.done, 30.0)
        assert future.result().results[0].successful
    tell(clock, -5, 0)
    other.spin(0.1)


def test_twin_goes_on_whatever_the_clock_says(tmp_path: Path):
    (tmp_path / 'scene.yaml').write_text(TWIN)
    process = start(tmp_path, scene='scene.yaml', record_path='bag', rerun_sink='none',
                    use_sim_time=True)
    with peer() as other:
        clock = other.node.create_publisher(Clock, '/clock', qos_profile_sensor_data)
        machine = other.node.create_publisher(
            JointState, f'{SIMULATOR}/observations', qos_profile_sensor_data)
        errors: list[JointState] = []
        other.node.create_subscription(
            JointState, f'{SIMULATOR}/prediction_error', errors.append, 10)
        other.spin_until(lambda: other.states and clock.get_subscription_count()
                         and machine.get_subscription_count())
        survives(other, clock, SIMULATOR[1:])
        count = len(errors)
        machine.publish(JointState(name=['angle'], position=[0.2]))
        other.spin_until(lambda: len(errors) > count)
        seen = len(other.states)
        other.spin_until(lambda: len(other.states) > seen + 10)
        process.send_signal(signal.SIGINT)
        status, _, error = finish(process)
    assert status == 0 and '/clock: message ignored' in error
    verdict = check_replay(tmp_path / 'bag')
    assert verdict.good, verdict.text
