# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What `make build` says where it cannot begin."""

import os
from pathlib import Path
import shutil
import subprocess
import tempfile

import pytest

REQUIREMENTS = Path(__file__).parents[1] / 'requirements'


def test_checkout_of_another_user_is_told_as_such():
    # Root can write everywhere: nobody begins in its place.
    other = ['setpriv', '--reuid', '65534', '--clear-groups'] if os.getuid() == 0 else []
    if other and not shutil.which('setpriv'):
        pytest.skip('root can write everywhere, and setpriv, of util-linux, is not installed')
    # That of pytest is root's alone.
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(REQUIREMENTS, Path(folder, 'requirements'))
        os.chmod(folder, 0o555)
        try:
            result = subprocess.run(
                [*other, '/bin/sh', f'{folder}/requirements/make_venv', 'run'], check=False,
                capture_output=True, text=True, env={'PATH': '/usr/bin:/bin'}, cwd='/')
        finally:
            os.chmod(folder, 0o755)
    assert (result.returncode, result.stdout) == (1, '')
    assert result.stderr == (f"error: '{folder}' cannot be written by this user; clone the "
                             'repository into a folder of yours\n')
