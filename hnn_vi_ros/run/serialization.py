# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Serialise messages as CDR whose padding is zero.

Fast CDR leaves the bytes between two fields as it finds them in memory: two equal messages
differ, and what is recorded holds bytes of the process that are nobody's business.
"""

from collections.abc import Sequence
import re
import struct
from typing import Any, final

import numpy as np

# Plain CDR, numbers little-endian; alignment is reckoned from behind it.
_ENCAPSULATION = b'\0\1\0\0'
_CODES = {'boolean': '?', 'octet': 'c', 'int8': 'b', 'uint8': 'B', 'int16': 'h', 'uint16': 'H',
          'int32': 'i', 'uint32': 'I', 'int64': 'q', 'uint64': 'Q', 'float': 'f', 'double': 'd'}
_SEQUENCE = 'sequence<'
_FIXED = re.compile(rf'({"|".join(_CODES)})\[\d+\]')


def serialize(message: Any) -> bytes:
    """
    Return a message as CDR, the bytes of ``serialize_message`` with zeros for padding.

    At its end too, up to a multiple of four bytes: the middleware would add them.

    Raises
    ------
    TypeError
        A field is of a kind that no message of ours has, such as a wide string.

    """
    data = _Writer(message).data
    return bytes(data) + bytes(-len(data) % 4)


@final
class Template:
    """
    The CDR of a message in which only numbers change, at the cost of a copy each time.

    Parameters
    ----------
    message : message
        All messages share its strings and lengths.

    Attributes
    ----------
    numbers : list of np.ndarray
        The places of its double numbers and sequences, in the order of its fields; fill them.

    """

    def __init__(self, message: Any):
        written = _Writer(message)
        self._data = written.data
        self.numbers = [np.frombuffer(self._data, '<f8', count, start)
                        for start, count in written.doubles]

    def set_stamp(self, stamp: int) -> None:
        """Set the stamp [ns] of a message that begins with a header."""
        struct.pack_into('<iI', self._data, len(_ENCAPSULATION), *divmod(stamp, 10**9))

    def serialized(self) -> bytes:
        """Return the message with its numbers of now."""
        return bytes(self._data)


class _Writer:
    """The CDR of a message, and where its double numbers are: first byte and count of each."""

    def __init__(self, message: Any):
        self.data = bytearray(_ENCAPSULATION)
        self.doubles: list[tuple[int, int]] = []
        self._put_message(message)

    def _put_message(self, message: Any) -> None:
        for name, kind in message.get_fields_and_field_types().items():
            self._put(kind, getattr(message, name))

    def _put(self, kind: str, value: Any) -> None:
        if kind.startswith(_SEQUENCE):
            self._put_sequence(kind.removeprefix(_SEQUENCE).removesuffix('>'), value)
        elif kind in _CODES:
            self._put_numbers(kind, [value])
        elif (array := _FIXED.fullmatch(kind)) is not None:
            self._put_numbers(array[1], value)
        elif kind == 'string':
            text = value.encode() + b'\0'
            self._put_numbers('uint32', [len(text)])
            self.data += text
        elif hasattr(value, 'get_fields_and_field_types'):
            self._put_message(value)
        else:
            raise TypeError(f'a field of the type {kind} cannot be serialised')

    def _put_sequence(self, kind: str, values: Sequence[Any]) -> None:
        self._put_numbers('uint32', [len(values)])
        if kind in _CODES:
            self._put_numbers(kind, values)
        else:
            for value in values:
                self._put(kind, value)

    def _put_numbers(self, kind: str, values: Sequence[Any]) -> None:
        # Nothing is aligned for a sequence without entries.
        if len(values):
            code = _CODES[kind]
            self.data += bytes((len(_ENCAPSULATION) - len(self.data)) % struct.calcsize(code))
            if kind == 'double':
                self.doubles.append((len(self.data), len(values)))
            self.data += struct.pack(f'<{len(values)}{code}', *values)
