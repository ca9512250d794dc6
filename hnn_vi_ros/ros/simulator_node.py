# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node: parameters, scene, and on each tick steps, messages, log and picture."""

import signal
import time
import warnings

from hnn_vi_ros.errors import ParameterError, StepFailure
from hnn_vi_ros.guards import BoxGuard, EnergyGuard
from hnn_vi_ros.ros.choosing import resolve
from hnn_vi_ros.ros.diagnostics_publisher import DiagnosticsPublisher
from hnn_vi_ros.ros.health import Health, make_guards, STEP_FAILED
from hnn_vi_ros.ros.look_ahead import look_ahead
from hnn_vi_ros.ros.monitor import Monitor
from hnn_vi_ros.ros.pacing import OverrunGuard, Pacer
from hnn_vi_ros.ros.parameters import declare_parameters
from hnn_vi_ros.ros.recording import Recording
from hnn_vi_ros.ros.run_status import RunStatus
from hnn_vi_ros.ros.sampling import Sampler
from hnn_vi_ros.ros.scene_report import scene_report
from hnn_vi_ros.ros.status_line import StatusLine
from hnn_vi_ros.ros.topics import Topics
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.sinks.sample import Sample
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

# One timer call works at most this long, so that the executor stays responsive [s].
_LONGEST_CALL = 0.02
# Subscribers whose number has not changed for so long are taken for all there are [s].
_SETTLED = 0.5
# Simulated time of which the picture leaves room, at the pace of the clock [s].
_SEEN = 30.0
# Wall time between two samples beyond which a pace is taken for a mistake [s].
_LONGEST_WAIT = 1e6
# Wall time between two messages on /diagnostics [s].
_DIAGNOSTICS_PERIOD = 1.0


