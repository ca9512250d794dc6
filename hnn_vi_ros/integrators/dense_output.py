# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Dense output: polynomials that interpolate between the ends of a step."""

from typing import Any

from hnn_vi_ros.kernels import called, inlined
import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import ArrayLike

_Value = float | np.ndarray
# Ends of the parts of a step of one part, in fractions of the step.
WHOLE = np.array([0.0, 1.0])


@inlined
def cubic(h: _Value, x0: _Value, v0: _Value, x1: _Value, v1: _Value) -> tuple[Any, ...]:
    """
    Return the coefficients of the cubic Hermite polynomial in theta = t / h, constant first.

    Its error is h^4 max abs(x'''') / 384.

    Parameters
    ----------
    h : float or np.ndarray
        Length of the step [s].
    x0, v0, x1, v1 : float or np.ndarray of one shape
        Value and slope [1/s] at t = 0 and at t = h.

    """
    rise, first, last = x1 - x0, h * v0, h * v1
    return x0, first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise, 0.0, 0.0


@inlined
def quintic(h: _Value, x0: _Value, v0: _Value, a0: _Value, x1: _Value, v1: _Value, a1: _Value
            ) -> tuple[Any, ...]:
    """
    Return the coefficients of the quintic Hermite polynomial in theta = t / h, constant first.

    Its error is h^6 max abs(x^(6)) / 46080.

    Parameters
    ----------
    h : float or np.ndarray
        Length of the step [s].
    x0, v0, a0, x1, v1, a1 : float or np.ndarray of one shape
        Value, slope [1/s] and second derivative [1/s^2] at t = 0 and at t = h.

    """
    rise, first, last = x1 - x0, h * v0, h * v1
    bend, bent = h * h * a0, h * h * a1
    return (x0, first, 0.5 * bend,
            10.0 * rise - 6.0 * first - 4.0 * last - 1.5 * bend + 0.5 * bent,
            -15.0 * rise + 8.0 * first + 7.0 * last + 1.5 * bend - bent,
            6.0 * rise - 3.0 * (first + last) + 0.5 * (bent - bend))


@called
def value_at(c: tuple[float, ...], x: float) -> float:
    """Return the value of a quintic polynomial with these six coefficients."""
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))


@called
def slope_at(c: tuple[float, ...], x: float) -> float:
    """Return the derivative of the polynomial."""
    return c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + x * (4.0 * c[4] + x * 5.0 * c[5])))


@called
def bend_at(c: tuple[float, ...], x: float) -> float:
    """Return the second derivative of the polynomial."""
    return 2.0 * c[2] + x * (6.0 * c[3] + x * (12.0 * c[4] + x * 20.0 * c[5]))


class DenseOutput:
    """
    A polynomial in time for the whole state, through one step or through each part of it.

    Parameters
    ----------
    order : int
        m: the error is O(h^(m + 1)) anywhere in the step, in addition to the error of its ends.
    coefficients : np.ndarray, shape (j, k, n)
        Coefficients of (q, p) in k parts, in powers of theta = t / h of each part, or in Legendre
        polynomials of 2 theta - 1.
    momenta : int
        Index of the first column of p.
    ends : np.ndarray, shape (k + 1,)
        Ends of the parts, in fractions of the step.
    in_legendre : bool
        True for Legendre polynomials; high powers of theta would lose digits.

    """

    def __init__(self, order: int, coefficients: np.ndarray, momenta: int,
                 ends: np.ndarray = WHOLE, in_legendre: bool = False):
        self.order, self._coefficients, self._momenta = order, coefficients, momenta
        self.ends, self._in_legendre = ends, in_legendre

    def __call__(self, theta: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """
        Return q and p at times in the step.

        Parameters
        ----------
        theta : array_like, shape () or (k,)
            Times in fractions of the step, from 0 to 1.

        Returns
        -------
        tuple of np.ndarray, shape (n,) or (k, n)
            q and p.

        """
        share = np.asarray(theta, dtype=np.float64)
        part: int | np.ndarray = 0
        if self.ends is not WHOLE:
            part = np.clip(np.searchsorted(self.ends, share, 'right') - 1, 0, self.ends.size - 2)
            share = (share - self.ends[part]) / (self.ends[part + 1] - self.ends[part])
        share, coefficients = share[..., None], self._coefficients[:, part]
        z: np.ndarray = (legendre.legval(2.0 * share - 1.0, coefficients, tensor=False)
                         if self._in_legendre else
                         polynomial.polyval(share, coefficients, tensor=False))
        return z[..., :self._momenta], z[..., self._momenta:]


def hermite_output(h: float, momenta: int, z: np.ndarray, v: np.ndarray,
                   a: np.ndarray | None = None, ends: np.ndarray = WHOLE) -> DenseOutput:
    """
    Return Hermite polynomials of a step: quintic if second derivatives are given, else cubic.

    Parameters
    ----------
    h : float
        Length of the step [s].
    momenta, ends
        See DenseOutput.
    z, v, a : np.ndarray, shape (k + 1, n)
        (q, p), and its first and second derivatives, at the ends of all parts.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.6.

    """
    parts = h * np.diff(ends)[:, None]
    if a is None:
        coefficients = cubic(parts, z[:-1], v[:-1], z[1:], v[1:])[:4]
        return DenseOutput(3, np.array(coefficients), momenta, ends)
    coefficients = quintic(parts, z[:-1], v[:-1], a[:-1], z[1:], v[1:], a[1:])
    return DenseOutput(5, np.array(coefficients), momenta, ends)


def collocation_output(h: float, z0: np.ndarray, slopes: np.ndarray) -> DenseOutput:
    """
    Return the collocation polynomial of a step of a Gauss method of s stages, of degree s.

    It passes through z0, and its derivative at each node is the slope of that stage. Its order is
    s anywhere in the step, and 2 s, the order of the method, only at its end.

    Parameters
    ----------
    h : float
        Length of the step [s].
    z0 : np.ndarray, shape (2 n,)
        (q, p) at its start.
    slopes : np.ndarray, shape (s, 2 n)
        (q', p') at the stages.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section II.1.2.

    """
    stages = len(slopes)
    nodes, weights = legendre.leggauss(stages)
    # The derivative has degree s - 1: Gauss quadrature gives its Legendre coefficients exactly.
    basis = legendre.legvander(nodes, stages - 1) * (np.arange(stages) + 0.5)
    derivative = np.einsum('j,jk,jn->kn', weights, basis, slopes)
    path = legendre.legint(derivative, lbnd=-1.0, scl=0.5 * h)
    path[0] += z0
    return DenseOutput(stages, path[:, None], z0.size // 2, in_legendre=True)
