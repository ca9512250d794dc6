# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a test that fails leaves running would take part in the graph of the next one."""

from collections.abc import Iterator
import gc

import processes
import pytest


@pytest.fixture(autouse=True)
def end_of_processes() -> Iterator[None]:
    """Kill the simulators that a test has started and not ended."""
    yield
    for process in processes.started:
        if process.poll() is None:
            process.kill()
            process.wait()
        for file in process.outputs:
            # Shown by pytest if the test has failed.
            print(file.read()[-5000:])
            file.close()
    processes.started.clear()
    if processes.refusals:
        # Nodes that were refused in this process leave the graph.
        gc.collect()
        processes.refusals.clear()
