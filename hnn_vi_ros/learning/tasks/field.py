# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train families that learn a field of (q, p) from states and rates, and judge them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.dataset import Dataset, ExactData, sample_exact
from hnn_vi_ros.learning.data.motions import MotionData
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.export_module import graph_model
from hnn_vi_ros.learning.families.base import EnergyFamily, Scales, ShiftedEnergy, Trainable
from hnn_vi_ros.learning.fit.config import FieldConfig
from hnn_vi_ros.learning.fit.field import fit_field, FittedField, LOSSES
from hnn_vi_ros.learning.fit.loop import Train, trained
from hnn_vi_ros.learning.fit.model_files import described
from hnn_vi_ros.learning.judging.energy import friction_work, integrated
from hnn_vi_ros.learning.judging.ensemble import (
    bootstrapped, calibrated, ensemble_text, field_calibration, held_out)
from hnn_vi_ros.learning.judging.report import Comparison, Judged, plot_field
from hnn_vi_ros.learning.tasks import TrainingTask
from hnn_vi_ros.models import (
    Box, Checkpoint, energy_error, energy_spread, EnergyError, FAMILIES, load_member, Units)
from hnn_vi_ros.scene import Scene
import numpy as np
import torch

# Number of states in the box at which learned and true energy are compared.
_STATES = 2000


class FieldData(NamedTuple):
    """
    Data of a training of H(q, p), a Lagrangian or a two-form.

    Parameters
    ----------
    config : FieldConfig
        Configuration of the training.
    known : Dataset
        Data of the training.
    held : Dataset or None
        Data that no member of an ensemble is trained on.
    ensemble : bool
        True if members are trained, each on resampled data.

    """

    config: FieldConfig
    known: Dataset
    held: Dataset | None
    ensemble: bool

    @classmethod
    def of(cls, config: FieldConfig, dataset: Dataset, ensemble: bool = False) -> 'FieldData':
        """Return data for training; raise DataError if they have forces that H cannot explain."""
        print(f'data: {dataset.description}', flush=True)
        if isinstance(config.data, MotionData) and not config.family.driven and (
                dataset.commands is not None):
            raise DataError(f'{dataset.description}: has forces, which H(q, p) does not contain; '
                            'record free motions, set data.forces: none, or train the family '
                            'mechanical or control_affine')
        return cls(config, *(held_out(config, dataset) if ensemble else (dataset, None)), ensemble)

    @property
    def arrays(self) -> Iterator[np.ndarray]:
        """Return the arrays of the data, which identify an interrupted run."""
        return (part for part in vars(self.known).values() if isinstance(part, np.ndarray))

    @property
    def box(self) -> Box:
        """Return the training domain."""
        return self.known.box


def read(source: Path, config: FieldConfig, given: Sequence[str], ensemble: bool) -> FieldData:
    """Read the data of a configuration, or given files in their place."""
    return FieldData.of(config, make_dataset(
        config.data, config.seed, source, given, [one.q_unit for one in config.coordinates]),
        ensemble)


def fit(data: FieldData, config: FieldConfig, device: str, train: Train = trained) -> FittedField:
    """Fit a model."""
    return fit_field(config, bootstrapped(data.known, config.seed) if data.ensemble else
                     data.known, device, train)


def describe(data: FieldData, fitted: FittedField, config: FieldConfig, name: str, command: str
             ) -> Checkpoint:
    """Return a trained model with its card."""
    family, samples, reference = fitted.module, fitted.samples, config.reference
    dataset, scales = samples.dataset, Scales.of(samples.dataset)
    box = replace(dataset, p=family.momenta(dataset)).box
    centre = np.mean([*box.q, *box.p], axis=1)
    z0 = centre if reference is None else np.array([*reference.q, *reference.p])
    energy0 = 0.0 if reference is None else reference.energy
    networks = family.networks(z0, energy0)
    checkpoint = described(
        config, networks, name, command, family=config.family.kind, scheme=config.loss.scheme,
        box=box, dataset=dataset.description, losses=fitted.losses, confine=config.confine,
        units=Units(centre=scales.centre.tolist(), scale=scales.half.tolist(),
                    target=samples.unit.tolist()), **family.constants())
    if networks:
        return checkpoint
    assert isinstance(family, EnergyFamily), 'others have networks in their files'
    return graph_model(ShiftedEnergy(family, z0, energy0), checkpoint.card, family.name)[0]


def judge(data: FieldData, checkpoint: Checkpoint, fitted: FittedField) -> Judged:
    """Return the model with its energy error, if the energy is known."""
    config, card, family = data.config, checkpoint.card, fitted.module
    error = judge_energy(checkpoint, family, config, data.known)
    where = _where_valid(checkpoint, family, config, data.known)
    checkpoint = replace(checkpoint, card=card.model_copy(update={
        'energy_error': error, 'dataset': '; '.join(filter(None, (card.dataset, where)))}))
    if data.ensemble:
        checkpoint = calibrated(checkpoint, lambda: field_calibration(
            checkpoint, config, data.held))
    card = checkpoint.card
    lines = [', '.join(f'{key} {value:.3g}' for key, value in card.losses.items())]
    if error is not None:
        lines.append(f'energy error: RMS {error.rms:.3g} J, maximum {error.sup:.3g} J, '
                     f'compared with the {error.compared_with}')
        if error.friction_power:
            lines.append(f'these motions lose {error.friction_power:.3g} W on average, but '
                         'H(q, p) conserves energy: for friction use `hnn train --data`, which '
                         'fits a machine, or the family dgnet or dissipative_hnn')
    lines += [where, ensemble_text(card)]
    return Judged(checkpoint, '\n'.join(filter(None, lines)), ensemble_text(card),
                  lambda path: plot_field(compared(fitted), card, path),
                  scene=_scene_of(family, data.known) if FAMILIES[card.family].conservative else
                  None)


