# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Short text that git-LFS leaves in the place of a file that was not fetched."""

from hnn_vi_ros.errors import HnnViRosError

_BEGIN = b'version https://git-lfs'


def refuse_pointer(raw: bytes, where: object, error: type[HnnViRosError]) -> None:
    """
    Raise if a file is no more than a pointer.

    Parameters
    ----------
    raw : bytes
        The file, or its first 32 bytes.
    where : object
        The file's name.
    error : type of HnnViRosError
        What to raise, with one line.

    """
    if raw.startswith(_BEGIN):
        raise error(f'{where}: a git-LFS pointer in the place of the file; fetch the file with: '
                    'git lfs pull')
