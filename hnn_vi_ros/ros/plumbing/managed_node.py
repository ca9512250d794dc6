# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that survive an invalid /clock, and lifecycle nodes whose transitions can be slow."""

from collections.abc import Awaitable, Callable, Sequence
import math
import os
import signal
import sys
import threading
import time
import traceback
from typing import Any

from hnn_vi_ros.errors import did_you_mean, HnnViRosError
from hnn_vi_ros.files import one_line
from hnn_vi_ros.ros.plumbing.executor import NodeExecutor
from hnn_vi_ros.ros.plumbing.graph import THREAD_TURN
from hnn_vi_ros.ros.plumbing.qos_overrides import PREFIX
from hnn_vi_ros.ros.plumbing.rclpy_internals import answer_changes, log, state_machine
from hnn_vi_ros.ros.plumbing.starting import plain_ros_errors
from hnn_vi_ros.run import nanoseconds
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock as SteadyClock, ClockType, ROSClock
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock

CLOCK_TOPIC = '/clock'
# With several publishers of /clock, one is followed until it is silent for this time [s]; a time
# that goes back, or leaps ahead by more than this [ns], is attributed to another publisher.
_MAX_CLOCK_SILENCE, _MAX_CLOCK_STEP = 5.0, 10**9


def steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Return a timer on wall time; on ROS time it would stall while /clock is paused."""
    return node.create_timer(period, callback, clock=SteadyClock(clock_type=ClockType.STEADY_TIME))


def follows_clock(node: Node) -> bool:
    """Return True if the clock of a node follows /clock."""
    clock = node.get_clock()
    assert isinstance(clock, ROSClock), 'that of a node is one'
    return clock.ros_time_is_active


class PaceClock:
    """
    Clock that paces a node: ROS time under use_sim_time, otherwise a steady clock.

    Parameters
    ----------
    node : Node
        Node whose parameter use_sim_time selects the clock.

    """

    def __init__(self, node: Node):
        self._node, self._first = node, 0

    def __call__(self) -> float:
        """Return the time since an arbitrary start [s]; it is constant until /clock begins."""
        if not self.led:
            return time.monotonic()
        now = self._node.get_clock().now().nanoseconds
        # A float cannot resolve nanoseconds since the epoch.
        self._first = self._first or now
        return (now - self._first) * 1e-9

    @property
    def led(self) -> bool:
        """Return True if the time is that of /clock."""
        return follows_clock(self._node)


class RobustNode(Node):
    """
    Node that follows a single /clock with valid times, and names unknown parameters in errors.

    Attributes
    ----------
    after_clock : callable
        Called after each message of /clock under use_sim_time.

    """

    after_clock: Callable[[], None] = staticmethod(lambda: None)

    def create_subscription(self, msg_type: Any, topic: str, callback: Callable[[Any], None],
                            *args: Any, **more: Any) -> Subscription:
        """Filter messages of /clock, to which Node subscribes with this method."""
        if topic == CLOCK_TOPIC:
            callback = self._heeding(callback)
        return super().create_subscription(msg_type, topic, callback, *args, **more)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters; in contrast to Node, name an unknown parameter in the result."""
        for name in (parameter.name for parameter in parameter_list):
            if not self.has_parameter(name):
                known = sorted(self.list_parameters([], 0).names)
                hint = did_you_mean(name, known) or '; it has: ' + ', '.join(
                    own for own in known if not own.startswith(PREFIX))
                return SetParametersResult(successful=False, reason=(
                    f'parameter {name[:80]}: {self.get_name()} has no such parameter{hint}'))
        return super().set_parameters_atomically(parameter_list)

    def _heeding(self, callback: Callable[[Clock], None]) -> Callable[[Clock], None]:
        newest, heard = 0, -math.inf

        def on_clock(message: Clock) -> None:
            nonlocal newest, heard
            try:
                at = nanoseconds(message.clock)
            except ValueError as problem:
                self.get_logger().error(
                    f'{CLOCK_TOPIC}: message ignored: {problem}', throttle_duration_sec=1.0)
                return
            now = time.monotonic()
            # Messages do not identify their publishers.
            if (now - heard < _MAX_CLOCK_SILENCE and not 0 <= at - newest <= _MAX_CLOCK_STEP
                    and self.count_publishers(CLOCK_TOPIC) > 1):
                self.get_logger().warning(
                    f'{CLOCK_TOPIC} has several publishers: the first is followed, at '
                    f'{newest / 1e9:.9g} s, and another at {at / 1e9:.9g} s is ignored; stop all '
                    'but one',
                    once=True)
                return
            newest, heard = at, now
            callback(message)
            self.after_clock()
        return on_clock


# Wall time between two checks for signals while the node is idle [s]. Each timeout of a wait
# costs a turn of the executor, which is half a tick at 1 kHz.
_SIGNAL_PERIOD = 0.1
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
# Transitions that clients may request; the others are internal steps.
_PUBLIC = {
    Transition.TRANSITION_CONFIGURE: 'on_configure',
    Transition.TRANSITION_CLEANUP: 'on_cleanup',
    Transition.TRANSITION_ACTIVATE: 'on_activate',
    Transition.TRANSITION_DEACTIVATE: 'on_deactivate',
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: 'on_shutdown',
    Transition.TRANSITION_INACTIVE_SHUTDOWN: 'on_shutdown',
    Transition.TRANSITION_ACTIVE_SHUTDOWN: 'on_shutdown',
}


