# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What works without the extras `train`, `rerun` and `sweep`, and what names the missing one."""

from hnn_vi_ros.files import shipped_names
import pytest
from sources import ROOT, run_without

IMPORTS = """
from importlib import import_module
from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.errors import MissingPackage
"""
RECORDED = ROOT / 'test' / 'fixtures' / 'recorded'
# What a light install lacks, and what only training brings.
TRAINING = {'matplotlib', 'torch'}
# What the extras of recordings and of sweeps bring.
# Packages of ROS 2 that nodes import.
ROS = {'rclpy', 'ament_index_python', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs',
       'lifecycle_msgs', 'rcl_interfaces', 'sensor_msgs', 'std_msgs', 'std_srvs',
       'trajectory_msgs'}
RECORDING = {'rerun', 'rerun_bindings', 'pyarrow', 'PIL', 'psutil', 'attr'}
SIMULATED = """
trajectory = simulate(load_scene('harmonic_oscillator'), 1.0)
assert abs(trajectory.energy - trajectory.energy[0]).max() < 0.01 * trajectory.energy[0]
"""


def assert_done(code: str, hidden: set[str]) -> None:
    """Run code in a process that cannot import some packages."""
    done = run_without(hidden, IMPORTS + code)
    assert done.returncode == 0, done.stderr


def test_light_install_imports_nodes_simulates_and_names_what_a_sweep_takes():
    # Scipy takes a tenth of a start. What is imported stays so: what is hidden gets less.
    assert_done(f"""
for module in ('recording.bags.recover_bag', 'commands.scene_tool', 'ros.listener_node',
               'ros.replay.replay_node', 'ros.simulator_node'):
    import_module(f'hnn_vi_ros.{{module}}')
hidden -= {{'scipy'}}
{SIMULATED}
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.files.resources import shipped_file
for name in {shipped_names('model')!r}:
    load_checkpoint(shipped_file('model', name))
try:
    from hnn_vi_ros import sweep
except MissingPackage as problem:
    assert str(problem).startswith('a sweep needs the Python package pyarrow; install it with: ')
else:
    raise AssertionError('it is hidden')
hidden -= {RECORDING!r}
for module in ('ros.replay.picture', 'recording.viewer.rerun_sink'):
    import_module(f'hnn_vi_ros.{{module}}')
assert not {TRAINING!r} & {{*sys.modules}}
""", TRAINING | RECORDING | {'scipy'})


def test_run_is_simulated_and_drawn_without_what_a_recording_takes(tmp_path):
    # matplotlib takes pillow itself.
    assert_done(f"""
for module in ('commands.cost', 'envs', 'identify.identify', 'learning.import_model',
               'ros.controller_node', 'run.companions.members', 'torch'):
    import_module(f'hnn_vi_ros.{{module}}')
{SIMULATED}
trajectory.plot().savefig({str(tmp_path / 'trajectory.png')!r})
try:
    trajectory.to_rerun({str(tmp_path / 'a.rrd')!r})
except MissingPackage as problem:
    assert str(problem).startswith('to_rerun needs the Python package rerun; install it with: ')
    assert str(problem).endswith(' -m pip install "rerun-sdk>=0.41,<0.42"')
else:
    raise AssertionError('it is hidden')
from hnn_vi_ros import cli
sys.argv = ['hnn', 'run', 'pendulum', '--duration', '1', '--plot', {str(tmp_path / 'run.png')!r}]
cli.main()
""", RECORDING - {'PIL'})
    for name in ('trajectory.png', 'run.png'):
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.parametrize('name', ['pendulum', 'servo_arm'])
def test_bag_is_verified_without_ros(name):
    """Of a machine that takes commands, too; the processor of the recording is another."""
    done = run_without(ROS | RECORDING, f"""
from hnn_vi_ros import cli
sys.argv = ['hnn', 'replay', {str(RECORDED / name)!r}, '--verify']
cli.main()
""")
    assert 'samples are bit-identical' in done.stdout, done.stderr
    assert done.stderr == ''
