# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ports for tests with servers."""

import os
import random
import socket

# Below Linux's ephemeral range, in which connections of other tests may take a free port.
_PORTS = range(20_000, 32_000)


def free_port() -> int:
    """Return the number of a port without a listener."""
    choice = random.Random(os.urandom(8))
    while True:
        port = choice.choice(_PORTS)
        with socket.socket() as probe:
            try:
                probe.bind(('', port))
            except OSError:
                continue
        return port
