# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""One file of a bag, whatever its format: its channels, and its messages in pieces."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel, Message, Schema


class Piece(NamedTuple):
    """
    A stretch of a file that holds messages.

    Parameters
    ----------
    first, last : int
        Times of its earliest and latest message [ns].
    start, length : int
        Where it is in the file: in bytes, or in rows.
    kind : int
        Information for the file's reader.

    """

    first: int
    last: int
    start: int
    length: int
    kind: int = 0


class Source(ABC):
    """
    A file of a bag; nothing but its outline is held in memory.

    Parameters
    ----------
    path : Path
        The file.
    name : Path
        How messages to the user call it.

    Attributes
    ----------
    channels : dict of int to Channel
        Topic, encoding and metadata of each channel.
    schemas : dict of int to Schema
        Name and definition of each type.
    pieces : list of Piece
        In the order of the file.
    unread : dict of int to int
        Lengths of the parts that cannot be read, by their place [bytes]; those inside of pieces
        are known once these are read.
    incomplete : int
        Bytes of a record with which the file breaks off.
    held : int
        How many messages there are, by all that tells it before they are read.
    counted : int or None
        How many the recorder has counted; None where it has not.

    """

    def __init__(self, path: Path, name: Path):
        self.path, self.name = path, name
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.pieces: list[Piece] = []
        self.unread: dict[int, int] = {}
        self.incomplete = self.held = 0
        self.counted: int | None = None

    @abstractmethod
    def read(self, piece: Piece) -> Iterable[Message]:
        """Return the messages of a piece that can be read, all of known channels."""

    def attachment(self, name: str) -> bytes | None:
        """Return a file that is kept with the messages; None if there is none of this name."""
        return None

    def metadata(self, name: str) -> dict[str, str]:
        """Return the newest metadata of a name; empty if there is none."""
        return {}
