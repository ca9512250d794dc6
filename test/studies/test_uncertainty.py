# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The study of ensemble spread: coverage with its error, and detection for machines."""

from pathlib import Path

from ensembles import mechanisms, scaled, together
from hnn_vi_ros.hamiltonians import momentum
from hnn_vi_ros.models import load_learned, save_checkpoint
from mechanical_models import random_mechanical
import numpy as np
import pytest
from studies.uncertainty import acceleration_spread, accelerations, coverage, detection


def test_error_of_a_coverage_is_that_of_independent_motions():
    rng = np.random.default_rng(0)
    # Motions whose instants are all alike: as good as one each.
    covered = [np.full((rng.integers(5, 20), 2), rng.random() < 0.9) for _ in range(400)]
    share, error = coverage(covered)
    assert share.shape == error.shape == (3,)
    np.testing.assert_allclose(share, np.concatenate(covered).mean(), rtol=1e-12)
    # (0.9 x 0.1 / 400)^(1/2) for motions of one length; sizes of 5 to 20 make it 1.06 times that.
    assert error[0] == pytest.approx(np.sqrt(share[0] * (1.0 - share[0]) / 400), rel=0.2)
    share, error = coverage([np.array([[True, False]] * 4)] * 3)
    assert share.tolist() == [0.5, 1.0, 0.0] and error.tolist() == [0.0, 0.0, 0.0]


def test_members_that_differ_by_a_factor_have_one_acceleration(tmp_path: Path):
    base, file = random_mechanical('worn'), str(tmp_path / 'm.safetensors')
    model = together([base, scaled(base, 3.0)])
    save_checkpoint(file, model)
    q, p = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 5, 2))
    assert acceleration_spread(file, model, q, p).max() < 1e-10


def test_acceleration_of_a_member_without_friction_is_that_of_its_hamiltonian(tmp_path: Path):
    model = mechanisms('double pendulum', 2)
    file = tmp_path / 'm.safetensors'
    save_checkpoint(file, model)
    own = load_learned(file, confine=False, member=2)
    q, v = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 4, 2))
    friction = accelerations(str(file), 2, q, v) - accelerations(str(file), 2, q, -v)
    p, h = momentum(own, q, v, np.zeros_like(v)), 1e-5

    def velocity(t: float) -> np.ndarray:
        dH_dq, dH_dp = own.gradient(q, p)
        return own.gradient(q + t * dH_dp, p - t * dH_dq)[1]
    found = (velocity(h) - velocity(-h)) / (2.0 * h)
    # Friction is odd in the velocity, all else even; the difference errs by h^2 and 1e-16 / h.
    np.testing.assert_allclose(
        accelerations(str(file), 2, q, v) - 0.5 * friction, found, rtol=0.0, atol=1e-7)


def test_angle_is_inside_of_its_box_less_whole_turns():
    model = mechanisms('eccentric', 2)
    box = model.card.box.model_copy(update={'q': [[0.0, 2.0 * np.pi - 1e-9]], 'p': [[-1.0, 1.0]]})
    whole = model.card.model_copy(update={'box': box})
    seen = []

    def spread(q: np.ndarray, p: np.ndarray) -> np.ndarray:
        seen.append(p)
        return np.abs(p[:, 0])
    # All angles are inside, so what is outside is so by its momentum.
    assert detection(type(model)(whole, {}, members=model.members), spread) == 1.0
    assert np.abs(seen[0]).max() <= 1.0 < np.abs(seen[1]).min()
