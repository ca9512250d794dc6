# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Energy of models along motions, against work, and how well a card knows it."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from hnn_vi_ros.effects import Effect, EFFECTS
from hnn_vi_ros.errors import StateError
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.learning import EvenMotion
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.families.base import EnergyFamily
from hnn_vi_ros.learning.judging.energy import (
    balance, energy_mismatch, friction_work, momentum, unaccounted)
from hnn_vi_ros.learning.tasks.field import model_work
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models import (
    energy_error, energy_spread, interval_text, load_checkpoint, load_learned)
import mechanical_models
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch

GRAVITY = 9.81
CONFIG = """
coordinates: [{name: angle, q_unit: rad, p_unit: kg m^2/s}]
data: {kind: measured, path: log.txt, columns: [run, t, q, p], trial: run, time: t, q: [q], p: [p],
  derivatives: {kind: savitzky_golay, window: 0.1, degree: 4}}
family: {kind: FAMILY}
hidden: [8]
adam_steps: 30
lbfgs_steps: 100
"""


def motions(viscous: float, dry: float) -> tuple[np.ndarray, ...]:
    """Return time, q, p and number of two pendulums with friction, every 10 ms for 8 s."""
    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], -GRAVITY * np.sin(z[0]) - viscous * z[1] - dry * np.tanh(z[1] / 0.01)]
    t = 0.01 * np.arange(801)
    runs = [solve_ivp(rates, (0.0, 8.01), [start, 0.0], t_eval=t, rtol=1e-9, atol=1e-10,
                      method='LSODA').y for start in (2.0, 1.4)]
    q, p = np.concatenate(runs, axis=1)
    return np.tile(t, 2), q, p, np.repeat([0, 1], 801)


def energy(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    return 0.5 * p**2 + GRAVITY * (1.0 - np.cos(q))


def test_friction_of_a_machine_is_no_error_of_its_energy():
    t, q, p, runs = motions(0.1, 0.05)
    true = energy(q, p)
    work, power = friction_work(true, runs, t, p[:, None])
    lost = sum(true[runs == run][0] - true[runs == run][-1] for run in (0, 1))
    # The sign of v in place of the tanh, and trapezoids over its jumps: some per mille.
    assert power == pytest.approx(lost / 16.0, rel=0.01)
    as_an_error = energy_spread(true, runs, 0)
    error = energy_spread(true, runs, 0, work, 'work of fitted friction')
    assert as_an_error.rms > 1.0 and error.rms < 0.005 * as_an_error.rms
    assert error.against == 'work of fitted friction' and error.spread > 1.0
    # What is wrong with a model stays, beside the friction.
    wrong = true + 0.1 * np.sin(3.0 * q)
    found = energy_spread(wrong, runs, 0, friction_work(wrong, runs, t, p[:, None])[0])
    assert found.rms == pytest.approx(0.1 * np.std(np.sin(3.0 * q)), rel=0.2)


def test_friction_never_brings_energy():
    t, q, p, runs = motions(0.0, 0.0)
    work, power = friction_work(energy(q, p) + 0.3 * t, runs, t, p[:, None])
    assert power == 0.0 and not work.any()


def test_work_of_a_model_is_that_of_its_friction():
    class Damped(EnergyFamily):

        def energy(self, z: torch.Tensor) -> torch.Tensor:
            return 0.5 * z[:, 1]**2 + GRAVITY * (1.0 - torch.cos(z[:, 0]))

        def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None
                         ) -> torch.Tensor:
            return super().vector_field(z) - 0.1 * z * torch.tensor([0.0, 1.0])

        def networks(self, z0: np.ndarray, energy0: float) -> dict:
            return {}
    t, q, p, runs = motions(0.1, 0.0)
    dataset = Dataset(q[:, None], p[:, None], p[:, None], p[:, None], runs, 'two', t, runs)
    error = energy_spread(energy(q, p), runs, 0, model_work(Damped(), dataset, runs))
    # Trapezoids of h = 0.01 s: h^2 / 12 of what the power 0.1 p^2 changes by in time, at most
    # 0.1 * 2 * 3 * 10 W/s.
    assert error.rms < 1e-4


def test_bootstrap_interval_holds_the_true_rms_about_as_often_as_it_says():
    held = 0
    for seed in range(60):
        noise = np.random.default_rng(seed).normal(size=200)
        error = energy_error(5.0 + 2.0 * noise, np.zeros(200), seed)
        held += error.rms_interval[0] <= 2.0 <= error.rms_interval[1]
    # 57 of 60 on average; eight fewer are five standard deviations.
    assert held >= 49


