# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Action of simulation_interfaces that takes steps, reports its progress, and can be cancelled."""

from collections.abc import Callable
import math
import time
from typing import Any

from hnn_vi_ros.ros.run.control import Answer, Simulator
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.task import Future

ACTION = 'SimulateSteps'
# Least wall time between two feedbacks [s]; thousands of steps a second would flood the client.
_PERIOD = 0.02


class SimulateSteps:
    """
    Serve the action.

    Every goal is accepted: by the definition, one that cannot be reached is answered by a result
    that says why, which a rejection could not do.

    Parameters
    ----------
    node : Node
        That serves it.
    kind : type
        ``simulation_interfaces.action.SimulateSteps``.
    codes : type
        ``simulation_interfaces.msg.Result``.
    simulator : Simulator
        The simulator to step.
    group : CallbackGroup
        Which it belongs to.

    """

    def __init__(self, node: Node, kind: type, codes: type, simulator: Simulator,
                 group: CallbackGroup):
        self._kind, self._codes, self._simulator = kind, codes, simulator
        self._goal: tuple[Any, Future] | None = None
        ActionServer(node, kind, '~/simulate_steps', self._execute, callback_group=group,
                     cancel_callback=self._on_cancel)

    async def _execute(self, goal: ServerGoalHandle) -> Any:
        """Take the steps of a goal; a second goal is answered at once, as a second service is."""
        control = self._simulator.control
        if control is None:
            return self._finish(goal, Answer(False, self._simulator.refusal))
        future = control.request_steps(int(goal.request.steps), self._feedback(goal))
        if not future.done():
            self._goal = goal, future
            if goal.is_cancel_requested:
                # Since before it began.
                control.cancel_steps(future)
        return self._finish(goal, await future)

    def _feedback(self, goal: ServerGoalHandle) -> Callable[[int, int], None]:
        """Return what reports progress to a client: after the first batch, and the last."""
        last = -math.inf

        def tell(done: int, left: int) -> None:
            nonlocal last
            now = time.monotonic()
            if left == 0 or now - last >= _PERIOD:
                last = now
                goal.publish_feedback(
                    self._kind.Feedback(completed_steps=done, remaining_steps=left))
        return tell

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Take no more steps of this goal; what was taken is not taken back."""
        if self._goal is not None and self._goal[0] == goal and self._simulator.control:
            self._simulator.control.cancel_steps(self._goal[1])
        return CancelResponse.ACCEPT

    def _finish(self, goal: ServerGoalHandle, answer: Answer) -> Any:
        result, codes = self._kind.Result(), self._codes
        if answer.success:
            result.result.result = codes.RESULT_OK
            goal.succeed()
            return result
        result.result.result = codes.RESULT_OPERATION_FAILED
        result.result.error_message = answer.message
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result
