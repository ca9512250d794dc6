# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator that goes on from the last state of a bag."""

from pathlib import Path

from hnn_vi_ros.ros.replay.replay_node import main as replay
from messages import assert_message
import numpy as np
from processes import finish, read_bag, refusal, simulator_words, start
import pytest

QUIET = {'scene': 'harmonic_oscillator', 'real_time_factor': 0}


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a bag of one second, one that goes on, and one of both at once."""
    folder = tmp_path_factory.mktemp('resume')
    for parameters in ({'duration': 1, 'record_path': 'first'},
                       {'duration': 1, 'record_path': 'second', 'resume': 'first'},
                       {'duration': 2, 'record_path': 'whole'}):
        assert finish(start(folder, **QUIET | parameters))[0] == 0
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


def test_run_that_cannot_be_resumed_is_refused_in_one_line(folder, monkeypatch):
    monkeypatch.chdir(folder)
    for wrong in ({'step_size': 0.02}, {'integrator': 'gauss4'}, {'resume': 'nowhere'}):
        assert_message(refusal('simulator', *simulator_words(
            **QUIET | {'duration': 1, 'resume': 'first'} | wrong)))
