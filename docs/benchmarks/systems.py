# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Twelve systems that are not shipped, and models of random networks."""

from dataclasses import replace
from itertools import pairwise
import math
from typing import Any, NamedTuple

from hnn_vi_ros.hamiltonians import Formula
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.models import (
    Box, Checkpoint, CoordinateCard, FrictionCard, Layers, MechanicalCard, ModelCard,
    NeuralHamiltonian)
from hnn_vi_ros.simulation import InitialValueProblem
import numpy as np


# Models of two joints, or of one coordinate: entries of their cards.
FAMILIES: dict[str, dict[str, Any]] = {
    'separable_hnn': {'networks': {'kinetic': [1, 32, 32, 1], 'potential': [1, 32, 32, 1]}},
    'control_affine': {'networks': {
        'mass_inverse': [2, 32, 32, 3], 'potential': [2, 32, 32, 1], 'input_map': [2, 4, 2]}},
    'mechanical': {
        'networks': {'mass': [2, 32, 32, 3], 'potential': [4, 32, 32, 1]},
        'mechanical': MechanicalCard(
            kinds=['continuous', 'continuous'], features=[[1.0, 0.0], [1.0, 1.0]],
            mass_features=[[0.0, 1.0]], mass_scale=[1.0, 1.0], floor=0.5,
            friction=FrictionCard(viscous=[0.0, 0.0]))}}


def random_checkpoint(widths: list[int], seed: int) -> Checkpoint:
    """Return a network of these widths with random weights of the usual size."""
    return random_model('hnn', widths[0] // 2, seed, widths=widths)


def random_family(family: str, seed: int) -> Checkpoint:
    """Return a model of a row of FAMILIES with random weights of the usual size."""
    return random_model(family, 1 if family == 'separable_hnn' else 2, seed, **FAMILIES[family])


def random_model(family: str, d: int, seed: int, **entries: Any) -> Checkpoint:
    """Return a model of d coordinates with these entries of its card, and random weights."""
    rng = np.random.default_rng(seed)
    card = ModelCard(
        name='random', family=family, dataset='none', seed=seed, losses={}, training_command='',
        package_version='0', box=Box(q=[[-1.0, 1.0]] * d, p=[[-1.0, 1.0]] * d),
        coordinates=[CoordinateCard(name=f'x{i}') for i in range(d)], **entries)
    return Checkpoint(card, {name: Layers(
        tuple(rng.normal(size=(n_out, n_in)) / np.sqrt(n_in) for n_in, n_out in pairwise(widths)),
        tuple(0.1 * rng.normal(size=n_out) for n_out in widths[1:]))
        for name, widths in card.layout.items()})


class System(NamedTuple):
    """A motion, and a time like a period of it [s]."""

    problem: InitialValueProblem
    period: float


def network(seed: int, period: float) -> System:
    """Return a tanh network with random weights, twice the usual size in each layer."""
    checkpoint = random_checkpoint([2, 32, 32, 1], seed)
    layers = {name: Layers(tuple(2.0 * w for w in network.weights), network.biases)
              for name, network in checkpoint.networks.items()}
    return System(InitialValueProblem(NeuralHamiltonian(replace(checkpoint, networks=layers)), (),
                                      np.array([0.3]), np.array([0.3])), period)


def orbit(eccentricity: float, apocentre: bool) -> System:
    """Return an orbit of semi-major axis 1 m from one of its ends."""
    r = 1.0 + eccentricity if apocentre else 1.0 - eccentricity
    return System(InitialValueProblem(Kepler(), (), np.array([r, 0.0]),
                                      np.array([0.0, math.sqrt(2.0 / r - 1.0)])), 2.0 * math.pi)


def system(potential: str, q: list[float], p: list[float], period: float) -> System:
    """Return H = p . p / 2 + V with its initial state; V is a formula of x0, x1, ..."""
    names = [f'x{i}' for i in range(len(q))]
    kinetic = ' + '.join(f'p_{name}^2' for name in names)
    return System(InitialValueProblem(Formula(names, f'({kinetic}) / 2 + {potential}'), (),
                                      np.array(q), np.array(p)), period)


def systems() -> dict[str, System]:
    """Return the twelve systems by name."""
    x, v = [0.97000436, -0.24308753], [-0.93240737, -0.86473146]
    return {
        'kepler 0.9, apocentre': orbit(0.9, True),
        'kepler 0.9, pericentre': orbit(0.9, False),
        'kepler 0.99, apocentre': orbit(0.99, True),
        'kepler 0.99, pericentre': orbit(0.99, False),
        'toda ring of three': system(
            'exp(x0 - x1) + exp(x1 - x2) + exp(x2 - x0)',
            [1.0, -0.5, -0.5], [0.3, 0.5, -0.8], 4.0),
        'figure eight of three bodies': system(
            '- 1/sqrt((x0 - x2)^2 + (x1 - x3)^2) - 1/sqrt((x0 - x4)^2 + (x1 - x5)^2)'
            ' - 1/sqrt((x2 - x4)^2 + (x3 - x5)^2)',
            [*x, -x[0], -x[1], 0.0, 0.0],
            [-0.5 * v[0], -0.5 * v[1], -0.5 * v[0], -0.5 * v[1], *v], 6.3259),
        'stiff spring pendulum': system(
            '500 * (sqrt(x0^2 + x1^2) - 1)^2 + 9.81 * x1', [1.0, 0.0], [0.0, 0.0], 2.3),
        'double well next to its saddle': system('x0^4 / 4 - x0^2 / 2', [1e-3], [0.0], 20.0),
        'Lennard-Jones dimer': system(
            '4 * ((x0^2 + x1^2)^-6 - (x0^2 + x1^2)^-3)', [1.6, 0.0], [0.0, 0.25], 3.0),
        'three coupled pendulums': system(
            '0.1 * ((x0 - x1)^2 + (x1 - x2)^2) - cos(x0) - cos(x1) - cos(x2)',
            [1.0, 0.2, -0.5], [0.0, 0.3, 0.0], 6.5),
        'random network 2-32-32-1': network(8, 1.9),
        'another random network': network(5, 6.9),
    }
