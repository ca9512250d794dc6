# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Modules of others: the same energy as their source, and nothing of a file is run."""

import codecs
from collections import Counter
from itertools import pairwise, product
from pathlib import Path
import pickle
import zipfile

from helpers import Malicious
from hnn_vi_ros.errors import HnnViRosError, ModelError
from hnn_vi_ros.learning.import_model import main, MAX_BYTES, perceptron_of, read_state
from hnn_vi_ros.learning.torch_file import load_tensors
from hnn_vi_ros.models import load_learned
from hypothesis import given, settings, strategies as st
from messages import refused
import numpy as np
import pytest
import safetensors.torch
import torch

ROOT = Path(__file__).resolve().parents[2]
FUNNEL = ROOT.parent / 'shared' / 'data' / 'foreign' / 'neal_funnel_hnn.tar'
CODE = """\
import torch

class Layers(torch.nn.Module):
    def __init__(self, widths, function):
        super().__init__()
        self.depth, self.function = len(widths) - 1, function
        for k in range(1, len(widths)):
            setattr(self, f'linear{k}', torch.nn.Linear(
                widths[k - 1], widths[k], bias=k < self.depth))

    def forward(self, x):
        for k in range(1, self.depth):
            x = self.function(getattr(self, f'linear{k}')(x))
        return getattr(self, f'linear{self.depth}')(x)

class HNN(torch.nn.Module):
    def __init__(self, widths, function, layout):
        super().__init__()
        self.differentiable_model, self.layout = Layers(widths, function), layout

    def forward(self, x):
        outputs = self.differentiable_model(x)
        half = outputs.shape[1] // 2
        return outputs[:, 1] if self.layout == 'hnn' else outputs[:, half:].sum(1)

def hnn():
    return HNN([4, 9, 9, 2], torch.tanh, 'hnn')

def sum_second_half():
    return HNN([4, 100, 100, 100, 100, 4], torch.sin, 'sum_second_half')

def number():
    return 3.0
"""


def assert_alike(model: Path, module: torch.nn.Module, d: int) -> None:
    q, p = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 50, d))
    expected = module.double()(torch.tensor(np.hstack([q, p]))).detach().numpy().ravel()
    found = load_learned(model).energy(q, p)
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize('layout', [
    'hnn', pytest.param('sum_second_half', marks=pytest.mark.long)])
def test_module_of_code_with_weights_is_that_of_torch(tmp_path, capsys, layout):
    (tmp_path / f'code_of_{layout}.py').write_text(CODE)
    names: dict[str, object] = {}
    exec(CODE, names)
    torch.manual_seed(0)
    module, weights = names[layout](), tmp_path / 'weights.tar'
    torch.save(module.state_dict(), weights)
    if layout == 'sum_second_half' and FUNNEL.is_file():
        weights = FUNNEL
        module.load_state_dict(torch.load(FUNNEL, weights_only=True))
    main([f'{tmp_path}/code_of_{layout}.py:{layout}', '--weights', str(weights), '--coordinates',
          'q1,q2', '--box=-2:2', '--out', str(tmp_path / 'model.safetensors')])
    told = capsys.readouterr().out
    assert f'running {layout}() of' in told and 'next: hnn run SCENE.yaml, a scene with' in told
    assert_alike(tmp_path / 'model.safetensors', module, 2)


class Sine(torch.nn.Module):
    """The sine between layers."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return sin(x)."""
        return torch.sin(x)


ACTIVATION_MODULES = {'tanh': torch.nn.Tanh, 'sine': Sine, 'relu': torch.nn.ReLU,
                      'softplus': torch.nn.Softplus}


def sequential(activation: str, *widths: int) -> torch.nn.Sequential:
    torch.manual_seed(sum(widths))
    layers = [part for a, b in pairwise(widths)
              for part in (torch.nn.Linear(a, b), ACTIVATION_MODULES[activation]())]
    return torch.nn.Sequential(*layers[:-1])


@pytest.mark.parametrize('activation', ACTIVATION_MODULES)
def test_state_of_a_sequential_module_is_imported(tmp_path, activation):
    module = sequential(activation, 2, 9, 9, 1)
    torch.save(module.state_dict(), tmp_path / 'source.pt')
    import_file(tmp_path, '--activation', activation)
    assert_alike(tmp_path / 'model.safetensors', module, 1)


@pytest.mark.parametrize('key, prefix', [
    ('model_state', ''), ('state_dict', 'module.'), ('net', '_orig_mod.'), ('', 'net.'),
    ('safetensors', '')])
