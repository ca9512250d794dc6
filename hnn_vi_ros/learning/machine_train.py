# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train a model of a machine, and judge it by motions that it has not seen."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import NamedTuple

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.files.limits import read_limited
from hnn_vi_ros.files.yaml_text import MAX_BYTES, parse_mapping
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.learning.energy_account import balance
from hnn_vi_ros.learning.evaluate import judge, numbers, own_effects, simulation_of, verdict
from hnn_vi_ros.learning.evaluation import linear_model, score, table
from hnn_vi_ros.learning.excitation import excited_motions
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.identification import identify
from hnn_vi_ros.learning.identification_report import identified_text, with_force_errors
from hnn_vi_ros.learning.keeping import kept, members_kept
from hnn_vi_ros.learning.machine_config import (
    Forward, load_machine, MachineConfig, MachineExcitation, RigidBodyChoice, Trajectory)
from hnn_vi_ros.learning.machine_ensemble import (
    calibrated_machine, check_machines, combined_machines, ensemble_text, kept_and_held,
    resampled_blocks)
from hnn_vi_ros.learning.machine_training import fit, scales_of, split_motions
from hnn_vi_ros.learning.motion_sources import read_motions
from hnn_vi_ros.learning.motions import Motion, run_of
from hnn_vi_ros.learning.plain_network import PlainNetwork, predicted_by
from hnn_vi_ros.learning.prediction_report import draw_predictions, shown
from hnn_vi_ros.learning.rigid_body import best_rigid_body, fit_rigid_body
from hnn_vi_ros.models.checkpoint import Checkpoint, complete_checkpoint, save_checkpoint
from hnn_vi_ros.models.energy_error import energy_spread, interval_text
from hnn_vi_ros.models.ensemble import load_member
from hnn_vi_ros.models.model_card import Box, CoordinateCard, ModelCard, PredictionError
from hnn_vi_ros.models.planar_chain import CHAINS
from hnn_vi_ros.models.rigid_body_card import RIGID_BODY
from hnn_vi_ros.version import __version__
import numpy as np
import torch

# What a model is judged by: errors after these times, from states so far apart [s].
_HORIZONS, _EVERY, _LONGEST = (0.1, 0.5), 0.05, 2.0


def own_family(source: Path) -> str:
    """Return the family of a configuration whose schema is its own, such as mechanical; or ''."""
    try:
        text = read_limited(source, MAX_BYTES)
    except OSError:
        return ''  # the other schema's reader tells what is wrong
    data, _ = parse_mapping(text, source, DataError)
    family = data.get('family')
    kind = family.get('kind') if isinstance(family, dict) else ''
    return kind if kind in ('mechanical', RIGID_BODY, 'lie_group') else ''


class Outputs(NamedTuple):
    """The files of a run, all beside the model."""

    model: Path
    picture: Path
    report: Path

    @classmethod
    def beside(cls, model: Path) -> 'Outputs':
        """Return the files of a model."""
        return cls(model, model.with_suffix('.predictions.png'), model.with_suffix('.report.md'))


def run(source: Path, arguments: Namespace, outputs: Outputs, command: str) -> None:
    """Train as a configuration and the command line say, and print what came of it."""
    out = outputs.model
    config = load_machine(source)
    if arguments.seed is not None:
        config = config.model_copy(update={'seed': arguments.seed})
    if arguments.ensemble is not None:
        check_machines(config, arguments.ensemble)
    train, test, description = _read(source, config, arguments.data)
    known, held = (train, []) if arguments.ensemble is None else kept_and_held(train, config)
    print(f'data: {description}', flush=True)
    # Where data come from, and by which licence, goes with the model.
    description = f'{config.description} {description}'.lstrip() + _scale(config, train)
    begun = time.perf_counter()
    members: list[Checkpoint] = []
    with members_kept(out, members):
        for k in range(arguments.ensemble or 1):
            own = config.model_copy(update={'seed': config.seed + k})
            drawn = known if arguments.ensemble is None else resampled_blocks(known, own.seed)
            network, losses = learn(own, drawn)
            if _opens_scale(config, train):
                fix_scale(network, train)
            name = out.stem if arguments.ensemble is None else f'{out.stem}, member {k + 1}'
            members.append(describe(network, own, train, description, losses, name, command))
    checkpoint = members[0] if arguments.ensemble is None else \
        combined_machines(members, out.stem)
    seconds = time.perf_counter() - begun
    with kept(out, checkpoint):
        checkpoint = with_energy_error(checkpoint, test)
        if arguments.ensemble is None:
            checkpoint = with_force_errors(checkpoint, network, test)
        else:
            checkpoint = calibrated_machine(checkpoint, held, test)
        found = _judge(config, checkpoint, network, train, test, outputs, seconds)
    print(f'model: {out}\nreport: {outputs.report}\n\n{found}\ntrained in {seconds:.1f} s')


