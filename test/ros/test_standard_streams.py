# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever becomes of the standard streams and the working directory, the bag is complete."""

from pathlib import Path
import shutil
import signal
import subprocess
import sys

from peer import peer
from processes import finish, read_bag, start
import pytest

SAMPLES = 100


def simulate(folder: Path, redirection: str) -> subprocess.CompletedProcess:
    """Run a simulator by a shell that redirects its outputs; what is left of them is captured."""
    parameters = {
        'scene': 'exact_harmonic_oscillator', 'duration': SAMPLES / 100, 'real_time_factor': 0.0,
        'discovery_time': 0.0, 'record_path': 'bag', 'rerun_path': 'picture.rrd'}
    words = ' '.join(f'-p {name}:={value}' for name, value in parameters.items())
    code = 'from hnn_vi_ros.cli import simulator; simulator()'
    return subprocess.run(
        f'"{sys.executable}" -c "{code}" --ros-args {words} {redirection}', shell=True,
        executable='/bin/bash', cwd=folder, capture_output=True, text=True, timeout=120,
        check=False)


@pytest.mark.parametrize('redirection, reason', [
    ('>/dev/full', 'No space left on device'), ('<&- >&- 2>&-', ''), *(
        pytest.param(*case, marks=pytest.mark.long) for case in (
            ('>&-', 'Bad file descriptor'), ('> >(true)', 'Broken pipe'), ('2>&-', ''),
            ('2>/dev/full', '')))])
def test_bag_is_complete_and_one_line_tells_what_is_lost(tmp_path, redirection, reason):
    result = simulate(tmp_path, redirection)
    # The files are what the run is for, and they are all there.
    assert result.returncode == 0
    assert len(read_bag(tmp_path / 'bag')['/hnn_simulator/q']) == SAMPLES
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()
    lines = [line for line in result.stderr.splitlines() if 'standard output' in line]
    assert len(lines) == bool(reason) and all(reason in line for line in lines)
    assert 'Traceback' not in result.stdout + result.stderr
    # No file has taken the place of an output that was closed.
    mcap = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    assert mcap.startswith(b'\x89MCAP') and b'[INFO]' not in mcap


def test_bag_is_complete_when_the_working_directory_is_removed(tmp_path):
    folder = tmp_path / 'gone'
    folder.mkdir()
    process = start(folder, record_path=tmp_path / 'bag', rerun_path=tmp_path / 'picture.rrd')
    with peer() as other:
        other.spin_until(lambda: len(other.states) > 20)
        shutil.rmtree(folder)
        assert other.trigger('reset').success
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 20)
    process.send_signal(signal.SIGINT)
    status, out, _ = finish(process)
    assert status == 0
    for name in ('bag', 'bag-2'):
        assert len(read_bag(tmp_path / name)['/hnn_simulator/q']) > 15
        assert str(tmp_path / name) in out
