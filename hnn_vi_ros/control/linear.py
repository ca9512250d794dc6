# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Equilibria of scenes with commands, linear models there, and their optimal regulators."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import checked_weights
from hnn_vi_ros.errors import listed, optional, StateError
from hnn_vi_ros.hamiltonians import momenta
from hnn_vi_ros.phase_space import angle_columns, columns, momentum_name
from hnn_vi_ros.scene import Scene
import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

_ITERATIONS = 50
# Changes of the state, relative to its scale, at which the search ends; what may be left of the
# velocities and the forces, relative to theirs.
_SETTLED, _LEFT = 1e-12, 1e-10

# A scene, or steps of one that are made already.
Model = BatchStep | Scene | str | Path


def _steps(scene: Model, hold: int = 1) -> BatchStep:
    return scene if isinstance(scene, BatchStep) else BatchStep(scene, hold)


def momentum(scene: Model, q: ArrayLike, v: ArrayLike) -> np.ndarray:
    """
    Return the momenta that belong to velocities.

    Parameters
    ----------
    scene : BatchStep, Scene, str or Path
        See BatchStep.
    q, v : array_like, shape (..., d)
        Coordinates and velocities.

    Raises
    ------
    StateError
        A velocity has no momentum.

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

    By Newton's method, with rows and columns in scales of the scene itself: at rest, no coordinate
    moves in a step by 1e-10 of its scale, and no force differs from zero by more than 1e-10 of its
    terms. The scale of an angle is 1 rad, that of other coordinates the largest of ``near``.

    Parameters
    ----------
    scene : BatchStep, Scene, str or Path
        See BatchStep. Forces act as at t = 0.
    near : array_like, shape (d,)
        Coordinates to begin at.
    free : sequence of str, optional
        Names of the coordinates that may change; all by default.
    commands : bool, optional
        Whether commands may hold the state: they are zero otherwise.

    Raises
    ------
    StateError
        None is found from there.
    ValueError
        No coordinate has such a name, or ``near`` is not d finite numbers.

    """
    steps = _steps(scene)
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
    for _ in range(_ITERATIONS):
        field, matrix, rows, columns = _scaled(steps, x, begin)
        if not (np.isfinite(field).all() and np.isfinite(matrix).all()):
            break
        # The smallest change of all that solves the linear equations.
        change = np.linalg.lstsq(matrix[:, moves], -field, rcond=None)[0]
        x[moves] += columns[moves] * change
        if not np.abs(change).max(initial=0.0) > _SETTLED:
            break
        # Coordinates have no scale at zero; the first change gives them one.
        begin = begin if begin.any() else x[:d].copy()
    field, _, rows, _ = _scaled(steps, x, begin)
    if not (np.abs(field) <= _LEFT).all():
        raise StateError(f'no equilibrium is found from q = {q.tolist()}: at {x[:d].tolist()} '
                         f"z' is still {(rows * field).tolist()}; begin elsewhere, or free more")
    return x[:2 * d], x[2 * d:]


def _scaled(steps: BatchStep, x: np.ndarray, begin: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return z' at (z, u) and its derivatives by both in scales, and these of rows and columns."""
    d = steps.dimension
    z, u, angles = x[:2 * d], x[2 * d:], angle_columns(steps.hamiltonian.coordinates)
    field, matrix = steps.field(z, u), np.hstack(steps.field_derivatives(z, u))
    rows, columns = np.ones(2 * d), np.ones(x.size)
    columns[:d] = np.where(angles, 1.0, np.abs(begin[~angles]).max(initial=0.0) or 1.0)
    rows[:d] = columns[:d] * steps.hold / steps.duration
    columns[d:2 * d] = _inverse((np.abs(matrix[:d, d:2 * d]) / rows[:d, None]).max(axis=0))
    # The terms of each force: at the scale of each coordinate, of H alone, and of commands.
    terms = np.abs(matrix[d:]) * np.r_[columns[:d], np.abs(x[d:])]
    alone = getattr(steps.hamiltonian, 'base', steps.hamiltonian).gradient(z[:d], z[d:])[0]
    rows[d:] = _inverse(_inverse(np.maximum.reduce([
        *terms.T, np.abs(field[d:]), np.abs(alone)])))
    columns[2 * d:] = _inverse((np.abs(matrix[:, 2 * d:]) / rows[:, None]).max(axis=0))
    return field / rows, matrix * columns / rows[:, None], rows, columns


def _inverse(scales: np.ndarray) -> np.ndarray:
    """Return one over each scale; 1 for those that are zero."""
    return 1.0 / np.where(scales > 0.0, scales, 1.0)


def linearise(scene: Model, at: tuple[ArrayLike, ArrayLike], hold: int | None = None
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return A, shape (2 d, 2 d), and B, shape (2 d, c), of small deviations.

    Parameters
    ----------
    scene : BatchStep, Scene, str or Path
        See BatchStep.
    at : tuple of array_like
        State and command; see ``find_equilibrium``.
    hold : int, optional
        For the map of the scene's method over so many steps, under a held command, not for z'.

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
        raise StateError(f'no finite derivatives at z, u = {np.array(at[0]).tolist()}, '
                         f'{np.array(at[1]).tolist()}; linearise elsewhere')
    return found


def state_space(scene: Model, at: tuple[ArrayLike, ArrayLike], hold: int | None = None) -> Any:
    """
    Return the linear model as a ``control.StateSpace`` of python-control, with all states out.

    Parameters
    ----------
    scene, at, hold
        See ``linearise``; with ``hold`` it is a model in discrete time.

    Raises
    ------
    MissingPackage
        python-control is not installed.

    """
    with optional('control', 'state_space'):
        # A folder of the name `control` on the path is no such module.
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
    Optimal regulator of a linear model: u = -K z, whose cost from z on is z . P z.

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
    Return the regulator that makes the integral, or sum, of z . Q z + u . R u the least.

    Parameters
    ----------
    a, b : np.ndarray
        From ``linearise``.
    q, r : array_like, shape (n, n) and (c, c)
        Q and R.
    discrete : bool, optional
        Whether a and b are those of a map.

    Raises
    ------
    ValueError
        Commands cannot stabilise the model, or Q is not symmetric without negative eigenvalues,
        or R not with positive ones.

    """
    states, inputs = b.shape
    weights = checked_weights('q', q, states), checked_weights('r', r, inputs, positive=True)
    solve = linalg.solve_discrete_are if discrete else linalg.solve_continuous_are
    try:
        cost = solve(a, b, *weights)
    except np.linalg.LinAlgError as problem:
        raise ValueError(f'no regulator stabilises this model: {problem}') from problem
    if discrete:
        gain = np.linalg.solve(weights[1] + b.T @ cost @ b, b.T @ cost @ a)
    else:
        gain = np.linalg.solve(weights[1], b.T @ cost)
    # The discrete equations have solutions also where commands have no influence.
    poles = np.linalg.eigvals(a - b @ gain)
    if not ((np.abs(poles) < 1.0) if discrete else (poles.real < 0.0)).all():
        raise ValueError('no regulator stabilises this model: the poles of what is found are '
                         f'{poles.round(6).tolist()}')
    return Gain(gain, cost)
