# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Packages that only some features need, and that may be missing."""

from collections.abc import Iterator
from contextlib import contextmanager
import sys

from hnn_vi_ros.errors import MissingPackage

# What pip takes where that is not the name by which a package is imported. Each version of rerun
# changes its API: the range is that of setup.py.
_REQUIREMENTS = {'rerun': 'rerun-sdk>=0.41,<0.42', 'yaml': 'pyyaml'}


def pip_command(*packages: str) -> str:
    """
    Return the command that installs packages where this Python finds them.

    Parameters
    ----------
    packages : str
        The names by which they are imported; of others, what pip takes.

    """
    return f'{sys.executable} -m pip install ' + ' '.join(
        f'"{_REQUIREMENTS.get(package, package)}"' for package in packages)


@contextmanager
def optional(package: str, what: str) -> Iterator[None]:
    """
    Say in one line which package is missing, where an import inside fails for that.

    Parameters
    ----------
    package : str
        The name by which it is imported.
    what : str
        What takes it.

    Raises
    ------
    MissingPackage
        It is not installed.

    """
    try:
        yield
    except ModuleNotFoundError as problem:
        # One that the package itself lacks is another matter.
        if problem.name is None or problem.name.partition('.')[0] != package:
            raise
        raise MissingPackage(f'{what} takes the Python package {package}; install it with: '
                             f'{pip_command(package)}') from problem
