# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A configured run: one scene from its initial state, with its messages, files and figures."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
import math
import time
from typing import Any

from hnn_vi_ros.errors import ParameterError, prefixed, StepFailure, StoppedByEvent
from hnn_vi_ros.files import dump_yaml, parse_mapping
from hnn_vi_ros.hamiltonians import Payload, payload_of
from hnn_vi_ros.phase_space import energy_unit
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros.plumbing.graph import publisher_conflicts, RepetitionFilter
from hnn_vi_ros.ros.plumbing.managed_node import CLOCK_TOPIC, PaceClock
from hnn_vi_ros.ros.plumbing.rclpy_internals import log
from hnn_vi_ros.ros.run.health import Health, RunStatus, STEP_FAILED
from hnn_vi_ros.ros.run.preparation import PreparedRun
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.companions import SpreadTopic, TwinTopic
from hnn_vi_ros.ros.topics.diagnostics import (
    DiagnosticsPublisher, EVENT, OK, state_values, Status, WARN)
from hnn_vi_ros.ros.topics.inputs import JOINT_COMMANDS, OBSERVATIONS
from hnn_vi_ros.ros.topics.joining import ObservationJoiner
from hnn_vi_ros.ros.topics.outputs import ConfiguredRun, DIAGNOSTICS, EVENTS, PREDICTION_ERROR
from hnn_vi_ros.ros.topics.topics import Topics
from hnn_vi_ros.run import (
    LONGEST_CALL, Monitor, OverrunGuard, Pacer, Sampler, StatusLine, with_companions)
from hnn_vi_ros.simulation import (
    Alarm, BoxGuard, EnergyGuard, make_guards, PathReport, RescuePending, RunFacts, watched,
    WatchedSimulation)
from rclpy.node import Node


