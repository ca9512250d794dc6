# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The vectorised hyperbolic tangent against mpmath."""

from helpers import EPS
from hnn_vi_ros.networks import activations
from mpmath import mp, mpf
import numba
import numpy as np


@numba.njit
def tanh(x: np.ndarray) -> np.ndarray:
    """Return the tanh of every element."""
    result = np.empty_like(x)
    for i in range(x.size):
        result[i] = activations.tanh(x[i])
    return result


def test_tanh_is_accurate_to_4_eps_at_every_scale():
    rng = np.random.default_rng(1)
    x = rng.choice([-1.0, 1.0], 4000) * 10.0 ** rng.uniform(-12.0, 1.5, 4000)
    mp.dps = 40
    expected = np.array([float(mp.tanh(mpf(value))) for value in x])
    # Rounding of the reduction, of the series, of the sum m + 2 and of the quotient: 1 eps each.
    assert (np.abs(tanh(x) - expected) <= 4.0 * EPS * np.abs(expected)).all()


def test_tanh_keeps_not_a_number_and_saturates_at_one():
    special = tanh(np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0, 1e-310]))
    assert np.isnan(special[0])
    assert special[1:].tolist() == [1.0, -1.0, 1.0, -1.0, 0.0, 1e-310]


def test_tanh_is_odd():
    x = np.linspace(0.0, 20.0, 1001)
    assert np.abs(tanh(-x) + tanh(x)).max() <= 4.0 * EPS


def test_tanh_polynomial_interpolates_in_chebyshev_nodes_to_an_eighth_of_eps():
    mp.dps = 40
    bound, n = mp.log(2) / 2 * mpf('1.0001'), len(activations._EXP)
    nodes = [bound * mp.cos(mp.pi * (2 * k + 1) / (2 * n)) for k in range(n)]
    powers = mp.matrix([[node ** j for j in range(n)] for node in nodes])
    solution = mp.lu_solve(powers, mp.matrix([mp.expm1(node) / node for node in nodes]))
    assert [float(value) for value in solution] == list(activations._EXP)
    for r in np.linspace(-float(bound), float(bound), 1000):
        exact = mp.expm1(mpf(r)) / mpf(r)
        series = mp.polyval(list(map(mpf, activations._EXP[::-1])), mpf(r))
        assert abs(series / exact - 1) < EPS / 8


def test_tanh_becomes_vector_instructions():
    tanh(np.zeros(1))
    (assembly,) = tanh.inspect_asm().values()
    # Two or more quotients at once, under the name that x86 or ARM gives it.
    assert 'divpd' in assembly or 'fdiv\tv' in assembly
