# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels in Triton against the products of torch, in the interpreter of Triton.

``test_fused`` runs these in a process of their own, with TRITON_INTERPRET=1.
"""

import json

from helpers import EPS, random_checkpoint
from hnn_vi_ros.errors import RecordingError, UnsupportedSystem
from hnn_vi_ros.lockstep import triton_kernels
from hnn_vi_ros.lockstep.ensemble import LockstepEnsemble, Recorded
from hnn_vi_ros.lockstep.gradient import make_gradient
from hnn_vi_ros.models.confined import ConfinedHamiltonian
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.run.ensemble import simulate_many
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.sweeps.sweep import sweep
from lockstep_scenes import random_network
import numpy as np
import pytest
import torch
import triton
import triton.language as tl

CPU = torch.device('cpu')
TWO = ['variational_euler', 'generalized_leapfrog']


@triton.jit
def tanh_of(x, y, COUNT: tl.constexpr):
    at = tl.arange(0, COUNT)
    tl.store(y + at, triton_kernels.tanh(tl.load(x + at)))


def test_tanh_is_that_of_extended_precision():
    """Exp, to 1 eps of a part of at most 0.8, and four roundings of less than eps each."""
    sizes = np.concatenate([np.geomspace(1e-300, 50.0, 1500), np.linspace(0.6, 0.65, 543)])
    x = np.concatenate([sizes, -sizes, [0.0, -0.0, 800.0, np.inf, -np.inf, np.nan], np.zeros(4)])
    found = torch.empty(len(x), dtype=torch.float64)
    tanh_of[(1,)](torch.from_numpy(x), found, COUNT=len(x))
    exact = np.tanh(x.astype(np.longdouble))
    finite = np.isfinite(x) & (x != 0.0)
    assert np.abs(found.numpy() / exact - 1.0)[finite].max() <= 4.0 * EPS
    assert np.array_equal(found[~finite], np.tanh(x[~finite]), equal_nan=True)


def network(widths: list[int]) -> NeuralHamiltonian:
    return NeuralHamiltonian(random_checkpoint(widths, seed=6))


@pytest.mark.parametrize('name', [
    'pendulum', 'double_pendulum', 'separable_pendulum', 'walled', '2-5-9-1', '2-300-270-1'])
def test_gradient_is_that_of_torch(name):
    """
    Two and three layers, of one and more inputs, and blocks that are not full or several.

    Both round each of the sums, of n terms of numbers up to the largest, in at most 6 products.
    """
    if '-' in name:
        hamiltonian = network([int(width) for width in name.split('-')])
    elif name == 'walled':
        hamiltonian = ConfinedHamiltonian(load_scene('pendulum').create_hamiltonian())
    else:
        hamiltonian = load_scene(name).create_hamiltonian()
    width = max(map(int, name.split('-'))) if '-' in name else 64
    z = torch.from_numpy(np.random.default_rng(1).uniform(
        -2.5, 2.5, (2 * hamiltonian.dimension, 20)))
    plain, fused = (make_gradient(hamiltonian, CPU, kernels)(z) for kernels in ('torch', 'fused'))
    assert (fused - plain).abs().max() <= 2 * 6 * width * EPS * plain.abs().max()
    assert not torch.equal(fused, plain), 'the same sums in the same order: of the same code?'


def recorded(scene: Scene, device: str, q: np.ndarray, p: np.ndarray, samples: list[int]
             ) -> Recorded:
    return LockstepEnsemble(scene.create_hamiltonian(), scene.create_integrator(),
                            scene.known_step_size, [], scene.on_failure, device
                            ).record(q, p, samples)


@pytest.mark.parametrize('method', TWO)
def test_many_steps_are_those_of_torch_in_any_launches(method):
    """Both solve to 8 eps of the scale of numbers up to 8."""
    scene = load_scene('stepwise_pendulum').with_overrides(0.05, method)
    q, p = np.random.default_rng(0).uniform(-1.2, 1.2, (2, 11, 1))
    plain, many = (recorded(scene, device, q, p, [0, 1, 4]) for device in ('cpu', 'cpu/steps'))
    assert 8 * EPS * 8.0 <= 1e-13
    for steps, *pairs in zip([0, 1, 4], plain.q, many.q, plain.p, many.p, strict=True):
        assert np.abs(pairs[0] - pairs[1]).max() <= steps * 1e-13
        assert np.abs(pairs[2] - pairs[3]).max() <= steps * 1e-13
    assert not many.failures and not many.counts.rescued.any()
    # An iterate that is good enough for one may need another one with the other.
    equations = 1 + TWO.index(method)
    assert np.abs(many.counts.costliest - plain.counts.costliest).max() <= equations
    assert (many.counts.at > 0).all() and (many.counts.at <= 4).all()
    # However the steps are cut into launches, the same bits, counts included.
    again = recorded(scene, 'cpu/steps', q, p, [2, 4])
    assert np.array_equal(again.q[1], many.q[2]) and np.array_equal(again.p[1], many.p[2])
    assert np.array_equal(again.counts.costliest, many.counts.costliest)
    assert np.array_equal(again.counts.at, many.counts.at)


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('method, on_failure', [(TWO[0], 'stop'), (TWO[1], 'substep')])
def test_steps_that_are_not_solved_in_a_launch_are_taken_or_fail_as_others(
        tmp_path, method, on_failure):
    scene = random_network(tmp_path, 4.0).changed({'on_failure': on_failure})
    scene = scene.with_overrides(0.1, method)
    q, p = np.random.default_rng(5).uniform(-1.0, 1.0, (2, 8, 1))
    plain, many = (recorded(scene, device, q, p, [0, 2]) for device in ('cpu', 'cpu/steps'))
    assert {k: (one.reason, one.t) for k, one in plain.failures.items()} == {
        k: (one.reason, one.t) for k, one in many.failures.items()}
    good = [k for k in range(len(q)) if k not in plain.failures]
    # Two steps of up to 1e-13, which such a network stretches.
    assert np.abs(plain.q - many.q)[:, good].max() <= 1e-9
    assert np.array_equal(np.isnan(plain.q), np.isnan(many.q))
    for name in ('rescued', 'several_solutions'):
        assert getattr(plain.counts, name).tolist() == getattr(many.counts, name).tolist()
    assert plain.counts.rescued.any() if on_failure == 'substep' else plain.failures


def test_what_has_no_kernels_is_refused_with_what_is_possible():
    def refused(scene: str, device: str, method: str | None = None) -> str:
        chosen = load_scene(scene)
        with pytest.raises(UnsupportedSystem) as problem:
            LockstepEnsemble(chosen.create_hamiltonian(),
                             chosen.with_overrides(0.01, method).create_integrator(), 0.01, [],
                             'stop', device)
        assert '\n' not in str(problem.value)
        return str(problem.value)
    with pytest.raises(UnsupportedSystem, match='with 1 layers of tanh has no fused kernels'):
        make_gradient(network([2, 8, 1]), CPU, 'fused')
    assert 'of one coordinate, with two layers of tanh' in refused(
        'double_pendulum', 'cpu/steps', 'variational_euler')
    assert 'gauss4: one launch takes many steps of variational_euler or' in refused(
        'pendulum', 'cpu/steps', 'gauss4')


def test_sweep_records_its_kernels_and_goes_on_with_no_others(tmp_path):
    definition = {'scene': 'pendulum', 'duration': 0.04, 'shard_size': 4, 'vary': [
        {'kind': 'box', 'keys': ['initial_state.q.angle', 'initial_state.p.angle'],
         'low': [-1.0, -1.0], 'high': [1.0, 1.0], 'count': 6}]}
    whole = sweep(definition, tmp_path / 'whole', device='cpu/steps')
    assert json.loads((whole / 'sweep.json').read_text())['device'] == {
        'kind': 'cpu', 'torch': torch.__version__, 'kernels': 'steps', 'triton': '3.7.1'}
    for share in ('1/2', '0/2'):
        sweep(definition, tmp_path / 'parts', shard=share, device='cpu/steps')
    assert [path.read_bytes() for path in sorted((tmp_path / 'parts').glob('*.parquet'))] == [
        path.read_bytes() for path in sorted(whole.glob('*.parquet'))]
    with pytest.raises(RecordingError, match='holds another sweep: device.* is "steps" there'):
        sweep(definition, whole, device='cpu/fused')


def test_simulate_many_takes_them():
    scene = load_scene('stepwise_pendulum').with_overrides(0.05, 'variational_euler')
    state = [[0.5], [0.6]], [[0.1], [0.2]]
    plain, fused = (simulate_many(scene, *state, 0.1, device=device, threads=1)
                    for device in ('cpu', 'cpu/fused'))
    assert np.abs(plain.q - fused.q).max() <= 2e-13


def test_benchmark_prints_its_tables(capsys):
    from benchmarks import device
    device.main(['cpu', '--quick'])
    about, *lines = capsys.readouterr().out.splitlines()
    assert json.loads(about)['triton'] == '3.7.1'
    assert [line.count('|') for line in lines if line] == [9, 9, 9, 6, 6, 6, 6]
    assert '2-32-32-1, `generalized_leapfrog`, 12' in lines[-1] and 'nan' not in lines[-1]
