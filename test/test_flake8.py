# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hold every Python file to the style rules of ROS 2."""

import pytest


@pytest.mark.flake8
@pytest.mark.linter
def test_python_files_satisfy_ament_flake8(changed_sources, monkeypatch, tmp_path):
    ament_flake8 = pytest.importorskip('ament_flake8.main', reason='needs ament_flake8')
    # It compares each file with every folder below the current one whose name begins with . or _,
    # of which .venv/ has thousands: from a folder without any.
    monkeypatch.chdir(tmp_path)
    with changed_sources('flake8') as sources:
        code, errors = ament_flake8.main_with_errors(argv=sources)
        assert code == 0, '\n'.join(errors)
