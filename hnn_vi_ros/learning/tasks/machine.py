# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train models of machines on measured motions, and judge them on other motions."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import ImplicitMidpoint
from hnn_vi_ros.learning.data.motions import (
    delayed, EvenMotion, MotionData, of_positions, train_and_test)
from hnn_vi_ros.learning.families.choices import (
    AUTO, Forward, RigidBodyChoice, Structure, TrajectoryLoss)
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork, PlainNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.growing import first_noise
from hnn_vi_ros.learning.fit.inertias import identified_text, identify_inertias, with_force_errors
from hnn_vi_ros.learning.fit.loop import TrainingProblem
from hnn_vi_ros.learning.fit.machine import Fading, MachineProblem, scales_of
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body, fit_records, fit_rigid_body
from hnn_vi_ros.learning.fit.rigid_problem import positions_alone, RigidProblem
from hnn_vi_ros.learning.judging.ensemble import (
    bootstrapped_blocks, calibrated, drafted, ensemble_text, kept_and_held, machine_calibration)
from hnn_vi_ros.learning.judging.evaluation import (
    balance, judge, Judging, linear_model, numbers, outside, own_effects, Predict, predicted_by,
    simulated, simulation_of, table, variance_of, verdict)
from hnn_vi_ros.learning.judging.missing import missing_force
from hnn_vi_ros.learning.judging.report import draw_predictions, Judged, shown
from hnn_vi_ros.learning.judging.residuals import (
    errors_text, is_noise, judged_along, judged_model, STEP)
from hnn_vi_ros.learning.tasks import described, OPEN_BY_MAP, TrainingTask
from hnn_vi_ros.learning.tasks.records import Records
from hnn_vi_ros.learning.tasks.selection import MOST_DELAY, selected
from hnn_vi_ros.models import (
    Box, CHAINS, Checkpoint, domain_of, DomainCard, energy_spread, interval_text, load_member,
    ModelCard, PLANAR_CHAIN, PredictionError, RIGID_BODY, SelectionCard)
import numpy as np
from scipy.optimize import minimize_scalar
import torch


