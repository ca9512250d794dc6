# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Make bags whole whose recording was interrupted, or that were damaged."""

from pathlib import Path
import sys

from hnn_vi_ros.bags import arguments
from hnn_vi_ros.bags.bag_files import bag_files
from hnn_vi_ros.bags.mcap_recovery import describe, recover, Recovery
from hnn_vi_ros.command_line import called
from hnn_vi_ros.errors import printable, RecordingError


def main(argv: list[str]) -> int:
    """Make each bag whole, and print its contents."""
    options = arguments.recover_bag().parse_args(argv)
    return max(_recover(bag, options.replace) for bag in options.bag)


def _recover(bag: Path, replace: bool) -> int:
    """Make the files of a bag whole; return the exit status."""
    status, changed = 0, False
    try:
        files = bag_files(bag)
        for path in [bag] if len(files) == 1 else files:
            recovery = recover(path, replace)
            print(printable(_summary(recovery)), flush=True)
            status, changed = max(status, int(recovery.lost)), changed or recovery.changed
        if len(files) > 1 and (changed or not (bag / 'metadata.yaml').exists()):
            messages = describe(bag, files)
            print(f'{bag}: metadata.yaml written: {messages} messages in {len(files)} files',
                  flush=True)
    except OSError as problem:
        return _fail(f'{bag}: its metadata.yaml cannot be written ({problem.strerror}); the '
                     'files are whole')
    except RecordingError as problem:
        return _fail(str(problem))
    return status


def _fail(problem: str) -> int:
    print(f'{called("recover_bag")}: {problem}', file=sys.stderr, flush=True)
    return 2


def _summary(recovery: Recovery) -> str:
    done = 'recovered' if recovery.changed else 'whole already'
    if recovery.described and not recovery.changed:
        done = 'whole already, metadata.yaml written'
    parts = [f'{recovery.path}: {done}: {recovery.messages} messages, {recovery.seconds:.2f} s']
    if recovery.contradicted:
        parts.append(f'{recovery.contradicted} indexes contradicted their messages')
    if recovery.incomplete:
        parts.append(f'it breaks off in a record of which {recovery.incomplete} bytes are there')
    if recovery.lost:
        parts.append(f'LOST: {", ".join(_losses(recovery))}')
    if recovery.original:
        parts.append(f'as it was: {recovery.original.name}')
    return '; '.join(parts)


def _losses(recovery: Recovery) -> list[str]:
    """Return what is not kept, each in some words."""
    losses = []
    if recovery.damaged:
        losses.append(f'{recovery.damaged} damaged parts, {recovery.unread} bytes not understood')
    if recovery.another is not None:
        losses.append(f'a second file behind the first, from byte {recovery.another} on: cut it '
                      f'out by `tail -c +{recovery.another + 1}`')
    if recovery.fewer:
        losses.append(f'{recovery.fewer} messages that had been counted')
    if recovery.more:
        losses.append(f'the count: {recovery.more} messages more than were counted')
    if recovery.files:
        losses.append(f'{recovery.files} attachments or metadata that had been counted')
    if recovery.gaps:
        first = recovery.gaps[0]
        losses.append(f'{sum(gap.count for gap in recovery.gaps)} stamps in {len(recovery.gaps)} '
                      f'gaps, the first after t = {first.after * 1e-9:.9g} s')
    if recovery.altered:
        losses.append('a checksum: the header or metadata are not as they were recorded')
    return losses
