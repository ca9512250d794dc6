# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of ``recover_bag``; imports none of the modules that do the work."""

from pathlib import Path

from hnn_vi_ros.files import Parser

_RECOVERED = """\
What can be read is written anew; the file as it was is kept as FILE.orig. Exit status: 0 if
nothing was lost (a recording that was killed ends where it broke off), 1 if something was, 2 if
nothing could be recovered; then all is left as it was."""


def recover_bag() -> Parser:
    """Return the parser of ``recover_bag``."""
    parser = Parser(
        'recover_bag', 'Repair bags that were cut off or damaged.',
        ['ros2 run hnn_vi_ros recover_bag runs/pendulum-20260101T120000Z/bag'], _RECOVERED)
    parser.add_argument('bag', type=Path, nargs='+', metavar='BAG', help=(
        'folder of a bag, or its .mcap file, that a recorder did not close'))
    parser.add_argument('--replace', action='store_true', help='do not keep the file as it was')
    return parser
