# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the environment variables of ROS, since some of its libraries abort the process."""

from collections.abc import Iterator
from contextlib import suppress
from importlib import metadata
from importlib.util import find_spec
import os
from pathlib import Path
import sys

from hnn_vi_ros.errors import did_you_mean, ParameterError

# The tested distributions, by the major version of their rclpy.
DISTRIBUTIONS = {'7': 'jazzy', '9': 'kilted'}
_INDEX = 'share/ament_index'
_RANGES = ('SUBNET', 'LOCALHOST', 'OFF', 'SYSTEM_DEFAULT')
# Larger domains give invalid UDP ports (DDSI-RTPS 2.5, 9.6.1: 7400 + 250 d + 1 <= 65535).
_LARGEST_DOMAIN = 232


def prepare_ros_environment() -> None:
    """
    Add ROS from this environment to AMENT_PREFIX_PATH if needed, and check the variables of ROS.

    Logs have clock times, unless RCUTILS_CONSOLE_OUTPUT_FORMAT is set. Fast DDS reads only
    profiles that a variable names, and not DEFAULT_FASTRTPS_PROFILES.xml of the working folder,
    unless SKIP_DEFAULT_XML_FILE is set. ROS ignores or misreads some invalid values: a domain of
    -1, a misspelt discovery range.

    Raises
    ------
    ParameterError
        A variable has an invalid value, or no ROS installation is found.

    """
    os.environ.setdefault('RCUTILS_CONSOLE_OUTPUT_FORMAT',
                          '[{severity}] [{date_time_with_ms}] [{name}]: {message}')
    os.environ.setdefault('SKIP_DEFAULT_XML_FILE', '1')
    if not any(_middlewares()):
        # A workspace may be sourced without the ROS installation that it builds on.
        prefixes = [*_prefixes(), sys.prefix]
        if Path(sys.prefix, _INDEX).is_dir():
            os.environ['AMENT_PREFIX_PATH'] = os.pathsep.join(prefixes)
        elif not any(Path(prefix, _INDEX).is_dir() for prefix in prefixes) and \
                find_spec('rclpy') is not None:
            there = os.environ.get('AMENT_PREFIX_PATH')
            raise ParameterError(
                f'AMENT_PREFIX_PATH{f"={there!r} names no ROS 2" if there else " is not set"}, '
                f'and {sys.prefix} has no {_INDEX}; source the setup file of ROS 2, or install '
                'its wheels into this environment')
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= _LARGEST_DOMAIN):
        raise ParameterError(f'ROS_DOMAIN_ID={domain!r} is not a valid domain; set a number from '
                             f'0 to {_LARGEST_DOMAIN}, or unset it to use 0')
    reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '')
    if reach and reach not in _RANGES:
        raise ParameterError(
            f'ROS_AUTOMATIC_DISCOVERY_RANGE={reach!r} is unknown'
            f'{did_you_mean(reach, _RANGES)}; valid: {", ".join(_RANGES)}')
    middleware, installed = os.environ.get('RMW_IMPLEMENTATION', ''), sorted({*_middlewares()})
    if middleware and installed and middleware not in installed:
        raise ParameterError(
            f'RMW_IMPLEMENTATION={middleware!r} is not installed'
            f'{did_you_mean(middleware, installed)}; installed: {", ".join(installed)}; set one '
            'of them, or unset it')


def distribution() -> str:
    """Return the name of the ROS 2 distribution that Python imports, or its rclpy version."""
    for name in ('ros-rclpy', 'rclpy'):
        with suppress(metadata.PackageNotFoundError):
            version = metadata.version(name)
            return os.environ.get('ROS_DISTRO') or DISTRIBUTIONS.get(
                version.partition('.')[0], f'rclpy {version}')
    return ''


def _prefixes() -> list[str]:
    return [*filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))]


def _middlewares() -> Iterator[str]:
    """Yield the names of the middlewares in the ament index; nothing without an index."""
    for prefix in _prefixes():
        folder = Path(prefix, _INDEX, 'resource_index', 'rmw_typesupport')
        if folder.is_dir():
            # The index also lists rmw_implementation, which loads one of the middlewares.
            yield from (path.name for path in folder.iterdir()
                        if path.name != 'rmw_implementation')
