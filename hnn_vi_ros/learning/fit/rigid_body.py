# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit the parameters of a rigid body with friction to measured motions by least squares.

Linear regression of the forces initialises the fit, but noise of the accelerations biases it.
Nonlinear least squares on simulated windows follow. If velocities were measured, windows start
from smoothed states; with positions alone, the initial states are unknowns as well (see shooting),
because noise that is differentiated looks like friction. ``records`` fits whole motions instead.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
import math

from hnn_vi_ros.integrators import ImplicitMidpoint
from hnn_vi_ros.learning.data.motions import cutoff_of, EvenMotion, smoothed
from hnn_vi_ros.learning.families.choices import Structure, TrajectoryLoss
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.fitted_rigid_body import (
    covariance_of, covariance_of_sums, downsampled, FittedRigidBody, OPEN_SHARE,
    positions_alone)
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.growing import (
    cost_at_start, excess_of, fit_numbers, FittedNumbers, refitted)
from hnn_vi_ros.learning.fit.machine import (
    acceleration_errors, Samples, samples_of, scales_of, window_errors, windows_of)
from hnn_vi_ros.learning.fit.rigid_model import ABOVE, parts_of_card, PriorUnknowns, RigidModel
from hnn_vi_ros.learning.fit.shooting import made_up, projected, undetermined, units_of
from hnn_vi_ros.learning.fit.steps import Solutions
from hnn_vi_ros.learning.fit.windows import CannotFollow, cut_windows
from hnn_vi_ros.models import chain_angles, PLANAR_CHAIN
import numpy as np
from scipy.optimize import least_squares, lsq_linear, OptimizeResult
import torch

# Number of evenly spread samples and windows; more change the result by less than its error.
_SAMPLES, _WINDOWS = 4000, 500
# Maximum number of evaluations per fit; it usually ends earlier.
_EVALUATIONS = 60
# Cut-offs of the coarser states of further regressions, relative to the automatic one.
_COARSE = 0.3, 0.1
# Ridge penalty of the regression, relative to the column norms.
_RIDGE = 1e-6
# Plain friction, without the terms of drives.
_PLAIN = {'stribeck': 0, 'directed': False, 'offset': False, 'fade': False, 'load': False}
# Finite-difference step for whole motions, far above the rounding error.
_DIFFERENCE = 1e-5
# Maximum number of windows that start within the length of one.
_OVERLAP = 20
# Share by which residuals without idle numbers may grow beyond what the criterion allows; more
# shows a false minimum.
_NO_WORSE = 1.02
# Variance along directions that the data do not determine, in units of all others together.
_OPEN = 1e6
# Size of a width in standard errors from which the data tell it.
_TOLD = 1.96
# Relative tolerance of the fit to positions: errors of the numbers are far larger.
_TOLERANCE = 1e-5
# Cost of an initial guess, relative to the least, from which other angles are not tried.
_HOPELESS = 100.0
# Change of a number at half the step that matters: in standard errors, and relative to it for logs
# without noise; most halvings of the sampling interval; residuals, in units of the noise, of which
# steps are no main part.
_MOVED, _EXACT, _HALVED, _LACKING = 0.2, 1e-5, 5, 1.5


def fit_rigid_body(networks: Sequence[MechanicalNetwork], loss: TrajectoryLoss,
                   motions: Sequence[EvenMotion]) -> FittedRigidBody | None:
    """
    Fit prior and friction of the best of some networks; widths of friction only to positions.

    Parameters
    ----------
    networks : sequence of MechanicalNetwork
        Networks with a prior and without residual networks.
    loss : Trajectory
        Windows to simulate. Without ``records``, those of positions alone have initial states as
        unknowns and grow up to whole motions, as long as the residuals do not.
    motions : sequence of EvenMotion
        Training motions.

    Returns
    -------
    FittedRigidBody or None
        None if none of them follows the motions.

    """
    if positions_alone(motions) and not loss.records:
        try:
            return _fit_positions([_with_one_width(one) for one in networks], loss, motions)
        except CannotFollow:
            return None
    found = [fit_smoothed(network, loss, motions) for network in networks]
    usable = [one for one in found if np.isfinite([*one.losses.values()]).all()]
    return min(usable, key=lambda one: _last(one.losses), default=None)


