# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Machines of these tests: their motions, and their networks as files and as compiled models."""

from collections.abc import Callable, Sequence
from pathlib import Path

from helpers import difference
from hnn_vi_ros.learning import EvenMotion, MotionSource, read_motions
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.model_files import describe_machine
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
from hnn_vi_ros.simulation import Simulation
import numpy as np
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
