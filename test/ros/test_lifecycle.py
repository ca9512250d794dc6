# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle of the simulator, over its services: allowed, illegal and failing transitions."""

from pathlib import Path
import signal
import sys
import threading
from types import SimpleNamespace

from hnn_vi_ros.ros.plumbing.graph import THREAD_TURN
from hnn_vi_ros.ros.plumbing.managed_node import ManagedNode
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions
from peer import (
    ACTIVATE, ACTIVE_SHUTDOWN, CLEANUP, CONFIGURE, DEACTIVATE, INACTIVE_SHUTDOWN, peer, simulating,
    SIMULATOR, stamp, UNCONFIGURED_SHUTDOWN)
from processes import finish, read_bag, standard_error, start, wait_until
import pytest
from scene_files import write_scene

# A kernel that is compiled anew in each process: nothing of it is on disk.
SLOW_MODULE = """\
import time

from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator


def create():
    until = time.monotonic() + 6.0
    while time.monotonic() < until:     # keeps the interpreter, as a compilation does
        sum(range(1000))
    return HarmonicOscillator()
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working directory with a scene that is slow to configure."""
    write_scene(tmp_path / 'slow.yaml', "python, factory: 'slow:create'")
    (tmp_path / 'slow.py').write_text(SLOW_MODULE)
    return tmp_path


def test_lifecycle_goes_round_twice_and_refuses_what_is_illegal(folder):
    process = start(folder, autostart='false', record_path='bag')
    with peer() as other:
        assert other.state == 'unconfigured'
        for illegal in (ACTIVATE, DEACTIVATE, CLEANUP, INACTIVE_SHUTDOWN, ACTIVE_SHUTDOWN,
                        0, 8, 10, 30, 50, 60, 99, 255):
            assert not other.change_state(illegal)
        # Nothing is there before it is configured.
        assert f'{SIMULATOR}/q' not in other.topics_of()[0]
        assert not other.trigger('step').success and not other.trigger('reset').success
        assert 'not configured' in other.trigger('start_recording').message
        for cycle in (1, 2):
            assert other.change_state(CONFIGURE) and other.state == 'inactive'
            assert not other.change_state(CONFIGURE)
            other.states.clear()
            other.spin(0.1)
            assert not other.states
            assert other.change_state(ACTIVATE) and other.state == 'active'
            assert not other.change_state(CLEANUP)
            other.spin_until(lambda: len(other.states) > 20)
            # The state stands still while it is not active, and goes on from there.
            assert other.change_state(DEACTIVATE) and other.state == 'inactive'
            other.spin(0.1)
            last = other.states[-1]
            other.spin(0.3)
            assert other.states[-1] is last
            assert other.change_state(ACTIVATE)
            other.spin_until(lambda: other.states[-1] is not last)
            index = next(i for i, state in enumerate(other.states) if state is last)
            assert stamp(other.states[index + 1]) == stamp(last) + 10_000_000
            assert other.change_state(DEACTIVATE)
            assert other.change_state(CLEANUP) and other.state == 'unconfigured'
            # The files are closed, and each configuration has its own.
            bag = folder / 'bag'
            assert (bag / 'metadata.yaml').exists()
            assert len(read_bag(bag)['/hnn_simulator/q']) > 20
            bag.rename(folder / f'bag_of_cycle_{cycle}')
            wait_until(lambda: not other.node.count_publishers('/joint_states'))
        assert other.change_state(UNCONFIGURED_SHUTDOWN)
    status, _, error = finish(process)
    assert status == 0
    assert 'rejected: the node is' in error and 'shut down' in error


@pytest.mark.parametrize('transition, first', [
    (INACTIVE_SHUTDOWN, [CONFIGURE]), (ACTIVE_SHUTDOWN, [CONFIGURE, ACTIVATE])])
def test_shutdown_closes_the_files_and_ends_the_process(folder, transition, first):
    process = start(folder, autostart='false', record_path='bag')
    with peer() as other:
        for step in (*first, transition):
            assert other.change_state(step)
        assert finish(process)[0] == 0
    assert (folder / 'bag' / 'metadata.yaml').exists()


