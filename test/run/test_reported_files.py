# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of the files of a run at its end."""

from pathlib import Path

from hnn_vi_ros.run import bag_lines, picture_lines, report_files
import pytest


def test_files_are_told_with_how_to_open_them_unless_they_were_removed(
        tmp_path: Path, capsys: pytest.CaptureFixture):
    picture = tmp_path / 'recording.rrd'
    report_files([*bag_lines(tmp_path / 'bag'), *picture_lines(picture)])
    out = capsys.readouterr().out
    assert out.count('  was removed') == 2
    assert 'open it' not in out and 'is not complete' not in out
    picture.touch()
    report_files(picture_lines(picture))
    assert f'rerun {picture}' in capsys.readouterr().out
