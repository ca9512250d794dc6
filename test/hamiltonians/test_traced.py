# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""H as a function of Python: traced into a formula that agrees with it, or refused by name."""

import math

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.hamiltonians import traced
from hnn_vi_ros.scene import Scene
from messages import refused
import numpy as np
import pytest

MASS = np.array([[2.0, 0.3], [0.3, 1.0]])
# Functions of numbers, and of arrays of the length behind them.
FUNCTIONS = [
    (lambda q, p: p**2 / 2 - np.cos(q), None),
    (lambda q, p: np.exp(-q) * p**2 + abs(q) + 2**q + np.float64(3.0) - math.pi * q / p, None),
    (lambda q, p: p**2 / (2 * (1 + q**2)) - (-q)**3 - (+q**2)**3 - -1 / (1 - np.cos(q)), None),
    (lambda q, p: p @ p / 2 - 1 / np.linalg.norm(q), 2),
    (lambda q, p: p @ np.linalg.inv(MASS) @ p / 2 + np.sum(np.cosh(q)) + np.prod(np.sin(q)), 2),
    (lambda q, p: (p**2).sum() / 2 + np.hypot(q[0], q[1])**3 + np.linalg.norm(q[1:] - q[0])**4, 3),
    (lambda q, p: np.sum(p[0] * p + 2.0 / (3.0 + q[0] * q)) - np.sum(q[1] ** 2 - q**2 / 4), 3),
    (lambda q, p: np.dot(p, p) / 2 + np.sum(np.diff(q)**4) / 4 + np.square(q).mean(), 40),
    (lambda q, p: sum(np.tanh(p)**2) + np.einsum('i,ij,j', q, MASS, q) - 1e-7 * q[0], 2)]
REFUSED = {
    'branch': lambda q, p: p**2 if q > 0 else p, 'maximum': lambda q, p: np.maximum(q, 0.0) + p,
    'math': lambda q, p: p**2 - math.cos(q), 'and': lambda q, p: q and p,
    'int': lambda q, p: int(q), 'modulo': lambda q, p: q % 1.0,
    'log1p': lambda q, p: np.log1p(q) + p,
    'arctan2': lambda q, p: np.arctan2(q, p), 'sign': lambda q, p: p * np.sign(q),
    'index': lambda q, p: np.ones(3)[q], 'None': lambda q, p: None, 'number': lambda q, p: 1.0,
    'one argument': lambda q: q, 'its own error': lambda q, p: 1 / 0,
    'module': type('Net', (), {'state_dict': dict, '__call__': lambda self, z: z})(),
    'nan': lambda q, p: p * np.nan,
    'long': lambda q, p: sum((1 + k * q)**7 * p for k in range(400))}


def values(function, d, scene, rows):
    """Return H of a function and of the scene that it became."""
    return np.transpose([(function(*((q[0], p[0]) if d is None else (q, p))),
                          scene.energy(q, p)) for q, p in rows])


@pytest.mark.parametrize('function, d', FUNCTIONS)
def test_traced_function_agrees_with_its_formula_at_32_states(function, d):
    rows = np.random.default_rng(1).normal(size=(32, 2, d or 1))
    start = (1.0, 0.5) if d is None else (np.arange(1.0, d + 1.0), np.ones(d))
    scene = Scene.build(hamiltonian=function, integrator='gauss8', step_size=0.1,
                        initial_state=start)
    expected, found = values(function, d, scene.create_hamiltonian(), rows)
    # Roundings of some tens of operations.
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize('function', REFUSED.values(), ids=REFUSED)
def test_function_that_is_no_formula_is_refused_by_name(function):
    with refused(ValueError):
        traced(function, None)


def test_array_is_no_value_of_H():
    with refused(ValueError):
        traced(lambda q, p: p**2, 2)


def test_simulate_takes_a_function_and_gives_its_scene_back_as_yaml(tmp_path):
    run = simulate(lambda q, p: p**2 / 2 - np.cos(q), 2.5, 0.0, 1.0, 0.01)
    exact = simulate(load_scene('exact_pendulum'), 1.0, step_size=0.01, integrator='gauss8',
                     initial_state={'q': [2.5], 'p': [0.0]})
    assert run.q.shape == (101, 1) == exact.q.shape
    (tmp_path / 'H.yaml').write_text(run.scene.to_yaml())
    again = simulate(tmp_path / 'H.yaml', 1.0)
    assert np.array_equal(again.q, run.q) and again.scene.hamiltonian.H == '0.5*p^2 - cos(q)'


def test_simulate_takes_every_argument_of_a_function_once():
    H = FUNCTIONS[3][0]
    run = simulate(H, [1.0, 0.0], [0.0, 1.0], duration=0.2, step_size=0.1, integrator='rk4')
    assert run.scene.integrator.kind == 'rk4' and run.names == (['q1', 'q2'], ['p1', 'p2'])
    for arguments, options in (((1.0, 0.0, 1.0, 0.1, 3), {}),
                               ((1.0, 0.0, 1.0), {'duration': 2.0})):
        with refused(TypeError):
            simulate(FUNCTIONS[0][0], *arguments, **options)
    with refused(SceneError):
        simulate(FUNCTIONS[0][0], 1.0, duration=1.0, step_size=0.1)
