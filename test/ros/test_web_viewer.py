# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The served picture in rerun's web viewer, loaded by a real browser without a screen."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from urllib.parse import quote

from ports import free_port
from processes import simulator_words, wait_until
import pytest

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)
# No sandbox: it does not start for root. Drawing in software: there is no graphics card.
OPTIONS = ('--headless=new', '--no-sandbox', '--disable-dev-shm-usage', '--no-first-run',
           '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist',
           '--window-size=1000,700', '--remote-debugging-port=0')


class Relay:
    """Pass connections on to a port, and keep what comes back."""

    def __init__(self, port: int):
        self._target, self.received = port, bytearray()
        self._listener = socket.create_server(('127.0.0.1', 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            server = socket.create_connection(('127.0.0.1', self._target))
            for source, sink, keep in ((client, server, False), (server, client, True)):
                threading.Thread(
                    target=self._pass_on, args=(source, sink, keep), daemon=True).start()

    def _pass_on(self, source: socket.socket, sink: socket.socket, keep: bool) -> None:
        try:
            while data := source.recv(65536):
                if keep:
                    self.received += data
                sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)
        except OSError:
            pass

    def close(self) -> None:
        self._listener.close()


@contextmanager
def running(*command: object, **options: object) -> Iterator[subprocess.Popen]:
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL, **options)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(('127.0.0.1', port)) == 0


@pytest.mark.skipif(BROWSER is None, reason=f'needs a browser: one of {", ".join(BROWSERS)}')
@pytest.mark.timeout(240)
@pytest.mark.long
def test_web_viewer_in_a_browser_receives_the_recording(tmp_path):
    port, page = free_port(), free_port()
    simulator = 'from hnn_vi_ros.cli import simulator; simulator()'
    viewer = (f'import rerun, time; rerun.serve_web_viewer(web_port={page}, open_browser=False); '
              'time.sleep(600)')
    relay = Relay(port)
    words = simulator_words(scene='exact_pendulum', duration=0, rerun_sink='serve',
                            rerun_path=f"'{port}'")
    with running(sys.executable, '-c', simulator, *words), running(sys.executable, '-c', viewer):
        wait_until(lambda: listens(port) and listens(page), 60.0)
        assert not relay.received
        url = quote(f'rerun+http://127.0.0.1:{relay.port}/proxy', safe='')
        with running(BROWSER, *OPTIONS, f'--user-data-dir={tmp_path / "profile"}',
                     f'http://127.0.0.1:{page}/?url={url}',
                     env=os.environ | {'HOME': str(tmp_path)}):
            # The entities of state and energy, and the values of 60 samples at least.
            wait_until(lambda: b'/state/q' in relay.received and b'/energy/H' in relay.received,
                       120.0)
            size, deadline = -1, time.monotonic() + 30.0
            while size != len(relay.received) and time.monotonic() < deadline:
                size = len(relay.received)
                time.sleep(1.0)
    relay.close()
    assert size > 10_000
