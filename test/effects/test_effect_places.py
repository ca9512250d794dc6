# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects that are known by what they declare alone: nothing else in the package names them."""

import ast
from itertools import permutations
from pathlib import Path

from helpers import free, plain_run, Uncompiled
from hnn_vi_ros import effects as effects_room, simulation as simulation_room
from hnn_vi_ros.effects.base import EffectError, Force, Place, StepEffect
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.exports import exported
from hnn_vi_ros.hamiltonians.free_particle import FreeParticle
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation.system import System
from messages import refused
import numpy as np
import pytest

# What every effect is made of, and what solves all constraints together, or keeps loops closed.
BASES = {
    'registry', 'base', 'commands', 'kernels', 'knots', 'loops', 'manifold', 'payload_changes',
    'time_drive', 'wrapped'}


class Kick(StepEffect):
    """An impulse J after each step."""

    excludes = {Place.NODES: 'which would be kicked too'}

    def __init__(self, impulse: float = 0.0):
        self.impulse = impulse

    def resolve(self, coordinates, state):
        """Return the impulse."""
        return (self.impulse,)

    @staticmethod
    def wrap(step, keeps_gradient):
        """Return the step with the impulse after it."""
        def kicked(kernel, h, options, z, z1, memory):
            inner, (impulse,), _, _ = options
            outcome, residual, gradients = step(kernel, h, inner, z, z1, memory[:-1])
            z1.p[0] += impulse
            kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
            return outcome, residual, gradients + 1
        return kicked


class Within(Kick):
    """Nothing, between the halves of a step."""

    acts = Place.MIDDLE

    @staticmethod
    def wrap(halves, keeps_gradient):
        """Return no real step."""
        first_half, _ = halves
        return first_half


class Outermost(Kick):
    """The same around all else."""

    acts, single, batched = Place.OUTSIDE, True, False


class Push(Force):
    """A constant force."""

    depends_on_momentum = False

    def resolve(self, coordinates, state):
        """Return nothing."""
        return ()

    @staticmethod
    def add_force(parameters, t, q, p, velocity, f_q, f_p):
        """Add 1 N."""
        f_p[0] += 1.0


def system(*effects, integrator='generalized_leapfrog'):
    return System(Uncompiled(FreeParticle()), effects, INTEGRATORS[integrator]())


def test_simulation_imports_no_effect():
    homes = exported(Path(effects_room.__file__))
    for path in Path(simulation_room.__file__).parent.glob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module == 'hnn_vi_ros.effects':
                files = {homes[alias.name].removeprefix('hnn_vi_ros.effects.')
                         for alias in node.names}
                assert files <= BASES


@pytest.mark.parametrize('effects', list(permutations([Kick(), Within(), Outermost()])))
def test_effects_act_around_a_step_in_the_order_of_their_places(effects):
    assert system(*effects).integrator.kernel_name == \
        'Account(Outermost(Kick(Within(GeneralizedLeapfrog))))'


def test_declared_effect_acts_in_a_simulation():
    simulation = plain_run(Uncompiled(FreeParticle(2.0)), 'implicit_midpoint', 0.5, [0.0], [1.0],
                           Kick(2.0), on_failure='stop')
    simulation.advance(2)
    # Steps of 0.5 s at 0.5 and 1.5 m/s; all numbers are exact.
    assert (simulation.q[0], simulation.p[0]) == (1.0, 5.0)


def test_declared_force_acts_at_the_nodes():
    simulation = plain_run(free('x'), 'stormer_verlet', 0.5, [0.0], [0.0], Push(),
                           on_failure='stop')
    simulation.advance(2)
    assert (simulation.q[0], simulation.p[0]) == (0.5, 1.0)
    assert simulation.works == {'Push': 0.5}


@pytest.mark.parametrize('effects, place', [
    ((Outermost(), Outermost()), 1), ((Push(), Kick()), 1)])
def test_what_an_effect_declares_against_others_is_refused(effects, place):
    with refused(EffectError) as raised:
        system(*effects)
    assert raised.value.index == place


def test_effect_in_the_middle_is_taken_by_methods_with_halves():
    with refused(UnsupportedSystem) as raised:
        system(Within(), integrator='rk4')
    able = str(raised.value).partition('valid methods: ')[2].split(', ')
    assert able == [name for name, method in INTEGRATORS.items() if method.halves is not None]


def test_effect_that_takes_one_state_at_a_time_is_named():
    with refused(ValueError):
        system(Kick(), Outermost()).check_state(np.zeros((2, 1)), np.zeros((2, 1)))
    assert system(Kick()).batched
