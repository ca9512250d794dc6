# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables of error messages, one per folder of tests: `messages.txt`, one line per mistake.

A row contains the test that makes the mistake, its parameters as the input, and the resulting
message. `make messages` rewrites the tables; the diff is reviewed.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
import os
from pathlib import Path
import re
import tempfile

from hnn_vi_ros.files import in_plain_words, share_folder
from pydantic import ValidationError
import pytest

TESTS = Path(__file__).resolve().parents[1]
TABLE = 'messages.txt'
# Set by --messages: folder in which each process records the messages it has seen.
RECORD = 'HNN_VI_ROS_MESSAGES'
# Temporary folders of one run: pytest's tmp_path, and others in the temporary directory.
_FOLDER = re.compile(re.escape(tempfile.gettempdir())
                     + r'/(pytest-of-[^/ ]+/pytest-\d+/(popen-gw\d+/)?)?[^/\s\'"]+')
# Digests of files made by tests, whose bits may differ on other processors.
_DIGEST = re.compile(r'\b[0-9a-f]{16}([0-9a-f]{48})?\b')
# The shown part of a long name depends on the length of the path before it.
_RUN = re.compile(r'(\w)\1{49,}')
_LONGEST_KEY = 120
_calls: Counter[str] = Counter()


@contextmanager
def refused(*kinds: type[BaseException]) -> Iterator[pytest.ExceptionInfo]:
    """Expect an error of one of these kinds in one line, with the message of the table."""
    with pytest.raises(kinds) as caught:
        yield caught
    assert_message(f'{caught.type.__name__}: {caught.value}')


@contextmanager
def misfit() -> Iterator[None]:
    """Expect an error about data that do not fit a schema, with the message of the table."""
    with pytest.raises(ValidationError) as caught:
        yield
    assert_message(in_plain_words(caught.value))


def assert_message(text: str) -> None:
    """Compare a one-line message with the row of the table for the running test."""
    # A checkout may be in the temporary directory as well.
    for folder in (share_folder(), TESTS.parent):
        text = text.replace(f'{folder}/', '')
    said = _RUN.sub(r'\1...', _DIGEST.sub('DIGEST', _FOLDER.sub('TMP', text)))
    assert '\n' not in said and len(said) < 2200, said
    file, _, case = os.environ['PYTEST_CURRENT_TEST'].rpartition(' (')[0].partition('::')
    table = (TESTS.parent / file).parent / TABLE
    key = f'{Path(file).name}::{case}'
    if len(key) > _LONGEST_KEY:
        key = f'{key[:_LONGEST_KEY]} {sha256(key.encode()).hexdigest()[:8]}'
    _calls[file + key] += 1
    if _calls[file + key] > 1:
        key += f' #{_calls[file + key]}'
    if record := os.environ.get(RECORD):
        with Path(record, str(os.getpid())).open('a', encoding='utf-8') as notes:
            notes.write(f'{table.parent.relative_to(TESTS)}\t{key}\t{said}\n')
        return
    rows = read_table(table)
    assert key in rows, f'no row {key} in {table}; `make messages` writes it: {said}'
    assert said == rows[key], f'{key}: the table has\n{rows[key]}\nand not\n{said}'


@cache
def read_table(path: Path) -> dict[str, str]:
    """Return the messages of a table by key."""
    if not path.exists():
        return {}
    return dict(line.split('\t', 1) for line in path.read_text(encoding='utf-8').splitlines())


def write_tables(notes: Path, tests: set[str]) -> None:
    """Write recorded messages to the tables; they replace all rows of the functions that ran."""
    noted: dict[Path, dict[str, str]] = {}
    for line in (line for note in notes.iterdir()
                 for line in note.read_text(encoding='utf-8').splitlines()):
        folder, key, said = line.split('\t', 2)
        noted.setdefault(TESTS / folder / TABLE, {})[key] = said
    ran = {test.partition('[')[0] for test in tests}
    for path in {(TESTS.parent / test.partition('::')[0]).parent / TABLE for test in ran}:
        rows = {key: said for key, said in read_table(path).items() if _is_kept(path, key, ran)}
        rows |= noted.get(path, {})
        if rows:
            path.write_text(''.join(f'{key}\t{rows[key]}\n' for key in sorted(rows)),
                            encoding='utf-8')
        else:
            path.unlink(missing_ok=True)


def _is_kept(table: Path, key: str, ran: set[str]) -> bool:
    """Return whether the test function of a row exists and did not run."""
    file, function = key.partition('[')[0].partition(' #')[0].split('::', 1)
    path = table.parent / file
    return (f'{path.relative_to(TESTS.parent)}::{function}' not in ran and path.exists()
            and f'def {function.rpartition("::")[2]}(' in path.read_text(encoding='utf-8'))
