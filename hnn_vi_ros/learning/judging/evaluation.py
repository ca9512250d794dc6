# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a model: free simulations from measured states, compared with measurements."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.effects import (
    Commanded, Damping, Effect, EffectState, ExternalForce, Force, has_map, LearnedDissipation,
    LearnedFriction)
from hnn_vi_ros.errors import DataError, StepFailure
from hnn_vi_ros.files import is_path
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum
from hnn_vi_ros.integrators import ImplicitMidpoint, Integrator, VariationalMidpoint
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.data.sampling import steps_between
from hnn_vi_ros.learning.fit.machine import Network, runge_kutta
from hnn_vi_ros.models import Domain, load_checkpoint, load_learned, rows_of_each
from hnn_vi_ros.run import VALID
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, resolve, Simulation
import numpy as np
from scipy.optimize import nnls
import torch


class EnergyBalance(NamedTuple):
    """
    Energy and work along one motion, shape (N,) each.

    Parameters
    ----------
    energy : np.ndarray
        H(q, p(v)) [J].
    work : np.ndarray
        Work of all forces, including friction, since the first sample [J].
    kinetic : np.ndarray
        v . p(v) / 2 [J].

    """

    energy: np.ndarray
    work: np.ndarray
    kinetic: np.ndarray


def unaccounted(effects: Sequence[Effect]) -> list[str]:
    """Return the classes of effects without work defined by measured states, such as noise."""
    return [type(effect).__name__ for effect in effects
            if not (effect.conservative or isinstance(effect, Force)) or effect.internal]


def balance(hamiltonian: Hamiltonian, effects: Sequence[Effect], motion: EvenMotion
            ) -> EnergyBalance:
    """
    Return energy and work along a motion.

        W(t) = integral of (H_q . f_q + H_p . f_p) dt,  f from friction and motors

    The integral uses the second-order trapezoidal rule, smoothed states, and p with H_p(q, p) = v.
    The measured forces act as in simulations, as means over each interval.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H including the potentials of the effects.
    effects : sequence of Effect
        Effects, each conservative or a Force.
    motion : EvenMotion
        The measured motion.

    Raises
    ------
    ModelError
        No momentum corresponds to some velocity.

    """
    q = motion.q_smooth
    p = momentum(hamiltonian, q, motion.v_smooth, np.zeros_like(q))
    # A command is constant over an interval; friction may depend on it.
    ends = [_power(hamiltonian, effects, motion.t[rows], q[rows], p[rows], motion.forces)
            for rows in (slice(None, -1), slice(1, None))]
    steps = 0.5 * motion.spacing * (ends[0] + ends[1])
    return EnergyBalance(hamiltonian.energy(q, p), np.concatenate([[0.0], np.cumsum(steps)]),
                         0.5 * (motion.v_smooth * p).sum(axis=1))


