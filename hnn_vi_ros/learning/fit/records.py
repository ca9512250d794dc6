# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Final training stages of machine networks: whole motions, compiled steps and their adjoint."""

from collections.abc import Callable, Sequence
from functools import partial
import math

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import downsampled
from hnn_vi_ros.learning.fit.loop import Stage
from hnn_vi_ros.learning.fit.machine import Penalty
from hnn_vi_ros.learning.fit.model_files import describe_machine, drafted, machine_scene
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
    config : MachineConfig
        Source of the integrator and of the step size, to which motions are downsampled.
    motions : sequence of EvenMotion
        Training motions.
    penalty : callable, optional
        Penalty added to the errors.

    """

    def __init__(self, config: MachineConfig, motions: Sequence[EvenMotion],
                 penalty: Penalty | None = None):
        self._config, self._motions, self._penalty = config, motions, penalty
        self._records, self._size = downsampled(motions, config.windows.step_size)
        self._built: tuple[bytes, DifferentiableSimulation] | None = None

    def stages(self) -> list[Stage]:
        """Return stages of increasing windows; each restores the best on whole motions."""
        longest = max(len(record.t) - 1 for record in self._records)
        return [Stage(
            f'records_{share:g}', partial(self._begin, math.ceil(share * longest)), _STEPS,
            held_out=self.whole, patience=_PATIENCE) for share in _SHARES]

    def _begin(self, steps: int, network: MechanicalNetwork, _: torch.Generator
               ) -> Callable[[], torch.Tensor]:
        return partial(self.loss, network, steps)

    def _simulation(self, network: MechanicalNetwork) -> DifferentiableSimulation:
        """Return the simulation with the network's friction and motors, built when they change."""
        fixed = b''.join(part.detach().numpy().tobytes() for name, part in
                         network.named_parameters() if '.linears.' not in name)
        if self._built is None or self._built[0] != fixed:
            checkpoint = describe_machine(network, self._config, self._motions)
            with drafted(checkpoint) as model:
                self._built = fixed, DifferentiableSimulation(machine_scene(
                    model, checkpoint.card, self._records[0].spacing,
                    self._config.windows.method, True), [*network.tensors()])
        return self._built[1]

    def loss(self, network: MechanicalNetwork, steps: int) -> torch.Tensor:
        """Return the loss of consecutive windows of `steps` steps, at most a whole motion."""
        simulation, weights, errors = self._simulation(network), network.tensors(), []
        for record in self._records:
            length = min(steps, len(record.t) - 1)
            starts = np.arange(0, len(record.t) - length, length)
            rows = starts + np.arange(1, length + 1)[:, None]
            q, v = torch.tensor(record.q_smooth[starts]), torch.tensor(record.v_smooth[starts])
            try:
                motion = simulation(
                    q, network.momenta(q, v)[0], duration=length * record.spacing,
                    commands=torch.tensor(record.forces[rows - 1]), parameters=weights)
            except HnnViRosError:
                # L-BFGS then shortens its step.
                return _FAILED + 0.0 * torch.cat([part.flatten() for part in weights.values()]
                                                 ).sum()
            error = (motion.q[1:] - torch.tensor(record.q[rows])) / torch.tensor(self._size)
            errors.append(error.flatten())
        loss = torch.cat(errors).square().mean()
        return loss if self._penalty is None else loss + self._penalty(
            network, torch.Generator().manual_seed(self._config.seed))

    def whole(self, network: MechanicalNetwork) -> float:
        """Return the loss of whole motions."""
        with torch.no_grad():
            return float(self.loss(network, max(len(record.t) for record in self._records)))
