# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Faults that integrators are known to have had: planted in a copy, each turns a test red."""

from dataclasses import dataclass
import os
from pathlib import Path
import shutil
import subprocess
import sys

import hnn_vi_ros
from hnn_vi_ros.files.resources import share_folder
import pytest

TESTS = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Fault:
    """
    A change of the sources, and where it must be found.

    Parameters
    ----------
    name : str
        What is wrong.
    file : str
        In the package.
    changes : tuple of (str, str)
        Each text, which stands there once, and what takes its place.
    test, chosen : str
        Of the test's folder, and pytest's -k: tests of which at least one must fail.

    """

    name: str
    file: str
    changes: tuple[tuple[str, str], ...]
    test: str
    chosen: str


FAULTS = [
    Fault('implicit solve stopped after three iterations', 'integrators/solvers.py',
          (('    if stage == OWN and residual > bound and not is_last:\n', '    if is_last:\n'
            '        return OK, residual, stage\n'
            '    if stage == OWN and residual > bound and not is_last:\n'),
           ('    for k in range(1, max_iterations + 1):\n'
            '        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect,'
            ' previous,\n'
            '                                         stage, k == max_iterations)\n'
            '        if outcome != GO_ON:\n'
            '            return outcome, residual, k\n'
            '        if stage == COMMON and is_hopeless(k, residual, previous):\n',
            '    for k in range(1, 4):\n'
            '        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect,'
            ' previous,\n'
            '                                         stage, k == 3)\n'
            '        if outcome != GO_ON:\n'
            '            return outcome, residual, k\n'
            '        if stage == COMMON and is_hopeless(k, residual, previous):\n')),
          'verification/test_symplecticity.py', 'own_two_form and tao and variational_euler'),
    Fault('composition with its factors swapped', 'integrators/composition.py',
          (('fractions = (_w, 1.0 - 2.0 * _w, _w)', 'fractions = (1.0 - 2.0 * _w, _w, _w)'),),
          'verification/test_order.py', 'local_error and yoshida4'),
    Fault('k4 of RK4 taken at h / 2', 'integrators/runge_kutta.py',
          (('length = h if stage == 2 else 0.5 * h', 'length = 0.5 * h'),),
          'verification/test_order.py', 'local_error and rk4'),
    Fault("q' = p assumed by the paper's scheme", 'integrators/variational_euler.py',
          (('h * z.dH_dp[i]', 'h * z.p[i]'),),
          'verification/test_order.py', 'local_error and variational_euler'),
    Fault("q' = p assumed by the leapfrog", 'integrators/stormer_verlet.py',
          (('z.q_carry[i], h * z1.dH_dp[i])', 'z.q_carry[i], h * z1.p[i])'),),
          'verification/test_structure.py', 'is_stormer_verlet'),
    Fault('sign flipped in the adjoint', 'integrators/symplectic_euler.py',
          (('-h * z1.dH_dq[i]', 'h * z1.dH_dq[i]'),),
          'verification/test_order.py', 'local_error and symplectic_euler_adjoint'),
]


def copy_of_the_project(folder: Path) -> Path:
    """Copy the package and its tests, beside links to the files that it ships."""
    ignored = shutil.ignore_patterns('__pycache__')
    package = folder / 'hnn_vi_ros'
    shutil.copytree(Path(hnn_vi_ros.__file__).parent, package, ignore=ignored)
    shutil.copytree(TESTS, folder / 'test', ignore=ignored)
    for name in ('config', 'resource'):
        (folder / name).symlink_to(share_folder() / name)
    return package


def run_tests(folder: Path, faults: list[Fault]) -> subprocess.CompletedProcess:
    """Run the tests that must find some faults, those of a copy on that copy."""
    path = os.pathsep.join([str(folder), str(folder / 'test'), os.environ.get('PYTHONPATH', '')])
    return subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider',
         '-k', ' or '.join(f'({Path(fault.test).name} and {fault.chosen})' for fault in faults),
         *sorted({str(folder / 'test' / fault.test) for fault in faults})],
        cwd=folder, env=os.environ | {'PYTHONPATH': path}, capture_output=True, text=True,
        timeout=250)


def test_copy_without_a_fault_passes_what_finds_the_faults(tmp_path):
    copy_of_the_project(tmp_path)
    done = run_tests(tmp_path, FAULTS)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize('fault', FAULTS, ids=lambda fault: fault.name)
def test_planted_fault_is_found(tmp_path, fault):
    file = copy_of_the_project(tmp_path) / fault.file
    text = file.read_text(encoding='utf-8')
    for before, after in fault.changes:
        assert text.count(before) >= 1
        text = text.replace(before, after)
    file.write_text(text, encoding='utf-8')
    done = run_tests(tmp_path, [fault])
    # 1: tests failed; a copy that cannot be imported, or no test at all, is another number.
    assert done.returncode == 1, done.stdout
