# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train families that learn a field of (q, p), from states and their rates."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.exact_data import ExactData, sample_exact
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.families.base import EnergyFamily, Trainable
from hnn_vi_ros.learning.fit.config import FieldConfig
from hnn_vi_ros.learning.fit.field import FieldProblem
from hnn_vi_ros.learning.judging.energy_account import friction_work, integrated
from hnn_vi_ros.learning.judging.ensemble import (
    calibrated, combined, ensemble_text, field_calibration, held_out, resampled)
from hnn_vi_ros.learning.judging.report import Judged, plot_field
from hnn_vi_ros.learning.tasks.base import Task
from hnn_vi_ros.models.checkpoint import Checkpoint, widths_of
from hnn_vi_ros.models.energy_error import energy_error, energy_spread, EnergyError
from hnn_vi_ros.models.ensemble import load_member
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.model_card import ModelCard
from hnn_vi_ros.version import __version__
import numpy as np
import torch

# States of the box at which the learned energy is compared with the true one.
_STATES = 2000


class FieldTask(Task):
    """
    A model of H(q, p), or of a Lagrangian or two-form, trained on states; see Task.

    Parameters
    ----------
    source : Path
        The file of the configuration.
    config : FieldConfig
        How to train.
    given : sequence of str
        Files that replace those of the configuration.
    ensemble : bool
        Whether members are trained, each on resampled data.

    """

    picture = 'field'

    def __init__(self, source: Path, config: FieldConfig, given: Sequence[str], ensemble: bool):
        self._config, self._ensemble = config, ensemble
        self._dataset = make_dataset(config.data, config.seed, source, given)
        self._known, self._test = held_out(config, self._dataset) if ensemble else (
            self._dataset, None)

    def arrays(self) -> Iterator[np.ndarray]:
        """Yield the arrays of the data; see Task."""
        return (part for part in vars(self._dataset).values() if isinstance(part, np.ndarray))

    def problem(self, config: FieldConfig, device: str) -> FieldProblem:
        """Return a fresh model with its loss; see Task."""
        return FieldProblem(config, resampled(self._known, config.seed) if self._ensemble
                            else self._known, device)

    def describe(self, problem: FieldProblem, config: FieldConfig, name: str, command: str
                 ) -> Checkpoint:
        """Return a trained model with its card; see Task."""
        problem.to('cpu')
        return describe(problem, config, name, command)

    def combined(self, members: list[Checkpoint], name: str) -> Checkpoint:
        """Return members as one model, whose box is that of all data; see Task."""
        return combined(members, name, self._known.box)

    def judged(self, checkpoint: Checkpoint, problem: FieldProblem) -> Judged:
        """Return the model with the error of its energy, where that is known; see Task."""
        config, card = self._config, checkpoint.card
        error = judge_energy(checkpoint, problem.module, config, self._known)
        checkpoint = replace(checkpoint, card=card.model_copy(update={'energy_error': error}))
        if self._ensemble:
            checkpoint = calibrated(checkpoint, lambda: field_calibration(
                checkpoint, config, self._test))
        card = checkpoint.card
        lines = [', '.join(f'{key} {value:.3g}' for key, value in card.losses.items())]
        if error is not None:
            lines.append(f'energy error: RMS {error.rms:.3g} J, largest {error.sup:.3g} J, '
                         f'against the {error.compared_with}')
        lines.append(ensemble_text(card))
        return Judged(checkpoint, '\n'.join(filter(None, lines)), ensemble_text(card),
                      lambda path: plot_field(problem.compare(), card, path))


def describe(problem: FieldProblem, config: FieldConfig, name: str, command: str) -> Checkpoint:
    """Return a trained model with its card."""
    family, dataset, reference = problem.module, problem.dataset, config.reference
    box = replace(dataset, p=family.momenta(dataset)).box
    centre = np.mean([*box.q, *box.p], axis=1)
    z0 = centre if reference is None else np.array([*reference.q, *reference.p])
    networks = family.networks(z0, 0.0 if reference is None else reference.energy)
    card = ModelCard(
        name=name, family=config.family.kind, **widths_of(networks), **family.constants(),
        scheme=config.loss.scheme, coordinates=config.coordinates, box=box,
        dataset=dataset.description, seed=config.seed, losses=problem.final_losses(),
        units=problem.units, training_command=command, package_version=__version__,
        confine=config.confine)
    return Checkpoint(card, networks)


def judge_energy(checkpoint: Checkpoint, family: Trainable, config: FieldConfig,
                 dataset: Dataset) -> EnergyError | None:
    """
    Return the error of the learned energy, as far as the energy is known; None if it is not.

    For exact data the reference is the true energy, at new states of the box. For others it is the
    energy along each motion: it changes by the work of the forces that the family has; where the
    family has none, by the work of friction that is fitted.

    Parameters
    ----------
    checkpoint : Checkpoint
        The trained model.
    family : Trainable
        The same, for the momenta of the states.
    config : FieldConfig
        How it was trained.
    dataset : Dataset
        The training data.

    """
    row = FAMILIES[checkpoint.card.family]
    hamiltonian = load_member(checkpoint, None)  # refuses a Lagrangian that is singular
    if isinstance(config.data, ExactData):
        data = config.data.model_copy(update={
            'samples': _STATES, 'edge_share': 0.0, 'trajectory': None, 'noise': 0.0})
        dataset = sample_exact(data, config.seed + 1)
        assert dataset.energies is not None, 'exact data have them'
        return energy_error(hamiltonian.energy(dataset.q, family.momenta(dataset)),
                            dataset.energies, config.seed)
    if dataset.t is None:
        return None  # without times there is no motion along which anything is known
    p = family.momenta(dataset)
    learned = hamiltonian.energy(dataset.q, p)
    if isinstance(family, EnergyFamily) and not row.conservative:
        work = model_work(family, replace(dataset, p=p), dataset.motion)
        return energy_spread(learned, dataset.motion, config.seed, work,
                             'work of forces and friction')
    work, power = friction_work(learned, dataset.motion, dataset.t, dataset.dq_dt)
    if power == 0.0:
        return energy_spread(learned, dataset.motion, config.seed)
    error = energy_spread(learned, dataset.motion, config.seed, work, 'work of fitted friction')
    return error.model_copy(update={'friction_power': power})


def model_work(family: EnergyFamily, dataset: Dataset, trajectory: np.ndarray) -> np.ndarray:
    """
    Return the work of the forces that a model has learned, along measured motions.

    Its own rates (q', p') have the power H_q . q' + H_p . p': Hamilton's equations have none.

    Parameters
    ----------
    family : EnergyFamily
        The model.
    dataset : Dataset
        States and commands, with their times.
    trajectory : np.ndarray of int, shape (N,)
        Of which each state is one.

    Returns
    -------
    np.ndarray, shape (N,)
        W [J], from zero on in each trajectory, by the trapezoidal rule.

    """
    z = torch.tensor(np.hstack([dataset.q, dataset.p]))
    commands = None if dataset.commands is None else torch.tensor(dataset.commands)
    rates = family.vector_field(z, commands)
    power = (family.gradient(z) * rates).sum(dim=1).detach().numpy()
    assert dataset.t is not None, 'asked of motions alone'
    return integrated(power[:, None], trajectory, dataset.t)[:, 0]
