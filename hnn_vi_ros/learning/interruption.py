# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Stop a training run and go on with it later, in another process."""

from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
import os
from pathlib import Path
import pickle
import signal
import sys
import time
import zipfile

from hnn_vi_ros.errors import Interrupted, ParameterError
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.learning.config import TrainingConfig
from hnn_vi_ros.learning.dataset import Dataset
from hnn_vi_ros.learning.loop import Loop
from hnn_vi_ros.learning.state_dict import check_pickles
import numpy as np
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
        How is trained.
    dataset : Dataset
        On what.
    device : str
        Where.

    """

    def __init__(self, path: Path, config: TrainingConfig, dataset: Dataset, device: str):
        self.path, self._saved, self._stopping = path, time.monotonic(), False
        digest = sha256(f'{config.model_dump_json()} {device} {torch.__version__}'.encode())
        for part in vars(dataset).values():
            if isinstance(part, np.ndarray):
                digest.update(np.ascontiguousarray(part).tobytes())
        self._digest = digest.hexdigest()

    def load(self, loop: Loop) -> None:
        """
        Go on where the saved run stopped.

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
        loop.state = saved['state']

    def __call__(self, loop: Loop) -> None:
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
            torch.save({'digest': self._digest, 'state': loop.state}, temporary)
            temporary.replace(self.path)
        except (OSError, RuntimeError) as problem:  # torch has an error of its own for a full disk
            if self._stopping:
                raise ParameterError(f'stopped at step {loop.step}; its state cannot be written '
                                     f'to {self.path} ({one_line(problem)})') from problem
            print(f'warning: {self.path}: the state of the run cannot be written '
                  f'({one_line(problem)}); training goes on', file=sys.stderr, flush=True)
        finally:
            temporary.unlink(missing_ok=True)
        self._saved = time.monotonic()
        if self._stopping:
            raise Interrupted(f'stopped at step {loop.step}, state in {self.path}; go on with the '
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
