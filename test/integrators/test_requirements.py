# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What methods declare that they need: refusals, and the lists of methods that can."""

import re

from helpers import Uncompiled
from hnn_vi_ros.effects import Place
from hnn_vi_ros.effects.base import StepEffect
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import check_method, Integrator, INTEGRATORS, Requirements
from hnn_vi_ros.simulation import System
from hnn_vi_ros.simulation.batches.steps import step_of
from hnn_vi_ros.simulation.gradients.derivatives import differentiable_tableau
import pytest


class Elsewhere(Uncompiled):
    """A system in coordinates that are not canonical."""

    canonical = False


SYSTEMS = {'separable': Uncompiled(HAMILTONIANS['pendulum']()),
           'not separable': Uncompiled(HAMILTONIANS['tao']()),
           'turning': Uncompiled(HAMILTONIANS['heavy_top']()),
           'not canonical': Elsewhere(HAMILTONIANS['pendulum']())}
# DiscreteEulerLagrange is no method for H, but for a discrete Lagrangian that it is given.
METHODS = {name: method() for name, method in INTEGRATORS.items()
           if method.requirements.hamiltonian}


def refusal(name: str, hamiltonian: Hamiltonian) -> str:
    """Return what a method says of a system, nothing where it takes it."""
    try:
        check_method(METHODS[name], hamiltonian)
    except UnsupportedSystem as problem:
        return str(problem)
    return ''


@pytest.mark.parametrize('system', SYSTEMS)
def test_refusal_names_the_methods_that_refuse_nothing(system):
    refusals = {name: refusal(name, SYSTEMS[system]) for name in METHODS}
    able = [name for name, message in refusals.items() if not message]
    others = {name: message for name, message in refusals.items() if message}
    assert able and others
    for name, message in others.items():
        assert message.startswith(f'{name} ')
        assert message.partition('; valid methods: ')[2].split(', ') == able


class Precise(StepEffect):
    """A step effect that only methods of high order take."""

    turns = True
    acts = Place.OUTSIDE

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether it takes a method."""
        return integrator.order > 2

    def resolve(self, coordinates, state) -> tuple:
        """Return no parameters."""
        return ()

    @staticmethod
    def wrap(step, keeps_gradient):
        """Return the step."""
        return step


@pytest.mark.parametrize('system', ['separable', 'not separable', 'turning'])
def test_methods_that_a_refusal_names_take_the_system(system):
    hamiltonian, turning = SYSTEMS[system], system == 'turning'
    # A method that takes the system, of low order, without a tableau and without a device.
    method = METHODS['lie_leapfrog' if turning else 'discrete_gradient']
    on_device = ('variational_euler', 'generalized_leapfrog', 'implicit_midpoint', 'gauss')
    for refuse, can in (
            (lambda: System(hamiltonian, [Precise()], method),
             lambda name: METHODS[name].order > 2),
            (lambda: differentiable_tableau(hamiltonian, method),
             lambda name: METHODS[name].partitioned is not None),
            (lambda: step_of(method, hamiltonian), lambda name: name.startswith(on_device))):
        with pytest.raises(UnsupportedSystem) as raised:
            refuse()
        named = re.split('valid methods: ', str(raised.value))[1].split(', ')
        able = [name for name in METHODS if not refusal(name, hamiltonian) and can(name)]
        assert named == (able or ['none for this H'])


def test_stormer_verlet_and_compositions_of_it_refuse_a_hamiltonian_that_does_not_separate():
    for method in (INTEGRATORS['stormer_verlet'](), INTEGRATORS['yoshida4']('stormer_verlet')):
        with pytest.raises(UnsupportedSystem, match=r'needs H = T\(p\) .*generalized_leapfrog'):
            check_method(method, SYSTEMS['not separable'])
        check_method(method, SYSTEMS['separable'])


def test_failed_steps_are_redone_by_methods_that_are_symmetric():
    for method in INTEGRATORS.values():
        if method.fallback:
            assert INTEGRATORS[method.fallback].requirements.symmetric


@pytest.mark.parametrize('needs, takes', [
    ({}, (True, True)), ({'separable': True}, (True, False)), ({'forces': False}, (False, False)),
    ({'hamiltonian': False}, (False, False)), ({'forces': 'held'}, (False, False))])
def test_forces_that_a_method_takes_follow_from_what_it_needs(needs, takes):
    declared = Requirements(symmetric=True, symplectic=True, **needs)
    assert tuple(declared.take_force(depends) for depends in (False, True)) == takes
    assert declared.take_force(False, held=True) == (takes[0] or 'held' in needs.values())
