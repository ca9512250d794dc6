# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Image of the memory that compiled code reads and writes, which can be placed anywhere."""

from bisect import bisect
import ctypes
import re
from typing import Any, NamedTuple

from hnn_vi_ros.integrators import MemoryByAddress
from hnn_vi_ros.kernels import Block, flat, provide_all, symbol_at, Target
import numpy as np

# Regions begin at cache lines [bytes].
_LINE = 64


class Image(NamedTuple):
    """
    Contents of blocks of addresses, then of all other arrays.

    Parameters
    ----------
    words : np.ndarray of int64
        The contents; an address is the number of bytes from their start.
    changing : int
        Number of words before those that change.
    pointers : np.ndarray of int64
        Indices of words that are addresses of memory.
    entries : dict of int to str
        Symbol of the function whose address is in a word, by index.
    start : int
        Index of the first word of the value.
    order : np.ndarray of int64
        Index of the word of each number, in the order of ``numbers_at``.

    """

    words: np.ndarray
    changing: int
    pointers: np.ndarray
    entries: dict[int, str]
    start: int
    order: np.ndarray

    def packed(self) -> bytes:
        """Return the words with each run of zero bytes as a zero and the number of the others."""
        return re.sub(rb'\0{1,256}', lambda run: bytes((0, len(run[0]) - 1)),
                      self.words.tobytes())


class _Walk:
    """Memory that a value reaches: its spans, and the addresses in it."""

    def __init__(self) -> None:
        self.spans: dict[bool, list[tuple[int, int]]] = {True: [], False: []}
        self.pointers: dict[int, int] = {}
        self.entries: dict[int, str] = {}
        # Addresses and contents of numbers, in an order that does not depend on addresses.
        self.numbers: list[tuple[np.ndarray, np.ndarray]] = []
        self._seen: set[int] = set()

    def array(self, array: np.ndarray) -> None:
        """Add the memory of an array, and what a block reaches."""
        owner: Any = array
        while isinstance(owner, np.ndarray):
            owner = owner.base
        memory = owner.obj if isinstance(owner, memoryview) else owner
        if isinstance(memory, Block):
            self.block(memory)
        elif array.size:
            self.spans[False].append(np.lib.array_utils.byte_bounds(array))
            if array.itemsize == 8:
                offsets = np.tensordot(array.strides, np.indices(array.shape), 1)
                self.numbers.append((array.ctypes.data + offsets.ravel(),
                                     array.ravel().view(np.int64)))

    def block(self, memory: Block) -> int:
        """Add a block, and return the address of its value."""
        words = memory.words
        begin = words.ctypes.data
        place = begin + 8 * (words.size - len(flat(memory.held)))
        if begin not in self._seen:
            self._seen.add(begin)
            self.spans[True].append((begin, begin + words.nbytes))
            for k, word in enumerate(words[:(place - begin) // 8].tolist()):
                symbol = symbol_at(word)
                if symbol is not None:
                    self.entries[begin + 8 * k] = symbol
            self.value(memory.held, place)
        return place

    def value(self, value: Any, place: int) -> int:
        """Add what a value reaches, given its address; return the address after it."""
        if isinstance(value, MemoryByAddress):
            begin, counts = value.counts.ctypes.data, value.counts.tolist()
            self.spans[True].append((begin, begin + value.counts.nbytes))
            self.pointers |= {begin + 8 * k: count for k, count in enumerate(counts)}
            self.pointers[place + 8 * (len(flat(value.words)) + 4)] = begin
            self.value((value.words,), place)
        elif isinstance(value, tuple):
            if isinstance(value, Target):
                provide_all(value)
            for part in value:
                place = self.value(part, place)
            return place
        elif isinstance(value, np.ndarray):
            # The fifth word of an array is its address; see flat.
            self.pointers[place + 32] = value.ctypes.data
            self.array(value)
        elif isinstance(value, float):
            self.numbers.append((np.array([place]), np.array(flat(value))))
        return place + 8 * len(flat(value))


def numbers_at(memory: Block) -> np.ndarray:
    """Return all numbers that a block reaches, as int64, in the same order for other arrays."""
    walk = _Walk()
    walk.block(memory)
    return np.concatenate([contents for _, contents in walk.numbers])


def image_of(memory: Block) -> Image:
    """Return the image of a block and all that it reaches, with their present contents."""
    walk = _Walk()
    start = walk.block(memory)
    parts, end, changing = list[bytes](), 0, 0
    # First and last address of each span, and its place in the image.
    places = list[tuple[int, int, int]]()
    for blocks in (True, False):
        changing = end
        for low, high in _merged(walk.spans[blocks]):
            gap, size = -end % _LINE, high - low
            places.append((low, high, end + gap))
            parts += bytes(gap), ctypes.string_at(low, size), bytes(-(end + gap + size) % 8)
            end = sum(map(len, parts[-3:]), end)
    places.sort()

    def moved(address: int) -> int:
        low, high, place = places[bisect(places, (address + 1,)) - 1]
        # Empty arrays point to nowhere.
        return place + address - low if low <= address <= high else 0
    words = np.frombuffer(b''.join(parts), dtype=np.int64).copy()
    pointers = {moved(place) // 8: moved(target) for place, target in walk.pointers.items()}
    words[list(pointers)] = list(pointers.values())
    entries = {moved(place) // 8: symbol for place, symbol in walk.entries.items()}
    words[list(entries)] = 0
    addresses = np.concatenate([addresses for addresses, _ in walk.numbers])
    lows, _, begins = np.array(places).T
    own = np.searchsorted(lows, addresses, 'right') - 1
    return Image(words, changing // 8, np.array(sorted(pointers)), entries, moved(start) // 8,
                 (addresses - lows[own] + begins[own]) // 8)


def _merged(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return spans, with those that overlap as one, in an order that no address changes."""
    found: list[tuple[int, int, int]] = []
    for (low, high), k in sorted(zip(spans, range(len(spans)), strict=True)):
        if found and low <= found[-1][2]:
            first, begin, end = found[-1]
            found[-1] = min(first, k), begin, max(high, end)
        else:
            found.append((k, low, high))
    return [(low, high) for _, low, high in sorted(found)]
