# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reports of machines: equations with their numbers, parameters, and units that hold."""

import re
from types import SimpleNamespace

from hnn_vi_ros.models import DomainCard, equation_text, parameters_text
from hnn_vi_ros.models.mechanical_card import (
    CoulombTerm, FittedNumber, FrictionCard, MechanicalCard, PriorCard, Quantity, StribeckTerm)
from hnn_vi_ros.models.planar_chain import chain_kernel
import numpy as np
import pytest

SMOOTH = FrictionCard(viscous=[0.3, 0.0], coulomb=[CoulombTerm(
    force=[0.4, 1e-9], width=[0.02, 0.02])])


def described(kinds, angles, parameters, forces=((-3.0, 3.0), (-3.0, 3.0)), **entries):
    """Return what a report reads of the card of a chain of two links without networks."""
    prior = {'estimates': entries.pop('estimates', {})}
    eye = np.eye(2).tolist()
    return SimpleNamespace(
        coordinates=[SimpleNamespace(name=name) for name in 'ab'],
        domain=DomainCard(q=[[-1.0, 1.0]] * 2, v=[[-2.0, 2.0]] * 2, forces=[*map(list, forces)]),
        mechanical=MechanicalCard(**{
            'kinds': kinds, 'features': eye, 'mass_features': eye, 'mass_scale': [1.0, 1.0],
            'floor': 0.0, 'friction': SMOOTH, 'prior': PriorCard(
                kind='planar_chain', angles=angles, alone=True, parameters={
                    name: Quantity(value=x, unit='kg m2') for name, x in parameters.items()},
                **prior)} | entries))


CHAINS = [
    (['revolute'] * 2, [[1.0, 0.0], [1.0, 1.0]], {
        'inertia1': 0.71, 'inertia2': 0.23, 'coupling12': 0.17, 'gravity1': 4.4, 'gravity2': -1.3,
        'motor_inertia2': 0.05}),
    (['revolute'] * 2, [[1.0, 0.0], [1.0, 1.0]], {
        'inertia1': 0.71, 'inertia2': 0.23, 'coupling12': 0.17, 'gravity1': 4.4, 'gravity2': -1.3,
        'motor_inertia2': 0.05, 'sensor_offset1': 0.3, 'sensor_offset2': -0.2}),
    (['prismatic', 'revolute'], [[0.0, 0.0], [0.0, 1.0]], {
        'inertia1': 1.71, 'inertia2': 0.23, 'coupling12': 0.17, 'gravity1': 0.2, 'gravity2': 1.3,
        'stiffness1': 7.0, 'stiffness2': 0.4, 'stiffness12': -0.6, 'spring_force2': 0.3,
        'spring2_1': 0.8, 'spring2_2': 0.0, 'spring3_1': -0.5, 'spring3_2': 0.9})]


@pytest.mark.parametrize(('kinds', 'angles', 'parameters'), CHAINS)
def test_written_equation_is_that_of_the_model(kinds, angles, parameters):
    text = equation_text(described(kinds, angles, parameters))
    sides = dict(re.findall(r'^(M\[.*?\]|V) = (.*)$', text, re.MULTILINE))
    state = np.random.default_rng(0).normal(size=(20, 4))
    kernel = chain_kernel(angles, parameters)
    for a, b, *p in state.tolist():
        def value(side: str) -> float:
            product = re.sub(r'(?<=[0-9ab)]) (?=[a-z(])', ' * ', sides[side]).replace('^', '**')
            return float(eval(product, {'cos': np.cos, 'a': a, 'b': b}))
        M = np.array([[value('M[a, a]'), value('M[b, a]')], [value('M[b, a]'), value('M[b, b]')]])
        written = 0.5 * np.array(p) @ np.linalg.solve(M, p) + value('V')
        # Four digits of each number.
        size = 0.5 * np.array(p) @ np.linalg.solve(M, p) * np.linalg.cond(M) + sum(
            map(abs, parameters.values())) * (1.0 + a**4 + b**4)
        energy = kernel.energy.py_func(kernel.parameters, np.array([a, b]), np.array(p))
        assert energy == pytest.approx(written, abs=5e-4 * size)


