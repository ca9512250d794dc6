# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on the installation: installed parts, and the reasons for parts that do not work."""

from collections.abc import Iterator
from importlib import metadata
from importlib.util import find_spec
import os
from pathlib import Path
import platform
import shutil
import sys
from typing import NamedTuple

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.errors import ParameterError, pip_command
from hnn_vi_ros.files import cache_folder, can_be_written, share_folder, shipped_names
from hnn_vi_ros.ros import distribution, prepare_ros_environment
from hnn_vi_ros.simulation import usable_processors
from hnn_vi_ros.version import __version__

# Import names of required and of optional packages; names on PyPI that differ.
_REQUIRED = ('numpy', 'numba', 'llvmlite', 'scipy', 'pydantic', 'yaml', 'safetensors', 'mcap',
             'contourpy')
_OPTIONAL = {'rerun': 'the viewer', 'matplotlib': 'figures', 'torch': 'training',
             'pandas': 'to_dataframe', 'xarray': 'to_xarray', 'pyarrow': 'sweeps',
             'ray': 'sweep --ray', 'rosbags': 'training on bags in SQLite',
             'argcomplete': 'completion',
             'tqdm': 'the studies, such as `make hard-cases`',
             'jinja2': 'the studies, such as `make hard-cases`'}
_ON_PYPI = {'rerun': 'rerun-sdk', 'yaml': 'PyYAML'}


class Finding(NamedTuple):
    """Finding on one item: its state (``ok``, ``absent`` or ``wrong``), and details."""

    what: str
    state: str
    text: str


def main(argv: list[str]) -> int:
    """Print a line for each finding; return 1 if one is wrong."""
    arguments.doctor().parse_args(argv)
    findings = [*_machine_findings(), *_packages(), _kernels(), *_ros(), _viewer()]
    for finding in findings:
        print(f'{finding.state:6}  {finding.what:12}  {finding.text}')
    return int(any(finding.state == 'wrong' for finding in findings))


def _machine_findings() -> Iterator[Finding]:
    package = Path(__file__).resolve().parents[1]
    yield Finding('hnn_vi_ros', 'ok', f'{__version__} in {package}')
    try:
        yield Finding('scenes', 'ok', f'{len(shipped_names("scene"))} in {share_folder()}')
    except FileNotFoundError as problem:
        yield Finding('scenes', 'wrong', str(problem))
    good = sys.version_info >= (3, 11)
    yield Finding('Python', 'ok' if good else 'wrong', f'{platform.python_version()}, '
                  f'{sys.executable}' + ('' if good else '; install 3.11 or newer'))
    yield Finding('processor', 'ok', f'{platform.machine()}, {os.cpu_count()} cores, of which '
                  f'{usable_processors()} for this process')


def _packages() -> Iterator[Finding]:
    for module in (*_REQUIRED, *_OPTIONAL):
        name, what = _ON_PYPI.get(module, module), _OPTIONAL.get(module)
        if find_spec(module) is not None:
            yield Finding(name, 'ok', _version(name))
        else:
            state, reason = ('absent', f'needed only for {what}') if what else ('wrong', 'absent')
            yield Finding(name, state, f'{reason}; install it with: {pip_command(module)}')


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return 'unknown version'


def _kernels() -> Finding:
    """Locate the cache of compiled code: in the package's own folders, or in that of the user."""
    package = Path(__file__).resolve().parents[1]
    usual = package if os.access(package, os.W_OK) else cache_folder() / 'numba'
    folder = Path(os.environ.get('NUMBA_CACHE_DIR') or usual)
    files = [*folder.rglob('*.nb[ic]')]
    size = sum(file.stat().st_size for file in files) / 1e6
    if not can_be_written(folder):
        return Finding('kernel cache', 'wrong', f'{folder} is not writable: every start compiles '
                       'again; set NUMBA_CACHE_DIR to a writable folder')
    return Finding('kernel cache', 'ok', f'{len(files)} files, {size:.0f} MB in {folder}')


def _ros() -> Iterator[Finding]:
    found = find_spec('rclpy')
    if found is None:
        yield Finding('ROS 2', 'absent', 'needed only for simulator, controller, replay and '
                      'listener: source ROS 2 Jazzy, or run `make build` in the checkout')
        return
    named = os.environ.get('AMENT_PREFIX_PATH', '')
    try:
        prepare_ros_environment()
    except ParameterError as problem:
        yield Finding('ROS 2', 'wrong', str(problem))
        return
    prefix = os.environ.get('AMENT_PREFIX_PATH', '')
    where = f'AMENT_PREFIX_PATH={prefix}' + (
        '' if prefix == named else ', found from the prefix of this Python')
    place = Path(found.origin or '').parent
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    yield Finding('ROS 2', 'ok', f'{distribution() or "unknown"}, rclpy in {place}, {where}, '
                  f'domain {domain}, discovery {reach}')
    if shutil.which('ros2') is None:
        yield Finding('ros2', 'absent', 'the command ros2 is not on the PATH; nodes run without '
                      'it, with hnn simulator')


def _viewer() -> Finding:
    beside = Path(sys.prefix) / 'bin' / 'rerun'
    found = str(beside) if beside.exists() else shutil.which('rerun')
    if found is None:
        return Finding('viewer', 'absent', 'the command rerun is missing; install it with: '
                       f'{pip_command("rerun")}')
    shown = os.environ.get('WAYLAND_DISPLAY') or os.environ.get('DISPLAY')
    text = 'a display' if shown or sys.platform == 'darwin' else \
        'no display: open recordings on another machine, or use rerun_sink:=serve'
    return Finding('viewer', 'ok', f'{found}, {text}')
