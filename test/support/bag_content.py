# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag, for tests without torch and mpmath."""

from pathlib import Path

from hnn_vi_ros.recording import BagReader


def content_of(bag: Path) -> list[tuple[str, int, bytes]]:
    """Return topic, time and data of the messages of an intact bag."""
    reader = BagReader(bag)
    found = [(reader.channels[m.channel].topic, m.time, m.data) for m in reader.messages()]
    assert not reader.damage
    return found
