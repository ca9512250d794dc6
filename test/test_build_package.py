# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What makes `make` build the package anew, and what does not."""

import os
from pathlib import Path
import shutil
import subprocess

import pytest

SCRIPT = Path(__file__).parents[1] / 'requirements' / 'build_package'
FILES = ('hnn_vi_ros/a.py', 'hnn_vi_ros/core/b.py', 'config/c.yaml', 'launch/d.py',
         'resource/hnn_vi_ros', 'package.xml', 'setup.py', 'setup.cfg')


@pytest.fixture
def built(tmp_path: Path) -> Path:
    """Return a checkout that was built a moment ago."""
    for name in (*FILES, '.venv/environment.sh', 'install/.built', 'install/.compiled'):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9, 1e9))
    (tmp_path / 'requirements').mkdir()
    shutil.copy2(SCRIPT, tmp_path / 'requirements')
    os.utime(tmp_path / 'requirements' / 'build_package', (1e9, 1e9))
    record = tmp_path / 'install' / '.built'
    record.write_text('\n'.join(sorted((*FILES, 'requirements/build_package'))) + '\n')
    return tmp_path


def begun(checkout: Path, *words: str) -> str:
    """Return what the script begins, which fails here: there is no colcon, and no executable."""
    run = subprocess.run([checkout / 'requirements' / 'build_package', *words],
                         capture_output=True, text=True, check=False)
    assert (run.returncode == 0) == (run.stdout == '')
    return run.stdout.partition(' ')[0]


def builds(checkout: Path) -> bool:
    """Tell whether the script begins to build."""
    return begun(checkout) == 'Building'


def test_package_is_not_built_again_for_what_python_leaves_in_its_folders(built):
    assert not builds(built)
    (built / 'hnn_vi_ros' / 'core' / '__pycache__').mkdir()
    (built / 'hnn_vi_ros' / 'core' / '__pycache__' / 'b.pyc').touch()
    assert not builds(built)


@pytest.mark.parametrize('change', [
    lambda folder: (folder / 'hnn_vi_ros' / 'core' / 'b.py').touch(),
    lambda folder: (folder / 'hnn_vi_ros' / 'core' / 'b.py').unlink(),
    lambda folder: (folder / 'config' / 'c.yaml').rename(folder / 'config' / 'e.yaml'),
    lambda folder: (folder / '.venv' / 'environment.sh').write_text(''),
    lambda folder: (folder / 'install' / '.built').unlink(),
], ids=['changed', 'removed', 'renamed', 'environment', 'never built'])
def test_package_is_built_again_where_a_source_or_the_environment_is_another(built, change):
    # Times of files are whole ticks of the system's clock.
    os.utime(built / 'install' / '.built', (1.1e9, 1.1e9))
    change(built)
    assert builds(built)


def test_scenes_are_compiled_only_where_that_is_asked_for(built):
    assert begun(built, 'scenes') == ''
    (built / 'install' / '.compiled').unlink()
    assert begun(built) == ''
    assert begun(built, 'scenes') == 'Compiling'
    # It failed, and is not taken for done; the package is, and is not built again.
    assert begun(built, 'scenes') == 'Compiling'
    assert begun(built) == ''


def test_new_build_compiles_its_scenes_again(built):
    # Times of files are whole ticks of the system's clock.
    os.utime(built / 'install' / '.built', (1.1e9, 1.1e9))
    (built / 'setup.py').touch()
    assert begun(built, 'scenes') == 'Building'
    assert not (built / 'install' / '.compiled').exists()


def test_word_that_is_none_of_the_script_is_refused_in_one_line(built):
    run = subprocess.run([built / 'requirements' / 'build_package', 'scene'],
                         capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (2, '')
    assert run.stderr == "error: build_package takes 'scenes' or nothing, not 'scene'\n"
