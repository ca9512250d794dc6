# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulators as processes, and what they leave behind."""

from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import TextIO

from hnn_vi_ros.bags.mcap_reader import BagReader
from rosbags.highlevel import AnyReader

# By the present test, with their standard output and error; see conftest.py.
started: dict[subprocess.Popen, tuple[TextIO, TextIO]] = {}


def start(folder: Path, **parameters: object) -> subprocess.Popen:
    """Start a simulator in a folder."""
    values = {'scene': 'oscillator.yaml', 'discovery_time': 0} | parameters
    # Names like __ns are ROS's own.
    arguments = [word for name, value in values.items() for word in (
        '-r' if name.startswith('__') else '-p', f'{name}:={value}')]
    return start_executable('simulator', '--ros-args', *arguments, folder=folder)


def to_file(path: Path) -> list[str]:
    """Return the arguments by which rerun_bridge writes a file."""
    return ['--ros-args', '-p', 'rerun_sink:=file', '-p', f'rerun_path:={path}']


def start_executable(name: str, *words: object, folder: Path | None = None) -> subprocess.Popen:
    """Start one of the package's executables."""
    # What started the tests may have made them deaf to a closed terminal, as nohup does.
    code = ('import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL); '
            f'from hnn_vi_ros.cli import {name}; {name}()')
    # Files, not pipes: a pipe that nobody empties stops who writes to it.
    outputs = [tempfile.TemporaryFile('w+') for _ in range(2)]  # noqa: SIM115  see finish
    process = subprocess.Popen([sys.executable, '-c', code, *map(str, words)], cwd=folder,
                               stdout=outputs[0], stderr=outputs[1])
    started[process] = outputs
    return process


def finish(process: subprocess.Popen, timeout: float = 60.0) -> tuple[int, str, str]:
    """Wait for the end; return status, standard output and standard error."""
    process.wait(timeout)
    outputs = started[process]
    for file in outputs:
        file.seek(0)
    out, error = (file.read() for file in outputs)
    assert 'Traceback' not in error, error
    return process.returncode, out, error


def standard_error(process: subprocess.Popen) -> str:
    """Return what a process that runs has written to standard error."""
    return Path(f'/proc/{process.pid}/fd/2').read_text()


def wait_until(condition, timeout: float = 120.0) -> None:
    """Wait until the condition holds."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, 'timed out'
        time.sleep(0.02)


def recorded_until(bag: Path) -> int:
    """Return the newest log time in a bag that is being recorded [ns]; 0 before its samples."""
    return BagReader(bag).last if bag.exists() and bag.stat().st_size else 0


def read_bag(bag: Path) -> dict[str, list[tuple[int, object]]]:
    """Return (log time, message) of each topic, by the independent reader."""
    with AnyReader([bag]) as reader:
        topics = {connection.topic: [] for connection in reader.connections}
        for connection, stamp, raw in reader.messages():
            topics[connection.topic].append(
                (stamp, reader.deserialize(raw, connection.msgtype)))
    return topics
