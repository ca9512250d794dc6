# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Packages that only some features need, and that may be missing."""

from collections.abc import Iterator
from contextlib import contextmanager
import sys

from hnn_vi_ros.errors import MissingPackage


@contextmanager
def optional(package: str, what: str) -> Iterator[None]:
    """
    Say in one line which package is missing, where an import inside fails for that.

    Parameters
    ----------
    package : str
        Its name, by which it is imported and installed.
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
                             f'{sys.executable} -m pip install "{package}"') from problem
