# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit the model of a machine: its rigid body by least squares, then networks by gradients.

The last stages of the networks are on whole motions, by compiled steps and their adjoint.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
import math

from hnn_vi_ros.errors import counted, DataError, HnnViRosError
from hnn_vi_ros.learning.data.motions import delayed, EvenMotion, of_positions
from hnn_vi_ros.learning.families.choices import AUTO, RigidBodyChoice, Structure
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import downsampled, FittedRigidBody
from hnn_vi_ros.learning.fit.inertias import identify_inertias
from hnn_vi_ros.learning.fit.loop import Fitted, Stage, Train, trained, TrainingProblem
from hnn_vi_ros.learning.fit.machine import Fading, Penalty, scales_of, stages_of
from hnn_vi_ros.learning.fit.model_files import describe_machine, drafted, machine_scene
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body, fit_records, fit_rigid_body
from hnn_vi_ros.models import PLANAR_CHAIN
from hnn_vi_ros.torch import DifferentiableSimulation
import numpy as np
from scipy.optimize import minimize_scalar
import torch

# Largest estimated delay in samples; the resolution is a tenth of a sample.
MOST_DELAY = 5.0
# Window lengths of successive L-BFGS stages, as shares of the longest motion.
_SHARES = 0.25, 0.5, 1.0
# Number of steps per stage, and evaluations without improvement after which it ends.
_STEPS, _PATIENCE = 60, 2
# Loss of a failed step; motions that stay in their range are far below it.
_FAILED = 1e6


def fit_machine(config: MachineConfig, motions: Sequence[EvenMotion],
                rigid: FittedRigidBody | None = None, train: Train = trained) -> Fitted:
    """
    Fit the model of a machine.

    Parameters
    ----------
    config : MachineConfig
        Family, loss and seed; the prior is chosen.
    motions : sequence of EvenMotion
        Training motions.
    rigid : FittedRigidBody, optional
        Rigid body to which networks are added; by default it is fitted as well.
    train : callable
        Runs the stages of the networks.

    Returns
    -------
    Fitted
        A FittedRigidBody if there are no networks.

    Raises
    ------
    DataError
        Forces belong to motors instead of joints, or no prior can follow the motions.

    """
    check_motors(config, motions)
    family = config.family
    structure, scales = config.structure(), scales_of(motions, family.input_map == 'learned')
    if structure.prior is None:
        network = MechanicalNetwork(structure, config.hidden, scales, config.seed)
        return train(TrainingProblem(network, _stages(config, motions), config.seed))
    if rigid is None:
        rigid = fit_prior(config, structure, motions)
    if not structure.residual:
        # Nothing is left to train, so that a saved run of this model cannot exist.
        train(TrainingProblem(rigid.module))
        return rigid
    own = rigid.module.structure
    structure = replace(structure, angles=own.angles, friction=own.friction)
    network = MechanicalNetwork(structure, config.hidden, scales, config.seed).with_prior_of(
        rigid.module)
    fading = Fading(structure, motions, family.residual_weight, family.fade_weight)
    found = train(TrainingProblem(
        network, _stages(config, motions, fading), config.seed, rigid.losses))
    return replace(found, noise=rigid.noise)


def _stages(config: MachineConfig, motions: Sequence[EvenMotion], penalty: Penalty | None = None
            ) -> list[Stage]:
    """Return the stages, at the end those on whole motions if the loss requests them."""
    records = Records(config, motions, penalty).stages() if config.windows.records else []
    return [*stages_of(config, motions, penalty), *records]


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


def check_motors(config: MachineConfig, motions: Sequence[EvenMotion]) -> None:
    """Raise DataError for forces of motors instead of joints, unless the family maps them."""
    d, motors = motions[0].q.shape[1], motions[0].tau.shape[1]
    if motors == d:
        return
    if isinstance(config.family, RigidBodyChoice):
        raise DataError(f'forces of the data: {counted(motors, "column")} for {d} joints; a '
                        'rigid_body requires the force of each joint')
    if config.family.input_map != 'learned':
        raise DataError(f'data.tau: {counted(motors, "column")}, expected {d}, one for each '
                        'coordinate; add a column of zeros for a joint without a motor, or set '
                        'family.input_map: learned')


def fit_prior(config: MachineConfig, structure: Structure, motions: Sequence[EvenMotion]
              ) -> FittedRigidBody:
    """Return a fitted prior with friction and without networks, or raise DataError."""
    family, loss = config.family, config.windows
    if structure.prior == PLANAR_CHAIN:
        found = best_rigid_body(loss, motions, structure, family.input_map == 'learned')
        checked = 'angles of its links from the vertical'
    else:
        network = MechanicalNetwork(
            replace(structure, residual=False, friction_features=None), config.hidden,
            scales_of(motions), config.seed)
        if isinstance(family, RigidBodyChoice):
            checked = 'URDF'
            found = identify_inertias(network, config, motions,
                                      family.rotor_inertia == 'identified', family.offsets)
            if not np.isfinite([*found.losses.values()]).all():
                found = None
        else:
            checked = 'coordinates (they must be those of the system)'
            found = fit_rigid_body([network], loss, motions)
    if found is None:
        raise DataError(f'prior: no {structure.prior} fits these motions; check the {checked} and '
                        'the data for outliers')
    if loss.records and found.numbers is None:
        network, error = fit_records(found.module, loss, motions)
        return replace(found, module=network, losses={**found.losses, 'records': error})
    return found


def estimated_delay(config: MachineConfig, motions: Sequence[EvenMotion]) -> float:
    """
    Return the estimated delay of the forces in samples, not necessarily an integer.

    The delay minimises the loss of a rigid body, which is refitted for each trial delay:
    parameters fitted with another delay would hide a part of it.

    Raises
    ------
    DataError
        There are no forces, or no rigid body can follow the motions.

    """
    if not any(motion.tau.any() for motion in motions):
        raise DataError('data.delay: cannot be estimated without forces; remove it')
    family, loss = config.family, config.windows.model_copy(update={
        'records': False, 'windows': config.windows.windows[:1]})
    rigid = {'residual': []} if isinstance(family, RigidBodyChoice) else {
        'residual': False, 'prior': PLANAR_CHAIN if family.prior in (None, AUTO) else family.prior}
    # A friction network is also excluded from a rigid body.
    config = config.model_copy(update={'loss': loss, 'family': family.model_copy(update=rigid | {
        'friction': family.friction.model_copy(update={'network': False})})})
    structure = config.structure()
    # Losses of smoothed states can be compared, residuals in units of each fit's noise cannot.
    # Filtered velocities would add their own delay.
    motions = [replace(motion, v=motion.v_smooth) for motion in of_positions(motions)]
    angles = fit_prior(config, structure, motions).module.structure.angles

    def error(delay: float) -> float:
        late = [delayed(motion, delay) for motion in motions]
        return [*fit_prior(config, replace(structure, angles=angles), late).losses.values()][-1]
    return float(minimize_scalar(error, bounds=(-MOST_DELAY, MOST_DELAY), method='bounded',
                                 options={'xatol': 0.1}).x)
