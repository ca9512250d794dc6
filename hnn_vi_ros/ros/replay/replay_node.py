# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Node that publishes the topics of a bag; `--verify` simulates it again, `--rerun` shows it."""

from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from itertools import chain
from pathlib import Path
import sys
from typing import Any

from ament_index_python.resources import has_resource
from hnn_vi_ros.errors import HnnViRosError, listed, ParameterError, RecordingError
from hnn_vi_ros.recording import BagReader, qos_profiles, RecordedMessage
from hnn_vi_ros.ros.node_parameters import declare_parameters, refuse_unknown
from hnn_vi_ros.ros.plumbing.graph import (
    Discovery, DISCOVERY_PERIOD, freeze_memory, spin, THREAD_TURN, wait_for_delivery)
from hnn_vi_ros.ros.plumbing.managed_node import CLOCK_TOPIC, RobustNode, steady_timer
from hnn_vi_ros.ros.plumbing.qos_overrides import create_publisher, Endpoint
from hnn_vi_ros.ros.plumbing.starting import plain_ros_errors, ros_process
from hnn_vi_ros.ros.replay.player import Player, read_ahead
from hnn_vi_ros.ros.settings import REPLAY_PARAMETERS, ReplaySettings, Value
from hnn_vi_ros.ros.topics.inputs import INPUTS
from hnn_vi_ros.ros.topics.messages import clock_message, CLOCK_QOS, type_hash
from hnn_vi_ros.run import own_topics
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy)
from rclpy.validate_full_topic_name import validate_full_topic_name
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

_DEFAULT_DEPTH = 10
# rosbag2 writes an infinite duration as the largest possible one.
_MAX_QOS_SECONDS = 9_000_000_000
# Messages have seconds of 32 bits [ns].
_CLOCK_END = 2**31 * 10**9


def recorded_qos(text: str) -> QoSProfile:
    """
    Return the QoS profile with which to publish a recorded topic.

    The first of several publishers' profiles is used. A policy that is missing, unknown or left to
    the system has the default of publishers: reliable, volatile, keep last 10.

    Parameters
    ----------
    text : str
        YAML list of profiles, whose policies are names or, in older bags, numbers.

    """
    first = next(iter(qos_profiles(text)), None)
    profile: Mapping[str, Any] = first if isinstance(first, dict) else {}
    depth = profile.get('depth')
    history = _policy(HistoryPolicy, profile.get('history'), HistoryPolicy.KEEP_LAST)
    return QoSProfile(
        history=history, depth=depth if depth and _is_count(depth, 2**31) else _DEFAULT_DEPTH,
        reliability=_policy(ReliabilityPolicy, profile.get('reliability'),
                            ReliabilityPolicy.RELIABLE),
        durability=_policy(DurabilityPolicy, profile.get('durability'),
                           DurabilityPolicy.VOLATILE),
        # A replay does not assert liveliness manually.
        liveliness=LivelinessPolicy.AUTOMATIC,
        deadline=_duration(profile.get('deadline')), lifespan=_duration(profile.get('lifespan')))


def _policy(policies: Any, value: object, default: Any) -> Any:
    """Return a policy by name or number; the default if no publisher can offer it."""
    offered = {policy.short_key: policy for policy in policies
               if policy.name not in ('SYSTEM_DEFAULT', 'UNKNOWN', 'BEST_AVAILABLE')}
    if isinstance(value, int):
        return next((policy for policy in offered.values() if policy.value == value), default)
    return offered.get(value, default) if isinstance(value, str) else default


def _duration(value: object) -> Duration:
    """Return a duration; an infinite or missing one becomes zero, which means unspecified."""
    if not isinstance(value, dict):
        return Duration()
    seconds, nanoseconds = value.get('sec', 0), value.get('nsec', 0)
    if not (_is_count(seconds, _MAX_QOS_SECONDS) and _is_count(nanoseconds, 10**9)):
        return Duration()
    return Duration(seconds=seconds, nanoseconds=nanoseconds)


def _is_count(value: object, beyond: int) -> bool:
    return type(value) is int and 0 <= value < beyond