def test_blocks_as_long_as_the_correlation_hold_the_true_rms_of_correlated_errors():
    n, memory, held, naive = 4000, 0.95, 0, 0
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(size=n)
        errors = np.empty(n)
        errors[0] = noise[0]
        for k in range(1, n):
            errors[k] = memory * errors[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
        error = energy_spread(errors, np.zeros(n, dtype=int), seed)
        held += error.rms_interval[0] <= 1.0 <= error.rms_interval[1]
        naive += abs(error.rms - 1.0) <= 1.96 * np.sqrt(0.5 / n)
    # 38 of 40 by the level; blocks of one correlation time miss a part of it between them.
    assert held >= 32
    # As many independent states would have it a third of the times.
    assert naive < 24


def test_no_interval_is_told_of_errors_of_which_too_few_are_independent():
    trajectory = np.repeat([3, 5, 9], 50)
    constant = np.repeat([1.0, -2.0, 4.0], 50)
    still = energy_spread(constant, trajectory, 0)
    assert still.sup < 1e-15 and still.rms_interval is None
    wave = np.where(trajectory == 5, np.tile([1.0, -1.0], 75), 0.0)
    error = energy_spread(constant + wave, trajectory, 0)
    assert error.rms == pytest.approx(np.sqrt(1.0 / 3.0)) and error.sup == 1.0
    # One of three motions is off: three independent sizes of errors.
    assert error.rms_interval is None
    assert error.against == 'mean along each trajectory'
    drift = energy_spread(np.linspace(0.0, 3.0, 1000), np.zeros(1000, dtype=int), 0)
    assert drift.rms_interval is None
    assert interval_text(None).startswith('no interval')
    assert interval_text([0.5, 1.25]) == '95 %: 0.5 to 1.2'


@pytest.mark.parametrize('family, against', [
    ('hnn', 'work of fitted friction'), ('dgnet', 'work of forces and friction')])
def test_card_of_a_measured_motion_tells_the_energy_that_work_accounts_for(
        tmp_path: Path, family: str, against: str):
    t, q, p, runs = motions(0.3, 0.0)
    np.savetxt(tmp_path / 'log.txt', np.column_stack([runs, t, q, p]), fmt='%.12g')
    config = CONFIG.replace('FAMILY', f'{family}, friction: true' if family == 'dgnet' else family)
    (tmp_path / 'log.yaml').write_text(config)
    main(['--config', str(tmp_path / 'log.yaml'), '--out', str(tmp_path / 'm.safetensors')])
    card = load_checkpoint(tmp_path / 'm.safetensors').card
    error = card.energy_error
    assert error.against == against
    # The motions surround a part of the box that they never enter.
    assert 'H is known near the states of the data, from ' in card.dataset
    assert (error.friction_power is None) == (family == 'dgnet')
    page = (tmp_path / 'm.report.md').read_text()
    assert f'against the {against}' in page


RATE, GRAVITY = 0.4, 9.81


def exact_motion(spacing: float) -> EvenMotion:
    """Return a pendulum, damped and driven by 2 sin(2 t), to 1e-11, as it is without a filter."""
    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], -GRAVITY * np.sin(z[0]) - RATE * z[1] + 2.0 * np.sin(2.0 * t)]
    t = spacing * np.arange(round(4.0 / spacing) + 1)
    q, v = solve_ivp(rates, (0.0, t[-1] + 1e-9), [1.0, 0.0], t_eval=t, rtol=1e-11, atol=1e-12,
                     method='DOP853').y[..., None]
    motion = smoothed('exact', t, q, v, 2.0 * np.sin(2.0 * t)[:, None], 40.0)
    return replace(motion, q_smooth=q, v_smooth=v)


def mismatch(motion: EvenMotion, effects: list[Effect], horizon: float = 1.0) -> float:
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
    # Without friction and forces only the noise of the states changes H.
    t = 0.01 * np.arange(401)
    q, v = solve_ivp(lambda _, z: [z[1], -GRAVITY * np.sin(z[0])], (0.0, 4.0), [1.0, 0.0],
                     t_eval=t).y[..., None]
    free = smoothed('free', t, q, v, np.zeros_like(q), 40.0)
    assert energy_mismatch([balance(HAMILTONIANS['pendulum'](), [], free)], 0.01, [1.0]) is None
    assert unaccounted([EFFECTS['damping'](RATE), EFFECTS['gravity']('x')]) == []
    assert unaccounted([EFFECTS['thermostat'](1.0, 0.5)]) == ['Thermostat']


def test_velocity_without_a_momentum_is_one_line():
    class Flat(HAMILTONIANS['pendulum']):

        def gradient(self, q: np.ndarray, p: np.ndarray, t: float = 0.0
                     ) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros_like(q), np.zeros_like(p)

        def hessian_vector(self, q: np.ndarray, p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray,
                           t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros_like(q), np.zeros_like(p)
    with refused(StateError):
        momentum(Flat(), np.array([[0.1], [0.2]]), np.array([[0.0], [2.0]]), np.zeros((2, 1)))
