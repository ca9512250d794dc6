# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Recover bags whose recording was interrupted, or that were damaged."""

from pathlib import Path
import sys

from hnn_vi_ros.errors import printable, RecordingError
from hnn_vi_ros.recording import arguments
from hnn_vi_ros.recording.bags.mcap_recovery import recover, Recovery


def main(argv: list[str]) -> int:
    """Recover each bag, and print its contents."""
    options = arguments.recover_bag().parse_args(argv)
    return max(_recover(bag, options.replace) for bag in options.bag)


def _recover(bag: Path, replace: bool) -> int:
    """Recover a bag; return the exit status."""
    try:
        recovery = recover(bag, replace)
    except RecordingError as problem:
        print(f'hnn recover_bag: {problem}', file=sys.stderr, flush=True)
        return 1
    print(printable(_summary(recovery)), flush=True)
    return int(recovery.lost)


def _summary(recovery: Recovery) -> str:
    done = 'recovered' if recovery.changed else 'already complete'
    if recovery.described and not recovery.changed:
        done = 'already complete, metadata.yaml written'
    parts = [f'{recovery.path}: {done}: {recovery.messages} messages, {recovery.seconds:.2f} s']
    if recovery.incomplete:
        parts.append(f'it ends in a record of which {recovery.incomplete} bytes exist')
    losses = []
    if recovery.damaged:
        losses.append(f'{recovery.damaged} damaged parts, {recovery.unread} unreadable bytes')
    if recovery.fewer:
        losses.append(f'{recovery.fewer} messages that were counted')
    if recovery.altered:
        losses.append('a checksum: the header or metadata differ from the recorded ones')
    if losses:
        parts.append(f'LOST: {", ".join(losses)}')
    if recovery.original:
        parts.append(f'original: {recovery.original.name}')
    return '; '.join(parts)
