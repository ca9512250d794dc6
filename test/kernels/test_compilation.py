# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: found again by a later process, and never for functions from elsewhere."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import os
from pathlib import Path
import shutil
import subprocess
import sys
from threading import Barrier, BrokenBarrierError

from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import (
    by_address, compilation, compiled_loop, is_own, name_stably, provide, reached)
from hnn_vi_ros.kernels.addresses import fill_energies
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.assembly import advance
import numba
import numpy as np
import pytest

RUN = """
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
simulation = Simulation(HAMILTONIANS['tao'](), INTEGRATORS['explicit_euler'](), 0.1, [1.0], [0.5])
simulation.advance(10)
stats = simulation._loops[0].function.stats
import sys
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), simulation.q[0].hex(),
      'numba.np.arraymath' in sys.modules)
"""


def run(cache, system: str = 'tao') -> list[str]:
    """Simulate in a new process; return cache hits, misses, q, and whether it has a compiler."""
    return subprocess.run(
        [sys.executable, '-c', RUN.replace('tao', system)],
        env=os.environ | {'NUMBA_CACHE_DIR': str(cache)},
        capture_output=True, text=True, timeout=120, check=True).stdout.split()


def test_next_process_finds_the_loop_of_every_system_without_the_compiler(tmp_path):
    first, second = run(tmp_path), run(tmp_path)
    assert first[:2] == ['0', '1']
    assert second[:2] == ['1', '0']
    assert first[2] == second[2]
    # Numba's compiler takes longer to set up than all of the simulation.
    assert (first[3], second[3]) == ('True', 'False')
    assert run(tmp_path, 'pendulum')[:2] == ['1', '0']
    assert len([*tmp_path.rglob('assembly.advance_*.nbi')]) == 1


@pytest.mark.parametrize('name', ['pendulum', 'henon_heiles'])
def test_kernel_by_address_gives_the_same_numbers(name):
    kernel = HAMILTONIANS[name]().kernel
    called, d = by_address(kernel), kernel.dimension
    q, p, v_q, v_p = np.random.default_rng(0).normal(size=(4, d))
    assert called.energy(called.parameters, q, p) == kernel.energy(kernel.parameters, q, p)
    results = [np.zeros((4, d)), np.zeros((4, d))]
    for own, result in zip((kernel, called), results, strict=True):
        own.gradient(own.parameters, q, p, result[0], result[1])
        own.hessian_vector(own.parameters, q, p, v_q, v_p, result[2], result[3])
    np.testing.assert_array_equal(*results)
    assert np.abs(results[0]).max() > 0.0


def test_function_that_was_not_asked_for_is_compiled_when_it_is_called():
    kernel = by_address(HAMILTONIANS['pendulum']().kernel)
    q = np.array([0.5])

    @numba.njit
    def call(kernel, q):
        return kernel.energy(kernel.parameters, q, q)

    addresses = kernel.parameters.words[:3].copy()
    value = call(kernel, q)
    assert value == kernel.energy(kernel.parameters, q, q)
    assert [*(kernel.parameters.words[:3] != addresses)] == [True, False, False]


@pytest.mark.parametrize('number', [np.float32(1.5), 3, True], ids=lambda one: type(one).__name__)
def test_energy_by_address_is_a_float64_whatever_the_function_returns(number):
    @numba.njit
    def energy(parameters, q, p):
        return number

    kernel = by_address(HAMILTONIANS['tao']().kernel._replace(energy=energy))
    energies = np.empty(2)
    fill_energies(kernel.parameters, np.zeros(2), np.zeros(2), energies)
    assert energies.tolist() == [number, number]


def test_error_in_a_function_by_address_is_raised():
    @numba.njit
    def energy(parameters, q, p):
        if q.size:
            raise ValueError('no energy there')
        return 0.0

    kernel = by_address(HAMILTONIANS['tao']().kernel._replace(energy=energy))

    @numba.njit
    def call(kernel, q):
        return kernel.energy(kernel.parameters, q, q)

    provide(kernel, 0)
    with pytest.raises(ValueError, match='no energy there'):
        call(kernel, np.zeros(1))


def test_parameters_that_are_no_words_are_refused():
    kernel = HAMILTONIANS['tao']().kernel
    with pytest.raises(TypeError, match='str in the parameters'):
        by_address(kernel._replace(parameters=('text',)))
    with pytest.raises(TypeError, match='adjacent bools'):
        provide(by_address(kernel._replace(parameters=(True, True))), 0)


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

    first = simulate()._loops[0].function
    assert simulate()._loops[0].function is first and len(first.overloads) == 1


