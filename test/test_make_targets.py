# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Each target of the Makefile, from a fresh clone with an empty environment."""

import os
from pathlib import Path
import subprocess

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Arguments of each target in its smallest form, and a file that it writes; those that need least
# come first.
TARGETS = {
    'study': (['NAME=paper_figures', 'ARGS=--out out'], 'out/paper_figures.csv'),
    'hard-cases': (['ARGS=--quick --case 1 --out cases', 'OUT=out'], 'cases'),
    'docs': (['HNN_DOCS_GALLERY=double_pendulum'], 'docs/_build/html/index.html'),
    'bench': (['ARGS=--rows exact --quick'], None),
    'accuracy': (['ARGS=--methods gauss4 --horizons 10 --steps 0.1 --runs 1 --limit 5',
                  'OUT=out'], 'work_precision'),
}
pytestmark = [pytest.mark.long, pytest.mark.timeout(7200)]


@pytest.fixture(scope='module')
def clone(tmp_path_factory) -> Path:
    """Return a clone of what is committed here, in which nothing is built."""
    folder = tmp_path_factory.mktemp('targets') / 'clone'
    subprocess.run(['git', 'clone', '-q', str(ROOT), str(folder)], check=True)
    (folder / 'out').mkdir()
    return folder


@pytest.mark.parametrize('target', TARGETS)
def test_target_runs_from_a_fresh_clone_in_an_empty_environment(clone, target):
    arguments, written = TARGETS[target]
    # Nothing of the environment that runs this test.
    path = os.pathsep.join(entry for entry in os.environ['PATH'].split(os.pathsep)
                           if not Path(entry).is_relative_to(ROOT))
    told = subprocess.run(
        ['make', target, *arguments], cwd=clone, capture_output=True, text=True, check=False,
        env={'PATH': path, 'HOME': os.environ['HOME']})
    assert told.returncode == 0, told.stdout[-4000:] + told.stderr[-4000:]
    assert written is None or (clone / written).exists()
    if target == 'bench':
        assert 'Kepler' in told.stdout
