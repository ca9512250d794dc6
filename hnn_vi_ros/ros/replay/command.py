# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command `replay`: publish a bag, or, without ROS, simulate it again."""

from collections.abc import Sequence
import sys

from hnn_vi_ros.errors import printable
from hnn_vi_ros.ros import arguments
from hnn_vi_ros.ros.settings import REPLAY_PARAMETERS


def main(argv: list[str]) -> int:
    """Play a bag until its end or a signal, verify it, or write its picture."""
    parser = arguments.replay()
    words = _own_arguments(argv)
    options = parser.parse_args(words)
    given = {item.name: item.check(value) for item in REPLAY_PARAMETERS
             if (value := getattr(options, item.name)) is not None}
    instead = [name for name, value in (('--verify', options.verify), ('--rerun', options.rerun))
               if value]
    if len(instead) == 2:
        parser.error('--verify and --rerun exclude each other; call replay twice')
    if options.trust_code and not instead:
        parser.error('--trust-code: only --verify and --rerun run code')
    if options.node and not instead:
        parser.error('--node: valid only with --verify or --rerun; --topics selects what is '
                     'published')
    if instead and (given or len(words) < len(argv)):
        unused = f'--{next(iter(given)).replace("_", "-")}' if given else 'ROS arguments'
        parser.error(f'{instead[0]}: nothing is published, so {unused} would have no effect; '
                     f'remove {unused}')
    # Imported lazily: playback needs no compiler, and verification no ROS.
    if options.rerun:
        from hnn_vi_ros.ros.replay.picture import write_picture
        samples, damage = write_picture(
            options.bag, options.rerun, options.trust_code, options.node)
        print(f'{options.rerun}: {samples} samples')
        if damage:
            print(f'warning: {damage}', file=sys.stderr)
        return 0
    if options.verify:
        from hnn_vi_ros.run import check_replays
        good = True
        for verdict in check_replays(options.bag, options.trust_code, options.node):
            print(printable(verdict.text), flush=True)
            good = good and verdict.good
        return 0 if good else 1
    from hnn_vi_ros.ros.replay.replay_node import play
    return play(options.bag, given, argv)


def _own_arguments(argv: Sequence[str]) -> list[str]:
    """Return the arguments that are not for ROS; see ``starting.own_arguments``."""
    if not any(word == '--ros-args' or ':=' in word for word in argv):
        return list(argv)
    from hnn_vi_ros.ros.plumbing.starting import own_arguments
    return own_arguments(argv)
