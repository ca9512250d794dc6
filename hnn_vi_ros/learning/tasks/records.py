# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Final training stages of machine networks: whole motions, compiled steps and their adjoint."""

from collections.abc import Callable, Sequence
from functools import partial
import math

from hnn_vi_ros.effects import has_map
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.families.choices import TrajectoryLoss
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.loop import Stage
from hnn_vi_ros.learning.fit.rigid_problem import downsampled
from hnn_vi_ros.learning.judging.ensemble import drafted
from hnn_vi_ros.models import Checkpoint
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.torch import DifferentiableSimulation
import numpy as np
import torch

# Window lengths of successive L-BFGS stages, as shares of the longest motion.
_SHARES = 0.25, 0.5, 1.0
# Number of steps per stage, and evaluations without improvement after which it ends.
_STEPS, _PATIENCE = 60, 2
# Loss of a failed step; motions that stay in their range are far below it.
_FAILED = 1e6


class Records:
    """
    Mean squared position error over whole motions, in units of their spread (output error).

    States and gradients agree with the steps of the deployed model up to rounding. The prior,
    friction coefficients and input map stay fixed.

    Parameters
    ----------
    network : MechanicalNetwork
        Network of the machine, with residual networks.
    loss : Trajectory
        Source of the integrator and of the step size, to which motions are downsampled.
    motions : sequence of EvenMotion
        Training motions.
    draft : callable
        Callable that returns the current network as a model.
    penalty : callable
        Callable that returns the penalty added to the errors.

    """

    def __init__(self, network: MechanicalNetwork, loss: TrajectoryLoss,
                 motions: Sequence[EvenMotion], draft: Callable[[], Checkpoint],
                 penalty: Callable[[], torch.Tensor]):
        self._network, self._method = network, loss.method
        self._draft, self._penalty = draft, penalty
        self._records, self._size = downsampled(motions, loss.step_size)

    def stages(self) -> list[Stage]:
        """Return stages of increasing windows; each restores the best on whole motions."""
        longest = max(len(record.t) - 1 for record in self._records)
        return [Stage(
            f'records_{share:g}', partial(self.loss, math.ceil(share * longest)), _STEPS,
            held_out=self.whole, patience=_PATIENCE, begin=self.begin) for share in _SHARES]

    def begin(self) -> None:
        """Build the simulation with the current friction and motors."""
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
        """Return the loss of consecutive windows of `steps` steps, at most a whole motion."""
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
                # L-BFGS then shortens its step.
                return _FAILED + 0.0 * torch.cat([part.flatten() for part in weights.values()]
                                                 ).sum()
            error = (motion.q[1:] - torch.tensor(record.q[rows])) / torch.tensor(self._size)
            errors.append(error.flatten())
        return torch.cat(errors).square().mean() + self._penalty()

    def whole(self) -> float:
        """Return the loss of whole motions."""
        with torch.no_grad():
            return float(self.loss(max(len(record.t) for record in self._records)))
