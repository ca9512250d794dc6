# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The energy of a model along motions, against the work of motors and friction."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import StateError
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.learning.data.runs import Run, smoothed
from hnn_vi_ros.learning.judging.evaluation import balance, energy_mismatch, momentum, unaccounted
from hnn_vi_ros.models.confined import load_learned
import mechanical_models
import numpy as np
import pytest
from scipy.integrate import solve_ivp

RATE, GRAVITY = 0.4, 9.81


def exact_motion(spacing: float) -> Run:
    """Return a pendulum, damped and driven by 2 sin(2 t), to 1e-11, as it is without a filter."""
    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], -GRAVITY * np.sin(z[0]) - RATE * z[1] + 2.0 * np.sin(2.0 * t)]
    t = spacing * np.arange(round(4.0 / spacing) + 1)
    q, v = solve_ivp(rates, (0.0, t[-1] + 1e-9), [1.0, 0.0], t_eval=t, rtol=1e-11, atol=1e-12,
                     method='DOP853').y[..., None]
    motion = smoothed('exact', t, q, v, 2.0 * np.sin(2.0 * t)[:, None], 40.0)
    return replace(motion, q_smooth=q, v_smooth=v)


def mismatch(motion: Run, effects: list[Effect], horizon: float = 1.0) -> float:
    found = balance(HAMILTONIANS['pendulum'](), effects, motion)
    return energy_mismatch([found], motion.spacing, [horizon])[horizon]


def test_energy_mismatch_converges_with_order_2_to_zero_in_the_sample_interval():
    effects = [EFFECTS['damping'](RATE), EFFECTS['external_force'](['angle'])]
    found = [mismatch(exact_motion(spacing), effects) for spacing in (0.04, 0.02, 0.01)]
    assert found[2] < 1e-3
    for coarse, fine in pairwise(found):
        assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)
    # What the work of one of them is worth: without it nothing closes.
    for left_out in effects:
        assert mismatch(exact_motion(0.01), [left_out]) > 100.0 * found[2]


def test_energy_mismatch_counts_the_friction_that_a_model_has_learned(tmp_path: Path):
    model = mechanical_models.saved(tmp_path, 'joint')
    hamiltonian: Hamiltonian = load_learned(Path(model), confine=False)
    friction = EFFECTS['learned_friction'](model)

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        f_q, f_p = np.zeros((2, 1))
        H_q, H_p = hamiltonian.gradient(z[:1], z[1:])
        friction.add_force(own, t, z[:1], z[1:], H_p, f_q, f_p)
        return np.concatenate([H_p, f_p - H_q])
    own = friction.resolve(hamiltonian.coordinates, None)
    t = 0.01 * np.arange(301)
    q, p = solve_ivp(rates, (0.0, 3.0 + 1e-9), [0.8, 1.0], t_eval=t, rtol=1e-10, atol=1e-12
                     ).y[..., None]
    v = hamiltonian.gradient(q, p)[1]
    motion = replace(smoothed('joint', t, q, v, np.zeros_like(q), 40.0), q_smooth=q, v_smooth=v)
    np.testing.assert_allclose(momentum(hamiltonian, q, v, np.zeros_like(q)), p, atol=1e-10)
    with_friction, without = (
        energy_mismatch([balance(hamiltonian, effects, motion)], 0.01, [0.5])[0.5]
        for effects in ([friction], []))
    # Coulomb friction turns over within its width: less smooth than the motion of a pendulum.
    assert with_friction < 1e-3 < 0.05 < without


def test_energy_that_does_not_change_has_no_mismatch_and_noise_no_work_that_states_tell():
    motion = exact_motion(0.02)
    still = replace(motion, q_smooth=np.full_like(motion.q, 0.3), v_smooth=np.zeros_like(motion.q))
    assert energy_mismatch([balance(HAMILTONIANS['pendulum'](), [], still)], 0.02, [1.0]) is None
    assert unaccounted([EFFECTS['damping'](RATE), EFFECTS['gravity']('x')]) == []
    assert unaccounted([EFFECTS['thermostat'](1.0, 0.5)]) == ['Thermostat']


def test_velocity_without_a_momentum_is_one_line():
    class Flat(HAMILTONIANS['pendulum']):

        def gradient(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros_like(q), np.zeros_like(p)

        def hessian_vector(self, q: np.ndarray, p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray
                           ) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros_like(q), np.zeros_like(p)
    with pytest.raises(StateError, match=r'no momentum belongs to the velocity \[2.0\]'):
        momentum(Flat(), np.array([[0.1], [0.2]]), np.array([[0.0], [2.0]]), np.zeros((2, 1)))
