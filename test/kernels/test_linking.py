# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Functions that are only linked into others, and loops whose arrays nobody counts."""

from collections.abc import Callable, Iterator
import os
import platform
import re
import subprocess
import sys
from types import FunctionType

from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import bare, compiled, compiled_loop, compiled_options, kept, Part, part
from hnn_vi_ros.kernels.linking import LinkOnly
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.assembly import advance
import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.event import install_recorder
from numba.core.runtime import _nrt_python, rtsys
import numpy as np
import pytest


def doubled(function: Part) -> numba.core.dispatcher.Dispatcher:
    @numba.njit
    def twice(x):
        return 2.0 * function(x)
    return twice


def test_parts_of_one_name_and_type_stay_apart():
    def shifted(by: float) -> Part:
        @part()
        def shift(x):
            return x + by
        return shift

    assert [doubled(shifted(by))(1.0) for by in (0.5, 10.0, 3.0)] == [3.0, 22.0, 8.0]


def test_part_is_plain_python_where_python_calls_it():
    @part(forceinline=True)
    def name(x):
        return type(x).__name__

    assert name(1) == 'int' and not name.overloads


def test_part_is_neither_optimised_nor_loaded(monkeypatch):
    @part()
    def square(x):
        return x * x

    finished = []
    load = JITCodeLibrary._finalize_specific
    monkeypatch.setattr(JITCodeLibrary, '_finalize_specific',
                        lambda library: finished.append(library.name) or load(library))
    function = doubled(square)
    assert function(3.0) == 18.0
    assert square.overloads and function.__name__ in ''.join(finished)
    assert not any('square' in name for name in finished)


def test_part_that_prints_finds_its_environment(capfd):
    @part()
    def tell(x):
        print('x is', x)
        return x

    assert doubled(tell)(3.0) == 6.0
    assert capfd.readouterr().out == 'x is 3.0\n'


def test_error_in_a_part_reaches_python():
    @part()
    def inverse(x):
        return 1.0 / x

    with pytest.raises(ZeroDivisionError):
        doubled(inverse)(0.0)


def test_unpickled_part_is_compiled_alike():
    # As numba makes one anew from a cache on disk.
    @part()
    def square(x):
        return x * x

    copy = Part._rebuild(**{**square._reduce_states(), 'uuid': 'another'})
    assert copy._compiler.pipeline_class is LinkOnly


def test_bare_arrays_are_the_same_memory_and_their_owners_keep_them():
    @numba.njit
    def fill(state, number):
        (x, parts), number = bare((state, number))
        for k in range(parts[0].size):
            parts[0][k] = x[k] + number
        return number

    x, y = np.arange(3.0), np.empty(3)
    before = (x.base, y.base)
    assert fill((x, (y, 1)), 2.0) == 2.0
    assert y.tolist() == [2.0, 3.0, 4.0] and (x.base, y.base) == before
    assert bare(x) is x


@pytest.fixture
def allocations() -> Iterator[Callable]:
    _nrt_python.memsys_enable_stats()
    yield rtsys.get_allocation_stats
    _nrt_python.memsys_disable_stats()


def test_part_counts_no_references_and_returns_arrays_that_their_owner_keeps(allocations):
    @part()
    def rest(x):
        y = x[1:]
        return y, x

    @numba.njit
    def total(x):
        own = x + 1.0
        y, whole = rest(own)
        return y.sum() + whole[0] + own[0]

    x = np.arange(3.0)
    total(x)
    references, before = sys.getrefcount(x), allocations()
    assert [total(x) for _ in range(100)] == [7.0] * 100
    after = allocations()
    assert sys.getrefcount(x) == references
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free >= 100


def test_part_that_creates_arrays_frees_them(allocations):
    @part()
    def doubled(x):
        return 2.0 * x

    @part()
    def quadrupled(x):
        return doubled(doubled(x))

    @numba.njit
    def total(x):
        return quadrupled(x).sum()

    total(np.ones(2))
    before = allocations()
    assert [total(np.ones(2)) for _ in range(100)] == [8.0] * 100
    after = allocations()
    # The argument itself, and two for each.
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free == 300


