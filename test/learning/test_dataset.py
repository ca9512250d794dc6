# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training data: exact samples, measured logs, and the error that each unusable row gives."""

from pathlib import Path

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.dataset import (
    Dataset, differentiate, ExactData, sample_exact, SavitzkyGolay, SmoothingSpline)
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.data.text import MeasuredData
from hypothesis import given, settings, strategies as st
from messages import misfit, refused
import numpy as np
import pytest
from scipy.signal import savgol_coeffs

LOG = {'kind': 'measured', 'columns': ['t', 'x', 'v'], 'time': 't', 'q': ['x'], 'p': ['v'],
       'derivatives': {'kind': 'savitzky_golay', 'window': 0.45}}
OMEGA, SPACING = 2.0, 0.05
T = SPACING * np.arange(200)


def measured(**changes) -> MeasuredData:
    return MeasuredData.model_validate({**LOG, **changes})


def dataset(path: Path, data: MeasuredData) -> Dataset:
    return make_dataset(data, 0, Path(), [path])


def oscillation(t: np.ndarray = T) -> np.ndarray:
    return np.stack([t, np.sin(OMEGA * t), OMEGA * np.cos(OMEGA * t)], axis=-1)


def write(path, rows, separator=' ', header='', end='\n'):
    lines = [separator.join(f'{value:.17g}' for value in row) for row in rows]
    path.write_text(header + end.join([*lines, '']))
    return path


def assert_refused(path, data):
    with refused(DataError):
        dataset(path, data)


EXACT = {'kind': 'exact', 'hamiltonian': {'kind': 'harmonic_oscillator'}, 'samples': 50,
         'box': {'q': [[-2.0, 1.0]], 'p': [[0.0, 3.0]]}}


def test_sample_exact_follows_the_hamiltonian_and_stays_in_its_box():
    data = ExactData.model_validate({**EXACT, 'hamiltonian': {
        'kind': 'harmonic_oscillator', 'mass': 2.0, 'stiffness': 8.0}})
    sampled = sample_exact(data, 1)
    assert np.array_equal(sampled.dq_dt, sampled.p / 2.0)
    assert np.array_equal(sampled.dp_dt, -8.0 * sampled.q)
    assert sampled.q.min() >= -2.0 and sampled.q.max() <= 1.0
    assert sampled.p.min() >= 0.0 and sampled.p.max() <= 3.0
    assert sampled.box.q == [[sampled.q.min(), sampled.q.max()]]
    assert 'mass=2' in sampled.description


def test_sample_exact_keeps_to_the_bounds_of_radius_and_energy():
    data = ExactData.model_validate({
        'kind': 'exact', 'hamiltonian': {'kind': 'kepler'}, 'samples': 200,
        'box': {'q': [[-2.0, 2.0]] * 2, 'p': [[-2.0, 2.0]] * 2}, 'radius': [0.5, 1.5],
        'energy': [-0.6, -0.4]})
    sampled = sample_exact(data, 1)
    radius = np.linalg.norm(sampled.q, axis=1)
    energy = 0.5 * (sampled.p ** 2).sum(axis=1) - 1.0 / radius
    assert 0.5 <= radius.min() and radius.max() <= 1.5
    assert -0.6 <= energy.min() and energy.max() <= -0.4


def test_sample_exact_puts_the_share_asked_for_on_the_bounds():
    data = ExactData.model_validate({**EXACT, 'edge_share': 0.2, 'samples': 10_000})
    sampled = sample_exact(data, 1)
    for values, low, high in ((sampled.q, -2.0, 1.0), (sampled.p, 0.0, 3.0)):
        # Binomial with a mean of 1000 on either bound and a standard deviation of 30.
        assert abs(np.sum(values == low) - 1000) < 150
        assert abs(np.sum(values == high) - 1000) < 150
    corners = np.isin(sampled.q, (-2.0, 1.0)) & np.isin(sampled.p, (0.0, 3.0))
    assert abs(np.sum(corners) - 400) < 100  # 0.04 of them, within five deviations of 20
    assert sampled.box == data.box