def _fit_positions(networks: Sequence[MechanicalNetwork], loss: TrajectoryLoss,
                   motions: Sequence[EvenMotion]) -> FittedRigidBody:
    """Fit the best of some networks in windows whose initial states are unknowns."""
    motions = [replace(motion, v=None) for motion in motions]
    cutoff, models = cutoff_of(motions, motions[0].spacing), list[tuple[float, RigidModel]]()
    # Coarser states have less noise: derivatives of noise look like friction.
    samples = [samples_of(states, None) for states in (motions, *(
        [smoothed(motion.name, motion.t, motion.q, motion.v, motion.tau, share * cutoff)
         for motion in motions] for share in _COARSE))]
    thin, driven = downsampled(motions, loss.step_size)[0], any(
        motion.tau.any() for motion in motions)
    for network in networks:
        physical = PriorUnknowns(network, widths=True)
        begun = [RigidModel(physical, _first(physical, states)[0], thin[0].spacing, driven)
                 for states in samples]
        models.append(min(((cost_at_start(model, thin), model) for model in begun),
                          key=lambda one: one[0]))
    least = min(cost for cost, _ in models)
    fitted = _without_idle_numbers(_with_finer_steps(_with_usual_widths(fit_numbers(
        [model for cost, model in models if not cost > _HOPELESS * least], thin, None, True,
        tolerance=_TOLERANCE, finer=_with_steps_for_next))))
    model = fitted.problem.model
    assert isinstance(model, RigidModel)
    return FittedRigidBody(model.network_at(fitted.solution.values), {
        f'residuals / noise over {length:.3g} s': misfit for length, misfit in fitted.stages},
        noise=fitted.noise, numbers=fitted)


def _with_one_width(network: MechanicalNetwork) -> MechanicalNetwork:
    """Return a network with one Coulomb term, whose width is fitted, unless more are chosen."""
    friction = network.structure.friction
    return network if 'coulomb' in friction.model_fields_set else MechanicalNetwork(
        replace(network.structure, friction=friction.model_copy(update={'coulomb': 1})), [1],
        network.scales, 0)


def _with_usual_widths(fitted: FittedNumbers) -> FittedNumbers:
    """
    Return the fit with usual widths of friction where its data do not tell them from 0.

    Dry friction as wide as all speeds is viscous: neither of the two would be certain.
    """
    solution, model = fitted.solution, fitted.problem.model
    assert isinstance(model, RigidModel)
    errors = np.sqrt(np.diag(covariance_of(fitted)))
    free = np.abs(undetermined(solution, fitted.problem.weights(solution.residuals)))
    open_ = [k for k in model.useless_widths(range(len(errors)))
             if solution.values[k] < _TOLD * errors[k] or (free[k] > OPEN_SHARE).any()]
    if not open_:
        return fitted
    found = refitted(fitted, model.without(open_), np.delete(solution.values, open_), _TOLERANCE)
    return _staged(found, _NO_WORSE) or fitted


def _staged(fitted: FittedNumbers, limit: float) -> FittedNumbers | None:
    """Return a new fit with its stage, None if residuals grew by more than a factor."""
    # Longer windows may have been left.
    k = len(fitted.fits) - 1
    length, before = fitted.stages[k]
    now = excess_of(fitted.solution, fitted.problem, fitted.sensor)
    return None if now > limit * before else fitted._replace(
        stages=[*fitted.stages[:k], (length, now), *fitted.stages[k + 1:]])


def _with_finer_steps(fitted: FittedNumbers) -> FittedNumbers:
    """Return the fit with steps that are small enough."""
    model = _finer_model(fitted)
    if model is fitted.problem.model:
        return fitted
    found = _staged(refitted(fitted, model, fitted.solution.values, _TOLERANCE), math.inf)
    assert found is not None
    return found


def _with_steps_for_next(fitted: FittedNumbers) -> FittedNumbers:
    """
    Return the fit with finer steps if it needs them, unless it lacks something else.

    Numbers that make up for errors of the steps would lead longer windows to false minima.
    """
    return fitted if fitted.stages[-1][1] > _LACKING else _with_finer_steps(fitted)


