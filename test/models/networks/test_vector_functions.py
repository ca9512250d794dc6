# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The vectorised tanh, sine, cosine and softplus against mpmath."""

from collections.abc import Callable

from helpers import EPS
from hnn_vi_ros.models.networks import activations
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


@numba.njit
def tanh(x: np.ndarray) -> np.ndarray:
    """Return the tanh of every element."""
    result = np.empty_like(x)
    for i in range(x.size):
        result[i] = activations.tanh(x[i])
    return result


def alone(function: Callable) -> Callable:
    """Return a function of an array that returns what one of numbers does."""
    @numba.njit(error_model='numpy')
    def loop(x: np.ndarray) -> np.ndarray:
        found = np.empty_like(x)
        for i in range(np.uint64(x.size)):
            found[i] = function(x[i])
        return found
    return loop


EXPONENTIAL, LOGARITHM = alone(activations.exponential), alone(activations.logarithm)


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


def test_tanh_is_accurate_to_4_eps_at_every_scale():
    x = scattered(10.0 ** 1.5, 4000)
    expected = exact(mp.tanh, x)
    # Rounding of the reduction, of the series, of the sum m + 2 and of the quotient: 1 eps each.
    assert (np.abs(tanh(x) - expected) <= 4.0 * EPS * np.abs(expected)).all()


def test_tanh_keeps_not_a_number_and_saturates_at_one():
    special = tanh(np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0, 1e-310]))
    assert np.isnan(special[0])
    assert special[1:].tolist() == [1.0, -1.0, 1.0, -1.0, 0.0, 1e-310]


def test_tanh_is_odd():
    x = np.linspace(0.0, 20.0, 1001)
    assert np.abs(tanh(-x) + tanh(x)).max() <= 4.0 * EPS


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


def test_exponential_is_accurate_to_6_eps_and_keeps_its_limits():
    x = scattered(700.0)
    expected = exact(mp.exp, x)
    # The root errs by 2 eps, its square by twice as much and one rounding.
    assert (np.abs(EXPONENTIAL(x) - expected) <= 6.0 * EPS * expected).all()
    limits = EXPONENTIAL(np.array([-np.inf, -1e4, 0.0, 710.0, np.inf, np.nan]))
    assert limits[:5].tolist() == [0.0, 0.0, 1.0, np.inf, np.inf] and np.isnan(limits[5])


def test_logarithm_is_accurate_to_4_eps_and_keeps_its_limits():
    x = np.concatenate([10.0**scattered(300.0), 1.0 + scattered(0.5), [5e-324, 1e-310]])
    expected = exact(mp.log, x)
    # A quotient and the polynomial err by 1 eps each, the sum with k ln 2 by two more.
    assert (np.abs(LOGARITHM(x) - expected) <= 4.0 * EPS * np.abs(expected)).all()
    limits = LOGARITHM(np.array([0.0, 1.0, np.inf, -1.0, np.nan]))
    assert limits[:3].tolist() == [-np.inf, 0.0, np.inf] and np.isnan(limits[3:]).all()


# Functions and intervals [low, high]; what is left of an error by its factor is below eps / 8.
@pytest.mark.parametrize('function', [tanh, SINE, SOFTPLUS, EXPONENTIAL, LOGARITHM], ids=[
    'tanh', 'sine', 'softplus', 'exponential', 'logarithm'])
def test_activations_become_vector_instructions(function):
    function(*[np.zeros(1)] * (3 if function in (SINE, SOFTPLUS) else 1))
    (assembly,) = function.inspect_asm().values()
    # Two or more products, or quotients, at once, under the names that x86 or ARM gives them.
    names = ('divpd', 'fdiv\tv') if function is tanh else (
        'mulpd', 'fmul\tv', 'fmla\tv', 'fmadd213pd')
    assert any(name in assembly for name in names)
