# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What works without the extras `train`, `rerun` and `sweep`, and what names the missing one."""

import subprocess
import sys

from hnn_vi_ros.files.resources import shipped_names
import pytest

HIDE = """
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {hidden!r}:
            raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)
sys.meta_path.insert(0, Hide())
"""
# What a light install lacks, and what only training brings.
TRAINING = {'matplotlib', 'torch'}
# What the extras of recordings and of sweeps bring.
RECORDING = {'rerun', 'rerun_bindings', 'pyarrow', 'PIL', 'psutil', 'attr'}


def status_of(code: str, hidden: set[str] = TRAINING) -> int:
    """Run code in a process that cannot import some packages; return its status."""
    return subprocess.run([sys.executable, '-c', HIDE.format(hidden=hidden) + code], check=False,
                          timeout=300).returncode


SIMULATED = """
from hnn_vi_ros import load_scene, simulate
trajectory = simulate(load_scene('harmonic_oscillator'), 1.0)
assert abs(trajectory.energy - trajectory.energy[0]).max() < 0.01 * trajectory.energy[0]
"""


@pytest.mark.parametrize('hidden', [TRAINING, RECORDING])
def test_learned_scene_is_simulated_without_extras(hidden):
    assert status_of(SIMULATED, hidden) == 0


def test_models_of_every_family_are_loaded_without_the_extra_of_training():
    assert status_of(f"""
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.files.resources import shipped_file
for name in {shipped_names('model')!r}:
    load_checkpoint(shipped_file('model', name))
""") == 0


# matplotlib takes pillow itself.
def test_run_is_simulated_and_drawn_without_rerun_and_pyarrow(tmp_path):
    assert status_of(f"""
from hnn_vi_ros import cli
sys.argv = ['hnn', 'run', 'pendulum', '--duration', '1', '--plot', {str(tmp_path / 'a.png')!r}]
cli.main()
""", RECORDING - {'PIL'}) == 0
    assert (tmp_path / 'a.png').stat().st_size > 0


def test_trajectory_is_drawn_without_rerun_and_pyarrow_and_names_what_a_recording_takes(tmp_path):
    assert status_of(SIMULATED + f"""
from hnn_vi_ros.errors import MissingPackage
trajectory.plot().savefig({str(tmp_path / 'a.png')!r})
try:
    trajectory.to_rerun({str(tmp_path / 'a.rrd')!r})
except MissingPackage as problem:
    assert str(problem).startswith('to_rerun needs the Python package rerun; install it with: ')
    assert str(problem).endswith(' -m pip install "rerun-sdk>=0.41,<0.42"')
else:
    raise AssertionError('it is hidden')
""", RECORDING - {'PIL'}) == 0


def test_sweep_in_python_names_what_it_takes():
    assert status_of("""
from hnn_vi_ros.errors import MissingPackage
try:
    from hnn_vi_ros import sweep
except MissingPackage as problem:
    assert str(problem).startswith('a sweep needs the Python package pyarrow; install it with: ')
else:
    raise AssertionError('it is hidden')
""", RECORDING) == 0


@pytest.mark.parametrize('module, hidden', [
    *[(module, {'rerun', 'pyarrow'}) for module in (
        'commands.cost', 'envs', 'learning.scene_numbers.identify', 'learning.import_checkpoint',
        'ros.controller_node', 'companions.members', 'torch')],
    *[(module, TRAINING) for module in ('ros.rerun_bridge', 'viewer.rerun_sink')],
    # Scipy takes a tenth of a start.
    *[(module, TRAINING | {'rerun', 'pyarrow', 'scipy'}) for module in (
        'bags.recover_bag', 'commands.scene_tool', 'ros.listener_node', 'ros.replay.replay_node',
        'ros.simulator_node')]])
def test_what_runs_is_imported_without_what_it_does_not_take(module, hidden):
    assert status_of(f'import hnn_vi_ros.{module}', hidden) == 0
