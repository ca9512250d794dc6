# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A stream of the rerun SDK to one target, which reports failures and cleans up."""

from pathlib import Path
import socket
from subprocess import DEVNULL, PIPE, Popen
import threading
import time
from typing import final
from urllib.parse import urlsplit
from uuid import NAMESPACE_OID, uuid5

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import make_folder
import rerun as rr
from rerun import bindings  # type: ignore[attr-defined]  # not exported, but needed
import rerun.blueprint as rrb
import rerun_cli  # type: ignore[import-untyped]

Target = Path | str | int
# Time limits of closing [s]: to flush the last samples, to end a connection, and to finish a
# server or the index of a file.
FLUSH, HANG_UP, FINISH = 0.5, 0.3, 10.0
# Time limit for a server to start [s]; a second on an idle machine.
START = 30.0
# The server of the SDK listens on all interfaces, so the command `rerun` is started as a server.
# A shell ends it when its standard input is closed, also if this process is killed.
_ADDRESS = '127.0.0.1'
_UNTIL_CLOSED = '"$@" & read _; kill $!; wait'
# Threads that wait for a target that may never answer.
_waiting: list[threading.Thread] = []


@final
class RerunStream:
    """
    A stream to a file, to a viewer, or to viewers that connect to a port.

    Parameters
    ----------
    application : str
        Application; its recordings share a layout in the viewer.
    target : Path, str or int
        File to write (must not exist), URL of a viewer, or port to serve viewers of this machine.

    Attributes
    ----------
    live : bool
        True if viewers show data immediately.
    recording : rerun.RecordingStream
        Recording that receives the data.

    Raises
    ------
    RecordingError
        The file exists or cannot be written, no viewer listens, or the port is taken.

    """

    def __init__(self, application: str, target: Target):
        self.live = not isinstance(target, Path)
        self._application, self._target, self._size = application, target, 0
        self._server: Popen[bytes] | None = None
        self.recording = self._open()

    def send_blueprint(self, blueprint: rrb.Blueprint) -> None:
        """
        Send the layout of the views.

        The SDK's own function creates a reference cycle of its stream with a memory recording,
        which is never freed; here the cycle is broken.
        """
        _number(blueprint.root_container, 'root')
        stream = rr.RecordingStream._from_native(bindings.new_blueprint(
            application_id=self._application, make_default=False,
            make_thread_default=False, default_enabled=True))
        stream.set_time('blueprint', sequence=0)
        blueprint._log_to_stream(stream)
        bindings.send_blueprint(stream.memory_recording().storage, make_active=True,
                                make_default=True, recording=self.recording.to_native())
        stream.disconnect()

    def check(self) -> None:
        """
        Check that the data sent so far have reached the file.

        Raises
        ------
        RecordingError
            The file was removed or cannot be written any more; the stream is closed.

        """
        if not isinstance(self._target, Path):
            return
        try:
            before, self._size = self._size, self._target.stat().st_size
            if self._size == before:
                # The disk is slow, or the writing thread has ended (only this call tells).
                self.recording.flush(timeout_sec=FLUSH)
        except (OSError, RuntimeError) as problem:
            self._hang_up(HANG_UP)
            raise RecordingError(
                f'{self._target}: the rerun recording stopped ({_reason(problem)}): the file was '
                'removed or the disk is full; record elsewhere') from problem

    def close(self) -> None:
        """
        Flush the last data and close the target, within a second unless the disk is slow.

        Raises
        ------
        RecordingError
            Some data are lost, because the viewer is gone or the disk is full.

        """
        try:
            self.recording.flush(timeout_sec=FLUSH)
        except RuntimeError as problem:
            self._hang_up(HANG_UP)
            why = 'the viewer was closed' if self.live else (
                'the disk is full, or the machine is too busy')
            raise RecordingError(f'{self._target}: the end of the rerun recording is lost '
                                 f'({_reason(problem)}): perhaps {why}') from problem
        self._hang_up(HANG_UP if isinstance(self._target, str) else FINISH)
        if isinstance(self._target, Path) and not bindings.check_for_rrd_footer(self._target):
            raise RecordingError(f'{self._target}: the end of the rerun recording is lost: '
                                 'perhaps the disk is full')

    def _hang_up(self, longest: float) -> None:
        """
        Close the target, or give up after a time limit [s].

        Otherwise a lost viewer would block the caller for 10 s, and a file on a full disk would
        block it for ever, even at the exit of the process.
        """
        thread = threading.Thread(target=self.recording.disconnect, daemon=True)
        thread.start()
        thread.join(longest)
        if thread.is_alive():
            _waiting.append(thread)
            rr.unregister_shutdown()
        self._end_server()

    def _end_server(self) -> None:
        if self._server is not None:
            self._server.communicate()

    def _open(self) -> rr.RecordingStream:
        target = self._target
        try:
            if isinstance(target, Path):
                make_folder(target.parent)
                # Exclusive creation here ensures that an existing file is not overwritten.
                target.open('xb').close()
            elif isinstance(target, str):
                _check_viewer(target)
            else:
                _check_port(target)
                self._server = _serve(target)
            return _connect(self._application, target)
        except FileExistsError as problem:
            raise RecordingError(f'{target}: exists and is not overwritten; choose another '
                                 'rerun_path') from problem
        except (OSError, RuntimeError, ValueError, OverflowError) as problem:
            self._end_server()
            raise RecordingError(f'{target}: a rerun recording cannot be written there: '
                                 f'{problem}') from problem


