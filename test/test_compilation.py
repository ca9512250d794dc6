# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: found again by a later process, and never for functions from elsewhere."""

import os
import subprocess
import sys

from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels.compilation import compiled_loop
from hnn_vi_ros.kernels.marks import is_own
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.loops import advance
import numba
import pytest

RUN = """
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
simulation = Simulation(HAMILTONIANS['tao'](), INTEGRATORS['explicit_euler'](), 0.1, [1.0], [0.5])
simulation.advance(10)
stats = simulation._loops[0][0].stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), simulation.q[0].hex())
"""


def run(cache, system: str = 'tao') -> list[str]:
    """Run a simulation in a new process; return cache hits, misses and the result."""
    return subprocess.run(
        [sys.executable, '-c', RUN.replace('tao', system)],
        env=os.environ | {'NUMBA_CACHE_DIR': str(cache)},
        capture_output=True, text=True, timeout=120, check=True).stdout.split()


def test_kernel_compiled_by_one_process_is_found_by_the_next(tmp_path):
    first, second = run(tmp_path), run(tmp_path)
    assert first[:2] == ['0', '1']
    assert second[:2] == ['1', '0']
    assert first[2] == second[2]


def test_each_kernel_has_an_index_of_its_own(tmp_path):
    run(tmp_path)
    run(tmp_path, 'pendulum')
    assert len([*tmp_path.rglob('loops.advance_*.nbi')]) == 2


def test_kernel_of_a_function_from_elsewhere_is_not_kept():
    @numba.njit
    def energy(parameters, q, p):
        return 0.0

    kernel = HAMILTONIANS['tao']().kernel
    assert compiled_loop(advance, kernel, 'any').stats.cache_path
    assert not compiled_loop(advance, kernel._replace(energy=energy), 'any').stats.cache_path


def test_second_simulation_of_the_same_kind_compiles_nothing():
    def simulate() -> Simulation:
        simulation = Simulation(
            HAMILTONIANS['tao'](), INTEGRATORS['explicit_euler'](), 0.1, [1.0], [0.5])
        simulation.advance(1)
        return simulation

    first = simulate()._loops[0][0]
    assert simulate()._loops[0][0] is first and len(first.overloads) == 1


@pytest.mark.parametrize('method', INTEGRATORS.values(), ids=INTEGRATORS)
def test_kernels_of_every_method_are_kept(method):
    assert is_own(method.__module__)