class MachineTask(TrainingTask):
    """
    Training of a machine with friction and motors on measured motions; see Task.

    Parameters
    ----------
    source : Path
        Path of the configuration.
    config : MachineConfig
        Configuration of the training.
    given : sequence of str
        Files that override the configured ones.
    ensemble : bool
        True to train ensemble members, each on resampled blocks of the motions.

    """

    picture = 'predictions'

    def __init__(self, source: Path, config: MachineConfig, given: Sequence[str],
                 ensemble: bool):
        self._ensemble = ensemble
        self._train, self._test, description = _read(source, config, given)
        self._delay = estimated_delay(config, self._train) \
            if config.data.delay == 'estimate' else config.data.delay
        measured = self._measured = self._train, self._test
        if self._delay:
            self._train, self._test = ([delayed(motion, self._delay) for motion in part]
                                       for part in (self._train, self._test))
            description += f'; forces delayed by {self._delay:.3g} samples'
        print(f'data: {description}; {_ranges(config, self._train)}', flush=True)
        _check_motors(config, self._train)
        self._config, self._selection = selected(config, self._train, problem_of)
        if isinstance(self._config.data.delay, float):
            self._delay = self._config.data.delay
        self._train, self._test = (as_selected(part, self._config.data, self._delay)
                                   for part in measured)
        self._known, self._held = kept_and_held(self._train, config) if ensemble else (
            self._train, [])
        # Source and licence of the data are stored with the model.
        self._description = f'{config.description} {description}'.lstrip() + _scale(
            self._config, self._train)

    def arrays(self) -> Iterator[np.ndarray]:
        """Yield the arrays of the training motions; see Task."""
        return (part for motion in self._train for part in vars(motion).values()
                if isinstance(part, np.ndarray))

    def problem(self, config: MachineConfig, device: str) -> TrainingProblem:
        """Return a new network with its prior fitted, and the remaining stages; see Task."""
        if self._ensemble:
            return problem_of(self._chosen(config), bootstrapped_blocks(self._known, config.seed))
        problem = problem_of(self._chosen(config), self._known)
        if self._selection is None or config.data.inputs or self._train[0].inputs != 'linear' \
                or not isinstance(problem, RigidProblem) or not problem.is_driven(self._train):
            return problem
        return self._with_smooth_forces(problem, config)

    def _with_smooth_forces(self, problem: RigidProblem, config: MachineConfig) -> RigidProblem:
        """Return the fit with a spline of the forces if long windows show that it is better."""
        data = self._config.data.model_copy(update={'inputs': 'spline'})
        train, test = (as_selected(part, data, self._delay) for part in self._measured)
        if not problem.is_evidence(problem.gain_with(train, config.windows)):
            return problem
        chosen = self._chosen(config).model_copy(update={'data': data})
        try:
            found = problem_of(chosen, train)
        except DataError:
            return problem
        length = problem.no_worse(found)
        if length is None or not isinstance(found, RigidProblem):
            return problem
        text = f'forces between samples as spline, which fits windows of {length:.3g} s better'
        print(text, flush=True)
        self._description += f'; {text}'
        self._config = self._config.model_copy(update={'data': data})
        self._train, self._test, self._known = train, test, train
        return found

    def _chosen(self, config: MachineConfig) -> MachineConfig:
        """Return a configuration of another seed with the selected family and loss."""
        return config.model_copy(update={
            'family': self._config.family, 'loss': self._config.loss, 'data': self._config.data})

    def describe(self, problem: TrainingProblem, config: MachineConfig, name: str, command: str
                 ) -> Checkpoint:
        """Return a trained network with its card; see Task."""
        config = self._chosen(config)
        opens = _opens_scale(config, self._train)
        if opens:
            fix_scale(problem.module, self._train)
        description = self._description
        if isinstance(problem, RigidProblem) and problem.fitted is not None:
            problem.module.prior.estimates = problem.estimates(
                config.coordinates, _joined(self._train) if opens else None)
            if self._selection is None and problem.is_driven(self._train):
                courses = problem.courses(self._train, config.windows,
                                          config.data.inputs is not None)
                if courses.better:
                    text = courses.text('data.inputs:')
                    print(text, flush=True)
                    description += f'. {text}'
        return describe(problem.module, config, self._train, description, problem.losses,
                        name, command, self._selection, self._delay * self._train[0].spacing)

    def judged(self, checkpoint: Checkpoint, problem: TrainingProblem) -> Judged:
        """Return the model with the prediction errors of itself and of the baselines; see Task."""
        if self._ensemble:
            checkpoint = calibrated(checkpoint, lambda: machine_calibration(
                checkpoint, self._held, self._test))
        else:
            checkpoint = with_force_errors(checkpoint, problem.module, self._test)
        config, test, network = self._config, self._test, problem.module
        judging = Judging().paced(test)
        horizons = [horizon for horizon in judging.horizons if any(
            motion.t[-1] - motion.t[0] >= horizon for motion in test)]
        hamiltonian, effects = _parts_of(checkpoint)
        names, step_size, said, known = [one.name for one in config.coordinates], None, '', {}
        if positions_alone(test):
            noise = first_noise(test) if problem.noise is None else problem.noise
            model, step_size = judged_model(hamiltonian, effects, test), STEP
            residuals, test = judged_along(model, test, noise)
            known = {'residuals': residuals, 'noise': noise.tolist()}
            missing = '' if is_noise(residuals) else missing_force(
                network, [*self._train, *self._test], names)
            said = errors_text(residuals, noise, config.coordinates) + (
                f'\nOf all motions, also those of the training: {missing}' if missing else '')
        scores, fans = judge(
            simulation_of(hamiltonian, ImplicitMidpoint(), effects, test, step_size),
            effects, test, horizons, judging.every, judging.longest, self._baselines(network))
        domain = domain_of(hamiltonian)
        checkpoint = with_energy_error(checkpoint, test)
        card = checkpoint.card.model_copy(update={
            'prediction_error': PredictionError.model_validate(numbers(scores['model']) | known)})
        prior = None if card.mechanical is None else card.mechanical.prior
        text = '\n\n'.join(filter(None, (
            table(scores, names), verdict(scores), said.rstrip(),
            '' if domain is None else outside(domain, fans, horizons).text,
            '' if card.selection is None else card.selection.text,
            '' if prior is None else prior.text,
            ensemble_text(card))))
        return Judged(
            replace(checkpoint, card=card), text,
            f'{text}\n\n{_remarks(config, card, judging.every)}\n{identified_text(card)}'.rstrip(),
            lambda path: draw_predictions(path, card.name, hamiltonian.coordinates,
                                          shown(fans, max(horizons))))

    def _baselines(self, network: MechanicalNetwork) -> dict[str, Predict]:
        """Return other models of the training motions, to compare with."""
        config, others = self._config, {'linear model': linear_model(self._train)}
        if config.baseline:
            print('baseline, a plain network of (q, v, tau):', flush=True)
            plain = PlainNetwork(network.structure.kinds, config.hidden, scales_of(
                self._train, config.family.input_map == 'learned'), config.seed)
            MachineProblem(plain, _of_plain_network(config), self._train).fit()
            others['plain network'] = predicted_by(plain)
        if network.structure.residual and 'prismatic' not in network.structure.kinds:
            rigid = best_rigid_body(config.windows, self._train)
            others |= {} if rigid is None else {'rigid body': predicted_by(rigid.module)}
        return others


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
    angles = _rigid(config, structure, motions).module.structure.angles

    def error(delay: float) -> float:
        late = [delayed(motion, delay) for motion in motions]
        return [*_rigid(config, replace(structure, angles=angles), late).losses.values()][-1]
    return float(minimize_scalar(error, bounds=(-MOST_DELAY, MOST_DELAY), method='bounded',
                                 options={'xatol': 0.1}).x)


