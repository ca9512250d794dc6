# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Return the rows of compressed logs and of binary tables as comma-separated text."""

from collections.abc import Mapping
import csv
import errno
import gzip
from io import BytesIO, StringIO
from itertools import chain
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files import in_bytes, memory_for, parse_json, read_limited
import numpy as np

# Columns of datasets of LeRobot, largest size of their description [bytes], and of positions in
# per cent of a range, with some excess.
_STATE, _ACTION, _MOST_INFO, _RANGE = 'observation.state', 'action', 1 << 20, 105.0
# Most cells in a table, memory in which it is read [bytes], and rows that become text at once.
_MOST_CELLS, _MEMORY, _BLOCK = 20_000_000, 2 << 30, 10_000
# Functions of pandas that read tables, and the packages that they need.
_PANDAS = {'.parquet': ('read_parquet', 'pandas pyarrow'),
           '.feather': ('read_feather', 'pandas pyarrow'), '.json': ('DataFrame', 'pandas'),
           '.xlsx': ('read_excel', 'pandas openpyxl')}
_READ = frozenset(('.gz', '.zip', '.npy', '.mat', *_PANDAS))
_CSV = 'save its table as CSV'
_REMEDIES = {'.bag': 'convert it with rosbags-convert', '.ulg': 'convert it with ulog2csv'} | {
    suffix: remedy for remedy, suffixes in {
        'decompress it with zstd -d': ('.zst', '.zstd'),
        'write its arrays with numpy.savez': ('.h5', '.hdf5'),
        _CSV: ('.bz2', '.jsonl', '.mf4', '.ods', '.tdms', '.xls', '.xz'),
        f'{_CSV}, for pickles may run code': ('.pkl', '.pickle')}.items() for suffix in suffixes}


def table_text(path: Path, most: int, encoding: str) -> str | None:
    """
    Return the rows of a table under a line of their names, or None for a file of plain text.

    Parameters
    ----------
    path : Path
        File whose suffix names the format: compressed text (.gz, .zip with one file), arrays of
        columns (.npy, .mat), or a table that pandas reads (.parquet, .feather, .json, .xlsx).
    most : int
        Maximum size of the file and of its text [bytes].
    encoding : str
        Encoding of compressed text.

    Raises
    ------
    DataError
        The format is not supported or needs a package; the message names the remedy.
    OSError
        The file cannot be read, or is larger than `most`.

    """
    suffix = path.suffix.lower()
    if suffix in _REMEDIES:
        raise DataError(f'{path}: {suffix} is no format of a log; {_REMEDIES[suffix]}')
    if suffix not in _READ:
        return None
    stream, (reader, needs) = BytesIO(read_limited(path, most)), _PANDAS.get(suffix, ('', ''))
    try:
        with memory_for(_MEMORY):
            return _text(path, stream, suffix, most, encoding, reader)
    except ImportError as problem:
        raise DataError(f'{path}: {suffix} is read with {" and ".join(needs.split())}; '
                        f'pip install {needs}, or {_CSV}') from problem
    except (ValueError, TypeError, KeyError, EOFError, RuntimeError, BadZipFile, MemoryError,
            SyntaxError, gzip.BadGzipFile) as problem:
        reason = ' '.join(str(problem).split())[:200] or 'it takes too much memory'
        raise DataError(f'{path}: not a readable {suffix} table ({reason}); {_CSV}') from problem


def _text(path: Path, stream: BytesIO, suffix: str, most: int, encoding: str, reader: str) -> str:
    if suffix in ('.gz', '.zip'):
        text = _decompress(stream, suffix, most + 1)
        if len(text) > most:
            raise OSError(errno.EFBIG, f'unpacks to more than {in_bytes(most)}')
        return text.decode(encoding)
    if suffix == '.npy':
        return _csv(_columns({'': np.load(stream)}))
    if suffix == '.mat':
        from scipy.io import loadmat
        return _csv(_columns(loadmat(stream)))
    import pandas
    if suffix == '.xlsx':
        _check_sheet(stream, pandas.ExcelFile(stream))
    # read_json would take numbers of columns such as timestamp for dates.
    table = pandas.DataFrame(_samples(parse_json(stream.read()))) if suffix == '.json' else \
        getattr(pandas, reader)(stream)
    table = table if table.index.name is None else table.reset_index()
    columns = {str(name): table[name].to_numpy() for name in table}
    return _csv(_of_episodes(path, columns) if {_STATE, _ACTION} <= columns.keys() else columns)


