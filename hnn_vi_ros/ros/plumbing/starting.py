# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Start of ROS in a process: its arguments, one-line errors, and signals."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
import signal
import warnings

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import ENDING, spare_output
from hnn_vi_ros.ros.plumbing.rclpy_internals import log_plainly, UnknownROSArgsError
import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.logging import get_logger_effective_level, LoggingSeverity, set_logger_level
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

_SYNTAX = 'set parameters with --ros-args -p NAME:=VALUE, remappings with --ros-args -r FROM:=TO'


def own_arguments(argv: Sequence[str]) -> list[str]:
    """
    Return the arguments that are not for ROS.

    Raises
    ------
    ParameterError
        ``NAME:=VALUE`` in launch syntax, which ROS would take for a remapping and ignore.

    """
    ours = True
    for word in argv:
        if word in ('--ros-args', '--'):
            ours = word == '--'
        elif ours and ':=' in word:
            raise ParameterError(f'unknown argument {word!r}; {_SYNTAX}')
    with plain_ros_errors():
        return remove_ros_args(argv)


def init_ros(argv: Sequence[str]) -> None:
    """
    Initialise rclpy without its signal handlers, which would shut down the context at once.

    Raises
    ------
    ParameterError
        ROS rejects its arguments; one line.

    """
    spare_output()
    log_plainly()
    with plain_ros_errors():
        rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)


@contextmanager
def plain_ros_errors() -> Iterator[None]:
    """Convert errors of ROS to a ParameterError of one line."""
    # The log of rcl would repeat the same error on further lines.
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        with warnings.catch_warnings(action='ignore', category=RuntimeWarning):
            yield
    except UnknownROSArgsError as problem:
        raise ParameterError(f'ROS: unknown ROS argument {problem}; {_SYNTAX}') from problem
    except (RuntimeError, ValueError, NameValidationException, ParameterException) as problem:
        text = ' '.join(str(problem).split()).partition(', at /')[0].rstrip('.')
        for words in ('failed to initialize rcl: ', 'Failed to parse ROS arguments: '):
            text = text.removeprefix(words)
        if 'rule' in text:
            text += f'; {_SYNTAX}'
        if 'logging' in text:
            text += '; set ROS_LOG_DIR to a writable folder'
        if os.environ.get('ROS_SECURITY_ENABLE', '').lower() == 'true':
            text += ('; security is enabled, which requires a keystore and a middleware built '
                     'with security: see docs/how-to/launch.md, or set '
                     'ROS_SECURITY_ENABLE=false')
        raise ParameterError(f'ROS: {text}') from problem
    finally:
        # Undone here, except where --log-level has set another level.
        if get_logger_effective_level('rcl') == LoggingSeverity.FATAL:
            set_logger_level('rcl', LoggingSeverity.UNSET)


@contextmanager
def ros_process(argv: Sequence[str]) -> Iterator[list[int]]:
    """Initialise ROS for the duration of the block; yield the list of ``record_signals``."""
    init_ros(argv)
    try:
        yield record_signals()
    finally:
        rclpy.try_shutdown()


def record_signals() -> list[int]:
    """
    Record the signals that end a node, without any other effect; return the list of them.

    SIGHUP, which a closed terminal sends, is one of them unless it is ignored (``nohup``).
    """
    received: list[int] = []
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda number, frame: received.append(number))
    return received