def _check_motors(config: MachineConfig, motions: Sequence[EvenMotion]) -> None:
    """Raise DataError for forces of motors instead of joints, unless the family maps them."""
    d, motors = motions[0].q.shape[1], motions[0].tau.shape[1]
    if motors == d:
        return
    if isinstance(config.family, RigidBodyChoice):
        raise DataError(f'the data have {motors} columns of forces for {d} joints; a rigid_body '
                        'requires the force of each joint')
    if config.family.input_map != 'learned':
        raise DataError(f'data.tau: {motors} columns of forces, expected {d}, one per coordinate; '
                        'add a column of zeros for a joint without a motor, or set '
                        'family.input_map: learned')


def problem_of(config: MachineConfig, motions: Sequence[EvenMotion],
               rigid: RigidProblem | None = None) -> TrainingProblem:
    """
    Return a network with the stages that follow; fit its prior, unless one is given.

    Raises
    ------
    DataError
        Forces belong to motors instead of joints, or no prior can follow the motions.

    """
    _check_motors(config, motions)
    family, learns_map = config.family, config.family.input_map == 'learned'
    structure, scales = config.structure(), scales_of(motions, learns_map)
    if structure.prior is None:
        return _with_records(MachineProblem(MechanicalNetwork(
            structure, config.hidden, scales, config.seed), config, motions), config, motions)
    if rigid is None:
        rigid = _rigid(config, structure, motions)
    if not structure.residual:
        return rigid
    network = MechanicalNetwork(replace(structure, angles=rigid.module.structure.angles),
                                config.hidden, scales, config.seed)
    network.begin_with(rigid.module)
    fading = Fading(network, motions, family.residual_weight, family.fade_weight)
    problem = _with_records(
        MachineProblem(network, config, motions, fading, rigid.losses), config, motions,
        lambda: fading(torch.Generator().manual_seed(config.seed)))
    problem.noise = rigid.noise
    return problem


def _with_records(problem: MachineProblem, config: MachineConfig, motions: Sequence[EvenMotion],
                  penalty: Callable[[], torch.Tensor] = lambda: torch.zeros(())
                  ) -> TrainingProblem:
    """Append the stages on whole motions if the loss requests them."""
    if config.windows.records:
        problem.stages += Records(problem.module, config.windows, motions, lambda: describe(
            problem.module, config, motions, '', {}, 'draft', ''), penalty).stages()
    return problem


