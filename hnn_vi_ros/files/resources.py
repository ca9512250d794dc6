# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find the files that are shipped with the package, installed or in a source checkout."""

from pathlib import Path

_FOLDERS = {
    'scene': ('config/scenes', '.yaml'),
    'sweep': ('config/sweeps', '.yaml'),
    'training': ('config/training', '.yaml'),
    'model': ('resource/models', '.safetensors'),
}


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
    """Return the sorted names of the shipped files of a kind: scene, sweep, training or model."""
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
