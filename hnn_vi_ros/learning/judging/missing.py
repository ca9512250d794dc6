# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The force that a model lacks along measured motions, and what it depends on."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.learning.data.motions import EvenMotion, joined
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
import numpy as np
from scipy.stats import median_abs_deviation
import torch

# Share of the force's variance that a quantity must explain to be named.
_SHARE = 0.15
# Deviations from the median beyond this many standard deviations of usual ones are bounded.
_USUAL = 5.0
# Quantities by which the force is explained, and remedies.
_REMEDIES = {
    'position': 'networks of V and M (residual), or another prior or other angles',
    'velocity': 'more friction (directed, stribeck, network)',
    'input': 'the gain of the motors (fade, load, input_map: learned)',
    'time': 'something drifts: learn from shorter runs',
    'own past': 'a state that is not measured, or a delay (data.delay: estimate)'}


class MissingForce(NamedTuple):
    """
    The force on a coordinate that a model lacks.

    Parameters
    ----------
    size : float
        Standard deviation of the force [N or N m].
    share : float
        Size relative to that of the measured force; 0 without one.
    causes : dict of str to float
        Shares of the force's variance that quantities explain, the largest first.

    """

    size: float
    share: float
    causes: dict[str, float]


def missing_force(network: MechanicalNetwork, motions: Sequence[EvenMotion],
                  names: Sequence[str]) -> str:
    """Return one sentence for each coordinate on the force that a model lacks, if one is plain."""
    lines = []
    for name, (size, share, causes) in zip(names, missing_forces(network, motions), strict=True):
        if causes:
            shares = ', '.join(f'{key} ({100.0 * part:.0f} %)' for key, part in causes.items())
            whole = f', {100.0 * share:.2g} % of the measured one' if share else ''
            lines.append(f'On {name} a force of {size:.3g} RMS{whole} is missing, which goes '
                         f'with {shares}: {_REMEDIES[next(iter(causes))]}.')
    return '\n'.join(lines)


def missing_forces(network: MechanicalNetwork, motions: Sequence[EvenMotion]
                   ) -> list[MissingForce]:
    """
    Return the force that a model lacks of each coordinate, and what explains it.

    The force needed for the smoothed accelerations, less that of the model, is regressed on
    functions of each quantity alone. Its own past is that of the rest which no quantity explains,
    earlier by the time of two periods of the smoothing.
    """
    q, v, a, tau = joined(motions, 'q_smooth', 'v_smooth', 'a_smooth', 'tau')
    with torch.no_grad():
        given = network.joint_forces(torch.tensor(tau))
        needed = network.forces(*map(torch.tensor, (q, v, a, tau)))
    missing, measured = (given - needed).numpy(), given.numpy().std(axis=0)
    t = np.concatenate([(motion.t - motion.t[0])[:, None] for motion in motions])
    switch = np.tanh(v / (0.1 * v.std(axis=0) + 1e-300))
    columns = {'position': [q, q**2, q**3, np.sin(q), np.cos(q)],
               'velocity': [v, v * np.abs(v), switch], 'input': [tau, np.abs(tau)],
               'time': [t, t**2]}
    lacking = []
    for one, whole in zip(missing.T, measured, strict=True):
        force, size = _bounded(one), float(one.std())
        found = {key: _explained(parts, force)[0] for key, parts in columns.items()}
        rest = _explained([part for parts in columns.values() for part in parts], force)[1]
        found['own past'] = _own_past(rest, motions) * float(rest.var() / force.var())
        lacking.append(MissingForce(size, size / whole if whole else 0.0, {
            key: share for key, share in sorted(found.items(), key=lambda one: -one[1])
            if share > _SHARE}))
    return lacking


def _bounded(force: np.ndarray) -> np.ndarray:
    """Return a force without outliers, as those of accelerations at the ends of motions."""
    middle, most = np.median(force), _USUAL * median_abs_deviation(force, scale='normal')
    bounded: np.ndarray = force.clip(middle - most, middle + most) if most else force
    return bounded - bounded.mean()


def _explained(parts: Sequence[np.ndarray], force: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the share of the variance that some columns explain, and the rest of the force."""
    matrix = np.hstack([*parts, np.ones((len(force), 1))])
    matrix = matrix / (np.abs(matrix).max(axis=0) + 1e-300)
    rest: np.ndarray = force - matrix @ np.linalg.lstsq(matrix, force, rcond=1e-10)[0]
    return 1.0 - float(rest.var() / max(force.var(), 1e-300)), rest


def _own_past(rest: np.ndarray, motions: Sequence[EvenMotion]) -> float:
    """Return the share of the rest that its own past explains."""
    lag = max(1, round(2.0 / (motions[0].cutoff * motions[0].spacing)))
    ends = np.cumsum([len(motion.t) for motion in motions])
    pairs = [(part[:-lag], part[lag:]) for part in np.split(rest, ends[:-1])
             if len(part) > 2 * lag]
    if not pairs:
        return 0.0
    before, after = map(np.concatenate, zip(*pairs, strict=True))
    spread = before.std() * after.std()
    return float((np.mean(before * after) / spread)**2) if spread else 0.0
