# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles: one file of several networks, whose mean is a Hamiltonian."""

import json
from pathlib import Path

from ensembles import ensemble, mechanisms
from helpers import random_checkpoint
from hnn_vi_ros import load_scene
from hnn_vi_ros.commands import scene_tool
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import ModelError, UnsupportedSystem
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.models import (
    EnsembleCard, load_checkpoint, load_learned, ModelCard, save_checkpoint)
from messages import misfit, refused
import numpy as np
import pytest
import safetensors.numpy

EPS = float(np.finfo(np.float64).eps)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / 'several.safetensors'
    save_checkpoint(path, ensemble(3))
    return path


def test_mean_has_the_mean_energy_gradient_and_hessian_of_its_members(model: Path):
    mean = load_learned(model)
    members = [load_learned(model, member=k) for k in (1, 2, 3)]
    q, p, v, w = np.random.default_rng(0).normal(size=(4, 5, 1))
    for name, arguments in (('energy', (q, p)), ('gradient', (q, p)),
                            ('hessian_vector', (q, p, v, w))):
        found = np.array(getattr(mean, name)(*arguments))
        parts = np.array([getattr(one, name)(*arguments) for one in members])
        # Of three numbers of order one, each sum rounds a few times.
        np.testing.assert_allclose(found, parts.mean(axis=0), rtol=0.0,
                                   atol=16.0 * EPS * np.abs(parts).max())


def test_ensemble_is_saved_and_loaded_to_the_last_bit(model: Path):
    before, after = ensemble(3), load_checkpoint(model, ensembles=True)
    assert after.card == before.card and after.networks == {}
    for one, other in zip(before.members, after.members, strict=True):
        for a, b in zip(*(sum(part.networks['energy'], ()) for part in (one, other)), strict=True):
            assert a.tobytes() == b.tobytes()


def test_what_wants_one_model_refuses_an_ensemble(model: Path):
    with refused(ModelError):
        load_checkpoint(model)
    with refused(ModelError):
        EFFECTS['learned_dissipation'](str(model))


@pytest.mark.parametrize('number', [4, 0])
def test_member_that_is_not_there_is_refused(model: Path, number: int):
    with refused(ModelError):
        load_learned(model, member=number)


def test_member_of_a_model_that_is_no_ensemble_is_refused(tmp_path: Path):
    save_checkpoint(tmp_path / 'one.safetensors', random_checkpoint([2, 4, 1], 0))
    with refused(ModelError):
        load_learned(tmp_path / 'one.safetensors', member=1)


def test_file_without_a_tensor_of_a_member_is_refused(model: Path):
    tensors = safetensors.numpy.load(model.read_bytes())
    with safetensors.safe_open(model, 'numpy') as file:
        metadata = file.metadata()
    del tensors['member2.linear1.bias']
    model.write_bytes(safetensors.numpy.save(tensors, metadata))
    with refused(ModelError):
        load_checkpoint(model, ensembles=True)


def card_data(card: ModelCard) -> dict:
    """Return what a file holds of a card."""
    return json.loads(card.model_dump_json(exclude_none=True))


@pytest.mark.parametrize('changes', [
    {'family': 'dgnet', 'friction': [0.1]}, {'activation': 'sine'}, {'widths': [2, 5, 1]}])
def test_members_that_differ_are_refused(changes: dict):
    data = card_data(ensemble(2).card)
    data['ensemble']['members'][1] |= changes
    with misfit():
        ModelCard.model_validate(data)


@pytest.mark.parametrize('changes', [
    {'features': [[1.0, 0.0], [0.0, 1.0]]}, {'input_map': [[1.0], [0.5]]},
    {'mass_features': [[0.0, 2.0]]}])
def test_mechanisms_that_are_not_alike_are_refused(changes: dict):
    data = card_data(mechanisms('arm', 2).card)
    data['ensemble']['members'][1]['mechanical'] |= changes
    with misfit():
        ModelCard.model_validate(data)


def test_one_factor_of_version_0_2_is_that_of_all():
    data = card_data(ensemble(2).card)
    del data['ensemble']['factors']
    data['ensemble']['factor'] = 3.5
    assert ModelCard.model_validate(data).ensemble.factors == [3.5, 3.5]
    for members in ([], [1, 2], 'none', [{'coordinates': 3}]):
        with misfit():
            EnsembleCard.model_validate({'factor': 3.5, 'members': members})


def test_factors_must_be_as_many_as_coordinates_and_momenta():
    data = card_data(ensemble(2).card)
    data['ensemble']['factors'] = [1.0, 2.0, 3.0]
    with misfit():
        ModelCard.model_validate(data)


def test_ensemble_of_ensembles_is_refused():
    card = ensemble(2).card
    nested = EnsembleCard.model_construct(members=[card, card])
    with misfit():
        ModelCard.model_validate(card.model_copy(update={'ensemble': nested}).model_dump())


def test_what_takes_the_networks_of_one_model_refuses_a_mean_and_names_members(model: Path):
    torch = pytest.importorskip('torch', reason='torch is not installed')
    from hnn_vi_ros.simulation.batches.gradient import make_gradient
    from hnn_vi_ros.torch import with_weights
    mean = load_learned(model)
    with refused(UnsupportedSystem):
        with_weights(mean, {'linear1.weight': np.zeros((6, 2))})
    with refused(UnsupportedSystem):
        make_gradient(mean, torch.device('cpu'))


def test_check_of_a_scene_finds_uncertainty_that_no_ensemble_has(
        tmp_path: Path, capsys: pytest.CaptureFixture):
    scene = load_scene('exact_pendulum').changed({'uncertainty': {'limit': 0.2}})
    (tmp_path / 'scene.yaml').write_text(dump_yaml(scene.model_dump(exclude_none=True)))
    assert scene_tool.main(['--check', str(tmp_path / 'scene.yaml')]) == 1
    assert 'hamiltonian: is not the mean of an ensemble' in capsys.readouterr().err
