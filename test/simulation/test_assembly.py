# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects around steps by address: their results, and what is compiled for them."""

from concurrent.futures import ThreadPoolExecutor
import copy
import gc
import os
from pathlib import Path
import pickle
import shutil
import subprocess
import sys

from effect_table import create_effect
from hnn_vi_ros.effects.base import StepEffect
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS, step_addresses
from hnn_vi_ros.kernels import NotKept
from hnn_vi_ros.simulation import assembly, Simulation
from hnn_vi_ros.simulation.assembly import advance
from numba.core.dispatcher import Dispatcher
import numpy as np
import pytest

DAMPING = ('damping', {'rate': 0.4})
DRIVE = ('periodic_drive', {'coordinate': 'angle', 'amplitude': 3.0, 'frequency': 0.8})
BATH = ('thermostat', {'temperature': 0.5, 'rate': 2.0, 'seed': 1})
WALL = ('impact', {'coordinate': 'angle', 'position': 0.3, 'restitution': 0.7})
SYSTEMS = {
    'a keeping step': ('stormer_verlet', 'pendulum', (), [1.0], [0.0], [DAMPING, DRIVE]),
    'halves': ('stormer_verlet', 'pendulum', (), [1.0], [0.0], [BATH, WALL]),
    'an equation': ('implicit_midpoint', 'pendulum', (), [1.0], [0.0], [DAMPING]),
    'many together': ('stormer_verlet', 'pendulum', (), [[1.0], [0.5], [2.0]],
                      [[0.0], [0.2], [0.1]], [DAMPING]),
    'a rod': ('stormer_verlet', 'free_particle', (1.0, ('x', 'z')), [0.6, 0.8], [0.8, -0.6], [
        ('holonomic_constraint', {'point': ['x', 'z'], 'anchor': [0.0, 0.0]}),
        ('damping', {'rate': [0.5, 1.0]})]),
}


def simulation(name: str, folder: Path) -> Simulation:
    method, system, arguments, q, p, effects = SYSTEMS[name]
    return Simulation(HAMILTONIANS[system](*arguments), INTEGRATORS[method](), 0.05, q, p,
                      [create_effect(kind, parameters, folder) for kind, parameters in effects])


@pytest.mark.parametrize('name', SYSTEMS)
def test_steps_by_address_are_those_of_plain_python(name, tmp_path):
    ways = [simulation(name, tmp_path) for _ in range(2)]
    ways[1]._loops[0]._compiled = False
    for way in ways:
        # Back and forth: what is forgotten or put back is in the arrays that steps work on.
        way.advance(3)
        state = way.snapshot()
        way.advance(2)
        way.restore(state)
        way.advance(40)
    here, plain = ways
    assert isinstance(here._loops[0].function, Dispatcher)
    assert plain._loops[0].function is advance
    assert np.abs(here.p).max() > 0.0
    assert here.gradients == plain.gradients
    for part in ('q', 'p', 'dH_dq', 'dH_dp', 'work'):
        np.testing.assert_allclose(getattr(here, part), getattr(plain, part), 1e-13, 1e-14)


RUN = """
import sys
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
from numba.core.event import install_recorder

ALL = {'damping': {'rate': 0.4},
       'periodic_drive': {'coordinate': 'angle', 'amplitude': 3.0, 'frequency': 0.8},
       'thermostat': {'temperature': 0.5, 'rate': 2.0, 'seed': 1}}
for kinds in sys.argv[1:]:
    with install_recorder('numba:compile') as recorder:
        simulation = Simulation(
            HAMILTONIANS['pendulum'](), INTEGRATORS['stormer_verlet'](), 0.05, [1.0], [0.0],
            [EFFECTS[kind](**ALL[kind]) for kind in kinds.split(',')])
        simulation.advance(10)
    names = [event.data['dispatcher'].py_func.__name__ for _, event in recorder.buffer
             if event.is_end]
    print(names.count('_step_entry'), names.count('advance'), simulation.q[0].hex())
"""


