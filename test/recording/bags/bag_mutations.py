# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Mutations of recorded MCAP files, record by record and byte by byte."""

from collections.abc import Iterator
import random
import struct
from typing import NamedTuple

from mcap.writer import MCAP0_MAGIC as MAGIC

_PREFIX = struct.Struct('<BQ')
KINDS = ('flip', 'zeros', 'truncation', 'insertion', 'deletion', 'opcode', 'swap', 'repeat',
         'removal', 'join', 'double')


class Mutant(NamedTuple):
    """A changed file: what was done to it, and how much of the original it begins with."""

    kind: str
    content: bytes
    description: str


def records_of(content: bytes) -> list[bytes]:
    """Return the records of an undamaged file, magic aside, as they stand in it."""
    found, place = [], len(MAGIC)
    while place + _PREFIX.size <= len(content):
        _, length = _PREFIX.unpack_from(content, place)
        found.append(content[place:place + _PREFIX.size + length])
        place += len(found[-1])
    return found


def opcode_flips(content: bytes) -> Iterator[Mutant]:
    """Yield the file with each bit of the opcode of each record flipped, and as a message."""
    place = len(MAGIC)
    for record in records_of(content):
        for opcode in {record[0] ^ 1 << bit for bit in range(8)} | {0x05} - {record[0]}:
            yield Mutant('opcode', content[:place] + bytes([opcode]) + content[place + 1:],
                         f'opcode {record[0]:#x} at {place} becomes {opcode:#x}')
        place += len(record)


def joined(first: bytes, second: bytes) -> Iterator[Mutant]:
    """Yield one file behind another, as it is and without its end; and behind a broken one."""
    whole = MAGIC + b''.join(records_of(second))
    for end, before in (('whole', first), ('cut off', first[:len(first) * 2 // 3])):
        for begin, behind in (('whole', second), ('without end', whole),
                              ('half', second[:len(second) // 2])):
            yield Mutant('join', before + behind, f'{end} file, then one {begin}')


def mutant(content: bytes, other: bytes, kind: str, rng: random.Random) -> Mutant:
    """Return a file that is changed at random in one way; `other` is that of another scene."""
    place, records = rng.randrange(len(content)), records_of(content)
    first, second = sorted(rng.sample(range(len(records)), 2))
    what = f'{kind} at byte {place}'
    if kind == 'flip':
        changed = bytearray(content)
        changed[place] ^= 1 << rng.randrange(8)
        return Mutant(kind, bytes(changed), what)
    if kind in ('zeros', 'deletion', 'insertion'):
        size = min(rng.choice((1, 9, 300, 512, 4096)), len(content) - place)
        behind = content[place:] if kind == 'insertion' else content[place + size:]
        filled = {'zeros': bytes(size), 'deletion': b'', 'insertion': rng.randbytes(size)}[kind]
        return Mutant(kind, content[:place] + filled + behind, f'{what}, {size} bytes')
    if kind == 'truncation':
        return Mutant(kind, content[:place], what)
    if kind == 'opcode':
        return rng.choice(list(opcode_flips(content)))
    if kind in ('join', 'double'):
        found = list(joined(content, content if kind == 'double' else other))
        return rng.choice(found)._replace(kind=kind)
    what = ' and '.join(f'{kind} of record {number} ({records[number][0]:#x})'
                        for number in (first, second))
    if kind == 'swap':
        records[first], records[second] = records[second], records[first]
    elif kind == 'repeat':
        records.insert(second, records[first])
    else:
        del records[first]
    end = MAGIC if content.endswith(MAGIC) else b''
    return Mutant(kind, MAGIC + b''.join(records) + end, what)


def mutants(content: bytes, other: bytes, count: int, joint: int = 1, flip: int = 1
            ) -> list[Mutant]:
    """Return so many mutations at random of each kind, and each so-manieth joint and opcode."""
    rng = random.Random(13)
    drawn = [mutant(content, other, kind, rng) for kind in KINDS for _ in range(count)]
    doubles = [found._replace(kind='double') for found in joined(content, content)]
    return (drawn + list(opcode_flips(content))[::flip] + list(joined(content, other))[::joint]
            + doubles[::joint])