def _power(hamiltonian: Hamiltonian, effects: Sequence[Effect], t: np.ndarray, q: np.ndarray,
           p: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return the power of forces at states under these commands, shape (N,) [W]."""
    state = EffectState.empty(len(effects), hamiltonian.dimension)
    # Resolve all effects: some use the gauge of a magnetic field.
    resolved = [(effect, effect.resolve(hamiltonian.coordinates, state)) for effect in effects]
    forces: list[tuple[Any, Any]] = [
        (effect, own) for effect, own in resolved if isinstance(effect, Force)]
    power = np.zeros(len(q))
    if not forces:
        return power
    H_q, H_p = hamiltonian.gradient(q, p)
    f_q, f_p = np.zeros((2, q.shape[1]))
    for k in range(len(q)):
        f_q[:], f_p[:] = 0.0, 0.0
        for effect, own in forces:
            if isinstance(effect, Commanded):
                effect.prepare(commands[k], own, q[k])()
        for effect, own in forces:
            effect.add_force(own, t[k], q[k], p[k], H_p[k], f_q, f_p)
        power[k] = H_q[k] @ f_q + H_p[k] @ f_p
    return power


def energy_mismatch(balances: Sequence[EnergyBalance], spacing: float, horizons: Sequence[float]
                    ) -> dict[float, float] | None:
    """
    Return the energy change without matching work, relative to the range of H.

    Parameters
    ----------
    balances : sequence of Balance
        Energy and work of motions sampled at even times.
    spacing : float
        Sampling interval [s].
    horizons : sequence of float
        Times over which energies are compared, at most the longest motion [s].

    Returns
    -------
    dict of float to float, or None
        For each horizon, the RMS over all samples of the change of (H - work) in that time,
        divided by max H - min H over all motions; None if that is less than a tenth of the
        largest kinetic energy, which noise could explain.

    """
    energies, kinetic = (np.concatenate(parts) for parts in zip(*(
        (found.energy, found.kinetic) for found in balances), strict=True))
    size = float(np.ptp(energies))
    if size <= _LEAST_RANGE * kinetic.max():
        return None
    shares = {}
    for horizon in horizons:
        k = round(horizon / spacing)
        # For a true model, H minus the work is constant.
        changes = np.concatenate([
            rest[k:] - rest[:max(0, len(rest) - k)]
            for rest in (found.energy - found.work for found in balances)])
        shares[horizon] = float(np.sqrt(np.mean(changes**2))) / size
    return shares


def friction_work(learned: np.ndarray, trajectory: np.ndarray, t: np.ndarray, v: np.ndarray
                  ) -> tuple[np.ndarray, float]:
    """
    Fit the work of friction to energies along motions by least squares.

        W(t) = -sum_i integral of (b_i v_i^2 + c_i abs(v_i)) dt,  b_i, c_i >= 0

    Parameters
    ----------
    learned : np.ndarray, shape (n,)
        Energies [J], ordered by time within each trajectory.
    trajectory : np.ndarray of int, shape (n,)
        Trajectory number of each state.
    t : np.ndarray, shape (n,)
        Times [s].
    v : np.ndarray, shape (n, d)
        Velocities.

    Returns
    -------
    np.ndarray of shape (n,), and float
        Work W [J], zero at the start of each trajectory, and mean power of friction loss [W].

    """
    columns = integrated(np.hstack([v**2, np.abs(v)]), trajectory, t)
    centred, energies, duration = columns.copy(), learned.copy(), 0.0
    for rows in rows_of_each(trajectory):
        centred[rows] -= columns[rows].mean(axis=0)
        energies[rows] -= energies[rows].mean()
        duration += t[rows[-1]] - t[rows[0]]
    # Normalise the columns, because nnls uses absolute tolerances.
    units = np.sqrt(np.mean(centred**2, axis=0))
    units[units == 0.0] = 1.0
    coefficients = nnls(centred / units, -energies)[0] / units
    work = -columns @ coefficients
    lost = sum(work[rows[0]] - work[rows[-1]] for rows in rows_of_each(trajectory))
    return work, float(lost / duration) if duration > 0.0 else 0.0


def integrated(rates: np.ndarray, trajectory: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Integrate (trapezoidal rule) over time, from zero in each trajectory, shape (n, k)."""
    integral = np.zeros_like(rates)
    for rows in rows_of_each(trajectory):
        steps = 0.5 * np.diff(t[rows])[:, None] * (rates[rows[1:]] + rates[rows[:-1]])
        integral[rows[1:]] = np.cumsum(steps, axis=0)
    return integral


# Least range of H, as a share of the kinetic energy, that energy mismatches can be relative to.
_LEAST_RANGE = 0.1
# Timeout of external_force; commands hold to the end of the simulation [s].
_FOREVER = 1e9

# ``predict(motion, starts, count)`` returns q, shape (starts, count + 1, d), at the samples from
# each start on; NaN after a failure of the simulation, inf after an early stop.
Predict = Callable[[EvenMotion, np.ndarray, int], np.ndarray]


class TrajectoryBundle(NamedTuple):
    """
    Predictions of one motion from many of its states.

    Parameters
    ----------
    motion : EvenMotion
        The measured motion.
    starts : np.ndarray of int, shape (n,)
        Indices of the initial samples.
    q : np.ndarray, shape (n, count + 1, d)
        Predicted coordinates at the samples from there on; see Predict.

    """

    motion: EvenMotion
    starts: np.ndarray
    q: np.ndarray


@dataclass(frozen=True)
class Scores:
    """
    Scores of a prediction against measured motions.

    Parameters
    ----------
    horizons : dict of float to np.ndarray, shape (d,)
        RMS error of each coordinate at the end of each horizon [s].
    starts : dict of float to int
        Number of simulations per horizon.
    valid_prediction_time : float
        Median over all starts [s].
    censored : float
        Share of predictions that were still valid at their end or the end of their run.
    failed : int
        Number of failed simulations; their errors are infinite.
    energy_mismatch : dict of float to float, optional
        Energy mismatch of a model over each horizon; see energy_mismatch.

    """

    horizons: dict[float, np.ndarray]
    starts: dict[float, int]
    valid_prediction_time: float
    censored: float
    failed: int
    energy_mismatch: dict[float, float] | None = None


def simulated(simulation: Simulation, spacing: float, least: float, variance: np.ndarray
              ) -> Predict:
    """
    Return a predictor that simulates with the measured forces as commands.

    Parameters
    ----------
    simulation : Simulation
        Simulation whose step size divides the sampling interval. It accepts one command per
        coordinate if the motions have forces.
    spacing : float
        Sampling interval [s].
    least : float
        Minimum duration of each prediction, the longest horizon [s]; afterwards it stops when
        the prediction is no longer valid.
    variance : np.ndarray, shape (d,)
        Variance of the coordinates, the unit of the validity check.

    """
    steps = round(spacing / simulation.step_size)

    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        needed = samples_in(least, motion)
        q = np.full((len(starts), count + 1, motion.q.shape[1]), np.nan)
        p = np.zeros(motion.q.shape[1])
        tau = motion.forces
        for row, start in zip(q, starts, strict=True):
            row[0] = motion.q_smooth[start]
            p = momentum(simulation.hamiltonian, motion.q_smooth[start], motion.v_smooth[start],
                         p)
            valid = True
            try:
                simulation.restart(motion.q_smooth[start], p)
                for k in range(min(count, len(tau) - start)):
                    if k >= needed and not valid:
                        row[k + 1:] = np.inf
                        break
                    if simulation.takes_commands:
                        simulation.set_command(tau[start + k])
                    simulation.advance(steps)
                    row[k + 1] = simulation.q
                    error = row[k + 1] - motion.q[start + k + 1]
                    valid = valid and bool((error**2 / variance).sum() < VALID)
            except StepFailure:
                continue  # the row stays NaN from here on and counts as a failure
            except ValueError as problem:
                raise DataError(f'{motion.name}: the state at {motion.t[start]:.6g} s cannot be '
                                f'simulated: {problem}') from problem
        return q
    return predict


def constant_velocity(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
    """Predict motions with constant velocity, without any force."""
    t = motion.spacing * np.arange(count + 1)
    return motion.q_smooth[starts][:, None] + t[:, None] * motion.v_smooth[starts][:, None]


def linear_model(motions: Sequence[EvenMotion]) -> Predict:
    """Return a predictor x_(k+1) = A x_k + B tau_k + c, x = (q, v), fitted by least squares."""
    inputs, targets = [], []
    for motion in motions:
        x = np.hstack([motion.q_smooth, motion.v_smooth])
        tau = motion.forces
        inputs.append(np.hstack([x[:-1], tau, np.ones((len(tau), 1))]))
        targets.append(x[1:] - x[:-1])
    matrix = np.linalg.lstsq(np.concatenate(inputs), np.concatenate(targets), rcond=None)[0]
    spacing = motions[0].spacing

    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        share = motion.spacing / spacing
        d = motion.q.shape[1]
        x = np.hstack([motion.q_smooth, motion.v_smooth])[starts]
        tau = motion.forces
        q = [x[:, :d]]
        # A may be unstable; overflow is scored as a failure.
        with np.errstate(over='ignore', invalid='ignore'):
            for k in range(count):
                row = np.minimum(starts + k, len(tau) - 1)
                x = x + share * np.hstack([x, tau[row], np.ones((len(x), 1))]) @ matrix
                q.append(x[:, :d])
        return np.stack(q, axis=1)
    return predict


def predicted_by(network: Network) -> Predict:
    """Return a predictor that integrates a network with the classical RK4 method."""
    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        tau = torch.tensor(motion.forces)
        q, v = (torch.tensor(values[starts]) for values in (motion.q_smooth, motion.v_smooth))
        rows, found = torch.tensor(starts), [q]
        with torch.no_grad():
            for k in range(count):
                # Predictions beyond the end of the motion are not judged.
                held = tau[torch.clamp(rows + k, max=len(tau) - 1)]
                q, v = runge_kutta(network.accelerations, q, v, held, motion.spacing)
                found.append(q)
        return torch.stack(found, dim=1).numpy()
    return predict


def variance_of(motions: Sequence[EvenMotion]) -> np.ndarray:
    """
    Return the variance of each coordinate over motions, shape (d,).

    For a constant coordinate it is inf, so that its errors do not count.

    Raises
    ------
    DataError
        All coordinates are constant.

    """
    q = np.concatenate([motion.q for motion in motions])
    moves = np.ptp(q, axis=0) > 0.0
    if not moves.any():
        raise DataError(f'{motions[0].name}: no coordinate moves, so no error can be computed; '
                        'use other motions')
    return np.where(moves, q.var(axis=0), np.inf)


class Judging(NamedTuple):
    """
    Times at which predictions are judged, each in s.

    Parameters
    ----------
    horizons : tuple of float
        Horizons of errors.
    every : float
        Time between starts.
    longest : float
        Limit of valid prediction times.

    """

    horizons: tuple[float, ...] = (0.1, 0.5)
    every: float = 0.05
    longest: float = 2.0

    def paced(self, motions: Sequence[EvenMotion]) -> 'Judging':
        """Return longer times if samples are further apart than the shortest horizon."""
        slow = max(1.0, motions[0].spacing / min(self.horizons))
        return Judging(tuple(round(slow * horizon, 9) for horizon in self.horizons),
                       max(slow * self.every, motions[0].spacing), slow * self.longest)


def samples_in(time: float, motion: EvenMotion) -> int:
    """Return the number of samples in a time [s], at most all samples of the motion."""
    return round(min(time / motion.spacing, len(motion.t)))


def fans_of(predict: Predict, motions: Sequence[EvenMotion], horizons: Sequence[float],
            every: float, longest: float) -> list[TrajectoryBundle]:
    """Predict from many measured states, for the durations that ``score`` needs."""
    for horizon in horizons:
        if all(samples_in(horizon, motion) >= len(motion.t) for motion in motions):
            raise DataError(f'no motion is as long as the horizon {horizon:g} s; use shorter '
                            '--horizons')
        if any(samples_in(horizon, motion) < 1 for motion in motions):
            raise DataError(f'the horizon {horizon:g} s is shorter than the sampling interval '
                            f'{motions[0].spacing:.4g} s; use longer --horizons')
    fans = []
    for motion in motions:
        n = len(motion.t)
        starts = np.arange(0, n - samples_in(min(horizons), motion),
                           max(1, samples_in(every, motion)))
        if len(starts):
            count = min(samples_in(max(longest, *horizons), motion), n - 1)
            fans.append(TrajectoryBundle(motion, starts, predict(motion, starts, count)))
    return fans


def score(predict: Predict, motions: Sequence[EvenMotion], horizons: Sequence[float], every: float,
          longest: float) -> Scores:
    """
    Predict from many measured states, and compare with the measurements.

    Parameters
    ----------
    predict : callable
        Predictor to judge.
    motions : sequence of EvenMotion
        The measured motions.
    horizons : sequence of float
        Times at which errors are evaluated [s].
    every : float
        Time between starts [s].
    longest : float
        Prediction time limit for the valid prediction time, at least the longest horizon [s].

    Raises
    ------
    DataError
        No motion is as long as a horizon, or samples are further apart than a horizon.

    """
    fans = fans_of(predict, motions, horizons, every, longest)
    return score_fans(fans, horizons, variance_of(motions))


def score_fans(fans: Sequence[TrajectoryBundle], horizons: Sequence[float], variance: np.ndarray
               ) -> Scores:
    """Score predictions against measured motions of this variance, shape (d,); see score."""
    errors: dict[float, list[np.ndarray]] = {horizon: [] for horizon in horizons}
    times, ended, failed = [], [], 0
    for motion, starts, q in fans:
        n, spacing, count = len(motion.t), motion.spacing, q.shape[1] - 1
        room = n - 1 - starts
        within = np.arange(count + 1) <= room[:, None]
        at = np.minimum(starts[:, None] + np.arange(count + 1), n - 1)
        error = q - motion.q[at]
        failed += int((np.isnan(error).any(axis=2) & within).any(axis=1).sum())
        error = np.where(np.isfinite(error), error, np.inf)
        for horizon in horizons:
            k = samples_in(horizon, motion)
            if k <= count:
                errors[horizon].append(error[room >= k, k])
        with np.errstate(over='ignore', invalid='ignore'):
            # The quotient is NaN for an infinite error of a coordinate with infinite variance.
            beyond = within & ~((error**2 / variance).sum(axis=2) < VALID)
        found = beyond.any(axis=1)
        times.append(np.where(found, beyond.argmax(axis=1), np.minimum(count, room)) * spacing)
        ended.append(~found)
    with np.errstate(over='ignore'):
        rms = {horizon: np.sqrt(np.mean(np.concatenate(parts)**2, axis=0))
               for horizon, parts in errors.items()}
    return Scores(rms, {horizon: sum(map(len, parts)) for horizon, parts in errors.items()},
                  float(np.median(np.concatenate(times))),
                  float(np.mean(np.concatenate(ended))), failed)


def whole_records(predict: Predict, motions: Sequence[EvenMotion], first: int) -> list[np.ndarray]:
    """
    Return the RMS error over each whole run, shape (d,) each.

    Parameters
    ----------
    predict : callable
        Predictor to judge.
    motions : sequence of EvenMotion
        The measured motions.
    first : int
        Sample of each run whose smoothed state starts the only prediction.

    Raises
    ------
    DataError
        A run ends before that sample.

    """
    found = []
    for motion in motions:
        if first >= len(motion.t) - 1:
            raise DataError(f'{motion.name} has only {len(motion.t)} samples; reduce --from')
        q = predict(motion, np.array([first]), len(motion.t) - 1 - first)[0]
        error = np.where(np.isfinite(q), q - motion.q[first:], np.inf)
        found.append(np.sqrt(np.mean(error**2, axis=0)))
    return found


def table(scores: dict[str, Scores], names: Sequence[str]) -> str:
    """Return the scores of several predictors as a Markdown table."""
    first = next(iter(scores.values()))
    head = [f'{horizon:g} s: {", ".join(names)}' for horizon in first.horizons]
    lines = [f'| prediction | {" | ".join(head)} | valid for [s] | energy mismatch | failed |',
             f'|---|{"---|" * (len(head) + 3)}']
    for name, found in scores.items():
        cells = [' '.join(f'{value:.4g}' for value in rms) for rms in found.horizons.values()]
        least = '>= ' if found.censored >= 0.5 else ''
        mismatch = ' '.join(f'{100.0 * value:.3g}%'
                            for value in (found.energy_mismatch or {}).values())
        lines.append(f'| {name} | {" | ".join(cells)} | {least}{found.valid_prediction_time:.3g} '
                     f'| {mismatch or "-"} | {found.failed} |')
    return '\n'.join(lines)


def verdict(scores: dict[str, Scores]) -> str:
    """Summarise the scores in one sentence."""
    said = [f'{"at least " if found.censored >= 0.5 else ""}{found.valid_prediction_time:.2g} s'
            for found in scores.values()]
    others = ', '.join(f'{name} {text}' for name, text in zip(
        [*scores][1:], said[1:], strict=True))
    return f'The model follows the machine for {said[0]} (median); {others}.'


def as_json(scores: dict[str, Scores]) -> dict[str, Any]:
    """Return the content of ``--json``: scores of the model and of its baselines."""
    model, *others = (numbers(found) for found in scores.values())
    return model | {'baselines': dict(zip([*scores][1:], others, strict=True))}


def finite(values: Iterable[float]) -> list[float | None]:
    """Return numbers for JSON, with None in place of non-finite values."""
    return [float(value) if math.isfinite(value) else None for value in values]


def numbers(scores: Scores) -> dict[str, Any]:
    """Return scores for JSON, with None in place of infinite errors."""
    return {'horizons': {f'{horizon:.15g}': finite(rms)
                         for horizon, rms in scores.horizons.items()},
            'valid_prediction_time': scores.valid_prediction_time,
            'censored': scores.censored, 'failed': scores.failed,
            'energy_mismatch': scores.energy_mismatch and dict(zip(
                (f'{horizon:.15g}' for horizon in scores.energy_mismatch),
                finite([*scores.energy_mismatch.values()]), strict=True))}


class Outside(NamedTuple):
    """
    Motions and predictions outside of a model's training domain, in q, v or forces.

    Parameters
    ----------
    share : float
        Share of the samples that are outside.
    beyond : list of str
        Quantities that exceed the domain, the largest excess first.
    errors : dict of str to dict of float to np.ndarray, shape (d,)
        RMS errors at the end of each horizon, separately for predictions along which the machine
        stayed ``inside`` and for all others, ``outside``; empty groups are omitted.

    """

    share: float
    beyond: list[str]
    errors: dict[str, dict[float, np.ndarray]]

    @property
    def text(self) -> str:
        """Summarise the result in plain sentences."""
        if not self.share:
            return 'All samples are inside the training domain of the model.'
        errors = '; '.join(f'{where} ' + ', '.join(
            f'{" ".join(f"{x:.3g}" for x in rms)} after {horizon:g} s'
            for horizon, rms in found.items()) for where, found in self.errors.items() if found)
        return (f'{100.0 * self.share:.3g} % of the samples are outside the training domain of '
                f'the model: {"; ".join(self.beyond)}. RMS errors {errors}.')

    @property
    def numbers(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {'share': self.share, 'beyond': self.beyond, 'errors': {
            where: {f'{horizon:.15g}': finite(rms) for horizon, rms in found.items()}
            for where, found in self.errors.items()}}


def outside(domain: Domain, fans: Sequence[TrajectoryBundle], horizons: Sequence[float]
            ) -> Outside:
    """Compare motions, and predictions of them, with a model's training domain."""
    motions = [fan.motion for fan in fans]
    parts = [np.concatenate([getattr(motion, name) for motion in motions])
             for name in ('q_smooth', 'v_smooth', 'tau')]
    errors: dict[str, dict[float, np.ndarray]] = {'inside': {}, 'outside': {}}
    for horizon in horizons:
        found, out = list[np.ndarray](), list[np.ndarray]()
        for motion, starts, q in fans:
            k = samples_in(horizon, motion)
            starts = starts[starts + k < len(motion.t)]
            if k >= q.shape[1] or not len(starts):
                continue
            found.append(q[:len(starts), k] - motion.q[starts + k])
            count = np.cumsum(np.append(0, domain.excess(
                motion.q_smooth, motion.v_smooth, motion.tau).any(axis=1)))
            out.append(count[starts + k + 1] > count[starts])
        error, beyond = np.concatenate(found), np.concatenate(out)
        error = np.where(np.isfinite(error), error, np.inf)
        for where, rows in (('inside', ~beyond), ('outside', beyond)):
            if rows.any():
                errors[where][horizon] = np.sqrt(np.mean(error[rows]**2, axis=0))
    return Outside(float(domain.excess(*parts).any(axis=1).mean()), domain.beyond(*parts), errors)


def parts_of(model: str) -> tuple[Hamiltonian, Integrator, float | None, list[Effect]]:
    """Return H, integrator, step size (None: the data's) and effects of a model or scene."""
    if model.endswith('.safetensors'):
        hamiltonian = load_learned(Path(model), confine=False)
        if not hamiltonian.canonical:
            return hamiltonian, VariationalMidpoint(), None, []
        return hamiltonian, ImplicitMidpoint(), None, own_effects(model, hamiltonian)
    scene = load_scene(model if not is_path('scene', model) else Path(model))
    parts = resolve(scene)
    build(parts)  # checks that the parts fit each other
    scene, hamiltonian, integrator, effects = parts
    for i, effect in enumerate(effects):
        if isinstance(effect, ExternalForce):
            effect.timeout = _FOREVER
            if effect.names:
                checkpoint = getattr(hamiltonian, 'checkpoint', None)
                if checkpoint is not None and has_map(checkpoint):
                    raise DataError(f'{model}: its model has a learned input map, but '
                                    'external_force acts directly on the joints; give it the '
                                    'model instead of coordinates')
                # All coordinates have a measured force, in the order of H.
                effects[i] = effect.on(names_of(hamiltonian), _FOREVER)
    return hamiltonian, integrator, scene.step_size, effects


def names_of(hamiltonian: Hamiltonian) -> list[str]:
    """Return the names of the coordinates."""
    return [coordinate.name for coordinate in hamiltonian.coordinates]


def own_effects(model: str, hamiltonian: Hamiltonian) -> list[Effect]:
    """Return the learned effects of a model besides H, and its external force."""
    checkpoint = load_checkpoint(model, ensembles=True)
    card = checkpoint.card
    effects: list[Effect] = [
        ExternalForce(model=model, timeout=_FOREVER) if has_map(checkpoint) else
        ExternalForce(names_of(hamiltonian), timeout=_FOREVER)]
    if card.mechanical is not None:
        effects.append(LearnedFriction(model))
    if card.friction is not None:
        effects.append(Damping(model=model))
    if 'dissipation' in checkpoint.networks:
        effects.append(LearnedDissipation(model))
    return effects


def simulation_of(hamiltonian: Hamiltonian, integrator: Integrator, effects: Sequence[Effect],
                  motions: Sequence[EvenMotion], step_size: float | None = None) -> Simulation:
    """
    Return the simulation that predicts motions, which must share one interval.

    The step is the data's interval, or its largest integer fraction of about ``step_size`` or
    less.
    """
    spacing = motions[0].spacing
    steps = 1 if step_size is None else steps_between(spacing, step_size)
    return Simulation(hamiltonian, integrator, spacing / steps, motions[0].q_smooth[0],
                      np.zeros(hamiltonian.dimension), effects)


def judge(simulation: Simulation, effects: Sequence[Effect], motions: Sequence[EvenMotion],
          horizons: Sequence[float], every: float, longest: float,
          others: Mapping[str, Predict]) -> tuple[dict[str, Scores], list[TrajectoryBundle]]:
    """Return the scores of a model, of constant velocity and of `others`; and the model's fans."""
    variance = variance_of(motions)
    predict = simulated(simulation, motions[0].spacing, max(horizons), variance)
    fans = fans_of(predict, motions, horizons, every, longest)
    scores = {'model': score_fans(fans, horizons, variance)} | {
        name: score(other, motions, horizons, every, longest)
        for name, other in {'constant velocity': constant_velocity, **others}.items()}
    if not unaccounted(effects):
        mismatch = energy_mismatch(
            [balance(simulation.hamiltonian, effects, motion) for motion in motions],
            motions[0].spacing, horizons)
        scores['model'] = replace(scores['model'], energy_mismatch=mismatch)
    return scores, fans