def _scene_of(family: Trainable, dataset: Dataset) -> Callable[[str, Path], Scene] | None:
    """Return the scene of a conservative model from the first state, if times are known."""
    if dataset.t is None or not isinstance(family, EnergyFamily):
        return None
    start = {'q': dataset.q[0].tolist(), 'p': family.momenta(dataset)[0].tolist()}
    step = float(f'{np.median(np.diff(dataset.t)):.6g}')
    return lambda model, place: Scene.build(
        description='starts from the first state of the data',
        hamiltonian={'kind': 'learned', 'model': model}, integrator='implicit_midpoint',
        step_size=step, initial_state=start, name=str(place))


def folds(data: FieldData, config: FieldConfig, count: int, device: str) -> dict[str, float]:
    """
    Return the mean loss of a cross-validation, and its standard deviation over `count` models.

    Each is trained without a share of the runs, or of blocks of time if there are fewer runs, and
    judged on that share.

    Raises
    ------
    DataError
        There are fewer blocks than that.

    """
    dataset, found = data.known, list[float]()
    runs = len(np.unique(dataset.motion)) >= count
    group = dataset.motion if runs else dataset.block
    groups = np.random.default_rng(config.seed).permutation(np.unique(group))
    if len(groups) < count:
        raise DataError(f'--folds {count}: the data have {len(groups)} blocks of time; use fewer '
                        'folds, or record more runs')
    for k, left_out in enumerate(np.array_split(groups, count)):
        held = np.isin(group, left_out)
        fitted = fit_field(config, dataset.rows(~held), device, partial(
            trained, name=f'fold {k + 1} of {count}'))
        samples = fitted.samples
        losses = samples.unseen_losses(fitted.module, LOSSES[config.loss.kind].batch(
            config.loss, dataset.rows(held)))
        found.append(losses['loss'])
        print(f'fold {k + 1} of {count}, without {"runs" if runs else "blocks of time"} '
              f'{", ".join(map(str, sorted(left_out.tolist())))}: ' + ', '.join(
                  f'{name} {value:.3g}' for name, value in losses.items()), flush=True)
    return {'folds_loss': float(np.mean(found)), 'folds_deviation': float(np.std(found, ddof=1))}


FIELD = TrainingTask('field', read, lambda data: data, fit, describe, judge, folds)


def compared(fitted: FittedField) -> Comparison:
    """Return a model's predictions together with the held-out data."""
    samples = fitted.samples
    batch, parts = samples.validation, LOSSES[samples.config.loss.kind].parts
    target = batch.target.numpy()
    predicted = target + samples.errors(fitted.module, batch).detach().numpy()
    states = batch.inputs[0].numpy() if parts == ('dq_dt', 'dp_dt') else None
    data = samples.config.data
    return Comparison(states, target, predicted, samples.unit.numpy(), parts,
                      isinstance(data, ExactData) and data.noise == 0.0)


def _where_valid(checkpoint: Checkpoint, family: Trainable, config: FieldConfig, dataset: Dataset
                 ) -> str:
    """Return a note on the part of its training domain that a model has seen; '' for all."""
    if isinstance(config.data, ExactData):
        return ''
    energies = load_member(checkpoint, None).energy(dataset.q, family.momenta(dataset))
    return (f'H is known near the states of the data, from {energies.min():.4g} to '
            f'{energies.max():.4g} J; elsewhere in the training domain it is extrapolated without '
            'an alarm')


def judge_energy(checkpoint: Checkpoint, family: Trainable, config: FieldConfig,
                 dataset: Dataset) -> EnergyError | None:
    """
    Return the error of the learned energy, or None if no reference is known.

    For exact data, the reference is the true energy at new states of the box. For other data it
    is the energy along each motion, which changes by the work of the family's forces; for families
    without forces, by the work of fitted friction.

    Parameters
    ----------
    checkpoint : Checkpoint
        Trained model.
    family : Trainable
        The same model as a trainable family, which supplies momenta of the states.
    config : FieldConfig
        Configuration of the training.
    dataset : Dataset
        Training data.

    """
    row = FAMILIES[checkpoint.card.family]
    hamiltonian = load_member(checkpoint, None)  # raises for a singular Lagrangian
    if isinstance(config.data, ExactData):
        data = config.data.model_copy(update={
            'samples': _STATES, 'edge_share': 0.0, 'trajectory': None, 'noise': 0.0})
        dataset = sample_exact(data, config.seed + 1)
        assert dataset.energies is not None, 'exact data have them'
        return energy_error(hamiltonian.energy(dataset.q, family.momenta(dataset)),
                            dataset.energies, config.seed)
    if dataset.t is None:
        return None  # without times no motion, and so no energy reference, is known
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
    Return the work of a model's learned forces along measured motions.

    The power is H_q . q' + H_p . p' with the model's rates (q', p'); without forces it is 0.

    Parameters
    ----------
    family : EnergyFamily
        The trained model.
    dataset : Dataset
        States and commands with times.
    trajectory : np.ndarray of int, shape (N,)
        Trajectory number of each state.

    Returns
    -------
    np.ndarray, shape (N,)
        Work W [J] by the trapezoidal rule, zero at the start of each trajectory.

    """
    z = torch.tensor(np.hstack([dataset.q, dataset.p]))
    commands = None if dataset.commands is None else torch.tensor(dataset.commands)
    rates = family.vector_field(z, commands)
    power = (family.gradient(z) * rates).sum(dim=1).detach().numpy()
    assert dataset.t is not None, 'asked of motions alone'
    return integrated(power[:, None], trajectory, dataset.t)[:, 0]
