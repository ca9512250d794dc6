# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Node that displays a running simulator or a bag in rerun, in a separate process."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import repeat
import math
from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.errors import HnnViRosError, ParameterError, prefixed, RecordingError
from hnn_vi_ros.files import expand_user, numbered_paths
from hnn_vi_ros.hamiltonians import MECHANISMS, momentum
from hnn_vi_ros.recording import decode_state, RerunSink, Sample, StateMessage, Target
from hnn_vi_ros.ros import arguments
from hnn_vi_ros.ros.node_parameters import declare_parameters, node_name, refuse_unknown
from hnn_vi_ros.ros.plumbing.graph import spin, take_once
from hnn_vi_ros.ros.plumbing.managed_node import RobustNode
from hnn_vi_ros.ros.plumbing.qos_overrides import Endpoint
from hnn_vi_ros.ros.plumbing.stamps import nanoseconds
from hnn_vi_ros.ros.plumbing.starting import own_arguments, plain_ros_errors, ros_process
from hnn_vi_ros.ros.recording import SERVER_PORT, VIEWER_URL
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun
from hnn_vi_ros.ros.settings import BRIDGE_PARAMETERS, BridgeSettings
from hnn_vi_ros.ros.topics.diagnostics import ERROR, EVENT
from hnn_vi_ros.ros.topics.inputs import Input, places_of
from hnn_vi_ros.ros.topics.outputs import DIAGNOSTICS, EVENTS, LATCHED
from hnn_vi_ros.ros.topics.subscriptions import Subscriptions
from hnn_vi_ros.run import preview_bounds
from hnn_vi_ros.scene import described_scene, Scene
from hnn_vi_ros.simulation import build
import numpy as np
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

# Simulated time that fits into the picture [s].
_PREVIEW_TIME = 30.0
# Largest step number that the viewer accepts.
_MAX_STEP_NUMBER = 2.0**63


class BridgePicture:
    """
    Display of samples in the viewer.

    Parameters
    ----------
    scene : Scene
        Scene as described by ~/scene or a log.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, for example because its model is missing.

    """

    def __init__(self, scene: Scene):
        # The simulation stays in its initial state.
        self._simulation = simulation = build(scene)
        self._hamiltonian = simulation.hamiltonian
        self._energy0, self._modified = simulation.energy, simulation.modified_energy is not None
        self._box = simulation.hamiltonian.box or preview_bounds(simulation, _PREVIEW_TIME)
        self._mechanism = MECHANISMS[scene.mechanism] if scene.mechanism else None
        self.samples = 0

    def open(self, target: Target, name: str) -> None:  # noqa: A003
        """
        Open the recording.

        Parameters
        ----------
        target : Path, str or int
            Destination; see RerunSink.
        name : str
            Name of the recording.

        Raises
        ------
        RecordingError
            The target cannot be opened.

        """
        simulation = self._simulation
        self._sink = RerunSink(
            name, target, self._hamiltonian, simulation.q.copy(), simulation.p.copy(),
            box=self._box, mechanism=self._mechanism,
            effects=simulation.effects, step_size=simulation.step_size,
            conservative=simulation.conservative, modified=self._modified)

    def show(self, state: StateMessage) -> None:
        """Display a sample; ValueError if it does not fit the scene."""
        simulation, hamiltonian = self._simulation, self._hamiltonian
        h, energy0 = simulation.step_size, self._energy0
        dH_dp = np.asarray(hamiltonian.gradient(state.q, state.p, state.stamp * 1e-9)[1])
        modified: Any = math.nan
        if self._modified:
            modified = simulation.integrator.modified_energy(
                hamiltonian, h, state.q, state.p, state.energy, -state.dp_dt, dH_dp)
        step = state.stamp * 1e-9 / h
        if not step < _MAX_STEP_NUMBER:
            raise ValueError(f'its scene has steps of {h:g} s, so its stamps exceed the '
                             'countable number of steps; check its step_size')
        balance = state.energy - energy0 - state.work
        self._sink.write(Sample(
            step=round(step), stamp=state.stamp, q=state.q,
            p=state.p, dH_dq=-state.dp_dt, dH_dp=dH_dp, energy=state.energy,
            modified_energy=modified, work=state.work,
            energy_error=balance / abs(energy0) if energy0 else balance))
        self.samples += 1

    def tell(self, message: DiagnosticArray, simulator: str) -> None:
        """
        Display alarms and the cost of steps at the newest sample, and events at their own times.

        Parameters
        ----------
        message : DiagnosticArray
            Diagnostics of any node.
        simulator : str
            Full name of the displayed simulator.

        """
        for status in message.status:
            values = {item.key.partition(' ')[0]: item.value for item in status.values}
            if status.name == f'{simulator[1:]}: health' and 'alarm' in values:
                self._sink.event(f'{values["alarm"]}: {status.message}',
                                 'ERROR' if status.level == ERROR else 'WARN')
            elif status.name == f'{simulator[1:]}: {EVENT}':
                stamp = nanoseconds(message.header.stamp)
                self._sink.event(status.message, 'INFO', (
                    stamp, math.floor(stamp * 1e-9 / self._simulation.step_size)))
            elif status.name == f'{simulator[1:]}: timing':
                median, p99, pace = (float(values.get(name, math.nan)) for name in (
                    'microseconds_per_step_median', 'microseconds_per_step_p99',
                    'real_time_factor'))
                self._sink.timing((median, p99), pace)

    def plan(self, message: JointTrajectory) -> None:
        """Display a controller's plan; ValueError if it does not fit the scene."""
        order = places_of(self._hamiltonian.coordinates, message.joint_names, 'joint_names')
        d = len(order)
        points = [(point.positions, point.velocities) for point in message.points]
        if any(len(half) != d for point in points for half in point):
            raise ValueError(f'a point must have {d} positions and {d} velocities')
        q, v = np.array(points, dtype=np.float64).reshape(-1, 2, d)[:, :, order].swapaxes(0, 1)
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise ValueError('a position or a velocity is not finite')
        self._sink.plan(nanoseconds(message.header.stamp), q, momentum(
            self._hamiltonian, q, v, np.zeros_like(v)) if len(q) else v)

    def close(self) -> None:
        """Send the remaining data; RecordingError if that fails."""
        self._sink.close()


