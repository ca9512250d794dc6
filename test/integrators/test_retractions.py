# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Retractions from rotation vectors to rotations, and their tangents, against their definition."""

from helpers import EPS, exact, jacobian
from hnn_vi_ros.integrators.lie.rotations import Coefficients, RETRACTIONS
from mpmath import mp, mpf
import numpy as np
import pytest

X, M = ['0.7', '-1.1', '0.4'], ['0.3', '0.9', '-0.2']


def matrix(tau: Coefficients, x: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of the quaternion."""
    (a, b, c), w = tau.vector * x, 1 + tau.less_one
    return np.array([
        [w * w + a * a - b * b - c * c, 2 * (a * b - w * c), 2 * (a * c + w * b)],
        [2 * (a * b + w * c), w * w - a * a + b * b - c * c, 2 * (b * c - w * a)],
        [2 * (a * c - w * b), 2 * (b * c + w * a), w * w - a * a - b * b + c * c]])


def rotation(name: str, x: np.ndarray) -> np.ndarray:
    return matrix(RETRACTIONS[name](x.dot(x) / 4), x)


def hat(x: np.ndarray) -> mp.matrix:
    return mp.matrix([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


@pytest.mark.parametrize('name', RETRACTIONS)
def test_retraction_is_the_map_of_its_name(name: str):
    x = exact(X)
    if name == 'exponential':
        expected = mp.expm(hat(x))
    else:
        expected = (mp.eye(3) - hat(x) / 2) ** -1 * (mp.eye(3) + hat(x) / 2)
    # 60 digits, of which a few are lost to rounding.
    assert abs(rotation(name, x) - np.array(expected.tolist())).max() < mpf(10) ** -55


@pytest.mark.parametrize('name', RETRACTIONS)
def test_trivialised_tangent_and_its_inverse_are_those_of_differences(name: str):
    x, m = exact(X), exact(M)

    def trivialised(y: np.ndarray) -> np.ndarray:
        change = rotation(name, y).dot(rotation(name, x).T)
        return np.array([change[2, 1] - change[1, 2], change[0, 2] - change[2, 0],
                         change[1, 0] - change[0, 1]]) / 2
    tangent, tau = jacobian(trivialised, x), RETRACTIONS[name](x.dot(x) / 4)
    bend, along = np.cross(x, m), x.dot(m)
    transposed = tau.own * m - tau.cross * bend + tau.line * along * x
    inverse = m + bend / 2 + tau.along * along * x - tau.squared * x.dot(x) * m
    # Of the differences; see jacobian.
    assert abs(tangent.T.dot(m) - transposed).max() < 1e-35
    assert abs(tangent.T.dot(inverse) - m).max() < 1e-35


@pytest.mark.parametrize('name', RETRACTIONS)
@pytest.mark.parametrize(
    'size', [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-4, 0.01, 0.5, 1.0, 2.0, 3.0])
def test_retraction_is_exact_to_round_off(name: str, size: float, measured):
    y = 0.25 * size * size
    mp.dps = 60
    errors = [abs(found - true) / abs(true) for found, true in zip(
        RETRACTIONS[name](y), RETRACTIONS[name](mpf(y) + mpf(0)), strict=True) if true != 0]
    worst = float(max(errors)) / EPS
    measured('largest relative error of a coefficient, in EPS', f'{name}, |x| = {size:g}', worst,
             '<= 40')
    # A dozen roundings; at 3 rad sums of alternating terms lose one more digit.
    assert worst <= 40.0
    assert RETRACTIONS[name](y).less_one <= 0.0
