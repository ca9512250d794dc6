# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator that goes on from the last state of a bag."""

from pathlib import Path

from hnn_vi_ros.ros.replay.replay_node import main as replay
import numpy as np
from processes import finish, read_bag, start
import pytest

QUIET = {'scene': 'harmonic_oscillator', 'real_time_factor': 0, 'rerun_sink': 'none'}


def run(folder: Path, **parameters: object) -> tuple[int, str, str]:
    """Run a simulator to its end."""
    return finish(start(folder, **QUIET | parameters))


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a bag of one second, one that goes on, and one of both at once."""
    folder = tmp_path_factory.mktemp('resume')
    assert run(folder, duration=1, record_path='first')[0] == 0
    assert run(folder, duration=1, record_path='second', resume='first')[0] == 0
    assert run(folder, duration=2, record_path='whole')[0] == 0
    return folder


def test_resumed_run_goes_on_in_time_and_state(folder):
    first, second, whole = (read_bag(folder / name) for name in ('first', 'second', 'whole'))
    for topic in ('/hnn_simulator/q', '/hnn_simulator/p'):
        joined = first[topic] + second[topic]
        assert [stamp for stamp, _ in joined] == [stamp for stamp, _ in whole[topic]]
        there, here = (np.array([message.data[0] for _, message in part])
                       for part in (joined, whole[topic]))
        assert np.array_equal(there[:100], here[:100])
        # The solver's memory is not in the log: each of 100 steps may end 8 eps elsewhere.
        assert np.abs(there - here).max() <= 100 * 8 * np.finfo(float).eps


def test_bag_of_a_resumed_run_can_be_had_again(folder, capsys):
    assert replay([str(folder / 'second'), '--verify']) == 0, capsys.readouterr().out


@pytest.mark.parametrize('parameters, words', [
    ({'step_size': 0.02}, ('step_size', 'resume')),
    ({'integrator': 'gauss4'}, ('integrator', 'resume')),
    ({'resume': 'nowhere'}, ('nowhere',))])
def test_run_that_cannot_be_resumed_is_refused_in_one_line(folder, parameters, words):
    status, _, error = run(folder, **{'duration': 1, 'resume': 'first', 'record': 'false'}
                           | parameters)
    assert status == 1
    (line,) = error.splitlines()
    assert all(word in line for word in words)
