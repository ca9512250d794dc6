# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Write the file of a new scene, which takes the place of no other."""

from pathlib import Path

from hnn_vi_ros.errors import SceneError


def write_new_scene(path: Path, text: str) -> None:
    """
    Write the text of a scene.

    Raises
    ------
    SceneError
        The file exists already, or cannot be written.

    """
    try:
        with path.open('x', encoding='utf-8') as stream:
            stream.write(text)
    except FileExistsError as problem:
        raise SceneError(f'{path}: exists already; name another file') from problem
    except OSError as problem:
        raise SceneError(f'{path}: cannot be written ({problem.strerror}); name another file'
                         ) from problem
