# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Origin of a scene, which locates its models and the Python code next to it."""

from collections.abc import Mapping
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import ModelError, offered, prefixed
from hnn_vi_ros.files import (
    find_beside, is_path, KeyPlaces, no_file, package_file, parse_mapping, SCHEME,
    shipped_file, shipped_names)
from hnn_vi_ros.models import file_digest

# Suffixes of files written by torch.save.
_OF_TORCH = ('.pt', '.pth', '.tar', '.pkl')


@dataclass(frozen=True)
class Origin:
    """
    The file of a scene, or the description in a bag or a topic.

    Parameters
    ----------
    path : Path
        File the scene was read from, if any.
    places : KeyPlaces or None
        Places of the keys.
    replaced : frozenset of str
        Keys whose values differ from those in the file.
    code_folder : str or None
        Folder for Python code that is not installed; None for the scene of a bag or a topic, which
        must not choose it.
    digests : frozenset of str or None
        SHA-256 of the model files of a scene from a bag or a topic. It may name any path, but only
        files with these digests are opened as models. None for a file given by the user.

    """

    path: Path = Path('scene')
    places: KeyPlaces | None = None
    replaced: frozenset[str] = frozenset()
    code_folder: str | None = None
    digests: frozenset[str] | None = None

    def place(self, *key: str | int) -> str:
        """Return ``file:line: key`` for an error; the key of an effect is ``effects, 0``."""
        if self.places is not None and key[0] not in self.replaced:
            return self.places.place(*key)
        changed = ' with overrides' * (key[0] in self.replaced)
        return f'{self.path}{changed}: {".".join(map(str, key))}'

    def find_code(self, arguments: Mapping[str, Any]) -> None:
        """Search the folder of the scene as well for Python code named in its arguments."""
        if arguments.get('factory') or arguments.get('discrete_lagrangian'):
            find_beside(self.code_folder)

    def model_file(self, model: str, *key: str | int) -> Path:
        """
        Return the file of a model.

        Parameters
        ----------
        model : str
            Name or path of the model.
        *key : str or int
            Key that names the model.

        Raises
        ------
        ModelError
            The model does not exist, or differs from that of the recorded scene.

        """
        if is_path('model', model):
            beside = self.path.parent / model
            file = beside if os.path.exists(beside) else Path(model)
            self._check_digest(file, '.safetensors', *key, 'model')
            return file
        # A model trained by the user precedes the shipped one of the same name.
        for candidate in (Path('models') / f'{model}.safetensors', shipped_file('model', model)):
            if os.path.isfile(candidate):
                return candidate
        names = shipped_names('model')
        raise ModelError(
            f'{self.place(*key, "model")}: no model {model!r}, nor models/{model}.safetensors'
            f'{offered(model, names, "shipped")}{_remedy(model)}')

    def robot_file(self, name: str, *key: str | int) -> Path:
        """
        Return the file of a robot.

        Parameters
        ----------
        name : str
            Path, or package://PACKAGE/PATH.
        *key : str or int
            Key that names the robot.

        Raises
        ------
        ModelError
            The file does not exist, or differs from that of the recorded scene.

        """
        place = self.place(*key, 'file')
        if name.startswith(SCHEME):
            with prefixed(place, ModelError):
                file = package_file(name)
        else:
            beside = self.path.parent / name
            file = beside if os.path.exists(beside) else Path(name)
        if not os.path.isfile(file):
            name = str(file)
            what = f'{name!r} {no_file(file)}' if os.path.exists(file) else f'no file {name!r}'
            raise ModelError(f'{place}: {what}; give a path from the folder of the scene or the '
                             'working directory, or package://PACKAGE/PATH')
        self._check_digest(file, '.urdf', *key, 'file')
        return file

    def _check_digest(self, file: Path, suffix: str, *key: str | int) -> None:
        if self.digests is None:
            return
        place = self.place(*key)
        if file.suffix != suffix:
            raise ModelError(f'{place}: {str(file)!r} is not a {suffix} file')
        with prefixed(place, ModelError, ModelError):
            digest = file_digest(file)
        if digest not in self.digests:
            raise ModelError(f'{place}: {str(file)!r} is not the file that was recorded: its '
                             f'SHA-256 begins with {digest[:16]}; restore the recorded file')


def _remedy(model: str) -> str:
    """Return the command that creates a missing model, if its name is known."""
    if model.endswith(_OF_TORCH):
        return ('; a model is a .safetensors file; convert a torch module with: '
                f'hnn import {model} ...')
    if model not in shipped_names('training'):
        return ''
    file = shipped_file('training', model)
    configuration, _ = parse_mapping(file.read_bytes(), file, ModelError)
    source = configuration['data'].get('source')
    data = f' --data FILE, which is {source}' if source else ''
    return f'; train it with: hnn train --config {model}{data}'
