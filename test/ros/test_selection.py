# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What the integrator auto chose is told, watched, and reported when it does not do."""

from dataclasses import asdict
from pathlib import Path

from hnn_vi_ros import load_scene
from hnn_vi_ros.ros.run.preparation import choice_lines
from hnn_vi_ros.run import scene_report
from hnn_vi_ros.simulation import build, Choice, choose, Tolerance
from hnn_vi_ros.simulation.accuracy import automatic_choice
from processes import finish, start
import pytest
from scene_files import scene_text
from test_health import events_of

AUTO = scene_text(integrator='auto, energy_error: 1.0e-3, horizon: 10.0').replace(
    'step_size: 0.01\n', '')
TOLERANCE = Tolerance('energy_error', 1e-3, 10.0)
CHOICE = Choice('gauss4', 0.005, 1e-4, 10.0, 1e-3, 4e3, {}, 0.5)


@pytest.fixture
def plant(tmp_path: Path, monkeypatch):
    """Give what writes a scene for which a choice was made before."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))

    def planted(choice: Choice) -> None:
        (tmp_path / 'auto.yaml').write_text(AUTO)
        with monkeypatch.context() as patch:
            patch.setattr(automatic_choice, 'calibrate', lambda *_: choice)
            choose(load_scene(tmp_path / 'auto.yaml'), 1.0 / 100.0)
    return planted


def test_choice_is_logged_shown_and_simulated(tmp_path, plant):
    plant(CHOICE)
    status, _, error = finish(start(tmp_path, scene='auto.yaml', duration=1, real_time_factor=0,
                                    rerun_path='picture.rrd'))
    assert status == 0
    assert 'calibrating for energy_error 0.001 up to 10 s' in error
    explained = CHOICE.explain(TOLERANCE)
    assert explained in error
    # A node that another test has killed may still be found.
    assert not [line for line in error.splitlines()
                if 'WARN' in line and 'of the graph have the name' not in line
                and 'publishers, /hnn_simulator, /hnn_simulator' not in line]
    events = [event[1:] for event in events_of(tmp_path / 'picture.rrd')]
    assert ('INFO', explained) in events
    assert any('gauss4, h = 0.005 s' in text for _, text in events)


def test_scene_report_carries_tolerance_and_choice(tmp_path, plant):
    plant(CHOICE)
    scene, chosen = choose(load_scene(tmp_path / 'auto.yaml'), 1.0 / 100.0)
    report = scene_report(scene, build(scene), chosen=chosen)
    assert report['tolerance'] == {'kind': 'energy_error', 'error': 1e-3, 'horizon': 10.0,
                                   'energy_scale': 0.5}
    assert report['choice'] == asdict(CHOICE)
    assert (report['integrator']['kind'], report['step_size']) == ('gauss4', 0.005)


def test_tolerance_that_is_exceeded_is_warned_of_with_both_numbers(tmp_path, plant):
    # The paper's scheme errs by h / 2 = 5e-3.
    plant(Choice('variational_euler', 0.01, 1e-4, 10.0, 1e-3, 300.0, {}, 0.5))
    status, _, error = finish(start(tmp_path, scene='auto.yaml', duration=9, real_time_factor=0,
                                    rerun_path='picture.rrd'))
    assert status == 0
    assert 'for steps that divide the sampling interval, 0.01 s; hnn run has none' in error
    line, = [line for line in error.splitlines() if 'the tolerance is exceeded' in line]
    assert '[WARN]' in line and 'energy_error 0.001' in line and 'the limit is 0.001' in line
    assert [text in line for _, level, text in events_of(tmp_path / 'picture.rrd')
            if level == 'WARN' and 'tolerance' in text] == [True]


def test_choice_that_cannot_keep_the_pace_is_warned_of_before_the_run():
    choice = Choice('gauss16', 0.01, 1e-4, 10.0, 0.25, 1e4, {}, 0.5)
    assert [event.level for event in choice_lines(TOLERANCE, choice, 0.0)] == ['INFO']
    assert [event.level for event in choice_lines(TOLERANCE, choice, 3.9)] == ['INFO']
    _, warning = choice_lines(TOLERANCE, choice, 4.1)
    assert warning.level == 'WARN'
    assert 'no integrator achieves energy_error 0.001 up to 10 s' in warning.text
    assert 'at real_time_factor 4.1' in warning.text
    assert 'at most about 4,' in warning.text
