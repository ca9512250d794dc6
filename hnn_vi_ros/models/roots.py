# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled functions of a lower triangular L whose entries are the outputs y of a network.

With u of shape (k,) and w = L^T u, the derivative of |w|^2 / 2 by y at constant u is u_i w_j
L_ij'(y). A momentum whose inverse mass has such a root,

    H = u . (L L^T + floor) u / 2 + V(z),    u = S pi,    z = (x, pi),    L = L(x),

has v = S (L w + floor u) + V_pi, and H_x = V_x + sum_ij u_i w_j (L_ij)_x.
"""

from typing import NamedTuple

from hnn_vi_ros.kernels import part
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.perceptron_memory import PackedPerceptron
from hnn_vi_ros.models.outputs import (
    evaluate_outputs, output_tangents, PackedOutputs, part_gradient, weigh)
import numpy as np


class RootWork(NamedTuple):
    """
    Workspace for one state; names ending in ``_v`` are changes along a direction.

    Parameters
    ----------
    z, z_v, c, c_v, m, m_v : np.ndarray, shape (n,)
        (x, pi), the inputs of the networks; the derivative of H by it; and the derivative of only
        the network of L.
    y, y_v, a, a_v : np.ndarray, shape (e,)
        The entries of L, as outputs of the network, and the derivative of H by them.
    L, L_v : np.ndarray, shape (k, k)
        L.
    u, u_v, w, w_v, v, v_v : np.ndarray, shape (k,)
        u = S pi, w = L^T u, and the velocity.

    """

    z: np.ndarray
    z_v: np.ndarray
    c: np.ndarray
    c_v: np.ndarray
    m: np.ndarray
    m_v: np.ndarray
    y: np.ndarray
    y_v: np.ndarray
    a: np.ndarray
    a_v: np.ndarray
    L: np.ndarray
    L_v: np.ndarray
    u: np.ndarray
    u_v: np.ndarray
    w: np.ndarray
    w_v: np.ndarray
    v: np.ndarray
    v_v: np.ndarray

    @classmethod
    def empty(cls, n: int, entries: int, k: int) -> 'RootWork':
        """Return workspace for z of shape (n,), this number of entries, and pi of shape (k,)."""
        return cls(*np.zeros((6, n)), *np.zeros((4, entries)), *np.zeros((2, k, k)),
                   *np.zeros((6, k)))


class RootParameters(NamedTuple):
    """
    Parameters of the functions of such a momentum, their first argument.

    Parameters
    ----------
    mass : PackedOutputs
        The network of y.
    potential : PackedPerceptron
        The network of V.
    places : np.ndarray of int, shape (e, 2)
        Row and column of each entry in L.
    scale : np.ndarray, shape (k,)
        The diagonal of S.
    floor : float
        Constant added to the diagonal of L L^T.
    positive : bool
        True if the diagonal of L is log(1 + exp(y)), False if it is y.
    work : RootWork
        Workspace.

    """

    mass: PackedOutputs
    potential: PackedPerceptron
    places: np.ndarray
    scale: np.ndarray
    floor: float
    positive: bool
    work: RootWork


@part(error_model='numpy')
def energy(parameters: RootParameters) -> float:
    """Return H at z."""
    work = parameters.work
    _fill_root(parameters)
    half = work.z.size // 2
    energy = perceptron.energy(parameters.potential, work.z[:half], work.z[half:])
    for i in range(work.u.size):
        energy += 0.5 * (work.w[i] * work.w[i] + parameters.floor * work.u[i] * work.u[i])
    return energy


@part(error_model='numpy')
def first_order(parameters: RootParameters) -> None:
    """Fill the derivative c of H by x, and the velocities v, at z."""
    work, scale = parameters.work, parameters.scale
    z, c, m, L, u, w, v = work.z, work.c, work.m, work.L, work.u, work.w, work.v
    half, first = z.size // 2, z.size - v.size
    _fill_root(parameters)
    weigh_entries(parameters.places, parameters.positive, work.y, u, w, work.a)
    weigh(parameters.mass, work.a)
    part_gradient(parameters.mass.network, z[:half], z[half:], m[:half], m[half:])
    part_gradient(parameters.potential, z[:half], z[half:], c[:half], c[half:])
    for i in range(first):
        c[i] += m[i]
    for i in range(v.size):
        v[i] = parameters.floor * u[i]
        for j in range(i + 1):
            v[i] += L[i, j] * w[j]
        v[i] = scale[i] * v[i] + c[first + i]


@part(error_model='numpy')
def second_order(parameters: RootParameters) -> None:
    """Fill the changes of c and of v along z_v; call first_order first."""
    work, places, scale = parameters.work, parameters.places, parameters.scale
    z, z_v, c_v, m, m_v = work.z, work.z_v, work.c_v, work.m, work.m_v
    L, L_v = work.L, work.L_v
    u, u_v, w, w_v, v_v = work.u, work.u_v, work.w, work.w_v, work.v_v
    half, first = z.size // 2, z.size - v_v.size
    perceptron.hessian_vector(parameters.mass.network, z[:half], z[half:], z_v[:half],
                              z_v[half:], m_v[:half], m_v[half:])
    output_tangents(parameters.mass, work.y_v)
    turn_root(places, parameters.positive, work.y, work.y_v, L_v)
    for i in range(u.size):
        u_v[i] = scale[i] * z_v[first + i]
    for j in range(u.size):
        w_v[j] = 0.0
        for i in range(j, u.size):
            w_v[j] += L_v[i, j] * u[i] + L[i, j] * u_v[i]
    weigh_entry_changes(places, parameters.positive, work.y, work.y_v, u, u_v, w, w_v, work.a_v)
    weigh(parameters.mass, work.a_v)
    part_gradient(parameters.mass.network, z[:half], z[half:], m[:half], m[half:])
    perceptron.hessian_vector(parameters.potential, z[:half], z[half:], z_v[:half], z_v[half:],
                              c_v[:half], c_v[half:])
    for i in range(first):
        c_v[i] += m[i] + m_v[i]
    for i in range(v_v.size):
        v_v[i] = parameters.floor * u_v[i]
        for j in range(i + 1):
            v_v[i] += L_v[i, j] * w[j] + L[i, j] * w_v[j]
        v_v[i] = scale[i] * v_v[i] + c_v[first + i]


@part(error_model='numpy')
def _fill_root(parameters: RootParameters) -> None:
    """Fill y and L at z, and u and w."""
    work, z, u = parameters.work, parameters.work.z, parameters.work.u
    half, first = z.size // 2, z.size - u.size
    evaluate_root(parameters.mass, parameters.places, parameters.positive, z[:half], z[half:],
                  work.y, work.L)
    for i in range(u.size):
        u[i] = parameters.scale[i] * z[first + i]
    transposed_product(work.L, u, work.w)


@part(error_model='numpy')
def evaluate_root(outputs: PackedOutputs, places: np.ndarray, positive: bool, q: np.ndarray,
                  p: np.ndarray, y: np.ndarray, L: np.ndarray) -> None:
    """Fill y and L at the two halves of the network's inputs."""
    evaluate_outputs(outputs, q, p, y)
    for k in range(y.size):
        i, j = places[k]
        L[i, j] = y[k]
        if i == j and positive:
            # log(1 + exp(y)) without overflow.
            L[i, j] = max(y[k], 0.0) + np.log1p(np.exp(-abs(y[k])))


