# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of days, which Ctrl-C ends, and stretches of steps, which change nothing."""

from contextlib import suppress
import gc
import json
import signal
import subprocess
import sys
from threading import Event, main_thread, Thread, Timer
import time

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import (
    build, simulate, simulate_many, Simulation, simulation as stepping, watched)
from hnn_vi_ros.simulation.assembly import Loop
from hnn_vi_ros.simulation.processors import in_threads
from numba.core.registry import CPUDispatcher
import numpy as np
import pytest
from scene_files import scene_text

SCENE = scene_text(integrator='variational_euler', step_size=0.001)
# A step takes a microsecond: as many as take some years [s].
DURATION = 1e11
STATES = [[1.0]] * 64, [[0.0]] * 64


@pytest.fixture
def scene(tmp_path):
    """Return the scene of an exact oscillator."""
    path = tmp_path / 'oscillator.yaml'
    path.write_text(SCENE)
    return path


@pytest.fixture
def ctrl_c(monkeypatch):
    """Have SIGINT sent while compiled code takes steps, once."""
    sent, call = [], Loop.__call__

    def run(loop, *arguments):
        if not sent and loop._entry is not None:
            sent.append(Timer(0.1, signal.pthread_kill, (main_thread().ident, signal.SIGINT)))
            sent[0].start()
        return call(loop, *arguments)
    monkeypatch.setattr(Loop, '__call__', run)
    # Python loses what is raised in a callback of its garbage collector, such as that of
    # hypothesis, and a large process collects for as long as the signal takes.
    gc.disable()
    yield
    gc.enable()
    assert sent, 'no steps were taken'
    sent[0].join()


@pytest.mark.parametrize('run', [
    lambda scene: simulate(scene, DURATION, every=10**10),
    lambda scene: simulate(scene, DURATION, every=10**10, effects=[
        {'kind': 'periodic_drive', 'coordinate': 'x', 'amplitude': 0.1, 'frequency': 1.0}]),
    lambda scene: simulate(scene, DURATION, times=[0.1, DURATION]),
    lambda scene: simulate_many(scene, *STATES, DURATION, threads=1),
    lambda scene: simulate_many(scene, *STATES, DURATION, threads=2),
    lambda scene: (one := build(load_scene(scene))).probe.trial(one.row, 1e-3, every=10**14),
], ids=['samples', 'work', 'times', 'block', 'threads', 'trial'])
def test_ctrl_c_ends_a_run_of_years(run, scene, ctrl_c):
    with pytest.raises(KeyboardInterrupt):
        run(scene)


@pytest.fixture
def compiler(monkeypatch):
    """Have SIGINT sent while numba compiles, by the thread that does or another one."""
    began, go_on, compile_ = Event(), Event(), CPUDispatcher.compile

    def compile_slowly(dispatcher, signature):
        began.set()
        # As the callbacks of LLVM have it, which are the first to handle a signal.
        with suppress(KeyboardInterrupt):
            go_on.wait()
        return compile_(dispatcher, signature)

    def send():
        began.wait()
        signal.pthread_kill(main_thread().ident, signal.SIGINT)
    monkeypatch.setattr(CPUDispatcher, 'compile', compile_slowly)
    Thread(target=send).start()
    yield
    go_on.set()


def test_ctrl_c_while_a_function_is_compiled_is_not_lost(compiler):
    function = kept(own=False)(lambda x: 2 * x)
    with pytest.raises(KeyboardInterrupt):
        function(3)


def test_ctrl_c_while_threads_compile_ends_those_who_wait(compiler):
    function = kept(own=False)(lambda x: 2 * x)
    with pytest.raises(KeyboardInterrupt):
        in_threads(function, 2)


RUN = """
import os, signal, sys
from hnn_vi_ros.cli import main
from hnn_vi_ros.simulation import simulation as stepping

def press_ctrl_c():
    stepping.check_interrupt = lambda: None
    os.kill(os.getpid(), signal.SIGINT)

stepping.check_interrupt = press_ctrl_c
sys.argv = ['hnn', 'run', *sys.argv[1:]]
main()
"""


