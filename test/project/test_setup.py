# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run setup.py without installing: what it ships, and whose Python its executables run."""

import os
from pathlib import Path
import runpy
import tomllib

from hnn_vi_ros.commands import EXECUTABLES
from hnn_vi_ros.errors import pip_command
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
import pytest
from sources import brought, requirements_of, ROOT


@pytest.fixture
def run_setup(monkeypatch):
    """Return a function that runs setup.py and returns what it hands to setuptools."""
    captured = {}
    monkeypatch.setattr('setuptools.setup', captured.update)
    monkeypatch.chdir(ROOT)
    # setup.py sets it; set and deleted here, so that the test leaves it as it was.
    monkeypatch.setenv('__PYVENV_LAUNCHER__', '')
    monkeypatch.delenv('__PYVENV_LAUNCHER__')

    def run():
        runpy.run_path(str(ROOT / 'setup.py'))
        return captured
    return run


def test_setup_ships_every_config_model_and_launch_file_in_its_own_folder(run_setup):
    installed = {
        Path(folder) / Path(source).name: source
        for folder, sources in run_setup()['data_files'] for source in sources}
    share = Path('share/hnn_vi_ros')
    for pattern in ('config/*/*.yaml', 'resource/models/*.safetensors', 'launch/*.launch.py'):
        for path in ROOT.glob(pattern):
            name = path.relative_to(ROOT)
            assert installed[share / name] == str(name)
    assert installed[share / 'package.xml'] == 'package.xml'
    assert Path('share/ament_index/resource_index/packages/hnn_vi_ros') in installed


def test_setup_packages_leave_the_tests_out(run_setup):
    packages = run_setup()['packages']
    assert 'hnn_vi_ros.ros' in packages
    assert all(package.partition('.')[0] == 'hnn_vi_ros' for package in packages)


@pytest.mark.parametrize('words, by_colcon', [
    (['egg_info', '--egg-base', 'b', 'build', '--build-base', 'b', 'install'], True),
    (['develop', '--editable', '--no-deps'], True), (['egg_info'], False),
    (['bdist_wheel'], False), (['dist_info'], False), (['editable_wheel'], False)])
def test_pip_has_one_executable_and_leaves_nothing_in_the_checkout(
        run_setup, monkeypatch, words, by_colcon):
    monkeypatch.setattr('sys.argv', ['setup.py', *words])
    captured = run_setup()
    names = {row.partition(' = ')[0] for row in captured['entry_points']['console_scripts']}
    # What ROS finds by the package has generic names.
    assert names == {'hnn', *(EXECUTABLES if by_colcon else ())}
    # A module that was deleted would be installed from what an earlier build has left.
    folders = {folder for options in captured['options'].values()
               for name, folder in options.items() if name in ('build_base', 'egg_base')}
    assert bool(folders) != by_colcon
    assert not any(Path(folder).resolve().is_relative_to(ROOT) for folder in folders)


def test_every_pip_builds_a_wheel():
    # Without a backend an older pip runs `setup.py install`, and `hnn` is on nobody's PATH.
    system = tomllib.loads((ROOT / 'pyproject.toml').read_text())['build-system']
    assert system == {'requires': ['setuptools'], 'build-backend': 'setuptools.build_meta'}


def test_executables_run_the_python_of_an_activated_environment(run_setup, monkeypatch, tmp_path):
    interpreter = tmp_path / 'bin' / 'python3'
    interpreter.parent.mkdir()
    interpreter.touch()
    # Without one, the Python that builds.
    monkeypatch.delenv('VIRTUAL_ENV', raising=False)
    assert 'build_scripts' not in run_setup()['options']
    assert '__PYVENV_LAUNCHER__' not in os.environ
    monkeypatch.setenv('VIRTUAL_ENV', str(tmp_path))
    assert run_setup()['options']['build_scripts'] == {'executable': str(interpreter)}
    assert os.environ['__PYVENV_LAUNCHER__'] == str(interpreter)


def test_setup_names_the_packages_of_the_requirements(run_setup):
    captured = run_setup()
    extras = captured['extras_require']
    for named, name, besides, of_studies in (
            (captured['install_requires'], 'runtime', {'setuptools'}, set()),
            (extras['rerun'], 'rerun', set(), set()), (extras['sweep'], 'sweep', set(), set()),
            (extras['train'], 'train', {'rerun-sdk'}, {'tqdm'}),
            (extras['ray'], 'ray', set(), None)):
        ranges = {canonicalize_name(item.name): item.specifier
                  for item in map(Requirement, named)}
        pins = {canonicalize_name(pin.name): str(pin.specifier)
                for pin in requirements_of(name)}
        # None: the requirements pin as well what the package brings.
        assert of_studies is None or ranges.keys() - besides == pins.keys() - of_studies
        assert all(pins[package].removeprefix('==') in ranges[package]
                   for package in ranges.keys() - besides), name
    assert len(extras['ray']) == 1
    # As the message of a missing viewer names it.
    extra, = extras['rerun']
    assert pip_command('rerun').endswith(f'-m pip install "{extra}"')


@pytest.mark.parametrize('python', ['3.11', '3.12', '3.13', '3.14'])
def test_constraints_pin_every_package_that_an_install_brings(python):
    pins = {canonicalize_name(pin.name): str(pin.specifier) for pin in requirements_of(
        'constraints', 'bench', 'ray', 'jazzy', 'jazzy_test')}
    names = brought(requirements_of('build', 'runtime', 'rerun', 'sweep', 'jazzy', 'train',
                                    'test', 'jazzy_test', 'ray'), python)
    assert not [name for name in names if not pins.get(name, '').startswith('==')]


def test_constraints_pin_what_the_default_torch_brings():
    names = {canonicalize_name(pin.name) for pin in requirements_of('constraints')}
    # Of its wheel for Linux; the CUDA packages that these bring are among them.
    assert {'triton', 'cuda-toolkit', 'cuda-bindings', 'cuda-pathfinder', 'nvidia-cublas',
            'nvidia-cudnn-cu13', 'nvidia-cusparselt-cu13', 'nvidia-nccl-cu13',
            'nvidia-nvshmem-cu13', 'nvidia-nvjitlink'} <= names
