# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulators as processes, what they refuse, and what they leave behind."""

from contextlib import redirect_stderr
import io
from pathlib import Path
import signal
import sys
import time
import warnings

from executables import Executable
from hnn_vi_ros.cli import run_module
from hnn_vi_ros.commands import module_of
from hnn_vi_ros.files import ENDING
from hnn_vi_ros.recording import BagReader
from rosbags.highlevel import AnyReader

# By the present test; see conftest.py.
started: list[Executable] = []
refusals: list[str] = []


def start(folder: Path, **parameters: object) -> Executable:
    """Start a simulator in a folder; it writes only those files whose paths are given."""
    return start_executable('simulator', *simulator_words(**parameters), folder=folder)


def simulator_words(**parameters: object) -> list[str]:
    """Return the arguments of a simulator with these parameters."""
    values = {'scene': 'exact_harmonic_oscillator', 'discovery_time': 0,
              'record': 'record_path' in parameters,
              'rerun_sink': 'file' if 'rerun_path' in parameters else 'none'} | parameters
    # Names like __ns are ROS's own.
    return ['--ros-args', *(word for name, value in values.items() for word in (
        '-r' if name.startswith('__') else '-p', f'{name}:={value}'))]


def start_executable(name: str, *words: object, folder: Path | None = None) -> Executable:
    """Start one of the package's executables."""
    started.append(process := Executable(name, [*map(str, words)], folder))
    return process


def finish(process: Executable, timeout: float = 300.0) -> tuple[int, str, str]:
    """Wait for the end; return status, standard output and standard error."""
    status = process.wait(timeout)
    out, error = (Path(file.name).read_text() for file in process.outputs)
    assert 'Traceback' not in error, error
    return status, out, error


def standard_error(process: Executable) -> str:
    """Return what a process has written to standard error."""
    return Path(process.outputs[1].name).read_text()


def refusal(name: str, *words: object) -> str:
    """Return the line by which an executable, run in this process, refuses its arguments."""
    argv, error = [*map(str, words)], io.StringIO()
    handlers = {number: signal.getsignal(number) for number in ENDING}
    interval = sys.getswitchinterval()
    try:
        with warnings.catch_warnings(), redirect_stderr(error):
            status = run_module(module_of(name), argv, f'hnn {name}')
    except SystemExit as end:
        # From argparse.
        assert end.code == 2
        status = error.getvalue().removesuffix('\n')
    finally:
        sys.setswitchinterval(interval)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert isinstance(status, str) and '\n' not in status, status
    refusals.append(status)
    return status


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
