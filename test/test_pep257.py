# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hold every docstring to the rules of ROS 2."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.linter
@pytest.mark.pep257
def test_docstrings_satisfy_ament_pep257(capfd):
    ament_pep257 = pytest.importorskip('ament_pep257.main', reason='needs ament_pep257')
    # Named one by one: the linter would walk into .venv/, build/ and install/.
    sources = [str(ROOT / name)
               for name in ('docs/studies', 'hnn_vi_ros', 'launch', 'setup.py', 'test')]
    code = ament_pep257.main(argv=sources)
    captured = capfd.readouterr()
    assert code == 0, '\n'.join(
        line for line in captured.err.splitlines() if not line.startswith('checking'))
