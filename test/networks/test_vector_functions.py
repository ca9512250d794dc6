# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The vectorised sine, cosine and softplus against mpmath."""

from collections.abc import Callable

from helpers import EPS
from hnn_vi_ros.networks import activations
from mpmath import mp, mpf
import numba
import numpy as np
import pytest


def both(function: Callable) -> Callable:
    """Return a function of arrays, that fills two more with what one of numbers returns."""
    @numba.njit(error_model='numpy')
    def loop(x: np.ndarray, first: np.ndarray, second: np.ndarray) -> None:
        for i in range(np.uint64(x.size)):
            first[i], second[i] = function(x[i])
    return loop


SINE, SOFTPLUS = both(activations.sine_and_cosine), both(activations.softplus_and_slope)


def evaluate(loop: Callable, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first, second = np.empty_like(x), np.empty_like(x)
    loop(x, first, second)
    return first, second


def exact(function: Callable, x: np.ndarray) -> np.ndarray:
    mp.dps = 60
    return np.array([float(function(mpf(value))) for value in x])


def scattered(largest: float, n: int = 3000) -> np.ndarray:
    """Return numbers of either sign and of every scale from 1e-12 on."""
    rng = np.random.default_rng(1)
    return rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(-12.0, np.log10(largest), n)


def test_sine_and_cosine_are_accurate_to_2_eps_up_to_a_million():
    x = np.concatenate([scattered(1e6), 0.5 * np.pi * np.arange(-200, 200)])
    sine, cosine = evaluate(SINE, x)
    # Reduction, polynomial and sum round by half of eps each.
    assert np.abs(sine - exact(mp.sin, x)).max() <= 2.0 * EPS
    assert np.abs(cosine - exact(mp.cos, x)).max() <= 2.0 * EPS
    small = np.abs(x) < 0.7
    assert (np.abs(sine - exact(mp.sin, x))[small] <= 2.0 * EPS * np.abs(x)[small]).all()


def test_sine_keeps_not_a_number_and_stays_bounded():
    sine, cosine = evaluate(SINE, np.array([np.nan, np.inf, -np.inf, 0.0, 1e17, -1e300]))
    assert np.isnan(sine[:3]).all() and np.isnan(cosine[:3]).all()
    assert (sine[3], cosine[3]) == (0.0, 1.0)
    assert np.abs([sine[4:], cosine[4:]]).max() <= 1.0


def test_softplus_and_slope_are_accurate_to_8_eps_at_every_scale():
    x = scattered(690.0)
    value, slope = evaluate(SOFTPLUS, x)
    # The exponential errs by 2 eps of itself, the logarithm and its sum by 3, quotients by 1.
    for found, function in ((value, lambda z: mp.log1p(mp.exp(z))),
                            (slope, lambda z: 1 / (1 + mp.exp(-z)))):
        expected = exact(function, x)
        assert (np.abs(found - expected) <= 8.0 * EPS * expected).all()


def test_softplus_keeps_not_a_number_and_its_limits():
    value, slope = evaluate(SOFTPLUS, np.array([np.nan, np.inf, 1e300, -1e300, -np.inf]))
    assert np.isnan(value[0]) and np.isnan(slope[0])
    assert value[1:3].tolist() == [np.inf, 1e300] and slope[1:3].tolist() == [1.0, 1.0]
    assert np.abs([value[3:], slope[3:]]).max() < 1e-300


@pytest.mark.parametrize('coefficients, function, end', [
    (activations._SIN, lambda x: (mp.sin(mp.sqrt(x)) / mp.sqrt(x) - 1) / x,
     lambda: (mpf('1.0001') * mp.pi / 4) ** 2),
    (activations._COS, lambda x: (mp.cos(mp.sqrt(x)) - 1 + x / 2) / x ** 2,
     lambda: (mpf('1.0001') * mp.pi / 4) ** 2),
    (activations._LOG, lambda x: (mp.atanh(mp.sqrt(x)) / mp.sqrt(x) - 1) / x,
     lambda: mpf('1.0001') / 9),
], ids=['sine', 'cosine', 'artanh'])
def test_polynomials_interpolate_in_chebyshev_nodes_to_an_eighth_of_eps(
        coefficients, function, end):
    mp.dps = 40
    n, end = len(coefficients), end()
    nodes = [end / 2 * (1 + mp.cos(mp.pi * (2 * k + 1) / (2 * n))) for k in range(n)]
    powers = mp.matrix([[node ** j for j in range(n)] for node in nodes])
    solution = mp.lu_solve(powers, mp.matrix([function(node) for node in nodes]))
    assert [float(value) for value in solution] == list(coefficients)
    for x in np.linspace(float(end) / 300, float(end), 300):
        error = (mp.polyval(list(map(mpf, coefficients[::-1])), mpf(x)) - function(mpf(x))) * x
        assert abs(error) < EPS / 8


@pytest.mark.parametrize('loop', [SINE, SOFTPLUS], ids=['sine', 'softplus'])
def test_activations_become_vector_instructions(loop):
    evaluate(loop, np.zeros(1))
    (assembly,) = loop.inspect_asm().values()
    # Two or more products at once, under the names that x86 or ARM gives them.
    assert any(name in assembly for name in ('mulpd', 'fmul\tv', 'fmla\tv', 'fmadd213pd'))
