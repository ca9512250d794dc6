# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Random walks: nodes that are killed, join late, stand still, or share their topics."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
import math
import os
from pathlib import Path
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from executables import Executable
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording.bags.mcap_recovery import recover
from hnn_vi_ros.ros.replay.replay_check import check_replay
import numpy as np
from peer import Peer, peer
from processes import simulator_words, standard_error, start_executable
import pytest
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.long
DURATION = float(os.environ.get('HNN_VI_ROS_WALK', '60'))
# The controller's time of silence, and what a busy machine may add to it [s].
SILENCE, SLACK = 0.2, 5.0
LIMIT, INTRUDER, SECOND = 4.0, 'intruder', 10**9
TWIN = """\
hamiltonian: {kind: pendulum}
effects: [{kind: observer, coordinates: [angle], gain: 20.0, damping: 8.0, timeout: 0.5}]
integrator: {kind: implicit_midpoint}
step_size: 0.01
initial_state: {q: [0.3], p: [0.0]}
"""
# By the number of a message and the time [ns]; those that may be answered more than once.
STAMPS: dict[str, Callable[[int, int], tuple[int, int]]] = {
    'rising': lambda k, now: divmod(now, SECOND), 'zero': lambda k, now: (0, 0),
    'frozen': lambda k, now: (5, 0), 'falling': lambda k, now: divmod(now - k * SECOND, SECOND),
    'ahead': lambda k, now: (2**31 - 1 - k, 0), 'none': lambda k, now: (5, 2**32 - 1),
    'negative': lambda k, now: (-1, 0)}
ANSWERED = 'rising', 'zero', 'falling', 'ahead'


class Walk:
    """Processes that come and go, and a node that speaks on their topics."""

    def __init__(self, other: Peer, folder: Path, scene: str, seed: int):
        self.scene, self.other, self.folder = scene, other, folder
        self.random = np.random.default_rng(seed)
        self.namespace = ('', '/left')[seed % 2]
        self.alive: dict[str, Executable] = {}
        self.bags: list[Path] = []
        self.counts: Counter[str] = Counter()
        self.speaking: dict[str, Iterator[None]] = {}
        # When something was last heard that may be answered.
        self.heard = time.monotonic()

    def begin(self, name: str) -> None:
        """Start an executable unless it runs."""
        if name in self.alive:
            return
        self.counts[f'{name} starts'] += 1
        if name == 'simulator':
            self.bags.append(self.folder / f'bag{len(self.bags)}')
            words = simulator_words(scene=self.scene, record_path=self.bags[-1])
        else:
            words = ['--ros-args', '-p', 'task:=swing_up']
        if self.namespace:
            words += ['-r', f'__ns:={self.namespace}']
        self.alive[name] = start_executable(name, *words, folder=self.folder)

    def end(self, name: str, number: int) -> None:
        """Send a signal to an executable and see it end."""
        process = self.alive.pop(name, None)
        if process is not None:
            self.counts[f'{name} {signal.Signals(number).name}'] += 1
            process.send_signal(number)
            status = process.wait(120.0)
            error = standard_error(process)
            # Interrupted before it has a node, it ends as Python does.
            expected = -number if number == signal.SIGKILL else 0 if error else 130
            assert status == expected, (status, error)

    def stand_still(self, name: str) -> None:
        """Stop a process for a while that is longer than the time of silence."""
        if name in self.alive:
            self.counts[f'{name} stands'] += 1
            self.alive[name].send_signal(signal.SIGSTOP)
            self.other.spin(self.random.uniform(0.1, 1.5))
            self.alive[name].send_signal(signal.SIGCONT)

    def speak(self, topic: str, message: Callable[[int], JointState]) -> None:
        """Let another publisher of a topic speak for a while, with stamps of a random kind."""
        if topic in self.speaking:
            return
        kind = str(self.random.choice([*STAMPS]))
        self.counts[f'{topic.rpartition("/")[2]}: {kind}'] += 1
        publisher = self.other.node.create_publisher(JointState, topic, 10)

        def words() -> Iterator[None]:
            for k in range(int(self.random.integers(5, 150))):
                said, (seconds, fraction) = message(k), STAMPS[kind](k, time.time_ns())
                said.header.stamp.sec, said.header.stamp.nanosec = seconds, fraction
                publisher.publish(said)
                if kind in ANSWERED or k == 0:
                    self.heard = time.monotonic()
                yield
            self.other.node.destroy_publisher(publisher)
        self.speaking[topic] = words()

    def take(self, actions: Sequence[Callable[[], None]]) -> None:
        """Take random actions for the duration."""
        until = time.monotonic() + DURATION
        while time.monotonic() < until:
            actions[self.random.integers(len(actions))]()
            pause = time.monotonic() + self.random.uniform(0.1, 4.0)
            while time.monotonic() < pause:
                self.go_on()

    def go_on(self) -> None:
        """Hear and speak for a moment; no process ends by itself."""
        self.other.spin(0.01)
        for topic, words in [*self.speaking.items()]:
            if next(words, words) is words:
                del self.speaking[topic]
        for name, process in self.alive.items():
            assert process.poll() is None, f'{name}: {standard_error(process)}'

    def finish(self) -> None:
        """End all; assert that every bag is what its scene does."""
        for name in [*self.alive]:
            self.end(name, signal.SIGINT)
        for bag in self.bags:
            # Killed before the file had its name, or before its first sample.
            if not list(bag.glob('*.mcap')):
                continue
            recover(bag)
            try:
                verdict = check_replay(bag)
                empty = 'holds no samples' in verdict.text
                assert verdict.good or empty, verdict.text
            except RecordingError as problem:
                assert 'topics: none' in str(problem)
                empty = True
            self.counts['empty bags' if empty else 'verified bags'] += 1
        print(f'\n{dict(sorted(self.counts.items()))}')


