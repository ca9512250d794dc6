# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a model: simulated freely from measured states, and compared."""

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
from hnn_vi_ros.learning.data.motions import EvenMotion, steps_between
from hnn_vi_ros.learning.fit.machine import Network, runge_kutta
from hnn_vi_ros.models import Domain, load_checkpoint, load_learned, rows_of_each
from hnn_vi_ros.run import VALID
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import resolve, Simulation
import numpy as np
from scipy.optimize import nnls
import torch


class Balance(NamedTuple):
    """
    Energy and work along one motion, each of shape (N,).

    Parameters
    ----------
    energy : np.ndarray
        H(q, p(v)) [J].
    work : np.ndarray
        Of all forces, friction included, since the first sample [J].

    """

    energy: np.ndarray
    work: np.ndarray


def unaccounted(effects: Sequence[Effect]) -> list[str]:
    """Return the classes of effects whose work measured states do not tell, as that of noise."""
    return [type(effect).__name__ for effect in effects
            if not (effect.conservative or isinstance(effect, Force))]


def balance(hamiltonian: Hamiltonian, effects: Sequence[Effect], motion: EvenMotion) -> Balance:
    """
    Return energy and work along a motion.

        W(t) = integral of (H_q . f_q + H_p . f_p) dt,  f of friction and of the motors

    by the trapezoidal rule, of second order, with the smoothed states and p from H_p(q, p) = v.
    The measured forces act as in simulations: their mean over each interval.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H, with the potentials of the effects.
    effects : sequence of Effect
        Each conservative or a Force.
    motion : EvenMotion
        The measured motion.

    Raises
    ------
    ModelError
        A velocity has no momentum.

    """
    state = EffectState.empty(len(effects), hamiltonian.dimension)
    # All of them: a magnetic field's gauge is in what others take.
    resolved = [(effect, effect.resolve(hamiltonian.coordinates, state)) for effect in effects]
    forces = [(effect, own) for effect, own in resolved if isinstance(effect, Force)]
    q = motion.q_smooth
    p = momentum(hamiltonian, q, motion.v_smooth, np.zeros_like(q))
    # A command is the same from one end of an interval to the other, and friction may feel it.
    ends = [_power(hamiltonian, forces, motion.t[rows], q[rows], p[rows], motion.forces)
            for rows in (slice(None, -1), slice(1, None))]
    steps = 0.5 * motion.spacing * (ends[0] + ends[1])
    return Balance(hamiltonian.energy(q, p), np.concatenate([[0.0], np.cumsum(steps)]))