def test_text_beside_bare_arrays_keeps_its_owner():
    @numba.njit
    def text_of(state):
        _, text = bare(state)
        return text

    texts = [chr(97 + k % 26) * k for k in range(200)]
    assert [text_of((np.zeros(2), text)) for text in texts] == texts


def run(loop: Callable) -> tuple[numba.core.event.RecordingListener, float, float]:
    """Take five steps from one state; return what was compiled for it, and the end."""
    method = INTEGRATORS['implicit_midpoint']()
    simulation = Simulation(HAMILTONIANS['harmonic_oscillator'](), method, 0.1, [1.0], [0.5])
    step = compiled(method.step, method.kernel_name)
    options = compiled_options(method.options(0, 1))
    q, p = np.empty((2, 1, 1))
    with install_recorder('numba:compile') as recorder:
        outcome, done, *_ = loop(step, simulation._kernel, 0.1, options, 0, 5, simulation._z,
                                 simulation._z1, simulation._memories[0], q, p, 5)
    assert (outcome, done) == (0, 5)
    return recorder, float(q[0, 0]), float(p[0, 0])


def test_loop_counts_no_references_makes_no_texts_and_shares_no_functions():
    # A copy: what is kept on disk shows no code.
    copy = FunctionType(advance.__code__, advance.__globals__)
    loop = compiled_loop(copy, HAMILTONIANS['tao']().kernel, 'any', own=False)
    recorder, *end = run(loop)
    modules = {event.data['dispatcher'].py_func.__module__ for _, event in recorder.buffer}
    assert 'hnn_vi_ros.simulation.assembly' in modules and 'numba.cpython.unicode' not in modules
    (code,) = loop.inspect_llvm().values()
    bodies = dict(re.findall(
        r'^define [^@]*@"?([\w.$]+)"?\([^\n]*\{\n(.*?)^\}', code, re.M | re.S))
    # Those that Python calls count what they unpack of their arguments.
    counting = [name for name, body in bodies.items()
                if re.search(r'call .*@NRT_(?:incref|decref)', body)]
    assert any('advance' in name and name not in counting for name in bodies)
    assert counting and all('cpython' in name for name in counting)
    # Code from the cache must not find its functions elsewhere.
    assert not re.search('^define (?:weak|linkonce)', code, re.M)
    # Neither may reorder or fuse operations: plain Python ends in the same numbers.
    assert run(advance)[1:] == tuple(end)


@pytest.mark.timeout(60)
def test_function_of_another_that_calls_a_kept_one_is_compiled():
    # numba compiles the inner one while it holds its lock for the outer one.
    inner = kept(own=False)(lambda x: 2.0 * x)
    assert doubled(inner)(3.0) == 12.0


WIDE = """
import sys
from hnn_vi_ros.kernels import part, Whole
import numba

@part()
def add(a, x, y):
    for i in range(x.size):
        y[i] += a * x[i]

@numba.njit(pipeline_class=Whole)
def caller(a, x, y):
    add(a, x, y)

array = numba.float64[::1]
caller.compile((numba.float64, array, array))
print('zmm' in caller.inspect_asm(caller.signatures[0]))
"""


@pytest.mark.skipif(platform.machine() != 'x86_64', reason='its vectors are compared')
@pytest.mark.parametrize('processor, extension, wide', [
    ('icelake-server', '+avx512vbmi2,', True), ('cascadelake', '', False)])
def test_vectors_of_512_bits_where_they_do_not_lower_the_clock(processor, extension, wide):
    # By LLVM's choice both have 256 bits. The code is compiled, not run.
    environment = {**os.environ, 'NUMBA_CPU_NAME': processor, 'NUMBA_CPU_FEATURES':
                   f'{extension}+avx512f,+avx512vl,+avx512dq,+avx512bw,+fma,+prefer-256-bit'}
    found = subprocess.run([sys.executable, '-'], input=WIDE, env=environment, text=True,
                           capture_output=True, check=True)
    assert found.stdout == f'{wide}\n'