@pytest.mark.parametrize('method', INTEGRATORS.values(), ids=INTEGRATORS)
def test_kernels_of_every_method_are_kept(method):
    assert is_own(method.__module__)


INNER = """
from hnn_vi_ros.kernels.linking import part
_part = part()

@_part
def inner(x: float) -> float:
    return x + FACTOR * x
"""
OUTER = """
from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.models.networks import inner

@kept()
def outer(x: float) -> float:
    return inner.inner(x)
"""


@pytest.fixture
def package(tmp_path):
    """Return a copy of the package, as a folder to import it from."""
    shutil.copytree(Path(__file__).parents[2] / 'hnn_vi_ros', tmp_path / 'hnn_vi_ros',
                    ignore=shutil.ignore_patterns('__pycache__'))
    return tmp_path


def answer(package: Path, code: str) -> str:
    """Run code with a package of one's own in a new process; return what it prints."""
    return subprocess.run(
        [sys.executable, '-c', code], cwd=package, capture_output=True, text=True, timeout=120,
        env=os.environ | {'PYTHONPATH': str(package), 'NUMBA_CACHE_DIR': str(package / 'cache')},
        check=True).stdout.strip()


def test_function_is_compiled_anew_when_one_that_it_calls_changes(package):
    rooms = package / 'hnn_vi_ros'
    (rooms / 'models/outer.py').write_text(OUTER)
    code = ('from hnn_vi_ros.models.outer import outer; '
            'print(outer(1.0), sum(outer.stats.cache_hits.values()))')
    answers = []
    for second, factor in enumerate(('1.0', '1.0', '2.0')):
        inner = rooms / 'models/networks/inner.py'
        inner.write_text(INNER.replace('FACTOR', factor))
        # Python takes a file of the same size and second for the one whose bytecode it keeps.
        os.utime(inner, (second, second))
        answers.append(answer(package, code))
    assert answers == ['2.0 0', '2.0 1', '3.0 0']


def test_key_of_a_function_changes_with_what_it_comes_from_and_nothing_else(package):
    code = ('from hnn_vi_ros.kernels.sources import digest_of; '
            'print(*(digest_of(frozenset([f"hnn_vi_ros.{name}"])) for name in ('
            '"models.lagrangian", "hamiltonians.tao", "integrators.runge_kutta")))')
    before = answer(package, code).split()
    for changed, file in (((True, False, False), 'models/networks/perceptron_memory.py'),
                          ((False, False, False), 'effects/gravity.py'),
                          ((True, True, True), 'kernels/kernel.py')):
        with (package / 'hnn_vi_ros' / file).open('a') as stream:
            stream.write('# changed\n')
        after = answer(package, code).split()
        assert tuple(a != b for a, b in zip(before, after, strict=True)) == changed
        before = after


def test_functions_are_found_behind_closures_tuples_and_names():
    method = INTEGRATORS['variational_euler']()
    names = {function.__name__ for function in reached(method.step, method.options(0, 2))}
    assert {'extrapolate', '_residual', 'may_be_disconnected'} <= names


def test_function_is_named_once_where_two_threads_ask_at_the_same_time(monkeypatch):
    """The first one waits in the middle of it, until the second one has come as far or waits."""
    together = Barrier(2)

    def digest(*values: object) -> str:
        with suppress(BrokenBarrierError):
            together.wait(0.5)
        return 'digest'

    monkeypatch.setattr(compilation, '_digest', digest)
    dispatcher = numba.njit(lambda x: x)
    with ThreadPoolExecutor(2) as pool:
        names = list(pool.map(name_stably, [dispatcher, dispatcher]))
    assert names[0] == names[1]
    assert names[0].endswith('-digest')


def test_functions_by_address_take_arrays_that_are_read_only_and_none_that_have_gaps():
    pendulum = HAMILTONIANS['pendulum']()
    q, p = np.array([0.3]), np.array([0.7])
    expected = [part.tolist() for part in pendulum.gradient(q, p)]
    q.flags.writeable = p.flags.writeable = False
    assert [part.tolist() for part in pendulum.gradient(q, p)] == expected
    assert [part.shape for part in pendulum.gradient(*np.empty((2, 0, 1)))] == [(0, 1)] * 2
    kernel = by_address(pendulum.kernel)
    with pytest.raises(ValueError, match='contiguous'):
        kernel.gradient(kernel.parameters, *np.zeros((4, 6))[:, ::2])


def test_function_that_numba_has_numbered_meanwhile_can_be_named():
    function = numba.njit(lambda x: 3.0 * x)
    # As where another thread compiles a caller of the function.
    numbered = function._uuid
    assert name_stably(function)
    assert (function._uuid, function(2.0)) == (numbered, 6.0)
