# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Which states a controller answers, by their stamps, and what it makes of the others."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.ros import controller_node
from hnn_vi_ros.ros.controller_node import ControllerNode
from hnn_vi_ros.ros.plumbing.graph import RepetitionFilter
from hnn_vi_ros.ros.plumbing.stamps import Stamps
from hnn_vi_ros.ros.topics import subscriptions
from hnn_vi_ros.ros.topics.joining import ObservationJoiner
from hnn_vi_ros.run import nanoseconds
from messages import refused
from peer import ros, values_of
from processes import wait_until
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

SECOND, SILENCE, PERIOD = 10**9, 0.2, 0.01
EPOCH = 1_700_000_000 * SECOND
OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
STATES, COMMANDS = '/joint_states', '/hnn_simulator/joint_commands'


def state(stamp: int, angle: float = 0.3) -> JointState:
    message = JointState(name=['angle'], position=[angle], velocity=[0.0])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, SECOND)
    return message


class Driven:
    """A controller whose clock, timers and messages are those of a test."""

    def __init__(self, node: ControllerNode):
        self.node, self.time, self.log, self.told = node, 0.0, [], []
        self.commands: list[JointState] = []
        node._commands.publish = self.commands.append
        node.get_logger = lambda: SimpleNamespace(**{
            level: lambda text, **more: self.log.append(text)
            for level in ('info', 'warning', 'error')}, is_enabled_for=lambda severity: False)
        node._diagnostics._send = lambda payload, stamp: self.told.append(
            deserialize_message(payload, DiagnosticArray).status[0])
        node._sent = 0
        node._warn_of_crowd, node._warn_of_stranger, node._warn_of_gaps = (
            RepetitionFilter(self.log.append) for _ in range(3))
        node._hearing.ignored.clear()
        node._hearing._due.clear()
        node.on_activate(None)
        self._scene, self._states = (one.callback for one in node._hearing._subscriptions)

    def hear(self, *messages: JointState, apart: float = PERIOD) -> list[float]:
        """Hear states, so much wall time apart [s]; return the efforts of the commands."""
        before = len(self.commands)
        for message in messages:
            self.time += apart
            self._states(serialize_message(message))
            self.node._watch()
        return [command.effort[0] for command in self.commands[before:]]

    def reset(self) -> None:
        """Hear that the simulator was reset."""
        self._scene(serialize_message(String()))

    @property
    def status(self) -> DiagnosticStatus:
        self.node._report()
        return self.told[-1]


@pytest.fixture(scope='module')
def controller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ControllerNode]:
    """Return a node that is configured and active."""
    task = tmp_path_factory.mktemp('task') / 'task.yaml'
    task.write_text(shipped_file('task', 'swing_up').read_text())
    arguments = ['--ros-args', '-p', f'task:={task}']
    with ros(*arguments):
        node, executor = ControllerNode(arguments), SingleThreadedExecutor()
        executor.add_node(node)
        executor.create_task(node.autostart)
        wait_until(lambda: executor.spin_once(timeout_sec=0.1) or node._active)
        assert node._silence == SILENCE and node._assigned.task.period == PERIOD
        yield node
        node.destroy_node()


@pytest.fixture
def driven(controller: ControllerNode, monkeypatch: pytest.MonkeyPatch) -> Driven:
    """Return it with a clock of the test, without a state so far."""
    found = Driven(controller)
    monkeypatch.setattr(controller_node, 'time', SimpleNamespace(
        monotonic=lambda: found.time, sleep=lambda seconds: None))
    monkeypatch.setattr(controller, '_stamps', Stamps(
        lambda: EPOCH + round(found.time * 1e9)))
    return found


