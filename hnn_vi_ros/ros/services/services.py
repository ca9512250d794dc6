# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the simulator, apart from its lifecycle and parameters."""

from typing import Any

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.ros.run.control import Answer, Simulator
from hnn_vi_ros.ros.services.simulation_interfaces import offer_simulation_interfaces
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger


def offer_services(node: Node, simulator: Simulator) -> None:
    """
    Create the services, with simulation_interfaces where it is installed.

    Parameters
    ----------
    node : Node
        That offers them.
    simulator : Simulator
        What they act on.

    """
    services = Services(simulator)
    # They have a group of their own: a long call of ~/step keeps no other waiting.
    group = ReentrantCallbackGroup()
    for name, kind, handler in (
            ('~/set_pause', SetBool, services.set_pause),
            ('~/reset', Trigger, services.reset),
            ('~/step', Trigger, services.step),
            ('~/start_recording', Trigger, services.start_recording),
            ('~/stop_recording', Trigger, services.stop_recording)):
        node.create_service(kind, name, handler, callback_group=group)
    offer_simulation_interfaces(node, simulator, group)


class Services:
    """
    Answer the services of std_srvs.

    Parameters
    ----------
    simulator : Simulator
        What they act on.

    """

    def __init__(self, simulator: Simulator):
        self._simulator = simulator

    @property
    def _refusal(self) -> Answer:
        return Answer(False, self._simulator.refusal)

    def set_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Pause, or end the pause."""
        control = self._simulator.control
        return _fill(
            response, control.set_paused(request.data) if control else self._refusal)

    def reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Restart at the initial state."""
        control, time_too = self._simulator.control, self._simulator.settings.reset_time
        return _fill(response, control.reset(time_too) if control else self._refusal)

    async def step(self, request: Trigger.Request, response: Trigger.Response
                   ) -> Trigger.Response:
        """Take ``step_count`` steps, by its current value; the answer gives their number."""
        control = self._simulator.control
        if control is None:
            return _fill(response, self._refusal)
        return _fill(
            response, await control.request_steps(self._simulator.settings.step_count))

    def start_recording(self, request: Trigger.Request, response: Trigger.Response
                        ) -> Trigger.Response:
        """Begin a new bag; the answer is its absolute path."""
        return self._record(response, 'start_bag', 'recording to')

    def stop_recording(self, request: Trigger.Request, response: Trigger.Response
                       ) -> Trigger.Response:
        """Complete the bag; the answer is its absolute path."""
        return self._record(response, 'stop_bag', 'recorded')

    def _record(self, response: Trigger.Response, method: str, words: str) -> Trigger.Response:
        run = self._simulator.run
        if run is None:
            return _fill(response, self._refusal)
        try:
            path = getattr(run.recording, method)()
        except RecordingError as problem:
            return _fill(response, Answer(False, str(problem)))
        run.tell(f'{words} {path}', 'INFO')
        return _fill(response, Answer(True, path))


def _fill(response: Any, answer: Answer) -> Any:
    response.success, response.message = answer
    return response
