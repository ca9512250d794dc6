# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of Hamiltonians: H and its gradient, for one state, for many, or as a kernel."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Self

from hnn_vi_ros.hamiltonians.rigid_body.loops import Loops
from hnn_vi_ros.hamiltonians.rigid_body.payload import Carrier
from hnn_vi_ros.hamiltonians.rigid_body.robot import Robot
from hnn_vi_ros.kernels import Functions, Kernel, Parameters
from hnn_vi_ros.phase_space import columns, Coordinate, rotations
import numpy as np
from numpy.typing import ArrayLike


Invariant = Callable[[np.ndarray, np.ndarray], float]


class ExactMotion(NamedTuple):
    """
    Exact motion from a formula.

    Parameters
    ----------
    path : np.ndarray, shape (n, 2 d)
        (q, p) at each time.
    condition : float
        Relative error of its period, divided by that of the energy.
    formula : str
        Formula that computes it.

    """

    path: np.ndarray
    condition: float
    formula: str


class Hamiltonian(ABC):
    """
    A function H(q, p) of d coordinates and their momenta, with q' = H_p, p' = -H_q.

    H(q, p, t) is evaluated at the time in ``time``, where the gradient stores H_t.

    With rotations (see Coordinate), d is the number of columns of q, and p has one column less for
    each rotation; H_p contains angular velocities in the frame of the body, and H_q the
    derivatives by each column of a quaternion.

    A subclass defines its coordinates and its kernel, and states whether H(q, p) = T(p) + V(q). If
    (q, p) is not ``canonical`` but another set of 2 d coordinates u, H_p is the first half of u',
    and -H_q the second.

    Attributes
    ----------
    coordinates : tuple of Coordinate
        Names, units and kinds of the coordinates.
    separable, canonical : bool
        True if H(q, p) = T(p) + V(q); True if p are canonical momenta.
    time : np.ndarray, shape (2,), or None
        The time [s] and H_t [W] of the last gradient; None if H does not depend on the time.
    robot : Robot or None
        The robot whose joints are the coordinates, if a URDF describes one.
    loops : Loops or None
        The closed chains of this robot.
    carrier : Carrier or None
        The body of this robot that carries a payload.
    invariants, known_invariants : mapping of str to callable
        Functions of q and p, of shape (d,), by name: those that a scene monitors, and those that
        are conserved besides H in the absence of effects.
    box : pair of np.ndarray, shape (d, 2) each, or None
        Bounds of q and p in which H was trained; None if unlimited.
    smooth : bool
        True if the gradient of H is continuous, which the order of every method requires.
    barrier : tuple of (str, float) or None
        Name and energy [J] of the barrier that confines motions of low energy; None if unknown.
    provenance : dict of str to str
        Identification of the data behind H, for recordings; may be empty.
    scheme : tuple of (str, float) or None
        The method and the step size [s] through which H was trained and with which it is valid.

    """

    coordinates: tuple[Coordinate, ...]
    separable: bool = False
    canonical: ClassVar[bool] = True
    time: np.ndarray | None = None
    robot: Robot | None = None
    loops: Loops | None = None
    carrier: Carrier | None = None
    invariants: Mapping[str, Invariant] = MappingProxyType({})
    known_invariants: Mapping[str, Invariant] = MappingProxyType({})
    box: tuple[np.ndarray, np.ndarray] | None = None
    smooth: bool = True
    barrier: tuple[str, float] | None = None
    provenance: dict[str, str] = {}
    scheme: tuple[str, float] | None = None

    @property
    def gauge(self) -> np.ndarray | None:
        """Return G, shape (d, d), of magnetic fields: M v = p - G q; None without such fields."""
        return None

    def outside(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return True for states (..., d) outside the box or not finite, shape (...)."""
        assert self.box is not None, 'called only if there is a box'
        low, high = np.concatenate(self.box).T
        z = np.concatenate([q, p if self.gauge is None else p - q @ self.gauge.T], axis=-1)
        return np.asarray(~((low <= z) & (z <= high)).all(axis=-1))

    def exact_motion(self, q: np.ndarray, p: np.ndarray, t: np.ndarray) -> ExactMotion | None:
        """
        Return the motion from (q, p) at given times, None if no formula is known.

        Parameters
        ----------
        q, p : np.ndarray, shape (d,)
            Initial state.
        t : np.ndarray, shape (n,)
            Times [s].

        """
        return None

    def check_state(self, q: np.ndarray, p: np.ndarray) -> None:  # noqa: B027
        """Raise ValueError if H is known to be undefined at a state, shape (d,) each."""

    def gravity_model(self, kind: str, file: str | None) -> 'Hamiltonian':
        """
        Return a model whose H_q at p = 0 bears gravity; see ``gravity_compensation`` of effects.

        Raises
        ------
        ValueError
            H has no such model.

        """
        if kind != 'model' or self.rotations or self.time is not None:
            raise ValueError(f'gravity_compensation = {kind!r} needs the H of a URDF; give '
                             'gravity_compensation: model of an H(q, p) with scalar coordinates')
        return self.copy()

    @property
    def dimension(self) -> int:
        """Return the number d of columns of q; without rotations, the degrees of freedom."""
        return len(self.coordinates) if self.rotations == () else len(columns(self.coordinates)[0])

    @cached_property
    def rotations(self) -> tuple[int, ...]:
        """Return the columns of q at which unit quaternions begin."""
        return rotations(self.coordinates)

    @cached_property
    @abstractmethod
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""

    def copy(self) -> Self:
        """Return the same function with its own workspace, for use in another thread."""
        other = copy(self)
        # Cached properties, which the copy computes for itself.
        for name in ('kernel', '_called'):
            vars(other).pop(name, None)
        if self.time is not None:
            other.time = self.time.copy()
        return other

    @cached_property
    def _called(self) -> Kernel:
        """Return the kernel by address, so that Python calls the same code as simulations."""
        # Imported lazily: reading a scene needs no compiler.
        from hnn_vi_ros.kernels import by_address
        return by_address(self.kernel)

    def compile(self) -> None:  # noqa: A003
        """Compile energy, gradient and Hessian-vector product now instead of at the first call."""
        if self._called.compiled:
            from hnn_vi_ros.kernels import provide
            provide(self._called, 0, 1, 2)

    def energy(self, q: np.ndarray, p: np.ndarray, t: ArrayLike = 0.0) -> np.ndarray:
        """
        Return H [J], shape (...), for q and p of shape (..., d), at times broadcast to (...).

        Raises
        ------
        ValueError
            The last axis does not have length d.

        """
        flat_q, flat_p = self._flat(q, self._padded(p))
        found = [self._called.energies(flat_q[part], flat_p[part])
                 for part in self._parts(t, np.shape(q))]
        return np.concatenate(found or [np.empty(0)]).reshape(np.shape(q)[:-1])

    def gradient(self, q: np.ndarray, p: np.ndarray, t: ArrayLike = 0.0
                 ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return (dH/dq, dH/dp), shape (..., d) each, for the arguments of ``energy``.

        Raises
        ------
        ValueError
            The last axis does not have length d.

        """
        flat = np.array(self._flat(q, self._padded(p)))
        dH_dq, dH_dp = np.concatenate([np.empty((2, 0)), *(
            self._called.slopes(*flat[:, part]) for part in self._parts(t, np.shape(q)))], axis=1)
        return dH_dq.reshape(np.shape(q)), self._unpadded(dH_dp.reshape(np.shape(q)))

    def hessian_vector(self, q: np.ndarray, p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray,
                       t: ArrayLike = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """
        Return H'' (v_q, v_p) at (q, p, t), shape (..., d) each, with t as in ``energy``.

        Raises
        ------
        ValueError
            The last axis does not have length d.

        """
        flat = np.array((*self._flat(q, self._padded(p)), *self._flat(v_q, self._padded(v_p))))
        product_q, product_p = np.concatenate([np.empty((2, 0)), *(
            self._called.products(*flat[:, part]) for part in self._parts(t, np.shape(q)))],
            axis=1)
        return product_q.reshape(np.shape(q)), self._unpadded(product_p.reshape(np.shape(q)))

    def inverse_mass(self, q: np.ndarray, p: np.ndarray, t: ArrayLike = 0.0) -> np.ndarray:
        """
        Return H_pp, shape (..., k, k), with a row and a column for each of k momenta.

        Parameters
        ----------
        q, p : np.ndarray, shape (..., d) and (..., k)
            States; k is d without rotations.
        t : array_like, optional
            Their times [s].

        """
        k = p.shape[-1]
        units = np.eye(k).reshape(k, *(p.ndim - 1) * [1], k)
        along_q, along_p = np.zeros((k, *q.shape)), np.broadcast_to(units, (k, *p.shape))
        q, p = (np.broadcast_to(x, (k, *x.shape)) for x in (q, p))
        return np.moveaxis(self.hessian_vector(q, p, along_q, along_p, t)[1], 0, -1)

    def _parts(self, t: ArrayLike, shape: tuple[int, ...]) -> Iterator[slice]:
        """Yield slices of concatenated states, (..., d), after setting the time of each."""
        if self.time is None:
            yield slice(None)
            return
        for k, time in enumerate(np.broadcast_to(t, shape[:-1]).flat):
            self.time[0] = time
            yield slice(k * shape[-1], (k + 1) * shape[-1])

    def _padded(self, p: np.ndarray) -> np.ndarray:
        """Return momenta with the zero columns that kernels expect."""
        if not self.rotations:
            return p
        return np.append(p, np.zeros((*np.shape(p)[:-1], len(self.rotations))), axis=-1)

    def _unpadded(self, p: np.ndarray) -> np.ndarray:
        return p[..., :self.dimension - len(self.rotations)]

    def _flat(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if np.shape(q) != np.shape(p) or np.shape(q)[-1:] != (self.dimension,):
            raise ValueError(f'q and p have shapes {np.shape(q)} and {np.shape(p)}, '
                             f'expected (..., {self.dimension}) for both')
        return (np.ascontiguousarray(q, dtype=np.float64).ravel(),
                np.ascontiguousarray(p, dtype=np.float64).ravel())


# Steps of differences, in the units of the state, whose scale is unknown; and the largest error
# of a slope relative to its terms.
_DIFFERENCES, _SLOPE_ERROR = (1e-5, 1e-8, 1e-11), 1e-3


def slopes_differ(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray) -> bool:
    """
    Return whether the gradient of H differs from differences of H near a state, (d,) each.

    Three states are compared, because H may have a kink at one of them, or be infinite.
    """
    if not hamiltonian.canonical:
        return False
    rng, wrong = np.random.default_rng(0), 0
    for k in (1, 2, 3):
        state = [(1.0 + 0.25 * k) * half + 0.125 * k for half in (q, p)]
        way = [rng.normal(size=half.shape) for half in state]
        terms = np.concatenate([slope * change for slope, change in zip(
            hamiltonian.gradient(*state), way, strict=True)])
        slopes = [float(np.diff([hamiltonian.energy(*(
            half + sign * h * change for half, change in zip(state, way, strict=True)))
            for sign in (-1.0, 1.0)])[0] / (2.0 * h)) for h in _DIFFERENCES]
        wrong += all(abs(slope - terms.sum()) > _SLOPE_ERROR * np.abs(terms).sum()
                     for slope in slopes)
    return wrong > 1


def compiled_kernel(functions: Functions, parameters: Parameters,
                    dimension: int, gradient_scale: tuple[float, float] = (0.0, 0.0),
                    rotations: tuple[int, ...] = ()) -> Kernel:
    """
    Return the kernel of an exact system.

    Parameters
    ----------
    functions : tuple of callable
        Energy, gradient and Hessian-vector product, plain Python in numba's subset, to be
        compiled; see Kernel.
    parameters : tuple
        First argument of the functions.
    dimension : int
        d.
    gradient_scale : tuple of float
        See Kernel.
    rotations : tuple of int
        See Kernel.

    """
    # Imported lazily: reading a scene needs no compiler.
    from hnn_vi_ros.kernels import dispatcher
    energy, gradient, hessian_vector = functions
    return Kernel(dispatcher(energy), dispatcher(gradient), dispatcher(hessian_vector), parameters,
                  dimension, gradient_scale, compiled=True, rotations=rotations)
