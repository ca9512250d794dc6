# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The controller node: commands a machine or a simulator by a task, from its state."""

from collections import deque
from collections.abc import Sequence
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.control import assign, Assignment, Planner
from hnn_vi_ros.effects import select
from hnn_vi_ros.errors import listed, ParameterError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.recording import MOMENTUM
from hnn_vi_ros.ros import arguments as command_lines
from hnn_vi_ros.ros.node_parameters import declare_parameters, node_name, refuse_unknown
from hnn_vi_ros.ros.plumbing.graph import (
    freeze_memory, nodes_of, publisher_conflicts, RepetitionFilter, wait_for_delivery)
from hnn_vi_ros.ros.plumbing.managed_node import (
    CLOCK_TOPIC, follows_clock, ManagedNode, steady_timer, SUCCESS)
from hnn_vi_ros.ros.plumbing.qos_overrides import create_publisher, Endpoint
from hnn_vi_ros.ros.plumbing.stamps import LATEST, Stamps
from hnn_vi_ros.ros.plumbing.starting import own_arguments, ros_process
from hnn_vi_ros.ros.settings import CONTROLLER_PARAMETERS, ControllerSettings
from hnn_vi_ros.ros.topics.diagnostics import DiagnosticsPublisher, OK, Status, WARN
from hnn_vi_ros.ros.topics.inputs import Input, NEWEST
from hnn_vi_ros.ros.topics.joining import ObservationJoiner
from hnn_vi_ros.ros.topics.outputs import DIAGNOSTICS
from hnn_vi_ros.ros.topics.subscriptions import Subscriptions
from hnn_vi_ros.run import nanoseconds, read_observation
import numpy as np
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# Number of commands whose plan times enter the diagnostics, and the period of these [s].
_PLAN_TIMES, _REPORT_PERIOD = 1000, 1.0
# Number of states whose lags, from time stamp to arrival, are compared.
_LAGS = 20
# Number of intervals between commands, and the median above which to warn [periods].
_INTERVALS, _MAX_INTERVAL = 100, 1.5
# Tolerated earliness of a state relative to the end of the period [periods].
_MAX_EARLINESS = 0.01
# Most calls that compile a controller, the least time of such a call [s], and the number of fast
# calls that show that all is compiled.
_MAX_WARM_CALLS, _MIN_COMPILE_TIME, _FAST_CALLS = 20, 0.5, 4

# Sensor-like QoS. The newest of the waiting states is answered, so that no plan begins at an older
# one; the depth keeps all parts of a state.
_STATES = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)


def state_of(message: JointState, hamiltonian: Hamiltonian) -> tuple[np.ndarray, np.ndarray]:
    """
    Return q and v from joint states, or from ~/state of the simulator, which has momenta.

    Parameters
    ----------
    message : JointState
        Message with every coordinate once, in any order, and possibly with others.
    hamiltonian : Hamiltonian
        Hamiltonian of d coordinates.

    Raises
    ------
    ValueError
        A coordinate is missing, or a number is not finite; one line.

    """
    (names, momenta), seen = columns(hamiltonian.coordinates), read_observation(message, 0)
    if MOMENTUM + momenta[0] in message.name:
        numbers, _ = select(seen, [*names, *(MOMENTUM + name for name in momenta)])
        q, p = np.split(numbers, [len(names)])
        return q, hamiltonian.gradient(q, p)[1]
    if hamiltonian.rotations:
        raise ValueError('joint states cannot describe rotating bodies: provide ~/state of a '
                         'simulator')
    q, v = select(seen, names)
    if np.isnan(v).any():
        raise ValueError('a velocity is missing or not finite')
    return q, v


