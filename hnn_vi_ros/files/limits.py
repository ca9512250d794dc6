# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read untrusted files within limits that are checked before the work.

Sizes declared by a file are compared with its content before memory is allocated. YAML and XML
have their own limits, in ``yaml_text`` and ``xml_text``; bags in the package ``bags``.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import errno
from hashlib import file_digest
from io import TextIOWrapper
import json
import math
from pathlib import Path
import resource
from typing import Any, BinaryIO

from hnn_vi_ros.files.regular_file import in_bytes, limited
import numpy as np

# Maximum length of a line of text [characters].
LONGEST_LINE = 1 << 20
# Maximum number of values in JSON: a covariance of a thousand parameters has a million.
MOST_VALUES = 1_200_000
# Maximum header of safetensors [bytes]: the card of an ensemble of 1000 members takes 3 MiB.
LONGEST_HEADER = 4 << 20


def sha256_of(path: Path, most: int) -> str:
    """Return the SHA-256 of a regular file; see ``limited``."""
    with limited(path, most) as stream:
        return file_digest(stream, 'sha256').hexdigest()


def text_lines(path: Path, most: int, encoding: str = 'utf-8-sig') -> Iterator[tuple[int, str]]:
    """
    Yield the lines of a text file without line breaks, each with its number from 1.

    Raises
    ------
    OSError
        See ``limited``.
    ValueError
        A line is too long, or not in this encoding; the message starts with its number.

    """
    number = 0
    with limited(path, most) as content, TextIOWrapper(content, encoding) as stream:
        while True:
            number += 1
            try:
                line = stream.readline(LONGEST_LINE + 1)
            except UnicodeError as problem:
                # Decoding is ahead of the lines, so the line number is a lower bound.
                name = encoding.removesuffix('-sig').upper()
                raise ValueError(f'{number}: not {name} text, in this line or below: '
                                 f'{getattr(problem, "reason", problem)}') from problem
            if not line:
                return
            line = line.rstrip('\n')
            if len(line) > LONGEST_LINE:
                raise ValueError(f'{number}: longer than {LONGEST_LINE} characters')
            yield number, line


@contextmanager
def memory_for(most: int) -> Iterator[None]:
    """Raise MemoryError if the process takes more memory than now, by more than this [bytes]."""
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[0])
    limits = resource.getrlimit(resource.RLIMIT_AS)
    # Without a limit it is -1.
    least = min([pages * resource.getpagesize() + most, *(one for one in limits if one >= 0)])
    resource.setrlimit(resource.RLIMIT_AS, (least, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def plain_number(text: str) -> float:
    """Return a number in decimal notation; NaN for anything else, such as 1_5 for 15."""
    try:
        return math.nan if '_' in text else float(text)
    except ValueError:
        return math.nan


def parse_json(text: bytes) -> Any:
    """
    Parse JSON.

    Raises
    ------
    ValueError
        The text is not JSON, has too many values, is nested too deeply, or is not UTF-8; one line.

    """
    # Checked before parsing: each empty list or key would take a hundred bytes.
    if sum(map(text.count, (b',', b'[', b'{'))) > MOST_VALUES:
        raise ValueError(f'more than {MOST_VALUES} values')
    try:
        return json.loads(text)
    except RecursionError as problem:
        raise ValueError('nested too deeply') from problem


def safetensors_header(stream: BinaryIO) -> bytes:
    """
    Return the JSON header of a safetensors file.

    Raises
    ------
    ValueError
        The header is truncated or too long.

    """
    size = int.from_bytes(stream.read(8), 'little')
    if size > LONGEST_HEADER:
        raise ValueError(f'a header of more than {in_bytes(LONGEST_HEADER)}')
    header = stream.read(size)
    if len(header) < max(size, 1):
        raise ValueError('it ends inside its header')
    return header


def array_names(path: Path, most: int) -> list[str]:
    """Return the keys of an .npz file; see ``unpack_arrays``."""
    with _archive(path, most) as archive:
        return [*archive.files]


def unpack_arrays(path: Path, most: int) -> dict[str, np.ndarray]:
    """
    Return the arrays of an .npz file by key; nothing is unpickled.

    Parameters
    ----------
    path : Path
        The file.
    most : int
        Maximum size of the file, and of its unpacked content [bytes].

    Raises
    ------
    OSError
        See ``limited``; or the unpacked content is larger.
    ValueError
        The file is not an archive of plain arrays, or is damaged; one line.

    """
    with _archive(path, most) as archive:
        if sum(member.file_size for member in archive.zip.infolist()) > most:
            raise OSError(errno.EFBIG, f'unpacks to more than {in_bytes(most)}')
        found = {name: archive[name] for name in archive.files}
        # numpy returns the bytes of a member that is not an array.
        if not all(isinstance(array, np.ndarray) for array in found.values()):
            raise ValueError
        return found


@contextmanager
def _archive(path: Path, most: int) -> Iterator[Any]:
    with limited(path, most) as stream:
        try:
            with np.load(stream, allow_pickle=False) as archive:
                yield archive
        except OSError:
            raise
        except Exception as problem:  # damaged archives raise exceptions without a common class
            # Not numpy's message, which recommends unpickling untrusted files.
            raise ValueError('not an .npz file of plain arrays') from problem
