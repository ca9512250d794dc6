# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Model files: exact round trips, a typed error for every defect, and no code execution."""

import hashlib
import json
from pathlib import Path
import pickle
import subprocess
import sys

from helpers import Malicious
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.models import (
    Box, Checkpoint, CoordinateCard, Layers, load_checkpoint, ModelCard, save_checkpoint)
from hnn_vi_ros.models.checkpoint import MAX_BYTES
from hypothesis import given, settings, strategies as st
from messages import refused
import numpy as np
import pytest
import safetensors.numpy

SHIPPED = shipped_file('model', 'harmonic_oscillator').read_bytes()


def make_checkpoint(**changes) -> Checkpoint:
    rng = np.random.default_rng(7)
    card = ModelCard(**{
        'name': 'small', 'widths': [2, 3, 1],
        'coordinates': [CoordinateCard(name='x', q_unit='m', p_unit='kg m/s')],
        'box': Box(q=[[-1.0, 2.0]], p=[[0.1, 0.3]]), 'dataset': 'none', 'seed': 3,
        'losses': {'train_loss': 0.1 + 0.2}, 'training_command': 'train --config small',
        'package_version': '0.1.0', **changes})
    return Checkpoint(card, {'energy': Layers((rng.normal(size=(3, 2)), rng.normal(size=(1, 3))),
                                              (rng.normal(size=3), rng.normal(size=1)))})


def write(path: Path, changes=None, card=None, **tensors) -> Path:
    """Write a model file whose card or tensors may be defective."""
    checkpoint = make_checkpoint()
    content = checkpoint.card.model_dump() | (changes or {})
    content = {key: value for key, value in content.items() if value != 'missing'}
    weights, biases = checkpoint.networks['energy']
    parts = {'linear1.weight': weights[0], 'linear1.bias': biases[0],
             'linear2.weight': weights[1], 'linear2.bias': biases[1],
             **{name.replace('__', '.'): value for name, value in tensors.items()}}
    raw = safetensors.numpy.save(
        {name: value for name, value in parts.items() if value is not None},
        {'model_card': json.dumps(content) if card is None else card})
    path.write_bytes(raw)
    return path


def assert_refused(path):
    with refused(ModelError):
        load_checkpoint(path)


def test_checkpoint_round_trip_is_exact(tmp_path):
    saved = make_checkpoint()
    path = tmp_path / 'new folder' / 'small.safetensors'
    save_checkpoint(path, saved)
    loaded = load_checkpoint(path)
    assert loaded.card == saved.card
    for name in ('weights', 'biases'):
        arrays = (getattr(model.networks['energy'], name) for model in (loaded, saved))
        for a, b in zip(*arrays, strict=True):
            assert a.dtype == np.float64
            assert a.tobytes() == b.tobytes() and a.shape == b.shape
    assert loaded.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert [entry.name for entry in path.parent.iterdir()] == ['small.safetensors']