class ControllerNode(ManagedNode):
    """
    Node that answers states with the commands of a task.

    A command answers one state and is sent at the time that the task sets; a late one acts late.

    Parameters
    ----------
    arguments : sequence of str, optional
        Command line with the parameters.

    Raises
    ------
    ParameterError
        A parameter is not usable; one line.

    """

    def __init__(self, arguments: Sequence[str] = ()):
        super().__init__('hnn_controller')
        self.settings = declare_parameters(self, ControllerSettings)
        name = self._simulator = node_name(self, 'simulator', self.settings.simulator)
        self._topic = f'{name}/{self.settings.commands}'
        if self.settings.lockstep and self.settings.commands != 'joint_commands':
            raise ParameterError('parameter lockstep: only joint_commands carry stamps; set '
                                 'commands to joint_commands')
        refuse_unknown(self, CONTROLLER_PARAMETERS, [
            Endpoint('joint_states', 'subscription'), Endpoint(f'{name}/state', 'subscription'),
            Endpoint(f'{name}/scene', 'subscription'),
            Endpoint(self._topic, 'publisher'), Endpoint(DIAGNOSTICS.topic, 'publisher'),
            Endpoint('~/plan', 'publisher')],
            arguments)
        self._assignment: Assignment | None = None
        self._hearing = Subscriptions(self)
        self._publishers: list[Publisher] = []
        self._timers: list[Timer] = []
        self._active = False

    async def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the task, compile its controller, and open the topics; serve in the meantime."""
        settings, begin = self.settings, time.monotonic()
        assignment: Assignment = await self.in_thread(
            lambda: _compile_controller(assign(settings.task, settings.scene, settings.lockstep)))
        self._assignment = assignment
        if assignment.left_out:
            self.get_logger().warning(
                f'the model of the controller lacks {listed(assignment.left_out)}: rigid stops '
                'have no derivatives; use soft_wall to plan with them')
        # For a task with a long period, the states between two answers are not a silence.
        self._silence = max(assignment.task.silence, assignment.task.period)
        self._time = assignment.task.plan_time or assignment.task.period
        self._commands = create_publisher(
            self, JointState if settings.commands == 'joint_commands' else Float64MultiArray,
            self._topic, NEWEST)
        diagnostics = create_publisher(self, DiagnosticArray, DIAGNOSTICS.topic, DIAGNOSTICS.qos)
        self._plans = create_publisher(self, JointTrajectory, '~/plan', NEWEST)
        self._publishers = [self._commands, self._plans, diagnostics]
        self._diagnostics = DiagnosticsPublisher(
            self, lambda payload, stamp: diagnostics.publish(payload), assignment.scene.name)
        self._hearing = Subscriptions(self)
        self._warn_of_crowd, self._warn_of_stranger, self._warn_of_gaps = (
            RepetitionFilter(self.get_logger().warning) for _ in range(3))
        turning = assignment.hamiltonian.rotations
        self._states = f'{self._simulator}/state' if turning else 'joint_states'
        self._answered = math.inf
        self._stamp, self._stamps = 0, Stamps(self._now)
        # A timeout of half the silence gives the reason for missing joints before the report.
        self._joiner = ObservationJoiner(
            columns(assignment.hamiltonian.coordinates)[0], 0.5 * self._silence, self._now)
        # A reset simulator publishes its scene again, and its stamps may then be older.
        self._hearing.hear(Input(f'{self._simulator}/scene', String, NEWEST),
                           self._on_scene, then=self._answer)
        self._hearing.hear(Input(self._states, JointState, _STATES),
                           self._on_state, then=self._answer)
        self._timers = [steady_timer(self, 0.25 * self._silence, self._watch),
                        steady_timer(self, _REPORT_PERIOD, self._report)]
        self._times: deque[float] = deque(maxlen=_PLAN_TIMES)
        self._sent = self._late = self._reported_late = 0
        self._forget()
        self.get_logger().info(
            f'{settings.task}: {assignment.task.controller.kind} of {assignment.scene.name}, '
            f'ready after {time.monotonic() - begin:.1f} s')
        freeze_memory()
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer states from now on."""
        self._forget()
        self._stamps.reset()
        self._active, self._silent, self._refused = True, False, False
        # Wall times of the arrival of the last state, and of the last answered one [s].
        self._heard = self._answered = math.inf
        self.get_logger().info(f'receives {self._states}, publishes commands on {self._topic}')
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send zeros, and stop answering."""
        self._rest()
        self._active = False
        return SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to the unconfigured state."""
        self.roll_back()
        return SUCCESS

    def roll_back(self) -> None:
        self._hearing.close()
        for publisher in self._publishers:
            self.destroy_publisher(publisher)
        for timer in self._timers:
            self.destroy_timer(timer)
        self._assignment, self._publishers, self._timers = None, [], []

    def finish(self, received: Sequence[int]) -> int:
        """Send zeros if the node is active, wait for delivery, and return the exit status."""
        if self._active:
            self._rest()
        wait_for_delivery(self, self._publishers, received)
        return self.exit_status or 0

    @property
    def _assigned(self) -> Assignment:
        assert self._assignment is not None, 'the node is configured'
        return self._assignment

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _forget(self) -> None:
        """Discard what is known of earlier states, so that the next one is answered."""
        self._assigned.prediction.reset()
        # The number of warm-up calls depends on the computer.
        if isinstance(self._assigned.controller, Planner):
            self._assigned.controller.reset()
        self._due = -1
        self._next: tuple[int, np.ndarray, np.ndarray] | None = None
        # The newest state since the last accepted one whose stamp is too old.
        self._older: tuple[int, np.ndarray, np.ndarray] | None = None
        self._lags: deque[float] = deque(maxlen=_LAGS)
        self._gaps: deque[float] = deque(maxlen=_INTERVALS)

    def _on_state(self, message: JointState) -> None:
        if not self._active:
            return
        self._heard, self._refused = time.monotonic(), True
        if (joined := self._joiner(message)) is None:
            return
        q, v = state_of(joined, self._assigned.hamiltonian)
        stamp = nanoseconds(joined.header.stamp)
        # The simulator repeats a state whose answer it still awaits.
        if self.settings.lockstep and self._sent and stamp == self._stamp:
            self._send(self._last)
        elif self.settings.lockstep and self._next and stamp == self._next[0]:
            self._next = stamp, q, v
        else:
            self._older = stamp, q, v
            self._next = self._stamps.accept(stamp), q, v
            self._older = None
        self._refused = False

    def _on_scene(self, message: String) -> None:
        """Accept an older stamp next, also that of a state that has just arrived."""
        self._stamps.reset()
        if self._older is not None and time.monotonic() - self._heard < self._silence:
            (stamp, q, v), self._older = self._older, None
            self._next = self._stamps.accept(stamp), q, v

    def _answer(self) -> None:
        """Answer the newest state, unless that was done or the period has not passed."""
        if self._next is None:
            return
        (stamp, q, v), self._next = self._next, None
        begin, assigned = self._heard, self._assigned
        if stamp < self._stamp:
            # The simulator has restarted, or the clock was set back.
            self._forget()
        if stamp < self._due:
            if self.settings.lockstep:
                self._stamp = stamp
                self._send(self._last)
            return
        if self._due >= 0:
            self._gaps.append((stamp - self._stamp) / 1e9)
        period = round(assigned.task.period * 1e9)
        self._due = stamp + period - round(_MAX_EARLINESS * period)
        t = stamp / 1e9
        u = np.asarray(assigned.controller(
            *assigned.prediction(t, q, v), t + assigned.prediction.delay))
        if not np.isfinite(u).all():
            raise ValueError(f'the controller has no command for q = {q.tolist()}, '
                             f'v = {v.tolist()}')
        spent = time.monotonic() - begin
        # Arrivals are delayed at random; the smallest recent lag gives the time of the state.
        self._lags.append(begin - t)
        sooner = min(begin, t + min(self._lags)) + assigned.task.plan_time - time.monotonic()
        if sooner > 0.0 and not self.settings.lockstep:
            time.sleep(sooner)
        self._stamp = stamp
        self._send(np.clip(u, -assigned.limits, assigned.limits))
        assigned.prediction.send(t, self._last)
        if self._silent:
            self.get_logger().info(f'{self._states}: usable states again after '
                                   f'{begin - self._answered:.3g} s', throttle_duration_sec=1.0)
        # Measured after the plan, since a long plan is not a silence.
        self._answered, self._silent = time.monotonic(), False
        self._times.append(spent)
        self._sent += 1
        self._late += spent > self._time and not self.settings.lockstep
        if self._plans.get_subscription_count():
            self._send_plan(t + assigned.prediction.delay)

    def _send_plan(self, begin: float) -> None:
        """Publish the states of the last plan, which begins at a time [s]; empty without one."""
        hamiltonian, controller = self._assigned.hamiltonian, self._assigned.controller
        message = JointTrajectory(joint_names=columns(hamiltonian.coordinates)[0])
        message.header.stamp = Time(nanoseconds=min(round(begin * 1e9), LATEST)).to_msg()
        if isinstance(controller, Planner) and controller.plan is not None \
                and np.isfinite(controller.plan).all():
            q, p = np.split(controller.plan, 2, axis=1)
            message.points = [JointTrajectoryPoint(
                positions=one, velocities=v,
                time_from_start=Duration(seconds=k * controller.interval).to_msg())
                for k, (one, v) in enumerate(zip(q, hamiltonian.gradient(q, p)[1], strict=True))]
        self._plans.publish(message)

    def _send(self, u: np.ndarray) -> None:
        """Publish a command; its stamp is that of the state that it answers."""
        assigned, names, self._last = self._assigned, [*self._assigned.task.inputs], u
        message: Any
        if self.settings.commands == 'commands':
            numbers = dict.fromkeys(assigned.numbers, 0.0) | dict(zip(names, u, strict=True))
            message = Float64MultiArray(data=[*numbers.values()])
        else:
            stamp = Time(nanoseconds=self._stamp).to_msg()
            message = JointState(header=Header(stamp=stamp), name=names, effort=u)
        self._commands.publish(message)

    def _rest(self) -> None:
        self._send(np.zeros(len(self._assigned.task.inputs)))

    def _watch(self) -> None:
        """Send zeros or hold the last command if no state comes, and log that once."""
        # In lockstep, simulated time waits, so that silence on the wall clock means nothing.
        if not self._active or self.settings.lockstep \
                or time.monotonic() - self._answered < self._silence:
            return
        cause = self._cause
        self._stamps.settle(paused=not cause)
        hold = self._assigned.task.on_silence == 'hold' and self._sent
        if not self._silent:
            self._silent = True
            self._assigned.prediction.reset()
            self.get_logger().warning(
                f'{self._states}: no usable state for {self._silence:g} s{cause}: '
                f'{"the last command is repeated" if hold else "commands are zero"} until one '
                'comes', throttle_duration_sec=1.0)
            if not hold:
                self._rest()
        if hold:
            self._send(self._last)

    @property
    def _cause(self) -> str:
        """Return the reason that incoming states are not answered; '' if none come."""
        if time.monotonic() - self._heard >= self._silence:
            return ''
        why = self._hearing.reasons.get(self._states, '') if self._refused else (
            'their stamps advance by less than a period; increase silence for a slow simulator')
        return f' ({why})' if why else ''

    @property
    def _stranger(self) -> str:
        """Return a warning if states come from another node than commands go to, else ''."""
        sources = nodes_of(self.get_publishers_info_by_topic(self._states))
        commanded = nodes_of(self.get_subscriptions_info_by_topic(self._topic))
        if not sources or {*sources} & {*commanded} or self._answered == math.inf:
            return ''
        states, topic = map(self.resolve_topic_name, (self._states, self._topic))
        return (f'{states} comes from {listed(sources)}, but {topic} goes to '
                f'{listed(commanded) or "no node"}: check the parameter simulator')

    def _report(self) -> None:
        """Publish the status of the controller."""
        assigned, controller = self._assigned, self._assigned.controller
        late, self._reported_late = self._late - self._reported_late, self._late
        ignored = self._hearing.ignored[self._states]
        level, message = OK, f'{assigned.task.controller.kind}: {controller.mode}'
        stranger = self._warn_of_stranger(self._stranger)
        # After the first answer, it is known if states come in parts.
        whole = self._answered < math.inf and not self._joiner.joins
        crowd = self._warn_of_crowd(publisher_conflicts(self, [
            *[self._states] * whole, self._topic, *[CLOCK_TOPIC] * follows_clock(self)]))
        apart = float(np.median(self._gaps)) if self._gaps else math.nan
        seldom = self._warn_of_gaps('' if not apart > _MAX_INTERVAL * assigned.task.period else (
            f'{self._states}: states arrive less often than every period of '
            f'{assigned.task.period:g} s; publish them more often, use smaller steps of /clock, '
            'or reduce the load of this machine'))
        if not self._active:
            message = 'inactive'
        elif self._silent:
            level, message = WARN, (f'no usable state for {time.monotonic() - self._answered:.3g} '
                                    f's{self._cause}')
        elif self._answered == math.inf:
            level, message = WARN, 'no usable state yet'
        elif late:
            level, message = WARN, (f'{late} plans since the last report took longer than their '
                                    f'limit, {self._time:g} s, and act late')
        elif crowd or (stranger and not self._commands.get_subscription_count()):
            level, message = WARN, crowd or stranger
        elif seldom:
            level, message = WARN, seldom
        elif stranger:
            # Expected if a broadcaster publishes the states, as with ros2_control.
            message += f'; {stranger}'
        times = np.array(self._times) if self._times else np.full(1, np.nan)
        self._diagnostics.publish([Status('control', level, message, {
            'mode': controller.mode, 'cost': float(controller.cost),
            'plan_time_median [s]': float(np.median(times)),
            'plan_time_p99 [s]': float(np.quantile(times, 0.99)),
            'plan_time_largest [s]': float(times.max()), 'period [s]': assigned.task.period,
            'from_command_to_command [s]': apart,
            'delay [s]': assigned.prediction.delay, 'commands [1]': self._sent,
            'late [1]': self._late, 'states_ignored [1]': ignored,
            'ignored_because': self._hearing.reasons.get(self._states, '')})],
            self._stamp, record=False)


def _compile_controller(assignment: Assignment) -> Assignment:
    """Call the controller before the first state, until everything is compiled."""
    q, p = (np.array(one) for one in (assignment.scene.initial_state.q,
                                      assignment.scene.initial_state.p))
    v = assignment.hamiltonian.gradient(q, p)[1]
    fast = 0
    for k in range(-_MAX_WARM_CALLS, 0):
        begin, t = time.monotonic(), k * assignment.task.period
        # A state off the plan forces the controller to plan again.
        assignment.controller(*assignment.prediction(t, q, v + 0.1 * (k % 3)), t)
        # A compilation uses up the budget of a plan, which then ends before all is compiled.
        fast = fast + 1 if time.monotonic() - begin < _MIN_COMPILE_TIME else 0
        if fast == _FAST_CALLS:
            break
    return assignment


def main(argv: list[str]) -> int:
    """Control until the node is shut down or a signal arrives."""
    command_lines.controller().parse_args(own_arguments(argv))
    with ros_process(argv) as received:
        node = ControllerNode(argv)
        try:
            node.serve(received, node.settings.autostart)
        finally:
            status = node.end(node.finish(received))
    return status
