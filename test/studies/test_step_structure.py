# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measures of structure measure what they say, and find steps that are planted wrong."""

from helpers import GENERIC, Method, Uncompiled
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import Composition, ImplicitMidpoint, INTEGRATORS, Requirements
from hnn_vi_ros.integrators.composition import Yoshida4
from messages import refused
import numpy as np
import pytest
from studies.structure import (
    block_maxima, reversal_defect, rounding_scale, stationary_energy, symplectic_defect, take_step,
    two_form)
from studies.variants import Undersolved

Q, P, H = np.array([0.7]), np.array([-1.2]), 0.05
TAO = Uncompiled(HAMILTONIANS['tao']())


@pytest.mark.parametrize('method', GENERIC, ids=lambda method: method.name)
def test_defects_tell_what_each_method_claims(method: Method):
    hamiltonian, integrator = Uncompiled(method.hamiltonian), method.integrator
    reversal = reversal_defect(hamiltonian, integrator, H, Q, P)
    symplectic = symplectic_defect(hamiltonian, integrator, H, Q, P)
    # Round-off on one side; on the other, the smallest defect here is that of RK4, O(h^5).
    assert (reversal <= 1e-14) == integrator.requirements.symmetric
    assert (symplectic <= 1e-11) == integrator.requirements.symplectic


def test_two_form_of_variational_euler_is_that_of_its_staggered_momentum():
    form = two_form(TAO, INTEGRATORS['variational_euler'](), H, np.array([0.7, -1.2]))
    # H_qp = 2 q p, so that dq ^ d(p + h H_q) = (1 + h H_qp) dq ^ dp.
    assert form[0, 1] == pytest.approx(1.0 + 2.0 * H * 0.7 * -1.2, rel=1e-14)


def test_under_solved_steps_are_found_by_the_defects():
    """Three iterations of a map that contracts by h H_qp leave a residual of its cube."""
    worse = Undersolved(ImplicitMidpoint(), 3)
    worse.requirements = Requirements(symmetric=True, symplectic=True)
    assert symplectic_defect(TAO, worse, H, Q, P) > 1e-9
    assert reversal_defect(TAO, worse, H, Q, P) > 1e-9


def test_swapped_composition_is_found_by_the_defect_of_reversal():
    class Swapped(Composition):
        fractions = (Yoshida4.fractions[0], Yoshida4.fractions[0], Yoshida4.fractions[1])

    assert reversal_defect(TAO, Yoshida4(), H, Q, P) <= 1e-14
    assert reversal_defect(TAO, Swapped(), H, Q, P) > 2e-8


def test_take_step_raises_where_a_step_is_not_finite():
    with refused(StepFailure):
        take_step(HAMILTONIANS['kepler']().kernel, INTEGRATORS['explicit_euler'](), 1.0,
                  np.zeros(2), np.zeros(2))


def test_block_maxima_are_of_absolute_values():
    error = np.array([1.0, -3.0, 2.0, 0.5, -0.1, 0.2])
    assert block_maxima(error, 3).tolist() == [3.0, 2.0, 0.2]


@pytest.mark.parametrize('name, arguments, z, energy', [
    ('pendulum', (1.0, 1.0, 9.81), (3.0, 0.1), 2.0 * 9.81),
    ('henon_heiles', (), (0.1, 0.9, 0.0, 0.0), 1.0 / 6.0),
    ('henon_heiles', (), (0.8, -0.4, 0.0, 0.0), 1.0 / 6.0),
])
def test_stationary_energy_is_that_of_the_saddle(name, arguments, z, energy):
    hamiltonian = Uncompiled(HAMILTONIANS[name](*arguments))
    d = len(z) // 2
    assert stationary_energy(hamiltonian, z[:d], z[d:]) == pytest.approx(energy, rel=1e-14)


def test_stationary_energy_says_that_there_is_none():
    # A free particle under gravity falls everywhere.
    class Falling(Uncompiled):

        def gradient(self, q, p):
            return np.ones_like(q), p

    with refused(ValueError):
        stationary_energy(Falling(HAMILTONIANS['free_particle']()), [0.0], [0.0])


def test_rounding_scale_is_not_zero_where_h_is():
    """On the parabola of the Kepler problem H = 0, while both of its parts are 1 / r."""
    q, p = np.array([1.0, 0.0]), np.array([0.0, np.sqrt(2.0)])
    dH_dq, dH_dp = HAMILTONIANS['kepler']().gradient(q, p)
    assert rounding_scale(0.0, q, p, dH_dq, dH_dp) == pytest.approx(1.5)
