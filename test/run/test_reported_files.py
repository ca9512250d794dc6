# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of the files of a run at its end."""

from pathlib import Path

from hnn_vi_ros.run.run_folder import bag_lines, picture_lines, report_files
import pytest


def test_files_that_were_removed_are_told_and_not_how_to_open_them(
        tmp_path: Path, capsys: pytest.CaptureFixture):
    report_files([*bag_lines(tmp_path / 'bag'), *picture_lines(tmp_path / 'recording.rrd')])
    out = capsys.readouterr().out
    assert out.count('  was removed') == 2
    assert 'open it' not in out and 'is not complete' not in out


def test_picture_that_is_there_is_told_with_how_to_open_it(
        tmp_path: Path, capsys: pytest.CaptureFixture):
    picture = tmp_path / 'recording.rrd'
    picture.touch()
    report_files(picture_lines(picture))
    assert f'rerun {picture}' in capsys.readouterr().out
