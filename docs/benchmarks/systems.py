# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Twelve systems that are not shipped: of most, V is a sum of terms, compiled once for all."""

from dataclasses import replace
from functools import cached_property
from itertools import pairwise
import math
from typing import NamedTuple

from hnn_vi_ros.accuracy.trials import InitialValueProblem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.models.checkpoint import Checkpoint, Layers
from hnn_vi_ros.models.model_card import Box, CoordinateCard, ModelCard
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.phase_space import Coordinate
import numba
import numpy as np

# What a term is of u = a . q, or of the distance r = abs((a . q, b . q)).
EXP, COS, POWER, DISTANCE, SPRING = range(5)


class Terms(Hamiltonian):
    """
    H(q, p) = p . p / 2 + a sum of terms c f(a . q) or c g(abs((a . q, b . q))).

    Parameters
    ----------
    dimension : int
        d.
    terms : list of tuple
        Kind, c, exponent or length, a, and b or None, each vector of shape (d,).

    """

    separable = True

    def __init__(self, dimension: int, terms: list[tuple]):
        self.coordinates = tuple(Coordinate(f'x{i}', 'm') for i in range(dimension))
        zero = np.zeros(dimension)
        self._numbers = np.array([[kind, c, n] for kind, c, n, _, _ in terms])
        self._first = np.array([a for *_, a, _ in terms], dtype=np.float64)
        self._second = np.array([zero if b is None else b for *_, b in terms], dtype=np.float64)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        return Kernel(_energy, _gradient, _hessian_vector,
                      (self._numbers, self._first, self._second), self.dimension,
                      (0.0, 0.0), compiled=True)


@numba.njit(error_model='numpy')
def _term(numbers: np.ndarray, u: float, v: float) -> tuple[float, float, float]:
    """Return a term, its first and its second derivative, by u or by r."""
    kind, c, n = int(numbers[0]), numbers[1], numbers[2]
    if kind == 0:
        value = c * math.exp(u)
        return value, value, value
    if kind == 1:
        return c * math.cos(u), -c * math.sin(u), -c * math.cos(u)
    x = u if kind == 2 else math.sqrt(u * u + v * v)
    if kind == 4:
        return 0.5 * c * (x - n) ** 2, c * (x - n), c
    if n >= 2.0:
        k = int(n)
        return c * x ** k, c * n * x ** (k - 1), c * n * (n - 1.0) * x ** (k - 2)
    if n == 1.0:
        return c * x, c, 0.0
    power = c * x ** int(n)
    return power, n * power / x, n * (n - 1.0) * power / (x * x)


@numba.njit(error_model='numpy')
def _dot(a: np.ndarray, x: np.ndarray, start: int) -> float:
    total = 0.0
    for i in range(a.size):
        total += a[i] * x[start + i]
    return total


@numba.njit(error_model='numpy')
def _energy(parameters: tuple, q: np.ndarray, p: np.ndarray) -> float:
    numbers, first, second = parameters
    total = 0.0
    for i in range(q.size):
        total += 0.5 * p[i] * p[i]
    for k in range(numbers.shape[0]):
        total += _term(numbers[k], _dot(first[k], q, 0), _dot(second[k], q, 0))[0]
    return total


