# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulating takes nothing of the extra `train`."""

import subprocess
import sys

from hnn_vi_ros.files.resources import shipped_names
import pytest

# What a light install lacks, and what only training brings.
HIDE = """
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {'matplotlib', 'torch', 'tqdm'}:
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, Hide())
"""


def status_of(code: str) -> int:
    """Run code in a process that can import nothing of the extra; return its status."""
    return subprocess.run([sys.executable, '-c', HIDE + code], check=False,
                          timeout=300).returncode


def test_learned_scene_is_simulated_without_the_extra_of_training():
    assert status_of("""
from hnn_vi_ros import load_scene, simulate
trajectory = simulate(load_scene('harmonic_oscillator'), 1.0)
assert abs(trajectory.energy - trajectory.energy[0]).max() < 0.01 * trajectory.energy[0]
""") == 0


def test_models_of_every_family_are_loaded_without_the_extra_of_training():
    assert status_of(f"""
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.files.resources import shipped_file
for name in {shipped_names('model')!r}:
    load_checkpoint(shipped_file('model', name))
""") == 0


@pytest.mark.parametrize('module', [
    'bags.recover_bag', 'ros.listener_node', 'ros.replay_node', 'ros.rerun_bridge',
    'ros.simulator_node', 'commands.scene_tool', 'viewer.rerun_sink'])
def test_what_runs_is_imported_without_the_extra_of_training(module):
    assert status_of(f'import hnn_vi_ros.{module}') == 0
