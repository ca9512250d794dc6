# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""States to begin at, which others publish on ~/initial_state, and the answers on ~/state_set."""

from collections.abc import Callable
from functools import partial

from hnn_vi_ros.ros.run.control import Answer
from hnn_vi_ros.ros.run.run import Run
from hnn_vi_ros.ros.topics.diagnostics_publisher import (
    DiagnosticsPublisher, ERROR, OK, state_values, Status)
from hnn_vi_ros.ros.topics.initial_state import initial_state
from hnn_vi_ros.ros.topics.outputs import STATE_SET
from hnn_vi_ros.ros.topics.topics import Topics
from rclpy.node import Node
from sensor_msgs.msg import JointState

_COMPONENT = 'initial_state'
# Characters of an answer.
_LONGEST = 1000


class StateTopic:
    """
    Take states for the next reset, and tell who sent them what came of it.

    An answer is one status: whether the state was taken, and why not; q and p, with all digits.

    Parameters
    ----------
    node : Node
        The simulator.
    topics : Topics
        Its publishers and subscriptions.
    run : Run
        What begins at the states.
    reset : callable
        Resets at once, or returns None where that is not asked for.

    """

    def __init__(self, node: Node, topics: Topics, run: Run, reset: Callable[[], Answer | None]):
        self._node, self._run, self._reset = node, run, reset
        self._answers = DiagnosticsPublisher(
            node, partial(topics.send, STATE_SET), run.scene.name)
        topics.hear('~/initial_state', JointState, self._take)

    def _take(self, message: JointState) -> None:
        run = self._run
        try:
            if not run.simulation.rescue_ready:
                raise ValueError('what turns velocities into momenta is still being compiled: '
                                 'send it again in some seconds')
            q, p = initial_state(message, run.simulation.hamiltonian, run.start[1])
            run.simulation.check_state(q, p)
            run.set_start(q, p)
            done, text = self._reset(), 'taken for the next reset'
            if done is not None:
                if not done.success:
                    raise ValueError(done.message)
                text = 'reset to it'
        except ValueError as problem:
            self._answer(ERROR, ' '.join(str(problem).split()), {})
            raise
        self._answer(OK, text, state_values(run.simulation.hamiltonian.coordinates, q, p))
        self._node.get_logger().info(f'~/initial_state: {text}', throttle_duration_sec=1.0)

    def _answer(self, level: bytes, text: str, values: dict[str, str]) -> None:
        self._answers.publish(
            [Status(_COMPONENT, level, text[:_LONGEST], values)], self._run.sampler.stamp)
