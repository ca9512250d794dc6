# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fit the model of a machine: its rigid body by least squares, then networks by gradients."""

from collections.abc import Sequence
from dataclasses import replace

from hnn_vi_ros.errors import counted, DataError
from hnn_vi_ros.learning.data.motions import delayed, EvenMotion, of_positions
from hnn_vi_ros.learning.families.choices import AUTO, RigidBodyChoice, Structure
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import FittedRigidBody
from hnn_vi_ros.learning.fit.inertias import identify_inertias
from hnn_vi_ros.learning.fit.loop import Fitted, Stage, Train, trained, TrainingProblem
from hnn_vi_ros.learning.fit.machine import Fading, Penalty, scales_of, stages_of
from hnn_vi_ros.learning.fit.records import Records
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body, fit_records, fit_rigid_body
from hnn_vi_ros.models import PLANAR_CHAIN
import numpy as np
from scipy.optimize import minimize_scalar

# Largest estimated delay in samples; the resolution is a tenth of a sample.
MOST_DELAY = 5.0


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
