# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Handle at the end of a process what has come, or waits, by then."""

from contextlib import suppress

from rclpy.executors import SingleThreadedExecutor, TimeoutException


def take_once(executor: SingleThreadedExecutor) -> bool:
    """
    Handle a message of each topic that has one, and go on with each handler that waited.

    Parameters
    ----------
    executor : SingleThreadedExecutor
        That nobody spins.

    Returns
    -------
    bool
        Whether there was anything to do.

    """
    taken = False
    with suppress(TimeoutException):
        while True:
            handler, _, _ = executor.wait_for_ready_callbacks(timeout_sec=0.0)
            handler()
            # Raises what its callback has raised.
            handler.result()
            taken = True
    return taken