def test_sample_exact_is_a_function_of_the_seed():
    data = ExactData.model_validate(EXACT)
    assert np.array_equal(sample_exact(data, 1).q, sample_exact(data, 1).q)
    assert not np.array_equal(sample_exact(data, 1).q, sample_exact(data, 2).q)


MOTION = {'duration': 3.0, 'spacing': 0.1}


def test_exact_trajectories_are_motions_from_the_states_of_the_box():
    data = ExactData.model_validate({**EXACT, 'trajectory': MOTION})
    sampled = sample_exact(data, 1)
    first = sample_exact(ExactData.model_validate(EXACT), 1)
    assert sampled.q.shape == (50 * 31, 1)
    begin = np.flatnonzero(sampled.t == 0.0)
    assert np.array_equal(sampled.q[begin], first.q)
    assert np.array_equal(sampled.trajectory, sampled.block)
    q0, p0 = first.q[sampled.trajectory], first.p[sampled.trajectory]
    t = sampled.t[:, None]
    # The tolerance of 1e-10 of the method, over three units of time.
    assert np.abs(sampled.q - q0 * np.cos(t) - p0 * np.sin(t)).max() < 1e-8
    assert np.array_equal(sampled.dq_dt, sampled.p)


def test_noise_is_on_the_states_and_not_on_their_rates():
    clean = sample_exact(ExactData.model_validate({**EXACT, 'samples': 2000}), 1)
    noisy = sample_exact(ExactData.model_validate({**EXACT, 'samples': 2000, 'noise': 0.1}), 1)
    assert np.array_equal(clean.dq_dt, noisy.dq_dt) and np.array_equal(clean.dp_dt, noisy.dp_dt)
    for part in ('q', 'p'):
        # A standard deviation from 2000 values errs by 1.6 % of itself, one sigma.
        assert np.std(getattr(noisy, part) - getattr(clean, part)) == pytest.approx(0.1, rel=0.08)
    assert 'noise 0.1' in noisy.description


def test_windows_are_the_evenly_spaced_runs_within_one_trajectory():
    sampled = sample_exact(ExactData.model_validate({**EXACT, 'trajectory': MOTION}), 1)
    runs = sampled.windows(0.2, 4)
    assert runs.shape == (50 * (31 - 6), 4)
    assert np.allclose(np.diff(sampled.t[runs], axis=1), 0.2, rtol=1e-12)
    assert (sampled.trajectory[runs] == sampled.trajectory[runs[:, :1]]).all()
    # What a split takes out, no run leaps over.
    rest = sampled.rows(np.arange(len(sampled.q)) != 5)
    assert len(rest.windows(0.2, 4)) == len(runs) - 3
    with refused(DataError):
        sample_exact(ExactData.model_validate(EXACT), 1).windows(0.1, 2)


def test_exact_accelerations_are_the_rates_of_the_velocities():
    data = ExactData.model_validate({
        **EXACT, 'hamiltonian': {'kind': 'tao'},
        'trajectory': {'duration': 0.02, 'spacing': 0.01}})
    sampled = sample_exact(data, 1)
    velocities = sampled.dq_dt.reshape(50, 3)
    middle = sampled.accelerations.reshape(50, 3)[:, 1]
    # Central differences: spacing^2 / 6 times a third derivative of at most some hundreds.
    assert np.allclose((velocities[:, 2] - velocities[:, 0]) / 0.02, middle, rtol=0.02, atol=0.05)


