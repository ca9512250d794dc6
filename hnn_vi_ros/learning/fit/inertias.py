# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Identify the inertial parameters and friction of a rigid-body robot from measured motions.

The forces are linear in the parameters, Y(q, v, a) theta = tau, and theta(x) is physically
consistent for every x, with x = 0 for the URDF. x minimises the residual of the stacked
regressor Y, each joint scaled by its noise, plus a small regularisation towards x = 0, which
weighs as much as one sample in directions that the data determine to less than _DETERMINED.
Acceleration noise biases this estimate towards zero; a fit of simulated windows can follow.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.data.sampling import low_pass
from hnn_vi_ros.learning.families.choices import Inverse, TrajectoryLoss
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.families.priors import RigidTree
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import FittedRigidBody
from hnn_vi_ros.learning.fit.machine import acceleration_errors, samples_of
from hnn_vi_ros.learning.fit.model_files import with_prior
from hnn_vi_ros.learning.fit.rigid_body import fit_errors, loss_of, spread, window_fits
from hnn_vi_ros.learning.fit.rigid_model import ABOVE, RigidUnknowns
from hnn_vi_ros.learning.fit.steps import Solutions
from hnn_vi_ros.models import (
    BaseParameter, Checkpoint, EACH, FrictionCard, Identification, INERTIAL, ModelCard, PriorCard,
    sum_text)
import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares, OptimizeResult
from scipy.stats import norm
from scipy.stats import t as student_t
import torch

# Half-width of a 95 % interval of the normal distribution, in standard deviations.
_HALF = 1.96
# Number of samples per chunk, which limits the memory.
_CHUNK = 5000


def with_force_errors(checkpoint: Checkpoint, network: MechanicalNetwork,
                      motions: Sequence[EvenMotion]) -> Checkpoint:
    """Return an identified rigid-body model with its force errors along motions in the card."""
    mechanical = checkpoint.card.mechanical
    if mechanical is None or mechanical.prior is None or mechanical.prior.identification is None:
        return checkpoint
    error, share = force_errors(network, motions)
    update = {'force_error': error} | ({'residual_share': share} if share else {})
    return with_prior(checkpoint, identification=mechanical.prior.identification.model_copy(
        update=update))


def force_errors(network: MechanicalNetwork, motions: Sequence[EvenMotion]
                 ) -> tuple[list[float], list[float]]:
    """
    Return the force errors along motions, and the share of the forces that networks produce.

    Returns
    -------
    list of float, d
        Squared error divided by the variance, per joint [1].
    list of float, d
        RMS force of the networks divided by that of all forces [1]; empty without networks.

    """
    errors, added, measured = zip(*(_errors(network, motion) for motion in motions), strict=True)
    error, forces = np.concatenate(errors), np.concatenate(measured)
    found = ((error**2).mean(axis=0) / forces.var(axis=0)).tolist()
    if not network.structure.residual:
        return found, []
    share = np.sqrt((np.concatenate(added)**2).mean(axis=0) / (forces**2).mean(axis=0))
    return found, share.tolist()


def _errors(network: MechanicalNetwork, motion: EvenMotion) -> tuple[np.ndarray, ...]:
    """Return errors of forces, forces of networks, and measured forces, shape (N, d) each."""
    states = motion.q_smooth, motion.v_smooth, motion.a_smooth, motion.tau
    chunks = zip(*(torch.tensor(part).split(_CHUNK) for part in states), strict=True)
    forces, added = [], []
    with torch.no_grad():
        for chunk in chunks:
            forces.append(network.forces(*chunk).numpy())
            added.append(network.added_forces(*chunk).numpy())
    return np.concatenate(forces) - motion.tau, np.concatenate(added), motion.tau


def identified_text(card: ModelCard) -> str:
    """Return the tables of identified parameters, or '' for other models."""
    prior = None if card.mechanical is None else card.mechanical.prior
    if card.mechanical is None or prior is None or prior.identification is None:
        return ''
    return '\n'.join(_lines([coordinate.name for coordinate in card.coordinates], prior,
                            prior.identification, card.mechanical.friction)) + '\n'