def _finer_model(fitted: FittedNumbers) -> RigidModel:
    """
    Return the model with steps so small that half of them moves no number, to first order.

    Sharp friction jumps within a step where a joint reverses.
    """
    solution, problem, begun = fitted.solution, fitted.problem, fitted.problem.model
    assert isinstance(begun, RigidModel)
    weights, windows = problem.weights(solution.residuals), solution.windows
    # The noise alone: errors of the steps are a part of the excess.
    errors = np.sqrt(np.diag(covariance_of(fitted))) / max(1.0, fitted.stages[-1][1])
    model, now = begun, LogSimulation(begun.parts_at(solution.values), windows).predict(
        solution.starts)
    while model.step_size > 1.5 * windows.spacing / 2**_HALVED:
        fine = model.at_step(0.5 * model.step_size)
        after = LogSimulation(fine.parts_at(solution.values), windows).predict(solution.starts)
        change = np.where(windows.there[..., None], (after - now) / solution.noise, 0.0)
        moved, _ = made_up(solution, weights, change)
        if (np.abs(moved) <= _MOVED * errors + _EXACT * np.abs(solution.values)).all():
            break
        model, now = fine, after
    return model


def _without_idle_numbers(fitted: FittedNumbers) -> FittedNumbers:
    """
    Return the fit without the friction and the springs that the data do not show.

    Each number removed lowers the Bayesian information criterion, chi^2 + n log(N), at the
    linearised optimum of the others; chi^2 takes the noise as correlated as its sensor shows it.
    """
    solution, model = fitted.solution, fitted.problem.model
    assert isinstance(model, RigidModel)
    weights = fitted.problem.weights(solution.residuals)
    units = units_of(solution)
    slopes = np.sqrt(weights)[..., None] * projected(solution, weights)[0] / units
    n = len(units)
    # At fixed widths: a force that may have any width is less certain than that there is one.
    slopes[..., model.useless_widths(range(n))] = 0.0
    _, R = np.linalg.qr(slopes.reshape(-1, n))
    C = np.linalg.pinv(R.T @ R, hermitian=True) / np.outer(units, units)
    # Along directions of optional numbers that the data do not determine, any of them makes up
    # for the others, so that they are removed first, the last one of them at the start.
    open_ = _open_directions(undetermined(solution, weights), model.optional)
    C += _OPEN * np.trace(C @ np.diag(units**2)) * (open_ @ open_.T) / np.outer(units, units)
    same = (np.abs(open_) > OPEN_SHARE).any(axis=1)
    B = np.outer(units, units) * covariance_of_sums(fitted, slopes)
    x, price, idle = solution.values.copy(), math.log(solution.freedom), list[int]()
    low, high = np.array([(number.low, number.high) for number in model.numbers]).T
    least = np.maximum(low, 0.0)
    while left := [k for k in model.optional if k not in idle and C[k, k] > 0.0]:
        spread = np.einsum('ki,ij,kj->k', C, B, C)
        above = np.where(np.isfinite(low), np.maximum(x - least, 0.0), x)
        with np.errstate(over='ignore'):
            cost = np.where(same, -np.arange(n), above**2 / np.maximum(spread, 1e-300))
        k = min(left, key=lambda k: cost[k])
        if cost[k] > price:
            break
        x -= C[:, k] / C[k, k] * (x[k] - least[k])
        C -= np.outer(C[:, k], C[:, k]) / C[k, k]
        idle.append(k)
        if same[k]:
            open_ = _open_directions(open_, [j for j in range(n) if j not in idle])
            same = (np.abs(open_) > OPEN_SHARE).any(axis=1)
    if not idle:
        return fitted
    idle += model.useless_widths(idle)
    # Residuals grow by no more than this under the criterion.
    limit = _NO_WORSE * math.sqrt(1.0 + len(idle) * price / solution.freedom)
    return _refitted_without(
        fitted, model.without(idle), np.delete(np.clip(x, low, high), idle), limit)


def _open_directions(directions: np.ndarray, numbers: Sequence[int]) -> np.ndarray:
    """Return an orthonormal basis, (n, k), of the directions along some numbers alone."""
    _, sizes, rows = np.linalg.svd(np.delete(directions, numbers, axis=0))
    large = np.count_nonzero(sizes > OPEN_SHARE)
    return directions @ rows[large:].T