def test_log_with_derivative_columns_is_taken_as_it_is(tmp_path):
    rows = np.random.default_rng(0).normal(size=(30, 5))
    rows[:, 0] = np.sort(rows[:, 0])
    log = dataset(write(tmp_path / 'log', rows), measured(
        columns=['t', 'x', 'v', 'dx', 'dv'], dq_dt=['dx'], dp_dt=['dv'], derivatives=None))
    assert np.array_equal(np.hstack([log.q, log.p, log.dq_dt, log.dp_dt]), rows[:, 1:])
    # Nothing is estimated, so that each row may be a motion of its own.
    path = write(tmp_path / 'alone', np.insert(rows, 0, range(30), axis=1))
    alone = dataset(path, measured(
        columns=['one', 't', 'x', 'v', 'dx', 'dv'], trial='one', dq_dt=['dx'], dp_dt=['dv'],
        derivatives=None))
    assert np.array_equal(alone.q, log.q)


def test_momenta_are_mass_times_the_velocity_columns(tmp_path):
    path = write(tmp_path / 'log', oscillation())
    one, three = (dataset(path, measured(mass=[m])) for m in (1.0, 3.0))
    assert np.allclose(three.p, 3.0 * one.p, rtol=1e-12, atol=1e-12)
    assert np.allclose(three.dp_dt, 3.0 * one.dp_dt, rtol=1e-12, atol=1e-12)
    assert np.array_equal(three.dq_dt, one.dq_dt)


def test_trials_are_differentiated_one_by_one(tmp_path):
    # The second trial restarts the clock elsewhere in phase: across it nothing is smooth.
    halves = [oscillation(T[:100]), oscillation(T[:100] + 1.234)]
    halves[1][:, 0] = T[:100]
    rows = np.vstack([np.insert(half, 0, i, axis=1) for i, half in enumerate(halves)])
    both = dataset(write(tmp_path / 'both', rows), measured(
        columns=['run', 't', 'x', 'v'], trial='run'))
    single = dataset(write(tmp_path / 'one', halves[0]), measured())
    assert np.array_equal(both.dq_dt[:92], single.dq_dt)
    assert len(both.q) == 2 * 92
    assert set(both.block[:92]).isdisjoint(both.block[92:])


def test_split_keeps_blocks_together_and_every_row_once(tmp_path):
    log = dataset(write(tmp_path / 'log', oscillation()), measured())
    train, validation = log.split(0.2, seed=5)
    assert set(train.block).isdisjoint(validation.block)
    together = np.sort(np.concatenate([train.q, validation.q]), axis=0)
    assert np.array_equal(together, np.sort(log.q, axis=0))
    # Rows 4 to 195 in blocks of 9 rows are 22 blocks, of which 0.2 are about 4.
    assert len(np.unique(validation.block)) == 4


def test_split_by_blocks_of_time_keeps_each_second_together(tmp_path):
    log = dataset(write(tmp_path / 'log', oscillation()), measured(block=1.0))
    # Instants 0.2 to 9.75 s.
    assert len(np.unique(log.block)) == 10
    _, validation = log.split(0.2, seed=5)
    assert len(np.unique(validation.block)) == 2
    assert set(np.unique(np.floor(validation.t))) == set(np.unique(validation.block))


def test_momenta_are_a_mass_matrix_times_the_velocities(tmp_path):
    rows = np.random.default_rng(0).normal(size=(30, 5))
    rows[:, 0] = np.arange(30)
    matrix = [[2.0, 0.5], [0.5, 1.0]]
    log = dataset(write(tmp_path / 'log', rows), measured(
        columns=['t', 'x', 'y', 'vx', 'vy'], q=['x', 'y'], p=['vx', 'vy'], mass=matrix,
        derivatives={'kind': 'smoothing_spline', 'smoothing': 0.0}))
    assert np.allclose(log.p, rows[:, 3:] @ matrix, rtol=0.0, atol=1e-9)


def test_momenta_that_a_log_of_positions_lacks_are_masses_times_velocities(tmp_path):
    path = write(tmp_path / 'log.txt', oscillation()[:, :2])
    found = dataset(path, measured(columns=['t', 'x'], p=None, mass=[3.0]))
    # The filter's error of the rate, degree 3: (omega window)^4 / 24 of it, twice for its rate.
    assert np.abs(found.p[:, 0] - 3.0 * OMEGA * np.cos(OMEGA * found.t)).max() < 0.05 * 3.0 * OMEGA
    assert np.abs(found.dp_dt[:, 0] + 3.0 * OMEGA**2 * np.sin(OMEGA * found.t)).max() \
        < 0.1 * 3.0 * OMEGA**2