def test_state_is_found_in_a_checkpoint(tmp_path, capsys, key, prefix):
    module = sequential('tanh', 2, 9, 1)
    state = {prefix + name: part for name, part in module.state_dict().items()}
    if key == 'safetensors':
        safetensors.torch.save_file(state, tmp_path / 'source.pt')
    else:
        torch.save({key: state, 'epoch': 3, 'optimizer_state': {'lr': 0.1}} if key else state,
                   tmp_path / 'source.pt')
    import_file(tmp_path, '--activation', 'tanh')
    assert_alike(tmp_path / 'model.safetensors', module, 1)
    told = capsys.readouterr().out
    assert (repr(key) in told) == (key not in ('', 'safetensors'))
    assert 'taken as Linear(2, 9), tanh, Linear(9, 1)\n' in told


@pytest.mark.parametrize('numbers', [
    {'loss': np.float64(1.5), 'step': np.int64(3), 'best': np.bool_(True)},
    {'loss': np.float32(1.5), 'mask': torch.ones(2)}])
def test_numbers_of_numpy_beside_the_weights_are_not_read(tmp_path, numbers):
    module = sequential('tanh', 2, 9, 1)
    torch.save({'net': module.state_dict(), **numbers}, tmp_path / 'source.pt')
    import_file(tmp_path, '--activation', 'tanh')
    assert_alike(tmp_path / 'model.safetensors', module, 1)


def test_entry_names_one_of_several_state_dicts(tmp_path):
    module = sequential('tanh', 2, 9, 1)
    torch.save({'net': LINEAR, 'ema': module.state_dict()}, tmp_path / 'source.pt')
    import_file(tmp_path, '--activation', 'tanh', '--entry', 'ema')
    assert_alike(tmp_path / 'model.safetensors', module, 1)
    for entry in ('epoch', 'none'):
        with refused(ModelError):
            read_state(tmp_path / 'source.pt', entry)


def test_prefix_of_lightning_is_removed_and_half_precision_is_remarked(tmp_path, capsys):
    (tmp_path / 'code_of_layers.py').write_text(CODE.replace('def hnn():', (
        'def layers():\n    return Layers([2, 9, 1], torch.tanh)\n\ndef hnn():')))
    names: dict[str, object] = {}
    exec(CODE, names)
    module = names['Layers']([2, 9, 1], torch.tanh).half()
    torch.save({'state_dict': {'loss.weight': torch.ones(3), **{
        f'model.net.{name}': part for name, part in module.state_dict().items()}}},
        tmp_path / 'lightning.ckpt')
    main([f'{tmp_path}/code_of_layers.py:layers', '--weights', str(tmp_path / 'lightning.ckpt'),
          '--coordinates', 'x', '--box=-2:2', '--out', str(tmp_path / 'model.safetensors')])
    assert_alike(tmp_path / 'model.safetensors', module, 1)
    assert 'weights of float16' in capsys.readouterr().out


@pytest.mark.filterwarnings('ignore')  # torch tells of what is old
def test_program_of_torch_is_refused_with_the_call_that_loads_it(tmp_path):
    module = sequential('tanh', 2, 9, 1)
    torch.jit.script(module).save(tmp_path / 'script.pt')
    torch.export.save(torch.export.export(module, (torch.ones(1, 2),)), tmp_path / 'program.pt2')
    for name in ('script.pt', 'program.pt2'):
        with refused(ModelError):
            read_state(tmp_path / name)


def import_file(folder: Path, *more: str) -> None:
    main([str(folder / 'source.pt'), '--coordinates', 'x', '--box=-2:2', '--out',
          str(folder / 'model.safetensors'), *more])


@pytest.mark.parametrize('legacy', [False, True])
def test_pickle_with_a_payload_is_refused_and_not_run(tmp_path, legacy):
    marker, path = tmp_path / 'executed', tmp_path / 'source.tar'
    torch.save({**LINEAR, 'extra': Malicious(marker)}, path,
               _use_new_zipfile_serialization=not legacy)
    assert_refused(path)
    assert not marker.exists()
    torch.load(path, weights_only=False)
    assert marker.exists()  # the file would have done it


def assert_refused(path: Path) -> None:
    with refused(ModelError):
        perceptron_of(path, read_state(path)[0], 'tanh')


LINEAR = {'0.weight': torch.ones(3, 2), '0.bias': torch.ones(3), '2.weight': torch.ones(1, 3)}


