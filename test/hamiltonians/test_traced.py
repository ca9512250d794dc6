# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""H as a function of Python: traced into a formula that agrees with it, or refused by name."""

from functools import partial, wraps
import math

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.hamiltonians import trace
from hnn_vi_ros.scene import Scene
from messages import refused
import numba
import numpy as np
import pytest

MASS = np.array([[2.0, 0.3], [0.3, 1.0]])


def matrix(x):
    return np.array([[x[0], 1.0 + x[1]], [2.0, x[0]]])


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
    (lambda q, p: p**2 / 2 + np.where(q > 0.5, q**2, -q) + np.sign(q) * q**3
     + (q >= 1) * (q - 1)**2 + np.clip(q, -1, p), None),
    (lambda q, p: p**2 / 2 + np.log1p(q**2) + np.expm1(q) + np.cbrt(2 + np.sin(q))
     + np.arcsinh(q) + np.arccosh(2 + q**2) + np.arctanh(np.sin(q) / 2), None),
    (lambda q, p: p @ p / 2 + np.arctan2(q[1], q[0])**2 + np.arctan2(1.0, q).sum()
     + np.maximum(q, 0.0) @ p + np.minimum(q, p).sum() + q.max() + np.hypot(3.0, q[0]), 2),
    *((lambda q, p, order=order: p @ p / 2 + np.linalg.norm(q, order), 3)
      for order in (1, 2, 3, np.inf, -np.inf)),
    (lambda q, p: p @ np.linalg.solve(matrix(q), p) + np.linalg.det(matrix(p))
     + np.linalg.inv(matrix(p))[0, 1] + p @ np.linalg.solve(MASS, q), 2),
    (lambda q, p: np.vdot(p, p) + np.var(q) + np.log2(2 + q @ q) + np.log10(3 + q[0]**2)
     + np.logaddexp(q[0], p[1]) + np.exp2(q).sum() + np.degrees(np.radians(q[1]))
     + np.float_power(2 + q[0]**2, 0.3), 2),
    (lambda q, p: p.sum()**2 / 2 + np.select([q > 1.0, ~(q > 0.0)], [q**2, -q], q)
     + np.logical_not(q > p) * q, None),
    (lambda q, p: p @ p / 2 + np.select([q > 1.0, ~(q > 0.0)], [q**2, -q]).sum(), 2),
    (lambda q, p: sum(np.tanh(p)**2) + np.einsum('i,ij,j', q, MASS, q) - 1e-7 * q[0], 2)]


def caught(q, below=lambda x: x < 0.0):
    try:
        return 0.0 if below(q - 12.0) else q
    except TypeError:
        return 0.0


CHANCE = np.random.default_rng(0)


def attempt(q):
    try:
        return math.isfinite(q)
    except TypeError:
        return False


REFUSED = {
    'branch': lambda q, p: p**2 if q > 0 else p, 'maximum': lambda q, p: max(q, 0.0) + p,
    'math': lambda q, p: p**2 - math.cos(q), 'and': lambda q, p: q and p,
    'int': lambda q, p: int(q), 'modulo': lambda q, p: q % 1.0,
    'rounded': lambda q, p: np.round(q) + p, 'interpolated': lambda q, p: np.interp(q, q, p),
    'velocity': lambda q, omega: omega**2 / 2, 'velocity first': lambda p, v: v**2 + p,
    'unknown names': lambda _Dummy_1, _Dummy_2: _Dummy_1**2 / 2 - np.cos(_Dummy_2),
    'one beside the time': lambda q, t: q**2 * t, 'two times': lambda q, p, t, time=0.0: p**2 + t,
    'time with a value': lambda q, p, t=2.0: p**2 / 2 + t * q**2,
    'time bound': partial(lambda q, p, t: p**2 / 2 + q * np.cos(t), t=0.0),
    'hidden': lambda *parts: (lambda p, q: p**2 / 2 - np.cos(q))(*parts),
    'hidden time': lambda q, p, **others: p**2 / 2 + q * np.cos(others.get('t', 0.0)),
    'parameter': lambda q, p=1.0: p**2 / 2 + q**2, 'keywords': lambda *, q, p: p**2 / 2 + q**2,
    'caught': lambda q, p: p**2 / 2 + caught(q),
    'caught function': lambda q, p: p**2 / 2 + caught(q, np.signbit),
    'type': lambda q, p: p**2 + (q**2 if isinstance(q, float) else q**4),
    'type far away': lambda q, p: p**2 + q**2 * (2 if isinstance(q, float) and q > 12.0 else 1),
    'random': lambda q, p: p**2 + q * CHANCE.normal(),
    'slow drift': lambda q, p, calls=[0]: p**2 + q**2 * (
        1.0 + 1e-9 * (calls.append(0) or len(calls))),
    'counter': lambda q, p, calls=[0]: p**2 + q * (calls.append(0) or len(calls)),
    'try': lambda q, p: p**2 + (q if hasattr(q, '__float__') and attempt(q) else 0.0),
    'method of symbols': lambda q, p: p**2 + q.sin(),
    'index': lambda q, p: np.ones(3)[q], 'None': lambda q, p: None, 'number': lambda q, p: 1.0,
    'another argument': lambda q, p, k: p**2 / 2 + k * q,
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
        trace(function, 1.0)


@pytest.mark.parametrize('function', [
    lambda q, p: p @ p + (q @ q if q.dtype == object else 0.0),
    lambda q, p: p @ np.linalg.solve(np.diag(q) + 1.0, p),
    lambda q, p: p @ p + np.linalg.norm(np.outer(q, q), 'fro')])
def test_function_of_arrays_that_is_no_formula_is_refused_by_name(function):
    with refused(ValueError):
        trace(function, np.arange(1.0, 6.0))


def test_numpy_is_as_before_after_a_function_was_traced():
    before = np.where, np.clip, np.linalg.solve
    with pytest.raises(ValueError, match='branch'):
        trace(REFUSED['branch'], 1.0)
    assert (np.where, np.clip, np.linalg.solve) == before


def momentum_first(p, q):
    return p**2 / 2 - np.cos(q)


@pytest.mark.parametrize('function', [
    momentum_first, np.vectorize(momentum_first), numba.njit(momentum_first),
    lambda theta, p_theta: p_theta**2 / 2 - np.cos(theta),
    wraps(momentum_first)(lambda *parts: momentum_first(*parts)),
    wraps(momentum_first)(lambda q, p: momentum_first(p, q))])
def test_names_of_arguments_tell_coordinates_from_momenta(function):
    assert trace(function, 1.0)[1] == '0.5*p^2 - cos(q)'


@pytest.mark.parametrize('function', [
    lambda q, p, t: p**2 / 2 + q * np.cos(t), lambda p, q, time=0.0: p**2 / 2 + q * np.cos(time),
    lambda t, q, p: p**2 / 2 + q * np.cos(t), lambda q, p, *, t: p**2 / 2 + q * np.cos(t),
    lambda q, p, m=2.0, t=0.0: p**2 / m + q * np.cos(t),
    partial(lambda q, p, m, t=None: p**2 / m + q * np.cos(t), m=2.0)])
def test_argument_with_the_name_of_the_time_is_the_time(function):
    assert trace(function, 1.0)[1] == '0.5*p^2 + q*cos(t)'


def test_array_is_no_value_of_H():
    with refused(ValueError):
        trace(lambda q, p: p**2, [1.0, 0.5])


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
