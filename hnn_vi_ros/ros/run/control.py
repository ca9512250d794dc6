# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Control of when a run advances: start, halt, pause, steps by number, reset."""

from abc import abstractmethod
from collections.abc import Callable
import gc
import json
import time
from typing import Any, NamedTuple

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.ros.plumbing.graph import Discovery, DISCOVERY_PERIOD
from hnn_vi_ros.ros.plumbing.managed_node import ManagedNode, steady_timer
from hnn_vi_ros.ros.run.run import Run
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.run import LONGEST_CALL
from rclpy.task import Future
from rclpy.timer import Timer

# Wall time between two messages on /diagnostics [s].
_DIAGNOSTICS_PERIOD = 1.0
# A turn of the executor, which looks through all services, takes about so long [s].
_TURN = 6e-4
# A service is answered within two seconds: so long it waits for what takes a failing step [s].
_LONGEST_WAIT = 1.0


class Answer(NamedTuple):
    """
    Result of a request, in the terms of std_srvs.

    The message of one that moved the run ends in a JSON object: where the run stands by it.
    """

    success: bool
    message: str


class Control:
    """
    Drive a run by timers of the steady clock.

    Parameters
    ----------
    node : ManagedNode
        The simulator.
    run : Run
        The run to drive.
    discovery : Discovery
        The first step waits for it.
    settings : Settings
        The node's parameters.

    Attributes
    ----------
    active, paused : bool
        Whether the node is active, and whether a pause was asked for.
    stopped : bool
        Whether the run waits at its initial state to be played, rather than in a pause: a
        difference that simulation_interfaces makes. Whoever stops it sets this.

    """

    def __init__(self, node: ManagedNode, run: Run, discovery: Discovery, settings: Settings):
        self._node, self.run, self._discovery = node, run, discovery
        self.active, self.paused, self.stopped = False, settings.start_paused, True
        self.run.status.paused = self.paused
        self._timers: list[Timer] = []
        self._timer: Timer | None = None
        # How many nodes of this one's name have been told of.
        self._namesakes = 0
        # Steps of the request that is being worked on, and who waits for its end.
        self._left, self._asked = 0, 0
        self._waiting: Future | None = None
        self._progress: Callable[[int, int], None] | None = None
        self._moved, self._led = 0.0, run.pacer.led
        node.after_clock = self._on_clock

    @property
    def running(self) -> bool:
        """Return whether simulated time advances by itself."""
        return self.active and not self.paused

    @property
    def ticking(self) -> bool:
        """Return whether the timer runs, and calls at once again after each call."""
        return (self._timer is not None and not self._timer.is_canceled()
                and self.run.pacer.timer_period < LONGEST_CALL)

    def activate(self) -> None:
        """Go on, for the first time once subscribers that are there have been found."""
        self.active, self.stopped = True, False
        self._tell_clock()
        if self.paused:
            self.run.tell('paused until ~/set_pause ends it', 'INFO')
        if self._timer is None and not self._timers:
            self._add_timer(DISCOVERY_PERIOD, self._start_when_discovered)
        self._schedule()

    def deactivate(self) -> None:
        """Stand still and keep everything."""
        self.active = False
        self._end_request(Answer(False, 'the node was deactivated'))
        self._schedule()
        self.run.recording.flush()

    def stop(self) -> None:
        """Take no more steps, and report how the run has ended."""
        self.active = False
        self._end_request(Answer(False, 'the run has ended'))
        if self._timer is not None:
            self.run.publish_diagnostics()

    def close(self) -> None:
        """Take the timers away."""
        self._end_request(Answer(False, 'the run has ended'))
        self._node.after_clock = lambda: None
        for timer in self._timers:
            self._node.destroy_timer(timer)
        self._timers.clear()

    def set_paused(self, paused: bool) -> Answer:
        """Pause or go on; what was missed in a pause is not caught up with."""
        word = 'paused' if paused else 'running' if self.active else 'to run once active'
        self.stopped = False
        if paused != self.paused:
            self.paused = self.run.status.paused = paused
            self._end_request(Answer(False, 'the pause was ended'))
            self._schedule()
            self.run.tell('paused' if paused else 'pause ended', 'INFO')
            if paused:
                self.run.recording.flush()
        return Answer(True, f'{word} at t = {self.run.sampler.time:.9g} s')

    def request_steps(self, count: int, progress: Callable[[int, int], None] | None = None
                      ) -> Future:
        """
        Take so many steps in the pause; return what will hold the Answer.

        Parameters
        ----------
        count : int
            How many: what others ask for from now on does not change it.
        progress : callable, optional
            Told after each batch how many were taken, and how many are left. Who hears of
            progress waits as long as a failing step takes to compile its rescue; others are
            told to ask again.

        """
        future = Future()
        if not (self.active and self.paused):
            future.set_result(Answer(False, 'only in a pause of an active node: pause it first'))
        elif self._waiting is not None:
            future.set_result(Answer(False, 'steps are being taken already'))
        elif count < 1:
            future.set_result(Answer(False, 'expected at least one step'))
        else:
            self._left, self._asked, self._moved = count, count, time.monotonic()
            self._waiting, self._progress, self.stopped = future, progress, False
            self._schedule()
        return future

    def cancel_steps(self, future: Future) -> None:
        """Take no more steps of the request that this future was returned for."""
        if self._waiting is future:
            self._end_request(Answer(False, 'cancelled'))
            self._schedule()

    def reset(self, time_too: bool) -> Answer:
        """Go back to the initial state, running or paused as before."""
        self._end_request(Answer(False, 'the simulation was reset'))
        try:
            self.run.reset(time_too)
        except (ValueError, StepFailure) as problem:
            return Answer(False, f'not reset: the initial state is refused: {problem}')
        finally:
            self._schedule()
        self.run.tell('reset', 'INFO')
        simulation = self.run.simulation
        return Answer(True, self._where(q=simulation.q.tolist(), p=simulation.p.tolist(),
                                        reset_time=time_too))

    def reset_time(self) -> Answer:
        """Restart simulated time from the current state; resets go back as before."""
        run, start = self.run, self.run.start
        run.start = run.simulation.q.copy(), run.simulation.p.copy()
        try:
            return self.reset(True)
        finally:
            run.start = start

    def set_period(self) -> None:
        """Follow a change of the pace."""
        if self._timer is not None:
            self._timer.timer_period_ns = round(self.run.pacer.timer_period * 1e9)
        if self._led != self.run.pacer.led:
            self._led = not self._led
            self.run.start_clocks()
            self._tell_clock()

    def _schedule(self) -> None:
        """Let the timer run while there is something to do, owing nothing as of now."""
        if self._timer is None:
            return
        self.run.start_clocks()
        if self.active and (not self.paused or self._waiting is not None):
            self._timer.reset()
        else:
            self._timer.cancel()

    def _start_when_discovered(self) -> None:
        """Start once discovery is over."""
        if self._discovery.over:
            self._node.destroy_timer(self._timers.pop())
            # The preparation froze the rest; this freezes the objects made since.
            gc.freeze()
            self._warn_of_namesakes()
            self.run.watch()
            self._add_timer(_DIAGNOSTICS_PERIOD, self._publish_diagnostics)
            self._timer = self._add_timer(self.run.pacer.timer_period, self._on_timer)
            self._schedule()

    def _publish_diagnostics(self) -> None:
        # Discovery may take longer than the start.
        self._warn_of_namesakes()
        self.run.publish_diagnostics()

    def _warn_of_namesakes(self) -> None:
        node = self._node
        own = (node.get_name(), node.get_namespace())
        others = node.get_node_names_and_namespaces().count(own) - 1
        before, self._namesakes = self._namesakes, others
        if others > before:
            self.run.tell(
                f'{others} more of the graph are called {node.get_fully_qualified_name()}: calls '
                'of services may reach them instead; name one, such as: --ros-args -r '
                f'__node:={own[0]}_2', 'WARN')

    def _add_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        timer = steady_timer(self._node, period, callback)
        self._timers.append(timer)
        return timer

    def _tell_clock(self) -> None:
        if self._led:
            self.run.tell('follows /clock, which use_sim_time asks for', 'INFO')

    def _on_clock(self) -> None:
        """Follow /clock as soon as it goes on."""
        if self._timer is not None and not self._timer.is_canceled():
            self._on_timer()

    def _on_timer(self) -> None:
        """
        Step for a short while, in batches, so that signals and other callbacks get a turn.

        Ticks that are shorter than this while are waited for here, and the executor has its turn
        in a wait that is long enough for it. Commands are heard after each tick.
        """
        run, begin = self.run, time.monotonic()
        until = begin + LONGEST_CALL
        while self.active and (now := time.monotonic()) < until:
            if self.paused:
                if self._waiting is None:
                    return
                self._take_requested()
            elif run.at_sample and not run.pacer.due():
                wait = run.pacer.wait
                if now + wait + _TURN > until or (
                        wait > _TURN and now > begin + 0.8 * LONGEST_CALL):
                    return
                time.sleep(max(wait, 0.0))
            elif (taken := run.step()) is None:
                time.sleep(LONGEST_CALL)
            elif taken == 0:
                self.set_paused(True)
            elif (run.at_sample and run.pacer.asked and not run.pacer.led
                  and run.simulation.motors.takes):
                return

    def _take_requested(self) -> None:
        """Take a batch of the steps that were asked for; show where they end."""
        taken = self.run.step(self._left)
        if taken is None:
            time.sleep(LONGEST_CALL)
            if time.monotonic() - self._moved > _LONGEST_WAIT and self._progress is None:
                self._end_request(Answer(False, 'a step fails, and what takes such steps is '
                                         'being compiled: ask again'))
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
        """Answer a request for steps, if there is one, with the number of steps taken."""
        if self._waiting is not None:
            words = [answer.message] * bool(answer.message)
            where = self._where(steps=self._asked - self._left)
            waiting, self._waiting, self._left = self._waiting, None, 0
            waiting.set_result(Answer(answer.success, ': '.join([*words, where])))
            self._node.spinner.wake()

    def _where(self, **figures: Any) -> str:
        """Return figures, and at which step, time [s] and stamp [ns] the run stands, as JSON."""
        run = self.run
        return json.dumps(figures | {'step': run.simulation.steps, 'time': run.sampler.time,
                                     'stamp': run.sampler.stamp})


class Simulator(ManagedNode):
    """
    The simulator as its services need it.

    Attributes
    ----------
    run, control : Run, Control or None
        The simulation and its control; None while the node is not configured.

    """

    run: Run | None = None
    control: Control | None = None

    @property
    @abstractmethod
    def settings(self) -> Settings:
        """Return the parameters."""

    @property
    @abstractmethod
    def refusal(self) -> str:
        """Return why there is no run to act on."""