@numba.njit(error_model='numpy')
def _gradient(parameters: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> None:
    numbers, first, second = parameters
    d = first.shape[1]
    for i in range(q.size):
        dH_dq[i], dH_dp[i] = 0.0, p[i]
    for start in range(0, q.size, d):
        for k in range(numbers.shape[0]):
            u, v = _dot(first[k], q, start), _dot(second[k], q, start)
            _, slope, _ = _term(numbers[k], u, v)
            du, dv = slope, 0.0
            if numbers[k, 0] >= 3.0:
                r = math.sqrt(u * u + v * v)
                du, dv = slope * u / r, slope * v / r
            for i in range(d):
                dH_dq[start + i] += du * first[k, i] + dv * second[k, i]


@numba.njit(error_model='numpy')
def _hessian_vector(parameters: tuple, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    numbers, first, second = parameters
    d = first.shape[1]
    for i in range(q.size):
        product_q[i], product_p[i] = 0.0, v_p[i]
    for start in range(0, q.size, d):
        for k in range(numbers.shape[0]):
            u, v = _dot(first[k], q, start), _dot(second[k], q, start)
            w_u, w_v = _dot(first[k], v_q, start), _dot(second[k], v_q, start)
            _, slope, curvature = _term(numbers[k], u, v)
            du, dv = curvature * w_u, 0.0
            if numbers[k, 0] >= 3.0:
                r = math.sqrt(u * u + v * v)
                along = (curvature - slope / r) * (u * w_u + v * w_v) / (r * r)
                du, dv = slope / r * w_u + along * u, slope / r * w_v + along * v
            for i in range(d):
                product_q[start + i] += du * first[k, i] + dv * second[k, i]


def random_checkpoint(widths: list[int], seed: int) -> Checkpoint:
    """Return a network of these widths with random weights of the usual size."""
    rng = np.random.default_rng(seed)
    d = widths[0] // 2
    pairs = list(pairwise(widths))
    card = ModelCard(
        name='random', widths=widths, dataset='none', seed=seed, losses={}, training_command='',
        package_version='0', box=Box(q=[[-1.0, 1.0]] * d, p=[[-1.0, 1.0]] * d),
        coordinates=[CoordinateCard(name=f'x{i}') for i in range(d)])
    return Checkpoint(card, {'energy': Layers(
        tuple(rng.normal(size=(n_out, n_in)) / np.sqrt(n_in) for n_in, n_out in pairs),
        tuple(0.1 * rng.normal(size=n_out) for _, n_out in pairs))})


def network(widths: list[int], seed: int, gain: float) -> NeuralHamiltonian:
    """Return a tanh network of random weights, those of its layers so many times the usual."""
    checkpoint = random_checkpoint(widths, seed)
    layers = {name: Layers(tuple(gain * w for w in network.weights), network.biases)
              for name, network in checkpoint.networks.items()}
    return NeuralHamiltonian(replace(checkpoint, networks=layers))


class System(NamedTuple):
    """What is simulated, and a time like a period of it [s]."""

    problem: InitialValueProblem
    period: float


def orbit(eccentricity: float, apocentre: bool) -> System:
    """Return an orbit of semi-major axis 1 m from one of its ends."""
    r = 1.0 + eccentricity if apocentre else 1.0 - eccentricity
    return System(InitialValueProblem(Kepler(), (), np.array([r, 0.0]),
                                      np.array([0.0, math.sqrt(2.0 / r - 1.0)])), 2.0 * math.pi)


def system(terms: list[tuple], q: list[float], p: list[float], period: float) -> System:
    """Return a sum of terms with its initial state."""
    return System(InitialValueProblem(Terms(len(q), terms), (), np.array(q), np.array(p)), period)


def plane(bodies: int, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a and b of the distance between two bodies of a plane."""
    a, b = np.zeros((2, 2 * bodies))
    a[2 * i], a[2 * j], b[2 * i + 1], b[2 * j + 1] = 1.0, -1.0, 1.0, -1.0
    return a, b


def systems() -> dict[str, System]:
    """Return the twelve, by their names."""
    x, v = [0.97000436, -0.24308753], [-0.93240737, -0.86473146]
    eye, ring = np.eye(3), np.eye(3) - np.roll(np.eye(3), 1, axis=1)
    pairs = [(DISTANCE, -1.0, -1.0, *plane(3, i, j)) for i, j in ((0, 1), (0, 2), (1, 2))]
    two = np.eye(2)
    dimer = two[0], two[1]
    return {
        'kepler 0.9, apocentre': orbit(0.9, True),
        'kepler 0.9, pericentre': orbit(0.9, False),
        'kepler 0.99, apocentre': orbit(0.99, True),
        'kepler 0.99, pericentre': orbit(0.99, False),
        'toda ring of three': system(
            [(EXP, 1.0, 0.0, ring[i], None) for i in range(3)]
            + [(POWER, -1.0, 1.0, ring[i], None) for i in range(3)],
            [1.0, -0.5, -0.5], [0.3, 0.5, -0.8], 4.0),
        'figure eight of three bodies': system(
            pairs, [*x, -x[0], -x[1], 0.0, 0.0],
            [-0.5 * v[0], -0.5 * v[1], -0.5 * v[0], -0.5 * v[1], *v], 6.3259),
        'stiff spring pendulum': system(
            [(SPRING, 1000.0, 1.0, two[0], two[1]), (POWER, 9.81, 1.0, two[1], None)],
            [1.0, 0.0], [0.0, 0.0], 2.3),
        'double well next to its saddle': system(
            [(POWER, -0.5, 2.0, [1.0], None), (POWER, 0.25, 4.0, [1.0], None)],
            [1e-3], [0.0], 20.0),
        'Lennard-Jones dimer': system(
            [(DISTANCE, 4.0, -12.0, *dimer), (DISTANCE, -4.0, -6.0, *dimer)],
            [1.6, 0.0], [0.0, 0.25], 3.0),
        'three coupled pendulums': system(
            [(COS, -1.0, 0.0, eye[i], None) for i in range(3)]
            + [(POWER, 0.1, 2.0, eye[i] - eye[i + 1], None) for i in range(2)],
            [1.0, 0.2, -0.5], [0.0, 0.3, 0.0], 6.5),
        'random network 2-32-32-1': System(
            InitialValueProblem(network([2, 32, 32, 1], 8, 2.0), (), np.array([0.3]),
                                np.array([0.3])), 1.9),
        'another random network': System(
            InitialValueProblem(network([2, 32, 32, 1], 5, 2.0), (), np.array([0.3]),
                                np.array([0.3])), 6.9),
    }