def pendulum(angle: float, velocity: float = 0.0) -> JointState:
    return JointState(name=['angle'], position=[angle], velocity=[velocity])


@pytest.mark.timeout(3600)
@pytest.mark.parametrize('seed', [0, 1])
def test_controller_keeps_its_limits_and_answers_silence_with_zeros(tmp_path, seed):
    with peer() as other:
        walk = Walk(other, tmp_path, 'motor_pendulum', seed)
        commands, strays = f'{walk.namespace}/hnn_simulator/joint_commands', []
        last: list[tuple[float, float]] = []
        zeros_after: list[float] = []

        def on_command(message: JointState) -> None:
            if message.header.frame_id == INTRUDER:
                return
            effort, = message.effort
            assert math.isfinite(effort) and abs(effort) <= LIMIT * (1.0 + 1e-12), effort
            walk.counts['commands'] += 1
            if last and effort == 0.0 != last[-1][1] and time.monotonic() > walk.heard + SILENCE:
                zeros_after.append(time.monotonic() - walk.heard)
            last[:] = [(time.monotonic(), effort)]

        def on_state(message: JointState) -> None:
            walk.heard = time.monotonic()

        other.node.create_subscription(JointState, commands, on_command, QoSProfile(depth=1000))
        other.node.create_subscription(
            JointState, f'{walk.namespace}/joint_states', on_state, qos_profile_sensor_data)
        # The robot of the other namespace.
        stray = '/hnn_simulator' if walk.namespace else '/left/hnn_simulator'
        other.node.create_subscription(
            JointState, f'{stray}/joint_commands', strays.append, QoSProfile(depth=1000))

        def command(k: int) -> JointState:
            said = JointState(name=['angle'], effort=[float(walk.random.normal(0.0, 10.0))])
            said.header.frame_id = INTRUDER
            return said
        walk.take([
            lambda: walk.begin('simulator'), lambda: walk.begin('controller'),
            lambda: walk.begin('simulator'), lambda: walk.begin('controller'),
            lambda: walk.end('simulator', signal.SIGKILL),
            lambda: walk.end('simulator', signal.SIGINT),
            lambda: walk.end('controller', signal.SIGKILL),
            lambda: walk.end('controller', signal.SIGINT),
            lambda: walk.stand_still('simulator'), lambda: walk.stand_still('controller'),
            lambda: walk.speak(f'{walk.namespace}/joint_states', lambda k: pendulum(
                float(walk.random.normal()), float(walk.random.choice([0.0, 1.0, math.nan])))),
            lambda: walk.speak(commands, command)])
        # Nothing is heard any more: the last command is of no effort.
        walk.begin('controller')
        walk.begin('simulator')
        before = walk.counts['commands']
        other.spin_until(lambda: walk.go_on() or walk.counts['commands'] > before)
        walk.end('simulator', signal.SIGKILL)
        other.spin_until(lambda: walk.go_on() or not walk.speaking)
        other.spin_until(lambda: last[-1][1] == 0.0, SILENCE + SLACK)
        walk.finish()
        print('zeros after silence of [s]:', np.round(sorted(zeros_after), 2).tolist())
        assert not strays


@pytest.mark.timeout(3600)
@pytest.mark.parametrize('seed', [2, 3])
def test_twin_goes_on_and_tells_of_silence(tmp_path, seed):
    (tmp_path / 'scene.yaml').write_text(TWIN)
    with peer() as other:
        walk = Walk(other, tmp_path, 'scene.yaml', seed)
        observations = f'{walk.namespace}/hnn_simulator/observations'
        levels: list[int] = []

        def on_state(message: JointState) -> None:
            walk.counts['states'] += 1
            assert np.isfinite([*message.position, *message.velocity]).all()

        def on_diagnostics(message: DiagnosticArray) -> None:
            levels.append(max(status.level for status in message.status))

        hear(other.node, JointState, f'{walk.namespace}/joint_states', on_state)
        hear(other.node, DiagnosticArray, '/diagnostics', on_diagnostics)
        begin = time.monotonic()

        def machine(k: int) -> JointState:
            t = time.monotonic() - begin
            return pendulum(0.3 * math.cos(3.13 * t), -0.94 * math.sin(3.13 * t))

        def stranger(k: int) -> JointState:
            angle = walk.random.choice([0.0, 1e9, math.nan, float(walk.random.normal())])
            return pendulum(float(angle), float(walk.random.choice([0.0, math.inf, 1e300])))
        walk.take([
            lambda: walk.begin('simulator'), lambda: walk.begin('simulator'),
            lambda: walk.end('simulator', signal.SIGKILL),
            lambda: walk.end('simulator', signal.SIGINT),
            lambda: walk.stand_still('simulator'),
            *[lambda: walk.speak(observations, machine)] * 3,
            lambda: walk.speak(observations, stranger)])
        walk.begin('simulator')
        before = walk.counts['states']
        other.spin_until(lambda: walk.go_on() or (
            walk.counts['states'] > before and not walk.speaking))
        levels.clear()
        other.spin_until(lambda: walk.go_on() or any(level > b'\0' for level in levels))
        walk.finish()


def hear(node: Node, kind: type, topic: str, callback: Callable) -> None:
    node.create_subscription(kind, topic, callback, qos_profile_sensor_data)
