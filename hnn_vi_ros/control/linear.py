# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Equilibria of scenes with commands, linear models there, and their optimal regulators."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.errors import listed, optional, StateError
from hnn_vi_ros.hamiltonians import momenta
from hnn_vi_ros.phase_space import columns, momentum_name
from hnn_vi_ros.scene import Scene
import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

_ITERATIONS, _TOLERANCE = 50, 1e-12

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
        No coordinate has such a name.

    """
    steps = _steps(scene)
    d, names = steps.dimension, [one.name for one in steps.hamiltonian.coordinates]
    chosen = names if free is None else list(free)
    if set(chosen) - set(names):
        raise ValueError(f'free = {chosen} must be among the coordinates: {listed(names)}')
    q, u = np.array(near, dtype=np.float64), np.zeros(steps.commands)
    moves = np.r_[[names.index(name) for name in chosen], d:2 * d].astype(int)
    z = np.append(q, momentum(steps, q, np.zeros(d)))
    for _ in range(_ITERATIONS):
        by_z, by_u = steps.field_derivatives(z, u)
        matrix = np.hstack([by_z[:, moves], by_u]) if commands else by_z[:, moves]
        # The smallest change of all that solves the linear equations.
        change = np.linalg.lstsq(matrix, -steps.field(z, u), rcond=None)[0]
        z[moves] += change[:moves.size]
        u += change[moves.size:] if commands else 0.0
        size = max(1.0, np.abs(z).max(), np.abs(u).max(initial=0.0))
        if np.abs(change).max() <= _TOLERANCE * size:
            break
    scale = np.abs(by_z).max() * max(1.0, np.abs(z).max()) + np.abs(u).max(initial=0.0)
    rest = np.abs(steps.field(z, u)).max()
    if not rest <= 1e-10 * scale:
        raise StateError(f'no equilibrium is found from q = {q.tolist()}: at {z[:d].tolist()} '
                         f"z' is still {rest:.3g}; begin elsewhere, or free more")
    return z, u


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

    """
    if hold is None:
        return _steps(scene).field_derivatives(*at)
    steps = BatchStep(scene.scene if isinstance(scene, BatchStep) else scene, hold)
    _, by_z, by_u = steps.derivatives(*at)
    return by_z, by_u


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
        Commands cannot stabilise the model.

    """
    weights = np.asarray(q, dtype=np.float64), np.asarray(r, dtype=np.float64)
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
