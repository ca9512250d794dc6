# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction of drives: by direction and load, offsets, fading gains; delays; what is dropped."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import delayed, EvenMotion, part_of, smoothed
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.machine_fit import estimated_delay, fit_machine
from hnn_vi_ros.learning.fit.rigid_body import whole
from hnn_vi_ros.learning.fit.steps import simulated
from hnn_vi_ros.learning.tasks.machine import MACHINE
from hnn_vi_ros.models.mechanical_card import FrictionCard
from messages import misfit, refused
import numpy as np
import pytest
from scipy.signal import lfilter
import torch

MASS, VISCOUS, COULOMB, OFFSET, FADE = 2.0, (1.5, 2.5), (0.5, 0.8), 0.3, 0.04
LOAD, SPACING, SPEED = 0.12, 0.01, 0.05
WINDOWS = [{'duration': 0.2, 'steps': 1}, {'duration': 1.0, 'steps': 1}]


@cache
def drive(seed: int = 0, offset: float = OFFSET, fade: float = FADE, load: float = 0.0,
          size: float = 3.0) -> EvenMotion:
    """Return 20 s of a drive on a rail, by the classical method with 10 steps a sample."""
    rng, t = np.random.default_rng(seed), SPACING * np.arange(2001)
    rates, phases = rng.uniform(0.5, 6.0, 6), rng.uniform(0.0, 6.0, 6)
    tau = size * np.sin(t[:, None] * rates + phases).sum(axis=1)

    def rate(z: np.ndarray, force: float) -> np.ndarray:
        ahead = 0.5 + 0.5 * np.tanh(z[1] / SPEED)
        b, c = (back + ahead * (front - back) for front, back in (VISCOUS, COULOMB))
        force = force / (1.0 + fade * abs(force))
        dry = (c + load * abs(force)) * np.tanh(z[1] / SPEED)
        return np.array([z[1], (force + offset - b * z[1] - dry) / MASS])
    states, h = [np.zeros(2)], SPACING / 10
    for force in tau[:-1]:
        z = states[-1]
        for _ in range(10):
            k1 = rate(z, force)
            k2 = rate(z + 0.5 * h * k1, force)
            k3 = rate(z + 0.5 * h * k2, force)
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + h * k3, force))
        states.append(z)
    q, v = np.array(states).T[..., None]
    run = smoothed('drive', t, q, v, tau[:, None], 40.0)
    return EvenMotion(**(vars(run) | {'inputs': 'held'}))


def config(friction: object, data: object = None, **loss: object) -> MachineConfig:
    return MachineConfig.model_validate({
        'coordinates': [{'name': 'x', 'q_unit': 'm', 'p_unit': 'kg m/s', 'kind': 'prismatic'}],
        'data': {'kind': 'arrays', **(data or {})},
        'family': {'kind': 'mechanical', 'prior': 'free_particle', 'residual': False,
                   'friction': friction},
        'loss': {'kind': 'trajectory', 'windows': WINDOWS, **loss}})


ALL = {'coulomb': 1, 'directed': True, 'offset': True, 'fade': True}


@pytest.fixture(scope='module')
def fitted():
    setting, motion = config(ALL, records=True), drive()
    return setting, motion, fit_machine(setting, [motion])


def test_fit_finds_directions_offset_and_fade(fitted):
    *_, problem = fitted
    card = problem.module.card('kg m/s')
    # Widths of dry friction are not fitted, which moves the other numbers by some percent.
    assert card.friction.viscous == pytest.approx([VISCOUS[0]], rel=0.1)
    assert card.friction.viscous_back == pytest.approx([VISCOUS[1]], rel=0.1)
    assert card.friction.coulomb[0].force == pytest.approx([COULOMB[0]], rel=0.2)
    assert card.friction.coulomb[0].back == pytest.approx([COULOMB[1]], rel=0.2)
    assert card.friction.offset == pytest.approx([OFFSET], rel=0.2)
    assert card.fade == pytest.approx([FADE], rel=0.2)
    # Whole motions, in units of their spread.
    assert problem.losses['records'] <= 0.01


def test_compiled_model_moves_as_the_network(fitted):
    _, motion, problem = fitted
    network = problem.module
    with torch.no_grad():
        forces = network.joint_forces(torch.tensor(motion.forces))[:, None]
        q = simulated(network, 'implicit_midpoint', torch.tensor(motion.q_smooth[:1]),
                      torch.tensor(motion.v_smooth[:1]), forces, SPACING).q[:, 0].numpy()
    # The same method and the same H; equations are solved to 1e-9 and better.
    assert np.abs(whole(network, motion)[1:] - q).max() <= 1e-7


