# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""List scenes, integrators, effects, models or tasks with a line each."""

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.scene import LISTS


def main(argv: list[str]) -> int:
    """Print a line for each name."""
    found = LISTS[arguments.names().parse_args(argv).what]()
    width = max(map(len, found))
    for name, description in found.items():
        print(f'{name:{width}}  {description}')
    return 0
