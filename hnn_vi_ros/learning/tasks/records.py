# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Last stages of a machine's networks: whole motions, by compiled steps and their adjoint."""

from collections.abc import Callable, Sequence
from functools import partial
import math

from hnn_vi_ros.effects import has_map
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.families.choices import Trajectory
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.loop import Stage
from hnn_vi_ros.learning.fit.rigid_body import thinned
from hnn_vi_ros.learning.judging.ensemble import drafted
from hnn_vi_ros.models import Checkpoint
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.torch import DifferentiableSimulation
import numpy as np
import torch

# Shares of the longest motion that windows last, one stage of L-BFGS after another.
_SHARES = 0.25, 0.5, 1.0
# Steps of each stage, and looks at whole motions without a gain after which it ends.
_STEPS, _PATIENCE = 60, 2
# The loss where a step fails, which motions that stay in their range do not reach.
_FAILED = 1e6


class Records:
    """
    Mean square errors of positions over whole motions, in units of their spread (output error).

    States are those of the model that will run, and gradients those of its steps, to rounding.
    Prior, numbers of friction and input map stay as they are.

    Parameters
    ----------
    network : MechanicalNetwork
        With networks.
    loss : Trajectory
        Its step size, by which motions are thinned out, and its method.
    motions : sequence of EvenMotion
        What to learn from.
    draft : callable
        Returns the model of the network as it is.
    penalty : callable
        Returns what is added to the errors.

    """

    def __init__(self, network: MechanicalNetwork, loss: Trajectory, motions: Sequence[EvenMotion],
                 draft: Callable[[], Checkpoint], penalty: Callable[[], torch.Tensor]):
        self._network, self._method = network, loss.method
        self._draft, self._penalty = draft, penalty
        self._records, self._size = thinned(motions, loss.step_size)

    def stages(self) -> list[Stage]:
        """Return stages of longer and longer windows, which end with what is best on the whole."""
        longest = max(len(record.t) - 1 for record in self._records)
        return [Stage(
            f'records_{share:g}', partial(self.loss, math.ceil(share * longest)), _STEPS,
            held_out=self.whole, patience=_PATIENCE, begin=self.begin) for share in _SHARES]

    def begin(self) -> None:
        """Make the simulation ready, with friction and motors as they are now."""
        checkpoint, d = self._draft(), self._network.d
        with drafted(checkpoint) as model:
            driven = {'model': model} if has_map(checkpoint) else {
                'coordinates': [one.name for one in checkpoint.card.coordinates]}
            self._simulation = DifferentiableSimulation(Scene.build(
                hamiltonian={'kind': 'learned', 'model': model, 'confine': False},
                integrator=self._method, step_size=self._records[0].spacing,
                initial_state=(d * [0.0], d * [0.0]), effects=[
                    {'kind': 'external_force', 'timeout': 1e9, **driven},
                    {'kind': 'learned_friction', 'model': model}]), [*self._network.tensors()])

    def loss(self, steps: int) -> torch.Tensor:
        """Return the loss of windows of so many steps, one after another, at most the whole."""
        weights, errors = self._network.tensors(), []
        for record in self._records:
            length = min(steps, len(record.t) - 1)
            starts = np.arange(0, len(record.t) - length, length)
            rows = starts + np.arange(1, length + 1)[:, None]
            q, v = torch.tensor(record.q_smooth[starts]), torch.tensor(record.v_smooth[starts])
            try:
                motion = self._simulation(
                    q, self._network.momenta(q, v)[0], duration=length * record.spacing,
                    commands=torch.tensor(record.forces[rows - 1]), parameters=weights)
            except HnnViRosError:
                # L-BFGS takes a shorter step.
                return _FAILED + 0.0 * torch.cat([part.flatten() for part in weights.values()]
                                                 ).sum()
            error = (motion.q[1:] - torch.tensor(record.q[rows])) / torch.tensor(self._size)
            errors.append(error.flatten())
        return torch.cat(errors).square().mean() + self._penalty()

    def whole(self) -> float:
        """Return the loss of whole motions."""
        with torch.no_grad():
            return float(self.loss(max(len(record.t) for record in self._records)))
