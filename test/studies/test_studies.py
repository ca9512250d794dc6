# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Studies as a whole: how they are run, and how they fail."""

from importlib import import_module
import sys

from messages import assert_message
import pytest
from studies.__main__ import main, studies


def test_studies_are_listed_with_what_they_do(capsys):
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()[2:]
    assert len(lines) == len(studies()) > 10
    assert all(len(line.split()) > 4 for line in lines)


def test_help_of_a_study_tells_every_option_and_how_it_is_run():
    for name in studies():
        parser = import_module(f'studies.{name}').parser()
        assert f'make study NAME={name}' in parser.format_help()
        assert all(action.help for action in parser._actions), name


def test_unknown_study_is_one_line_with_the_nearest():
    text = main(['paper_figure'])
    assert isinstance(text, str) and 'did you mean paper_figures?' in text and '\n' not in text


@pytest.mark.parametrize('arguments', [
    'paper-figures --out /dev/null/x', 'work_precision --scene nothing',
    'published_tables --quick --out /dev/null/x'])
def test_error_of_the_user_is_one_line(arguments):
    assert_message(main(arguments.split()))


def test_missing_peer_is_one_line_before_anything_is_measured(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'torchdiffeq', None)
    said = main(['work_precision', '--scene', 'pendulum', '--peers', '--out',
                 str(tmp_path / 'out')])
    assert isinstance(said, str) and '\n' not in said
    assert 'the Python package torchdiffeq is missing' in said
    assert not (tmp_path / 'out').exists()
