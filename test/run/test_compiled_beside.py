# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A second process that compiles the loop of a scene."""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import pickle
from subprocess import PIPE, Popen
import sys
import time

from hnn_vi_ros.run import compilation as beside, compile_in_background
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import assembly, build, compile_loop
import pytest

TELL = """
import os, pathlib, pickle, sys
scene = pickle.load(sys.stdin.buffer)
pathlib.Path({place!r}).write_text(f'{{os.getpid()}} {{scene.source}}\\n')
sys.stdin.buffer.read()
"""


def wait_for(place: Path) -> None:
    """Wait until there is a line in a file."""
    end = time.monotonic() + 60.0
    while not (place.exists() and place.stat().st_size):
        assert time.monotonic() < end
        time.sleep(0.02)


def test_process_gets_the_scene_and_ends_with_the_context(tmp_path, monkeypatch):
    place, scene = tmp_path / 'place', load_scene('exact_pendulum')
    monkeypatch.setattr(beside, '_is_kept', lambda parts: False)
    monkeypatch.setattr(beside, 'usable_processors', lambda: 2)
    monkeypatch.setattr(beside, '_CODE', TELL.format(place=str(place)))
    with pytest.raises(KeyboardInterrupt), compile_in_background(scene.parts()):
        wait_for(place)
        raise KeyboardInterrupt
    process, source = place.read_text().split()
    assert source == str(scene.source)
    with pytest.raises(ProcessLookupError):
        os.kill(int(process), 0)


def test_no_process_begins_for_a_loop_that_is_compiled(monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError
    parts = load_scene('exact_pendulum').parts()
    monkeypatch.setattr(beside, 'Popen', refuse)

    def start() -> None:
        compile_loop(parts)
        with compile_in_background(parts):
            pass
    with ThreadPoolExecutor(1) as pool:
        pool.submit(start).result()


def test_loop_that_is_compiled_alone_is_that_of_the_simulation(monkeypatch):
    loops, compile_entry = [], assembly.entry_point
    monkeypatch.setattr(assembly, 'entry_point', lambda loop, *arguments: (
        loops.append(loop), compile_entry(loop, *arguments))[1])
    parts = load_scene('damped_driven_pendulum').parts()
    compile_loop(parts)
    # Those of other scenes of this process are there as well.
    known = len(loops[0].overloads)
    build(parts).compile()
    assert loops[1] is loops[0] and len(loops[0].overloads) == known


@pytest.mark.long
def test_process_compiles_the_loop_and_nothing_of_the_hamiltonian(tmp_path):
    environment = os.environ | {'NUMBA_CACHE_DIR': str(tmp_path)}
    with Popen([sys.executable, '-c', beside._CODE], stdin=PIPE, env=environment) as process:
        pickle.dump(load_scene('exact_pendulum'), process.stdin)
        process.stdin.flush()
        assert process.wait(300.0) == 0
    names = {file.name.partition('_')[0] for file in tmp_path.rglob('*.nbc')}
    assert names == {'assembly.advance'}
