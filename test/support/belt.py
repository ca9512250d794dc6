# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A double pendulum driven by one motor through a belt."""

from hnn_vi_ros.learning.data.motions import EvenMotion, smoothed
import numpy as np
from scipy.integrate import solve_ivp

# M, the weights of V, and the friction. The belt's map has the norm that the network gives it.
MASS, WEIGHTS, RUB = np.array([[1.5, 0.4], [0.4, 0.8]]), np.array([5.0, 3.0]), 0.3
MAP = np.array([[0.8], [-0.6]])
FAMILY = {'kind': 'mechanical', 'prior': 'none', 'mass': 'constant', 'friction': {'coulomb': 0},
          'input_map': 'learned'}
BELT = {'coordinates': [{'name': 'a', 'q_unit': 'rad'}, {'name': 'b', 'q_unit': 'rad'}],
        'data': {'kind': 'arrays'}, 'hidden': [8], 'family': FAMILY}


def motion_by_a_belt(seed: int, seconds: float = 6.0) -> EvenMotion:
    """Return a motion with one motor, sampled every 10 ms, with exact accelerations."""
    rng = np.random.default_rng(seed)
    sizes, phases = rng.uniform(-2.0, 2.0, 3), rng.uniform(0.0, 6.0, 3)

    def command(t: np.ndarray) -> np.ndarray:
        return (sizes * np.sin(np.array([1.3, 2.9, 4.7]) * t[:, None] + phases)).sum(
            axis=1, keepdims=True)

    def acceleration(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.linalg.solve(MASS, (u @ MAP.T - WEIGHTS * np.sin(q) - RUB * v).T).T

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        q, v = z[None, :2], z[None, 2:]
        return np.concatenate([z[2:], acceleration(q, v, command(np.array([t])))[0]])
    t = 0.01 * np.arange(round(seconds / 0.01))
    z = solve_ivp(rate, (0.0, t[-1]), [*rng.uniform(-0.5, 0.5, 2), 0.0, 0.0], t_eval=t,
                  rtol=1e-9, atol=1e-9).y.T
    u = command(t)
    return smoothed(f'run{seed}', t, z[:, :2], z[:, 2:], u, 40.0,
                    acceleration(z[:, :2], z[:, 2:], u))


def motions_by_a_belt() -> dict[str, np.ndarray]:
    """Return arrays of six motions of 3 s, named by their seeds."""
    arrays = {}
    for seed in range(1, 7):
        motion = motion_by_a_belt(seed, 3.0)
        arrays |= {f'{seed}/t': motion.t, f'{seed}/q': motion.q, f'{seed}/dq': motion.v,
                   f'{seed}/tau': motion.tau}
    return arrays
