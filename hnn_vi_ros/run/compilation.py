# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compilation of the loop of a scene in another process, while this one compiles H.

Threads would not help, since numba compiles one function at a time. The process that first needs
a function compiles it; the other one waits, and loads the result from the disk cache.
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

_CODE = f'from {__name__} import compile_from_stdin; compile_from_stdin()'


@contextmanager
def compile_in_background(parts: Parts) -> Iterator[None]:
    """
    Compile the loop over steps in another process during the context, if it is not cached on disk.

    The process ends with this context, and with this process. It gets no signals of a terminal.
    Call it outside of the main thread, whose compilations run in other threads.

    Parameters
    ----------
    parts : Parts
        Parts of the scene.

    """
    if usable_processors() < 2 or _is_kept(parts):
        yield
        return
    with Popen([sys.executable, '-P', '-c', _CODE], stdin=PIPE, stdout=DEVNULL, stderr=DEVNULL,
               start_new_session=True) as process:
        try:
            # If the other process fails, this one compiles everything and reports the error.
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


def compile_from_stdin() -> None:
    """Compile the loop of the scene on standard input; exit when the input ends."""
    scene = pickle.load(sys.stdin.buffer)

    def end() -> None:
        # Past the buffer, whose lock must be free when the process ends.
        os.read(sys.stdin.fileno(), 1)
        os._exit(1)
    Thread(target=end, daemon=True).start()
    compile_loop(scene.parts())
