# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The study that makes a model of a bag, with a short bag and a network that learns little."""

from pathlib import Path

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.learning.fit.config import find_config
from hnn_vi_ros.learning.train import main as train
from hnn_vi_ros.scene import load_scene
from messages import refused
import pytest
from ros.recorded import record_run
from studies import bag_to_model as study


@pytest.fixture
def short(monkeypatch, tmp_path):
    """Make the study short; return the words of the commands that it runs."""
    for name, value in {'RECORDED': 2.0, 'SIMULATED': 0.1, 'STARTS': 2}.items():
        monkeypatch.setattr(study, name, value)
    monkeypatch.chdir(tmp_path)
    text = find_config(study.CONFIG).read_text()
    for line, less in (('adam_steps: 500', 'adam_steps: 50'),
                       ('lbfgs_steps: 3000', 'lbfgs_steps: 0'), ('[64, 64, 64]', '[8]')):
        assert line in text
        text = text.replace(line, less)
    Path('tiny.yaml').write_text(text)
    commands = []

    def run(words):
        commands.append(words[0])
        if words[0] == 'simulator':
            record_run(Path('out/bag'), load_scene(study.SCENE), 200)
        else:
            train(['--config', 'tiny.yaml', *words[3:]])

    monkeypatch.setattr(study, '_run', run)
    return commands


def test_study_makes_what_is_missing_and_writes_its_page(short, capsys):
    assert study.main(['--out', 'out', '--docs', 'docs']) == 1  # so little is not enough
    assert short == ['simulator', 'train']
    page = Path('docs', study.PAGE).read_text()
    assert '| the end of the bag | ' in page
    assert 'ros2 run hnn_vi_ros train --config double_pendulum_bag --data out/bag' in page
    assert '-p publish_rate:=100' in page
    assert Path('docs', study.PICTURE).read_bytes().startswith(b'\x89PNG')
    assert 'from 0 s: path error' in capsys.readouterr().out
    study.main(['--out', 'out'])
    assert short == ['simulator', 'train']


def test_study_refuses_a_bag_of_another_length(short):
    record_run(Path('out/bag'), load_scene(study.SCENE), 150)
    with refused(RecordingError):
        study.main(['--out', 'out'])


def test_committed_page_keeps_the_promises():
    page = (Path(__file__).parents[2] / 'docs' / 'evidence' / study.PAGE).read_text()
    rows = [line.split('|') for line in page.split('\n') if line.endswith('% |')]
    assert len(rows) == study.STARTS + 1
    for _, _, path_error, band, _ in rows:
        assert float(path_error.strip(' %')) < 100.0 * study.PATH_ERROR
        assert float(band.strip(' %')) < 100.0 * study.ENERGY_BAND