@pytest.mark.parametrize('degree', [3, 4])
def test_savitzky_golay_recovers_a_known_derivative_within_its_bound(degree):
    window, noise = 9, 1e-4
    rng = np.random.default_rng(3)
    clean = np.sin(OMEGA * T)
    values = clean + rng.uniform(-noise, noise, T.size)
    smooth, rate = differentiate(
        T, values[:, None], SavitzkyGolay(window=0.45, degree=degree), window)
    inside = slice(window // 2, -(window // 2))
    distance = SPACING * np.abs(np.arange(window) - window // 2)
    # The filters are exact up to degree 4 for the derivative and up to 3 or 5 for the value, so
    # Taylor's remainder of that order bounds the error, and the weights bound that of the noise.
    for found, exact, deriv, order in ((smooth, clean, 0, 4 if degree == 3 else 6),
                                       (rate, OMEGA * np.cos(OMEGA * T), 1, 5)):
        weights = np.abs(savgol_coeffs(window, degree, deriv=deriv, delta=SPACING))
        remainder = OMEGA**order / float(np.prod(np.arange(1, order + 1)))
        bound = weights @ (remainder * distance**order + noise)
        assert np.abs(found[:, 0] - exact)[inside].max() <= bound


def test_smoothing_spline_recovers_a_known_derivative_on_uneven_instants():
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.02, 0.06, 300))
    _, rate = differentiate(t, np.sin(OMEGA * t)[:, None],
                            SmoothingSpline(kind='smoothing_spline', smoothing=0.0), 0)
    # An interpolating cubic spline's derivative errs by h^3 max|f''''| / 24 (Hall and Meyer,
    # J. Approx. Theory 16, 1976), away from the ends, whose error at least halves a knot.
    inside = slice(30, -30)
    bound = 0.06**3 * OMEGA**4 / 24.0
    assert np.abs(rate[:, 0] - OMEGA * np.cos(OMEGA * t))[inside].max() <= bound


def test_uneven_log_is_resampled_for_savitzky_golay_and_taken_as_it_is_by_the_spline(tmp_path):
    t = np.delete(T, 50)
    path = write(tmp_path / 'log', oscillation(t))
    log = dataset(path, measured(derivatives={'kind': 'smoothing_spline'}))
    assert len(log.q) == len(t)
    log = dataset(path, measured())
    assert 'resampled every 0.05025 s' in log.description
    # The filter's own error: Taylor's remainder of order 4 in half a window, 0.2 s.
    assert np.abs(log.dq_dt[:, 0] - OMEGA * np.cos(OMEGA * log.t)).max() < OMEGA**5 * 0.2**4 / 24.0


def test_clock_written_with_few_digits_counts_as_even(tmp_path):
    rows = oscillation(np.arange(100) / 30.0)
    rows[:, 0] = np.round(rows[:, 0], 3)
    assert len(dataset(write(tmp_path / 'log', rows), measured()).q) > 80


# Digits that do not depend on the processor: messages tell a digest of the file.
GOOD = [f'{t:.2f} {np.sin(t):.6f} {np.cos(t):.6f}' for t in T]


@pytest.mark.parametrize('line', [
    '2.5 1.0 -inf', '2.5 one 1.0', '2.5 1_5 1.0', '2.5 1.0', '2.5 1.0 3.0' + ' 4' * 10**5,
    '2.5 1.0 1.0 1.0'], ids=['infinite', 'word', 'digits', 'short', 'endless', 'long'])
def test_unusable_row_gives_data_error_with_its_line(tmp_path, line):
    path = tmp_path / 'log.txt'
    path.write_text('\n'.join(['# head', *GOOD[:50], line, *GOOD[51:]]))
    assert_refused(path, measured())


