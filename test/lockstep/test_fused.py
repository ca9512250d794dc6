# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels in Triton: what they compute, what they compile to, and where they are refused."""

import os
from pathlib import Path
import subprocess
import sys

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.lockstep import devices
from hnn_vi_ros.lockstep.devices import description, kernels_of, open_device
import pytest

pytest.importorskip('torch', reason='torch is not installed')
HERE = Path(__file__).parent
# Compile for an H100 or H200, on any machine; print which products there are, and the variables.
COMPILE = """
import re
from hnn_vi_ros.lockstep import triton_kernels
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

NUMBERS = {'m', 'n', 'n1', 'n2', 'end'}
WHOLE = {'counts', 'todo', 'outcomes', 'most', 'at'}

def products(kernel, warps, **constants):
    signature = {name: 'constexpr' if name in constants else 'i32' if name in NUMBERS
                 else '*i64' if name in WHOLE else '*fp64' for name in kernel.arg_names}
    made = triton.compile(ASTSource(kernel, signature, constants),
                          target=GPUTarget('cuda', 90, 32), options={'num_warps': warps})
    print(*sorted(set(re.findall(r'mma.sync[.a-z0-9]*f64', made.asm['ptx']))))

blocks = {'ROWS': 16, 'COLUMNS': 16, 'DEPTH': 16}
products(triton_kernels.forward, 1, INPUTS=2, LAST=True, **blocks)
products(triton_kernels.backward, 1, INPUTS=2, PADDED=16, **blocks)
products(triton_kernels.take_steps, 1, LEAPFROG=True, EXTRAPOLATE=True, MOST=50, CONNECTED=True,
         WIDTH=16, COLUMNS=8)
"""


def run(arguments: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python with another environment, which Triton reads when it is imported."""
    path = os.pathsep.join([str(HERE.parent), str(HERE), os.environ.get('PYTHONPATH', '')])
    inherited = {key: value for key, value in os.environ.items() if key != 'TRITON_INTERPRET'}
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=False, timeout=280,
        env=inherited | {'PYTHONPATH': path} | environment)


def test_kernels_compute_in_the_interpreter_what_torch_does():
    """Run the cases of ``triton_cases``."""
    pytest.importorskip('triton', reason='triton is not installed')
    found = run(['-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider',
                 str(HERE / 'triton_cases.py')], TRITON_INTERPRET='1')
    assert found.returncode == 0, found.stdout + found.stderr
    assert ' passed' in found.stdout and 'skipped' not in found.stdout


def test_kernels_compile_to_products_that_fit_the_tensor_cores(tmp_path):
    """Of 16 x 8 x 16 numbers, as those of Hopper are."""
    pytest.importorskip('triton', reason='triton is not installed')
    script = tmp_path / 'compile_kernels.py'
    script.write_text(COMPILE)
    found = run([str(script)], TRITON_CACHE_DIR=str(tmp_path / 'cache'))
    assert found.returncode == 0, found.stdout + found.stderr
    assert found.stdout.splitlines() == 3 * [
        'mma.sync.aligned.m16n8k16.row.col.f64.f64.f64.f64']


def test_kernels_are_part_of_the_name_of_a_device():
    assert [kernels_of(name) for name in ('cpu', 'cuda:1', 'cuda:1/fused', 'cpu/steps')] == [
        'torch', 'torch', 'fused', 'steps']
    assert description('cpu').keys() == {'kind', 'torch'}
    for name in ('cpu/', 'cpu/torch', 'cuda/fast', 'cpu:0/fused', '/steps'):
        with pytest.raises(ValueError, match=f'device = {name!r} is not known; valid: cpu, cuda'):
            open_device(name)


def test_triton_that_cannot_run_the_kernels_is_refused_with_the_reason(monkeypatch):
    def refused(name: str) -> str:
        with pytest.raises(ParameterError) as problem:
            open_device(name)
        assert '\n' not in str(problem.value)
        return str(problem.value)

    def missing(package: str) -> str:
        raise devices.PackageNotFoundError(package)
    monkeypatch.delenv('TRITON_INTERPRET', raising=False)
    monkeypatch.setattr(devices, 'version', missing)
    assert 'which a torch for CUDA brings, and no version is installed' in refused('cpu/fused')
    monkeypatch.setattr(devices, 'version', lambda package: '3.8.0')
    assert 'and 3.8.0 is installed; take device = cuda, ' in refused('cuda/steps')
    monkeypatch.setattr(devices, 'version', lambda package: '3.7.1')
    assert 'set TRITON_INTERPRET=1, or take device = cpu' in refused('cpu/steps')
    monkeypatch.setenv('TRITON_INTERPRET', '1')
    assert open_device('cpu/steps').type == 'cpu'
    assert 'is for the processor; unset it' in refused('cuda/fused')
