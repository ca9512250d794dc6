# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files in installed ROS packages: package://PACKAGE/PATH, by the ament index."""

import os
from pathlib import Path
import sys

SCHEME = 'package://'


def package_file(uri: str) -> Path:
    """
    Return the file that a URI of a package names; it need not exist.

    Parameters
    ----------
    uri : str
        ``package://PACKAGE/PATH``, a path in the share folder of the package.

    Raises
    ------
    ValueError
        No such URI or no such package; one line.

    """
    package, _, path = uri.removeprefix(SCHEME).partition('/')
    if not (uri.startswith(SCHEME) and path and package.replace('_', '').isalnum()):
        raise ValueError(f'{uri!r} must be {SCHEME}PACKAGE/PATH')
    for prefix in prefixes():
        if (prefix / 'share/ament_index/resource_index/packages' / package).is_file():
            return prefix / 'share' / package / path
    raise ValueError(f'{uri}: no package {package!r} is in what AMENT_PREFIX_PATH lists; source '
                     'the workspace that holds it, or give the path of the file')


def prefixes() -> list[Path]:
    """Return the folders that ROS packages are installed in, first what overlays others."""
    # Wheels put share/ next to the interpreter's lib/ and need no AMENT_PREFIX_PATH for it.
    listed = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [Path(prefix) for prefix in (*listed, sys.prefix) if prefix]
