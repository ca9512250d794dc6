# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Networks of others: the same energy as their source, and nothing of a file is run."""

from pathlib import Path
import pickle
import tarfile
import zipfile

from helpers import Malicious, mostly_long
from hnn_vi_ros.errors import HnnViRosError, ModelError, ParameterError
from hnn_vi_ros.learning.import_checkpoint import main, MAX_BYTES, read_layers
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hypothesis import given, settings, strategies as st
from messages import refused
import numpy as np
import pytest
import torch

ROOT = Path(__file__).resolve().parents[2]
FUNNEL = ROOT.parent / 'shared' / 'data' / 'foreign' / 'neal_funnel_hnn.tar'
FUNCTIONS = {'tanh': torch.tanh, 'sine': torch.sin, 'relu': torch.relu,
             'softplus': torch.nn.functional.softplus}


class Source(torch.nn.Module):
    """What the original code trains: layers named linear1, ..., the last one without bias."""

    def __init__(self, widths: list[int], activation: str):
        super().__init__()
        self.depth, self.function = len(widths) - 1, FUNCTIONS[activation]
        for layer in range(1, len(widths)):
            setattr(self, f'linear{layer}', torch.nn.Linear(
                widths[layer - 1], widths[layer], bias=layer < self.depth))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return all outputs."""
        for layer in range(1, self.depth):
            x = self.function(getattr(self, f'linear{layer}')(x))
        return getattr(self, f'linear{self.depth}')(x)


class Whole(torch.nn.Module):
    """The module that holds it."""

    def __init__(self, widths: list[int], activation: str):
        super().__init__()
        torch.manual_seed(sum(widths))
        self.differentiable_model = Source(widths, activation)


def energy(outputs: torch.Tensor, layout: str) -> torch.Tensor:
    """Return H as the codes of others do."""
    if layout == 'hnn':
        return outputs.split(1, dim=1)[1][:, 0]
    return outputs[:, outputs.shape[1] // 2:].sum(dim=1)


def import_file(path: Path, activation: str, layout: str, names: str, *more: str
                ) -> NeuralHamiltonian:
    out = path.with_suffix('.safetensors')
    main([str(path), '--layout', layout, '--activation', activation, '--coordinates', names,
          '--out', str(out), *(more or ('--box=-2:2',))])
    return NeuralHamiltonian(load_checkpoint(out))


# Kernels of the other functions are compiled for these tests alone.
@pytest.mark.parametrize('activation', mostly_long(FUNCTIONS, 'tanh'))
@pytest.mark.parametrize('layout, widths', [
    ('hnn', [4, 30, 30, 2]), ('sum_second_half', [6, 20, 20, 20, 6])], ids=str)
@pytest.mark.parametrize('order', ['qp', 'pq'])
def test_imported_energy_agrees_with_the_source_to_1e_6_in_float32(
        tmp_path, activation, layout, widths, order):
    module, d = Whole(widths, activation), widths[0] // 2
    torch.save(module.state_dict(), tmp_path / 'source.tar')
    names = ','.join(f'x{i}' for i in range(d))
    hamiltonian = import_file(tmp_path / 'source.tar', activation, layout, names,
                              '--box=-2:2', '--order', order)
    q, p = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 100, d))
    x = torch.tensor(np.hstack([q, p] if order == 'qp' else [p, q]))
    ours = hamiltonian.energy(q, p)
    single = energy(module.differentiable_model(x.float()), layout).detach().numpy()
    assert np.abs(ours - single).max() <= 1e-6
    double = energy(module.double().differentiable_model(x), layout).detach().numpy()
    # The weights are the same numbers; two ways of rounding sums of 30 terms. softplus(z) is z
    # for torch from z = 20 on, where no argument is here.
    assert np.abs(ours - double).max() <= 1e-13
    card = hamiltonian.checkpoint.card
    assert card.activation == activation
    assert card.widths == [*widths[:-1], 1]
    assert 'imported from source.tar (sha256 ' in card.dataset


@pytest.mark.long
def test_imported_funnel_agrees_with_its_source(tmp_path):
    if not FUNNEL.is_file():
        pytest.skip(f'the network by others is not shipped and not at {FUNNEL}')
    out = tmp_path / 'funnel.safetensors'
    main([str(FUNNEL), '--layout', 'sum_second_half', '--activation', 'sine', '--coordinates',
          'q1,q2', '--box=-6:6,-4:4,-4:4,-4:4', '--out', str(out)])
    hamiltonian = NeuralHamiltonian(load_checkpoint(out))
    module = Whole([4, 100, 100, 100, 100, 4], 'sine')
    module.load_state_dict(torch.load(FUNNEL, weights_only=True))
    q, p = np.random.default_rng(1).uniform(-3.0, 3.0, (2, 200, 2))
    x = torch.tensor(np.hstack([q, p])).requires_grad_(True)
    double = energy(module.double().differentiable_model(x), 'sum_second_half')
    (gradient,) = torch.autograd.grad(double.sum(), x)
    double = double.detach().numpy()
    ours = hamiltonian.energy(q, p)
    # Energies of some tens, sums of 100 terms in each of four layers.
    assert np.abs(ours - double).max() <= 1e-12 * np.abs(double).max()
    single = energy(module.float().differentiable_model(x.detach().float()), 'sum_second_half')
    assert np.abs(ours - single.detach().numpy()).max() <= 1e-6 * np.abs(double).max()
    assert np.abs(np.hstack(hamiltonian.gradient(q, p)) - gradient.numpy()).max() <= 1e-10


def test_box_can_be_that_of_the_data_of_a_configuration(tmp_path):
    torch.save(Whole([2, 8, 2], 'tanh').state_dict(), tmp_path / 'source.tar')
    hamiltonian = import_file(tmp_path / 'source.tar', 'tanh', 'hnn', 'x', '--box-of',
                              'harmonic_oscillator')
    # 1000 uniform samples of [-2, 2].
    assert np.abs(np.abs(hamiltonian.box) - 2.0).max() < 0.02


@pytest.mark.parametrize('legacy', [False, True])
def test_pickle_with_a_payload_is_refused_and_not_run(tmp_path, legacy):
    marker, path = tmp_path / 'executed', tmp_path / 'source.tar'
    state = Whole([2, 8, 2], 'tanh').state_dict()
    torch.save({**state, 'extra': Malicious(marker)}, path,
               _use_new_zipfile_serialization=not legacy)
    assert_refused(path)
    assert not marker.exists()
    torch.load(path, weights_only=False)
    assert marker.exists()  # the file would have done it


def assert_refused(path: Path) -> None:
    with refused(ModelError):
        read_layers(path)


LINEAR = {'linear1.weight': torch.ones(3, 2), 'linear1.bias': torch.ones(3),
          'linear2.weight': torch.ones(2, 3)}


@pytest.mark.parametrize('state', [
    [torch.ones(2)], {}, {'state_dict': LINEAR}, {'conv1.weight': torch.ones(2, 2)},
    {**LINEAR, 'D.linear1.weight': torch.ones(3, 2)},
    {**LINEAR, 'linear4.weight': torch.ones(2, 2)}, {**LINEAR, 'linear2.weight': torch.ones(2, 4)},
    {**LINEAR, 'linear1.bias': torch.ones(4)},
    {**LINEAR, 'linear1.bias': torch.full((3,), np.nan)},
    {**LINEAR, 'linear1.bias': torch.ones(3, dtype=torch.int64)},
    {**LINEAR, 'linear1.weight': torch.ones(1).expand(10**6, 10**6)},
    {f'linear{i}.weight': torch.ones(1).expand(300, 300) for i in range(1, 100)},
    {**LINEAR, 'linear1.weight': torch.eye(3).to_sparse()},
    {**LINEAR, 'linear1.weight': torch.ones(3, 2, device='meta')},
    {**LINEAR, 'linear1.weight': torch.ones(3, 2, dtype=torch.complex64)},
    {**LINEAR, 'linear1.weight': torch.ones(3, 2).to(torch.float8_e4m3fn)},
    {**LINEAR, 'linear1.weight': torch.ones(0, 2)}], ids=range(17))
def test_state_that_is_not_one_network_is_refused(tmp_path, state):
    torch.save(state, tmp_path / 'source.tar')
    assert_refused(tmp_path / 'source.tar')


@pytest.mark.filterwarnings('ignore')  # torch tells of what is new, and of what is old
def test_tensor_of_another_kind_is_refused(tmp_path):
    for weight in (torch.eye(3).to_sparse_csr(),
                   torch.nested.nested_tensor([torch.ones(2), torch.ones(3)]),
                   torch.quantize_per_tensor(torch.ones(3, 2), 0.1, 0, torch.qint8)):
        torch.save({**LINEAR, 'linear1.weight': weight}, tmp_path / 'source.tar')
        assert_refused(tmp_path / 'source.tar')


def test_tensors_are_refused_by_their_sum_before_any_is_copied(tmp_path, monkeypatch):
    torch.save({f'linear{i}.weight': torch.ones(1).expand(2900, 2900) for i in range(1, 100)},
               tmp_path / 'source.tar')
    # As an array each would take 64 MiB, all 6.4 GB.
    monkeypatch.setattr(torch.Tensor, 'numpy', None)
    assert_refused(tmp_path / 'source.tar')


def test_negated_view_is_read_as_the_numbers_that_it_shows(tmp_path):
    weight = torch._neg_view(torch.ones(3, 2, dtype=torch.float64))
    torch.save({**LINEAR, 'linear1.weight': weight}, tmp_path / 'source.tar')
    assert (read_layers(tmp_path / 'source.tar').weights[0] == -1.0).all()


def test_pointer_of_git_lfs_is_named_as_such(tmp_path):
    (tmp_path / 'source.tar').write_text(
        'version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n')
    assert_refused(tmp_path / 'source.tar')


def test_file_that_is_not_one_of_torch_is_refused(tmp_path):
    path = tmp_path / 'source.tar'
    assert_refused(path)
    assert_refused(tmp_path)
    for raw in (b'', b'PK\x03\x04' + bytes(100), pickle.dumps({'a': 1})[:5], b'\x80\x02' * 50):
        path.write_bytes(raw)
        assert_refused(path)


def test_tar_archive_of_ancient_torch_is_refused(tmp_path):
    (tmp_path / 'pickle').write_bytes(pickle.dumps(Malicious(tmp_path / 'executed')))
    with tarfile.open(tmp_path / 'source.tar', 'w') as archive:
        for name in ('sys_info', 'storages', 'tensors', 'pickle'):
            archive.add(tmp_path / 'pickle', name)
    assert_refused(tmp_path / 'source.tar')
    assert not (tmp_path / 'executed').exists()


def test_file_that_unpacks_to_more_than_the_limit_is_refused(tmp_path):
    path = tmp_path / 'source.tar'
    with (zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as archive,
          archive.open('archive/data.pkl', 'w', force_zip64=True) as member):
        for _ in range((MAX_BYTES >> 20) + 1):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 20
    assert_refused(path)


@pytest.mark.parametrize('more', [
    ['--coordinates', 'x,y', '--layout', 'hnn', '--box=-1:1'],
    ['--coordinates', 'x/y', '--layout', 'hnn', '--box=-1:1'],
    ['--coordinates', 'x', '--layout', 'sum_second_half', '--box=-1:1', '--out', 'm.pt'],
    ['--coordinates', 'x', '--layout', 'hnn', '--box=1:-1'],
    ['--coordinates', 'x', '--layout', 'hnn', '--box=-1:1,-1:1,0:1'],
    ['--coordinates', 'x', '--layout', 'hnn', '--box=one']])
def test_unusable_argument_gives_one_line(tmp_path, monkeypatch, more):
    monkeypatch.chdir(tmp_path)
    torch.save(Whole([2, 8, 2], 'tanh').state_dict(), 'source.tar')
    with refused(ParameterError):
        main(['source.tar', '--activation', 'tanh', *more])
    assert not (tmp_path / 'models').exists()


def test_network_of_another_layout_is_refused(tmp_path):
    torch.save(Whole([4, 8, 2], 'tanh').state_dict(), tmp_path / 'source.tar')
    with refused(ModelError):
        import_file(tmp_path / 'source.tar', 'tanh', 'sum_second_half', 'x,y')


@pytest.mark.parametrize('widths', [[3, 8, 2], [2, 100_001, 2]])
def test_network_that_is_no_function_of_q_and_p_is_refused(tmp_path, widths):
    torch.save(Whole(widths, 'tanh').state_dict(), tmp_path / 'source.tar')
    with refused(ModelError):
        import_file(tmp_path / 'source.tar', 'tanh', 'hnn', 'x')
    assert not (tmp_path / 'source.safetensors').exists()


def test_relu_network_is_imported_with_a_warning(tmp_path, capsys):
    torch.save(Whole([2, 8, 2], 'relu').state_dict(), tmp_path / 'source.tar')
    import_file(tmp_path / 'source.tar', 'relu', 'hnn', 'x')
    printed = capsys.readouterr().out
    assert printed.count('warning') == 1 and 'gradient of a relu network jumps' in printed


@given(cuts=st.lists(st.tuples(st.integers(0, 3000), st.integers(0, 16),
                               st.binary(max_size=16)), min_size=1, max_size=3))
@settings(max_examples=60)
def test_mutated_file_gives_model_error_or_layers(tmp_path_factory, cuts):
    path = tmp_path_factory.getbasetemp() / 'mutated.tar'
    torch.save(LINEAR, path)
    raw = path.read_bytes()
    for start, length, replacement in cuts:
        raw = raw[:start] + replacement + raw[start + length:]
    path.write_bytes(raw)
    try:
        read_layers(path)
    except HnnViRosError as problem:
        assert '\n' not in str(problem)