@pytest.mark.parametrize('line, what', [
    ('2.5 nan 1.0', 'lack a number'), ('0.1 1.0 1.0', 'are late or duplicated')])
def test_row_that_lacks_a_number_or_is_late_is_left_out_and_counted(tmp_path, line, what):
    path = tmp_path / 'log.txt'
    path.write_text('\n'.join([*GOOD[:50], line, *GOOD[51:]]))
    assert f'left out 1 that {what}' in dataset(path, measured()).description
    assert_refused(path, measured(on_bad='fail'))


@pytest.mark.parametrize('raw', [
    b'', b'# only a comment\n', '\n'.join(GOOD[:5]).encode(), '\n'.join(GOOD[:12]).encode(),
    '\n'.join(f'{t:.2f} 1.0 {np.cos(t):.6f}' for t in T).encode(),
    '\n'.join(f'{t:.2f} {np.sin(t):.6f}e99 1' for t in T).encode(),
    b'\xff\xfe\x00binary'], ids=range(7))
def test_unusable_log_gives_data_error(tmp_path, raw):
    path = tmp_path / 'log.txt'
    path.write_bytes(raw)
    assert_refused(path, measured())


def test_missing_log_says_to_pass_data(tmp_path):
    assert_refused(tmp_path / 'none.txt', measured())
    assert_refused(tmp_path, measured())


def test_window_shorter_than_the_polynomial_is_refused(tmp_path):
    path = write(tmp_path / 'log', oscillation())
    for window in (1e-300, 0.15, 1e300):
        assert_refused(path, measured(derivatives={'kind': 'savitzky_golay', 'window': window}))


@pytest.mark.parametrize('changes', [
    {'radius': [1.5, 0.5]}, {'trajectory': {'duration': 1.0, 'spacing': 2.0}},
    {'trajectory': {'duration': 1.0, 'spacing': 1e-5}}, {'noise': -1.0},
    {'hamiltonian': {'kind': 'harmonic_oscillator', 'colour': 1.0}},
    {'hamiltonian': {'kind': 'harmonic_oscillator', 'mass': -1.0}},
    {'hamiltonian': {'kind': 'perpetuum_mobile'}}])
def test_exact_data_that_cannot_be_are_refused(changes):
    with misfit():
        ExactData.model_validate({**EXACT, **changes})


def test_energies_that_the_box_does_not_hold_are_refused():
    with refused(DataError):
        sample_exact(ExactData.model_validate({**EXACT, 'energy': [50.0, 60.0]}), 1)


@pytest.mark.parametrize('changes', [
    {'q': ['y']}, {'q': ['t']}, {'columns': ['t', 'x', 'x', 'v']}, {'trial': 'run'},
    {'mass': [1.0, 2.0]}, {'mass': [0.0]}, {'mass': [[-1.0]]}, {'mass': [[1.0, 0.0]]},
    {'derivatives': None}])
def test_contradictory_log_description_is_refused(changes):
    with misfit():
        measured(**changes)


@given(raw=st.one_of(
    st.binary(max_size=300),
    st.text('0123456789.eE+- \n#naif', max_size=300).map(str.encode),
    st.lists(st.tuples(*[st.floats(allow_nan=False)] * 3), max_size=30).map(
        lambda rows: '\n'.join(' '.join(map(repr, row)) for row in sorted(rows)).encode())))
@settings(max_examples=100)
@pytest.mark.filterwarnings('ignore::RuntimeWarning')  # overflow is what is tried here
def test_random_log_gives_data_error_or_a_dataset(tmp_path_factory, raw):
    path = tmp_path_factory.getbasetemp() / 'random.txt'
    path.write_bytes(raw)
    for derivatives in (LOG['derivatives'], {'kind': 'smoothing_spline'}):
        try:
            log = dataset(path, measured(derivatives=derivatives))
        except DataError as problem:
            assert '\n' not in str(problem)
        else:
            assert np.isfinite([log.q, log.p, log.dq_dt, log.dp_dt]).all()
