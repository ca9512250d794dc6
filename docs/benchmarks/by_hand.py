# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the paper's method on formulas, compared with hand-written gradients."""

from collections.abc import Iterator

from benchmarks.choosing import path_run
from benchmarks.measurement import assert_close, race, Row, Settings
from hnn_vi_ros.hamiltonians import compiled_kernel, HAMILTONIANS
from hnn_vi_ros.simulation import InitialValueProblem
import numpy as np

_STEPS = 20_000


def energy(parameters, q, p):
    """Return no energy, which no step asks for."""
    return 0.0


def hessian_vector(parameters, q, p, v_q, v_p, product_q, product_p):
    """Do nothing: the first attempt at a step needs only gradients."""


def oscillator(parameters, q, p, dH_dq, dH_dp):
    """Fill the gradient of p^2 / (2 m) + k q^2 / 2."""
    mass, stiffness = parameters
    for i in range(q.size):
        dH_dq[i] = stiffness * q[i]
        dH_dp[i] = p[i] / mass


def pendulum(parameters, q, p, dH_dq, dH_dp):
    """Fill the gradient of p^2 / (2 m l^2) + m g l (1 - cos q)."""
    inertia, torque = parameters
    for i in range(q.size):
        dH_dq[i] = torque * np.sin(q[i])
        dH_dp[i] = p[i] / inertia


def kepler(parameters, q, p, dH_dq, dH_dp):
    """Fill the gradient of p^2 / 2 - mu / abs(q)."""
    (mu,) = parameters
    for i in range(0, q.size, 2):
        squared = q[i] * q[i] + q[i + 1] * q[i + 1]
        attraction = mu / (squared * np.sqrt(squared))
        dH_dq[i] = attraction * q[i]
        dH_dq[i + 1] = attraction * q[i + 1]
        dH_dp[i] = p[i]
        dH_dp[i + 1] = p[i + 1]


def henon_heiles(parameters, q, p, dH_dq, dH_dp):
    """Fill the gradient of (p^2 + q^2) / 2 + x^2 y - y^3 / 3."""
    for i in range(0, q.size, 2):
        x, y = q[i], q[i + 1]
        dH_dq[i] = x + 2.0 * x * y
        dH_dq[i + 1] = y + x * x - y * y
        dH_dp[i] = p[i]
        dH_dp[i + 1] = p[i + 1]


def tao(parameters, q, p, dH_dq, dH_dp):
    """Fill the gradient of (q^2 + 1) (p^2 + 1) / 2."""
    for i in range(q.size):
        dH_dq[i] = q[i] * (p[i] * p[i] + 1.0)
        dH_dp[i] = (q[i] * q[i] + 1.0) * p[i]


def double_pendulum(parameters, q, p, dH_dq, dH_dp):
    """Fill the gradient of two point masses on rods."""
    m1, m2, l1, l2, gravity = parameters
    for i in range(0, q.size, 2):
        sine, cosine = np.sin(q[i] - q[i + 1]), np.cos(q[i] - q[i + 1])
        common = l1 * l2 * (m1 + m2 * sine * sine)
        v1 = (l2 * p[i] - l1 * cosine * p[i + 1]) / (l1 * common)
        v2 = ((m1 + m2) * l1 * p[i + 1] - m2 * l2 * cosine * p[i]) / (m2 * l2 * common)
        coupling = m2 * l1 * l2 * sine * v1 * v2
        dH_dq[i] = (m1 + m2) * gravity * l1 * np.sin(q[i]) + coupling
        dH_dq[i + 1] = m2 * gravity * l2 * np.sin(q[i + 1]) - coupling
        dH_dp[i], dH_dp[i + 1] = v1, v2


# Gradient, parameters, step size [s] and initial state of each system.
_CASES = {
    'harmonic_oscillator': (oscillator, (1.0, 1.0), 0.05, [1.0], [0.3]),
    'pendulum': (pendulum, (1.0, 9.81), 0.01, [1.5], [0.0]),
    'kepler': (kepler, (1.0,), 0.01, [0.4, 0.0], [0.0, 2.0]),
    'henon_heiles': (henon_heiles, (), 0.05, [0.0, 0.1], [0.45, 0.0]),
    'tao': (tao, (), 0.01, [0.5], [0.1]),
    'double_pendulum': (double_pendulum, (1.0, 1.0, 1.0, 1.0, 9.81), 0.002, [0.3, 0.2],
                        [0.0, 0.0])}


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row a system."""
    for name, (gradient, parameters, h, q, p) in _CASES.items():
        settings.say(f'{name} by hand')
        formula = HAMILTONIANS[name]()
        hand = HAMILTONIANS[name]()
        # In place of the functions that the formula gives; read once, then kept.
        vars(hand)['kernel'] = compiled_kernel(
            (energy, gradient, hessian_vector), parameters, formula.dimension,
            formula.kernel.gradient_scale)
        problems = [InitialValueProblem(hamiltonian, (), np.array(q), np.array(p))
                    for hamiltonian in (formula, hand)]
        ours, peer = (path_run(problem, problem.simulation('variational_euler', h), 1, _STEPS)
                      for problem in problems)
        # Roundings of 20,000 steps, apart by as much again where paths part.
        assert_close(f'{name} by hand', ours()(), peer()(), 1e-8)
        yield race(f'variational_euler on {name}: a formula', {'formula': ours},
                   {'gradient by hand': peer}, settings, target=1.05, scale=1e6 / _STEPS)