class SimulatorNode(Node):
    """
    Simulate a scene at a given pace, publish it, record it and show it.

    Attributes
    ----------
    exit_status : int or None
        None while the simulation goes on; then what the process is to return.
    topics : Topics
        What the node publishes and hears.

    Raises
    ------
    HnnViRosError
        A parameter, the scene or its model is not usable; one line.

    """

    def __init__(self):
        super().__init__('hnn_simulator')
        self.exit_status: int | None = None
        values = declare_parameters(self)
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.topics = Topics(self, values['publish_accuracy'])
        self._start_by = time.monotonic() + values['discovery_time']
        self._subscribers = (0, time.monotonic())
        factor = values['real_time_factor']
        scene = load_scene(values['scene']).with_overrides(
            values['step_size'] or None, values['integrator'] or None)
        scene, events = resolve(scene, 1.0 / values['publish_rate'], factor, self.get_logger())
        self._simulation = self._compile(scene)
        self._sampler = Sampler(self._simulation, values['publish_rate'])
        self._remaining = self._sampler.count(values['duration'])
        if factor * _LONGEST_WAIT < self._sampler.tick and factor > 0.0:
            raise ParameterError(f'parameter real_time_factor = {factor:g}: more than '
                                 f'{_LONGEST_WAIT:.0e} s would pass between two samples')
        self._configure(scene, values)
        for event in events:
            self._tell(*event)
        if self._sampler.deviation:
            self.get_logger().warning(self._sampler.deviation)
        self._real_time_factor = factor
        self._steps_left, self._batch = 0, 1
        # Made when the first step is due.
        self._pacer: Pacer | None = None
        self._status: StatusLine | None = None
        self._discovery = self.create_timer(
            0.02, self._start_when_discovered, clock=self._steady_clock)

    def stop(self, status: int, reason: str) -> None:
        """Step no more, and let the process end with this status."""
        if self.exit_status is None:
            self.exit_status = status
            self._tell(reason, 'ERROR' if status else 'INFO')
            if self._pacer is not None:
                self._publish_diagnostics()

    def finish(self) -> None:
        """Close the files and say where they are; makes no ROS call but to the log."""
        if self._status is not None:
            self._status.close()
        if not self._recording.close():
            self.exit_status = 1
        self._recording.report()

    def _tell(self, text: str, level: str, show: bool = True) -> None:
        """Log a line, and show it beside the samples; level is INFO, WARN or ERROR."""
        logger = self.get_logger()
        # On lines of their own: rclpy ties the line of a call to one severity.
        if level == 'INFO':
            logger.info(text)
        elif level == 'WARN':
            logger.warning(text)
        else:
            logger.error(text)
        if show:
            self._recording.event(text, level)

    def _configure(self, scene: Scene, values: dict[str, str | bool | float]) -> None:
        """Open the scene's topics and the files, and tell what is simulated."""
        simulation = self._simulation
        seconds = _SEEN * (values['real_time_factor'] or 1.0)
        box, cost = look_ahead(simulation, min(seconds, values['duration'] or seconds))
        if simulation.hamiltonian.box is not None:
            box = simulation.hamiltonian.box
        if values['explain'] and scene.effects:
            self.get_logger().info('measuring what each effect adds to a step')
        report = scene_report(scene, simulation, cost, values['explain'])
        self._monitor = Monitor(
            simulation, self._sampler.every, self._sampler.tick,
            scene.chosen and scene.chosen[0], lambda text, first: self._tell(text, 'WARN', first),
            make_guards(simulation, box, values['energy_band_limit'],
                        values['energy_change_limit']))
        self.topics.open(simulation, self._monitor, scene.mechanism, box, values['frame_id'])
        self._recording = Recording(
            self.get_logger(), scene, simulation, values, self.topics.descriptions, box)
        kinds = [effect.kind for effect in scene.effects]
        self._recording.event(', '.join([
            f'{scene.name}: {scene.integrator.kind}', f'h = {scene.step_size:g} s', *kinds,
            'conservative' if simulation.conservative else 'not conservative']), 'INFO')
        self.topics.publish_scene(report)
        self._diagnostics = DiagnosticsPublisher(self, self.topics.diagnostics, scene.name)
        self._stop_outside_box = values['stop_outside_box']
        self._health = Health(
            simulation, self._monitor.guards, self._diagnostics, self._recording,
            lambda text, level: self._tell(text, level, show=False),
            [STEP_FAILED, EnergyGuard.kind, *[BoxGuard.kind] * self._stop_outside_box])
        self._run_status = RunStatus(
            scene, simulation, self._monitor, self._recording, self._health,
            values['real_time_factor'])

    def _compile(self, scene: Scene) -> Simulation:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter('always')
            simulation = Simulation.from_scene(scene)
            seconds = simulation.compile()
        for warning in caught:
            self.get_logger().warning(str(warning.message))
        self.get_logger().info(f'scene {scene.source}: kernel compiled in {seconds:.2f} s')
        return simulation

    def _start_when_discovered(self) -> None:
        """Start once discovery is over, or its time: DDS takes some 1.5 s to find a node."""
        now = time.monotonic()
        count, since = self._subscribers
        found = self.topics.subscribers
        if found != count:
            self._subscribers = (found, now)
        elif now >= self._start_by or (found and now - since > _SETTLED):
            self._discovery.cancel()
            self._status = StatusLine(self.get_logger())
            self._pacer = Pacer(self._sampler.tick, self._real_time_factor)
            if self._real_time_factor:
                self._monitor.guards.append(OverrunGuard(self._pacer))
            self._watch(self._sampler.sample())
            self.create_timer(
                _DIAGNOSTICS_PERIOD, self._publish_diagnostics, clock=self._steady_clock)
            self.create_timer(self._pacer.timer_period, self._on_timer, clock=self._steady_clock)

    def _on_timer(self) -> None:
        """Step for a short while, in batches, so that signals and other callbacks get a turn."""
        until = time.monotonic() + _LONGEST_CALL
        while self.exit_status is None and time.monotonic() < until:
            if self._steps_left == 0:
                if not self._pacer.due():
                    return
                self._steps_left = self._sampler.every
            if self._step() and self._steps_left == 0:
                self._hand_out()
                self._remaining -= 1
                if self._remaining <= 0:
                    self.stop(0, 'the duration is over')

    def _step(self) -> bool:
        """Take a batch of steps, of about a fifth of a call; False if one failed."""
        simulation, n = self._simulation, min(self._batch, self._steps_left)
        rescued = simulation.rescued
        try:
            seconds = self._monitor.advance(n)
        except StepFailure as failure:
            newest = self._monitor.newest
            self._health.add_failure(failure, newest.stamp if newest else 0)
            self.stop(1, f'stopped at the last good state, t = {simulation.time:.9g} s')
            return False
        self._steps_left -= n
        if n == self._batch:
            short = seconds < 0.2 * _LONGEST_CALL
            self._batch = 2 * n if short else max(1, n // 2)
        if simulation.rescued > rescued:
            self.get_logger().warning(
                f'steps that converged only in parts: {simulation.rescued}; use a smaller '
                'step_size', throttle_duration_sec=1.0)
        return True

    def _hand_out(self) -> None:
        """Publish, record and show a sample; the log gets the very bytes that are published."""
        begin = time.perf_counter()
        sample = self._sampler.sample()
        evaluated = self._monitor.add(sample)
        self._recording.write(sample, self.topics.publish(sample))
        if evaluated:
            self._recording.timing(self._monitor.timing.figures)
        self._watch(sample)
        self._status.show(sample, self._pacer.overruns)
        self._monitor.timing.add_sample(time.perf_counter() - begin)

    def _watch(self, sample: Sample) -> None:
        """Tell what the guards find in a sample, and stop if that was asked for."""
        for alarm in self._monitor.watch(sample):
            self._health.add(alarm, sample.stamp)
            if alarm.kind == BoxGuard.kind and self._stop_outside_box:
                self.stop(1, f'stopped by stop_outside_box at t = {sample.stamp * 1e-9:.9g} s')

    def _publish_diagnostics(self) -> None:
        self._diagnostics.publish(self._run_status.statuses(self._pacer.overruns))


def main(argv: list[str]) -> int:
    """Run the node until its duration is over, a guard stops it, or SIGINT or SIGTERM arrives."""
    try:
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as problem:
        raise ParameterError(f'ROS arguments: {" ".join(str(problem).split())}') from problem
    if others := remove_ros_args(argv):
        rclpy.shutdown()
        raise ParameterError(f'unknown argument {others[0]!r}; parameters are given as: '
                             '--ros-args -p NAME:=VALUE')
    received: list[int] = []
    node = None

    def on_signal(number: int, frame: object) -> None:
        if node is None:
            raise KeyboardInterrupt
        received.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        # Our own handlers: rclpy's would end the context before the files are closed.
        signal.signal(number, on_signal)
    try:
        node = SimulatorNode()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while node.exit_status is None:
            executor.spin_once(timeout_sec=0.1)
            if received:
                node.stop(0, f'stopped by {signal.Signals(received[0]).name}')
        node.topics.wait_for_delivery()
    except KeyboardInterrupt:
        # Stopped while it was still starting.
        return 0
    finally:
        if node is not None:
            node.finish()
            node.destroy_node()
        rclpy.try_shutdown()
    return node.exit_status