def _check_sheet(stream: BytesIO, file: Any) -> None:
    """Raise ValueError if the first sheet has too many cells; one that is far away adds others."""
    # Each cell takes a dozen bytes, also in other sheets.
    _check_size(sum(part.file_size for part in ZipFile(stream).infolist()) // 12)
    cells = 0
    for row in file.book.worksheets[0].values:
        _check_size(cells := cells + len(row))


def _check_size(cells: int) -> None:
    if cells > _MOST_CELLS:
        raise ValueError(f'it has more than {_MOST_CELLS} cells')


def _samples(content: Any) -> Any:
    """Return the list of samples in a mapping whose other entries describe the log."""
    lists = [part for part in content.values() if isinstance(part, list) and part and all(
        isinstance(one, dict) for one in part)] if isinstance(content, dict) else []
    return lists[0] if len(lists) == 1 else content


def _of_episodes(path: Path, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """
    Return the columns of episodes of LeRobot, with positions and actions of each joint [deg].

    R. Cadene et al., LeRobot, 2024: data/chunk-000/*.parquet, and the names of joints in
    meta/info.json.
    """
    states, actions = (np.stack([*columns[key]]).astype(float) for key in (_STATE, _ACTION))
    lacking = [name for name in ('timestamp', 'episode_index') if name not in columns]
    if lacking:
        raise DataError(f'{path}: has {_STATE} and {_ACTION} as a LeRobot dataset, but no '
                        f'{" and no ".join(lacking)}; add it')
    found = {'t [s]': columns['timestamp'], 'episode': columns['episode_index']}
    names = [f'q{k + 1}' for k in range(states.shape[1])]
    for folder in path.resolve().parents[:3]:
        if (folder / 'meta' / 'info.json').is_file():
            named = parse_json(read_limited(folder / 'meta' / 'info.json', _MOST_INFO))[
                'features'][_STATE]['names']
            # Some versions nest them in a mapping, such as {'motors': [...]}.
            names = next(iter(named.values())) if isinstance(named, dict) else named
            break
    arm = [k for k, name in enumerate(names) if 'gripper' not in name]
    if any(name.endswith('.pos') for name in names) and \
            np.abs(np.stack([states, actions])[..., arm]).max() <= _RANGE:
        raise DataError(
            f'{path}: positions within -100 and 100 are per cent of a calibrated range, or '
            'degrees; convert them by the calibration, (range_max - range_min) / 4096 '
            '* 1.8 degrees each, and save the table as CSV')
    for k, name in enumerate(names):
        joint = name.removesuffix('.pos').removeprefix('main_')
        unit = ' [deg]' if k in arm else ' [%]'
        found |= {f'{joint} position{unit}': states[:, k], f'{joint} action{unit}': actions[:, k]}
    return found


def _decompress(stream: BytesIO, suffix: str, most: int) -> bytes:
    """Return the first bytes of a compressed file."""
    if suffix == '.gz':
        return gzip.open(stream).read(most)
    archive = ZipFile(stream)
    if len(names := archive.namelist()) != 1:
        raise ValueError(f'it has {len(names)} files, expected one')
    return archive.open(names[0]).read(most)


def _columns(arrays: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the columns of arrays of equal length; columns of a matrix have numbers."""
    found: dict[str, np.ndarray] = {}
    for key, values in arrays.items():
        if isinstance(values, np.ndarray) and values.dtype == object and values.size == 1:
            values = values.item()  # of a struct
        if isinstance(values, np.ndarray) and values.dtype.names:
            found |= _columns({name: values[name] for name in values.dtype.names})
        elif isinstance(values, np.ndarray) and values.dtype.kind in 'fiub' and values.size:
            table = values.reshape(-1, values.shape[-1] if np.squeeze(values).ndim > 1 else 1)
            found |= {f'{key}{k + 1}' if table.shape[1] > 1 else key: column
                      for k, column in enumerate(table.T)}
    rows = max(map(len, found.values()), default=0)
    return {name: column for name, column in found.items() if len(column) == rows}


def _csv(columns: Mapping[str, np.ndarray]) -> str:
    """Return columns as text, without a header if they come from an array without names."""
    arrays = [1 * column if column.dtype == bool else column for column in columns.values()]
    _check_size(sum(map(len, arrays)))
    blocks = (zip(*(array[first:first + _BLOCK].tolist() for array in arrays), strict=True)
              for first in range(0, max(map(len, arrays), default=0), _BLOCK))
    parts = []
    for rows in chain([] if '1' in columns else [[[*columns]]], blocks):
        text = StringIO()
        csv.writer(text, lineterminator='\n').writerows(rows)
        parts.append(text.getvalue())
    return ''.join(parts)
