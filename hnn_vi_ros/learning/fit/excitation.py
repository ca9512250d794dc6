# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated excitation of a robot, as a replacement for measured motions."""

from typing import Literal

from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.learning.data.motions import (
    even_motions, EvenMotion, Motion, MotionData, Recording)
from hnn_vi_ros.learning.families.priors import RigidTree
from hnn_vi_ros.models import tree_card, values_of
import numpy as np
from pydantic import Field
import torch

# Number of sines per joint, and the width of the speed range in which dry friction changes
# sign, as in the effect joint_friction [rad/s], [m/s].
_SINES, _SPEED = 5, 0.01
# Share of the range between limits that is used, and amplitude of joints without limits
# [rad], [m].
_ROOM, _UNLIMITED = 0.4, 1.5


class ExcitationData(MotionData):
    """Motions of joints along sums of sines; forces of the URDF with damping and friction."""

    kind: Literal['excitation'] = 'excitation'
    runs: int = Field(5, ge=1, le=1000)
    duration: float = Field(10.0, gt=0.0, le=1000.0, description='duration of each run [s]')
    interval: float = Field(0.005, gt=0.0, description='sampling interval [s]')
    fastest: float = Field(1.0, gt=0.0, description='maximum frequency of the sines [Hz]')
    noise_tau: float = Field(0.0, ge=0.0, description=(
        'standard deviation of the noise of forces, relative to the RMS of each'))


def excited_motions(data: ExcitationData, robot: RigidBodyTree, seed: int
                    ) -> tuple[list[EvenMotion], str]:
    """
    Return computed motions of a robot and their description.

    Parameters
    ----------
    data : ExcitationData
        Number, speed and noise of the motions.
    robot : RigidBodyTree
        The robot.
    seed : int
        Seed of the sines and the noise.

    """
    rng, d = np.random.default_rng(seed), robot.dimension
    t = data.interval * np.arange(round(data.duration / data.interval) + 1)
    damping, friction = (np.array([getattr(joint, name) for joint in robot.joints])
                         for name in ('damping', 'friction'))
    card = tree_card(robot.bodies, dict(enumerate(robot.joints)), robot.robot.name)
    values, runs = values_of(card, robot.bodies), []
    tree = RigidTree(card, values)
    for number in range(data.runs):
        q, v, a = _sines(rng, robot, t, data.fastest)
        with torch.no_grad():
            columns = tree.columns(*map(torch.tensor, (q, v, a))).numpy()
        tau = columns @ values.ravel() + damping * v + friction * np.tanh(v / _SPEED)
        size = np.sqrt(np.mean(tau**2, axis=0))
        # Three draws: the random numbers that follow are those of stored results.
        tau += data.noise_tau * size * rng.normal(size=(3, len(t), d))[2]
        runs.append(Motion(f'run{number}', f'run{number}', t, q, v, tau, a))
    return even_motions(Recording(
        runs, f'{robot.robot.name} along sums of sines, seed {seed}', 'none'), data)


def _sines(rng: np.random.Generator, robot: RigidBodyTree, t: np.ndarray, fastest: float
           ) -> tuple[np.ndarray, ...]:
    """Return coordinates, velocities and accelerations, shape (N, d) each."""
    found = np.zeros((3, len(t), robot.dimension))
    for j, joint in enumerate(robot.joints):
        low, high = joint.bounds
        middle, room = 0.0, _UNLIMITED
        if low is not None and high is not None and high > low:
            middle, room = 0.5 * (low + high), min(_ROOM * (high - low), _UNLIMITED)
        # Slow sines have large amplitudes; otherwise fast ones would dominate all forces.
        rate = 2.0 * np.pi * fastest * rng.uniform(0.1, 1.0, _SINES)
        size = rng.uniform(0.5, 1.0, _SINES) / rate
        size *= room / size.sum()
        phase = rate * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, _SINES)
        found[0, :, j] = middle + np.sin(phase) @ size
        found[1, :, j] = np.cos(phase) @ (size * rate)
        found[2, :, j] = -np.sin(phase) @ (size * rate**2)
    return tuple(found)
