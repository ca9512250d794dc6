# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Number of processors that this process may use."""

import os


def usable_processors() -> int:
    """Return how many processors this process may use: those of its affinity, all without one."""
    if hasattr(os, 'sched_getaffinity'):
        # A container's cpuset, taskset or a queue may allow fewer than the machine has.
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