def _rigid(config: MachineConfig, structure: Structure, motions: Sequence[EvenMotion]
           ) -> RigidProblem:
    """Return a fitted prior with friction and without networks, or raise DataError."""
    family = config.family
    if structure.prior == PLANAR_CHAIN:
        found = best_rigid_body(config.windows, motions, structure, family.input_map == 'learned')
        checked = 'angles of its links from the vertical'
    else:
        network = MechanicalNetwork(
            replace(structure, residual=False, friction_features=None), config.hidden,
            scales_of(motions), config.seed)
        if isinstance(family, RigidBodyChoice):
            checked = 'URDF'
            losses = identify_inertias(network, config, motions,
                                       family.rotor_inertia == 'identified', family.offsets)
            found = RigidProblem(network, losses) if np.isfinite(
                [*losses.values()]).all() else None
        else:
            checked = 'coordinates (they must be those of the system)'
            found = fit_rigid_body([network], config.windows, motions)
    if found is None:
        raise DataError(f'prior: no {structure.prior} fits these motions; check the {checked} and '
                        'the data for outliers')
    if config.windows.records and found.fitted is None:
        found.losses['records'] = fit_records(
            found.module, config.windows, motions,
            lambda motion: whole(found.module, config, motion))
    return found


def whole(network: MechanicalNetwork, config: MachineConfig, motion: EvenMotion) -> np.ndarray:
    """Simulate a network from the first state of a motion; return positions, shape (N, d)."""
    hamiltonian, effects = _parts_of(describe(network, config, [motion], '', {}, 'draft', ''))
    simulation = simulation_of(hamiltonian, ImplicitMidpoint(), effects, [motion])
    found: np.ndarray = simulated(simulation, motion.spacing, np.inf, variance_of([motion]))(
        motion, np.zeros(1, dtype=int), len(motion.t) - 1)[0]
    return found


def as_selected(motions: Sequence[EvenMotion], chosen: MotionData, delay: float
                ) -> list[EvenMotion]:
    """Return motions with the selected velocities, and forces of this delay [samples]."""
    if chosen.velocities and not positions_alone(motions):
        motions = of_positions(motions)
    # A delay that is no whole number interpolates forces by their course.
    motions = [replace(motion, inputs=chosen.inputs or motion.inputs) for motion in motions]
    return [delayed(motion, delay) for motion in motions] if delay else motions


def learn(config: MachineConfig, motions: Sequence[EvenMotion]
          ) -> tuple[MechanicalNetwork, dict[str, float]]:
    """Fit a network, after its prior if it has one; return it and its losses."""
    config, _ = selected(config, motions, problem_of)
    delay = config.data.delay
    problem = problem_of(config, as_selected(
        motions, config.data, 0.0 if isinstance(delay, str) else delay))
    return problem.module, problem.fit()


def fix_scale(network: MechanicalNetwork, motions: Sequence[EvenMotion]) -> None:
    """Scale the mean inertia of the first coordinate to 1, for motions without forces."""
    q = torch.tensor(_joined(motions))
    with torch.no_grad():
        network.scale_energy(1.0 / float(network.masses(q)[:, 0, 0].mean()))


def _joined(motions: Sequence[EvenMotion]) -> np.ndarray:
    return np.concatenate([motion.q_smooth for motion in motions])


def describe(network: MechanicalNetwork, config: MachineConfig, motions: Sequence[EvenMotion],
             description: str, losses: dict[str, float], name: str, command: str,
             selection: SelectionCard | None = None, delay: float = 0.0) -> Checkpoint:
    """Return a trained network with its card; `delay` is the delay of the forces [s]."""
    q, v, tau = (np.concatenate([getattr(motion, key) for motion in motions])
                 for key in ('q_smooth', 'v_smooth', 'tau'))
    with torch.no_grad():
        p = (network.masses(torch.tensor(q)) @ torch.tensor(v)[:, :, None])[:, :, 0].numpy()
    return described(
        config, network.networks(), name, command, family='mechanical', box=Box.of(q, p),
        mechanical=network.card([one.p_unit for one in config.coordinates]).model_copy(
            update={'delay': delay, 'inputs': config.data.inputs}), dataset=description,
        losses=losses, domain=DomainCard.of(q, v, tau), selection=selection)


