# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find shipped files, files of ROS packages, and folders of the user."""

import atexit
from contextlib import suppress
from functools import cache
import os
from pathlib import Path
from secrets import token_bytes
import shutil
import stat
import sys
import tempfile

from hnn_vi_ros.errors import did_you_mean, HnnViRosError, listed, offered
from hnn_vi_ros.files.regular_file import no_file, open_no_link
from hnn_vi_ros.files.writing import make_folder, write_bytes

SCHEME = 'package://'
# Size of a key for SHA-256 [bytes].
_KEY_SIZE = 32


def package_file(uri: str) -> Path:
    """
    Return the file of a package URI; it need not exist.

    Parameters
    ----------
    uri : str
        ``package://PACKAGE/PATH``, with a path in the share folder of the package.

    Raises
    ------
    ValueError
        The URI is malformed or the package is unknown; one line.

    """
    package, _, path = uri.removeprefix(SCHEME).partition('/')
    if not (uri.startswith(SCHEME) and path and package.replace('_', '').isalnum()):
        raise ValueError(f'{uri!r} must be {SCHEME}PACKAGE/PATH')
    for prefix in prefixes():
        if (prefix / 'share/ament_index/resource_index/packages' / package).is_file():
            return prefix / 'share' / package / path
    raise ValueError(f'{uri}: the package {package!r} is not in AMENT_PREFIX_PATH; source the '
                     'workspace that contains it, or give the path of the file')


def prefixes() -> list[Path]:
    """Return the folders in which ROS packages are installed; overlays come first."""
    # Wheels put share/ next to the interpreter's lib/ and need no AMENT_PREFIX_PATH for it.
    listed = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [Path(prefix) for prefix in (*listed, sys.prefix) if prefix]


def expand_user(path: str | Path) -> Path:
    """Return a path with ``~`` expanded; unchanged if there is no home folder for it."""
    return Path(os.path.expanduser(path))


def usual_folder(variable: str = 'XDG_CACHE_HOME', name: str = '.cache') -> Path | None:
    """Return the folder of a variable, or the default in the home; None if read-only."""
    folder = Path(os.environ.get(variable) or expand_user('~') / name)
    return folder if folder.is_absolute() and can_be_written(folder) else None


def cache_folder() -> Path:
    """Return the folder of the user's caches, or a private one if that is read-only."""
    return usual_folder() or private_folder()


def private_folder(folder: Path | None = None) -> Path:
    """
    Return a folder that only this user can write to; create it if it does not exist.

    Cached code is executed: a folder that others can write to, or a link, is replaced by a new
    folder, which is the same during the whole process and removed at its end.

    Parameters
    ----------
    folder : Path, optional
        The folder; by default a persistent one in the temporary directory.

    """
    if folder is None:
        folder = Path(tempfile.gettempdir(), f'hnn_vi_ros-cache-{os.getuid()}')
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if is_own(folder.lstat(), stat.S_IFDIR):
            return folder
    except OSError:  # for example a file, or a link to nothing
        pass
    return _instead(folder)


def own_cache(name: str) -> Path:
    """Return a folder of this package's caches to which only this user can write."""
    folder = private_folder(cache_folder() / 'hnn_vi_ros' / 'private') / name
    make_folder(folder)
    return folder


@cache
def _instead(folder: Path) -> Path:
    instead = Path(tempfile.mkdtemp(prefix='hnn_vi_ros-cache-'))
    atexit.register(shutil.rmtree, instead, ignore_errors=True)
    return instead


def is_own(there: os.stat_result, kind: int, *others: int) -> bool:
    """
    Return whether a file or folder belongs to this user and nobody else can write to it.

    Parameters
    ----------
    there : os.stat_result
        Result of ``os.fstat`` or ``os.lstat``.
    kind : int
        ``stat.S_IFREG`` or ``stat.S_IFDIR``.
    *others : int
        Other accepted owners.

    """
    return (stat.S_IFMT(there.st_mode) == kind and there.st_uid in (os.getuid(), *others)
            and not there.st_mode & (stat.S_IWGRP | stat.S_IWOTH))