def _refitted_without(fitted: FittedNumbers, model: RigidModel, values: np.ndarray, limit: float
                      ) -> FittedNumbers:
    """
    Return the fit of a model without some numbers in the longest windows where it is no worse.

    Long windows of a chaotic motion have false minima even close to the solution.
    """
    for k in range(len(fitted.fits), 0, -1):
        try:
            found = refitted(fitted._replace(fits=fitted.fits[:k]), model, values, _TOLERANCE)
        except CannotFollow:
            continue
        staged = _staged(found, limit)
        if staged is not None:
            return staged
    return fitted


def fit_smoothed(network: MechanicalNetwork, loss: TrajectoryLoss, motions: Sequence[EvenMotion]
                 ) -> FittedRigidBody:
    """
    Fit a network in windows that start from smoothed states; the friction widths stay fixed.

    Parameters
    ----------
    network : MechanicalNetwork
        Network with a prior and without residual networks.
    loss : Trajectory
        Windows to simulate.
    motions : sequence of EvenMotion
        Training motions.

    Returns
    -------
    FittedRigidBody
        With the loss after each fit, inf if windows diverge at its initial values.

    """
    samples, physical = samples_of(motions, loss.step_size), PriorUnknowns(network)
    found, first = _first(physical, samples)
    found, losses = _in_windows(physical, found, loss, samples)
    choice = network.friction.choice
    simple = choice.model_copy(update=_PLAIN)
    if simple != choice:
        plain = PriorUnknowns(MechanicalNetwork(replace(network.structure, friction=simple), [1],
                                                network.scales, 0))
        numbers, least = _in_windows(plain, _first(plain, samples)[0], loss, samples)
        # More friction contains less, so an end above it is a local minimum.
        if _last(least) < _last(losses):
            found, losses = _in_windows(
                physical, _with_more_friction(physical, plain, numbers), loss, samples)
    return FittedRigidBody(physical.network_at(found), {'rigid_body_forward': first} | losses)


def _in_windows(physical: PriorUnknowns, found: np.ndarray, loss: TrajectoryLoss, samples: Samples
                ) -> tuple[np.ndarray, dict[str, float]]:
    """Fit numbers to the windows of each stage; return them and the losses."""
    losses = {}
    for name, _, errors in window_fits(physical.network, loss, samples, _WINDOWS):
        found, losses[name] = _least_squares(physical, found, errors)
    return found, losses


def _with_more_friction(physical: PriorUnknowns, plain: PriorUnknowns, numbers: np.ndarray
                        ) -> np.ndarray:
    """Return the numbers of plain friction in a model with more: both sides alike, the rest 0."""
    d, sides = physical.network.d, 1 + physical.network.friction.choice.directed
    known, found = (np.split(x, np.cumsum(one.sizes)[:-1]) for x, one in (
        (numbers, plain), (physical.now(), physical)))
    force = np.repeat(known[2].reshape(-1, d), sides, axis=0).ravel()
    added = len(found[2]) - len(force)
    return np.concatenate([known[0], np.tile(known[1], sides), force, np.zeros(added),
                           0.0 * found[3], known[4], 0.0 * found[5], found[6]])


def _last(losses: Mapping[str, float]) -> float:
    return [*losses.values()][-1]


