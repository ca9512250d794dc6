# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What `make` says where it cannot begin, what it builds anew, and what its targets do."""

from contextlib import suppress
from importlib.metadata import metadata, PackageNotFoundError
import os
from pathlib import Path
import shutil
import subprocess
import tempfile

from packaging.specifiers import SpecifierSet
import pytest
from sources import ROOT

REQUIREMENTS = ROOT / 'requirements'


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
    assert result.stderr == (f"error: '{folder}' is not writable for this user; clone the "
                             'repository into a writable folder\n')


@pytest.mark.parametrize('environment, words', [
    ({'ROS': 'humble'}, 'there are no wheels of ROS=humble; choose jazzy or kilted, or source '),
    ({'ROS_DISTRO': 'humble'}, 'needs ROS 2 Jazzy or newer, but ROS 2 humble is sourced; use a '),
    ({'ROS_DISTRO': 'kilted', 'ROS': 'jazzy'}, 'ROS=jazzy was requested, but ROS 2 kilted is so'),
    ({'ROS_DISTRO': 'lyrical', 'PYTHON': '/usr/bin/python3'}, 'ROS 2 lyrical is sourced but '),
])
def test_ros_that_cannot_be_had_is_one_line(tmp_path, environment, words):
    shutil.copytree(REQUIREMENTS, tmp_path / 'requirements')
    result = subprocess.run(
        ['/bin/sh', tmp_path / 'requirements' / 'make_venv', 'run'], check=False,
        capture_output=True, text=True, env={'PATH': '/usr/bin:/bin'} | environment)
    assert (result.returncode, result.stdout) == (1, '')
    assert words in result.stderr and result.stderr.count('\n') == 1


@pytest.mark.parametrize('distribution', ['jazzy', 'kilted'])
def test_every_wheel_of_a_distribution_is_pinned_once(distribution):
    lines = [line for name in (distribution, f'{distribution}_test')
             for line in (REQUIREMENTS / f'{name}.txt').read_text().splitlines()
             if line[0] not in '#-']
    names, versions = zip(*(line.split('==') for line in lines), strict=True)
    assert all(versions) and len({*names}) == len(names)
    heads = {f'ros-{distribution}-rclpy[fastrtps]', f'ros-{distribution}-common-interfaces'}
    assert heads == {name for name in names if name.startswith(f'ros-{distribution}-')}
    others = (REQUIREMENTS / 'constraints.txt').read_text().splitlines()
    assert not any(line.startswith('ros-') for line in others)


def test_every_pin_takes_the_oldest_python_that_the_readme_names():
    """Debian 12 has Python 3.11.2."""
    refused = []
    for line in (REQUIREMENTS / 'constraints.txt').read_text(encoding='utf-8').splitlines():
        name = line.partition('==')[0].strip()
        with suppress(PackageNotFoundError):
            needed = metadata(name)['Requires-Python'] if name and name[0] != '#' else None
            if needed and not SpecifierSet(needed).contains('3.11.2'):
                refused.append(f'{line}: {needed}')
    assert not refused


# What makes `make` build the package anew, and what does not.

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
    shutil.copy2(REQUIREMENTS / 'build_package', tmp_path / 'requirements')
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
    assert run.stderr == "error: build_package accepts 'scenes' or no argument, not 'scene'\n"


# Each target of the Makefile, from a fresh clone with an empty environment.

# Arguments of each target in its smallest form, and a file that it writes; those that need least
# come first.
TARGETS = {
    'study': (['NAME=paper_figures', 'ARGS=--out out'], 'out/paper_figures.csv'),
    'hard-cases': (['ARGS=--quick --case 1 --out cases', 'OUT=out'], 'cases'),
    'docs': (['HNN_DOCS_GALLERY=double_pendulum'], 'docs/_build/html/index.html'),
    'bench': (['ARGS=--rows exact --quick'], None),
    'accuracy': (['ARGS=--scenes kepler --horizons 10 --seconds 5', 'OUT=out'],
                 'out/accuracy/kepler.csv'),
}


@pytest.fixture(scope='module')
def clone(tmp_path_factory) -> Path:
    """Return a clone of what is committed here, in which nothing is built."""
    folder = tmp_path_factory.mktemp('targets') / 'clone'
    subprocess.run(['git', 'clone', '-q', str(ROOT), str(folder)], check=True)
    (folder / 'out').mkdir()
    return folder


@pytest.mark.long
@pytest.mark.timeout(7200)
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