class ReplayNode(RobustNode):
    """
    Node that publishes a bag.

    Parameters
    ----------
    bag : Path
        A folder with the files of one bag, or one file.
    values : dict
        Parameters from command-line options; the others come from ROS.
    arguments : sequence of str
        Command line with these options.

    Attributes
    ----------
    reader : BagReader
        Reader of the bag.
    publishers_of : dict
        Publishers by channel of the bag.
    player : Player
        Player of the messages, started after the discovery of subscribers.

    Raises
    ------
    HnnViRosError
        The bag or a parameter cannot be used; one line.

    """

    def __init__(self, bag: Path, values: dict[str, Value], arguments: Sequence[str]):
        with plain_ros_errors():
            super().__init__('hnn_replay', parameter_overrides=[
                Parameter(name, value=value) for name, value in values.items()],
                automatically_declare_parameters_from_overrides=True)
        settings = declare_parameters(self, ReplaySettings)
        self.reader = BagReader(bag)
        topics = {CLOCK_TOPIC, *(found.topic for found in self.reader.channels.values())}
        refuse_unknown(self, REPLAY_PARAMETERS, [
            Endpoint(name, 'publisher') for name in sorted(topics) if _is_topic(name)], arguments)
        self.publishers_of = self._open(settings)
        first = self.reader.first + round(settings.start_offset * 1e9)
        last = self.reader.last
        if first > last:
            raise ParameterError(
                f'parameter start_offset = {settings.start_offset:g}: the bag is '
                f'{(last - self.reader.first) * 1e-9:g} s long')
        if settings.duration:
            last = min(last, first + round(settings.duration * 1e9))
        if settings.publish_clock and last >= _CLOCK_END:
            raise ParameterError(
                f'parameter publish_clock: the bag ends at {last * 1e-9:.9g} s, and {CLOCK_TOPIC} '
                f'counts to {_CLOCK_END // 10**9} s; remove publish_clock, or limit the duration')
        clock = create_publisher(
            self, ClockMessage, CLOCK_TOPIC, CLOCK_QOS) if settings.publish_clock else None
        self.player = Player(
            lambda: read_ahead(chain(
                self._latched(first), self.reader.messages(self.publishers_of, first, last))),
            lambda message: self.publishers_of[message.channel].publish(message.data),
            None if clock is None else lambda stamp: clock.publish(clock_message(stamp)),
            first, last, settings.rate, settings.loop, settings.start_paused,
            self.get_logger().info)
        self.get_logger().info(
            f'{self.reader.path}: {(last - first) * 1e-9:.6g} s, at rate {settings.rate:g}')
        self.create_service(SetBool, '~/set_pause', self._on_set_pause)
        self.create_service(Trigger, '~/step', self._on_step)
        self._discovery = Discovery(lambda: sum(
            publisher.get_subscription_count() for publisher in self.publishers_of.values()),
            settings.discovery_time)
        self._timer = steady_timer(self, DISCOVERY_PERIOD, self._start_when_discovered)

    @property
    def started(self) -> bool:
        """Return True once the playback has started."""
        return self._timer.is_canceled()

    def report(self) -> str:
        """Summarise the number of published messages and their lateness."""
        player, late = self.player, ''
        if errors := player.timing_errors():
            late = '; late by ' + ', '.join(
                f'{name} {value:.3f} ms' for name, value in errors.items())
        return f'{player.published} messages published{late}'

    def _open(self, settings: ReplaySettings) -> dict[int, Publisher]:
        """Create the publishers, one for each topic; return them by channel."""
        wanted = [name.strip() for name in settings.topics.split(',') if name.strip()]
        known = sorted({channel.topic for channel in self.reader.channels.values()})
        if unknown := [name for name in wanted if name not in known]:
            raise ParameterError(f'parameter topics: {unknown[0]!r} is not in the bag; it '
                                 f'contains: {listed(known) or "none"}')
        left_out = {CLOCK_TOPIC} if settings.publish_clock else set()
        if not wanted:
            left_out |= self._heard()
        topics: dict[str, Publisher] = {}
        publishers: dict[int, Publisher] = {}
        for number, channel in self.reader.channels.items():
            name = channel.topic
            if name in left_out or (wanted and name not in wanted):
                continue
            try:
                if name not in topics:
                    topics[name] = self._publisher(number)
                publishers[number] = topics[name]
            except RecordingError as problem:
                self.get_logger().warning(f'{name} is omitted: {problem}')
        if not publishers:
            raise RecordingError(f'{self.reader.path}: contains no topic that can be published')
        return publishers

    def _heard(self) -> set[str]:
        """Return the command topics of a recorded simulator, which would drive a running one."""
        topics = own_topics(self.reader)
        heard = {self.reader.channels[number].topic for name, number in topics.items()
                 for one in INPUTS if name.endswith(one.topic[1:])
                 and f'{name.removesuffix(one.topic[1:])}/scene' in topics}
        for name in sorted(heard):
            self.get_logger().info(f'{name} is omitted, since it would drive a running simulator; '
                                   'name it in topics to publish it')
        return heard

    def _latched(self, first: int) -> Iterator[RecordedMessage]:
        """Yield the latched messages from before the start, for which subscribers then wait."""
        latched = [number for number, publisher in self.publishers_of.items()
                   if publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL]
        if first > self.reader.first:
            newest = {message.channel: message for message
                      in self.reader.messages(latched, last=first - 1)}
            yield from (message._replace(time=first) for message in newest.values())

    def _publisher(self, number: int) -> Publisher:
        channel = self.reader.channels[number]
        schema = self.reader.schemas.get(channel.schema_id)
        if channel.message_encoding != 'cdr' or schema is None:
            raise RecordingError(f'its messages are encoded as {channel.message_encoding!r}, '
                                 'expected cdr')
        message_type = find_type(schema.name)
        recorded = channel.metadata.get('topic_type_hash', '')
        if recorded and recorded != type_hash(schema.name):
            raise RecordingError(f'the installed definition of {schema.name} differs from the '
                                 'recorded one')
        try:
            return create_publisher(self, message_type, channel.topic, recorded_qos(
                channel.metadata.get('offered_qos_profiles', '')))
        except (RuntimeError, ValueError, InvalidTopicNameException) as problem:
            raise RecordingError(' '.join(str(problem).split())) from problem

    def _start_when_discovered(self) -> None:
        if self._discovery.over:
            self._timer.cancel()
            freeze_memory()
            self.player.start()

    def _on_set_pause(self, request: SetBool.Request, response: SetBool.Response
                      ) -> SetBool.Response:
        self.player.set_paused(request.data)
        response.success, response.message = True, 'paused' if request.data else 'playing'
        return response

    def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        stamp = self.player.step()
        response.success = stamp is not None
        response.message = 'only possible while paused; see ~/set_pause' if stamp is None \
            else f't = {stamp * 1e-9:.9f} s'
        return response