@pytest.mark.long
def test_part_is_compiled_once_whatever_is_combined_with_it_until_its_source_changes(tmp_path):
    shutil.copytree(Path(__file__).parents[2] / 'hnn_vi_ros', tmp_path / 'hnn_vi_ros',
                    ignore=shutil.ignore_patterns('__pycache__'))
    cache = tmp_path / 'cache'

    def run(*kinds: str) -> list[list[str]]:
        """Run simulations in a new process; return steps and loops compiled, and q, of each."""
        lines = subprocess.run(
            [sys.executable, '-c', RUN, *kinds], cwd=tmp_path, capture_output=True, text=True,
            env=os.environ | {'PYTHONPATH': str(tmp_path), 'NUMBA_CACHE_DIR': str(cache)},
            timeout=300, check=True).stdout.splitlines()
        return [line.split() for line in lines]

    first, forced, bathed = run('damping', 'damping,periodic_drive', 'thermostat,damping')
    # The method's step and the damping's; then nothing; then the two halves, and the bath.
    assert [line[:2] for line in (first, forced, bathed)] == [
        ['2', '1'], ['0', '0'], ['3', '0']]
    assert len({line[2] for line in (first, forced, bathed)}) == 3
    # Other processes find all of it, whatever was compiled first.
    assert run('thermostat,damping', 'damping') == [['0', '0', bathed[2]], ['0', '0', first[2]]]
    assert len([*cache.rglob('assembly.advance_*.nbi')]) == 1
    for changed in ('integrators/stormer_verlet.py', 'effects/damping.py'):
        with (tmp_path / 'hnn_vi_ros' / changed).open('a') as stream:
            stream.write('# changed\n')
        assert run('damping') == [['1', '0', first[2]]], changed


def test_threads_compile_each_part_once_and_end_alike(tmp_path):
    def end(_: int) -> tuple[float, float]:
        here = simulation('halves', tmp_path)
        here.advance(20)
        return here.q[0], here.p[0]

    step_addresses._entry.cache_clear()
    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(end, range(8)))) == 1
    # The two halves, the bath, and the wall.
    assert step_addresses._entry.cache_info().misses == 4


def test_simulation_keeps_what_its_addresses_lead_to(tmp_path):
    ends = []
    for alone in (False, True):
        here = simulation('a keeping step', tmp_path)
        if alone:
            step_addresses._entry.cache_clear()
            gc.collect()
            _ = [np.full(n, np.nan) for n in range(1, 400)]
        here.advance(20)
        ends.append((here.q[0], here.p[0], here.works))
    assert ends[0] == ends[1]


@pytest.mark.parametrize('duplicate', [copy.copy, copy.deepcopy, pickle.dumps])
def test_simulation_refuses_to_be_copied(duplicate, tmp_path):
    with pytest.raises(TypeError, match=r'cannot be copied.*snapshot'):
        duplicate(simulation('a keeping step', tmp_path))


class Inverse(StepEffect):
    """What divides by the coordinate after each step."""

    def resolve(self, coordinates, state):
        """Return nothing."""
        return ()

    @staticmethod
    def wrap(step, keeps_gradient):
        """Return the step and a division."""
        def divided(kernel, h, options, z, z1, memory):
            outcome, residual, gradients = step(kernel, h, options[0], z, z1, memory[:-1])
            z1.p[0] += 0.0 * (1.0 / z1.q[0])
            return outcome, residual, gradients
        return divided


def test_error_in_an_effect_by_address_reaches_python():
    simulation = Simulation(HAMILTONIANS['free_particle'](), INTEGRATORS['stormer_verlet'](), 0.5,
                            [0.0], [0.0], [Inverse()], 'stop')
    with pytest.raises(ZeroDivisionError):
        simulation.advance(1)


def test_loop_whose_compilation_was_refused_is_compiled_when_asked_again(tmp_path, monkeypatch):
    run = simulation('an equation', tmp_path)
    run.compile()

    def refuse(*arguments):
        raise NotKept
    with monkeypatch.context() as change:
        change.setattr(assembly, 'entry_point', refuse)
        with pytest.raises(NotKept):
            run.compile_rescue()
    run.compile_rescue()