def _judge(config: MachineConfig, checkpoint: Checkpoint, network: MechanicalNetwork,
           train: list[Motion], test: list[Motion], outputs: Outputs, seconds: float) -> str:
    """Judge a model that was trained, complete its card, write its report, and return a table."""
    names = [coordinate.name for coordinate in config.coordinates]
    horizons = [horizon for horizon in _HORIZONS if any(
        motion.t[-1] - motion.t[0] >= horizon for motion in test)]
    hamiltonian = load_member(checkpoint, None)
    effects = _effects_of(checkpoint)
    simulation = simulation_of(hamiltonian, ImplicitMidpoint(), effects, test)
    asked = test, horizons, _EVERY, _LONGEST
    scores, fans = judge(simulation, effects, *asked)
    prediction = PredictionError.model_validate(numbers(scores['model']))
    complete_checkpoint(outputs.model, replace(checkpoint, card=checkpoint.card.model_copy(
        update={'prediction_error': prediction})))
    print('for comparison, a plain network of (q, v, tau):', flush=True)
    plain = PlainNetwork(network.structure.kinds, config.hidden, network.scales, config.seed)
    fit(plain, _of_plain_network(config), train)
    others = {'linear model': linear_model(train), 'plain network': predicted_by(plain)}
    if 'prismatic' not in network.structure.kinds:
        rigid = best_rigid_body(config.windows, train)
        others |= {} if rigid is None else {'rigid body': predicted_by(rigid)}
    scores |= {name: score(other, *asked) for name, other in others.items()}
    draw_predictions(outputs.picture, outputs.model.stem, hamiltonian.coordinates,
                     shown(fans, max(horizons)))
    found = '\n\n'.join(filter(None, (
        table(scores, names), verdict(scores), ensemble_text(checkpoint.card))))
    page = _page(outputs, config, checkpoint.card, found, seconds)
    outputs.report.write_text(page + identified_text(checkpoint.card), encoding='utf-8')
    return found


def _opens_scale(config: MachineConfig, motions: list[Motion]) -> bool:
    """Return whether motions without forces leave the scale of energy open."""
    own_scale = config.family.prior not in (None, RIGID_BODY, *CHAINS)
    return not own_scale and not any(motion.tau.any() for motion in motions)


def _scale(config: MachineConfig, motions: list[Motion]) -> str:
    """Return what fixes the scale of energy where forces do not, for the model card."""
    text = ''
    if config.family.prior not in (None, RIGID_BODY, *CHAINS):
        text = f'; the scale of energy is that of {config.family.prior}'
    elif _opens_scale(config, motions):
        text = ('; no forces, which leaves the scale of energy open: the mean inertia of '
                f'{config.coordinates[0].name} is 1')
    if config.family.input_map == 'learned':
        text += ('; an input map was learned, which leaves the scale of energy open: the mean '
                 'square of its columns is 1')
    return text


def _page(outputs: Outputs, config: MachineConfig, card: ModelCard, found: str, seconds: float
          ) -> str:
    """Return the report: what was trained on what, and what came of it."""
    same = _of_plain_network(config) is config
    way = 'in the same way' if same else 'by windows'
    held = ', '.join(config.data.test_runs) or 'the last fifth of each run'
    error = card.energy_error
    energy = '' if error is None else (
        f'On what was held out H is off by {error.rms:.3g} J RMS '
        f'({interval_text(error.rms_interval)}) against the '
        f'{error.compared_with}, which makes it vary by {error.spread:.3g} J.\n\n')
    return (f'# {card.name}\n\nData: {card.dataset}. Held out: {held}. '
            f'Trained on the others by {", ".join(card.losses)} in {seconds:.0f} s, seed '
            f'{card.seed}: `{card.training_command}`\n\nFree simulation of what was held out, '
            f'from a state every {_EVERY:g} s, with the measured forces; root mean square of the '
            'error at the end of each horizon. The energy mismatch is what H changes by over each '
            'horizon beside the work of forces and friction, as a share of its range. The plain '
            f'network of (q, v, tau) has the same hidden layers and was trained {way}; a '
            'rigid body is a chain of links fitted by least squares.\n\n'
            f'{found}\n\n{energy}'
            f'![Predictions of what was held out]({outputs.picture.name})\n')


def with_energy_error(checkpoint: Checkpoint, motions: list[Motion]) -> Checkpoint:
    """Return a model whose card tells its energy along motions, against the work on them."""
    hamiltonian, card = load_member(checkpoint, None), checkpoint.card
    effects = _effects_of(checkpoint)
    balances = [balance(hamiltonian, effects, motion) for motion in motions]
    error = energy_spread(
        np.concatenate([found.energy for found in balances]),
        np.repeat(np.arange(len(motions)), [len(found.energy) for found in balances]), card.seed,
        np.concatenate([found.work for found in balances]), 'work of forces and friction')
    return replace(checkpoint, card=card.model_copy(update={'energy_error': error}))


def _effects_of(checkpoint: Checkpoint) -> list[Effect]:
    """Return what a model has learned beside H: effects read it from a file, so from a draft."""
    with TemporaryDirectory() as folder:
        draft = Path(folder) / 'draft.safetensors'
        save_checkpoint(draft, checkpoint)
        return own_effects(str(draft), load_member(checkpoint, None))


