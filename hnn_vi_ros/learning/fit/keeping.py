# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A trained model is on disk before it is judged: nothing that comes after training loses it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

from hnn_vi_ros.errors import DataError, HnnViRosError, ModelError, RecordingError
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.models.checkpoint import Checkpoint, save_checkpoint
from pydantic import ValidationError


@contextmanager
def kept(model: Path, checkpoint: Checkpoint) -> Iterator[None]:
    """
    Save a trained model, and say of an error inside, where it is judged, that it is kept.

    Parameters
    ----------
    model : Path
        The file to write; where it cannot be written, as on a full disk, a folder for temporary
        files is taken instead, and the error names it.
    checkpoint : Checkpoint
        What was trained.

    Raises
    ------
    DataError, RecordingError
        In place of an error of this package, of a card, or of a file inside.
    ModelError
        The file cannot be written.

    """
    try:
        save_checkpoint(model, checkpoint)
    except ModelError as problem:
        instead = Path(mkdtemp(prefix='hnn_vi_ros_')) / model.name
        save_checkpoint(instead, checkpoint)
        raise ModelError(f'{problem}; the trained model is in {instead}') from problem
    still = f'; the model is trained, and is in {model}, without what was to follow'
    try:
        yield
    except ValidationError as problem:
        what = problem.errors(include_url=False)[0]
        raise DataError(f'{".".join(map(str, what["loc"]))} of the model card: '
                        f'{one_line(what["msg"])}{still}') from problem
    except HnnViRosError as problem:
        raise DataError(f'{problem}{still}') from problem
    except OSError as problem:
        raise RecordingError(f'{problem.filename}: cannot be written: {problem.strerror}{still}'
                             ) from problem


def member_files(model: Path, count: int) -> list[Path]:
    """Return where the members of an ensemble are kept if its training does not end."""
    return [model.with_suffix(f'.member{k}.safetensors') for k in range(1, count + 1)]


@contextmanager
def members_kept(model: Path, members: Sequence[Checkpoint]) -> Iterator[None]:
    """Save the members that are there by then, each as a model, if another one fails."""
    try:
        yield
    except BaseException:
        files = member_files(model, len(members))
        for file, member in zip(files, members, strict=True):
            save_checkpoint(file, member)
        if files:
            print(f'members that were trained: {", ".join(map(str, files))}', flush=True)
        raise
