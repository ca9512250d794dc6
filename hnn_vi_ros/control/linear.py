# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Equilibria of scenes with commands, linear models there, and their optimal regulators."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import weight_matrix
from hnn_vi_ros.errors import listed, optional, prefixed, StateError
from hnn_vi_ros.hamiltonians import momenta
from hnn_vi_ros.phase_space import angle_columns, columns, momentum_name
from hnn_vi_ros.scene import Scene
import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

_MAX_ITERATIONS = 50
# Relative change of the state at which the iteration stops; and tolerance of the remaining
# velocities and forces, relative to their scales.
_STEP_TOLERANCE, _RESIDUAL_TOLERANCE = 1e-12, 1e-10

# A scene, or its compiled steps.
Model = BatchStep | Scene | str | Path


def _steps(scene: Model, hold: int = 1) -> BatchStep:
    return scene if isinstance(scene, BatchStep) else BatchStep(scene, hold)


def momentum(scene: Model, q: ArrayLike, v: ArrayLike) -> np.ndarray:
    """
    Return the momenta for given velocities.

    Parameters
    ----------
    scene : BatchStep, Scene, str or Path
        See BatchStep.
    q, v : array_like, shape (..., d)
        Coordinates and velocities.

    Raises
    ------
    StateError
        A velocity has no corresponding momentum.

    """
    q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
    return momenta.momentum(_steps(scene).hamiltonian, q, v, np.zeros_like(v))


def velocity(scene: Model, q: ArrayLike, p: ArrayLike) -> np.ndarray:
    """Return the velocities H_p, shape (..., d), at states; see ``momentum``."""
    q, p = np.asarray(q, dtype=np.float64), np.asarray(p, dtype=np.float64)
    return _steps(scene).hamiltonian.gradient(q, p)[1]


