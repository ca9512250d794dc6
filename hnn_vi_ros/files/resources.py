# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find shipped files, files of ROS packages, and the folders of the user."""

import os
from pathlib import Path
import stat
import sys
import tempfile

from hnn_vi_ros.errors import did_you_mean, HnnViRosError, listed, offered
from hnn_vi_ros.files.regular_file import no_file

SCHEME = 'package://'


def package_file(uri: str) -> Path:
    """
    Return the file that a URI of a package names; it need not exist.

    Parameters
    ----------
    uri : str
        ``package://PACKAGE/PATH``, a path in the share folder of the package.

    Raises
    ------
    ValueError
        No such URI or no such package; one line.

    """
    package, _, path = uri.removeprefix(SCHEME).partition('/')
    if not (uri.startswith(SCHEME) and path and package.replace('_', '').isalnum()):
        raise ValueError(f'{uri!r} must be {SCHEME}PACKAGE/PATH')
    for prefix in prefixes():
        if (prefix / 'share/ament_index/resource_index/packages' / package).is_file():
            return prefix / 'share' / package / path
    raise ValueError(f'{uri}: no package {package!r} is in what AMENT_PREFIX_PATH lists; source '
                     'the workspace that holds it, or give the path of the file')


def prefixes() -> list[Path]:
    """Return the folders that ROS packages are installed in, first what overlays others."""
    # Wheels put share/ next to the interpreter's lib/ and need no AMENT_PREFIX_PATH for it.
    listed = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [Path(prefix) for prefix in (*listed, sys.prefix) if prefix]


def expand_user(path: str | Path) -> Path:
    """Return a path with ``~`` as the home; unchanged if the user, or ``~NAME``, has none."""
    return Path(os.path.expanduser(path))


def usual_folder(variable: str = 'XDG_CACHE_HOME', name: str = '.cache') -> Path | None:
    """Return the folder that a variable names, or that in the home; None if it is read-only."""
    folder = Path(os.environ.get(variable) or expand_user('~') / name)
    return folder if folder.is_absolute() and can_be_written(folder) else None


def cache_folder() -> Path:
    """Return where caches of the user are: the usual folder, else a private one."""
    return usual_folder() or private_folder()


def private_folder() -> Path:
    """
    Return a folder of this user alone among temporary files, the same each time.

    What others can write is not taken: cached code is run. There it is another one each time.
    """
    folder = Path(tempfile.gettempdir(), f'hnn_vi_ros-cache-{os.getuid()}')
    folder.mkdir(mode=0o700, exist_ok=True)
    there = folder.lstat()
    if (stat.S_ISDIR(there.st_mode) and there.st_uid == os.getuid()
            and not there.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        return folder
    return Path(tempfile.mkdtemp(prefix='hnn_vi_ros-cache-'))


def can_be_written(folder: Path) -> bool:
    """Return whether files can be made in a folder, which need not exist yet."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return os.access(folder, os.W_OK)


_FOLDERS = {
    'scene': ('config/scenes', '.yaml'),
    'sweep': ('config/sweeps', '.yaml'),
    'task': ('config/tasks', '.yaml'),
    'training': ('config/training', '.yaml'),
    'model': ('resource/models', '.safetensors'),
}
# What lists all shipped ones of a kind.
_ALL = {'scene': '; `hnn scene --list` lists them'}
# What users call a kind, where that is another word.
_WHAT = {'training': 'training configuration'}


def share_folder() -> Path:
    """
    Return the folder that holds ``config/`` and ``resource/``.

    That is the checkout for a source tree, ``<prefix>/share/hnn_vi_ros`` for anything installed
    (colcon, a Debian package, pip).
    """
    package = Path(__file__).resolve().parents[1]
    for folder in package.parents:
        for candidate in (folder, folder / 'share' / 'hnn_vi_ros'):
            if (candidate / 'config' / 'scenes').is_dir():
                return candidate
    raise FileNotFoundError(f'no config/scenes belongs to the package at {package}; reinstall it')


def shipped_names(kind: str) -> list[str]:
    """Return the sorted names of the shipped files of a kind: scene, sweep, task and so on."""
    folder, suffix = _FOLDERS[kind]
    return sorted(path.stem for path in (share_folder() / folder).glob(f'*{suffix}'))


def shipped_file(kind: str, name: str) -> Path:
    """Return where a shipped file of this kind and name lies; it need not exist."""
    folder, suffix = _FOLDERS[kind]
    return share_folder() / folder / f'{name}{suffix}'


def is_path(kind: str, name: str) -> bool:
    """Return whether a name is a path: it has a separator or the kind's suffix."""
    suffixes = (_FOLDERS[kind][1], '.yml') if kind != 'model' else (_FOLDERS[kind][1],)
    return '/' in name or name.endswith(suffixes)


def find_yaml(kind: str, text: str, error: type[HnnViRosError]) -> Path:
    """
    Return the YAML file that a user names.

    Parameters
    ----------
    kind : str
        ``scene``, ``sweep``, ``task`` or ``training``.
    text : str
        The name of a shipped file, or the path of a file.
    error : type of HnnViRosError
        The exception to raise if there is no such file, with one line: the valid names, and the
        nearest one.

    """
    named = is_path(kind, text)
    path = Path(text) if named else shipped_file(kind, text)
    if os.path.isfile(path):
        return path
    names, what = shipped_names(kind), _WHAT.get(kind, kind)
    if os.path.isdir(text) or (named and os.path.exists(text)):
        raise error(f'{text}: {no_file(Path(text))}; give the path of a {what} (.yaml)')
    if not named:
        beside = f'; for the file {text} give ./{text}' if os.path.isfile(text) else ''
        raise error(f'no {what} {text!r}{beside}{offered(text, names, "shipped")}'
                    f'{_ALL.get(kind, "")}; or give the path of a .yaml file')
    # Compare the stems: all files share the suffix.
    files = path.parent.glob('*.y*ml') if os.path.isdir(path.parent) else ()
    beside_it = {file.stem: file.name for file in files}
    hint = did_you_mean(path.stem, beside_it)
    for stem, name in beside_it.items():
        hint = hint.replace(f' {stem}?', f' {name}?')
    hint = hint or did_you_mean(path.stem, names)
    raise error(f'{text}: no such file{hint}; give the path of a {what}, or the name of a shipped '
                f'one{_ALL.get(kind) or f": {listed(names)}"}')
