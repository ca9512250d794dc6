# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What `make build` says where it cannot begin."""

from contextlib import suppress
from importlib.metadata import metadata, PackageNotFoundError
import os
from pathlib import Path
import shutil
import subprocess
import tempfile

from packaging.specifiers import SpecifierSet
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


@pytest.mark.parametrize('environment, words', [
    ({'ROS': 'humble'}, 'there are no wheels of ROS=humble; choose jazzy or kilted, or source '),
    ({'ROS_DISTRO': 'humble'}, 'needs ROS 2 Jazzy or newer, and ROS 2 humble is sourced; use a '),
    ({'ROS_DISTRO': 'kilted', 'ROS': 'jazzy'}, 'ROS=jazzy was asked for, and ROS 2 kilted is s'),
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