@part(error_model='numpy')
def transposed_product(L: np.ndarray, u: np.ndarray, w: np.ndarray) -> None:
    """Fill w = L^T u."""
    for j in range(u.size):
        w[j] = 0.0
        for i in range(j, u.size):
            w[j] += L[i, j] * u[i]


@part(error_model='numpy')
def weigh_entries(places: np.ndarray, positive: bool, y: np.ndarray, u: np.ndarray,
                  w: np.ndarray, c: np.ndarray) -> None:
    """Fill c = u_i w_j L_ij'(y)."""
    for k in range(y.size):
        i, j = places[k]
        c[k] = u[i] * w[j]
        if i == j and positive:
            c[k] *= _slope(y[k])


@part(error_model='numpy')
def turn_root(places: np.ndarray, positive: bool, y: np.ndarray, y_v: np.ndarray,
              L_v: np.ndarray) -> None:
    """Fill the change of L."""
    for k in range(y.size):
        i, j = places[k]
        L_v[i, j] = y_v[k] * _slope(y[k]) if i == j and positive else y_v[k]


@part(error_model='numpy')
def weigh_entry_changes(places: np.ndarray, positive: bool, y: np.ndarray, y_v: np.ndarray,
                        u: np.ndarray, u_v: np.ndarray, w: np.ndarray, w_v: np.ndarray,
                        c_v: np.ndarray) -> None:
    """Fill the change of the result of weigh_entries."""
    for k in range(y.size):
        i, j = places[k]
        c_v[k] = u_v[i] * w[j] + u[i] * w_v[j]
        if i == j and positive:
            rise = _slope(y[k])
            c_v[k] = c_v[k] * rise + u[i] * w[j] * rise * (1.0 - rise) * y_v[k]


@part(error_model='numpy')
def _slope(y: float) -> float:
    """Return the derivative of log(1 + exp(y))."""
    return 1.0 / (1.0 + np.exp(-y))
