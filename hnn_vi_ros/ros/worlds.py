# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes as the worlds of simulation_interfaces: found, named by URIs, and read."""

from collections.abc import Sequence
import os
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from hnn_vi_ros.errors import (
    DataError, HnnViRosError, ModelError, RecordingError, SceneError)
from hnn_vi_ros.files import (
    CODE_REFUSED, is_path, no_file, share_folder, shipped_file, shipped_names)
from hnn_vi_ros.scene import load_scene, Scene

_PACKAGE, _FOLDER, _SUFFIXES = 'hnn_vi_ros', '/config/scenes/', ('.yaml', '.yml')
# Most files that are read in one folder.
_MAX_FILES = 200


class WorldError(HnnViRosError):
    """
    A world that cannot be found or loaded.

    Parameters
    ----------
    code : str
        Name of the simulation_interfaces constant for the reason.
    message : str
        Text of one line.

    """

    remedy = ('load a world by a URI that `GetAvailableWorlds` returns; folders of scenes are '
              'searched if the request names them')

    def __init__(self, code: str, message: str):
        self.code = code
        super().__init__(message)


class World(NamedTuple):
    """
    A scene as seen by clients.

    Parameters
    ----------
    name : str
        Name of the file without the suffix.
    uri : str
        URI that loads the scene.
    description : str
        Text of one line.
    tags : tuple of str
        Kinds of its Hamiltonian and of its effects.

    """

    name: str
    uri: str
    description: str
    tags: tuple[str, ...]


def world_of(scene: Scene) -> World:
    """Return a scene as a world."""
    tags = dict.fromkeys([scene.hamiltonian.kind, *(effect.kind for effect in scene.effects)])
    source = scene.source.absolute()
    shipped = source == shipped_file('scene', scene.name).absolute()
    uri = f'package://{_PACKAGE}{_FOLDER}{source.name}' if shipped else source.as_uri()
    return World(scene.name, uri, scene.description, tuple(tags))


def unquoted(problem: HnnViRosError, file: str) -> HnnViRosError:
    """
    Return an error about a scene or bag that another node has named, without quoting its content.

    Errors about files of this package are returned unchanged.
    """
    if not isinstance(problem, SceneError | ModelError | DataError | RecordingError) or not \
            is_path('scene', file) or Path(file).resolve().is_relative_to(
                share_folder().resolve()):
        return problem
    why = f'names what {CODE_REFUSED}' if CODE_REFUSED in str(problem) else 'cannot be used'
    return SceneError(f'{_shown(file)}: {why}; another node has named it, so that nothing of it '
                      'is quoted here; check it on the command line')


def open_world(uri: str, known: str = '') -> tuple[Scene, str]:
    """
    Read the scene of a URI; return it and the value of the parameter ``scene`` for it.

    Parameters
    ----------
    uri : str
        ``package://hnn_vi_ros/config/scenes/NAME.yaml``, a ``file:`` URI, or a value of the
        parameter ``scene``: the name of a shipped scene or a path.
    known : str, optional
        Scene that the user has named, which errors may quote.

    Raises
    ------
    WorldError
        The URI names no scene that can be simulated, or names a scene that runs code, which only
        the user who starts the node can allow.

    """
    name = _name_or_path(uri)
    if os.path.splitext(name)[1] not in ('', *_SUFFIXES):
        raise WorldError('UNSUPPORTED_FORMAT', f'{_shown(uri)}: expected a scene file (.yaml)')
    if is_path('scene', name):
        if not os.path.isfile(name):
            raise WorldError('RESULT_NOT_FOUND', f'{_shown(uri)}: {no_file(Path(name))}; name a '
                                                 'scene file (.yaml)')
    elif name not in shipped_names('scene'):
        raise WorldError('RESULT_NOT_FOUND',
                         f'{_shown(uri)}: no such scene; ~/get_available_worlds lists them')
    try:
        scene = load_scene(name, trust_code=False)
        scene.model_files()
    except (SceneError, ModelError) as problem:
        code = 'MISSING_ASSETS' if isinstance(problem, ModelError) else 'UNSUPPORTED_ELEMENTS' \
            if CODE_REFUSED in str(problem) else 'RESOURCE_PARSE_ERROR'
        raise WorldError(code, str(
            problem if name == known else unquoted(problem, name))) from None
    return scene, name


def find_worlds(folders: Sequence[str], go_on: bool) -> tuple[list[World], list[str]]:
    """
    Return the worlds that can be loaded: the shipped ones, then those in folders.

    Parameters
    ----------
    folders : sequence of str
        Paths or ``file:`` URIs of folders with scene files.
    go_on : bool
        True to only report a folder that cannot be read.

    Returns
    -------
    worlds, problems : list
        The worlds, and a line on each folder that could not be searched.

    Raises
    ------
    WorldError
        A folder cannot be read.

    """
    worlds, problems = _loadable_worlds(shipped_names('scene')), []
    for folder in folders:
        try:
            worlds += _loadable_worlds(_files_in(folder))
        except WorldError as problem:
            if not go_on:
                raise
            problems.append(str(problem))
    return worlds, problems


def _name_or_path(uri: str) -> str:
    try:
        parts = urlsplit(uri)
    except ValueError as problem:
        raise WorldError('UNSUPPORTED_FORMAT', f'{_shown(uri)}: {problem}') from problem
    if not parts.scheme:
        return uri
    if parts.scheme == 'file' and parts.netloc in ('', 'localhost'):
        return unquote(parts.path)
    name = unquote(parts.path).removeprefix(_FOLDER).removesuffix(_SUFFIXES[0])
    if (parts.scheme, parts.netloc) == ('package', _PACKAGE) and not is_path('scene', name):
        return name
    raise WorldError('UNSUPPORTED_FORMAT', (
        f'{_shown(uri)}: expected package://{_PACKAGE}{_FOLDER}NAME.yaml, file:///PATH.yaml, '
        'the name of a shipped scene, or a path'))


def _files_in(folder: str) -> list[str]:
    try:
        path = Path(_name_or_path(folder)).absolute()
        files = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    except (OSError, ValueError, WorldError) as problem:
        raise WorldError('RESULT_NOT_FOUND',
                         f'{_shown(folder)}: not a readable folder') from problem
    if len(files) > _MAX_FILES:
        raise WorldError('RESULT_OPERATION_FAILED', (
            f'{_shown(folder)}: {len(files)} files exceed the limit of {_MAX_FILES}; put scenes '
            'into a separate folder'))
    return [str(file) for file in files]


def _loadable_worlds(names: Sequence[str]) -> list[World]:
    """Return the files that are loadable scenes; a folder may also contain other YAML files."""
    worlds = []
    for name in names:
        try:
            worlds.append(world_of(open_world(name)[0]))
        except WorldError:
            continue
    return worlds


def _shown(uri: str) -> str:
    """Return received text in a form that fits into a line."""
    return repr(uri[:200])
