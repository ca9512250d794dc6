# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""YAML by each of the ways in, a file, a bag and a topic: read, or refused in one line."""

from collections.abc import Callable, Iterator
from pathlib import Path

from hnn_vi_ros import load_scene
from hnn_vi_ros.commands.scene_tool import check
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.recording.bags.bag_metadata import qos_profiles
from hnn_vi_ros.recording.bags.mcap_reader import BagReader
from hnn_vi_ros.ros import rerun_bridge
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun
from hnn_vi_ros.ros.replay.replay_node import recorded_qos
from hnn_vi_ros.run.report import scene_report
from hnn_vi_ros.simulation.construction import build
from hypothesis import given, HealthCheck, settings, strategies
import pytest
import rclpy
from rclpy.qos import QoSProfile
from recorded import record_run
from scene_files import ACTED_ON, scene_text
from std_msgs.msg import String

SCENE = scene_text(integrator='variational_euler')
NAMED = [
    SCENE.replace('0.01', '1' + ':1' * 300_000), SCENE.replace('0.01', '[' * 20_000),
    SCENE.replace('0.01', '2020-13-45'), SCENE.replace('0.01', '9' * 5000),
    SCENE.replace('0.01', '!!python/object/apply:os.abort []'),
    SCENE.replace('0.01', '[' + '1,' * 500_000 + ']'),
    'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
        f'{name}: &{name} [{", ".join(9 * ["*" + before])}]\n'
        for before, name in zip('abcdefgh', 'bcdefghi', strict=True)) + SCENE,
    SCENE.replace('[1.0]', '[' + 'a,' * 20_000 + ']'),
    scene_text(effects='{kind: damping, rate: [' + 'a,' * 40_000 + ']}'),
    scene_text(effects='{kind: x},' * 10_000)]


@pytest.fixture(scope='module')
def ways(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Callable[[str], str]]]:
    """Return what takes a text in by each way, and returns what was said of it."""
    folder: Path = tmp_path_factory.mktemp('ways')
    bag = record_run(folder / 'bag', load_scene('exact_pendulum'), 3)
    change = pytest.MonkeyPatch()
    # The picture of a scene that is good is another matter.
    change.setattr(rerun_bridge, 'BridgePicture', lambda *arguments: None)
    rclpy.init()
    node = rerun_bridge.RerunBridge()
    told: list[str] = []
    change.setattr(node, 'get_logger', lambda: Log(told))

    def file(text: str) -> str:
        (folder / 'mine.yaml').write_bytes(text.encode('utf-8', 'surrogatepass'))
        with pytest.MonkeyPatch.context() as within:
            within.setattr('builtins.print', lambda line, **options: told.append(line))
            check([str(folder / 'mine.yaml')])
        return told.pop()

    def attachment(text: str) -> str:
        with pytest.MonkeyPatch.context() as within:
            within.setattr(BagReader, 'attachment',
                           lambda reader, name: text.encode('utf-8', 'surrogatepass'))
            try:
                RecordedRun(bag)
            except HnnViRosError as problem:
                return str(problem)
        return 'valid'

    def topic(text: str) -> str:
        node._described = None
        node._on_scene(String(data=text.encode(errors='replace').decode()))
        assert node.problem is None
        return told.pop()
    yield {'file': file, 'attachment': attachment, 'topic': topic}
    change.undo()
    node.destroy_node()
    rclpy.shutdown()


class Log:
    """Keep what is logged."""

    def __init__(self, told: list[str]):
        self.info = self.error = told.append


@pytest.mark.timeout(120)
@pytest.mark.parametrize('way', ['file', 'attachment', 'topic'])
@pytest.mark.parametrize('text', NAMED, ids=range(len(NAMED)))
def test_yaml_that_exhausted_the_machine_is_refused_in_one_line(ways, way, text):
    said = ways[way](text)
    place = {'file': 'mine.yaml:', 'attachment': 'its scene:', 'topic': '~/scene:'}[way]
    assert place in said and '\n' not in said and len(said) < 2000


@pytest.mark.parametrize('way', ['file', 'attachment', 'topic'])
def test_scene_is_read_by_each_way(ways, way):
    assert any(word in ways[way](SCENE) for word in ('valid', 'showing'))


RESOLVED = dump_yaml(scene_report(
    load_scene('exact_pendulum'), build(load_scene('exact_pendulum'))))
PIECES = strategies.one_of(
    strategies.text(max_size=8), strategies.floats().map(str), strategies.integers().map(str),
    strategies.sampled_from([
        '{', '[', '*a', '&a ', '!!float ', '? ', '- ', '1e999', '~', '1:1', '2020-13-45', '\ud800',
        'kind: python, factory: "os:abort"', '\n', '9' * 400, '"', '%', '<<: ', 'null', '[' * 40,
        'origin: -1\n', 'first_step: ' + '9' * 200 + '\n', 'source: "a\\nb\\0"\n', 'x']))


FUZZ = settings(max_examples=100, suppress_health_check=[
    HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
# Other examples each time, a hundred a part.
PARTS = pytest.mark.parametrize('part', [
    0, *(pytest.param(part, marks=pytest.mark.long) for part in (1, 2, 3))])


@PARTS
@given(way=strategies.sampled_from(['file', 'attachment', 'topic']),
       good=strategies.sampled_from([SCENE, ACTED_ON, RESOLVED]),
       changes=strategies.lists(strategies.tuples(
           strategies.integers(0, len(RESOLVED)), strategies.integers(0, 30), PIECES),
           min_size=1, max_size=3))
@FUZZ
def test_mutated_yaml_is_read_or_refused_in_one_line(ways, way, good, changes, part):
    for start, length, piece in changes:
        good = good[:start] + piece + good[start + length:]
    assert '\n' not in ways[way](good)


@PARTS
@given(way=strategies.sampled_from(['file', 'attachment', 'topic']), text=strategies.one_of(
    strategies.text(max_size=80), strategies.dictionaries(
        strategies.sampled_from(['hamiltonian', 'effects', 'integrator', 'step_size', 'source',
                                 'initial_state', 'origin', 'model_files', 'mechanism']),
        strategies.recursive(
            strategies.none() | strategies.booleans() | strategies.integers()
            | strategies.floats() | strategies.text(max_size=8),
            lambda inner: strategies.lists(inner, max_size=3) | strategies.dictionaries(
                strategies.sampled_from(['kind', 'q', 'p', 'model', 'factory']), inner),
            max_leaves=8)).map(dump_yaml)))
@FUZZ
def test_random_yaml_is_read_or_refused_in_one_line(ways, way, text, part):
    assert '\n' not in ways[way](text)


@PARTS
@given(text=strategies.one_of(
    strategies.text(max_size=50), strategies.lists(strategies.dictionaries(
        strategies.sampled_from(['history', 'depth', 'reliability', 'durability', 'deadline']),
        strategies.one_of(
            strategies.none(), strategies.integers(), strategies.text(max_size=5),
            strategies.floats(), strategies.lists(strategies.integers(), max_size=2),
            strategies.dictionaries(strategies.sampled_from(['sec', 'nsec']), strategies.one_of(
                strategies.integers(), strategies.text(max_size=3), strategies.none())))),
        max_size=2).map(dump_yaml)))
@FUZZ
def test_any_recorded_qos_gives_a_profile(text, part):
    assert isinstance(recorded_qos(text), QoSProfile)
    assert isinstance(qos_profiles(text), list)
