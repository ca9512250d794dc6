# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The four tasks of SymODEN: a pendulum twice, a cart-pole and an Acrobot under constant forces.

Y. D. Zhong, B. Dey, A. Chakraborty, Symplectic ODE-Net, ICLR 2020, with the equations, samplings
and the error of its public code: the sum over 40 instants and all components of the squared error
of a prediction without force, the mean over the initial states of the training. The published
model learns M(q), V(q) and g(q); ours is the formula of a rigid body with unknown numbers.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from hnn_vi_ros.files import Parser
import numpy as np
from studies.known_tables import keep, parser_of
from studies.short_motions import followed, Mechanism

TABLE, SEEDS, STARTS = 'symoden', 5, 16
FORCES = -2.0, -1.0, 0.0, 1.0, 2.0
SAMPLES, PREDICTED = 20, 40

_ARM = """
  kind: formula
  coordinates: [{{name: a, q_unit: {unit}}}, {{name: b, q_unit: rad}}]
  H: >-
    {H}
  parameters: {{{numbers}}}"""


@dataclass(frozen=True)
class Task:
    """
    A task, with what its states are drawn from and compared in.

    Parameters
    ----------
    mechanism : Mechanism
        True and fitted system.
    interval : float
        Between samples [s].
    low, high : tuple of float
        Bounds of the initial (q, v).
    driven : int
        Index of the coordinate on which the force acts.
    seen : callable
        The compared components of states (q, v), shape (..., 2 d).

    """

    mechanism: Mechanism
    interval: float
    low: tuple[float, ...]
    high: tuple[float, ...]
    driven: int
    seen: Callable[[np.ndarray], np.ndarray]


def _turning(z: np.ndarray) -> np.ndarray:
    q, v = np.split(z, 2, axis=-1)
    return np.concatenate([np.cos(q), np.sin(q), v], axis=-1)


def _cart(z: np.ndarray) -> np.ndarray:
    return np.concatenate([z[..., :1], np.cos(z[..., 1:2]), np.sin(z[..., 1:2]), z[..., 2:]],
                          axis=-1)


def _phase(z: np.ndarray) -> np.ndarray:
    # The momentum of the first task is a third of the velocity.
    return z * [1.0, 1.0 / 3.0]


def _solved(mass: Sequence[Sequence[np.ndarray]], force: Sequence[np.ndarray]) -> np.ndarray:
    """Return M^-1 f for m matrices of two rows."""
    (a, b), (_, c) = mass
    f, g = force
    return np.stack([c * f - b * g, a * g - b * f], axis=-1) / (a * c - b * b)[:, None]


def _pendulum(sign: float) -> Mechanism:
    """Return theta'' = sign 15 sin(theta) + 3 u."""
    return Mechanism(
        ' {kind: formula, coordinates: [{name: a, q_unit: rad}], '
        'H: p_a^2/(2*J) + G*cos(a), parameters: {J: 0.5, G: 1.0}}',
        ('parameters.J', 'parameters.G'), ('a',),
        lambda q, v, u: sign * 15.0 * np.sin(q) + 3.0 * u)


def _cart_pole(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    cart, pole, half = 0.5, 0.1, 0.5
    one, angle = np.ones(len(q)), q[:, 1]
    coupling = pole * half * np.cos(angle)
    return _solved([[(cart + pole) * one, coupling], [coupling, pole * half**2 * 4.0 / 3.0 * one]],
                   [u[:, 0] + pole * half * np.sin(angle) * v[:, 1]**2,
                    u[:, 1] + pole * half * 9.8 * np.sin(angle)])


def _acrobot(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    (a, b), (v1, v2) = q.T, v.T
    own, cross = 1.25 + 0.5 * np.cos(b), 0.5 * np.sin(b)
    lower = 4.9 * np.sin(a + b)
    return _solved([[2.25 + 2.0 * own - 1.25, own], [own, 1.25 * np.ones(len(q))]],
                   [u[:, 0] + cross * (2.0 * v1 * v2 + v2**2) - 14.7 * np.sin(a) - lower,
                    u[:, 1] - cross * v1**2 - lower])


TASKS = {
    'pendulum (q, p)': Task(_pendulum(-1.0), 0.05, (-np.pi, -3.0 * np.pi),
                            (2.0 * np.pi, 6.0 * np.pi), 0, _phase),
    'pendulum (cos, sin)': Task(_pendulum(1.0), 0.05, (-np.pi, -1.0), (np.pi, 1.0), 0, _turning),
    'cart-pole': Task(
        Mechanism(_ARM.format(
            unit='m', H='(J*p_a^2 - 2*K*cos(b)*p_a*p_b + m*p_b^2)/(2*(m*J - (K*cos(b))^2)) '
            '+ G*cos(b)', numbers='m: 1.0, J: 0.1, K: 0.1, G: 0.2'),
            tuple(f'parameters.{name}' for name in 'mJKG'), ('a', 'b'), _cart_pole),
        0.02, (-0.05, -3.14, -0.05, -3.0), (0.05, 3.14, 0.05, 3.0), 0, _cart),
    'acrobot': Task(
        Mechanism(_ARM.format(
            unit='rad', H='(I*p_a^2 - 2*(I + K*cos(b))*p_a*p_b + (J + I + 2*K*cos(b))*p_b^2)'
            '/(2*(I*J - (K*cos(b))^2)) - F*cos(a) - G*cos(a + b)',
            numbers='I: 1.0, J: 3.0, K: 0.3, F: 10.0, G: 4.0'),
            tuple(f'parameters.{name}' for name in 'IJKFG'), ('a', 'b'), _acrobot),
        0.05, (-3.14,) * 4, (3.14,) * 4, 1, _turning)}


def measure(names: Sequence[str], seeds: int, starts: int
            ) -> Iterator[tuple[str, int, str, float]]:
    """Yield the prediction error of each task and seed."""
    for seed in range(seeds):
        for name in names:
            task = TASKS[name]
            mechanism, d = task.mechanism, len(task.mechanism.names)
            first = np.random.default_rng(seed).uniform(task.low, task.high, (starts, 2 * d))
            forces = np.zeros((len(FORCES), starts, d))
            forces[:, :, task.driven] = np.array(FORCES)[:, None]
            every, u = np.tile(first, (len(FORCES), 1)), forces.reshape(-1, d)
            t = task.interval * np.arange(PREDICTED)
            short = mechanism.motions(every[:, :d], every[:, d:], u, t[:SAMPLES])
            free = np.zeros((starts, d))
            true = mechanism.motions(first[:, :d], first[:, d:], free, t)
            with TemporaryDirectory() as folder:
                scene = mechanism.identified(Path(folder), short, u, t[:SAMPLES], task.interval)
                found = followed(scene, first, free, t)
            error = task.seen(found) - task.seen(true)
            yield name, seed, 'formula', float((error**2).sum(axis=(1, 2)).mean())


def main(argv: Sequence[str]) -> None:
    """Measure the table, and write it with the page."""
    arguments = parser().parse_args(argv)
    print(keep(arguments.out, TABLE, measure(
        [*TASKS], *(1, 3) if arguments.quick else (SEEDS, STARTS))))


def parser() -> Parser:
    """Return the parser of the command line."""
    found = parser_of(TABLE, __doc__)
    found.add_argument('--quick', action='store_true', help='few motions, to test the program')
    return found
