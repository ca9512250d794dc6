# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Control of the progress of a run: start, stop, pause, single steps, reset."""

from abc import abstractmethod
from collections.abc import Callable
import gc
import json
import time
from typing import Any, NamedTuple

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.ros.plumbing.graph import Discovery, DISCOVERY_PERIOD
from hnn_vi_ros.ros.plumbing.managed_node import ManagedNode, steady_timer
from hnn_vi_ros.ros.run.lockstep import REPEAT_PERIOD
from hnn_vi_ros.ros.run.run import Run
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.run import LONGEST_CALL
from rclpy.task import Future
from rclpy.timer import Timer

# Wall time between two messages on /diagnostics [s].
_DIAGNOSTICS_PERIOD = 1.0
# Duration of a turn of the executor, which polls all services [s].
_TURN_TIME = 6e-4
# Longest wait for the compilation that a failing step needs; services answer within 2 s [s].
_MAX_COMPILE_WAIT = 1.0


class Answer(NamedTuple):
    """
    Result of a request, with the fields of std_srvs.

    If the request moved the run, the message ends in a JSON object with the new step and time.
    """

    success: bool
    message: str


class Control:
    """
    Control of a run with timers of the steady clock.

    Parameters
    ----------
    node : ManagedNode
        The simulator node.
    run : Run
        The run to drive.
    discovery : Discovery
        Discovery of subscribers, which the first step waits for.
    settings : Settings
        The node's parameters.

    Attributes
    ----------
    active, paused : bool
        True if the node is active; true if a pause was requested.
    stopped : bool
        True if the run waits at its initial state to be started, in contrast to a pause;
        simulation_interfaces distinguishes the two. Set by the caller that stops the run.

    """

    def __init__(self, node: ManagedNode, run: Run, discovery: Discovery, settings: Settings):
        self._node, self.run, self._discovery = node, run, discovery
        self.active, self.paused, self.stopped = False, settings.start_paused, True
        self.run.status.paused = self.paused
        self._timers: list[Timer] = []
        self._timer: Timer | None = None
        # Number of other nodes with the same name that were reported.
        self._namesakes = 0
        # Steps left and steps requested in the current request, and the future of its answer.
        self._left, self._asked = 0, 0
        self._waiting: Future | None = None
        self._progress: Callable[[int, int], None] | None = None
        self._moved, self._led = 0.0, run.pacer.led
        node.after_clock = self._on_clock
        if run.lockstep is not None:
            run.lockstep.on_answer = self._on_answer

    @property
    def running(self) -> bool:
        """Return True if simulated time advances by itself."""
        return self.active and not self.paused

    @property
    def ticking(self) -> bool:
        """Return True if the timer runs and fires again at once after each call."""
        return (self._timer is not None and not self._timer.is_canceled()
                and self.run.pacer.timer_period < LONGEST_CALL)

    def activate(self) -> None:
        """Start or resume the run; the first start waits for the discovery of subscribers."""
        self.active, self.stopped = True, False
        self._tell_clock()
        if self.paused:
            self.run.tell('paused until resumed with ~/set_pause', 'INFO')
        if self._timer is None and not self._timers:
            self._add_timer(DISCOVERY_PERIOD, self._start_when_discovered)
        self._schedule()

    def deactivate(self) -> None:
        """Pause the run and keep its state."""
        self.active = False
        self._end_request(Answer(False, 'the node was deactivated'))
        self._schedule()
        self.run.recording.flush()

    def stop(self) -> None:
        """Take no more steps, and publish the final diagnostics."""
        self.active = False
        self._end_request(Answer(False, 'the run has ended'))
        if self._timer is not None:
            self.run.publish_diagnostics()

    def close(self) -> None:
        """Destroy the timers."""
        self._end_request(Answer(False, 'the run has ended'))
        self._node.after_clock = lambda: None
        for timer in self._timers:
            self._node.destroy_timer(timer)
        self._timers.clear()

    def set_paused(self, paused: bool) -> Answer:
        """Pause or resume; a resumed run does not catch up on the time of the pause."""
        word = 'paused' if paused else 'running' if self.active else 'will run once active'
        self.stopped = False
        if paused != self.paused:
            self.paused = self.run.status.paused = paused
            self._end_request(Answer(False, 'the pause has ended'))
            self._schedule()
            self.run.tell('paused' if paused else 'pause ended', 'INFO')
            if paused:
                self.run.recording.flush()
        return Answer(True, f'{word} at t = {self.run.sampler.time:.9g} s')

    def request_steps(self, count: int, progress: Callable[[int, int], None] | None = None
                      ) -> Future:
        """
        Take steps during a pause; return a future of the Answer.

        Parameters
        ----------
        count : int
            Number of steps; later requests do not change it.
        progress : callable, optional
            Called after each batch with the numbers of steps taken and left. With it, the request
            waits while a failing step compiles its rescue; without it, the answer after a while is
            to try again.

        """
        future = Future()
        if not (self.active and self.paused):
            future.set_result(Answer(False, 'only possible while an active node is paused: pause '
                                            'it first'))
        elif self._waiting is not None:
            future.set_result(Answer(False, 'steps are already being taken'))
        elif count < 1:
            future.set_result(Answer(False, 'expected at least one step'))
        else:
            self._left, self._asked, self._moved = count, count, time.monotonic()
            self._waiting, self._progress, self.stopped = future, progress, False
            self._schedule()
        return future

    def cancel_steps(self, future: Future) -> None:
        """Cancel the remaining steps of the request with this future."""
        if self._waiting is future:
            self._end_request(Answer(False, 'cancelled'))
            self._schedule()

    def reset(self, time_too: bool) -> Answer:
        """Return to the initial state; the run stays running or paused."""
        self._end_request(Answer(False, 'the simulation was reset'))
        try:
            self.run.reset(time_too)
        except (ValueError, StepFailure) as problem:
            return Answer(False, f'not reset: the initial state is invalid: {problem}')
        finally:
            self._schedule()
        self.run.tell('reset', 'INFO')
        simulation = self.run.simulation
        return Answer(True, self._where(q=simulation.q.tolist(), p=simulation.p.tolist(),
                                        reset_time=time_too))

    def reset_time(self) -> Answer:
        """Restart simulated time at the current state; later resets keep the initial state."""
        run, start = self.run, self.run.start
        run.start = run.simulation.q.copy(), run.simulation.p.copy()
        try:
            return self.reset(True)
        finally:
            run.start = start

    def set_period(self) -> None:
        """Apply a change of the pace."""
        if self._timer is not None:
            self._timer.timer_period_ns = round(self.run.pacer.timer_period * 1e9)
        if self._led != self.run.pacer.led:
            self._led = not self._led
            self.run.start_clocks()
            self._tell_clock()

    def _schedule(self) -> None:
        """Start the timer if there is anything to do, else cancel it; discard any backlog."""
        if self._timer is None:
            return
        self.run.start_clocks()
        if self.active and (not self.paused or self._waiting is not None):
            self._timer.reset()
        else:
            self._timer.cancel()

    def _start_when_discovered(self) -> None:
        """Start once discovery is complete."""
        if self._discovery.over:
            self._node.destroy_timer(self._timers.pop())
            # The preparation froze the older objects; this freezes those created since.
            gc.freeze()
            self._warn_of_namesakes()
            self.run.watch()
            self._add_timer(_DIAGNOSTICS_PERIOD, self._publish_diagnostics)
            if self.run.lockstep is not None:
                self._add_timer(REPEAT_PERIOD, self._watch_lockstep)
            self._timer = self._add_timer(self.run.pacer.timer_period, self._on_timer)
            self._schedule()

    def _publish_diagnostics(self) -> None:
        # Nodes of the same name may be discovered after the start.
        self._warn_of_namesakes()
        self.run.publish_diagnostics()

    def _warn_of_namesakes(self) -> None:
        node = self._node
        own = (node.get_name(), node.get_namespace())
        others = node.get_node_names_and_namespaces().count(own) - 1
        before, self._namesakes = self._namesakes, others
        if others > before:
            self.run.tell(
                f'{others} more nodes of the graph have the name '
                f'{node.get_fully_qualified_name()}: service calls may reach them instead; rename '
                f'one, for example with --ros-args -r __node:={own[0]}_2', 'WARN')

    def _add_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        timer = steady_timer(self._node, period, callback)
        self._timers.append(timer)
        return timer

    def _tell_clock(self) -> None:
        if self._led:
            self.run.tell('follows /clock, since use_sim_time is true', 'INFO')

    def _on_clock(self) -> None:
        """Follow /clock as soon as it advances."""
        if self._timer is not None and not self._timer.is_canceled():
            self._on_timer()

    def _on_answer(self) -> None:
        """Continue as soon as the awaited command has arrived."""
        if self._timer is not None and self.active and (
                not self.paused or self._waiting is not None):
            self._timer.reset()
            self._on_timer()

    def _watch_lockstep(self) -> None:
        self.run.watch_lockstep(self.active and (not self.paused or self._waiting is not None))

    def _on_timer(self) -> None:
        """
        Take steps for a short time, in batches, so that signals and other callbacks get a turn.

        If ticks are shorter than this time, the wait for them is here, and the executor gets its
        turn during a wait that is long enough. Commands are taken after each tick.
        """
        run, begin = self.run, time.monotonic()
        until = begin + LONGEST_CALL
        while self.active and (now := time.monotonic()) < until:
            if run.locked:
                # The command that is awaited starts the timer again.
                if self._timer is not None:
                    self._timer.cancel()
                return
            if self.paused:
                if self._waiting is None:
                    return
                self._take_requested()
            elif run.at_sample and not run.pacer.due():
                wait = run.pacer.wait
                if now + wait + _TURN_TIME > until or (
                        wait > _TURN_TIME and now > begin + 0.8 * LONGEST_CALL):
                    return
                time.sleep(max(wait, 0.0))
            elif (taken := run.step()) is None:
                time.sleep(LONGEST_CALL)
            elif taken == 0:
                # Otherwise the run has ended, and has said so.
                if self._node.exit_status is not None:
                    return
                self.set_paused(True)
            elif (run.at_sample and run.pacer.asked and not run.pacer.led
                  and run.simulation.motors.takes):
                return

    def _take_requested(self) -> None:
        """Take a batch of the requested steps; publish the state after the last one."""
        taken = self.run.step(self._left)
        if taken is None:
            time.sleep(LONGEST_CALL)
            if time.monotonic() - self._moved > _MAX_COMPILE_WAIT and self._progress is None:
                self._end_request(Answer(False, 'a step failed, and its rescue is being compiled: '
                                                'try again'))
                self._schedule()
            return
        self._left, self._moved = self._left - taken, time.monotonic()
        if taken and self._progress is not None:
            self._progress(self._asked - self._left, self._left)
        if taken == 0:
            why = 'an event ended the run' if self._node.exit_status == 0 else 'a step failed'
            self._end_request(Answer(False, f'{why}: the state is the last good one'))
            self._schedule()
        elif self._left == 0 and self._waiting is not None:
            if not self.run.at_sample:
                self.run.show_state()
            self._end_request(Answer(True, ''))
            self._schedule()

    def _end_request(self, answer: Answer) -> None:
        """Answer the current request for steps, if any, with the number of steps taken."""
        if self._waiting is not None:
            words = [answer.message] * bool(answer.message)
            where = self._where(steps=self._asked - self._left)
            waiting, self._waiting, self._left = self._waiting, None, 0
            waiting.set_result(Answer(answer.success, ': '.join([*words, where])))
            self._node.spinner.wake()

    def _where(self, **figures: Any) -> str:
        """Return values together with the current step, time [s] and stamp [ns] as JSON."""
        run = self.run
        return json.dumps(figures | {'step': run.simulation.steps, 'time': run.sampler.time,
                                     'stamp': run.sampler.stamp})


class Simulator(ManagedNode):
    """
    The simulator node as its services use it.

    Attributes
    ----------
    run, control : Run, Control or None
        The simulation and its control; None while the node is not configured.
    scene_of_the_start : str
        Scene that the user has named.

    """

    scene_of_the_start = ''
    run: Run | None = None
    control: Control | None = None

    @property
    @abstractmethod
    def settings(self) -> Settings:
        """Return the parameters."""

    @property
    @abstractmethod
    def refusal(self) -> str:
        """Return the reason that there is no run to act on."""