def _is_topic(name: str) -> bool:
    try:
        return validate_full_topic_name(name)
    except InvalidTopicNameException:
        return False


def find_type(name: str) -> type:
    """Return the class of a message type, ``'std_msgs/msg/Float64'``; RecordingError if none."""
    package, _, rest = name.partition('/')
    try:
        # An import runs code, so that only packages of messages are imported.
        if not (package.isidentifier() and has_resource('rosidl_interfaces', package)):
            raise ModuleNotFoundError(f'no message package {package!r}')
        found = getattr(import_module(f'{package}.msg'), rest.rpartition('/')[2])
        if not hasattr(type(found), '_TYPE_SUPPORT'):
            raise AttributeError(f'{name} is not a message type')
        return found
    except (ImportError, AttributeError) as problem:
        raise RecordingError(f'its type {name} is not installed; source the workspace that '
                             'contains it') from problem


def play(bag: Path, given: dict[str, Value], argv: list[str]) -> int:
    """Play a bag until its end or a signal."""
    with ros_process(argv) as received:
        sys.setswitchinterval(THREAD_TURN)
        return _play(ReplayNode(bag, given, argv), received)


def _play(node: ReplayNode, received: Sequence[int]) -> int:
    player = node.player
    spin(node, lambda: received or (node.started and not player.is_alive()))
    if node.started:
        player.stop()
    wait_for_delivery(node, set(node.publishers_of.values()), received)
    node.get_logger().info(node.report())
    if node.reader.damage:
        node.get_logger().warning(node.reader.damage)
    node.destroy_node()
    if player.problem is not None:
        if isinstance(player.problem, HnnViRosError | OSError):
            raise RecordingError(f'replay stopped: {player.problem}') from player.problem
        raise player.problem
    return 0
