# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Make bags whole whose recording was interrupted."""

import sys

from hnn_vi_ros.arguments import recover_bag
from hnn_vi_ros.sinks.mcap_recovery import recover, Recovery


def main(argv: list[str]) -> int:
    """Make each bag whole, and say what is in it."""
    for bag in recover_bag().parse_args(argv).bag:
        print(_told(recover(bag)), file=sys.stdout, flush=True)
    return 0


def _told(recovery: Recovery) -> str:
    done = 'recovered' if recovery.changed else 'whole already'
    if recovery.described and not recovery.changed:
        done = 'whole already, metadata.yaml written'
    lost = (f'; {recovery.damaged} chunks could not be read in full' if recovery.damaged else '')
    return (f'{recovery.path}: {done}: {recovery.messages} messages, '
            f'{recovery.seconds:.2f} s{lost}')
