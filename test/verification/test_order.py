# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Observed order of convergence, on nonlinear problems: linear ones super-converge."""

from functools import cache

from helpers import (
    EPS, exact, exact_tableau, GENERIC, KINDS, Method, METHODS, mostly_long, python_step,
    Uncompiled)
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import gauss_tableau, INTEGRATORS
from hnn_vi_ros.simulation import Simulation
from mpmath import mp, mpf
import numpy as np
import pytest

# A state without symmetry: elsewhere a leading term may vanish.
Q0, P0, DURATION = 0.7, -1.2, 4.0
# Above order 8 a run in double precision meets the round-off plateau before its error is
# dominated by the leading term; the local error in 60 digits has no such bound.
GLOBAL = [method for method in METHODS
          if method.integrator.order <= 8 and method.name != 'dop853']


def field(system: str, z: list) -> list:
    """Return (q', p') of a system in mpmath, written down anew."""
    q, p = z
    if system == 'tao':
        return [(q * q + 1) * p, -(p * p + 1) * q]
    return [p, -mpf('9.81') * mp.sin(q)]


@cache
def reference(system: str, digits: int, duration: float) -> np.ndarray:
    """Return (q, p) at the end by Taylor series of high order in mpmath."""
    mp.dps = digits
    solution = mp.odefun(lambda t, z: field(system, z), 0, [mpf(Q0), mpf(P0)])
    return np.array(solution(mpf(duration)))


@pytest.mark.parametrize('method', GLOBAL, ids=str)
def test_method_converges_with_its_order(method: Method, measured):
    duration = DURATION if method.system == 'tao' else 1.0
    expected = reference(method.system, 25, duration).astype(float)
    steps, errors = np.array([4, 5, 6, 8]) * method.steps // 4, []
    for n in steps:
        simulation = Simulation(Uncompiled(method.hamiltonian), method.integrator, duration / n,
                                [Q0], [P0])
        simulation.advance(int(n))
        errors.append(np.hypot(simulation.q[0] - expected[0], simulation.p[0] - expected[1]))
    # Well above the round-off plateau, so that all points count.
    assert min(errors) > 1e-11
    order, requirements = method.integrator.order, method.integrator.requirements
    # log(C n^-p (1 + a / n^k)), with k = 2 for symmetric methods: what is left is of size a^2, and
    # a is at most 0.16. Steps that shorten themselves have no such series.
    columns, bound = [np.ones(4), -np.log(steps)], 0.35
    if method.name != 'time_transformed':
        columns, bound = [*columns, (steps[0] / steps)**(1 + requirements.symmetric)], 0.05
    slope = np.linalg.lstsq(np.stack(columns, axis=1), np.log(errors), rcond=None)[0][1]
    measured('order of convergence', f'{method.name}, {method.system}', slope,
             f'{order} ± {bound}')
    assert slope == pytest.approx(order, abs=bound)


@pytest.mark.parametrize('method', mostly_long(
    (m for m in GENERIC if m.system == 'tao'), *KINDS, 'kahan_li8', 'gauss8'))
def test_method_has_a_local_error_of_its_order_in_60_digits(method: Method, measured):
    order = method.integrator.order
    # Fractions of a step in doubles add up to it within 1e-16 of it: more than h^9 of short ones.
    first = 8 if method.name == 'kahan_li8' else 64
    lengths, errors = [mpf(1) / (first * k) for k in (1, 2, 4)], []
    for h in lengths:
        expected = reference(method.system, 60, h)
        z1 = python_step(method.integrator, method.hamiltonian, h, exact([Q0, P0]))
        errors.append(max(abs(z1 - expected)))
    # One step of order p errs by O(h^(p+1)).
    slope = np.polyfit(np.log(np.array(lengths, dtype=float)),
                       [float(mp.log(error)) for error in errors], 1)[0]
    measured('order of the local error, 60 digits', method.name, slope, f'{order + 1} ± 0.35')
    assert slope == pytest.approx(order + 1, abs=0.35)


@pytest.mark.parametrize('stages', mostly_long(range(1, 9), '1', '4', '8'))
def test_gauss_coefficients_are_right_to_round_off(stages: int):
    for computed, expected in zip(gauss_tableau(stages), exact_tableau(stages), strict=True):
        # The start extrapolates; its entries grow with the stages, and their rounding with them.
        size = max(1.0, float(abs(expected).max()))
        assert np.abs(computed - expected.astype(float)).max() <= 16 * EPS * size


def test_dop853_holds_its_tolerance():
    simulation = Simulation(Uncompiled(HAMILTONIANS['tao']()), INTEGRATORS['dop853'](), 0.5,
                            [Q0], [P0])
    simulation.advance(8)
    expected = reference('tao', 25, DURATION).astype(float)
    # rtol 1e-9 per step, some 100 steps, and a flow that stretches errors less than tenfold.
    assert np.hypot(simulation.q[0] - expected[0], simulation.p[0] - expected[1]) < 1e-6