def _lines(names: Sequence[str], prior: PriorCard, found: Identification, friction: FrictionCard
           ) -> Iterator[str]:
    yield ('\n## Identified\n\n'
           f'The motions determine {len(found.base_parameters)} combinations of the inertial '
           'parameters. The interval contains the true value in 95 % of cases if the noise of '
           'forces is the only error.\n')
    yield '| base parameter | value | ± 95 % | unit |\n|---|---|---|---|'
    for one in found.base_parameters:
        yield (f'| {sum_text(one.combination)} | {one.value:.5g} | '
               f'{_HALF * one.standard_error:.2g} | {one.unit} |')
    if found.weak:
        yield ('\nThe data hardly determine these parameters; their values stay close to the '
               'URDF: ' + '; '.join(sum_text(one.combination) for one in found.weak) + '.')
    yield ('\nThe forces do not depend on these changes, so along them the robot is as in the '
           f'URDF, or the nearest physically consistent body ({len(found.held)}):\n')
    yield from (f'- {sum_text(one)}' for one in found.held)
    yield '\n| joint | force error, share of its variance | viscous | Coulomb | offset |' + (
        ' networks, share of force |' if found.residual_share else '')
    yield '|---|---|---|---|---|' + ('---|' if found.residual_share else '')
    for j, name in enumerate(names):
        coulomb = ', '.join(f'{term.force[j]:.4g}' for term in friction.coulomb) or '-'
        share = f' {found.residual_share[j]:.3g} |' if found.residual_share else ''
        yield (f'| {name} | {found.force_error[j]:.4g} | {friction.viscous[j]:.4g} | {coulomb} | '
               f'{prior.values[f"{name}.offset"]:.4g} |{share}')


# Maximum number of samples, and number of blocks per joint regarded as independent: longer
# than the noise correlation, and several for each fitted parameter.
_SAMPLES, _BLOCKS = 20000, 25
# Maximum number of simulated windows; a tree takes ten times as long as a chain.
_WINDOWS = 200
# Number of states at which accelerations are compared.
_STATES = 2000
# A direction is determined if noise changes it by less than 1 / _DETERMINED of the URDF's
# value; singular values below _ROUNDING times the largest are zero.
_DETERMINED, _ROUNDING = 3.0, 1e-8
# Minimum noise as a share of the force; weight of the URDF, in standard deviations.
_LEAST_NOISE, _PREFERENCE = 1e-9, 0.1
# Coefficients of base parameters below this, in units of the parameters, are dropped.
_SMALL = 1e-6
# Column scale of masses, which makes them the last choice of base parameters.
_MASS_LAST = 1e-3


class Unknowns(RigidUnknowns):
    """
    Unknowns x = (log-Cholesky, rotors, offsets, viscous, Coulomb), some of them fixed.

    Parameters
    ----------
    network : MechanicalNetwork
        Network with a RigidTree and without residual networks.
    rotors, offsets : bool
        True to identify rotors and offsets too.

    """

    everything = False

    def __init__(self, network: MechanicalNetwork, rotors: bool, offsets: bool):
        tree, d = network.prior, network.d
        assert isinstance(tree, RigidTree)
        self.tree, self._parts = tree, [INERTIAL * d, d, d]
        order = [body.coordinate for body in tree.tree.bodies]
        inertia = network.scales.inertia[order]
        super().__init__(
            network, np.r_[np.ones(INERTIAL * d), inertia, network.friction.force_unit[order]],
            np.repeat([-np.inf, 0.0, -np.inf], self._parts))
        rubbing = sum(self.sizes[1:])
        self.free = np.flatnonzero(np.repeat([True, rotors, offsets, True],
                                             [*self._parts, rubbing]))
        self.start = np.r_[np.zeros(INERTIAL * d), tree.rotor.detach().numpy() / inertia,
                           np.zeros(d), np.full(rubbing, ABOVE)]

    def linear(self, x: torch.Tensor) -> torch.Tensor:
        """Return the parameters that enter forces linearly, (k,); x is in units of ``scale``."""
        prior, friction = (x * torch.tensor(self.scale)).tensor_split(self.sizes[:1])
        log, rotors, offsets = self.raw_prior(prior).values()
        values = torch.cat([self.tree.inertial(log), rotors[:, None], offsets[:, None]], dim=1)
        return torch.cat([values.flatten(), friction])

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the Jacobian of ``linear`` with respect to x."""
        return torch.func.jacfwd(self.linear)(torch.tensor(x)).numpy()

    def raw_prior(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return log-Cholesky parameters, rotors and offsets, as in RigidUnknowns."""
        log, rotors, offsets = values.split(self._parts)
        return {'prior.raw': log.reshape(-1, INERTIAL), 'prior.rotor': rotors,
                'prior.offset': offsets}


