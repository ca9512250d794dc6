# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Small trainings, cached below pytest's cache for equal sources and inputs."""

from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from dataclasses import dataclass
import fcntl
from hashlib import sha256
from io import StringIO
from pathlib import Path
import shutil

import hnn_vi_ros
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.learning import train
from matplotlib.figure import Figure
import numpy as np
import pytest
import torch


@dataclass(frozen=True)
class Training:
    """Files of a training; tests only read them."""

    folder: Path

    @property
    def config(self) -> str:
        """Return the path of the configuration."""
        return str(self.folder / 'm.yaml')

    @property
    def data(self) -> str:
        """Return the path of the measured motions."""
        return str(self.folder / 'm.npz')

    @property
    def model(self) -> Path:
        """Return the path of the trained model; its report is next to it, with empty plots."""
        return self.folder / 'm.safetensors'

    @property
    def said(self) -> str:
        """Return the printed lines."""
        return (self.folder / 'm.txt').read_text(encoding='utf-8')


def empty_picture(figure: Figure, stream: object, **options: object) -> None:
    """Replace ``Figure.savefig``, which takes longer than a small training."""


def trained(config: pytest.Config, name: str, settings: str | dict,
            arrays: Callable[[], dict[str, np.ndarray]] | None = None,
            options: Iterable[str] = ()) -> Training:
    """
    Return a training; it is repeated if the package, the motions or the settings changed.

    Workers of a session that need the same training wait for the first one.

    Parameters
    ----------
    config : pytest.Config
        Its cache contains the files.
    name : str
        Name of the training; one with another digest is replaced.
    settings : str or dict
        Configuration, as YAML.
    arrays : callable, optional
        Function that returns the motions to learn from.
    options : iterable of str, optional
        Further arguments of ``train``.

    """
    assert config.cache is not None
    text = settings if isinstance(settings, str) else dump_yaml(settings)
    options = [*options]
    digest = sha256(f'{text} {options} {torch.__version__}'.encode())
    files = [*Path(hnn_vi_ros.__file__).parent.rglob('*.py'), Path(__file__)]
    if arrays is not None:
        source = Path(arrays.__code__.co_filename)
        files += [source, *source.parent.glob('[!t]*.py')]  # and its imports
    for file in sorted(files):
        digest.update(file.read_bytes())
    folder = config.cache.mkdir('trainings') / name
    with folder.with_suffix('.lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        made = Training(folder)
        mark = folder / 'digest'
        if mark.is_file() and mark.read_text() == digest.hexdigest():
            return made
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        Path(made.config).write_text(text, encoding='utf-8')
        words = ['--config', made.config, '--out', str(made.model), *options]
        if arrays is not None:
            np.savez(made.data, **arrays())
            words += ['--data', made.data]
        with redirect_stdout(StringIO()) as said, pytest.MonkeyPatch.context() as patch:
            patch.setattr(Figure, 'savefig', empty_picture)
            train.main(words)
        (folder / 'm.txt').write_text(said.getvalue(), encoding='utf-8')
        # Written last: an interrupted training does not have it.
        mark.write_text(digest.hexdigest())
    return made
