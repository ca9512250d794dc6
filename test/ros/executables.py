# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Executables of the package, each in a process of its own that begins in milliseconds.

It is forked from a process that has imported what executables import, which takes longer than most
tests of a node. Files that are about the entry point and its imports start a new Python instead.
"""

from contextlib import suppress
import multiprocessing
from multiprocessing import forkserver
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile

from hnn_vi_ros import cli
import pytest

_FORKS = multiprocessing.get_context('forkserver')
_FORKS.set_forkserver_preload(['preloaded'])


def _start_server() -> None:
    """Start the process that others are forked from, unless it runs; it finds this folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('PYTHONPATH', os.pathsep.join(filter(None, (
            str(Path(__file__).parent), os.environ.get('PYTHONPATH')))))
        forkserver.ensure_running()


class Executable:
    """A process of an executable; its methods are those of subprocess.Popen."""

    def __init__(self, name: str, words: list[str], folder: Path | None):
        # Files, not pipes: a pipe that nobody empties stops who writes to it.
        self.outputs = [tempfile.NamedTemporaryFile('w+') for _ in range(2)]  # noqa: SIM115
        self._process = _FORKS.Process(target=_run, daemon=True, args=(
            name, words, folder or Path.cwd(), dict(os.environ),
            [file.name for file in self.outputs]))
        _start_server()
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        """Return the exit status; None while the process runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """Return the exit status; None while the process runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; return the exit status."""
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(str(self._process), timeout or 0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill the process."""
        self.send_signal(signal.SIGKILL)


def _run(name: str, words: list[str], folder: Path, environment: dict[str, str],
         outputs: list[str]) -> None:
    """Become a process that an executable was started in."""
    for number, path in enumerate(outputs, start=1):
        file = os.open(path, os.O_WRONLY | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    # The tests may have been started deaf to a closed terminal, as by nohup.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    sys.argv = [name, *words]
    getattr(cli, name)()
