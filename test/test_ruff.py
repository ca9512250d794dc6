# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hold every Python file to the rules of ruff.toml."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.linter
def test_python_files_satisfy_ruff():
    pytest.importorskip('ruff', reason='ruff is not installed')
    # Named one by one: the linter would walk into .venv/, build/ and install/.
    found = subprocess.run(
        [sys.executable, '-m', 'ruff', 'check', '--no-cache', '--output-format', 'concise',
         'docs', 'hnn_vi_ros', 'launch', 'setup.py', 'test'], cwd=ROOT, capture_output=True,
        text=True, check=False, timeout=100)
    assert found.returncode == 0, found.stdout + found.stderr
