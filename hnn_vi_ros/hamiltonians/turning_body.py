# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The functions of a rigid body that turns about a point, in a uniform field or in none."""

from collections.abc import Sequence

from hnn_vi_ros.hamiltonians.base import compiled_kernel
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# Moments of inertia I1, I2, I3 [kg m^2], and m g l [N m], the centre of mass on the third axis.
_Parameters = tuple[float, float, float, float]
# Columns of an attitude, in q and in p.
_COLUMNS = 4


def check_inertia(inertia: Sequence[float]) -> None:
    """Raise ValueError unless these are moments of inertia of a body, about principal axes."""
    if len(inertia) != 3:
        raise ValueError(f'inertia has {len(inertia)} values, expected 3, about principal axes')
    check_positive(**{f'inertia[{i}]': value for i, value in enumerate(inertia)})
    if 2.0 * max(inertia) > sum(inertia) * (1.0 + 1e-12):
        raise ValueError(f'inertia = {list(inertia)}: no body has a moment of inertia larger than '
                         'the sum of the other two')


def spatial_momentum(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return R p of shape (..., 3), for quaternions (x, y, z, w) and p in the body's frame."""
    vector, scalar = q[..., :3], q[..., 3:4]
    twice = 2.0 * np.cross(vector, p)
    return p + scalar * twice + np.cross(vector, twice)


def turning_body_kernel(inertia: Sequence[float], moment: float) -> Kernel:
    """
    Return H = sum of p_i^2 / (2 I_i) + m g l e_z . R e_3, with p the angular momentum in the body.

    Parameters
    ----------
    inertia : sequence of float
        I1, I2, I3 about the body's axes [kg m^2].
    moment : float
        m g l [N m], with l the place of the centre of mass on the third axis; 0 for no weight.

    """
    parameters = (*(float(value) for value in inertia), float(moment))
    return compiled_kernel((_energy, _gradient, _hessian_vector), parameters, _COLUMNS,
                           rotations=(0,))


def _energy(parameters: _Parameters, q: np.ndarray, p: np.ndarray) -> float:
    I1, I2, I3, moment = parameters
    height = q[3] * q[3] + q[2] * q[2] - q[0] * q[0] - q[1] * q[1]
    return (0.5 * (p[0] * p[0] / I1 + p[1] * p[1] / I2 + p[2] * p[2] / I3) + moment * height)


def _gradient(parameters: _Parameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> None:
    _apply(parameters, q, p, dH_dq, dH_dp)


def _hessian_vector(parameters: _Parameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    _apply(parameters, v_q, v_p, product_q, product_p)


@inlined
def _apply(parameters: _Parameters, q: np.ndarray, p: np.ndarray, at_q: np.ndarray,
           at_p: np.ndarray) -> None:
    """Apply H'', which is constant: H is quadratic in the quaternion and in the momentum."""
    I1, I2, I3, moment = parameters
    for i in range(0, q.size, _COLUMNS):
        at_q[i], at_q[i + 1] = -2.0 * moment * q[i], -2.0 * moment * q[i + 1]
        at_q[i + 2], at_q[i + 3] = 2.0 * moment * q[i + 2], 2.0 * moment * q[i + 3]
        at_p[i], at_p[i + 1], at_p[i + 2] = p[i] / I1, p[i + 1] / I2, p[i + 2] / I3
        at_p[i + 3] = 0.0