def rising(start: int) -> Iterator[JointState]:
    return (state(start + k * SECOND // 100) for k in count())


def take(states: Iterator[JointState], number: int) -> list[JointState]:
    return [next(states) for _ in range(number)]


@pytest.mark.parametrize('first', [(), (5 * SECOND,), (EPOCH - SECOND,)])
def test_state_without_stamp_is_of_its_arrival(driven: Driven, first: tuple[int, ...]):
    heard = driven.hear(*map(state, first), *[state(0)] * 100)
    assert len(heard) == 100 + len(first) and driven.status.level == OK
    # That of the command too.
    assert nanoseconds(driven.commands[-1].header.stamp) == EPOCH + round(driven.time * 1e9)


def test_one_zero_before_stamps_that_rise_is_time_zero(driven: Driven):
    assert len(driven.hear(*take(rising(0), 100))) == 100
    assert [nanoseconds(one.header.stamp) for one in driven.commands[:2]] == [0, SECOND // 100]


@pytest.mark.parametrize('stamp_at', [
    lambda k: 5 * SECOND, lambda k: EPOCH, lambda k: EPOCH - k * SECOND // 100,
    # Microseconds in the place of milliseconds.
    lambda k: EPOCH + 10_000 * k], ids=['frozen', 'frozen epoch', 'falling', 'slow'])
def test_stamps_that_do_not_rise_end_the_command_within_the_silence(
        driven: Driven, stamp_at: Callable[[int], int]):
    heard = driven.hear(*(state(stamp_at(k)) for k in range(200)))
    # The first state counts; each other one is ignored.
    assert heard[0] != 0.0 and heard[1:] == [0.0]
    assert sum('no usable state for 0.2 s (' in line for line in driven.log) == 1
    status = driven.status
    assert status.level == WARN and 'no usable state for' in status.message
    assert 'stamp' in status.message


def test_command_that_is_none_is_no_answer(driven: Driven, monkeypatch: pytest.MonkeyPatch):
    states = rising(SECOND)
    assert len(driven.hear(*take(states, 10))) == 10
    assignment = driven.node._assigned
    monkeypatch.setattr(driven.node, '_assignment', assignment._replace(
        controller=lambda q, v, t: [float('nan')]))
    assert driven.hear(*take(states, 100)) == [0.0]


def test_two_publishers_do_not_make_it_answer_each_message(driven: Driven):
    far, near = rising(100 * SECOND), rising(5 * SECOND)
    heard = driven.hear(*(state for pair in zip(take(far, 200), take(near, 200), strict=True)
                          for state in pair), apart=PERIOD / 2)
    assert len(heard) == 200 and min(map(abs, heard)) > 0.0
    # The one that is left is heard after a silence.
    assert len(driven.hear(*take(near, 100))) > 70


def test_older_stamps_are_answered_after_a_reset_or_a_silence(driven: Driven):
    assert len(driven.hear(*take(rising(100 * SECOND), 10))) == 10
    driven.reset()
    assert len(driven.hear(*take(rising(50 * SECOND), 10))) == 10
    # A clock that was set back, which nothing announces.
    heard = driven.hear(*take(rising(SECOND), 100))
    assert heard[0] == 0.0 and len(heard) == pytest.approx(1 + 100 - SILENCE / PERIOD, abs=2)
    # Another simulator, after the end of the one before.
    driven.time += 1.0
    driven.node._watch()
    assert len(driven.hear(*take(rising(SECOND // 100), 10))) == 10


def test_first_state_after_a_reset_is_answered_if_it_arrives_before_the_scene(driven: Driven):
    """The two topics have no common order, and a simulator that is stepped then waits."""
    assert len(driven.hear(*take(rising(100 * SECOND), 10))) == 10
    assert driven.hear(state(SECOND)) == []
    driven.reset()
    assert nanoseconds(driven.commands[-1].header.stamp) == SECOND and len(driven.commands) == 11
    assert len(driven.hear(*take(rising(SECOND + SECOND // 100), 10))) == 10
    # A stray state of long ago is not the first after a reset.
    assert driven.hear(state(SECOND)) == []
    driven.time += 2 * SILENCE
    driven.reset()
    assert len(driven.commands) == 21


def test_of_states_that_wait_the_newest_is_answered_and_each_is_heard(
        driven: Driven, monkeypatch: pytest.MonkeyPatch):
    states = rising(SECOND)
    first, *others = [*take(states, 3), JointState(name=['angle']), *take(states, 3)]
    monkeypatch.setattr(subscriptions, 'take_waiting',
                        lambda subscription: map(serialize_message, others))
    assert len(driven.hear(first)) == 1 and driven.node._hearing.ignored[driven.node._states] == 1
    assert nanoseconds(driven.commands[0].header.stamp) == SECOND + 5 * SECOND // 100


def test_states_in_parts_are_joined_and_not_told_as_a_second_publisher(
        driven: Driven, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(driven.node, '_joiner', ObservationJoiner(
        ['angle', 'elbow'], SILENCE / 2, lambda: EPOCH))

    def part(k: int) -> list[JointState]:
        elbow, grip = (JointState(name=[name], position=[0.0]) for name in ('elbow', 'grip'))
        both = [state(SECOND + k * SECOND // 100), grip, elbow]
        elbow.header.stamp = state(SECOND + k * SECOND // 100 + 1_000_000).header.stamp
        return both

    heard = driven.hear(*(one for k in range(50) for one in part(k)), apart=PERIOD / 3)
    assert len(heard) == 50 and min(map(abs, heard)) > 0.0
    # That of the newest part.
    assert nanoseconds(driven.commands[0].header.stamp) == SECOND + 1_000_000
    with endpoints(driven, arm=[f'publisher {STATES}', f'subscription {COMMANDS}'],
                   other=[f'publisher {STATES}']):
        driven.hear(*part(60)[:1])
        assert 'has 2 publishers' not in driven.status.message + driven.status.message
    # One of them falls silent.
    assert driven.hear(*(part(k)[0] for k in range(60, 120))) == [0.0]
    assert 'joints angle are observed without elbow' in driven.status.message


@pytest.mark.parametrize('stamp', [(5, 2**32 - 1), (2**31 - 1, 2**32 - 1), (-1, 0), (-2**31, 5)])
def test_stamp_that_is_none_is_ignored_and_the_last_one_ends_nothing(
        driven: Driven, stamp: tuple[int, int], monkeypatch: pytest.MonkeyPatch):
    wrong, states = state(0), rising(SECOND)
    wrong.header.stamp.sec, wrong.header.stamp.nanosec = stamp
    with refused(ValueError):
        nanoseconds(wrong.header.stamp)
    assert len(driven.hear(next(states), wrong, next(states))) == 2
    assert any('message ignored: a time of' in line for line in driven.log)
    monkeypatch.setattr(driven.node._plans, 'get_subscription_count', lambda: 1)
    assert len(driven.hear(state(2**31 * SECOND - 1))) == 1
    assert driven.status.level == OK


def test_stamps_say_which_is_not_later():
    stamps = Stamps(lambda: EPOCH)
    assert [stamps.accept(stamp) for stamp in (0, SECOND, 0)] == [0, SECOND, EPOCH]
    with refused(ValueError):
        stamps.accept(SECOND)
    with refused(ValueError):
        # The time of arrival is that of a clock that stands.
        stamps.accept(0)


@pytest.mark.parametrize(('every', 'level'), [(1, OK), (8, WARN)])
def test_states_that_come_less_often_than_a_period_are_told_once(
        driven: Driven, every: int, level: bytes):
    for k in range(0, 100, every):
        driven.hear(state(SECOND + k * SECOND // 100), apart=every * PERIOD)
        status = driven.status
    assert status.level == level
    lines = [line for line in driven.log if 'less often than every period of 0.01 s' in line]
    assert len(lines) == (level == WARN)
    assert values_of(status)['from_command_to_command [s]'] == f'{every * PERIOD:g}'


@contextmanager
def endpoints(driven: Driven, **kinds: Sequence[str]) -> Iterator[None]:
    """Let nodes by their names have publishers, or subscriptions, of joint states on topics."""
    nodes = [rclpy.create_node(name) for name in kinds]
    for node in nodes:
        for kind in kinds[node.get_name()]:
            create, topic = kind.split()
            if create == 'publisher':
                node.create_publisher(JointState, topic, 1)
            else:
                node.create_subscription(JointState, topic, print, 1)
    expected = Counter(kind for own in kinds.values() for kind in own)

    def seen() -> bool:
        found = {f'publisher {STATES}': driven.node.count_publishers(STATES),
                 f'publisher {COMMANDS}': driven.node.count_publishers(COMMANDS) - 1,
                 f'subscription {COMMANDS}': driven.node.count_subscribers(COMMANDS)}
        return all(expected[kind] == number for kind, number in found.items())
    wait_until(seen)
    try:
        yield
    finally:
        for node in nodes:
            node.destroy_node()


def told(driven: Driven) -> tuple[bytes, list[str]]:
    """Return the level that a controller gives itself, and what it warns of in some looks."""
    driven.log.clear()
    for _ in range(4):
        driven.hear(state(SECOND + round(driven.time * 1e9)))
        status = driven.status
    return status.level, driven.log


def test_second_publisher_of_states_commands_or_clock_is_told_once(driven: Driven):
    machine = [f'publisher {STATES}', f'subscription {COMMANDS}']
    with endpoints(driven, arm=machine):
        assert told(driven) == (OK, [])
    with endpoints(driven, arm=machine, other=machine[:1]):
        level, (line,) = told(driven)
        assert level == WARN and line.startswith(
            f'{STATES} has 2 publishers, /arm, /other, whose messages ')
    with endpoints(driven, arm=machine, other=[f'publisher {COMMANDS}']):
        level, (line,) = told(driven)
        assert level == WARN and line.startswith(
            f'{COMMANDS} has 2 publishers, /hnn_controller, /other, whose messages ')
    with endpoints(driven, arm=machine):
        assert told(driven) == (OK, [])


def test_commands_to_another_node_than_states_come_from_are_told_once(driven: Driven):
    with endpoints(driven, arm=[f'publisher {STATES}'], other=[f'subscription {COMMANDS}']):
        assert told(driven) == (OK, [
            f'{STATES} comes from /arm, but {COMMANDS} goes to /other: check the parameter '
            'simulator'])
    with endpoints(driven, arm=[f'publisher {STATES}']):
        level, (line,) = told(driven)
        assert level == WARN and f'{COMMANDS} goes to no node' in line
