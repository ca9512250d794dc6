# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Variables of the shell that ROS cannot take are one line, before a library of it is loaded."""

import os
from pathlib import Path
import re
import sys

from hnn_vi_ros.commands import doctor
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros import prepare_ros_environment
from hnn_vi_ros.scene import load_scene
from messages import refused
from processes import simulator_words
import pytest
from python_process import run_code
from recorded import record_run

NAMES = ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'RMW_IMPLEMENTATION')
from_wheels = pytest.mark.skipif(
    not Path(sys.prefix, 'share', 'ament_index').is_dir(),
    reason='ROS 2 is not from wheels in this environment')


@pytest.fixture(autouse=True)
def middlewares(tmp_path, monkeypatch):
    """Let two middlewares be installed, and nothing be set."""
    folder = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'rmw_typesupport'
    folder.mkdir(parents=True)
    for name in ('rmw_implementation', 'rmw_fastrtps_cpp', 'rmw_zenoh_cpp'):
        (folder / name).touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)


def test_values_of_ros_pass(monkeypatch):
    for name, value in (('ROS_DOMAIN_ID', ''), ('ROS_DOMAIN_ID', '0'), ('ROS_DOMAIN_ID', '232'),
                        ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF'),
                        ('RMW_IMPLEMENTATION', 'rmw_zenoh_cpp'), ('RMW_IMPLEMENTATION', '')):
        monkeypatch.setenv(name, value)
        prepare_ros_environment()


@pytest.mark.parametrize('name, values', [
    ('ROS_DOMAIN_ID', ('abc', '-1', '233', '1.0', '0x1', '٣')),
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', ('LOCALHSOT',)),
    ('RMW_IMPLEMENTATION', ('rmw_cyclonedds_cpp',))])
def test_value_that_ros_cannot_take_is_told_with_what_it_takes(name, values, monkeypatch):
    for value in values:
        monkeypatch.setenv(name, value)
        with refused(ParameterError):
            prepare_ros_environment()


def test_middleware_is_not_judged_where_no_index_tells_of_any(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, 'prefix', '/nowhere')
    (tmp_path / 'ros' / 'share' / 'ament_index').mkdir(parents=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'ros'))
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_mine')
    prepare_ros_environment()


@pytest.mark.parametrize('prefix', ['', '/workspace'])
def test_wheels_of_this_environment_complete_a_prefix_or_what_is_missing_is_told(
        tmp_path, monkeypatch, prefix):
    monkeypatch.setenv('AMENT_PREFIX_PATH', prefix)
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'empty'))
    with refused(ParameterError):
        prepare_ros_environment()
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    prepare_ros_environment()
    assert os.environ['AMENT_PREFIX_PATH'] == f'{prefix}:{tmp_path}'.lstrip(':')
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_mine')
    with refused(ParameterError):
        prepare_ros_environment()


@from_wheels
@pytest.mark.parametrize('prefix', ['/workspace', ''])
def test_doctor_names_the_distribution_and_where_it_was_found(prefix, monkeypatch, capsys):
    monkeypatch.setenv('AMENT_PREFIX_PATH', prefix)
    monkeypatch.delenv('ROS_DISTRO', raising=False)
    doctor.main([])
    line = next(line for line in capsys.readouterr().out.splitlines() if ' ROS 2 ' in line)
    assert line.startswith('ok') and re.search(f' (jazzy|kilted), .*{prefix}', line)
    assert line.count('found from the prefix of this Python') == 1


@from_wheels
def test_simulator_runs_where_only_the_interpreter_tells_where_ros_is():
    code = ("import os; os.environ.pop('AMENT_PREFIX_PATH', None); "
            'from hnn_vi_ros.cli import simulator; simulator()')
    result = run_code(
        code, *simulator_words(duration=0.1),
        env={name: value for name, value in os.environ.items() if name != 'AMENT_PREFIX_PATH'})
    assert (result.returncode, 'Traceback' in result.stderr) == (0, False), result.stderr


def test_bag_names_the_distribution_that_it_was_recorded_with(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_DISTRO', 'kilted')
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 1)
    assert '  ros_distro: kilted' in (bag / 'metadata.yaml').read_text()


def test_node_says_it_before_ros_ends_the_process():
    # The wheels' library ends the process, with status 102, while it is loaded.
    result = run_code('from hnn_vi_ros.cli import main; main()', 'listener',
                      env={**os.environ, 'RMW_IMPLEMENTATION': 'rmw_of_nobody'})
    assert (result.returncode, result.stdout) == (1, '')
    assert result.stderr.count('\n') == 1
    assert "hnn listener: RMW_IMPLEMENTATION='rmw_of_nobody' is not installed" in result.stderr


PROFILES = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><log>
<use_default>FALSE</use_default><consumer><class>FileConsumer</class><property>
<name>filename</name><value>{}</value></property></consumer></log></dds>
"""


@from_wheels
def test_profiles_of_the_working_folder_configure_no_middleware(tmp_path):
    written = tmp_path / 'written'
    for name in ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml'):
        (tmp_path / name).write_text(PROFILES.format(written))
    found = run_code("""
import os, sys
os.chdir(sys.argv[1])
from hnn_vi_ros.ros import prepare_ros_environment
if sys.argv[2]:
    prepare_ros_environment()
import rclpy
rclpy.init()
rclpy.create_node('one').destroy_node()
""", str(tmp_path), 'prepared')
    assert found.returncode == 0 and not written.exists(), found.stderr