def test_lifecycle_services_by_label_and_lists_answer(folder):
    with simulating(folder) as (other, _):
        other.wait_for_state('active')
        assert len(other.call(GetAvailableStates, 'get_available_states').available_states) == 11
        names = {found.transition.label for found in other.call(
            GetAvailableTransitions, 'get_available_transitions').available_transitions}
        assert names == {'deactivate', 'shutdown'}
        graph = other.call(GetAvailableTransitions, 'get_transition_graph')
        assert len(graph.available_transitions) > 20
        for label, expected in (('configure', False), ('x' * 10_000, False), ('', False),
                                ('transition_error', False), ('deactivate', True)):
            request = ChangeState.Request()
            request.transition.label = label
            assert other.call(ChangeState, 'change_state',
                              transition=request.transition).success is expected
        assert other.state == 'inactive'


def test_configuration_that_fails_is_one_line_and_leaves_the_node_unconfigured(folder):
    process = start(folder, scene='nothing', autostart='false')
    with peer() as other:
        assert not other.change_state(CONFIGURE)
        assert other.state == 'unconfigured'
        # Also one that fails late, with topics and a compiled kernel.
        assert other.set_parameters(scene='exact_harmonic_oscillator', duration=0.001).successful
        assert not other.change_state(CONFIGURE)
        assert other.state == 'unconfigured'
        assert other.node.count_publishers('/joint_states') == 0
        # Nor does another node read a file in what is said of it, or get the node stuck.
        (folder / 'private.yaml').write_text('password: hunter2\n')
        for values in ({'scene': str(folder / 'private.yaml'), 'duration': 0.0},
                       {'scene': 'exact_harmonic_oscillator', 'record': True,
                        'record_path': 'a/' * 1000}):
            assert other.set_parameters(**values).successful
            assert not other.change_state(CONFIGURE) and other.state == 'unconfigured'
        assert other.set_parameters(record=False).successful
        assert other.change_state(CONFIGURE) and other.change_state(ACTIVATE)
        other.spin_until(lambda: other.states)
        process.send_signal(signal.SIGTERM)
        status, _, error = finish(process)
    assert status == 0
    lines = [line for line in error.splitlines() if '[ERROR]' in line]
    assert len(lines) == 4 and 'no scene' in lines[0] and 'duration' in lines[1]
    assert 'nothing of it is quoted' in lines[2] and 'too many folders' in lines[3]
    assert 'hunter2' not in error and 'password' not in error


def test_services_answer_while_the_node_configures_and_autostart_says_how_far_it_is(folder):
    with simulating(folder, scene='slow.yaml') as (other, process):
        other.wait_for_state('configuring')
        rounds = 0
        while other.state == 'configuring':
            # Neither a transition nor a parameter of the scene can be changed meanwhile.
            assert not other.change_state(CONFIGURE) and not other.change_state(10)
            assert not other.set_parameters(scene='kepler').successful
            assert other.set_parameters(step_count=7).successful
            rounds += 1
            refused = [*map(other.trigger, ('start_recording', 'stop_recording', 'step', 'reset')),
                       other.pause()]
            if other.state == 'configuring':
                assert not any(answer.success for answer in refused)
                assert all(answer.message.startswith('configuring: ') for answer in refused)
            other.spin(0.1)
        # Again and again, although another thread holds the interpreter for 5 ms at a time.
        assert rounds > 1
        other.wait_for_state('active')
        assert other.get_parameter('step_count') == 7
    assert 'configuring: ' in standard_error(process)


def test_signal_while_the_node_configures_ends_it_before_it_is_configured(folder):
    (folder / 'slow.py').write_text(SLOW_MODULE.replace('6.0', '600.0'))
    with simulating(folder, scene='slow.yaml') as (other, process):
        other.wait_for_state('configuring')
    error = standard_error(process)
    assert 'stopped by SIGINT' in error


def test_threads_that_overlap_leave_the_interpreter_as_they_found_it():
    node = SimpleNamespace(spinner=SimpleNamespace(wake=lambda: None), _threads=[],
                           _turn=sys.getswitchinterval())
    gate = threading.Event()
    first, second = (ManagedNode.in_thread(node, gate.wait) for _ in range(2))
    try:
        # The second one begins while the first one is at work, and ends after it.
        for work in (first, second):
            work.send(None)
        assert sys.getswitchinterval() == pytest.approx(THREAD_TURN)
        gate.set()
        for work in (first, second):
            with pytest.raises(StopIteration):
                while True:
                    work.send(None)
        assert sys.getswitchinterval() == node._turn
    finally:
        sys.setswitchinterval(node._turn)
