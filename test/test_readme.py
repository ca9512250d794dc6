# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The code in the README and in the pages of docs runs."""

import re
import subprocess
import sys

from hnn_vi_ros.effects.base import coordinate_index, Force
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.learning.data.bags import BagData
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
from sources import blocks, ROOT
import yaml

SHIPPED_SCENE = ROOT / 'config' / 'scenes' / 'harmonic_oscillator.yaml'


def run(code: str, names: dict[str, object] | None = None) -> dict[str, object]:
    """Run a block of Python; return its names."""
    names = {} if names is None else names
    exec(compile(code, 'page', 'exec'), names)
    return names


def test_listener_of_the_tutorial_is_the_executable():
    source = (ROOT / 'hnn_vi_ros/ros/listener_node.py').read_text(encoding='utf-8')
    (listener,) = blocks(ROOT / 'docs/tutorials/first-simulation.md', 'python')
    # What a RobustNode is more than a Node is of no interest there.
    _, _, body = listener.strip().partition('class Listener(Node):\n')
    assert body and f'class Listener(RobustNode):\n{body}' in source


def test_first_scene_of_a_page_is_a_shipped_one():
    for page in ('README.md', 'docs/tutorials/scene.md'):
        assert blocks(ROOT / page, 'yaml')[0] == SHIPPED_SCENE.read_text(encoding='utf-8'), page


def test_data_of_the_bag_tutorial_are_valid():
    (data,) = blocks(ROOT / 'docs/tutorials/bag-to-verdict.md', 'yaml')
    assert BagData.model_validate(yaml.safe_load(data)['data']).block == 2.0


def test_readme_python_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(ROOT / 'README.md', 'python')
    run(example)
    assert '1001' in capsys.readouterr().out
    assert (tmp_path / 'oscillator.png').is_file()


def test_python_tutorial_runs(capsys):
    for example in blocks(ROOT / 'docs/tutorials/python.md', 'python'):
        run(example)
    assert '(2, 1000, 1)' in capsys.readouterr().out


def test_quadrotor_of_the_tutorial_climbs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(ROOT / 'docs/tutorials/quadrotor.md', 'python')
    names = run(example)
    # A tenth of g for 2 s is 1.962 m; the drag takes less than a tenth of that.
    height = names['height']
    assert 0.9 * 1.962 < height[-1] - height[0] < 1.962


def test_bag_example_reads_the_bag_of_a_run(tmp_path, monkeypatch, capsys):
    values = {'duration': 1, 'real_time_factor': 0, 'rerun_sink': 'none', 'discovery_time': 0}
    subprocess.run(
        [sys.executable, '-c', 'from hnn_vi_ros.cli import simulator; simulator()', '--ros-args',
         *[word for name, value in values.items() for word in ('-p', f'{name}:={value}')]],
        cwd=tmp_path, capture_output=True, timeout=120, check=True)
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(ROOT / 'docs/how-to/bags.md', 'python')
    run(example)
    assert re.match(r'runs/harmonic_oscillator-.*/bag 1.0 s 0.[45]\d+ J', capsys.readouterr().out)


def test_effect_of_your_own_works():
    (source,) = blocks(ROOT / 'docs/how-to/own-effect.md', 'python')
    names = run(source, {'Force': Force, 'coordinate_index': coordinate_index,
                         'inlined': inlined, '__name__': 'wind'})
    wind = names['Wind']('x', coefficient=0.5, speed=2.0)
    simulation = Simulation(HAMILTONIANS['free_particle'](), INTEGRATORS['gauss8'](), 0.1, [0.0],
                            [0.0], [wind])
    simulation.advance(10)
    # v = u (1 - exp(-b t / m)); the round-off of ten steps.
    assert simulation.p[0] == pytest.approx(2.0 * (1.0 - np.exp(-0.5)), abs=1e-13)
    assert simulation.works['Wind'] == pytest.approx(simulation.energy, abs=1e-13)