@cache
def private_key() -> bytes:
    """
    Return a random key that only this user can read, created at its first use.

    Without a writable cache folder it is new in each process.
    """
    with suppress(OSError):
        path = own_cache('') / 'key'
        for _ in range(2):
            with suppress(FileNotFoundError):
                with open(path, 'rb', opener=open_no_link) as stream:
                    there, key = os.fstat(stream.fileno()), stream.read(_KEY_SIZE)
                if is_own(there, stat.S_IFREG) and not there.st_mode & 0o077 \
                        and len(key) == _KEY_SIZE:
                    return key
                # Others could have read or written it.
                path.unlink()
            with suppress(FileExistsError):
                write_bytes(path, token_bytes(_KEY_SIZE), new=True, mode=0o600)
    return token_bytes(_KEY_SIZE)


def can_be_written(folder: Path) -> bool:
    """Return whether files can be created in a folder, which need not exist yet."""
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
# Kinds that `find_yaml` finds.
YAML_KINDS = ('scene', 'sweep', 'task', 'training')
# Command that lists all shipped files of a kind.
_LIST_HINTS = {'scene': '; `hnn list scenes` lists them', 'task': '; `hnn list tasks` lists them'}
# Names of kinds in messages, if different.
_KIND_NAMES = {'training': 'training configuration'}


def share_folder() -> Path:
    """
    Return the folder with ``config/`` and ``resource/``.

    In a source tree it is the checkout, in an installation (colcon, Debian package, pip)
    ``<prefix>/share/hnn_vi_ros``.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in package.parents:
        for candidate in (folder, folder / 'share' / 'hnn_vi_ros'):
            if (candidate / 'config' / 'scenes').is_dir():
                return candidate
    raise FileNotFoundError(f'the package at {package} has no config/scenes; reinstall it')


def shipped_names(kind: str) -> list[str]:
    """Return the sorted names of the shipped files of a kind, such as scene, sweep, task."""
    folder, suffix = _FOLDERS[kind]
    return sorted(path.stem for path in (share_folder() / folder).glob(f'*{suffix}'))


def shipped_file(kind: str, name: str) -> Path:
    """Return the path of a shipped file of this kind and name; it need not exist."""
    folder, suffix = _FOLDERS[kind]
    return share_folder() / folder / f'{name}{suffix}'


def is_path(kind: str, name: str) -> bool:
    """Return whether a name is a path: it has a separator or the suffix of the kind."""
    suffixes = (_FOLDERS[kind][1], '.yml') if kind != 'model' else (_FOLDERS[kind][1],)
    return '/' in name or name.endswith(suffixes)


def find_yaml(kind: str, text: str, error: type[HnnViRosError]) -> Path:
    """
    Return the YAML file for a name or a path given by the user.

    Parameters
    ----------
    kind : str
        ``scene``, ``sweep``, ``task`` or ``training``.
    text : str
        Name of a shipped file, or path of a file.
    error : type of HnnViRosError
        Exception to raise if the file does not exist, with one line: the valid names, and the
        closest one.

    """
    if kind == 'scene' and text.endswith(('.urdf', '.xacro')):
        raise error(f'{text}: is a robot, which needs a scene; write one with: hnn scene --new '
                    f'--robot {text}')
    named = is_path(kind, text)
    path = Path(text) if named else shipped_file(kind, text)
    if os.path.isfile(path):
        return path
    names, what = shipped_names(kind), _KIND_NAMES.get(kind, kind)
    if os.path.isdir(text) or (named and os.path.exists(text)):
        raise error(f'{text}: {no_file(Path(text))}; give the path of a {what} (.yaml)')
    if not named:
        beside = f'; for the file {text} give ./{text}' if os.path.isfile(text) else ''
        raise error(f'no {what} {text!r}{beside}{offered(text, names, "shipped")}'
                    f'{_LIST_HINTS.get(kind, "")}; or give the path of a .yaml file')
    # Compare stems only, because all files share the suffix.
    files = path.parent.glob('*.y*ml') if os.path.isdir(path.parent) else ()
    beside_it = {file.stem: file.name for file in files}
    hint = did_you_mean(path.stem, beside_it)
    for stem, name in beside_it.items():
        hint = hint.replace(f' {stem}?', f' {name}?')
    hint = hint or did_you_mean(path.stem, names)
    raise error(f'{text}: no such file{hint}; give the path of a {what}, or the name of a shipped '
                f'one{_LIST_HINTS.get(kind) or f": {listed(names)}"}')
