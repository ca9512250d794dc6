# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Texts of others, of bags, scenes and models: none of their control characters is printed."""

import json
from pathlib import Path
import re

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import printable, RecordingError
from hnn_vi_ros.recording import BagReader, serialize
from processes import finish, start_executable
import pytest
from python_process import run_code
from recorded import copy_channels, record_run, writing
from scene_files import write_scene
from sensor_msgs.msg import JointState
import yaml

# The title of a terminal, by OSC; clear it; one of C1, which some terminals obey; right to left; a
# line break; delete; invisible letters.
EVIL = 'x\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp.\u2066\x7f\u200b\u2028\ny'
SHOWN = r'x\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp.\u2066\x7f\u200b\u2028\ny'
# All that a terminal may obey, or that hides or turns what is read.
CONTROL = re.compile('[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f'
                     '\ufeff]')


CONFIG = """\
coordinates: [{name: angle, q_unit: rad, p_unit: kg m2/s}]
data: {kind: bag, joints: [angle], q: nothing}
"""


def assert_plain(text: str) -> None:
    assert not CONTROL.search(text), repr(text)


def test_error_is_one_line_that_shows_control_characters():
    problem = RecordingError(f'{EVIL}: is no bag')
    assert str(problem) == f'{SHOWN}: is no bag'
    # Nothing else changes, and what is shown is not changed again.
    assert printable(SHOWN) == SHOWN
    assert printable('q̇ = ∂H/∂p, Größe [µs], 角度') == 'q̇ = ∂H/∂p, Größe [µs], 角度'
    assert printable('a\tb\nc\r', keep='\n\t\r') == 'a\tb\nc\r'


STREAMS = """
import logging, sys, warnings
from hnn_vi_ros.files.standard_streams import harden_streams, rewrite_line
harden_streams()
evil = sys.argv[1]
print(f'out {evil}')
print('error', evil, file=sys.stderr)
logging.getLogger('x').warning(evil)
warnings.warn(evil)
rewrite_line(sys.stdout, evil)
raise ValueError(evil)
"""


def test_streams_show_control_characters_of_what_is_printed_logged_warned_and_raised():
    result = run_code(STREAMS, EVIL, text=False)
    # Lines end where whoever prints wants it.
    out, error = result.stdout.decode(), result.stderr.decode()
    assert out == 'out ' + SHOWN.replace(r'\n', '\n') + f'\n\r\x1b[K{SHOWN}'
    assert_plain(error)
    assert error.count(r'\x1b]0;owned\x07') >= 4


LOG = """
import sys
import rclpy
from hnn_vi_ros.ros.plumbing.starting import init_ros
from type_description_interfaces.srv import GetTypeDescription
init_ros([])
node = rclpy.create_node('evil')
node.get_logger().warning(sys.argv[1])
rclpy.logging.get_logger('other').error(sys.argv[1], once=True)
client = node.create_client(GetTypeDescription, 'evil/get_type_description')
assert client.wait_for_service(60.0)
for text in ('RIHS01_' + 64 * '0', sys.argv[1]):
    future = client.call_async(GetTypeDescription.Request(type_name=sys.argv[1], type_hash=text))
    rclpy.spin_until_future_complete(node, future, timeout_sec=60.0)
    assert not future.result().successful
"""


def test_log_of_ros_shows_control_characters():
    result = run_code(LOG, EVIL, encoding='utf-8')
    assert result.returncode == 0
    assert result.stderr.count(SHOWN) == 2
    assert_plain(result.stderr)


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """Return a bag of a run, with texts that are hostile wherever one can be."""
    folder = tmp_path_factory.mktemp('evil')
    reader = BagReader(record_run(folder / 'good', load_scene('exact_pendulum'), 20))
    scene = yaml.safe_load(reader.attachment('scene.yaml'))
    path = folder / 'evil.mcap'
    with writing(path, EVIL, EVIL) as writer:
        writer.add_attachment(0, 0, 'scene.yaml', EVIL, yaml.safe_dump(
            scene | {'description': EVIL, 'source': f'/{EVIL}'}).encode())
        writer.add_metadata('hnn_vi_ros', dict.fromkeys(reader.metadata('hnn_vi_ros'), EVIL))
        for number, (topic, kind) in enumerate((
                (f'/{EVIL}', 'std_msgs/msg/String'), ('/foreign', f'std_msgs/msg/{EVIL}'))):
            channel = writer.register_channel(
                topic, 'cdr', writer.register_schema(kind, 'ros2msg', b''),
                {'offered_qos_profiles': EVIL})
            writer.add_message(channel, number, b'\0\1\0\0' + bytes(8), 0)
        channels = copy_channels(writer, reader)
        for message in reader.messages():
            writer.add_message(channels[message.channel], message.time, message.data, 0)
        joints, = (channels[number] for number, channel in reader.channels.items()
                   if channel.topic == '/joint_states')
        writer.add_message(joints, 10**9, serialize(JointState(name=[EVIL], position=[1.0])), 0)
    return path


@pytest.mark.parametrize('name, words, status', [
    ('replay', ('{bag}', '--verify'), 0), ('replay', ('{bag}', '--discovery-time', '0'), 0),
    ('replay', ('{bag}', '--topics', '/none'), 1),
    ('train', ('--config', '{config}', '--data', '{bag}'), 1),
    ('evaluate', ('exact_pendulum', '--data', '{bag}', '--joints', 'none'), 1),
    ('scene', ('--check', '{scene}'), 1)])
def test_executables_show_control_characters_of_a_file(tmp_path, bag, name, words, status):
    (tmp_path / 'config.yaml').write_text(CONFIG)
    places = {'bag': bag, 'config': tmp_path / 'config.yaml', 'scene': write_scene(
        tmp_path / 'scene.yaml', json.dumps(EVIL))}
    found, out, error = finish(start_executable(
        name, *(word.format(**places) for word in words), folder=tmp_path), 120.0)
    assert_plain(out)
    assert_plain(error)
    assert r'x\x1b]0;owned\x07' in out + error
    assert found == status