@pytest.fixture(scope='module')
def geared():
    # A gear that loses 12 % of the force that it passes on.
    setting = config({'coulomb': 1, 'directed': True, 'load': True})
    motion = drive(0, 0.0, 0.0, LOAD)
    return setting, motion, fit_machine(setting, [motion])


def test_fit_finds_friction_that_grows_with_the_load(geared):
    friction = geared[2].module.card('kg m/s').friction
    # Widths are not fitted, as above.
    assert friction.load == pytest.approx([LOAD], rel=0.05)
    assert friction.coulomb[0].force == pytest.approx([COULOMB[0]], rel=0.05)


@pytest.mark.long
def test_load_friction_holds_under_larger_forces_than_were_learned_from(geared):
    faster, errors = drive(7, 0.0, 0.0, LOAD, size=6.0), []
    for setting, problem in (geared[::2], (config({'coulomb': 1, 'directed': True}), None)):
        problem = problem or fit_machine(setting, [geared[1]])
        q = whole(problem.module, faster)
        errors.append(float(np.sqrt(np.mean((q - faster.q)**2))))
    # After 20 s, 6 mm and 266 mm: a wrong k does not shrink with more data.
    assert errors[0] < 0.1 * errors[1]


@pytest.mark.parametrize('kind', ['fitted', 'geared'])
def test_friction_dissipates_at_every_velocity_and_load(kind, request):
    friction = request.getfixturevalue(kind)[2].module.friction
    v = torch.linspace(-3.0, 3.0, 601, dtype=torch.float64)[:, None]
    for tau in (0.0 * v, v, 5.0 - v):
        with torch.no_grad():
            power = (friction(v, v, tau) + friction.offset().sum(dim=0)) * v
            assert (power >= 0.0).all()
            # Linear in its numbers, which the first fit uses.
            assert torch.allclose(
                friction.columns(v, tau) @ friction.values(), friction(v, v, tau))


@pytest.mark.long
def test_delay_is_estimated_in_samples_and_parts():
    motion = delayed(drive(offset=0.0, fade=0.0), -2.3)
    setting = config({'coulomb': 1, 'directed': True}, windows=WINDOWS[:1])
    # Found to a tenth; widths of dry friction are not fitted, and forces are interpolated.
    assert estimated_delay(setting, [motion]) == pytest.approx(2.3, abs=0.3)


@pytest.mark.long
def test_delay_of_forces_is_not_that_of_filtered_velocities():
    motion = part_of(delayed(drive(offset=0.0, fade=0.0), -2.0), slice(600))
    late = lfilter([0.2], [1.0, -0.8], motion.v, axis=0)
    motion = replace(smoothed('drive', motion.t, motion.q, late, motion.tau, 40.0), inputs='held')
    setting = config({'coulomb': 1, 'directed': True}, windows=WINDOWS[:1])
    assert estimated_delay(setting, [motion]) == pytest.approx(2.0, abs=0.5)


def test_delay_without_forces_is_refused():
    free = EvenMotion(**(vars(drive()) | {'tau': np.zeros((2001, 1))}))
    with refused(DataError):
        estimated_delay(config({'coulomb': 1}), [free])


def test_delay_is_told_by_the_model(tmp_path: Path):
    motion = delayed(drive(), -2.0)
    np.savez(tmp_path / 'log.npz', t=motion.t, q=motion.q, dq=motion.v, tau=motion.tau)
    setting = config({'coulomb': 1}, {'delay': 2.0})
    data = MACHINE.select(MACHINE.read(
        tmp_path / 'x.yaml', setting, [str(tmp_path / 'log.npz')], False))
    card = MACHINE.describe(data, MACHINE.fit(data, setting, 'cpu'), setting, 'x', 'train').card
    assert card.mechanical.delay == pytest.approx(0.02)
    assert 'forces delayed by 2 samples' in card.dataset


def test_friction_that_a_robot_has_itself_is_refused():
    family = {'kind': 'rigid_body', 'file': 'x.urdf', 'friction': ALL}
    with misfit():
        MachineConfig.model_validate(config(ALL).model_dump() | {'family': family, 'loss': None})


def test_card_of_two_directions_needs_the_speed_between():
    with misfit():
        FrictionCard(viscous=[1.0], viscous_back=[2.0])