def test_written_forces_are_those_of_friction_and_motors():
    kinds, angles, parameters = CHAINS[0]
    lines = equation_text(described(kinds, angles, parameters)).splitlines()
    assert 'force on a = u1 - 0.3 v - 0.4 tanh(v / 0.02)' in lines
    assert 'force on b = u2 - 1e-09 tanh(v / 0.02)' in lines
    free = equation_text(described(kinds, angles, parameters, forces=()))
    assert 'force on a = - 0.3 v - 0.4 tanh(v / 0.02)' in free
    directed = FrictionCard(
        viscous=[0.3, 0.1], viscous_back=[0.2, 0.1], switch=[0.05, 0.05], load=[0.07, 0.0],
        offset=[0.5, 0.0], stribeck=[StribeckTerm(
            force=[0.6, 0.0], width=[0.02, 0.02], speed=[0.3, 0.3])])
    lines = equation_text(described(
        kinds, angles, parameters, friction=directed, input_map=[[2.0], [0.0]], fade=[0.9]))
    terms = ('- 0.6 tanh(v / 0.02) exp(-(v / 0.3)^2) - 0.07 abs(motor force) tanh(v / 0.05) + 0.5')
    motor = '2 u1 / (1 + 0.9 abs(u1))'
    assert (f'force on a = {motor} - 0.3 v {terms} where v > 0, {motor} - 0.2 v {terms} '
            'where v < 0') in lines.splitlines()


def test_friction_of_the_members_of_a_mean_is_added():
    kinds, angles, parameters = CHAINS[0]
    half = CoulombTerm(force=[0.2, 0.1], width=[0.02, 0.02])
    mean = FrictionCard(viscous=[0.3, 0.0], coulomb=[half, half])
    assert 'force on a = u1 - 0.3 v - 0.4 tanh(v / 0.02)\n' in equation_text(
        described(kinds, angles, parameters, friction=mean))


def test_without_forces_only_ratios_are_printed():
    kinds, angles, parameters = CHAINS[0]
    card = described(kinds, angles, parameters, estimates={
        'inertia1': FittedNumber(value=1.0, unit='kg m2', interval=[1.0, 1.0]),
        'gravity1': FittedNumber(value=9.8, unit='N m', interval=[9.7, 9.9]),
        'width': FittedNumber(value=0.1, unit='rad/s', interval=[0.0, 0.2])})
    assert '| gravity1 | 9.8 | 9.7 to 9.9 | N m |' in parameters_text(card, '')
    rows = parameters_text(card, 'kg m2')
    assert '| inertia1 | 1 | 1 to 1 | 1 |' in rows
    assert '| gravity1 | 9.8 | 9.7 to 9.9 | N m / (kg m2) |' in rows
    assert '| width | 0.1 | 0 to 0.2 | rad/s |' in rows


def test_parameters_stand_in_a_report_without_intervals_too():
    kinds, angles, parameters = CHAINS[0]
    rows = parameters_text(described(kinds, angles, parameters), '')
    assert all(f'| {name} | {x:.6g} | - | kg m2 |' in rows for name, x in parameters.items())


def test_numbers_that_a_log_does_not_determine_are_said():
    kinds, angles, parameters = CHAINS[0]
    gravity = FittedNumber(value=9.8, unit='N m', interval=[9.7, 9.9], correlated=['offset'])
    offset = FittedNumber(value=0.1, unit='rad', interval=[0.0, 0.2], correlated=['gravity1'])
    open_ = FittedNumber(value=1.0, unit='N m', interval=None)

    def text(**estimates: FittedNumber) -> str:
        return parameters_text(described(kinds, angles, parameters, estimates=estimates), '')
    some = text(gravity1=gravity, offset=offset, spring1=open_)
    assert '| spring1 | 1 | - | N m |' in some
    assert 'A number without an interval is not told by the data.' in some
    assert 'The data hardly tell apart gravity1 and offset:' in some
    none = text(spring1=open_)
    assert none.startswith('These numbers are not a minimum that explains the log')