class Run:
    """
    Run of a scene with its outputs; Control decides when it advances.

    Parameters
    ----------
    node : Node
        The simulator node.
    topics : Topics
        Topics of the node.
    prepared : Prepared
        The scene and its compiled parts.
    settings : Settings
        The node's parameters.
    stop : callable
        Ends the process, given its exit status and the reason.

    Attributes
    ----------
    scene, simulation, recording, pacer, sampler
        The parts that are used elsewhere.
    start : tuple of np.ndarray, shape (d,)
        q and p at which the next reset begins; may be assigned.

    """

    def __init__(self, node: Node, topics: Topics, prepared: PreparedRun, settings: Settings,
                 stop: Callable[[int, str], None]):
        self._node, self._topics, self._stop, self._settings = node, topics, stop, settings
        self.scene, self.recording = prepared.scene, prepared.recording
        self._chosen = prepared.chosen
        self._watched = simulation = watched(prepared.simulation, prepared.scene)
        self._members = prepared.members
        uncertainty = prepared.scene.uncertainty
        self._spread = None if self._members is None or uncertainty is None else SpreadTopic(
            self._members, simulation.hamiltonian, uncertainty.limit)
        self._twin = prepared.twin
        self._twin_topic = None if self._twin is None else TwinTopic(
            self._twin, partial(topics.send, PREDICTION_ERROR), lambda: (
                topics.subscriptions.ignored[OBSERVATIONS.topic],
                topics.subscriptions.reasons.get(OBSERVATIONS.topic, '')),
            lambda: self.sampler.stamp, lambda text: self.tell(text, 'WARN'))
        self._joiner = None if self._twin is None else ObservationJoiner(
            self._twin.names, self._twin.timeout, lambda: self.sampler.stamp,
            lambda: node.get_clock().now().nanoseconds)
        self.simulation = with_companions(
            simulation, [one for one in (self._members, self._twin) if one is not None])
        # The initial states of the scene, of the run since its last reset, and of the next reset.
        self._own_start = self._began_at = self.start = (
            self.simulation.q.copy(), self.simulation.p.copy())
        self._batch, self._last_step, self._waits = 1, math.inf, False
        # True if the guards are due; one sample after the figures, as both exceed a short tick.
        self._look_next = False
        # Value of the parameter that acts; empty for the payload of the scene.
        self._payload = ''
        self.sampler = Sampler(self.simulation, settings.publish_rate, prepared.origin)
        clock = PaceClock(node)
        self.pacer = Pacer(self.sampler.tick, settings.real_time_factor, clock, lambda: clock.led)
        self._diagnostics = DiagnosticsPublisher(
            node, partial(topics.send, DIAGNOSTICS), self.scene.name)
        self._warn_of_crowd = RepetitionFilter(lambda text: self.tell(text, 'WARN'))
        self.lockstep = prepared.lockstep
        self._path_error = PathReport.of(self.scene)
        monitor = self._make_monitor()
        self._status = StatusLine(node.get_logger().info, monitor.energy.energy_unit)
        topics.open(
            ConfiguredRun(self.simulation, monitor, prepared.box, self.scene.mechanism,
                          settings.frame_id, bool(self.scene.events), self._spread,
                          prepared.sensor),
            lambda: self.sampler.stamp, self.recording.write_other, self._joiner,
            None if self.lockstep is None else self.lockstep.take)
        self._events = DiagnosticsPublisher(node, partial(topics.send, EVENTS), self.scene.name)
        self._begin(monitor)
        self._tell_scene(prepared.report)
        for line in prepared.log_lines:
            self.tell(*line)
        if self.sampler.deviation:
            node.get_logger().warning(self.sampler.deviation)

    def _make_monitor(self) -> Monitor:
        sampler, settings = self.sampler, self._settings
        self._path_error.follow(self.simulation, sampler.count(settings.duration) * sampler.every)
        facts = RunFacts(self.simulation, settings.energy_band_limit, settings.energy_change_limit)
        guards = [*make_guards(facts)]
        if settings.real_time_factor:
            guards.append(OverrunGuard(self.pacer, self.recording.slow_disk))
        if self._spread is not None:
            guards.append(self._spread.make_guard())
        return Monitor(
            self.simulation, sampler.every, sampler.tick, self._chosen and self._chosen.tolerance,
            lambda text, first: self.tell(text, 'WARN', first), guards, facts.scale)

    def _begin(self, monitor: Monitor) -> None:
        """Start monitoring and recording from the initial state."""
        scene, settings, self._monitor = self.scene, self._settings, monitor
        samples = self.sampler.count(settings.duration)
        self._last_step = self.simulation.steps + samples * self.sampler.every
        self.recording.event(', '.join([
            f'{scene.name}: {scene.integrator.kind}', f'h = {scene.step_size:g} s',
            *(effect.kind for effect in scene.effects),
            'conservative' if self.simulation.conservative else 'not conservative']), 'INFO')
        # Stamp of the newest sample.
        self._stamp = self.sampler.stamp
        self._health = Health(
            self.sampler.stamp_at, monitor.guards, self._diagnostics, self.recording,
            lambda text, level: self.tell(text, level, show=False), self._errors())
        self.status = RunStatus(scene, self.simulation, self.sampler, monitor, self.recording,
                                self._health, self._path_error)

    def _tell_scene(self, report: dict[str, Any]) -> None:
        self._report = report
        self._topics.publish_scene(dump_yaml(report))

    def _errors(self) -> list[str]:
        return [STEP_FAILED, EnergyGuard.kind, *[BoxGuard.kind] * self._settings.stop_outside_box]

    def tell(self, text: str, level: str, show: bool = True) -> None:
        """Log a line, and display it with the samples; level is INFO, WARN or ERROR."""
        log(self._node, text, level)
        if show:
            self.recording.event(text, level)

    def watch(self, sample: Sample | None = None, at_once: bool = True) -> None:
        """Publish the alarms of a sample, by default of the current state; stop if configured."""
        self._report_alarms(self._monitor.watch(sample or self.sampler.sample(), at_once))

    def _report_alarms(self, alarms: Iterable[tuple[Alarm, int]]) -> None:
        for alarm, step in alarms:
            stamp = self.sampler.stamp_at(step)
            self._health.add(alarm, stamp)
            if alarm.kind == BoxGuard.kind and self._settings.stop_outside_box:
                self._stop(1, f'stopped by stop_outside_box at t = {stamp / 1e9:.9g} s')

    def publish_diagnostics(self) -> None:
        """Publish the status of each component."""
        self._report_alarms(self._monitor.look())
        more = [one.status() for one in (self._spread, self._twin_topic) if one is not None]
        crowd = publisher_conflicts(self._node, self._topics.sole(
            self.pacer.led, self._joiner is not None and self._joiner.joins))
        if self.pacer.led and not self._node.count_publishers(CLOCK_TOPIC):
            crowd = (f'{CLOCK_TOPIC} has no publisher, but use_sim_time is true: publish it, or '
                     'set use_sim_time to false')
        crowd = self._warn_of_crowd(crowd)
        if crowd:
            more.append(Status('graph', WARN, crowd, {}))
        self._diagnostics.publish(
            [*self.status.statuses(self.pacer), *more], self.sampler.stamp, record=False)

    def start_clocks(self) -> None:
        """Discard any backlog, and measure the pace from now on."""
        self.pacer.restart()
        self._monitor.timing.restart()
        self._status.restart(self.sampler.stamp)

    @property
    def at_sample(self) -> bool:
        """Return True if the next step is the first after a sample."""
        return self.simulation.steps % self.sampler.every == 0

    @property
    def locked(self) -> bool:
        """Return True while the answer to a sample is awaited."""
        return self.lockstep is not None and self.lockstep.awaited is not None

    def watch_lockstep(self, going: bool) -> None:
        """Publish an awaited state again, and end too long a wait of a run that is `going`."""
        if self.lockstep is not None and (reason := self.lockstep.check(
                going, self._node.count_publishers(
                    self._node.resolve_topic_name(JOINT_COMMANDS.topic)),
                self._topics.publish_again, self.tell)):
            self._stop(1, reason)

    def step(self, most: float = math.inf) -> int | None:
        """
        Take a batch of steps, at most to the next sample, which is then published.

        Returns
        -------
        int or None
            Number of steps; 0 if a step failed or an event ended the run. A failure ends the
            process, unless incoming messages may have caused it: these must not end a node. None
            if a step fails whose rescue is still being compiled: the next call tries it again.

        """
        simulation, every = self.simulation, self.sampler.every
        n = int(min(self._batch, every - simulation.steps % every, most))
        try:
            taken, seconds = self._monitor.advance(n, LONGEST_CALL)
        except RescuePending:
            if not self._waits:
                self._waits = True
                self.tell(f'waits at t = {self.sampler.time:.9g} s: a step failed, and its rescue '
                          'is being compiled, once', 'WARN')
            return None
        except StoppedByEvent as stop:
            self._hand_out_events()
            self._finish_second_run()
            self._stop(0, f'stopped by the event {stop.event.when}')
            return 0
        except StepFailure as failure:
            self._health.add_failure(
                failure.dated(self.sampler.time), simulation.steps, self._stamp)
            where = f'at the last good state, t = {self.sampler.time:.9g} s'
            # Incoming messages may have caused the failure.
            if self.simulation.motors.takes or self._began_at is not self._own_start:
                why = self._twin.unstable if self._twin is not None else ''
                self.tell(f'paused {where}{why and f": {why}"}; reset it', 'ERROR')
            else:
                self._stop(1, f'stopped {where}')
            return 0
        self._waits = False
        self._hand_out_events()
        if n == self._batch:
            self._batch = 2 * n if seconds < 0.2 * LONGEST_CALL else max(1, n // 2)
        if self.at_sample:
            self._hand_out()
            if simulation.steps >= self._last_step:
                self._finish_second_run()
                self._stop(0, self.sampler.end)
        return taken

    def _finish_second_run(self) -> None:
        """Wait for the path error of the whole run, and report it."""
        self._report_alarms((alarm, alarm.step) for _, alarm in self._path_error.finish())
        self.tell(str(self._path_error), 'INFO')

    def _hand_out_events(self) -> None:
        """
        Publish, record, display and log the events since the last call.

        Each event is one message with one status, stamped with the time of the event. The status
        describes the event in its message; its values are the condition, the direction, the time,
        the named q and p, and H, in full precision.
        """
        if not isinstance(self._watched, WatchedSimulation):
            return
        for event in self._watched.take_events():
            (stamp, step), text = self.sampler.place_of(event.t), str(event)
            coordinates = self.simulation.hamiltonian.coordinates
            self._events.publish([Status(EVENT, OK, text, {
                'when': event.when, 'direction': event.direction, 't [s]': repr(stamp / 1e9)}
                | state_values(coordinates, event.q, event.p)
                | {f'H [{energy_unit(coordinates)}]': repr(event.energy)})], stamp)
            self.recording.event(text, 'INFO', (stamp, step))
            log(self._node, text, 'INFO')

    def _hand_out(self) -> None:
        """Publish, record and display a sample; the log gets the same bytes that are published."""
        begin = time.perf_counter()
        sample = self._sample()
        self._stamp = sample.stamp
        self._monitor.add(sample)
        payloads = self._topics.publish(sample)
        # Slow work follows the publication, which it would otherwise delay.
        self.recording.write(sample, payloads)
        if self.lockstep is not None and self._topics.has_joint_states:
            self.lockstep.observe(sample, sample.step >= self._last_step)
        look, self._look_next = self._look_next, self._monitor.evaluate()
        if self._look_next:
            self.recording.timing(self._monitor.timing.figures)
        self.watch(sample, look or self.status.paused or self._must_stop(sample))
        self._status.show(sample, self.pacer.overruns, self._monitor.energy.unit == '1')
        self._monitor.timing.add_sample(time.perf_counter() - begin)

    def _must_stop(self, sample: Sample) -> bool:
        return self._settings.stop_outside_box and any(
            guard.outside(sample) for guard in self._monitor.guards
            if isinstance(guard, BoxGuard))

    def _sample(self) -> Sample:
        """Return a sample of the state, with the spread if there are members."""
        sample = self.sampler.sample()
        return sample if self._members is None else replace(sample, spread=self._members.spread)

    def show_state(self) -> None:
        """Publish and record a state between two samples; guards watch samples only."""
        sample = self._sample()
        self._stamp = sample.stamp
        # Uncertainty bands are published with samples only.
        self.recording.write(sample, self._topics.publish(replace(sample, spread=None)))

    def reset(self, time_too: bool) -> None:
        """
        Restart in new files; the steps are the same as in any run from that state.

        Parameters
        ----------
        time_too : bool
            True to restart the stamps too; otherwise they continue.

        Raises
        ------
        ValueError, StepFailure
            The initial state is invalid; the run is unchanged, and resets use the previous one.

        """
        self._report_alarms(self._monitor.look())
        origin = 0 if time_too else self.sampler.stamp
        before = self.simulation.snapshot()
        try:
            self.simulation.restart(*self.start)
        except (ValueError, StepFailure) as problem:
            self.start = self._began_at
            self.simulation.restart(*self._began_at)
            self.simulation.restore(before)
            if isinstance(problem, StepFailure):
                raise problem.dated(origin / 1e9) from problem
            raise
        self._began_at = self.start
        # The new files contain the new initial state.
        q, p = (part.tolist() for part in self._began_at)
        self.scene = self.scene.changed({'initial_state': {'q': q, 'p': p}})
        self.sampler = Sampler(self.simulation, self._settings.publish_rate, origin)
        if self.lockstep is not None:
            self.lockstep.release()
        monitor = self._make_monitor()
        self._topics.follow(monitor)
        report = self._report | {
            'initial_state': self.scene.initial_state.model_dump(), 'origin': origin,
            'first_step': 0}
        self._status.close()
        self.recording.renew(self.scene, report, self.sampler)
        self._tell_scene(report)
        paused = self.status.paused
        self._begin(monitor)
        self.status.paused = paused
        if self._payload:
            self._topics.load(self.payload_in(self._settings))
        self.watch()

    def payload_in(self, settings: Settings) -> Payload:
        """Return the payload of the parameters, by default that of the scene."""
        carrier, text = self.simulation.hamiltonian.carrier, settings.payload
        with prefixed(f'parameter payload = {text[:80]!r}', ParameterError):
            if carrier is None:
                raise ValueError('the robot of the scene has none; add payload: {link: LINK}')
            payload = carrier.payload if not text else payload_of({
                'link': carrier.payload.link,
                **parse_mapping(text, 'parameter payload', ParameterError)[0]})
            carrier.numbers(payload)
        return payload

    def apply(self, settings: Settings) -> None:
        """Apply changed parameters."""
        if settings.payload != self._payload:
            self._payload = settings.payload
            self._topics.load(self.payload_in(settings))
        if settings.real_time_factor != self._settings.real_time_factor:
            self.pacer.set_pace(settings.real_time_factor)
            self.start_clocks()
            guards = self._monitor.guards
            if self.pacer.asked and not any(isinstance(guard, OverrunGuard) for guard in guards):
                guards.append(OverrunGuard(self.pacer, self.recording.slow_disk))
        for guard in self._monitor.guards:
            guard.allow(settings.energy_band_limit, settings.energy_change_limit)
        self._settings = settings
        self._health.errors = self._errors()

    def close(self) -> bool:
        """Close and report the files, without ROS; return True if they are complete."""
        self._path_error.close()
        if not self._path_error.finished:
            self.tell(str(self._path_error), 'INFO')
        self._status.close()
        complete = self.recording.close()
        self.recording.report()
        return complete
