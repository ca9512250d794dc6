# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Delays of forces and their course between samples, found from logs."""

from pathlib import Path

from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.families.choices import AUTO
from hnn_vi_ros.learning.fit.config import guess_config
from hnn_vi_ros.learning.fit.machine_fit import fit_machine
from hnn_vi_ros.learning.tasks import selection
from hnn_vi_ros.learning.tasks.machine import as_selected, MACHINE
from hnn_vi_ros.learning.tasks.selection import selected
from machines import machine_config
import numpy as np
import pytest
from scipy.integrate import solve_ivp


def test_delay_at_the_end_of_its_search_is_no_evidence():
    forces = selection._Forces('linear', 0.0)
    for sign in (1.0, -1.0):
        assert selection._best_delay(lambda one: 9.0 - sign * one.delay, forces) == forces
    found = selection._best_delay(lambda one: 1.0 + (one.delay - 3.3)**2, forces)
    assert found.delay == pytest.approx(3.3, abs=0.1)


@pytest.mark.parametrize('delay', [0.0, 2.0])
def test_smooth_forces_at_rare_samples_bias_no_number(delay: float):
    """
    Chords of a force of 2.6 Hz at 20 Hz are too small by (2 pi f h)^2 / 12, 5 %.

    With a wrong delay the fit has wrong friction, and with that another delay fits it best.
    """
    times, noise, truth = 0.05 * np.arange(400), 2e-3, [0.25, 4.0]

    def force(t: np.ndarray | float) -> np.ndarray:
        return sum(size * np.sin(2.0 * np.pi * f * t) for size, f in (
            (1.0, 0.7), (1.5, 1.9), (1.2, 2.6)))

    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], (force(t) - truth[1] * np.sin(z[0]) - 0.08 * z[1]) / truth[0]]
    q = solve_ivp(rates, (0.0, times[-1]), [0.3, 0.0], t_eval=times, rtol=1e-9, atol=1e-9).y[:1].T
    q += noise * np.random.default_rng(1).normal(size=q.shape)
    config = machine_config('a', 'revolute', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, prior=AUTO, friction={'coulomb': 1})
    motions = [smoothed('run', times, q, None, force(times + 0.05 * delay)[:, None], 8.0)]
    chosen, card = selected(config, motions)
    assert chosen.data.inputs == 'spline' and 'between samples as spline' in card.held_out
    # The noise over the speed, 2e-3 / 0.5 s / sqrt(400), is .004 of a sample; found to 0.01.
    assert chosen.data.delay == pytest.approx(delay, abs=0.02)
    problem = fit_machine(chosen, as_selected(motions, chosen.data, chosen.data.delay))
    for name, number in problem.estimates(chosen.coordinates, None).items():
        if name in ('inertia1', 'gravity1'):
            low, high = number.interval
            true = truth[name == 'gravity1']
            # Three standard errors; that of chords is fifteen.
            assert abs(number.value - true) < 3.0 * (high - low) / (2.0 * 1.96)


@pytest.mark.parametrize('delay', [-3.0, pytest.param(2.0, marks=pytest.mark.long)])
def test_forces_that_act_earlier_or_later_than_logged_are_moved(delay: float):
    """A tenth of a sample, 2 ms, is 0.018 of the faster force; chords add (w h)^2 / 8, 0.004."""
    t = 0.02 * np.arange(800)

    def force(t: np.ndarray | float) -> np.ndarray:
        return np.sin(1.7 * t) + np.sin(9.0 * t)

    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], force(t) - 9.0 * np.sin(z[0]) - 0.3 * z[1]]
    q = solve_ivp(rates, (0.0, t[-1]), [0.4, 0.0], t_eval=t, rtol=1e-8, atol=1e-8).y[:1].T
    q += 3e-3 * np.random.default_rng(1).normal(size=q.shape)
    config = machine_config('a', 'revolute', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, prior=AUTO, friction={'coulomb': 1})
    motions = [smoothed('run', t, q, None, force(t + 0.02 * delay)[:, None], 5.0)]
    chosen, card = selected(config, motions)
    assert chosen.data.delay == pytest.approx(delay, abs=0.1)
    assert f'delayed by {chosen.data.delay:g} samples' in card.held_out
    (moved,) = as_selected(motions, chosen.data, chosen.data.delay)
    assert np.abs(moved.tau[5:-5, 0] - force(t[5:-5])).max() < 0.05
    stated = config.model_copy(update={'data': config.data.model_validate(
        {'kind': 'arrays', 'delay': 0.0})})
    assert selected(stated, motions)[0].data.delay == 0.0


@pytest.mark.long
def test_chords_that_whole_motions_alone_show_are_found_in_a_chaotic_motion(tmp_path: Path):
    """
    At 100 Hz chords of forces of 0.5 to 1.9 Hz are too small by 0.01 to 0.1 %.

    Short pieces do not show that; whole motions do, but those of 16 s have false minima.
    """
    times = 0.01 * np.arange(2000)
    I1, I2, C, G1, G2 = 0.256, 0.15, 0.12, 1.6 * 0.4 * 9.81, 0.6 * 0.5 * 9.81

    def forces(t: np.ndarray | float) -> np.ndarray:
        return np.array([3.0 * np.sin(np.pi * t) + 2.0 * np.sin(2.4 * np.pi * t),
                         1.5 * np.sin(1.4 * np.pi * t) + np.sin(3.8 * np.pi * t)])

    def rates(t: float, z: np.ndarray) -> list[float]:
        (a, b), v = np.split(z, 2)
        mixed, bend = I2 + C * np.cos(b), C * np.sin(b)
        mass = np.array([[I1 + 2.0 * mixed - I2, mixed], [mixed, I2]])
        pull = G2 * np.sin(a + b)
        return [*v, *np.linalg.solve(mass, forces(t) - [0.05 * v[0], 0.03 * v[1]] + [
            bend * (2.0 * v[0] + v[1]) * v[1] - G1 * np.sin(a) - pull,
            -bend * v[0]**2 - pull])]
    q = solve_ivp(rates, (0.0, times[-1]), [0.5, 0.1, 0.0, 0.0], t_eval=times, rtol=1e-9,
                  atol=1e-10).y[:2].T
    q += 2e-3 * np.random.default_rng(9).normal(size=q.shape)
    log = tmp_path / 'log.csv'
    np.savetxt(log, np.column_stack([times, q, forces(times).T]), delimiter=',', comments='',
               header='t,q1 [rad],q2 [rad],tau1 [N m],tau2 [N m]')
    config, _ = guess_config([str(log)])
    data = MACHINE.select(MACHINE.read(tmp_path / 'x.yaml', config, [str(log)], False))
    fitted = MACHINE.fit(data, config, 'cpu')
    assert MACHINE.describe(
        data, fitted, config, 'x', 'train').card.mechanical.inputs == 'spline'
    # Those of chords were 1.9, 2.1, 1.3, 1.7 and 3.8 half-widths off.
    for truth, number in zip((I1, I2, C, G1, G2), fitted.estimates(
            config.coordinates, None).values(), strict=False):
        low, high = number.interval
        assert abs(number.value - truth) < 1.5 * 0.5 * (high - low)
