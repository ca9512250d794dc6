# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Momenta of given velocities."""

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import StateError
from hnn_vi_ros.hamiltonians import HAMILTONIANS, momentum
from messages import refused
import numpy as np
import pytest


@pytest.mark.parametrize('scene', ['harmonic_oscillator', 'pendulum', 'double_pendulum'])
def test_momenta_of_a_learned_system_have_the_velocities_they_were_made_from(scene):
    scene = load_scene(scene)
    hamiltonian, q = scene.create_hamiltonian(), np.array(scene.initial_state.q)
    p = np.array(scene.initial_state.p) + 0.1
    velocity = hamiltonian.gradient(q, p)[1]
    found = momentum(hamiltonian, q, velocity, np.zeros_like(p))
    # The tolerance of the solver.
    assert np.abs(hamiltonian.gradient(q, found)[1] - velocity).max() <= 1e-10


def test_momenta_where_h_is_quadratic_in_p_are_mass_times_velocity():
    found = momentum(HAMILTONIANS['free_particle'](mass=2.0, names=['x', 'y']),
                     np.zeros(2), np.array([3.0, -1.0]), np.array([1e3, 1e3]))
    # One Newton step from 1e3, and one that mends its rounding.
    np.testing.assert_allclose(found, [6.0, -2.0], rtol=1e-13)


@pytest.mark.parametrize('velocity', [1e9, np.nan])
def test_momenta_that_do_not_exist_are_refused_in_one_line(velocity):
    # The velocities of a tanh network are bounded.
    hamiltonian = load_scene('pendulum').create_hamiltonian()
    with refused(StateError):
        momentum(hamiltonian, np.zeros(1), np.array([velocity]), np.zeros(1))