@pytest.mark.parametrize('keys', [
    [k * (2**61 - 1) for k in range(1, 2000)], [*product((-1, -2), repeat=10)]])
def test_keys_of_one_hash_are_refused_before_they_take_their_time(tmp_path, keys):
    torch.save(dict.fromkeys(keys), tmp_path / 'a.pt')
    with pytest.raises(ValueError, match='integers'):
        load_tensors(tmp_path / 'a.pt', 1 << 20)


@pytest.mark.parametrize('state', [
    [torch.ones(2)], {}, {'a': LINEAR, 'b': LINEAR}, {'conv1.weight': torch.ones(2, 2, 3)},
    {**LINEAR, 'D.0.weight': torch.ones(3, 2)}, {'epoch': 3},
    {**LINEAR, '4.weight': torch.ones(2, 2)}, {**LINEAR, '2.weight': torch.ones(1, 4)},
    {**LINEAR, '2.weight': torch.ones(2, 3)}, {**LINEAR, 'scale': torch.ones(1)},
    {**LINEAR, '0.bias': torch.ones(4)},
    {**LINEAR, '0.bias': torch.full((3,), np.nan)},
    {**LINEAR, '0.weight': torch.ones(1).expand(10**6, 10**6)},
    {f'{2 * i}.weight': torch.ones(1).expand(300, 300) for i in range(99)},
    {**LINEAR, '0.weight': torch.eye(3).to_sparse()},
    {**LINEAR, '0.weight': torch.ones(3, 2, device='meta')},
    {**LINEAR, '0.weight': torch.ones(3, 2, dtype=torch.complex64)},
    {**LINEAR, '0.weight': torch.ones(3, 2).to(torch.float8_e4m3fn)},
    {**LINEAR, '0.weight': torch.ones(0, 2)},
    # What is between layers with names, or without one activation between two, is unknown.
    {'frame.first.weight': torch.ones(3, 2), 'frame.last.weight': torch.ones(1, 3)},
    *({f'{k}.weight': torch.ones(1, 1) for k in places} for places in ((0, 1), (0, 3), (2, 0))),
    {'0.weight': torch.ones(3, 2), 'last.2.weight': torch.ones(1, 3)}], ids=range(24))
def test_state_that_is_not_one_network_is_refused(tmp_path, state):
    torch.save(state, tmp_path / 'source.tar')
    assert_refused(tmp_path / 'source.tar')


@pytest.mark.filterwarnings('ignore')  # torch tells of what is new, and of what is old
def test_tensor_of_another_kind_is_refused(tmp_path):
    for weight in (torch.eye(3).to_sparse_csr(),
                   torch.nested.nested_tensor([torch.ones(2), torch.ones(3)]),
                   torch.quantize_per_tensor(torch.ones(3, 2), 0.1, 0, torch.qint8)):
        torch.save({**LINEAR, '0.weight': weight}, tmp_path / 'source.tar')
        assert_refused(tmp_path / 'source.tar')


def test_tensors_are_refused_by_their_sum_before_any_is_copied(tmp_path, monkeypatch):
    torch.save({f'{2 * i}.weight': torch.ones(1).expand(2900, 2900) for i in range(99)},
               tmp_path / 'source.tar')
    # As an array each would take 64 MiB, all 6.4 GB.
    monkeypatch.setattr(torch.Tensor, 'numpy', None)
    assert_refused(tmp_path / 'source.tar')


def test_negated_view_is_read_as_the_numbers_that_it_shows(tmp_path):
    weight = torch._neg_view(torch.ones(3, 2, dtype=torch.float64))
    torch.save({**LINEAR, '0.weight': weight}, tmp_path / 'source.tar')
    assert (read_state(tmp_path / 'source.tar')[0]['0.weight'] == -1.0).all()


def test_file_that_is_not_one_of_torch_is_refused(tmp_path):
    path = tmp_path / 'source.tar'
    assert_refused(path)
    assert_refused(tmp_path)
    for raw in (b'', b'PK\x03\x04' + bytes(100), pickle.dumps({'a': 1})[:5], b'\x80\x02' * 50):
        path.write_bytes(raw)
        assert_refused(path)


class Called:
    """An object whose pickle calls a type with arguments."""

    def __init__(self, *called: object):
        self.called = called

    def __reduce__(self):
        return self.called