def _of_plain_network(config: MachineConfig) -> MachineConfig:
    """Return how a plain network is trained: it has no masses, which some losses need."""
    return config if isinstance(config.loss, Forward | Trajectory | None) else \
        config.model_copy(update={'loss': Trajectory(kind='trajectory')})


def learn(config: MachineConfig, motions: list[Motion]
          ) -> tuple[MechanicalNetwork, dict[str, float]]:
    """Return a network that was fitted, and its losses: after its prior, if it has one."""
    d, motors = motions[0].q.shape[1], motions[0].tau.shape[1]
    learns_map = config.family.input_map == 'learned'
    rigid_body = config.family if isinstance(config.family, RigidBodyChoice) else None
    if motors != d and rigid_body is not None:
        raise DataError(f'the data have {motors} columns of forces for {d} joints; a rigid_body '
                        'needs the force of each joint')
    if motors != d and not learns_map:
        raise DataError(f'the data have {motors} forces for {d} coordinates: of motors, not of '
                        'joints; take input_map: learned')
    structure, scales = config.structure(), scales_of(motions, learns_map)
    network = MechanicalNetwork(structure, config.hidden, scales, config.seed)
    if structure.prior is None:
        return network, fit(network, config, motions)
    rigid = MechanicalNetwork(replace(structure, residual=False, friction_features=None),
                              config.hidden, scales, config.seed)
    losses = fit_rigid_body(rigid, config.windows, motions) if rigid_body is None else identify(
        rigid, config, motions, rigid_body.rotor_inertia == 'identified', rigid_body.offsets)
    if not np.isfinite([*losses.values()]).all():
        looked = 'features, which must be the angles of its links from the vertical,' \
            if structure.prior in CHAINS else 'coordinates, which must be those of the system,'
        looked = looked if rigid_body is None else 'URDF'
        raise DataError(f'prior: no {structure.prior} follows these motions; look at the {looked} '
                        'and for outliers in the data')
    if not structure.residual:
        return rigid, losses
    network.begin_with(rigid)

    def penalty(generator: torch.Generator) -> torch.Tensor:
        return config.family.residual_weight * network.residual_size(
            network.random_states(config.windows.batch, generator))
    return network, losses | fit(network, config, motions, penalty)


def fix_scale(network: MechanicalNetwork, motions: list[Motion]) -> None:
    """Give the first coordinate a mean inertia of 1: motions without forces leave it open."""
    q = torch.tensor(np.concatenate([motion.q_smooth for motion in motions]))
    with torch.no_grad():
        network.scale_energy(1.0 / float(network.masses(q)[:, 0, 0].mean()))


def describe(network: MechanicalNetwork, config: MachineConfig, motions: list[Motion],
             description: str, losses: dict[str, float], name: str, command: str) -> Checkpoint:
    """Return a trained network with its card."""
    q, v = (np.concatenate([getattr(motion, key) for motion in motions])
            for key in ('q_smooth', 'v_smooth'))
    networks = network.networks()
    mechanical = network.card(config.coordinates[0].p_unit)
    with torch.no_grad():
        p = (network.masses(torch.tensor(q)) @ torch.tensor(v)[:, :, None])[:, :, 0].numpy()
    card = ModelCard(
        name=name, family='mechanical', mechanical=mechanical,
        networks={key: [layers.weights[0].shape[1], *(len(bias) for bias in layers.biases)]
                  for key, layers in networks.items()},
        coordinates=[CoordinateCard(name=c.name, q_unit=c.q_unit, p_unit=c.p_unit)
                     for c in config.coordinates],
        box=Box(q=_bounds(q), p=_bounds(p)), dataset=description, seed=config.seed,
        losses=losses, training_command=command, package_version=__version__)
    return Checkpoint(card, networks)


def _bounds(values: np.ndarray) -> list[list[float]]:
    return np.stack([values.min(axis=0), values.max(axis=0)], axis=-1).tolist()


def _read(source: Path, config: MachineConfig, given: list[str]
          ) -> tuple[list[Motion], list[Motion], str]:
    """Return motions to learn from, motions to judge by, and what they are."""
    data, joints = config.data, [coordinate.name for coordinate in config.coordinates]
    if isinstance(data, MachineExcitation):
        if given:
            raise DataError(f'{source}: its data are computed, so --data {given[0]} has no use; '
                            'leave it')
        assert isinstance(config.family, RigidBodyChoice), 'checked with the configuration'
        motions, description = excited_motions(data, config.family.robot(joints), config.seed)
    else:
        motions, description = read_motions(source, data, joints, given)
    names = list(dict.fromkeys(run_of(motion) for motion in motions))
    for run in data.test_runs:
        if run not in names:
            raise DataError(f'{source}: data.test_runs: no run {run!r} among {listed(names)}')
    train, test = split_motions(motions, data.test_runs)
    if not train:
        raise DataError(f'{source}: data.test_runs leave nothing to learn from')
    longest = max(motion.t[-1] - motion.t[0] for motion in test)
    if longest < _HORIZONS[0]:
        raise DataError(f'{source}: what is held out lasts {longest:.3g} s, expected at least '
                        f'{_HORIZONS[0]:g} s to judge by; name longer runs in data.test_runs')
    return train, test, description
