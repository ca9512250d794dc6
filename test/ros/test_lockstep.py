# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller in lockstep: the same run, however fast both are."""

import multiprocessing
from pathlib import Path
import signal
import time
from types import SimpleNamespace

from bag_content import content_of
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros.run.lockstep import Lockstep
from hnn_vi_ros.ros.settings import Settings
from messages import refused
from peer import peer, simulating
from processes import finish, standard_error, start, start_executable, wait_until
import pytest
from recorded import assert_agrees
from sensor_msgs.msg import JointState

GIVEN = {'scene': 'motor_pendulum', 'lockstep': True, 'real_time_factor': 0}
# Longer than the silence after which a controller sends zeros, without lockstep [s].
STALL = 0.5


def burn() -> None:
    while True:
        pass


def controlled_run(folder: Path, name: str, stalls: int) -> list[tuple[str, int, bytes]]:
    """Return the messages of a run that a controller swings up in lockstep."""
    controller = start_executable(
        'controller', '--ros-args', '-p', 'task:=swing_up', '-p', 'lockstep:=true')
    wait_until(lambda: 'inactive -> active' in standard_error(controller))
    # Four of five samples are between two plans of the controller.
    simulator = start(folder, record_path=name, duration=1.0, publish_rate=500.0, **GIVEN)
    wait_until(lambda: 'inactive -> active' in standard_error(simulator))
    for _ in range(stalls):
        time.sleep(0.1)
        simulator.send_signal(signal.SIGSTOP)
        time.sleep(STALL)
        simulator.send_signal(signal.SIGCONT)
    status, _, error = finish(simulator)
    assert status == 0, error
    controller.send_signal(signal.SIGINT)
    assert finish(controller)[0] == 0
    assert_agrees(folder / name, 500)
    # Diagnostics hold wall times.
    return [message for message in content_of(folder / name) if message[0] != '/diagnostics']


def test_runs_in_lockstep_are_equal_message_by_message_also_on_a_busy_machine(tmp_path):
    first = controlled_run(tmp_path, 'idle', 0)
    busy = [multiprocessing.Process(target=burn, daemon=True) for _ in range(3)]
    for process in busy:
        process.start()
    try:
        again = controlled_run(tmp_path, 'busy', 3)
    finally:
        for process in busy:
            process.kill()
    assert sum(topic == '/hnn_simulator/joint_commands' for topic, _, _ in first) == 499
    assert again == first


def test_run_in_lockstep_waits_for_a_late_controller_and_can_be_paused_and_reset(tmp_path):
    with simulating(tmp_path, record=False, **GIVEN) as (other, _):
        commands = other.publisher(JointState, '~/joint_commands')
        heard = other.hear(JointState, 'joint_states')
        # The awaited state is repeated for subscribers that come later.
        other.spin_until(lambda: len(heard) > 2 and commands.get_subscription_count())
        assert len({(one.header.stamp.sec, one.header.stamp.nanosec) for one in heard}) == 1
        for _ in range(3):
            before = heard[-1]
            answer = JointState(header=before.header, name=['angle'], effort=[0.1])
            commands.publish(answer)
            other.spin_until(lambda: heard[-1].header.stamp != before.header.stamp)
            # An answer to an earlier state is none.
            commands.publish(answer)
        assert other.trigger('reset').success
        other.spin_until(lambda: heard[-1].header.stamp.nanosec == 10_000_000 or len(heard) > 20)


@pytest.mark.parametrize(('policy', 'status', 'word'), [
    ('stop', 1, 'stopped: lockstep: no command on ~/joint_commands with the stamp 0.02 s within'),
    ('hold', 0, 'with the stamp 0.03 s within 0.1 s; the last command is held')])
def test_wait_after_the_first_command_that_is_too_long_ends_the_run_or_is_warned_of(
        tmp_path, policy, status, word):
    process = start(tmp_path, duration=0.05, lockstep_timeout=0.1, on_lockstep_timeout=policy,
                    record=False, rerun_sink='none', **GIVEN)
    with peer() as other:
        commands = other.publisher(JointState, '~/joint_commands')
        heard = other.hear(JointState, 'joint_states')
        # Repeated once a second: the wait for the first command is longer than the limit.
        other.spin_until(lambda: len(heard) > 2 and commands.get_subscription_count())
        assert {one.header.stamp.nanosec for one in heard} == {10_000_000}
        commands.publish(JointState(header=heard[-1].header, name=['angle'], effort=[0.1]))
        found, _, error = finish(process)
    assert 'lockstep: waiting for the first command on ~/joint_commands' in error
    assert found == status and word in error


def test_controller_that_dies_ends_the_wait_with_a_line(tmp_path):
    process = start(tmp_path, duration=0.05, record=False, rerun_sink='none', **GIVEN)
    with peer() as other:
        commands = other.publisher(JointState, '~/joint_commands')
        heard = other.hear(JointState, 'joint_states')
        other.spin_until(lambda: heard and commands.get_subscription_count())
        commands.publish(JointState(header=heard[-1].header, name=['angle'], effort=[0.1]))
        other.spin_until(lambda: heard[-1].header.stamp.nanosec == 20_000_000)
    # Sooner than the 60 s of lockstep_timeout.
    found, _, error = finish(process)
    assert found == 1 and ('stopped: lockstep: no command on ~/joint_commands with the stamp '
                           '0.02 s: its publisher is gone') in error


@pytest.mark.parametrize(('name', 'word'), [
    ('lockstep', 'takes no commands'), ('publish_loop_forces', 'has no loops')])
def test_scene_without_joint_commands_or_loops_has_no_use_for_them(tmp_path, name, word):
    status, _, error = finish(start(
        tmp_path, scene='exact_pendulum', record=False, rerun_sink='none', **{name: True}))
    assert status == 1 and f'parameter {name}: the scene {word}' in error


def test_period_of_lockstep_is_a_whole_number_of_samples():
    assert Lockstep(Settings(lockstep_period=0.03), 10, 0.001).awaited is None
    lockstep = Lockstep(Settings(lockstep_period=0.02), 10, 0.001)
    lockstep.observe(SimpleNamespace(step=10, stamp=5), False)
    assert lockstep.awaited is None
    lockstep.observe(SimpleNamespace(step=20, stamp=7), False)
    assert lockstep.awaited == 7
    assert lockstep.take(7)
    for stamp, awaited in ((6, 7), (7, None)):
        lockstep.awaited = awaited
        with refused(ValueError):
            lockstep.take(stamp)
    # A repeated state may be answered twice, and the last one or not.
    lockstep.repeated = 7
    assert lockstep.take(7) is None
    lockstep.observe(SimpleNamespace(step=40, stamp=9), True)
    assert lockstep.awaited is None and lockstep.take(9) is None
    for period in (0.004, 0.025):
        with refused(ParameterError):
            Lockstep(Settings(lockstep_period=period), 10, 0.001)


def test_period_without_lockstep_is_refused(tmp_path):
    status, _, error = finish(start(
        tmp_path, scene='motor_pendulum', lockstep_period=0.02, duration=0.03, record=False,
        rerun_sink='none'))
    assert status == 1 and 'parameter lockstep_period: has no effect without lockstep' in error