def _power(hamiltonian: Hamiltonian, forces: Sequence[tuple[Any, Any]], t: np.ndarray,
           q: np.ndarray, p: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return the power of forces at states, shape (N,), commanded so [W]."""
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


def energy_mismatch(balances: Sequence[Balance], spacing: float, horizons: Sequence[float]
                    ) -> dict[float, float] | None:
    """
    Return the energy that no work accounts for, as a share of the range of H.

    Parameters
    ----------
    balances : sequence of Balance
        Of motions, with samples at even times.
    spacing : float
        From one to the next [s].
    horizons : sequence of float
        Over which energies are compared, of at most the longest motion [s].

    Returns
    -------
    dict of float to float, or None
        For each horizon the root mean square, over all samples, of what H less the work changes
        by in that time, over max H - min H of all motions; None where H does not change.

    """
    energies = np.concatenate([found.energy for found in balances])
    size = float(np.ptp(energies))
    # Round-off of H is no range.
    if size <= 1e3 * np.finfo(np.float64).eps * np.abs(energies).max():
        return None
    shares = {}
    for horizon in horizons:
        k = round(horizon / spacing)
        # A true model holds H less the work constant.
        changes = np.concatenate([
            rest[k:] - rest[:max(0, len(rest) - k)]
            for rest in (found.energy - found.work for found in balances)])
        shares[horizon] = float(np.sqrt(np.mean(changes**2))) / size
    return shares


def friction_work(learned: np.ndarray, trajectory: np.ndarray, t: np.ndarray, v: np.ndarray
                  ) -> tuple[np.ndarray, float]:
    """
    Fit the work of friction to energies along motions, by least squares.

        W(t) = -sum_i integral of (b_i v_i^2 + c_i abs(v_i)) dt,  b_i, c_i >= 0

    Parameters
    ----------
    learned : np.ndarray, shape (n,)
        Energies [J], in the order of time within each trajectory.
    trajectory : np.ndarray of int, shape (n,)
        Of which each state is one.
    t : np.ndarray, shape (n,)
        When [s].
    v : np.ndarray, shape (n, d)
        Velocities.

    Returns
    -------
    np.ndarray of shape (n,), and float
        W [J], from zero on in each trajectory, and the mean power that friction takes [W].

    """
    columns = integrated(np.hstack([v**2, np.abs(v)]), trajectory, t)
    centred, energies, duration = columns.copy(), learned.copy(), 0.0
    for rows in rows_of_each(trajectory):
        centred[rows] -= columns[rows].mean(axis=0)
        energies[rows] -= energies[rows].mean()
        duration += t[rows[-1]] - t[rows[0]]
    # In units of their own: nnls judges by absolute sizes.
    units = np.sqrt(np.mean(centred**2, axis=0))
    units[units == 0.0] = 1.0
    coefficients = nnls(centred / units, -energies)[0] / units
    work = -columns @ coefficients
    lost = sum(work[rows[0]] - work[rows[-1]] for rows in rows_of_each(trajectory))
    return work, float(lost / duration) if duration > 0.0 else 0.0


def integrated(rates: np.ndarray, trajectory: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return integrals over time, shape (n, k), from zero on in each trajectory (trapezoids)."""
    integral = np.zeros_like(rates)
    for rows in rows_of_each(trajectory):
        steps = 0.5 * np.diff(t[rows])[:, None] * (rates[rows[1:]] + rates[rows[:-1]])
        integral[rows[1:]] = np.cumsum(steps, axis=0)
    return integral


# Commands hold to the end of the simulation [s].
_FOREVER = 1e9

# ``predict(motion, starts, count)`` returns q, shape (starts, count + 1, d), at samples from each
# start on: not a number from where a simulation fails, infinite from where one is given up.
Predict = Callable[[EvenMotion, np.ndarray, int], np.ndarray]


class Fan(NamedTuple):
    """
    Predictions of one motion from many of its states.

    Parameters
    ----------
    motion : EvenMotion
        The measured motions.
    starts : np.ndarray of int, shape (n,)
        Samples from which they begin.
    q : np.ndarray, shape (n, count + 1, d)
        Coordinates at the samples from there on; see Predict.

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
        Root mean square of the error of each coordinate at the end of each horizon [s].
    starts : dict of float to int
        How many simulations each is of.
    valid_prediction_time : float
        Median over the starts [s].
    censored : float
        Share of the starts whose prediction was still valid when it, or its run, ended.
    failed : int
        Simulations that failed; their errors are infinite.
    energy_mismatch : dict of float to float, optional
        Of a model, over each horizon; see energy_mismatch.

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
    Return the predictions of a simulation, with the measured forces as its commands.

    Parameters
    ----------
    simulation : Simulation
        Whose step size is a whole part of the samples' interval. It takes commands, one for each
        coordinate, if the motions have forces.
    spacing : float
        The samples' interval [s].
    least : float
        How long each prediction lasts at least, the longest horizon [s]; it is given up as soon
        as it is no longer valid.
    variance : np.ndarray, shape (d,)
        The unit in which errors are judged for that.

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
                continue  # the row stays no number from here on, which the scores count
            except ValueError as problem:
                raise DataError(f'{motion.name}: the state at {motion.t[start]:.6g} s cannot be '
                                f'simulated: {problem}') from problem
        return q
    return predict


def constant_velocity(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
    """Return motions without any force, as predictions."""
    t = motion.spacing * np.arange(count + 1)
    return motion.q_smooth[starts][:, None] + t[:, None] * motion.v_smooth[starts][:, None]


def linear_model(motions: Sequence[EvenMotion]) -> Predict:
    """Return predictions of x_(k+1) = A x_k + B tau_k + c, x = (q, v), by least squares."""
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
        # A matrix may well let motions grow until they are no numbers, which the scores count.
        with np.errstate(over='ignore', invalid='ignore'):
            for k in range(count):
                row = np.minimum(starts + k, len(tau) - 1)
                x = x + share * np.hstack([x, tau[row], np.ones((len(x), 1))]) @ matrix
                q.append(x[:, :d])
        return np.stack(q, axis=1)
    return predict


def predicted_by(network: Network) -> Predict:
    """Return the predictions of a network, by the Runge-Kutta method of order 4."""
    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        tau = torch.tensor(motion.forces)
        q, v = (torch.tensor(values[starts]) for values in (motion.q_smooth, motion.v_smooth))
        rows, found = torch.tensor(starts), [q]
        with torch.no_grad():
            for k in range(count):
                # Beyond the end of the motion nothing is judged.
                held = tau[torch.clamp(rows + k, max=len(tau) - 1)]
                q, v = runge_kutta(network.accelerations, q, v, held, motion.spacing)
                found.append(q)
        return torch.stack(found, dim=1).numpy()
    return predict


def variance_of(motions: Sequence[EvenMotion]) -> np.ndarray:
    """
    Return the variance of each coordinate over motions, shape (d,).

    It is infinite, so that no error counts in its units, for a coordinate that never moves.

    Raises
    ------
    DataError
        None moves.

    """
    q = np.concatenate([motion.q for motion in motions])
    moves = np.ptp(q, axis=0) > 0.0
    if not moves.any():
        raise DataError(f'{motions[0].name}: no coordinate moves, so that nothing can be judged; '
                        'give other motions')
    return np.where(moves, q.var(axis=0), np.inf)


def samples_in(time: float, motion: EvenMotion) -> int:
    """Return the samples of a motion in a time [s], at most all of them."""
    return round(min(time / motion.spacing, len(motion.t)))


def fans_of(predict: Predict, motions: Sequence[EvenMotion], horizons: Sequence[float],
            every: float, longest: float) -> list[Fan]:
    """Return predictions from many measured states, for as long as ``score`` asks for them."""
    for horizon in horizons:
        if all(samples_in(horizon, motion) >= len(motion.t) for motion in motions):
            raise DataError(f'no motion lasts {horizon:g} s, a horizon; give shorter --horizons')
        if any(samples_in(horizon, motion) < 1 for motion in motions):
            raise DataError(f'a horizon of {horizon:g} s is less than the {motions[0].spacing:.4g}'
                            ' s from sample to sample; give longer --horizons')
    fans = []
    for motion in motions:
        n = len(motion.t)
        starts = np.arange(0, n - samples_in(min(horizons), motion),
                           max(1, samples_in(every, motion)))
        if len(starts):
            count = min(samples_in(max(longest, *horizons), motion), n - 1)
            fans.append(Fan(motion, starts, predict(motion, starts, count)))
    return fans


def score(predict: Predict, motions: Sequence[EvenMotion], horizons: Sequence[float], every: float,
          longest: float) -> Scores:
    """
    Predict from many measured states, and compare.

    Parameters
    ----------
    predict : callable
        The predictions that are judged.
    motions : sequence of EvenMotion
        The measured motions.
    horizons : sequence of float
        After which errors are taken [s].
    every : float
        Time from one start to the next [s].
    longest : float
        How long predictions last for the valid prediction time, at least the longest horizon [s].

    Raises
    ------
    DataError
        No motion lasts as long as a horizon, or samples are further apart.

    """
    fans = fans_of(predict, motions, horizons, every, longest)
    return score_fans(fans, horizons, variance_of(motions))


def score_fans(fans: Sequence[Fan], horizons: Sequence[float], variance: np.ndarray) -> Scores:
    """Compare predictions with the measured motions, of this variance, shape (d,); see score."""
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
            # Not a number: an infinite error of a coordinate that has no variance.
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
    Return the root mean square error over each whole run, each of shape (d,).

    Parameters
    ----------
    predict : callable
        The predictions that are judged.
    motions : sequence of EvenMotion
        The measured motions.
    first : int
        The sample of each from whose smoothed state the one prediction begins.

    Raises
    ------
    DataError
        A run ends before that sample.

    """
    found = []
    for motion in motions:
        if first >= len(motion.t) - 1:
            raise DataError(f'{motion.name} has {len(motion.t)} samples; give a smaller --from')
        q = predict(motion, np.array([first]), len(motion.t) - 1 - first)[0]
        error = np.where(np.isfinite(q), q - motion.q[first:], np.inf)
        found.append(np.sqrt(np.mean(error**2, axis=0)))
    return found


def table(scores: dict[str, Scores], names: Sequence[str]) -> str:
    """Return the scores of several predictions as a Markdown table."""
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
    """Return one plain sentence."""
    said = [f'{"at least " if found.censored >= 0.5 else ""}{found.valid_prediction_time:.2g} s'
            for found in scores.values()]
    others = ', '.join(f'{name} {text}' for name, text in zip(
        [*scores][1:], said[1:], strict=True))
    return f'The model follows the machine for {said[0]} (median); {others}.'


def as_json(scores: dict[str, Scores]) -> dict[str, Any]:
    """Return the content of ``--json``: the model's numbers, and its baselines' numbers."""
    model, *others = (numbers(found) for found in scores.values())
    return model | {'baselines': dict(zip([*scores][1:], others, strict=True))}


def finite(values: Iterable[float]) -> list[float | None]:
    """Return numbers for JSON, which has no infinity: None for one that is not finite."""
    return [float(value) if math.isfinite(value) else None for value in values]


def numbers(scores: Scores) -> dict[str, Any]:
    """Return scores for JSON, which has no infinity: None for an error that has no bound."""
    return {'horizons': {f'{horizon:.15g}': finite(rms)
                         for horizon, rms in scores.horizons.items()},
            'valid_prediction_time': scores.valid_prediction_time,
            'censored': scores.censored, 'failed': scores.failed,
            'energy_mismatch': scores.energy_mismatch and dict(zip(
                (f'{horizon:.15g}' for horizon in scores.energy_mismatch),
                finite([*scores.energy_mismatch.values()]), strict=True))}


class Outside(NamedTuple):
    """
    Motions and predictions outside of what a model has seen, in q, v or forces.

    Parameters
    ----------
    share : float
        Of the samples that are outside.
    beyond : list of str
        What goes beyond, the furthest first.
    errors : dict of str to dict of float to np.ndarray, shape (d,)
        Root mean square of the errors at the end of each horizon, of predictions along which the
        machine stayed ``inside``, and of all others, ``outside``; without those that are none.

    """

    share: float
    beyond: list[str]
    errors: dict[str, dict[float, np.ndarray]]

    @property
    def text(self) -> str:
        """Return all of it, as plain sentences."""
        if not self.share:
            return 'All samples are inside of what the model has seen.'
        errors = '; '.join(f'{where} ' + ', '.join(
            f'{" ".join(f"{x:.3g}" for x in rms)} after {horizon:g} s'
            for horizon, rms in found.items()) for where, found in self.errors.items() if found)
        return (f'{100.0 * self.share:.3g} % of the samples are outside of what the model has '
                f'seen: {"; ".join(self.beyond)}. Errors {errors}.')

    @property
    def numbers(self) -> dict[str, Any]:
        """Return all of it for JSON."""
        return {'share': self.share, 'beyond': self.beyond, 'errors': {
            where: {f'{horizon:.15g}': finite(rms) for horizon, rms in found.items()}
            for where, found in self.errors.items()}}


def outside(domain: Domain, fans: Sequence[Fan], horizons: Sequence[float]) -> Outside:
    """Compare motions, and predictions of them, with what a model has seen."""
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
    """Return H, method, step size (None: that of the data) and effects of a model or scene."""
    if model.endswith('.safetensors'):
        hamiltonian = load_learned(Path(model), confine=False)
        if not hamiltonian.canonical:
            return hamiltonian, VariationalMidpoint(), None, []
        return hamiltonian, ImplicitMidpoint(), None, own_effects(model, hamiltonian)
    scene = load_scene(model if not is_path('scene', model) else Path(model))
    scene, hamiltonian, integrator, effects = resolve(scene)[0].parts()
    for effect in effects:
        if isinstance(effect, ExternalForce):
            effect.timeout = _FOREVER
            if effect.names:
                checkpoint = getattr(hamiltonian, 'checkpoint', None)
                if checkpoint is not None and has_map(checkpoint):
                    raise DataError(f'{model}: its model has learned what the motors do to the '
                                    'joints, and external_force acts on the joints themselves; '
                                    'give it the model in place of coordinates')
                # Each coordinate has a measured force, in the order of H.
                effect.names = tuple(names_of(hamiltonian))
    return hamiltonian, integrator, scene.step_size, effects


def names_of(hamiltonian: Hamiltonian) -> list[str]:
    """Return the names of the coordinates."""
    return [coordinate.name for coordinate in hamiltonian.coordinates]


def own_effects(model: str, hamiltonian: Hamiltonian) -> list[Effect]:
    """Return the effects that a model has learned in addition to H, and its external force."""
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
    Return the simulation that predicts motions, which share one interval.

    Steps are the data's interval, or the largest whole part of it that is about ``step_size`` or
    less.
    """
    spacing = motions[0].spacing
    steps = 1 if step_size is None else steps_between(spacing, step_size)
    return Simulation(hamiltonian, integrator, spacing / steps, motions[0].q_smooth[0],
                      np.zeros(hamiltonian.dimension), effects)


def judge(simulation: Simulation, effects: Sequence[Effect], motions: Sequence[EvenMotion],
          horizons: Sequence[float], every: float, longest: float,
          others: Mapping[str, Predict]) -> tuple[dict[str, Scores], list[Fan]]:
    """Return the scores of a model, of constant velocity for scale, and others; and its fans."""
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