class ManagedNode(LifecycleNodeMixin, RobustNode):
    """
    A lifecycle node that continues to serve during a long transition.

    Here ``on_configure`` may be a coroutine, which awaits the work of ``in_thread``. Its
    publishers are ordinary ones, which add no cost per message: a node that is not active has
    nothing to publish.

    Parameters
    ----------
    name : str
        Name of the node.

    Attributes
    ----------
    exit_status : int or None
        None while the node runs; then the exit status of the process.

    """

    def __init__(self, name: str):
        with plain_ros_errors():
            RobustNode.__init__(self, name, automatically_declare_parameters_from_overrides=True)
        # All services of this group answer during a transition.
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        # With the mixin's own handler, the error of an illegal transition would end the process.
        answer_changes(self, self._on_change_state)
        self._machine = state_machine(self)
        self._threads: list[threading.Thread] = []
        self.exit_status: int | None = None
        self._turn = sys.getswitchinterval()

    @property
    def state(self) -> int:
        """Return the ID of the state as in lifecycle_msgs/State."""
        return self._machine.current_state[0]

    @property
    def ticking(self) -> bool:
        """Return True if a timer fires so often that its calls are enough to notice signals."""
        return False

    def stop(self, status: int, reason: str) -> None:
        """Let the process end with this exit status, and log the reason."""
        if self.exit_status is None:
            self.exit_status = status
            log(self, reason, 'ERROR' if status else 'INFO')

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the process end with status 0."""
        self.stop(0, 'shut down')
        return SUCCESS

    def roll_back(self) -> None:
        """Undo what a configuration has done before it failed."""
        return

    async def autostart(self) -> None:
        """Configure and activate; raise the error of a transition that fails."""
        if await self.change_state(Transition.TRANSITION_CONFIGURE):
            await self.change_state(Transition.TRANSITION_ACTIVATE)

    def serve(self, received: Sequence[int], autostart: bool) -> NodeExecutor:
        """
        Serve until the node has an exit status; return the executor, which is then not spun.

        Parameters
        ----------
        received : sequence of int
            Received signals; a handler appends to it.
        autostart : bool
            True to configure and activate at once, without a request.

        """
        executor = NodeExecutor(self)
        if autostart:
            executor.create_task(self.autostart)
        while self.exit_status is None:
            if received:
                self.stop(0, f'stopped by {signal.Signals(received[0]).name}')
                continue
            executor.spin_once(timeout_sec=None if self.ticking else _SIGNAL_PERIOD)
        return executor

    def end(self, status: int) -> int:
        """Destroy the node and return the status; exit the process if a thread is busy."""
        busy = any(thread.is_alive() for thread in self._threads)
        self.destroy_node()
        if busy:
            # A compilation can be neither interrupted nor left running into the shutdown of the
            # interpreter.
            sys.stdout.flush()
            os._exit(status)
        return status

    def wait(self, seconds: float) -> None:
        """Wait at most this long for each thread at work [s]."""
        for thread in list(self._threads):
            thread.join(seconds)

    async def change_state(self, transition: int) -> bool:
        """
        Perform a transition; return True if it succeeded.

        Raises
        ------
        HnnViRosError
            The callback raised an exception; the transition has failed.

        """
        available = {found[0] for found in self._machine.available_transitions}
        if transition not in _PUBLIC or transition not in available:
            _, label = self._machine.current_state
            self.get_logger().warning(
                f'transition {transition} rejected: the node is {label}',
                throttle_duration_sec=1.0)
            return False
        before = LifecycleState(state_id=self.state, label=self._machine.current_state[1])
        self._machine.trigger_transition_by_id(transition, True)
        try:
            found = getattr(self, _PUBLIC[transition])(before)
            result = await found if isinstance(found, Awaitable) else found
        except GeneratorExit:
            # The process is ending, and ROS is already shut down.
            raise
        except Exception as problem:
            if transition == Transition.TRANSITION_CONFIGURE:
                self.roll_back()
            self._end_transition(FAILURE)
            if isinstance(problem, HnnViRosError):
                raise
            self.get_logger().debug(''.join(traceback.format_exception(problem)))
            raise HnnViRosError(f'{_PUBLIC[transition]} failed: {type(problem).__name__}: '
                                f'{one_line(problem)}') from problem
        self._end_transition(result)
        if result == SUCCESS:
            self.get_logger().info(f'{before.label} -> {self._machine.current_state[1]}')
        return result == SUCCESS

    def _end_transition(self, result: TransitionCallbackReturn) -> None:
        if self.state != State.PRIMARY_STATE_FINALIZED:
            self._machine.trigger_transition_by_label(result.to_label(), True)

    @property
    def spinner(self) -> Executor:
        """Return the executor, which exists while the node is spun."""
        assert self.executor is not None
        return self.executor

    async def in_thread(self, work: Callable[[], Any]) -> Any:
        """Run the work in a thread; return its result or raise its exception."""
        future, executor = Future(), self.spinner

        def run() -> None:
            try:
                future.set_result(work())
            except BaseException as problem:
                future.set_exception(problem)
            executor.wake()

        # A daemon thread, since nothing waits for a compilation that is no longer needed.
        thread = threading.Thread(target=run, daemon=True)
        self._threads.append(thread)
        sys.setswitchinterval(THREAD_TURN)
        thread.start()
        try:
            return await future
        finally:
            self._threads.remove(thread)
            if not self._threads:
                sys.setswitchinterval(self._turn)

    async def _on_change_state(self, request: ChangeState.Request,
                               response: ChangeState.Response) -> ChangeState.Response:
        transition = request.transition.id
        if request.transition.label:
            # The state machine's own look-up raises for an unknown label.
            transition = next((found[0] for found in self._machine.available_transitions
                               if found[1] == request.transition.label), 0)
        try:
            response.success = await self.change_state(transition)
        except HnnViRosError as problem:
            self.get_logger().error(str(problem))
            response.success = False
        return response
