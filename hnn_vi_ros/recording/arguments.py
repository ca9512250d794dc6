# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of ``recover_bag``; imports none of the modules that do the work."""

from pathlib import Path

from hnn_vi_ros.files import Parser

_RECOVERED = """\
The readable content replaces FILE; the original is kept as FILE.orig. Exit status: 0 if nothing
was lost (a killed recording ends where it was interrupted), 1 if something was lost, or nothing
could be recovered; then the file is unchanged."""


def recover_bag() -> Parser:
    """Return the parser of ``recover_bag``."""
    parser = Parser(
        'recover_bag', 'Repair truncated or damaged bags.',
        ['hnn recover_bag runs/pendulum-20260101T120000Z/bag'], _RECOVERED)
    parser.add_argument('bag', type=Path, nargs='+', metavar='BAG', help=(
        'folder or .mcap file of a bag that a recorder did not close'))
    parser.add_argument('--replace', action='store_true', help='do not keep the original file')
    return parser
