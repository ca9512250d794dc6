# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find and open the files of a bag, also compressed as a whole."""

from collections.abc import Sequence
from contextlib import ExitStack
from hashlib import file_digest, sha256
import os
from pathlib import Path
from tempfile import TemporaryDirectory

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import open_regular
from hnn_vi_ros.recording.bags.bag_metadata import read_bag_metadata
from hnn_vi_ros.recording.bags.mcap_file import McapFile, UnpackLimit
import zstandard

_SQLITE = '.db3', '.db3.zstd'
_SUFFIXES = '.mcap', '.mcap.zstd', *_SQLITE
_BLOCK_SIZE = 2**20


def bag_files(bag: Path) -> list[Path]:
    """
    Return the files of a bag in order.

    Parameters
    ----------
    bag : Path
        Folder of the bag, or one file.

    Raises
    ------
    RecordingError
        The folder contains no bag, or several files that no metadata.yaml joins to one bag.

    """
    # Opening the path reports the reason.
    if not os.path.isdir(bag):
        return [bag]
    files = sorted(path for path in bag.iterdir() if path.name.endswith(_SUFFIXES)
                   and not path.name.startswith('.'))
    named = read_bag_metadata(bag).get('relative_file_paths')
    # Only the file names are used, so no path leads out of the folder.
    names = list(dict.fromkeys(Path(str(name)).name for name in named)) \
        if isinstance(named, list) else []
    absent = [name for name in names if bag / name not in files]
    if names and not absent:
        return [bag / name for name in names]
    if len(files) == 1 and len(names) < 2:
        return files
    if names:
        raise RecordingError(f'{bag}: its metadata.yaml names {absent[0]!r}, which is not a bag '
                             'file there; restore it, or give a file')
    what = f'{len(files)} files without a metadata.yaml; give one of them, or write it with ' \
        '`ros2 bag reindex`' if files else f'none{_nearest(bag)}'
    raise RecordingError(f'{bag}: expected a folder with one bag (.mcap or .db3), found {what}')


def _nearest(folder: Path) -> str:
    """Suggest the subfolder that may have been meant: a run has its bags in subfolders."""
    bags = sorted(path.parent for suffix in _SUFFIXES for path in folder.glob(f'*/*{suffix}'))
    return f'; did you mean {bags[0]}?' if bags else ''


def is_sqlite(file: Path) -> bool:
    """Return True for the name of a bag's file in SQLite."""
    return file.name.endswith(_SQLITE)


def digest_of(files: Sequence[Path]) -> str:
    """Return the SHA-256 of some files."""
    found = sha256()
    for path in files:
        with open_regular(path) as stream:
            file_digest(stream, lambda: found)
    return found.hexdigest()


def open_sources(files: Sequence[Path]) -> tuple[list[McapFile], ExitStack]:
    """
    Return readers of the files of a bag, and the owner of their decompressed copies.

    Raises
    ------
    RecordingError
        A file does not belong to a bag in MCAP, or is too large when decompressed.
    OSError
        A file cannot be read.

    """
    for path in filter(is_sqlite, files):
        raise RecordingError(f'{path}: is in SQLite, which is read as training data only; convert '
                             'the bag to MCAP with `ros2 bag convert`')
    with ExitStack() as copies:
        if any(path.suffix == '.zstd' for path in files):
            folder = Path(copies.enter_context(TemporaryDirectory(prefix='hnn_vi_ros_bag_')))
            files = [_decompress(path, folder) if path.suffix == '.zstd' else path
                     for path in files]
        return [McapFile(path) for path in files], copies.pop_all()


def _decompress(path: Path, folder: Path) -> Path:
    """Decompress a file of a bag to a folder; return the new file."""
    target = folder / path.stem
    with open_regular(path) as stream, target.open('xb') as copy:
        allowance = UnpackLimit(path, os.fstat(stream.fileno()).st_size)
        try:
            unpacker = zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)
            while block := unpacker.read(_BLOCK_SIZE):
                allowance.spend(0, copy.tell() + len(block))
                copy.write(block)
        except zstandard.ZstdError as problem:
            raise RecordingError(f'{path}: cannot be decompressed ({problem}); give another '
                                 'bag') from problem
    return target
