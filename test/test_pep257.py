# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hold every docstring to the rules of ROS 2."""

import pytest


@pytest.mark.linter
@pytest.mark.pep257
def test_docstrings_satisfy_ament_pep257(changed_sources, capfd):
    ament_pep257 = pytest.importorskip('ament_pep257.main', reason='needs ament_pep257')
    with changed_sources('pep257') as sources:
        code = ament_pep257.main(argv=sources)
        assert code == 0, '\n'.join(line for line in capfd.readouterr().err.splitlines()
                                    if not line.startswith('checking'))