def test_command_that_is_stopped_says_so_in_a_line_and_by_its_status(scene):
    result = subprocess.run([sys.executable, '-c', RUN, str(scene), '--duration', '1e11',
                             '--every', '10000000000'], capture_output=True, text=True,
                            check=False)
    assert result.returncode == 128 + signal.SIGINT
    assert result.stdout == '' and result.stderr.count('\n') == 1
    assert result.stderr.startswith('hnn run: stopped: ')


def test_ctrl_c_ends_a_sweep_of_years(scene, tmp_path):
    definition, out = tmp_path / 'sweep.yaml', tmp_path / 'out'
    definition.write_text(json.dumps({
        'scene': str(scene), 'duration': DURATION, 'shard_size': 1,
        'vary': [{'kind': 'values', 'key': 'initial_state.q.0', 'values': [1.0, 2.0]}]}))
    code = 'from hnn_vi_ros.cli import sweep; sweep()'
    with subprocess.Popen([sys.executable, '-c', code, str(definition), '--out', str(out),
                           '--jobs', '1'], stderr=subprocess.PIPE, text=True) as run:
        while not (out / 'sweep.json').exists() and run.poll() is None:
            time.sleep(0.02)
        # It may still be compiling: it ends as well.
        time.sleep(5.0)
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate()
    assert run.returncode == 128 + signal.SIGINT
    assert errors.splitlines()[-1].startswith('hnn sweep: stopped; complete shards')


def wall(on_failure: str) -> Simulation:
    """Return a mass on a spring that meets a stiff wall, where h omega is 2.25."""
    return Simulation(
        HAMILTONIANS['free_particle'](names=['x']), INTEGRATORS['stormer_verlet'](), 0.045, [3.0],
        [-20.0], [EFFECTS['soft_wall']('x', 0.0, 'above', 2500.0, 0.5),
                  EFFECTS['spring'](['x'], anchor=[3.0], stiffness=4.0)], on_failure)


MADE = {
    'chain of solvers': lambda: Simulation(
        HAMILTONIANS['tao'](), INTEGRATORS['variational_euler'](max_iterations=3), 0.05,
        [0.0], [-3.0]),
    'sub-steps': lambda: Simulation(
        HAMILTONIANS['tao'](), INTEGRATORS['generalized_leapfrog'](), 0.8, [0.0], [-1.5]),
    'two methods': lambda: wall('implicit'),
    'noise': lambda: Simulation(
        HAMILTONIANS['pendulum'](), INTEGRATORS['stormer_verlet'](), 0.01, [1.0], [0.0],
        [EFFECTS['thermostat'](0.1, 1.0), EFFECTS['impact']('angle', 0.5)]),
    'block': lambda: Simulation(
        HAMILTONIANS['pendulum'](), INTEGRATORS['gauss4'](), 0.01, [[1.0], [2.0]], [[0.0], [0.0]])}


@pytest.mark.parametrize('kind', MADE)
def test_stretches_change_no_bit(kind, monkeypatch):
    monkeypatch.setattr(stepping, '_CALL_TIME', 0.0)
    pieces, whole = MADE[kind](), MADE[kind]()
    whole._most = 10**9
    assert np.array_equal(pieces.record(100, 3), whole.record(100, 3))
    assert pieces._most == 1
    for name in ('steps', 'gradients', 'rescued', 'several_solutions', 'costliest', 'residual',
                 'works'):
        assert getattr(pieces, name) == getattr(whole, name), name
    before, after = whole.snapshot(), pieces.snapshot()
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert bool(whole.rescued) == (kind in ('sub-steps', 'two methods'))


@pytest.mark.parametrize('events', ['', 'events: [{when: x = 0}]\n'], ids=['plain', 'watched'])
def test_steps_end_when_it_is_time_and_go_on_from_there(events, scene, monkeypatch):
    monkeypatch.setattr(stepping, '_CALL_TIME', 0.0)
    scene.write_text(SCENE + events)
    whole, pieces = (watched(build(load_scene(scene)), load_scene(scene)) for _ in range(2))
    whole.advance(100)
    assert [pieces.advance(100 - taken, time.perf_counter()) for taken in range(100)] == [1] * 100
    assert (pieces.steps, pieces.q, pieces.p) == (100, whole.q, whole.p)