class Equations(NamedTuple):
    """
    Linear equations for the forces of N samples of d joints in k parameters.

    Parameters
    ----------
    matrix : np.ndarray, shape (N, d, k)
        The regressor.
    forces : np.ndarray, shape (N, d)
        Measured forces.
    blocks : np.ndarray of int, shape (N,)
        Index of each sample's block of consecutive samples.

    """

    matrix: np.ndarray
    forces: np.ndarray
    blocks: np.ndarray


class Information(NamedTuple):
    """
    Information of the data on the inertial parameters, rotors and offsets at x.

    Parameters
    ----------
    held : np.ndarray, shape (n, m)
        Directions of the n free entries of x that the data do not determine.
    excited : np.ndarray, shape (n, r)
        Their orthogonal complement, the determined directions.
    felt : np.ndarray, shape (n, s)
        All directions that affect the forces, the determined ones first.
    base : np.ndarray, shape (s, k)
        Coefficients of the base parameters, the combinations on which the forces depend.
    units : np.ndarray, shape (s,)
        Scales of the base parameters: change of the first parameter of each with x.
    idle : list of np.ndarray, each (k,)
        Parameter changes that do not affect the forces.

    """

    held: np.ndarray
    excited: np.ndarray
    felt: np.ndarray
    base: np.ndarray
    units: np.ndarray
    idle: list[np.ndarray]


def identify_inertias(network: MechanicalNetwork, config: MachineConfig,
                      motions: Sequence[EvenMotion], rotors: bool = False, offsets: bool = True
                      ) -> FittedRigidBody:
    """
    Identify the inertias and friction of a tree; the friction widths stay fixed.

    Parameters
    ----------
    network : MechanicalNetwork
        Network with a RigidTree and without residual networks.
    config : MachineConfig
        Configuration of the fit.
    motions : sequence of EvenMotion
        Measured motions with forces.
    rotors, offsets : bool
        True to identify rotors and offsets too.

    Returns
    -------
    FittedRigidBody
        With the loss after each fit, inf where a window diverged; its network has the summary in
        ``prior.identification``.

    Raises
    ------
    DataError
        Some joint has no measured forces.

    """
    unknowns = Unknowns(network, rotors, offsets)
    equations = equations_of(network, motions)
    for coordinate, force in zip(config.coordinates, equations.forces.T, strict=True):
        if not force.any():
            raise DataError(f'the data contain no force of {coordinate.name}, without which '
                            'masses cannot be identified; record while its motor is active')
    weights = _weights(equations, unknowns)
    whitened = Equations(equations.matrix * weights[:, None], equations.forces * weights,
                         equations.blocks)
    x = _regress(unknowns, whitened)
    known = _information(unknowns, whitened, x)
    error = np.mean(_residuals(unknowns, whitened, x)**2)
    losses = {'rigid_body_inverse': float(error)}
    covariance = _covariance(unknowns, whitened, known, x)
    weak = _base_errors(unknowns, known, covariance, x) * _DETERMINED > known.units
    if not isinstance(config.loss, Inverse):
        x, found, covariance = _fit_windows(unknowns, whitened, config.windows, motions, x)
        losses |= found
    fitted = unknowns.network_at(x * unknowns.scale)
    assert fitted.prior is not None
    fitted.prior.identification = _summary(unknowns, known, weak, covariance, x)
    return FittedRigidBody(fitted, losses)