def fit_records(network: MechanicalNetwork, loss: TrajectoryLoss, motions: Sequence[EvenMotion]
                ) -> tuple[MechanicalNetwork, float]:
    """
    Fit prior and friction of a network to the positions of whole motions (output error).

    Parameters
    ----------
    network : MechanicalNetwork
        Network with a prior and without residual networks.
    loss : Trajectory
        Source of the step size to which motions are downsampled; forces are averaged.
    motions : sequence of EvenMotion
        Training motions.

    Returns
    -------
    MechanicalNetwork and float
        The best network, and its root mean square error in units of the standard deviation of each
        coordinate.

    """
    physical, (records, size) = PriorUnknowns(network), downsampled(motions, loss.step_size)
    scale = physical.scale

    def errors(x: np.ndarray) -> np.ndarray:
        own = physical.network_at((x - 1.0) * scale)
        return np.concatenate([(whole(own, motion) - motion.q) / size
                               for motion in records]).ravel()
    # All numbers are shifted by one, so that difference steps have similar sizes.
    least, most, start = (1.0 + part for part in (
        physical.least, physical.most, physical.now() / scale))
    fit = least_squares(errors, np.maximum(start, least + ABOVE), diff_step=_DIFFERENCE,
                        bounds=(least, most), x_scale='jac', max_nfev=_EVALUATIONS // 2)
    return physical.network_at((fit.x - 1.0) * scale), float(np.sqrt(np.mean(fit.fun**2)))


def whole(network: MechanicalNetwork, motion: EvenMotion) -> np.ndarray:
    """Simulate a rigid body from the first smoothed state of a motion; return q, shape (N, d)."""
    parts = parts_of_card(network.card(), motion.spacing, True)._replace(
        integrator=ImplicitMidpoint())
    windows = cut_windows([motion], len(motion.t) * motion.spacing)
    log = LogSimulation(parts, windows)
    states = log.states(log.starts(*windows.start.swapaxes(0, 1))[:, None])
    return states[0, 0, :, :network.d]


def best_rigid_body(loss: TrajectoryLoss, motions: Sequence[EvenMotion],
                    structure: Structure | None = None, learns_map: bool = False
                    ) -> FittedRigidBody | None:
    """
    Return a fitted chain with one link per coordinate.

    Parameters
    ----------
    loss : Trajectory
        Windows to simulate; see fit_rigid_body.
    motions : sequence of EvenMotion
        Training motions.
    structure : Structure, optional
        Joints and friction, and the angles of the links; without angles, the best ones are found.
        Default: continuous joints with viscous friction and two Coulomb terms.
    learns_map : bool
        True to fit an input map too.

    Returns
    -------
    FittedRigidBody or None
        None if no chain has that many links, if none follows the motions, or if the forces do not
        act on the joints.

    """
    d, motors = motions[0].q.shape[1], motions[0].tau.shape[1]
    known = structure or Structure(['revolute'] * d, [], [])
    if motors != d and not learns_map:
        return None
    scales = scales_of(motions, learns_map)
    networks = [MechanicalNetwork(replace(
        known, features=known.features or np.eye(d).tolist(), mass_features=[],
        prior=PLANAR_CHAIN, angles=angles, left_out=(), residual=False, friction_features=None),
        [1], scales, 0) for angles in (
            chain_angles(known.kinds, known.features) if known.angles is None else [known.angles])]
    return fit_rigid_body(networks, loss, motions) if networks else None


def window_fits(network: MechanicalNetwork, loss: TrajectoryLoss, samples: Samples, most: int
                ) -> Iterator[tuple[str, torch.Tensor, Callable[[Solutions], torch.Tensor]]]:
    """Yield the name of each stage, the starts of about `most` windows, and their errors."""
    for stage in loss.windows:
        windows, starts = windows_of(loss, stage, samples)
        # Windows nearly as long as their motion are nearly identical.
        length = windows.steps * samples.every
        chosen = spread(starts, min(most, 1 + _OVERLAP * len(starts) // length))
        yield f'rigid_body_{stage.duration:g}', chosen, partial(
            window_errors, network, samples, chosen, windows)


def spread(rows: torch.Tensor, most: int) -> torch.Tensor:
    """Return about `most` rows or fewer, evenly spread."""
    return rows[:: max(1, len(rows) // most)]


def _first(physical: PriorUnknowns, samples: Samples) -> tuple[np.ndarray, float]:
    """Return the parameters that best explain the accelerations, and the loss."""
    # For rigid links, the forces are linear in the parameters.
    found = _regression(physical, samples) if physical.prior.linear else physical.now()
    rows = spread(torch.arange(len(samples.q)), _SAMPLES)
    return _least_squares(physical, found, lambda _: acceleration_errors(
        physical.network, samples, rows))


def _regression(physical: PriorUnknowns, samples: Samples) -> np.ndarray:
    """Return the parameters that best explain the forces, with the current input map."""
    rows = spread(torch.arange(len(samples.q)), _SAMPLES)
    q, v, a, tau = (part[rows] for part in (samples.q, samples.v, samples.a, samples.tau))
    with torch.no_grad():
        tau = physical.network.joint_forces(tau)
    # Scale each joint by its usual force.
    scales = physical.network.scales
    unit = torch.tensor(scales.inertia * scales.a)
    matrix = (physical.network.columns(q, v, a, tau) / unit[:, None]).flatten(0, 1).numpy()
    right = (tau / unit).flatten().numpy()
    # The ridge splits the force between equal columns, such as a carriage's weight and its motor's
    # offset; otherwise they could cancel with huge coefficients.
    matrix = np.vstack([matrix, _RIDGE * np.diag(np.linalg.norm(matrix, axis=0))])
    right = np.append(right, np.zeros(matrix.shape[1]))
    least = (physical.least * physical.scale)[:matrix.shape[1]]
    if right.any():
        found = lsq_linear(matrix, right, (least, np.inf)).x
    else:
        # Without forces, parameters are known up to a common factor: set the first inertia to one.
        found = np.append(1.0, lsq_linear(matrix[:, 1:], -matrix[:, 0], (least[1:], np.inf)).x)
    n = physical.sizes[0]
    values = physical.prior.possible(torch.tensor(found[:n])).numpy()
    end = n + sum(physical.sizes[1:4])
    return np.concatenate([values, found[n:], physical.now()[end:]])


def _least_squares(physical: PriorUnknowns, start: np.ndarray,
                   errors: Callable[[Solutions], torch.Tensor]) -> tuple[np.ndarray, float]:
    """Return the parameters of the smallest soft loss, and that loss."""
    scale = torch.tensor(physical.scale)
    found = fit_errors(physical.network, lambda x: physical.raw(x * scale),
                       start / physical.scale, physical.least, errors, physical.most)
    return (start if found is None else found.x * physical.scale), loss_of(found)


def loss_of(found: OptimizeResult | None) -> float:
    """Return the loss after a fit, inf if its initial values were invalid."""
    # The cost is half a sum; the losses of networks are means of the same terms.
    return np.inf if found is None else 2.0 * float(found.cost) / len(found.fun)


def fit_errors(network: MechanicalNetwork,
               raw: Callable[[torch.Tensor], dict[str, torch.Tensor]], start: np.ndarray,
               least: np.ndarray, errors: Callable[[Solutions], torch.Tensor],
               most: np.ndarray | float = np.inf) -> OptimizeResult | None:
    """
    Minimise the soft loss of errors over parameters.

    Parameters
    ----------
    network : MechanicalNetwork
        Network that the errors depend on.
    raw : callable
        ``raw(x)`` returns the network's parameters by name.
    start, least : np.ndarray, shape (k,)
        Initial values, and lower bounds. Values on a bound are moved above it: a step ends where
        it meets a bound, and one such number would block all others.
    errors : callable
        Errors of the network, a function of the solver that caches its steps.
    most : np.ndarray, shape (k,), optional
        Upper bounds.

    Returns
    -------
    OptimizeResult or None
        Result of scipy.optimize.least_squares; None if the initial errors are not finite.

    """
    module = _Errors(network, errors)

    def residuals(x: torch.Tensor, solutions: Solutions) -> torch.Tensor:
        parts = {f'network.{name}': part for name, part in raw(x).items()}
        return torch.func.functional_call(module, parts, (solutions,)).reshape(-1)

    def values(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            # Errors are inf if M is not positive definite, or a window diverges.
            return np.nan_to_num(residuals(torch.tensor(x), Solutions()).numpy(), nan=np.inf)

    def jacobian(x: np.ndarray) -> np.ndarray:
        at, solutions = torch.tensor(x), Solutions()
        with torch.no_grad():
            residuals(at, solutions)
            return torch.func.jacfwd(lambda x: residuals(x, solutions.again()))(at).numpy()
    start = np.maximum(start, least + ABOVE)
    if not np.isfinite(values(start)).all():
        return None
    return least_squares(values, start, jacobian, (least, most), loss='soft_l1', x_scale='jac',
                         ftol=1e-5, max_nfev=_EVALUATIONS)


class _Errors(torch.nn.Module):
    """Error function as a module, whose parameters can be replaced."""

    def __init__(self, network: MechanicalNetwork, errors: Callable[[Solutions], torch.Tensor]):
        super().__init__()
        self.network, self.errors = network, errors

    def forward(self, solutions: Solutions) -> torch.Tensor:
        """Return the errors."""
        return self.errors(solutions)