def _number(part: rrb.Container | rrb.View, place: str) -> None:
    """Give a view a fixed id: the SDK never frees the paths of random ones."""
    part.id = uuid5(NAMESPACE_OID, place)
    if isinstance(part, rrb.Container):
        for number, child in enumerate(part.contents):
            _number(child, f'{place}/{number}')


def _connect(application: str, target: Target) -> rr.RecordingStream:
    # The SDK keeps each closed recording (two threads, half a megabyte) until a clean-up call
    # (rerun issue 2116), for example in rr.init; the clean-up waits for all of them.
    if not any(thread.is_alive() for thread in _waiting):
        bindings.flush_and_cleanup_orphaned_recordings()
    stream = rr.RecordingStream(application)
    if isinstance(target, Path):
        stream.save(target)
    else:
        stream.connect_grpc(
            target if isinstance(target, str) else f'rerun+http://{_ADDRESS}:{target}/proxy')
    return stream


def _serve(port: int) -> Popen[bytes]:
    """Start a server for viewers of this machine; return its process when it listens."""
    program = Path(rerun_cli.__file__).with_name('rerun')
    server = Popen(
        ['/bin/sh', '-c', _UNTIL_CLOSED, 'sh', program, '--serve-grpc', '--bind', _ADDRESS,
         '--port', str(port)], stdin=PIPE, stdout=DEVNULL, stderr=DEVNULL, start_new_session=True)
    until = time.monotonic() + START
    while True:
        try:
            socket.create_connection((_ADDRESS, port)).close()
            return server
        except OSError:
            if time.monotonic() > until:
                server.communicate()
                raise
            time.sleep(0.02)


def _check_viewer(url: str) -> None:
    """Check that a viewer listens: connecting to a missing one takes the SDK five seconds."""
    parts = urlsplit(url)
    if parts.scheme not in ('rerun', 'rerun+http', 'rerun+https') or not parts.hostname:
        raise RecordingError(f'{url}: is not the address of a rerun viewer, such as '
                             'rerun+http://127.0.0.1:9876/proxy')
    port = parts.port or {'rerun+http': 80}.get(parts.scheme, 443)
    try:
        socket.create_connection((parts.hostname, port), timeout=2.0).close()
    except OSError as problem:
        raise RecordingError(f'{url}: no rerun viewer listens there ({problem}); '
                             'start one with: rerun') from problem


def _check_port(port: int) -> None:
    """Check that a port is free by binding it: the SDK only logs that a port is taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(('', port))


def _reason(problem: OSError | RuntimeError) -> str:
    return getattr(problem, 'strerror', None) or str(problem)
