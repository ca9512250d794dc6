# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The loop of a scene, compiled in another process while this one compiles H.

Threads would not help: numba compiles one function at a time. Whichever process begins with a
function first compiles it; the other waits for it, and finds it on disk.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import os
import pickle
from subprocess import DEVNULL, PIPE, Popen
import sys
from threading import Thread

from hnn_vi_ros.kernels import kept_only, NotKept
from hnn_vi_ros.scene import Parts
from hnn_vi_ros.simulation import compile_loop, usable_processors

_CODE = f'from {__name__} import help_out; help_out()'


@contextmanager
def compiled_beside(parts: Parts) -> Iterator[None]:
    """
    Have the loop over steps compiled by another process meanwhile, where it is not on disk yet.

    The process ends with this context, and with this process. It hears no signals of a terminal.
    To be called outside of the main thread, whose compilations run in others.

    Parameters
    ----------
    parts : Parts
        Of the scene.

    """
    if usable_processors() < 2 or _is_kept(parts):
        yield
        return
    with Popen([sys.executable, '-P', '-c', _CODE], stdin=PIPE, stdout=DEVNULL, stderr=DEVNULL,
               start_new_session=True) as process:
        try:
            # One that fails leaves all to this process, which says what is wrong.
            with suppress(pickle.PicklingError, OSError, AttributeError, TypeError):
                assert process.stdin is not None
                pickle.dump(parts.scene, process.stdin)
                process.stdin.flush()
            yield
        finally:
            process.kill()


def _is_kept(parts: Parts) -> bool:
    try:
        with kept_only():
            compile_loop(parts)
    except NotKept:
        return False
    return True


def help_out() -> None:
    """Compile the loop of the scene that comes by standard input, until that ends."""
    scene = pickle.load(sys.stdin.buffer)

    def end() -> None:
        sys.stdin.buffer.read()
        os._exit(1)
    Thread(target=end, daemon=True).start()
    compile_loop(scene.parts())
