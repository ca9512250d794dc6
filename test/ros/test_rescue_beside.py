# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A step that fails while what takes such steps is still being compiled: the node answers."""

from pathlib import Path
import signal

from hnn_vi_ros.simulation import simulate
import numpy as np
from peer import peer
from processes import finish, read_bag, standard_error, start, wait_until
import pytest
from scene_files import write_scene
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

# Its third step, and many after it, are taken in sub-steps.
STEEP = {'step_size': 0.5, 'q': [1.6]}
# Nothing is on disk, and compiling ends when the test says so.
MODULE = """\
from contextlib import contextmanager
from pathlib import Path
import time
from hnn_vi_ros.hamiltonians.tao import Tao
from hnn_vi_ros.kernels.compilation import NotKept
from hnn_vi_ros.ros.run import preparation
from hnn_vi_ros.simulation import Simulation

compile_rescue = Simulation.compile_rescue


@contextmanager
def kept_only():
    raise NotKept
    yield


def wait(simulation):
    while not Path('go').exists():
        time.sleep(0.01)
    compile_rescue(simulation)


def create():
    preparation.kept_only, Simulation.compile_rescue = kept_only, wait
    return Tao()
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working directory with a scene whose third step fails."""
    write_scene(tmp_path / 'held.yaml', "python, factory: 'held:create'", **STEEP)
    (tmp_path / 'held.py').write_text(MODULE)
    write_scene(tmp_path / 'free.yaml', 'tao', **STEEP)
    return tmp_path


def wait_for_failure(folder: Path, **parameters: object):
    """Start a node; return it when its run waits."""
    process = start(folder, scene='held.yaml', real_time_factor=0, **parameters)
    wait_until(lambda: process.poll() is not None or 'waits at t = 1 s' in standard_error(
        process))
    assert process.poll() is None
    return process


def test_step_waits_for_what_takes_it_while_services_answer_and_changes_no_bit(folder):
    process = wait_for_failure(folder, record_path='bag', duration=40.0)
    with peer() as other:
        assert other.pause().message == 'paused at t = 1 s'
        publisher = other.publisher(JointState, '~/initial_state')
        other.spin_until(publisher.get_subscription_count)
        publisher.publish(JointState(name=['x'], position=[1.0], velocity=[0.0]))
        wait_until(lambda: 'is still being compiled' in standard_error(process))
        future = other.call_async(Trigger, 'step')
        assert other.trigger('start_recording').success is False
        assert not future.done()
        other.spin_until(future.done)
        assert not future.result().success
        assert future.result().message.startswith(
            'a step failed, and its rescue is being compiled: try again: {"steps": 0, ')
        (folder / 'go').touch()
        other.spin_until(lambda: other.trigger('step').success)
        assert other.trigger('step').message.startswith('{"steps": 1, "step": 4, ')
        other.pause(False)
        status, _, _ = finish(process)
    assert status == 0
    q = [message.position[0] for _, message in read_bag(folder / 'bag')['/joint_states']]
    # A step that was tried before, and failed, has left nothing behind.
    assert np.array_equal(q, simulate(folder / 'free.yaml', 40.0).q[1:, 0])
    assert len(q) == 80


def test_signal_ends_a_node_whose_step_waits(folder):
    process = wait_for_failure(folder, record='false')
    process.send_signal(signal.SIGINT)
    status, _, error = finish(process)
    assert status == 0 and 'stopped by SIGINT' in error