def find_equilibrium(scene: Model, near: ArrayLike, free: Sequence[str] | None = None,
                     commands: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a state at rest, shape (2 d,), and the command that holds it, shape (c,).

    It uses Newton's method, scaled by the scene itself. At the result, no coordinate moves in a
    step by more than 1e-10 of its scale, and no force differs from zero by more than 1e-10 of its
    terms. The scale of an angle is 1 rad, that of other coordinates the largest of ``near``.

    Parameters
    ----------
    scene : BatchStep, Scene, str or Path
        See BatchStep. Forces are evaluated at t = 0.
    near : array_like, shape (d,)
        Initial guess of the coordinates.
    free : sequence of str, optional
        Names of the coordinates that may change; all by default.
    commands : bool, optional
        True to let commands hold the state; otherwise they are zero.

    Raises
    ------
    StateError
        The iteration does not converge from this guess.
    ValueError
        A name is not that of a coordinate, or ``near`` is not d finite numbers.

    """
    steps = _steps(scene).frictionless
    d, names = steps.dimension, [one.name for one in steps.hamiltonian.coordinates]
    chosen = names if free is None else list(free)
    if set(chosen) - set(names):
        raise ValueError(f'free = {chosen} must be among the coordinates: {listed(names)}')
    q, u = np.array(near, dtype=np.float64), np.zeros(steps.commands)
    if q.shape != (d,) or not np.isfinite(q).all():
        raise ValueError(f'near = {q.tolist()!s:.80}: expected {d} finite coordinates: '
                         f'{listed(names)}')
    moves = np.r_[[names.index(name) for name in chosen], d:2 * d].astype(int)
    if commands:
        moves = np.r_[moves, 2 * d:2 * d + u.size]
    x, begin = np.r_[q, momentum(steps, q, np.zeros(d)), u], q
    for _ in range(_MAX_ITERATIONS):
        field, matrix, rows, columns = _scaled(steps, x, begin)
        if not (np.isfinite(field).all() and np.isfinite(matrix).all()):
            break
        # Minimum-norm solution of the linear equations.
        change = np.linalg.lstsq(matrix[:, moves], -field, rcond=None)[0]
        x[moves] += columns[moves] * change
        if not np.abs(change).max(initial=0.0) > _STEP_TOLERANCE:
            break
        # Coordinates at zero have no scale; the first change provides one.
        begin = begin if begin.any() else x[:d].copy()
    field, _, rows, _ = _scaled(steps, x, begin)
    if not (np.abs(field) <= _RESIDUAL_TOLERANCE).all():
        raise StateError(f"no equilibrium was found from q = {q.tolist()}: at {x[:d].tolist()} z' "
                         f'is {(rows * field).tolist()}; start elsewhere, or free more '
                         'coordinates')
    return x[:2 * d], x[2 * d:]


def _scaled(steps: BatchStep, x: np.ndarray, begin: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return scaled z' at (z, u), its scaled Jacobian, and the scales of rows and columns."""
    d = steps.dimension
    z, u, angles = x[:2 * d], x[2 * d:], angle_columns(steps.hamiltonian.coordinates)
    field, matrix = steps.field(z, u), np.hstack(steps.field_derivatives(z, u))
    rows, columns = np.ones(2 * d), np.ones(x.size)
    columns[:d] = np.where(angles, 1.0, np.abs(begin[~angles]).max(initial=0.0) or 1.0)
    rows[:d] = columns[:d] * steps.hold / steps.duration
    columns[d:2 * d] = _inverse((np.abs(matrix[:d, d:2 * d]) / rows[:d, None]).max(axis=0))
    # Terms of each force: due to each coordinate at its scale, to H alone, and to commands.
    terms = np.abs(matrix[d:]) * np.r_[columns[:d], np.abs(x[d:])]
    alone = getattr(steps.hamiltonian, 'base', steps.hamiltonian).gradient(z[:d], z[d:])[0]
    rows[d:] = _inverse(_inverse(np.maximum.reduce([*terms.T, np.abs(field[d:]), np.abs(alone)])))
    columns[2 * d:] = _inverse((np.abs(matrix[:, 2 * d:]) / rows[:, None]).max(axis=0))
    return field / rows, matrix * columns / rows[:, None], rows, columns


def _inverse(scales: np.ndarray) -> np.ndarray:
    """Return the reciprocal of each scale; 1 for zero."""
    return 1.0 / np.where(scales > 0.0, scales, 1.0)


def linearise(scene: Model, at: tuple[ArrayLike, ArrayLike], hold: int | None = None
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return A, shape (2 d, 2 d), and B, shape (2 d, c), of the linearised model.

    Parameters
    ----------
    scene : BatchStep, Scene, str or Path
        See BatchStep.
    at : tuple of array_like
        State and command; see ``find_equilibrium``.
    hold : int, optional
        Linearise the map of this many steps with a held command instead of z'.

    Raises
    ------
    StateError
        A derivative is not finite.

    """
    if hold is None:
        found = _steps(scene).field_derivatives(*at)
    else:
        steps = BatchStep(scene.scene if isinstance(scene, BatchStep) else scene, hold)
        found = steps.derivatives(*at)[1:]
    if not all(np.isfinite(matrix).all() for matrix in found):
        raise StateError(f'derivatives are not finite at z = {np.array(at[0]).tolist()}, u = '
                         f'{np.array(at[1]).tolist()}; linearise elsewhere')
    return found


def state_space(scene: Model, at: tuple[ArrayLike, ArrayLike], hold: int | None = None) -> Any:
    """
    Return the linear model as a ``control.StateSpace`` of python-control; it outputs all states.

    Parameters
    ----------
    scene, at, hold
        See ``linearise``; with ``hold`` the model is discrete in time.

    Raises
    ------
    MissingPackage
        python-control is not installed.

    """
    with optional('control', 'state_space'):
        # A folder named `control` on the path imports as well, but lacks this class.
        from control.statesp import StateSpace
    steps = _steps(scene, hold or 1)
    a, b = linearise(steps, at, hold)
    q, p = columns(steps.hamiltonian.coordinates)
    states = [*q, *map(momentum_name, p)]
    time = 0.0 if hold is None else hold * steps.duration / steps.hold
    return StateSpace(a, b, np.eye(len(states)), np.zeros(b.shape), time, inputs=[
        f'force_{name}' for name in steps.inputs], states=states, outputs=states)


class Gain(NamedTuple):
    """
    Optimal regulator of a linear model: u = -K z, with cost-to-go z^T P z.

    Parameters
    ----------
    gain : np.ndarray, shape (c, n)
        K.
    cost : np.ndarray, shape (n, n)
        P.

    """

    gain: np.ndarray
    cost: np.ndarray


def lqr(a: np.ndarray, b: np.ndarray, q: ArrayLike, r: ArrayLike, discrete: bool = False) -> Gain:
    """
    Return the regulator that minimises the integral, or sum, of z . Q z + u . R u.

    Parameters
    ----------
    a, b : np.ndarray
        Matrices from ``linearise``.
    q, r : array_like, shape (n, n) and (c, c)
        Q and R.
    discrete : bool, optional
        True if a and b describe a discrete map.

    Raises
    ------
    ValueError
        Commands cannot stabilise the model, Q is not symmetric positive semidefinite, or R is not
        symmetric positive definite.

    """
    states, inputs = b.shape
    weights = weight_matrix('q', q, states), weight_matrix('r', r, inputs, positive=True)
    solve = linalg.solve_discrete_are if discrete else linalg.solve_continuous_are
    with prefixed('no regulator stabilises this model', ValueError, np.linalg.LinAlgError):
        cost = solve(a, b, *weights)
    if discrete:
        gain = np.linalg.solve(weights[1] + b.T @ cost @ b, b.T @ cost @ a)
    else:
        gain = np.linalg.solve(weights[1], b.T @ cost)
    # The discrete equation may have a solution although the model cannot be stabilised.
    poles = np.linalg.eigvals(a - b @ gain)
    if not ((np.abs(poles) < 1.0) if discrete else (poles.real < 0.0)).all():
        raise ValueError('no regulator stabilises this model: the closed loop found has the poles '
                         f'{poles.round(6).tolist()}')
    return Gain(gain, cost)
