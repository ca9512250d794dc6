# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of every part, planted in a copy of the project: `make test` alone finds each of them."""

from dataclasses import dataclass
import os
from pathlib import Path
import shutil
import subprocess
import sys

import hnn_vi_ros
from hnn_vi_ros.files import share_folder
import pytest

PACKAGE, TESTS = Path(hnn_vi_ros.__file__).parent, Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Fault:
    """
    A change of the sources, and the tests that must find it.

    Parameters
    ----------
    name : str
        Description of the fault.
    file : str
        A file of the package.
    changes : tuple of (str, str)
        Pairs of a text of the file and its replacement.
    test, chosen : str
        A file of tests, and pytest's -k: at least one of these tests must fail. They must be
        tests of `make test`.

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
           ('range(1, max_iterations + 1)', 'range(1, 4)'),
           ('stage, k == max_iterations)', 'stage, k == 3)')),
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
    Fault('weight that pulls upwards', 'effects/gravity.py',
          (('dH_dq[parameters.column] += ', 'dH_dq[parameters.column] -= '),),
          'verification/test_exact_solutions.py', 'gravity_throws'),
    Fault('work with the wrong sign', 'effects/wrapped.py',
          (('state.pending[channel_effects[k]] += ', 'state.pending[channel_effects[k]] -= '),),
          'simulation/test_system.py', 'energy_balance_of_trajectories'),
    Fault('seed of the noise ignored', 'effects/noise.py',
          (('_mix(np.uint64(seed) + _GOLDEN)', '_mix(_GOLDEN)'),),
          'simulation/test_system.py', 'noise_is_that_of_its_seed'),
    Fault("energy guard's threshold ten times too high", 'simulation/guards/bands.py',
          (('_LARGEST_ERROR = 10.0, 0.5', '_LARGEST_ERROR = 100.0, 0.5'),),
          'simulation/guards/test_guards.py', 'says_at_once_that_the_energy_jumps'),
    Fault('checksum of chunks not compared', 'recording/bags/mcap_file.py',
          ((' and head.crc in (0, zlib.crc32(data))', ''),),
          'recording/bags/test_recover_bag.py', 'damaged_chunk_is_left_out'),
    Fault('delay of commands ignored by the controller', 'control/task.py',
          (('round(delay / steps.duration) if steps else 0', '0'),),
          'control/test_task.py', 'prediction_is_the_run'),
    Fault('angles of a cost not wrapped', 'control/costs.py',
          (('(x[..., k] + np.pi) % (2.0 * np.pi) - np.pi', 'x[..., k]'),),
          'control/test_costs.py', 'wraps_angles'),
    Fault('energies of the samples before', 'simulation/guards/watch.py',
          (('    energy = hamiltonian.energy(q, p, t)\n',
            '    energy = np.roll(hamiltonian.energy(q, p, t), 1, axis=0)\n'),),
          'simulation/guards/test_guard_calibration.py', 'shown_in_one_go'),
    Fault('friction learned with the wrong sign', 'learning/judging/energy.py',
          (('nnls(centred / units, -energies)', 'nnls(centred / units, energies)'),),
          'learning/test_energy_error.py', 'friction_of_a_machine'),
    Fault('grid of a sweep with its first key the fastest', 'sweeps/axes.py',
          (('np.unravel_index(places, axis.counts)',
            "np.unravel_index(places, axis.counts, order='F')"),),
          'sweeps/test_sweep.py', 'grid_and_file'),
    Fault('directions of events swapped', 'simulation/events.py',
          (("('down' if rises else 'up')", "('up' if rises else 'down')"),),
          'simulation/test_events.py', 'at_the_end_of_a_step'),
    Fault('code named by data that nobody trusts', 'files/named_code.py',
          (('if name is not None and not ', 'if name is None and not '),),
          'verification/test_constraints.py', 'refused_in_what_is_not_trusted'),
]


@pytest.fixture(scope='module')
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the package and its tests, beside links to the files that it ships."""
    folder, ignored = tmp_path_factory.mktemp('project'), shutil.ignore_patterns('__pycache__')
    shutil.copytree(PACKAGE, folder / 'hnn_vi_ros', ignore=ignored)
    shutil.copytree(TESTS, folder / 'test', ignore=ignored)
    for target in (*(share_folder() / name for name in ('config', 'resource')),
                   *(TESTS.parent / name for name in ('docs', 'setup.cfg'))):
        (folder / target.name).symlink_to(target)
    return folder


def run_tests(project: Path, kernels: Path, faults: list[Fault]) -> subprocess.CompletedProcess:
    """Run the tests of `make test` that must find some faults, with new compiled code."""
    path = os.pathsep.join([str(project), os.environ.get('PYTHONPATH', '')])
    return subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider', '-m', 'not long',
         '-k', ' or '.join(f'({Path(fault.test).name} and {fault.chosen})' for fault in faults),
         *sorted({str(project / 'test' / fault.test) for fault in faults})],
        cwd=project, env=os.environ | {'PYTHONPATH': path, 'PYTHONDONTWRITEBYTECODE': '1',
                                       'NUMBA_CACHE_DIR': str(kernels)},
        capture_output=True, text=True, timeout=800)


def test_faults_have_a_place_and_a_test():
    for fault in FAULTS:
        text = (PACKAGE / fault.file).read_text(encoding='utf-8')
        assert all(before in text for before, _ in fault.changes), fault.name
        assert (TESTS / fault.test).is_file(), fault.name


@pytest.mark.long
def test_copy_without_a_fault_passes_what_finds_the_faults(project, tmp_path):
    done = run_tests(project, tmp_path, FAULTS)
    assert done.returncode == 0, done.stdout


@pytest.mark.long
@pytest.mark.parametrize('fault', FAULTS, ids=lambda fault: fault.name)
def test_planted_fault_is_found(project, tmp_path, fault):
    file = project / 'hnn_vi_ros' / fault.file
    whole = text = file.read_text(encoding='utf-8')
    for before, after in fault.changes:
        text = text.replace(before, after)
    assert text != whole
    try:
        file.write_text(text, encoding='utf-8')
        done = run_tests(project, tmp_path, [fault])
    finally:
        file.write_text(whole, encoding='utf-8')
    # 1: tests failed; a copy that cannot be imported, or no test at all, is another number.
    assert done.returncode == 1, done.stdout
