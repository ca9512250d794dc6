# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the simulator, apart from its lifecycle and parameters."""

from collections.abc import Callable
from inspect import isawaitable
from typing import Any

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.ros.run.control import Answer, Control, Simulator
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
    def record(method: str, words: str) -> Answer:
        """Begin or complete a bag; the answer is its absolute path."""
        assert simulator.run is not None, 'it has a control'
        try:
            path = getattr(simulator.run.recording, method)()
        except RecordingError as problem:
            return Answer(False, str(problem))
        simulator.run.tell(f'{words} {path}', 'INFO')
        return Answer(True, path)

    def answering(handler: Callable[[Control, Any], Any]) -> Callable[[Any, Any], Any]:
        async def answer(request: Any, response: Any) -> Any:
            done = Answer(False, simulator.refusal) if simulator.control is None \
                else handler(simulator.control, request)
            response.success, response.message = await done if isawaitable(done) else done
            return response
        return answer

    # They have a group of their own: a long call of ~/step keeps no other waiting.
    group = ReentrantCallbackGroup()
    for name, kind, handler in (
            ('~/set_pause', SetBool, lambda control, request: control.set_paused(request.data)),
            ('~/reset', Trigger, lambda control, _: control.reset(simulator.settings.reset_time)),
            ('~/step', Trigger, lambda control, _: control.request_steps(
                simulator.settings.step_count)),
            ('~/start_recording', Trigger, lambda *_: record('start_bag', 'recording to')),
            ('~/stop_recording', Trigger, lambda *_: record('stop_bag', 'recorded'))):
        node.create_service(kind, name, answering(handler), callback_group=group)
    offer_simulation_interfaces(node, simulator, group)