def nested(depth: int) -> tuple:
    """Return a tuple of 2^depth items; hashing it takes as many steps."""
    return () if depth == 0 else (nested(depth - 1),) * 2


@pytest.mark.filterwarnings('ignore')  # types of tensors are deprecated
@pytest.mark.parametrize('legacy', [False, True])
@pytest.mark.parametrize('called', [
    (bytearray, (10**13,)), (codecs.encode, (b'a' * 9, 'hex')), (torch.Tensor, (10**13,)),
    (torch.FloatTensor, (10**13,)), (Counter, (['a'],))], ids=lambda called: called[0].__name__)
def test_type_that_makes_much_of_little_is_not_called(tmp_path, monkeypatch, legacy, called):
    path = tmp_path / 'source.tar'
    torch.save({**LINEAR, 'extra': Called(*called)}, path,
               _use_new_zipfile_serialization=not legacy)
    monkeypatch.setattr(torch, 'load', None)
    with refused(ModelError):
        read_state(path)
    with pytest.raises(ValueError, match='contains'):
        load_tensors(path, MAX_BYTES)


@pytest.mark.parametrize('legacy', [False, True])
def test_tuple_that_takes_long_to_hash_is_refused(tmp_path, legacy):
    path = tmp_path / 'source.tar'
    torch.save({**LINEAR, 'extra': [nested(40)]}, path, _use_new_zipfile_serialization=not legacy)
    assert_refused(path)


def test_state_of_an_optimiser_is_loaded(tmp_path):
    module = sequential('tanh', 2, 9, 1)
    optimiser = torch.optim.AdamW([{'params': [one]} for one in module.parameters()])
    module(torch.ones(1, 2)).sum().backward()
    optimiser.step()
    state = {'optimiser': optimiser.state_dict(), 'drawn': torch.get_rng_state()}
    torch.save(state, tmp_path / 'source.pt')
    found = load_tensors(tmp_path / 'source.pt', MAX_BYTES)
    assert found['optimiser']['param_groups'] == state['optimiser']['param_groups']
    assert torch.equal(found['drawn'], state['drawn'])


def test_file_that_unpacks_to_more_than_the_limit_is_refused(tmp_path):
    path = tmp_path / 'source.tar'
    with (zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as archive,
          archive.open('archive/data.pkl', 'w', force_zip64=True) as member):
        for _ in range((MAX_BYTES >> 20) + 1):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 20
    assert_refused(path)


@pytest.mark.parametrize('more', [
    ['--coordinates', 'x,y'], ['--coordinates', 'x/y'], ['--out', 'm.pt'], ['--box=1:-1'],
    ['--box=-1:1,-1:1,0:1'], ['--box=one'], ['--weights', 'source.pt']])
def test_unusable_argument_gives_one_line(tmp_path, monkeypatch, more):
    monkeypatch.chdir(tmp_path)
    torch.save(sequential('tanh', 2, 8, 1).state_dict(), 'source.pt')
    usual = [word for word in ('--activation=tanh', '--coordinates=x', '--box=-1:1')
             if not more[0].startswith(word.partition('=')[0])]
    with refused(HnnViRosError):
        main(['source.pt', *usual, *more])
    assert not (tmp_path / 'models').exists()


@pytest.mark.parametrize('source, more', [
    ('mine.py:number', []), ('mine.py:nothing', []), ('none.py:hnn', []),
    ('mine.py:hnn', ['--weights', 'source.pt']), ('source.pt', [])])
def test_module_that_cannot_be_made_is_refused(tmp_path, monkeypatch, source, more):
    monkeypatch.chdir(tmp_path)
    Path('mine.py').write_text(CODE)
    torch.save(sequential('tanh', 2, 8, 1).state_dict(), 'source.pt')
    with refused(HnnViRosError):
        main([source, '--coordinates', 'x,y', '--box=-1:1', *more])


@given(cuts=st.lists(st.tuples(st.integers(0, 3000), st.integers(0, 16),
                               st.binary(max_size=16)), min_size=1, max_size=3))
@settings(max_examples=60)
def test_mutated_file_gives_model_error_or_tensors(tmp_path_factory, cuts):
    path = tmp_path_factory.getbasetemp() / 'mutated.tar'
    torch.save(LINEAR, path)
    raw = path.read_bytes()
    for start, length, replacement in cuts:
        raw = raw[:start] + replacement + raw[start + length:]
    path.write_bytes(raw)
    try:
        read_state(path)
    except HnnViRosError as problem:
        assert '\n' not in str(problem)
