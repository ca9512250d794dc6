# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Nothing that was trained is lost: an interrupted run, a model whose evaluation fails."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
import os
from pathlib import Path
import pickle
import signal
import sys
from tempfile import mkdtemp
import time
import zipfile

from hnn_vi_ros.errors import (
    DataError, HnnViRosError, Interrupted, ModelError, ParameterError, RecordingError)
from hnn_vi_ros.files.limits import check_pickles
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.learning.fit.config import TrainingConfig
from hnn_vi_ros.learning.fit.loop import Fit
from hnn_vi_ros.models.checkpoint import Checkpoint, save_checkpoint
import numpy as np
from pydantic import ValidationError
import torch

# Wall time from one saving of the state to the next [s].
PERIOD = 30.0


class Keeper:
    """
    A file that holds the state of a training run while it runs.

    It is written every PERIOD and when Ctrl-C stops the run; it is removed when that has ended. It
    is read as tensors and numbers: nothing in it is executed.

    Parameters
    ----------
    path : Path
        The file.
    config : TrainingConfig
        How the model is trained.
    arrays : iterable of np.ndarray
        The data.
    device : str
        Where the model is trained.

    """

    def __init__(self, path: Path, config: TrainingConfig, arrays: Iterable[np.ndarray],
                 device: str):
        self.path, self._saved, self._stopping = path, time.monotonic(), False
        digest = sha256(f'{config.model_dump_json()} {device} {torch.__version__}'.encode())
        for part in arrays:
            digest.update(np.ascontiguousarray(part).tobytes())
        self._digest = digest.hexdigest()

    def load(self, fit: Fit) -> None:
        """
        Resume where the saved run stopped.

        Raises
        ------
        ParameterError
            There is no saved run, or it is one of something else.

        """
        try:
            check_pickles(self.path)
            saved = torch.load(self.path, weights_only=True)
            of_this = saved['digest'] == self._digest
        except FileNotFoundError as problem:
            raise ParameterError(f'--resume: no interrupted run at {self.path}; begin one without '
                                 '--resume') from problem
        except (OSError, RuntimeError, EOFError, KeyError, TypeError, ValueError,
                pickle.UnpicklingError, zipfile.BadZipFile) as problem:
            raise ParameterError(f'--resume: {self.path} cannot be read; remove it and begin anew '
                                 'without --resume') from problem
        if not of_this:
            raise ParameterError(f'--resume: {self.path} is of another configuration, other data '
                                 'or another device; take those again, or remove it and begin '
                                 'anew')
        fit.state = saved['state']

    def __call__(self, fit: Fit) -> None:
        """
        Save the state if it is time to.

        Raises
        ------
        Interrupted
            Ctrl-C was pressed.

        """
        if not self._stopping and time.monotonic() - self._saved < PERIOD:
            return
        temporary = self.path.with_name(f'.{self.path.name}.{os.getpid()}')
        try:
            torch.save({'digest': self._digest, 'state': fit.state}, temporary)
            temporary.replace(self.path)
        except (OSError, RuntimeError) as problem:  # torch has an error of its own for a full disk
            if self._stopping:
                raise ParameterError(f'stopped at step {fit.step}; its state cannot be written '
                                     f'to {self.path} ({one_line(problem)})') from problem
            print(f'warning: {self.path}: the state of the run cannot be written '
                  f'({one_line(problem)}); training goes on', file=sys.stderr, flush=True)
        finally:
            temporary.unlink(missing_ok=True)
        self._saved = time.monotonic()
        if self._stopping:
            raise Interrupted(f'stopped at step {fit.step}, state in {self.path}; go on with the '
                              'same command and --resume')

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Let Ctrl-C stop the run at its next pause; a second one stops it at once."""
        def stop(number: int, frame: object) -> None:
            self._stopping = True
            signal.signal(signal.SIGINT, before)

        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
        self.path.unlink(missing_ok=True)


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
        The trained model.

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
    """Save the members of an ensemble that are trained, each as a model, if another one fails."""
    try:
        yield
    except BaseException:
        files = member_files(model, len(members))
        for file, member in zip(files, members, strict=True):
            save_checkpoint(file, member)
        if files:
            print(f'members that were trained: {", ".join(map(str, files))}', flush=True)
        raise
