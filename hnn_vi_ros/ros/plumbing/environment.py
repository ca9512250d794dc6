# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The variables that ROS reads before any node: some of its libraries end the process."""

from collections.abc import Iterator
from contextlib import suppress
from importlib import metadata
from importlib.util import find_spec
import os
from pathlib import Path
import sys

from hnn_vi_ros.errors import did_you_mean, ParameterError

# The distributions that are tried, by the first number of their rclpy's version.
DISTRIBUTIONS = {'7': 'jazzy', '9': 'kilted'}
_INDEX = 'share/ament_index'
_RANGES = ('SUBNET', 'LOCALHOST', 'OFF', 'SYSTEM_DEFAULT')
# Beyond it the ports of DDS are none of UDP (DDSI-RTPS 2.5, 9.6.1: 7400 + 250 d + 1 <= 65535).
_LARGEST_DOMAIN = 232


def settle_ros_environment() -> None:
    """
    Set where ROS is, if only this environment tells, and check what ROS reads before any node.

    ROS ignores some values, or takes them for others: a domain of -1, a range that is misspelt.

    Raises
    ------
    ParameterError
        A variable has a value that ROS cannot take, or nothing tells where ROS is.

    """
    if not any(_middlewares()):
        # A workspace may be sourced, and the ROS below it not.
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
        raise ParameterError(f'ROS_DOMAIN_ID={domain!r} is no domain of ROS; set a number from 0 '
                             f'to {_LARGEST_DOMAIN}, or unset it, which is 0')
    reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '')
    if reach and reach not in _RANGES:
        raise ParameterError(
            f'ROS_AUTOMATIC_DISCOVERY_RANGE={reach!r} is none{did_you_mean(reach, _RANGES)}; '
            f'valid: {", ".join(_RANGES)}')
    middleware, installed = os.environ.get('RMW_IMPLEMENTATION', ''), sorted({*_middlewares()})
    if middleware and installed and middleware not in installed:
        raise ParameterError(
            f'RMW_IMPLEMENTATION={middleware!r} is not installed'
            f'{did_you_mean(middleware, installed)}; there: {", ".join(installed)}; set one of '
            'them, or unset it')


def distribution() -> str:
    """Return the name of the ROS 2 that Python imports, or the version of its rclpy."""
    for name in ('ros-rclpy', 'rclpy'):
        with suppress(metadata.PackageNotFoundError):
            version = metadata.version(name)
            return os.environ.get('ROS_DISTRO') or DISTRIBUTIONS.get(
                version.partition('.')[0], f'rclpy {version}')
    return ''


def _prefixes() -> list[str]:
    return [*filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))]


def _middlewares() -> Iterator[str]:
    """Yield the names of the middlewares that the index of ament has; nothing without one."""
    for prefix in _prefixes():
        folder = Path(prefix, _INDEX, 'resource_index', 'rmw_typesupport')
        if folder.is_dir():
            # The package that loads one of them is in the index as well.
            yield from (path.name for path in folder.iterdir()
                        if path.name != 'rmw_implementation')
