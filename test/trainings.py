# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Small trainings, as files below pytest's cache: made once of the same sources and inputs."""

from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from dataclasses import dataclass
import fcntl
from hashlib import sha256
from io import StringIO
from pathlib import Path
import shutil

import hnn_vi_ros
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.learning import train
from matplotlib.figure import Figure
import numpy as np
import pytest
import torch


@dataclass(frozen=True)
class Training:
    """Files of a training, which tests only read."""

    folder: Path

    @property
    def config(self) -> str:
        """Return the configuration."""
        return str(self.folder / 'm.yaml')

    @property
    def data(self) -> str:
        """Return the measured motions."""
        return str(self.folder / 'm.npz')

    @property
    def model(self) -> Path:
        """Return the trained model; its report lies beside it, with empty pictures."""
        return self.folder / 'm.safetensors'

    @property
    def said(self) -> str:
        """Return the printed lines."""
        return (self.folder / 'm.txt').read_text(encoding='utf-8')


def empty_picture(figure: Figure, path: Path, **options: object) -> None:
    """Take the place of ``Figure.savefig``, which takes longer than a small training."""
    path.touch()


def trained(config: pytest.Config, name: str, settings: str | dict,
            arrays: Callable[[], dict[str, np.ndarray]] | None = None,
            options: Iterable[str] = ()) -> Training:
    """
    Return a training, which is repeated where the package, the motions or the settings changed.

    Workers of one session that want the same one wait for the first.

    Parameters
    ----------
    config : pytest.Config
        Its cache holds the files.
    name : str
        Of the training; one of another digest replaces it.
    settings : str or dict
        The configuration, as YAML.
    arrays : callable, optional
        A function that returns the motions to learn from.
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
        files += [source, *source.parent.glob('[!t]*.py')]  # and what it may import beside it
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
        # The last file: a training that was interrupted has none.
        mark.write_text(digest.hexdigest())
    return made
