# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that outlive a wrong /clock, and whose slow transitions may be refused."""

from collections.abc import Awaitable, Callable, Sequence
import math
import os
import signal
import sys
import threading
import time
from typing import Any

from hnn_vi_ros.errors import did_you_mean, HnnViRosError
from hnn_vi_ros.ros.plumbing.graph import THREAD_TURN
from hnn_vi_ros.ros.plumbing.qos_overrides import PREFIX
from hnn_vi_ros.ros.plumbing.rclpy_internals import answer_changes, log, RCLError, state_machine
from hnn_vi_ros.ros.plumbing.stamps import nanoseconds
from hnn_vi_ros.ros.plumbing.starting import plain_ros_errors
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock as SteadyClock, ClockType, ROSClock
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock

CLOCK_TOPIC = '/clock'
# Of several publishers of /clock one is followed until it is silent for so long [s]; what goes
# back, or is so much ahead [ns], is another's.
_CLOCK_SILENCE, _CLOCK_STEP = 5.0, 10**9


def steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Return a timer by wall time; on ROS time it would stall in a pause of /clock."""
    return node.create_timer(period, callback, clock=SteadyClock(clock_type=ClockType.STEADY_TIME))


def follows_clock(node: Node) -> bool:
    """Return whether the time of a node is that of /clock."""
    clock = node.get_clock()
    assert isinstance(clock, ROSClock), 'that of a node is one'
    return clock.ros_time_is_active


class PaceClock:
    """
    The time by which a node is paced: that of /clock under use_sim_time, else a steady one.

    Parameters
    ----------
    node : Node
        Whose parameter use_sim_time counts.

    """

    def __init__(self, node: Node):
        self._node, self._first = node, 0

    def __call__(self) -> float:
        """Return the time since some start [s]; it stands until /clock begins."""
        if not self.led:
            return time.monotonic()
        now = self._node.get_clock().now().nanoseconds
        # A float could not tell nanoseconds of the epoch.
        self._first = self._first or now
        return (now - self._first) * 1e-9

    @property
    def led(self) -> bool:
        """Return whether it is that of /clock."""
        return follows_clock(self._node)


class RobustNode(Node):
    """
    A node that follows one /clock, whose times are possible; it names unknown parameters.

    Attributes
    ----------
    after_clock : callable
        Called after each message of /clock, where use_sim_time asks for these.

    """

    after_clock: Callable[[], None] = staticmethod(lambda: None)

    def create_subscription(self, msg_type: Any, topic: str, callback: Callable[[Any], None],
                            *args: Any, **more: Any) -> Subscription:
        """See Node, which subscribes to /clock by it wherever use_sim_time asks for that."""
        if topic == CLOCK_TOPIC:
            callback = self._heeding(callback)
        return super().create_subscription(msg_type, topic, callback, *args, **more)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """See Node, whose answer to an unknown name, by every service, does not name it."""
        for name in (parameter.name for parameter in parameter_list):
            if not self.has_parameter(name):
                known = sorted(self.list_parameters([], 0).names)
                hint = did_you_mean(name, known) or '; it has: ' + ', '.join(
                    own for own in known if not own.startswith(PREFIX))
                return SetParametersResult(successful=False, reason=(
                    f'parameter {name[:80]}: {self.get_name()} has none of this name{hint}'))
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
            # No message tells who sent it.
            if (now - heard < _CLOCK_SILENCE and not 0 <= at - newest <= _CLOCK_STEP
                    and self.count_publishers(CLOCK_TOPIC) > 1):
                self.get_logger().warning(
                    f'{CLOCK_TOPIC} has several publishers: the first is followed, at '
                    f'{newest / 1e9:.9g} s, and not one at {at / 1e9:.9g} s; end all but one',
                    once=True)
                return
            newest, heard = at, now
            callback(message)
            self.after_clock()
        return on_clock


# Wall time from one look at signals to the next, where nothing happens [s]. The end of such a wait
# costs a turn, half a tick at 1 kHz.
_LOOK = 0.1
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
# What others may ask for; the rest are steps inside of a transition.
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
    A lifecycle node that keeps serving during a long transition.

    Here ``on_configure`` may be a coroutine, which awaits the work of ``in_thread``. Its
    publishers are ordinary ones, which cost nothing more for each message: a node that is not
    active has nothing to publish.

    Parameters
    ----------
    name : str
        Of the node.

    Attributes
    ----------
    exit_status : int or None
        None while the node runs; then the exit status of the process.

    """

    def __init__(self, name: str):
        with plain_ros_errors():
            RobustNode.__init__(self, name, automatically_declare_parameters_from_overrides=True)
        # All services of this group answer while a transition is under way.
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        # The mixin's own handler lets the error of an illegal transition end the process.
        answer_changes(self, self._on_change_state)
        self._machine = state_machine(self)
        self._threads: list[threading.Thread] = []
        self.exit_status: int | None = None
        self._turn = sys.getswitchinterval()

    @property
    def state(self) -> int:
        """Return the number of the state, one of lifecycle_msgs/State."""
        return self._machine.current_state[0]

    @property
    def ticking(self) -> bool:
        """Return whether a timer calls so often that signals are noticed by its calls."""
        return False

    def stop(self, status: int, reason: str) -> None:
        """Let the process end with this status, and say why."""
        if self.exit_status is None:
            self.exit_status = status
            log(self, reason, 'ERROR' if status else 'INFO')

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process."""
        self.stop(0, 'shut down')
        return SUCCESS

    async def autostart(self) -> None:
        """Configure and activate; raise what makes that impossible."""
        if await self.change_state(Transition.TRANSITION_CONFIGURE):
            await self.change_state(Transition.TRANSITION_ACTIVATE)

    def serve(self, received: Sequence[int], autostart: bool) -> SingleThreadedExecutor:
        """
        Serve until the node has an exit status; return the executor, which nobody spins then.

        Parameters
        ----------
        received : sequence of int
            Signals that have come, to which a handler adds.
        autostart : bool
            Whether to configure and activate without being asked to.

        """
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        if autostart:
            executor.create_task(self.autostart)
        while self.exit_status is None:
            if received:
                self.stop(0, f'stopped by {signal.Signals(received[0]).name}')
                continue
            try:
                executor.spin_once(timeout_sec=None if self.ticking else _LOOK)
            except RCLError as problem:
                # Such as a client that is gone before its answer: no reason to stop.
                self.get_logger().warning(
                    f'ROS: {" ".join(str(problem).split())}', throttle_duration_sec=1.0)
        return executor

    def end(self, status: int) -> int:
        """Destroy the node and return the status; end the process if a thread is at work."""
        busy = any(thread.is_alive() for thread in self._threads)
        self.destroy_node()
        if busy:
            # A compilation that nobody needs cannot be interrupted, nor be left to run into the
            # end.
            sys.stdout.flush()
            os._exit(status)
        return status

    def wait(self, seconds: float) -> None:
        """Wait at most so long for the threads at work."""
        for thread in list(self._threads):
            thread.join(seconds)

    async def change_state(self, transition: int) -> bool:
        """
        Go through a transition; return whether it succeeded.

        Raises
        ------
        HnnViRosError
            From the callback; the transition has failed then.

        """
        available = {found[0] for found in self._machine.available_transitions}
        if transition not in _PUBLIC or transition not in available:
            _, label = self._machine.current_state
            self.get_logger().warning(
                f'transition {transition} refused: the node is {label}',
                throttle_duration_sec=1.0)
            return False
        before = LifecycleState(state_id=self.state, label=self._machine.current_state[1])
        self._machine.trigger_transition_by_id(transition, True)
        try:
            found = getattr(self, _PUBLIC[transition])(before)
            result = await found if isinstance(found, Awaitable) else found
        except GeneratorExit:
            # The process ends first, and ROS has ended already.
            raise
        except BaseException:
            self._end_transition(FAILURE)
            raise
        self._end_transition(result)
        if result == SUCCESS:
            self.get_logger().info(f'{before.label} -> {self._machine.current_state[1]}')
        return result == SUCCESS

    def _end_transition(self, result: TransitionCallbackReturn) -> None:
        if self.state != State.PRIMARY_STATE_FINALIZED:
            self._machine.trigger_transition_by_label(result.to_label(), True)

    @property
    def spinner(self) -> Executor:
        """Return the executor, which there is while the node is spun."""
        assert self.executor is not None
        return self.executor

    async def in_thread(self, work: Callable[[], Any]) -> Any:
        """Let a thread do the work; return what it returns, raise what it raises."""
        future, executor = Future(), self.spinner

        def run() -> None:
            try:
                future.set_result(work())
            except BaseException as problem:
                future.set_exception(problem)
            executor.wake()

        # A daemon: nobody waits for a compilation that is not needed any more.
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
            # The state machine's own look-up raises for an unknown name.
            transition = next((found[0] for found in self._machine.available_transitions
                               if found[1] == request.transition.label), 0)
        try:
            response.success = await self.change_state(transition)
        except HnnViRosError as problem:
            self.get_logger().error(str(problem))
            response.success = False
        return response
