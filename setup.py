# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Install the package, its shipped files and its executables."""

import atexit
from itertools import groupby
import os
from pathlib import Path
import shutil
import sys
import tempfile

from setuptools import find_packages, setup

NAME = 'hnn_vi_ros'
SHARE = Path('share') / NAME
RERUN = ['rerun-sdk>=0.41,<0.42']
SWEEP = ['pyarrow>=18']
TAYLOR = ['heyoka>=7.13,<8']
TRAIN = ['plotly>=6,<7', *RERUN, 'torch>=2.3,<3']

# What `ros2 run hnn_vi_ros NAME` finds in lib/hnn_vi_ros, where setup.cfg has it installed.
FOR_ROS = [
    'controller = hnn_vi_ros.cli:controller',
    'evaluate = hnn_vi_ros.cli:evaluate',
    'identify = hnn_vi_ros.cli:identify',
    'import = hnn_vi_ros.cli:import',
    'listener = hnn_vi_ros.cli:listener',
    'recover_bag = hnn_vi_ros.cli:recover_bag',
    'replay = hnn_vi_ros.cli:replay',
    'scene = hnn_vi_ros.cli:scene',
    'simulator = hnn_vi_ros.cli:simulator',
    'sweep = hnn_vi_ros.cli:sweep',
    'train = hnn_vi_ros.cli:train',
]


def shipped(*patterns: str) -> list[tuple[str, list[str]]]:
    """Return data_files entries that keep each file's folder under ``share/hnn_vi_ros``."""
    files = sorted(path for pattern in patterns for path in Path().glob(pattern) if path.is_file())
    return [
        (str(SHARE / folder), [str(path) for path in group])
        for folder, group in groupby(files, key=lambda path: path.parent)
    ]


def script_options() -> dict[str, dict[str, str]]:
    """
    Return the options that make the executables run an activated virtual environment's Python.

    The distribution's colcon runs this file with the system's Python, which cannot import what the
    user installed into the environment; without one, its own Python is the right one.
    """
    interpreter = Path(os.environ.get('VIRTUAL_ENV', '')) / 'bin' / 'python3'
    if not ('VIRTUAL_ENV' in os.environ and interpreter.is_file()):
        return {}
    # `colcon build --symlink-install` runs setuptools' develop, which knows only this variable.
    os.environ['__PYVENV_LAUNCHER__'] = str(interpreter)
    return {'build_scripts': {'executable': str(interpreter)}}


def folder_options() -> dict[str, dict[str, str]]:
    """
    Return the options that keep what pip builds out of the checkout.

    A module that was deleted, and is in ``build`` yet, would be installed by pip again. colcon
    names folders of its own.
    """
    if built_by_colcon():
        return {}
    folder = tempfile.mkdtemp(prefix='hnn_vi_ros-build-')
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return {'build': {'build_base': folder}, 'egg_info': {'egg_base': folder}}


def built_by_colcon() -> bool:
    """Tell whether setup.cfg says where executables go: it does not for the wheels of pip."""
    return not {'install', 'develop'}.isdisjoint(sys.argv)


setup(
    name=NAME,
    version='0.2.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (str(SHARE), ['package.xml']),
        *shipped('launch/*.launch.py', 'config/**/*', 'resource/models/*'),
    ],
    python_requires='>=3.11',
    install_requires=[
        'argcomplete>=3.0',
        'contourpy>=1.2',
        'matplotlib>=3.8',
        'mcap>=1.6,<2',
        'numba>=0.61,<0.70',
        'numpy>=2.0',
        'pydantic>=2.10,<3',
        'PyYAML>=6.0',
        'safetensors>=0.4',
        'scipy>=1.13',
        'setuptools',
    ],
    extras_require={
        # What recordings for the viewer, and the Parquet files of sweeps, take besides.
        'rerun': RERUN,
        'sweep': SWEEP,
        # What training takes besides: its reports hold recordings.
        'train': TRAIN,
        # What tables take besides.
        'tables': ['pandas>=2.2', 'xarray>=2024.1'],
        # What `hnn_vi_ros.envs` takes besides.
        'envs': ['gymnasium>=1.1,<2'],
        # What `integrator: {kind: taylor}` takes besides.
        'taylor': TAYLOR,
        # What `sweep --ray` takes besides.
        'ray': ['ray>=2.40,<3'],
        'test': [*TRAIN, *SWEEP, *TAYLOR, 'fmpy>=0.3.20,<1', 'gymnasium>=1.1,<2',
                 'hypothesis>=6.100', 'pandas>=2.2', 'pin>=3.0', 'pytest>=7.4',
                 'pytest-timeout>=2.1', 'pytest-xdist>=3.5', 'rosbags>=0.10', 'xarray>=2024.1'],
    },
    zip_safe=False,
    author='The hnn_vi_ros Authors',
    author_email='hnn-vi-ros@example.com',
    maintainer='The hnn_vi_ros Authors',
    maintainer_email='hnn-vi-ros@example.com',
    description='Run a learned Hamiltonian as a ROS 2 node, stepped by a variational integrator.',
    license='Apache-2.0',
    options=script_options() | folder_options(),
    entry_points={'console_scripts': [
        # One name where pip puts it, in bin/; those of ROS are too generic to stand there.
        'hnn = hnn_vi_ros.cli:main',
        *(FOR_ROS if built_by_colcon() else ()),
    ]},
)
