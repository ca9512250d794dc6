# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Summary of the identified parameters of a robot, in the report of a training run."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from hnn_vi_ros.learning.data.runs import Run
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.model_card import ModelCard
import numpy as np
import torch

# Half an interval that holds 95 % of a normal distribution, in standard deviations.
_HALF = 1.96
# Samples at a time: more would fill the memory.
_CHUNK = 5000


def with_force_errors(checkpoint: Checkpoint, network: MechanicalNetwork,
                      motions: Sequence[Run]) -> Checkpoint:
    """Return the model of a rigid body whose card tells its forces' errors along motions."""
    mechanical = checkpoint.card.mechanical
    if mechanical is None or mechanical.prior is None or mechanical.prior.identification is None:
        return checkpoint
    error, share = force_errors(network, motions)
    update = {'force_error': error} | ({'residual_share': share} if share else {})
    prior = mechanical.prior.model_copy(update={
        'identification': mechanical.prior.identification.model_copy(update=update)})
    return replace(checkpoint, card=checkpoint.card.model_copy(update={
        'mechanical': mechanical.model_copy(update={'prior': prior})}))


def force_errors(network: MechanicalNetwork, motions: Sequence[Run]
                 ) -> tuple[list[float], list[float]]:
    """
    Return how far forces are off along motions, and the share that networks have in them.

    Returns
    -------
    list of float, d
        Squared error over the variance, of each joint [1].
    list of float, d
        RMS of the forces of networks over that of all forces [1]; empty without networks.

    """
    errors, added, measured = zip(*(_errors(network, motion) for motion in motions), strict=True)
    error, forces = np.concatenate(errors), np.concatenate(measured)
    found = ((error**2).mean(axis=0) / forces.var(axis=0)).tolist()
    if not network.structure.residual:
        return found, []
    share = np.sqrt((np.concatenate(added)**2).mean(axis=0) / (forces**2).mean(axis=0))
    return found, share.tolist()


def _errors(network: MechanicalNetwork, motion: Run) -> tuple[np.ndarray, ...]:
    """Return errors of forces, the part of networks, and the measured forces, (N, d) each."""
    states = motion.q_smooth, motion.v_smooth, motion.a_smooth
    chunks = zip(*(torch.tensor(part).split(_CHUNK) for part in states), strict=True)
    forces, added = [], []
    with torch.no_grad():
        for q, v, a in chunks:
            forces.append(network.forces(q, v, a).numpy())
            added.append(network.added_forces(q, v, a).numpy())
    return np.concatenate(forces) - motion.tau, np.concatenate(added), motion.tau


def identified_text(card: ModelCard) -> str:
    """Return the tables of identified parameters; '' for other models."""
    prior = None if card.mechanical is None else card.mechanical.prior
    if prior is None or prior.identification is None:
        return ''
    return '\n'.join(_lines(card)) + '\n'


def _lines(card: ModelCard) -> Iterator[str]:
    assert card.mechanical is not None and card.mechanical.prior is not None
    prior, friction = card.mechanical.prior, card.mechanical.friction
    found, names = prior.identification, [coordinate.name for coordinate in card.coordinates]
    assert found is not None
    yield ('\n## Identified\n\nWhat the motions determine of the inertial parameters is '
           f'{len(found.base_parameters)} combinations of them; the interval holds the true value '
           'in 95 % of cases, if the model lacks nothing but the noise of forces.\n')
    yield '| base parameter | value | ± 95 % | unit |\n|---|---|---|---|'
    for one in found.base_parameters:
        yield (f'| {sum_text(one.combination)} | {one.value:.5g} | '
               f'{_HALF * one.standard_error:.2g} | {one.unit} |')
    if found.weak:
        yield ('\nThe data hardly determine these, whose values stay close to the URDF: '
               + '; '.join(sum_text(one.combination) for one in found.weak) + '.')
    yield ('\nNo force of the data depends on these changes, so along them the robot is as in the '
           f'URDF, or the next that a body can be ({len(found.held)}):\n')
    yield from (f'- {sum_text(one)}' for one in found.held)
    yield '\n| joint | error of force, share of its variance | viscous | Coulomb | offset |' + (
        ' networks, share of force |' if found.residual_share else '')
    yield '|---|---|---|---|---|' + ('---|' if found.residual_share else '')
    for j, name in enumerate(names):
        coulomb = ', '.join(f'{term.force[j]:.4g}' for term in friction.coulomb) or '-'
        share = f' {found.residual_share[j]:.3g} |' if found.residual_share else ''
        yield (f'| {name} | {found.force_error[j]:.4g} | {friction.viscous[j]:.4g} | {coulomb} | '
               f'{prior.values[f"{name}.offset"]:.4g} |{share}')


def sum_text(combination: Mapping[str, float]) -> str:
    """Return a linear combination as people write it."""
    text = ' '.join(f'{"-" if factor < 0.0 else "+"} '
                    f'{"" if abs(factor) == 1.0 else f"{abs(factor):.4g} "}{name}'
                    for name, factor in combination.items())
    return text.removeprefix('+ ')