def with_energy_error(checkpoint: Checkpoint, motions: Sequence[EvenMotion]) -> Checkpoint:
    """Add the energy error along motions, relative to the work on them, to a model's card."""
    hamiltonian, effects = _parts_of(checkpoint)
    balances = [balance(hamiltonian, effects, motion) for motion in motions]
    error = energy_spread(
        np.concatenate([found.energy for found in balances]),
        np.repeat(np.arange(len(motions)), [len(found.energy) for found in balances]),
        checkpoint.card.seed, np.concatenate([found.work for found in balances]),
        'work of forces and friction')
    return replace(checkpoint, card=checkpoint.card.model_copy(update={'energy_error': error}))


def _parts_of(checkpoint: Checkpoint) -> tuple[Hamiltonian, list[Effect]]:
    """Return H and the effects of a model; the effects read a draft file of it."""
    hamiltonian = load_member(checkpoint, None)
    with drafted(checkpoint) as draft:
        return hamiltonian, own_effects(draft, hamiltonian)


def _opens_scale(config: MachineConfig, motions: Sequence[EvenMotion]) -> bool:
    """Return True if the motions have no forces that could fix the energy scale."""
    own_scale = config.family.prior not in (None, RIGID_BODY, *CHAINS)
    return not own_scale and not any(motion.tau.any() for motion in motions)


def _ranges(config: MachineConfig, motions: Sequence[EvenMotion]) -> str:
    """Describe the sampling interval and coordinate ranges, which reveal wrong units."""
    q = np.concatenate([motion.q for motion in motions])
    return ', '.join([f'every {motions[0].spacing:.4g} s', *(
        f'{one.name} {low:.3g} to {high:.3g} {one.q_unit}' for one, low, high in zip(
            config.coordinates, q.min(axis=0), q.max(axis=0), strict=True))])


def _scale(config: MachineConfig, motions: Sequence[EvenMotion]) -> str:
    """Return a note on the energy scale for the model card, '' if forces fix the scale."""
    text = ''
    if config.family.prior not in (None, RIGID_BODY, *CHAINS):
        text = f'; the energy scale is that of {config.family.prior}'
    elif _opens_scale(config, motions):
        text = ('; the energy scale is arbitrary, since there are no forces: the mean inertia of '
                f'{config.coordinates[0].name} is 1')
    if config.family.input_map == 'learned':
        text += OPEN_BY_MAP
    return text


def _remarks(config: MachineConfig, card: ModelCard, every: float) -> str:
    """Return the remarks below the table of a report."""
    held, error = ', '.join(config.data.test_runs) or 'the last fifth of each run', \
        card.energy_error
    energy = '' if error is None else (
        f'On held-out data the RMS error of H is {error.rms:.3g} J '
        f'({interval_text(error.rms_interval)}), compared with the {error.compared_with}, with '
        f'which it varies by {error.spread:.3g} J.\n')
    return (f'Held out: {held}. The table contains the RMS error at the end of each horizon, in '
            'simulations of the held-out data with the measured forces, started every '
            f'{every:g} s. The energy mismatch is the change of H over each horizon minus the '
            'work of forces and friction, relative to its range; it is omitted if that is below a '
            'tenth of the kinetic energy. A plain network of (q, v, tau) has the same hidden '
            f'layers; a rigid body is a chain of links fitted by least squares.\n\n{energy}')


def _of_plain_network(config: MachineConfig) -> MachineConfig:
    """Return the configuration of a plain network; losses that need masses are replaced."""
    return config if isinstance(config.loss, Forward | TrajectoryLoss | None) else \
        config.model_copy(update={'loss': TrajectoryLoss()})


def _read(source: Path, config: MachineConfig, given: Sequence[str]
          ) -> tuple[list[EvenMotion], list[EvenMotion], str]:
    """Return training motions, test motions, and their description."""
    motions, description = config.motions(
        source, [coordinate.name for coordinate in config.coordinates], given)
    train, test = train_and_test(motions, config.data.test_runs)
    if not train:
        raise DataError(f'{source}: data.test_runs leave no run for training')
    longest = max(motion.t[-1] - motion.t[0] for motion in test)
    shortest = min(Judging().paced(test).horizons)
    if longest < shortest:
        raise DataError(f'{source}: the held-out data last {longest:.3g} s, expected at least '
                        f'{shortest:g} s for an evaluation; name longer runs in '
                        'data.test_runs')
    return train, test, description
