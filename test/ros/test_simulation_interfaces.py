# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Services and action of simulation_interfaces, with its real messages, from another process."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hnn_vi_ros.ros.services import INTERFACES, service_name
from peer import Peer, peer, SIMULATOR, stamp
from processes import finish, start
import pytest
from rclpy.action import ActionClient
from scene_files import write_scene

REASON = 'simulation_interfaces is not installed: apt install ros-jazzy-simulation-interfaces'
msg = pytest.importorskip('simulation_interfaces.msg', reason=REASON)
srv = pytest.importorskip('simulation_interfaces.srv', reason=REASON)
action = pytest.importorskip('simulation_interfaces.action', reason=REASON)

STATE, RESULT = msg.SimulationState, msg.Result
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working directory with two scenes."""
    write_scene(tmp_path / 'oscillator.yaml')
    write_scene(tmp_path / 'other.yaml', q=[2.0])
    return tmp_path


class Client:
    """What a tool that knows simulation_interfaces does."""

    def __init__(self, other: Peer):
        self.other = other
        self.action = ActionClient(other.node, action.SimulateSteps, f'{SIMULATOR}/simulate_steps')
        other.spin_until(self.action.server_is_ready)
        self.feedback: list[tuple[int, int]] = []

    def call(self, interface: str, **fields: Any) -> Any:
        return self.other.call(getattr(srv, interface), service_name(interface), **fields)

    def code(self, interface: str, **fields: Any) -> int:
        return self.call(interface, **fields).result.result

    def set_state(self, state: int) -> int:
        return self.code('SetSimulationState', state=STATE(state=state))

    @property
    def state(self) -> int:
        return self.call('GetSimulationState').state.state

    def load(self, uri: str) -> Any:
        request = srv.LoadWorld.Request()
        getattr(request, 'world_resource', request).uri = uri
        future = self.other.client(srv.LoadWorld, 'load_world').call_async(request)
        self.other.spin_until(future.done)
        return future.result()

    def send(self, steps: int) -> Any:
        """Return the handle of a goal."""
        future = self.action.send_goal_async(
            action.SimulateSteps.Goal(steps=steps), lambda told: self.feedback.append(
                (told.feedback.completed_steps, told.feedback.remaining_steps)))
        self.other.spin_until(future.done)
        return future.result()

    def end_of(self, goal: Any) -> tuple[int, Any]:
        """Return the status of a goal and its result."""
        future = goal.get_result_async()
        self.other.spin_until(future.done)
        return future.result().status, future.result().result.result


@contextmanager
def serving(folder: Path, **parameters: object) -> Iterator[tuple[Peer, Client]]:
    """Start a simulator, give another node and the client, and quit by a service."""
    process = start(folder, **parameters)
    with peer() as other:
        other.wait_for_state('active')
        client = Client(other)
        yield other, client
        assert client.set_state(STATE.STATE_QUITTING) == RESULT.RESULT_OK
    assert finish(process)[0] == 0


def test_every_interface_is_served_with_the_real_messages_and_steps_are_exact(folder):
    with serving(folder, start_paused='true') as (other, client):
        features = client.call('GetSimulatorFeatures').features.features
        assert list(features) == sorted(
            getattr(msg.SimulatorFeatures, feature) for name, served in INTERFACES.items()
            if hasattr(srv, name) or hasattr(action, name) for feature in served)
        assert client.state == STATE.STATE_PAUSED
        assert client.code('StepSimulation', steps=7) == RESULT.RESULT_OK
        other.spin_until(lambda: other.states and stamp(other.states[-1]) == 70_000_000)
        assert client.code('ResetSimulation', scope=1) == RESULT.RESULT_OK
        assert client.code('StepSimulation') == RESULT.RESULT_OK
        # One step of the default, eight from the initial state, and time began anew after seven.
        other.spin_until(lambda: stamp(other.states[-1]) == 10_000_000)
        assert other.states[-1].position[0] == pytest.approx(0.9968, abs=1e-4)
        for state in (STATE.STATE_STOPPED, STATE.STATE_PLAYING):
            assert client.set_state(state) == RESULT.RESULT_OK and client.state == state
        assert client.code('StepSimulation', steps=1) == RESULT.RESULT_OPERATION_FAILED


def test_action_tells_how_far_it_is_and_can_be_cancelled(folder):
    with serving(folder, start_paused='true') as (other, client):
        status, result = client.end_of(client.send(12))
        assert (status, result.result) == (SUCCEEDED, RESULT.RESULT_OK)
        other.spin_until(lambda: (12, 0) in client.feedback)
        assert all(done + left == 12 for done, left in client.feedback)
        long = client.send(10**12)
        other.spin_until(lambda: client.feedback[-1][1] > 10**11)
        # A second one is not taken, and does not disturb the first.
        status, result = client.end_of(client.send(3))
        assert (status, result.result) == (ABORTED, RESULT.RESULT_OPERATION_FAILED)
        assert 'already' in result.error_message
        cancelled = long.cancel_goal_async()
        other.spin_until(cancelled.done)
        status, result = client.end_of(long)
        assert status == CANCELED and 'cancelled' in result.error_message
        assert other.pause(False).success
        status, result = client.end_of(client.send(3))
        assert (status, result.result) == (ABORTED, RESULT.RESULT_OPERATION_FAILED)
        assert 'only possible while' in result.error_message


@pytest.mark.skipif(not hasattr(srv, 'LoadWorld'), reason='this version knows no worlds')
def test_world_is_listed_loaded_and_played(folder):
    with serving(folder) as (other, client):
        worlds = client.call('GetAvailableWorlds', additional_sources=[str(folder)]).worlds
        assert [world.name for world in worlds[-2:]] == ['oscillator', 'other']
        assert client.code('GetAvailableWorlds', additional_sources=['/no/where']) == (
            RESULT.RESULT_NOT_FOUND)
        assert client.load('world.sdf').result.result == srv.LoadWorld.Response.UNSUPPORTED_FORMAT
        assert client.state == STATE.STATE_PLAYING
        loaded = client.load((folder / 'other.yaml').as_uri())
        assert loaded.result.result == RESULT.RESULT_OK, loaded.result.error_message
        assert loaded.world.name == client.call('GetCurrentWorld').world.name == 'other'
        assert client.state == STATE.STATE_STOPPED
        other.states.clear()
        assert client.set_state(STATE.STATE_PLAYING) == RESULT.RESULT_OK
        other.spin_until(lambda: other.states)
        assert other.states[0].position[0] == pytest.approx(2.0, abs=1e-3)
        assert client.code('UnloadWorld') == RESULT.RESULT_OK
        assert client.state == STATE.STATE_NO_WORLD
        assert client.code('StepSimulation') == RESULT.RESULT_OPERATION_FAILED