def equations_of(network: MechanicalNetwork, motions: Sequence[EvenMotion]) -> Equations:
    """Return the equations of motions; forces pass the filter of the states."""
    every = max(1, sum(len(motion.t) for motion in motions) // _SAMPLES)
    length = sum(len(motion.t) for motion in motions) / (_BLOCKS * network.d)
    found, first = [], 0
    for motion in motions:
        with torch.no_grad():
            matrix = network.columns(*map(torch.tensor, (
                motion.q_smooth, motion.v_smooth, motion.a_smooth, motion.tau))).numpy()
        forces = motion.tau
        if motion.a is None:
            # Both sides get the same filter, so that they stay equal.
            matrix, forces = (low_pass(motion.name, part, motion.spacing, motion.cutoff)
                              for part in (matrix, forces))
        blocks = first + (np.arange(len(motion.t)) / length).astype(int)
        first = blocks[-1] + 1
        found.append((matrix[::every], forces[::every], blocks[::every]))
    return Equations(*map(np.concatenate, zip(*found, strict=True)))


def _weights(equations: Equations, unknowns: Unknowns) -> np.ndarray:
    """Return the reciprocal noise of each joint, including autocorrelation."""
    n, d = equations.forces.shape
    size = np.sqrt(np.mean(equations.forces**2, axis=0))
    weights, least = 1.0 / size, _LEAST_NOISE * size
    columns = np.abs(unknowns.slopes(unknowns.start)).max(axis=1)
    used = np.flatnonzero(columns)
    for _ in range(2):
        rows = (equations.matrix[:, :, used] * columns[used] * weights[:, None]).reshape(n * d, -1)
        found = np.linalg.lstsq(rows, (equations.forces * weights).ravel(), rcond=_ROUNDING)[0]
        errors = equations.forces - equations.matrix[:, :, used] @ (columns[used] * found)
        sums = np.stack([errors[equations.blocks == block].sum(axis=0)
                         for block in np.unique(equations.blocks)])
        # Variance of block sums; it equals the variance of a sample if samples are independent.
        noise = np.maximum((sums**2).sum(axis=0) / n, np.mean(errors**2, axis=0))
        weights = 1.0 / np.maximum(np.sqrt(noise), least)
    return weights


def _residuals(unknowns: Unknowns, equations: Equations, x: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        found: np.ndarray = equations.matrix @ unknowns.linear(torch.tensor(x)).numpy()
    return found - equations.forces


def _regress(unknowns: Unknowns, equations: Equations) -> np.ndarray:
    """Return the least-squares x; QR reduces the equations to the number of parameters."""
    k = equations.matrix.shape[2]
    R = np.asarray(np.linalg.qr(np.hstack([
        equations.matrix.reshape(-1, k), equations.forces.reshape(-1, 1)]), mode='r'))
    free, start = unknowns.free, unknowns.start
    known = _information(unknowns, equations, start)
    inertial = len(known.held)
    prefer = np.eye(len(free)) * _PREFERENCE
    prefer[:inertial, :inertial] += known.held @ known.held.T

    def full(z: np.ndarray) -> np.ndarray:
        x = start.copy()
        x[free] = z
        return x

    def residuals(z: np.ndarray) -> np.ndarray:
        linear = unknowns.linear(torch.tensor(full(z))).numpy()
        return np.r_[R[:, :k] @ linear - R[:, k], prefer @ (z - start[free])]

    def jacobian(z: np.ndarray) -> np.ndarray:
        return np.vstack([R[:, :k] @ unknowns.slopes(full(z))[:, free], prefer])
    found = least_squares(residuals, start[free], jacobian, (unknowns.least[free], np.inf),
                          x_scale=1.0, ftol=1e-12, xtol=1e-10, gtol=1e-10, max_nfev=500)
    return full(found.x)


def _information(unknowns: Unknowns, equations: Equations, x: np.ndarray) -> Information:
    """Return the information from the SVD of the regressor after eliminating friction."""
    k, rows = equations.matrix.shape[2], equations.matrix.reshape(-1, equations.matrix.shape[2])
    values = EACH * unknowns.network.d
    slopes = unknowns.slopes(x)
    inertial = unknowns.free[unknowns.free < unknowns.sizes[0]]
    G = slopes[:values][:, inertial]
    # QR puts friction first; the trailing block is what friction cannot explain.
    whole = np.asarray(np.linalg.qr(np.hstack([rows[:, values:], rows[:, :values]]), mode='r'))
    R = whole[k - values:, k - values:]
    _, sizes, V = np.linalg.svd(R @ G)
    felt = int(np.sum(sizes > _ROUNDING * sizes[0]))
    rank = int(np.sum(sizes[:felt] > _DETERMINED))
    # Scale of each parameter: its change with x.
    unit = np.sqrt((G**2).sum(axis=1))
    used = np.flatnonzero(unit)
    # Moments come before masses because users know moments better.
    pick = np.where(used % EACH == 0, _MASS_LAST, 1.0) * unit[used]
    _, triangle, order = qr(R[:, used] * pick, mode='economic', pivoting=True)
    count = int(np.sum(np.abs(np.diag(triangle)) > _ROUNDING * abs(triangle[0, 0])))
    factors = np.linalg.solve(triangle[:count, :count], triangle[:count, count:])
    base, idle = np.zeros((count, k)), []
    first, others = used[order[:count]], used[order[count:]]
    base[np.arange(count), first] = 1.0
    factors[np.abs(factors) < _SMALL] = 0.0
    base[:, others] = factors * pick[order[:count]][:, None] / pick[order[count:]]
    for column, other in enumerate(others):
        change = np.zeros(k)
        change[other] = 1.0
        change[first] = -base[:, others[column]]
        idle.append(change)
    return Information(V[rank:].T, V[:rank].T, V[:felt].T, base, unit[first], idle)


def _fit_windows(unknowns: Unknowns, equations: Equations, loss: TrajectoryLoss,
                 motions: Sequence[EvenMotion], x: np.ndarray
                 ) -> tuple[np.ndarray, dict[str, float], np.ndarray]:
    """
    Fit windows along determined directions; return x, losses, and covariance.

    Accelerations are fitted first: a common factor of all forces does not reduce their errors.
    """
    samples, losses = samples_of(motions, loss.step_size), {}
    network, covariance = unknowns.network, np.zeros((len(x), len(x)))
    rows = spread(torch.arange(len(samples.q)), _STATES)
    inertial = unknowns.sizes[0]
    # Start from the least-squares x, and from the URDF with the friction of that x.
    tries = [_fit(unknowns, equations, one, lambda _: acceleration_errors(network, samples, rows))
             for one in (x, np.r_[unknowns.start[:inertial], x[inertial:]])]
    # Repeat, because the determined directions at the result differ from those at the start.
    tries += [_fit(unknowns, equations, one, lambda _: acceleration_errors(network, samples, rows))
              for one, _, found in tries if found is not None]
    x, directions, found = min(tries, key=lambda one: np.inf if one[2] is None else one[2].cost)
    losses['rigid_body_forward'] = loss_of(found)
    for name, chosen, errors in window_fits(network, loss, samples, _WINDOWS):
        x, directions, found = _fit(unknowns, equations, x, errors)
        losses[name] = loss_of(found)
        if found is None:
            continue
        # Residuals of each window with soft_l1 weights.
        soft = (1.0 + found.fun**2)**-0.25
        parts = -1, len(chosen), unknowns.network.d
        jacobian = (found.jac * soft[:, None]).reshape(*parts, directions.shape[1])
        scores = np.einsum('snd,sndk->nk', (found.fun * soft).reshape(parts), jacobian)
        J = jacobian.reshape(-1, directions.shape[1])
        blocks = np.arange(len(chosen)) * min(_BLOCKS * network.d, len(chosen)) // len(chosen)
        covariance = directions @ _sandwich(J.T @ J, scores, blocks) @ directions.T
    return x, losses, covariance


def _fit(unknowns: Unknowns, equations: Equations, x: np.ndarray,
         errors: Callable[[Solutions], torch.Tensor]
         ) -> tuple[np.ndarray, np.ndarray, OptimizeResult | None]:
    """Return the best x along the directions determined at x, these directions, and the fit."""
    known = _information(unknowns, equations, x)
    directions, others = _directions(unknowns, known.excited), unknowns.free[len(known.held):]
    least = np.full(directions.shape[1], -np.inf)
    least[known.excited.shape[1]:] = unknowns.least[others] - x[others]
    found = fit_errors(
        unknowns.network,
        lambda z: unknowns.raw(
            (torch.tensor(x) + torch.tensor(directions) @ z) * torch.tensor(unknowns.scale)),
        np.zeros(len(least)), least, errors)
    return (x if found is None else x + directions @ found.x), directions, found


def _directions(unknowns: Unknowns, inertial: np.ndarray) -> np.ndarray:
    """Extend directions of the inertial part of x by all directions of friction."""
    free, (rows, count) = unknowns.free, inertial.shape
    found = np.zeros((len(unknowns.start), count + len(free) - rows))
    found[free[:rows], :count] = inertial
    found[free[rows:], count:] = np.eye(len(free) - rows)
    return found


def _covariance(unknowns: Unknowns, equations: Equations, known: Information, x: np.ndarray
                ) -> np.ndarray:
    """Return the covariance of x from residuals; zero along directions without effect."""
    directions = _directions(unknowns, known.felt)
    J = equations.matrix @ (unknowns.slopes(x) @ directions)
    scores = np.einsum('nd,ndk->nk', _residuals(unknowns, equations, x), J)
    rows = J.reshape(-1, J.shape[2])
    return directions @ _sandwich(rows.T @ rows, scores, equations.blocks) @ directions.T


def _sandwich(gram: np.ndarray, scores: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """
    Return the least-squares covariance from scores (N, k) that are correlated within blocks.

    The factor g / (g - k) for g blocks and k fitted numbers corrects the degrees of freedom;
    scaling by quantiles of Student's t for g - k keeps 1.96 standard errors at 95 %.
    """
    names, k = np.unique(blocks), len(gram)
    sums = np.stack([scores[blocks == name].sum(axis=0) for name in names])
    inverse = np.linalg.pinv(gram, hermitian=True)
    left = max(len(names) - k, 1)
    share = len(names) / left * (student_t.ppf(0.975, left) / norm.ppf(0.975))**2
    return share * inverse @ (sums.T @ sums) @ inverse


def _base_errors(unknowns: Unknowns, known: Information, covariance: np.ndarray, x: np.ndarray
                 ) -> np.ndarray:
    """Return the standard errors of the base parameters, shape (s,)."""
    base = known.base @ unknowns.slopes(x)
    return np.sqrt(np.maximum(np.diag(base @ covariance @ base.T), 0.0))


def _summary(unknowns: Unknowns, known: Information, weak: np.ndarray, covariance: np.ndarray,
             x: np.ndarray) -> Identification:
    """Return the identification summary for the model card."""
    names, units = unknowns.tree.names, [*unknowns.tree.tree.units.values()]
    linear = unknowns.linear(torch.tensor(x)).numpy()
    errors = _base_errors(unknowns, known, covariance, x)
    found = [BaseParameter(
        combination=dict(_factors(names, row)), value=float(row @ linear),
        standard_error=float(error), unit=units[int(np.argmax(row == 1.0))])
        for row, error in zip(known.base, errors, strict=True)]
    return Identification(
        base_parameters=[one for one, poor in zip(found, weak, strict=True) if not poor],
        weak=[one for one, poor in zip(found, weak, strict=True) if poor],
        held=[dict(_factors(names, row)) for row in known.idle], force_error=[])


def _factors(names: Sequence[str], row: np.ndarray) -> Iterator[tuple[str, float]]:
    """Yield names and coefficients of a combination; the one of coefficient 1 comes first."""
    places = np.flatnonzero(row[:len(names)]).tolist()
    for place in sorted(places, key=lambda place: (row[place] != 1.0, place)):
        yield names[place], float(row[place])
