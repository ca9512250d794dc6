# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files that a bag consists of, and how each is opened."""

from itertools import pairwise
import os
from pathlib import Path
import re
import shutil
import tempfile
import weakref

from hnn_vi_ros.bags.bag_metadata import read_bag_metadata
from hnn_vi_ros.bags.bag_source import Source
from hnn_vi_ros.bags.mcap_file import McapFile
from hnn_vi_ros.bags.mcap_records import LARGEST
from hnn_vi_ros.bags.sqlite_file import SqliteFile
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.regular_file import open_file
import zstandard

_SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
_PACKED = '.zstd'
_BLOCK = 2**18
# rosbag2 numbers the files of a bag.
_NUMBERED = re.compile(r'(.*)_(\d+)\.')


def bag_files(bag: Path) -> list[Path]:
    """
    Return the files of a bag, in their order: those that metadata.yaml names, or the folder's.

    Parameters
    ----------
    bag : Path
        A folder, or a file, which is then the only one.

    Raises
    ------
    RecordingError
        A folder without a bag, with several, or with a part of one.

    """
    # Opening the path reports why it cannot be a bag.
    if not os.path.isdir(bag):
        return [bag]
    files = sorted(path for path in bag.iterdir() if path.name.endswith(_SUFFIXES))
    named = read_bag_metadata(bag).get('relative_file_paths')
    # No path of it leads out of the folder.
    names = list(dict.fromkeys(Path(str(name)).name for name in named)) \
        if isinstance(named, list) else []
    absent = [name for name in names if bag / name not in files]
    if names and not absent:
        return [bag / name for name in names]
    if len(files) == 1 and len(names) < 2:
        return files
    if names:
        raise RecordingError(f'{bag}: its metadata.yaml names {absent[0]!r}, which is no file of '
                             'a bag there; put it back, or give a file')
    return _numbered(bag, files)


def _numbered(bag: Path, files: list[Path]) -> list[Path]:
    """Return the files of one bag in the order of their numbers."""
    found = {path: match for path in files if (match := _NUMBERED.match(path.name))}
    numbers = {path: int(match[2]) for path, match in found.items()}
    if not files or len(found) < len(files) or len(set(numbers.values())) < len(files) \
            or len({match[1] for match in found.values()}) > 1:
        what = f'{len(files)} files; give one of them' if files else f'none{_nearest(bag)}'
        raise RecordingError(f'{bag}: expected a folder with one bag (.mcap or .db3), found '
                             f'{what}')
    files.sort(key=numbers.__getitem__)
    # The first ones may have been deleted, as recorders do that keep the newest.
    for before, after in pairwise(files):
        if numbers[after] != numbers[before] + 1:
            raise RecordingError(f'{bag}: none of its files is number {numbers[before] + 1}, '
                                 f'between {before.name} and {after.name}; put it back, or give '
                                 'a file')
    return files


def _nearest(folder: Path) -> str:
    """Return which folder in this one may have been meant: a run has its bags in folders."""
    bags = sorted(path.parent for suffix in _SUFFIXES for path in folder.glob(f'*/*{suffix}'))
    return f'; did you mean {bags[0]}?' if bags else ''


def open_source(path: Path) -> Source:
    """
    Return a file of a bag; a packed one stays unpacked while in use.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    RecordingError
        It is no file of a bag, or too large when unpacked.
    OSError
        It cannot be read.

    """
    if not path.name.endswith(_PACKED):
        return _source(path, path)
    scratch = Path(tempfile.mkdtemp(prefix='hnn_vi_ros-'))
    try:
        source = _source(_unpacked(path, scratch), path)
    except BaseException:
        shutil.rmtree(scratch)
        raise
    weakref.finalize(source, shutil.rmtree, scratch, ignore_errors=True)
    return source


def _source(path: Path, name: Path) -> Source:
    return (SqliteFile if path.suffix == '.db3' else McapFile)(path, name)


def _unpacked(path: Path, scratch: Path) -> Path:
    """Unpack a file, never more of it than a chunk may hold."""
    target = scratch / path.name.removesuffix(_PACKED)
    left = LARGEST
    try:
        with open_file(path, path) as stream, target.open('wb') as unpacked:
            reader = zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)
            while left >= 0 and (block := reader.read(_BLOCK)):
                unpacked.write(block)
                left -= len(block)
    except zstandard.ZstdError as problem:
        raise RecordingError(f'{path}: cannot be unpacked ({problem}); give another bag') \
            from problem
    if left < 0:
        raise RecordingError(f'{path}: unpacks to more than {LARGEST >> 20} MiB; unpack it with '
                             f'`zstd -d {path}`, and give what comes out')
    return target