def target_of(settings: BridgeSettings) -> Target:
    """Return the destination of the picture set by the parameters, or raise ParameterError."""
    path = settings.rerun_path
    if settings.rerun_sink == 'connect':
        return path or VIEWER_URL
    if settings.rerun_sink == 'serve':
        port = path or str(SERVER_PORT)
        if not (port.isdecimal() and 0 < int(port) < 65536):
            raise ParameterError(f'parameter rerun_path = {path!r}: expected a port, 1 to 65535')
        return int(port)
    if not path:
        raise ParameterError('parameter rerun_path: expected the .rrd file to write')
    return expand_user(path)


_QUEUE = QoSProfile(depth=1000)
# Time limit for the display of queued samples at the end [s].
_MAX_END_TIME = 3.0


class RerunBridge(RobustNode):
    """
    Node that displays the topics of a simulator.

    A sample is a message of ~/state.

    Parameters
    ----------
    arguments : sequence of str, optional
        Command line with the parameters.
    trust_code : bool, optional
        True to allow the execution of Python code that a scene names; sets the parameter.

    Attributes
    ----------
    problem : HnnViRosError or None
        Error that ended the display.

    """

    def __init__(self, arguments: Sequence[str] = (), trust_code: bool = False):
        with plain_ros_errors():
            super().__init__(
                'hnn_rerun_bridge', automatically_declare_parameters_from_overrides=True,
                parameter_overrides=[Parameter('trust_code', value=True)] if trust_code else [])
        self._settings = declare_parameters(self, BridgeSettings)
        self._topics, self._hearing = self._find_topics(), Subscriptions(self)
        refuse_unknown(self, BRIDGE_PARAMETERS, [
            Endpoint(name, 'subscription') for name in self._topics], arguments)
        self.target = target_of(self._settings)
        self._targets = numbered_paths(self.target, self.target.suffix) if isinstance(
            self.target, Path) else repeat(self.target)
        self.problem: HnnViRosError | None = None
        self._described = ''
        self._picture: BridgePicture | None = None

    def listen(self) -> None:
        """Subscribe to the scene, the state, plans, diagnostics and events."""
        for topic, (kind, take, qos, raw) in self._topics.items():
            self._hearing.hear(Input(topic, kind, frozenset(), None, qos), take, raw)
        self.get_logger().info(f'waiting for {next(iter(self._topics))}')

    def _find_topics(self) -> dict[str, tuple[type, Callable[..., None], QoSProfile, bool]]:
        """Return message type, callback, QoS and use of raw bytes, by topic."""
        simulator, controller = (node_name(self, role, getattr(self._settings, role))
                                 for role in ('simulator', 'controller'))

        def tell(message: DiagnosticArray) -> None:
            self._show(BridgePicture.tell, message, simulator)

        return {
            f'{simulator}/scene': (String, self._on_scene, LATCHED, False),
            f'{simulator}/state': (JointState, lambda payload: self._show(
                BridgePicture.show, decode_state(payload)), _QUEUE, True),
            f'{controller}/plan': (JointTrajectory, lambda message: self._show(
                BridgePicture.plan, message), _QUEUE, False),
            DIAGNOSTICS.topic: (DiagnosticArray, tell, _QUEUE, False),
            EVENTS.topic.replace('~', simulator): (DiagnosticArray, tell, EVENTS.qos, False)}

    def show_bag(self, bag: Path) -> int:
        """Display all samples of a bag; return their number."""
        run = RecordedRun(bag, self._settings.trust_code)
        picture = BridgePicture(run.scene)
        picture.open(self.target, bag.resolve().name)
        self._picture = picture
        told = {number for number, name in run.names.items() if name in ('diagnostics', 'events')}
        with prefixed(str(bag), RecordingError):
            for message, state in run.in_order({run.channel, *told}):
                if state is not None:
                    self._show(BridgePicture.show, state)
                elif message.channel in told:
                    self._show(BridgePicture.tell, run.decoded(message, DiagnosticArray), run.node)
        if run.reader.damage:
            self.get_logger().warning(run.reader.damage)
        return picture.samples

    def close(self) -> None:
        """Send the remaining data."""
        if self._picture is not None:
            self._picture.close()
            self._picture = None

    def _on_scene(self, message: String) -> None:
        """Begin a new picture, unless the scene is unchanged; HnnViRosError if it is unusable."""
        if message.data == self._described:
            return
        self._described = message.data
        scene, _ = described_scene(message.data, '~/scene', self._settings.trust_code)
        # Any node may have sent it: if it cannot be built, the earlier picture continues.
        picture = BridgePicture(scene)
        with self._end_if_lost():
            self.close()
            # After the first picture, use a file name that does not exist yet.
            target = next(target for target in self._targets if target == self.target
                          or not (isinstance(target, Path) and target.exists()))
            picture.open(target, 'bridge')
            self._picture = picture
            shown = f'port {target}' if isinstance(target, int) else target
            simulator = next(iter(self._topics)).removesuffix('/scene')
            self.get_logger().info(f'showing {simulator} on {shown}')

    def _show(self, show: Callable[..., None], *what: Any) -> None:
        """Pass an object to a method of BridgePicture, if there is a picture."""
        if self._picture is not None:
            with self._end_if_lost():
                show(self._picture, *what)

    @contextmanager
    def _end_if_lost(self) -> Iterator[None]:
        """Store the error that ends the display."""
        try:
            yield
        except HnnViRosError as problem:
            self.problem = problem


def main(argv: list[str]) -> int:
    """Display a simulator until a signal, or all of a bag."""
    options = arguments.rerun_bridge().parse_args(own_arguments(argv))
    with ros_process(argv) as received:
        node = RerunBridge(argv, options.trust_code)
        try:
            if options.bag is None:
                _show_simulator(node, received)
            else:
                _show_bag(node, options.bag, received)
        finally:
            node.close()
        if node.problem is not None:
            raise node.problem
    return 0


def _show_simulator(node: RerunBridge, received: list[int]) -> None:
    node.listen()
    executor = spin(node, lambda: received or node.problem)
    # Display the messages received by then, unless that takes long or another signal comes.
    deadline, signals = time.monotonic() + _MAX_END_TIME, len(received)
    while len(received) == signals and node.problem is None and time.monotonic() < deadline:
        if not take_once(executor):
            return


def _show_bag(node: RerunBridge, bag: Path, received: list[int]) -> None:
    node.get_logger().info(f'{node.show_bag(bag)} samples shown')
    if isinstance(node.target, int):
        node.get_logger().info(f'viewers can connect to port {node.target} until Ctrl-C')
        while not received:
            time.sleep(0.1)
