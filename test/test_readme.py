# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The README: its code runs, its tables and listings are those of the package."""

from pathlib import Path
import re
import subprocess
import sys

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.effects.base import coordinate_index, Force
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.learning.bag_data import BagData
from hnn_vi_ros.ros.parameters import markdown_table
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
import yaml

ROOT = Path(__file__).parents[1]
README = (ROOT / 'README.md').read_text(encoding='utf-8')
PYTHON = re.findall(r'```python\n(.*?)```', README, re.DOTALL)


def test_readme_parameter_table_is_that_of_the_node():
    assert markdown_table() in README


def test_readme_listener_is_the_executable():
    source = (ROOT / 'hnn_vi_ros' / 'ros' / 'listener_node.py').read_text(encoding='utf-8')
    assert PYTHON[0].strip() in source


def test_readme_scene_is_a_shipped_one():
    scene = re.search(r'```yaml\n(.*?)```', README, re.DOTALL)[1]
    assert scene == (ROOT / 'config' / 'scenes' / 'harmonic_oscillator.yaml').read_text()


def test_readme_bag_data_is_valid():
    (data,) = (block for block in re.findall(r'```yaml\n(.*?)```', README, re.DOTALL)
               if 'kind: bag' in block)
    assert BagData.model_validate(yaml.safe_load(data)['data']).block == 2.0


def test_readme_effects_table_is_that_of_the_package():
    rows = re.findall(r'^\| `(\w+)` \| .* \| (kept|changes) \| .* \|$', README, re.MULTILINE)
    assert rows == [(kind, 'kept' if effect.conservative else 'changes')
                    for kind, effect in EFFECTS.items()]


def test_readme_python_example_runs(capsys):
    exec(compile(PYTHON[2], 'README.md', 'exec'), {})
    assert '1001' in capsys.readouterr().out


def test_readme_bag_example_reads_the_bag_of_a_run(tmp_path, monkeypatch, capsys):
    values = {'duration': 1, 'real_time_factor': 0, 'rerun_sink': 'none', 'discovery_time': 0}
    subprocess.run(
        [sys.executable, '-c', 'from hnn_vi_ros.cli import simulator; simulator()', '--ros-args',
         *[word for name, value in values.items() for word in ('-p', f'{name}:={value}')]],
        cwd=tmp_path, capture_output=True, timeout=120, check=True)
    monkeypatch.chdir(tmp_path)
    exec(compile(PYTHON[1], 'README.md', 'exec'), {})
    assert re.match(r'runs/harmonic_oscillator-.*/bag 1.0 s 0.[45]\d+ J', capsys.readouterr().out)


def test_readme_effect_of_your_own_works():
    source = next(text for text in PYTHON if 'class Wind' in text)
    names = {'Force': Force, 'coordinate_index': coordinate_index, 'inlined': inlined,
             '__name__': 'wind'}
    exec(compile(source, 'README.md', 'exec'), names)
    wind = names['Wind']('x', coefficient=0.5, speed=2.0)
    simulation = Simulation(HAMILTONIANS['free_particle'](), INTEGRATORS['gauss8'](), 0.1, [0.0],
                            [0.0], [wind])
    simulation.advance(10)
    # v = u (1 - exp(-b t / m)); the round-off of ten steps.
    assert simulation.p[0] == pytest.approx(2.0 * (1.0 - np.exp(-0.5)), abs=1e-13)
    assert simulation.works['Wind'] == pytest.approx(simulation.energy, abs=1e-13)


@pytest.mark.parametrize('link', re.findall(r'\]\((?!http)([^)#]+)\)', README))
def test_readme_link_leads_to_a_file(link):
    assert (ROOT / link).exists()
