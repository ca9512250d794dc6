# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Machines of these tests: their motions, and their networks as files and as compiled models."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from helpers import difference
from hnn_vi_ros.learning import EvenMotion, MotionSource, read_motions
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.families.choices import AUTO
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.families.priors import PlanarChain
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.model_files import describe_machine
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
from hnn_vi_ros.simulation import Simulation
import numpy as np
from scipy.integrate import solve_ivp
import torch


def from_file(path: Path | str, data: MotionSource, d: int = 2) -> tuple[list[EvenMotion], str]:
    """Return the motions of d coordinates in a file, and what is told of them."""
    return read_motions(Path(), data, d * ['q'], [str(path)])


def driven(simulation: Simulation, tau: np.ndarray, steps: int = 1
           ) -> tuple[np.ndarray, np.ndarray]:
    """Return q and v of each sample, with means of two samples' forces (k, d) between them."""
    q, v = np.empty((2, *tau.shape))
    for k in range(len(tau)):
        q[k], v[k] = simulation.q, simulation.dH_dp
        if k + 1 < len(tau):
            simulation.set_command(0.5 * (tau[k] + tau[k + 1]))
            simulation.advance(steps)
    return q, v


def machine_config(names: str = 'a', kind: str = 'continuous', more: dict | None = None,
                   **family: object) -> MachineConfig:
    """Return a configuration of coordinates of one letter, without a prior unless it is given."""
    return MachineConfig.model_validate({
        'coordinates': [{'name': name, 'kind': kind} for name in names],
        'data': {'kind': 'arrays'},
        'family': {'kind': 'mechanical', 'prior': 'none', **family}, **(more or {})})


def shaken(network: MechanicalNetwork) -> MechanicalNetwork:
    """Move a network away from its initial values, at which M and friction are near constants."""
    with torch.no_grad():
        for parameter in network.parameters():
            if parameter.requires_grad:
                parameter.add_(0.3 * torch.randn(parameter.shape, dtype=torch.float64,
                                                 generator=torch.Generator().manual_seed(1)))
        if isinstance(network.prior, PlanarChain):
            # Fits keep inertias of motors positive.
            network.prior.raw.split(network.prior._sizes)[3].abs_()
    return network


def compiled(network: MechanicalNetwork, motions: Sequence[EvenMotion], folder: Path,
             **family: object) -> tuple[MechanicalHamiltonian, str]:
    """Return what simulates a network of coordinates x0, x1, ..., and its file."""
    config = MachineConfig.model_validate({
        'coordinates': [{'name': f'x{i}', 'kind': kind}
                        for i, kind in enumerate(network.structure.kinds)],
        'data': {'kind': 'arrays'}, 'family': {'kind': 'mechanical', 'prior': 'none', **family}})
    checkpoint = describe_machine(network, config, motions, name='random')
    save_checkpoint(folder / 'm.safetensors', checkpoint)
    return MechanicalHamiltonian(checkpoint), str(folder / 'm.safetensors')


def slopes_along(loss: Callable[[], torch.Tensor], parameters: Sequence[torch.nn.Parameter],
                 step: float) -> tuple[float, float]:
    """Return the derivative of a loss in a random direction, and its difference of order 6."""
    generator = torch.Generator().manual_seed(7)
    direction = [torch.randn(part.shape, dtype=torch.float64, generator=generator)
                 for part in parameters]
    slopes = torch.autograd.grad(loss(), parameters, materialize_grads=True, allow_unused=True)

    def moved(distance: float) -> float:
        with torch.no_grad():
            for sign in (1.0, -1.0):
                for part, move in zip(parameters, direction, strict=True):
                    part.add_(move, alpha=sign * distance)
                if sign > 0.0:
                    found = float(loss())
        return found
    return sum(float((slope * move).sum()) for slope, move in zip(
        slopes, direction, strict=True)), difference(moved, step)


@cache
def carriage(seed: int, back: float, stiffness: float = 0.0, rest: float = 0.0) -> EvenMotion:
    """Return a carriage of 2 kg, whose friction is 1 N ahead, and another back, every 10 ms."""
    t = 0.01 * np.arange(500)
    rng = np.random.default_rng(seed)
    force = 3.0 * np.sin(t[:, None] * rng.uniform(1.0, 4.0, 3) + rng.uniform(0.0, 6.0, 3)).sum(1)

    def rates(time: float, z: np.ndarray) -> list[float]:
        side = np.tanh(z[1] / 0.05)
        return [z[1], 0.5 * (np.interp(time, t, force) - 0.5 * z[1] - stiffness * (z[0] - rest)
                             - (0.5 * (1.0 + side) + 0.5 * (1.0 - side) * back) * side)]
    z = solve_ivp(rates, (0.0, t[-1]), np.zeros(2), t_eval=t, rtol=1e-8, atol=1e-8).y.T
    noise = rng.normal(size=z.shape) * [2e-4, 2e-3]
    return smoothed(f'run{seed}', t, *np.hsplit(z + noise, 2), force[:, None], 40.0)


def sliding(**family: object) -> MachineConfig:
    return machine_config('x', 'prismatic', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, **{'prior': AUTO, **family})


@cache
def kinked_spring(begin: float) -> EvenMotion:
    """Return a driven mass of 0.5 kg at 20 N/m below 0.07 m and 60 N/m above, by its positions."""
    t = 0.02 * np.arange(1000)
    force = (0.4 * np.sin(t[:, None] * [2.1, 5.3, 8.0] + [0.3, 1.0, begin])).sum(1)

    def rates(time: float, z: np.ndarray) -> list[float]:
        above = max(z[0] - 0.07, 0.0)
        return [z[1], 2.0 * (np.interp(time, t, force) - 0.35 * z[1] - 20.0 * z[0] - 40.0 * above)]
    z = solve_ivp(rates, (0.0, t[-1]), [begin, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y.T
    q = z[:, :1] + 1e-3 * np.random.default_rng(5).normal(size=(len(t), 1))
    return smoothed('spring', t, q, None, force[:, None], 20.0)


@cache
def double_well() -> EvenMotion:
    """Return a driven mass of 0.5 kg, V = -6 q^2 + 225 q^4, by its positions every 10 ms."""
    t = 0.01 * np.arange(1000)
    force = (0.8 * np.sin(t[:, None] * [2.1, 5.3, 8.0] + [0.3, 1.0, 2.0])).sum(1)
    z = solve_ivp(lambda time, z: [z[1], 2.0 * (
        np.interp(time, t, force) - 0.35 * z[1] + 12.0 * z[0] - 900.0 * z[0]**3)], (0.0, t[-1]),
        np.array([0.12, 0.0]), t_eval=t, rtol=1e-9, atol=1e-11).y.T
    q = z[:, :1] + 3e-4 * np.random.default_rng(5).normal(size=(len(t), 1))
    return smoothed('well', t, q, None, force[:, None], 40.0)