def test_float32_tensors_load_as_float64(tmp_path):
    weight = np.float32([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    loaded = load_checkpoint(write(tmp_path / 'm.safetensors', linear1__weight=weight))
    assert loaded.networks['energy'].weights[0].dtype == np.float64
    assert np.array_equal(loaded.networks['energy'].weights[0], weight.astype(np.float64))


def test_save_checkpoint_never_overwrites(tmp_path):
    path = tmp_path / 'm.safetensors'
    path.write_text('precious')
    with refused(ModelError):
        save_checkpoint(path, make_checkpoint())
    assert path.read_text() == 'precious'


def test_save_checkpoint_refuses_tensors_that_contradict_the_card(tmp_path):
    path = tmp_path / 'm.safetensors'
    with refused(ModelError):
        save_checkpoint(path, make_checkpoint(widths=[2, 4, 1]))
    assert not path.exists()


@pytest.mark.parametrize('raw', [
    b'', SHIPPED[:4], SHIPPED[:500], SHIPPED[:-1], SHIPPED + b'\0', b'\xff' * 1000,
    b'[' * 100_000, (10**5).to_bytes(8, 'little') + b'[' * 10**5,
    pickle.dumps({'weight': [1.0]}), b'PK\x03\x04' + bytes(100)], ids=range(10))
def test_damaged_model_file_gives_model_error(tmp_path, raw):
    path = tmp_path / 'm.safetensors'
    path.write_bytes(raw)
    assert_refused(path)


@pytest.mark.parametrize('tensors', [
    {'linear1__weight': np.zeros((2, 3))}, {'linear1__bias': np.full(3, np.nan)},
    {'linear2__weight': np.full((1, 3), np.inf)}, {'linear2__bias': np.zeros(1, dtype=np.int64)},
    {'linear2__bias': np.zeros(1, dtype=np.float16)}, {'linear2__bias': None},
    {'linear3__bias': np.zeros(1)}],
    ids=['transposed', 'nan', 'infinite', 'integer', 'half', 'missing', 'unknown'])
def test_wrong_tensor_gives_model_error(tmp_path, tensors):
    assert_refused(write(tmp_path / 'm.safetensors', **tensors))


@pytest.mark.parametrize('changes', [
    {'colour': 'red'}, {'box': 'missing'}, {'format_version': 2}, {'widths': [4, 3, 1]},
    {'widths': [2, 0, 1]}, {'widths': [2, 10**9, 1]}, {'widths': [2, 1]},
    {'activation': 'cosine'}, *({'box': {'q': q, 'p': p}} for q, p in (
        ([[1.0, 1.0]], [[0.1, 0.3]]), ([[2.0, 1.0]], [[0.1, 0.3]]),
        ([[-1.7e308, 1.7e308]], [[0.1, 0.3]]), ([[0.0, float('nan')]], [[0.1, 0.3]]),
        ([[0.0, 1.0]] * 2, [[0.0, 1.0]] * 2))),
    {'coordinates': [{'name': 'x'}] * 2}, {'coordinates': [{'name': 'a/b'}]},
    {'coordinates': [{'name': 'x', 'q_unit': '*/\nint x;'}]}], ids=range(16))
def test_wrong_model_card_gives_model_error(tmp_path, changes):
    assert_refused(write(tmp_path / 'm.safetensors', changes))


@pytest.mark.parametrize('card', ['', '{', '[]', '[' * 10_000, '"text"'], ids=range(5))
def test_model_card_that_is_not_a_card_gives_model_error(tmp_path, card):
    assert_refused(write(tmp_path / 'm.safetensors', card=card))


def test_safetensors_file_of_others_gives_model_error(tmp_path):
    path = tmp_path / 'other.safetensors'
    path.write_bytes(safetensors.numpy.save({'weight': np.zeros(3)}))
    assert_refused(path)


def test_missing_directory_and_huge_files_give_model_error(tmp_path):
    assert_refused(tmp_path / 'none.safetensors')
    assert_refused(tmp_path)
    huge = tmp_path / 'huge.safetensors'
    with huge.open('wb') as stream:
        stream.truncate(MAX_BYTES + 1)
    assert_refused(huge)


@pytest.mark.parametrize('writer', ['pickle', 'torch'])
def test_malicious_pickle_is_refused_and_not_executed(tmp_path, writer):
    marker, path = tmp_path / 'executed', tmp_path / 'm.safetensors'
    if writer == 'pickle':
        path.write_bytes(pickle.dumps(Malicious(marker)))
    else:
        import torch
        torch.save({'weight': Malicious(marker)}, path)
    assert_refused(path)
    assert not marker.exists()
    if writer == 'pickle':
        pickle.loads(path.read_bytes())
        assert marker.exists()  # the file would have done it


@given(cuts=st.lists(st.tuples(
    st.one_of(st.integers(0, 2000), st.integers(0, len(SHIPPED))),
    st.integers(0, 16), st.binary(max_size=16)), min_size=1, max_size=4) | st.tuples(
        st.tuples(st.integers(0, 2000), st.just(1), st.binary(min_size=1, max_size=1))))
@settings(max_examples=400)
def test_mutated_model_gives_model_error_or_a_valid_model(tmp_path_factory, cuts):
    raw = SHIPPED
    for start, length, replacement in cuts:
        raw = raw[:start] + replacement + raw[start + length:]
    path = tmp_path_factory.getbasetemp() / 'mutated.safetensors'
    path.write_bytes(raw)
    try:
        loaded = load_checkpoint(path)
    except ModelError as problem:
        assert '\n' not in str(problem)
    else:
        assert all(np.isfinite(part).all() for parts in loaded.networks['energy']
                   for part in parts)


def test_loading_a_model_imports_no_torch():
    code = ('import sys; from hnn_vi_ros.models.checkpoint import load_checkpoint; '
            'load_checkpoint(sys.argv[1]); assert "torch" not in sys.modules')
    subprocess.run(
        [sys.executable, '-c', code, str(shipped_file('model', 'harmonic_oscillator'))],
        check=True, timeout=60)
