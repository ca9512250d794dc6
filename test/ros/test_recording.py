# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A recording that cannot go on ends with an ERROR diagnostic; the simulation goes on."""

from collections.abc import Callable
from pathlib import Path
import resource
import shutil
import signal
import subprocess

from diagnostic_msgs.msg import DiagnosticArray
from peer import peer
from processes import finish, start
import pytest

SCENE = """\
hamiltonian: {kind: harmonic_oscillator}
integrator: {kind: variational_euler}
step_size: 0.01
initial_state: {q: [1.0], p: [0.0]}
"""


def fill_disk(process: subprocess.Popen, bag: Path) -> None:
    # No file of the process may grow beyond what the bag is now.
    size = (bag / 'bag_0.mcap').stat().st_size
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, size))


def remove_folder(process: subprocess.Popen, bag: Path) -> None:
    shutil.rmtree(bag)


@pytest.mark.parametrize('spoil, reason', [
    (fill_disk, 'File too large'), (remove_folder, 'No such file or directory')])
def test_recording_that_fails_is_an_error_diagnostic_while_the_simulation_goes_on(
        tmp_path: Path, spoil: Callable[[subprocess.Popen, Path], None], reason: str):
    (tmp_path / 'oscillator.yaml').write_text(SCENE)
    process = start(tmp_path, record_path='bag', rerun_sink='none')
    told: list[str] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        told.extend(status.message for status in message.status
                    if status.name == 'hnn_simulator: recorder' and status.level == b'\x02')

    with peer() as other:
        other.node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
        other.spin_until(lambda: len(other.states) > 150)
        assert told == []
        spoil(process, tmp_path / 'bag')
        other.spin_until(lambda: told)
        assert reason in told[0]
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 100)
        process.send_signal(signal.SIGINT)
        status, _, error = finish(process)
    # The process ends with the status of an incomplete recording, and says why once.
    assert status == 1
    assert error.count('the simulation goes on') == 1 and reason in error


def test_recording_into_a_folder_that_cannot_be_made_is_refused_and_the_simulation_goes_on(
        tmp_path: Path):
    (tmp_path / 'oscillator.yaml').write_text(SCENE)
    (tmp_path / 'file').write_text('')
    process = start(tmp_path, record='false', record_path='file/bag', rerun_sink='none')
    with peer() as other:
        other.spin_until(lambda: other.states)
        answer = other.trigger('start_recording')
        assert not answer.success and 'file' in answer.message, answer.message
        assert '\n' not in answer.message
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 50)
        process.send_signal(signal.SIGINT)
        assert finish(process)[0] == 0
