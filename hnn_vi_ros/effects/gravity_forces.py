# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled forces V'(q) of a model, which motors add to those commanded."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import coordinate_index
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import by_address, kept, name_stably
import numpy as np


class Compensation(NamedTuple):
    """
    Forces of n motors against gravity.

    Parameters
    ----------
    fill : callable
        Fills ``forces``; see fill_gravity.
    model : GravityModel or tuple
        Its first argument; empty without compensation.
    forces : np.ndarray, shape (n,)
        The forces; zero without compensation, or empty.

    """

    fill: Callable[..., None]
    model: Any
    forces: np.ndarray


class GravityModel(NamedTuple):
    """
    A model whose V'(q) = H_q(q, 0) is compensated.

    Parameters
    ----------
    gradient : callable
        Signature of its kernel, see Kernel.
    parameters : tuple
        Its first argument.
    rest : np.ndarray, shape (d,)
        p = 0.
    slopes : np.ndarray, shape (2, d)
        Workspace for H_q and H_p.
    rows : np.ndarray of int64, shape (n,)
        Coordinate that each motor moves.

    """

    gradient: Callable[..., None]
    parameters: Any
    rest: np.ndarray
    slopes: np.ndarray
    rows: np.ndarray


@kept(error_model='numpy')
def fill_gravity(own: GravityModel, q: np.ndarray, forces: np.ndarray) -> None:
    """Fill V'(q) of each motor's coordinate."""
    d = own.rest.size
    own.gradient(own.parameters, q[:d], own.rest, own.slopes[0], own.slopes[1])
    for k in range(forces.size):
        forces[k] = own.slopes[0, own.rows[k]]


@kept(error_model='numpy')
def fill_nothing(own: tuple[()], q: np.ndarray, forces: np.ndarray) -> None:
    """Leave the forces zero."""


for _function in (fill_gravity, fill_nothing):
    # Functions in the parameters of compiled functions need a name; see identify.
    name_stably(_function)


def no_compensation(n: int) -> Compensation:
    """Return forces of n motors that stay zero."""
    return Compensation(fill_nothing, (), np.zeros(n))


def compensation_of(model: Hamiltonian, names: Sequence[str]) -> Compensation:
    """Return the forces of motors on named coordinates."""
    kernel, d = by_address(model.kernel), model.dimension
    rows = [coordinate_index(model.coordinates, name) for name in names]
    own = GravityModel(kernel.gradient, kernel.parameters, np.zeros(d), np.zeros((2, d)),
                       np.array(rows, dtype=np.int64))
    fill: Any = fill_gravity
    return Compensation(fill if kernel.compiled else fill.py_func, own, np.zeros(len(rows)))
