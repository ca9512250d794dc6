# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What every integrator offers, and what a step works on."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.marks import is_own
import numpy as np

# Outcomes of one step, as numbers that compiled code can return.
OK, NO_CONVERGENCE, NOT_FINITE, BEYOND, NO_MASS, REDUNDANT, IN_DOUBT, NO_SOLUTION = range(8)
REASONS = {NO_CONVERGENCE: 'no convergence', NOT_FINITE: 'not finite',
           BEYOND: 'beyond the limit of stability',
           NO_MASS: 'H_pp is not positive definite, so that there are no masses',
           REDUNDANT: 'it depends on the constraints before it; leave it out',
           NO_SOLUTION: 'no solution is connected to h = 0'}
# What may be done about a step that fails; see Rescue.
ON_FAILURE = ('substep', 'implicit', 'stop')


# The step of a method, with the outcome, the residual and the evaluations; see Integrator.step.
Step = Callable[..., tuple[int, float, int]]
# Unknowns of an equation up to which Newton's method can have a Jacobian, and up to which it takes
# less time with one than without; and the vectors that it keeps without.
LARGEST_MATRIX, FAST_MATRIX, KRYLOV_DIMENSION = 512, 128, 30


class Point(NamedTuple):
    """
    A state, of one trajectory or of several one after another, each array of shape (n,).

    Parameters
    ----------
    q, p : np.ndarray
        Coordinates and momenta.
    q_carry, p_carry : np.ndarray
        What compensated summation has rounded off them so far.
    dH_dq, dH_dp : np.ndarray
        The gradient of H at (q, p), where the method keeps it.

    """

    q: np.ndarray
    p: np.ndarray
    q_carry: np.ndarray
    p_carry: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray

    @classmethod
    def empty(cls, n: int) -> 'Point':
        """Return a point of n zeros in each array."""
        return cls(*np.zeros((6, n)))


class Memory(NamedTuple):
    """
    What one implicit equation of N unknowns keeps between steps, and its working space.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        How many earlier solutions ``increments`` holds.
    slow_start : np.ndarray, shape (1,)
        1 if the first iteration of the last solve did not halve its residual, else 0.
    increments : np.ndarray, shape (3, N)
        Earlier solutions less their starting points, the newest first.
    scale, own_scale : np.ndarray, shape (N,)
        Sizes to which residuals are relative: of the largest unknown of its kind, and its own.
    unknowns, base : np.ndarray, shape (N,)
        For methods whose unknowns or starting point are not arrays of the new point.
    accepted : np.ndarray, shape (N,)
        The last iterate that was good enough.
    newton : np.ndarray, shape (N,)
        A Newton step.
    values, residuals, basis : np.ndarray, shape (4, N)
        The last evaluations of the fixed-point map and their residuals, by Anderson's method.
    triangle : np.ndarray, shape (4, 4)
        The small least-squares problem of Anderson's method.
    matrix : np.ndarray, shape (N, N) or (0, 0)
        The factors of the Jacobian of Newton's method; empty where N is too large for one.
    directions : np.ndarray, shape (m + 1, N) or (0, 0)
        The Krylov space of Newton's method without a Jacobian; empty where N is small.
    hessenberg, rotations : np.ndarray, shape (m + 1, m), (3, m + 1)
        Its small least-squares problem: the matrix; cosines, sines and the right-hand side.
    pivots : np.ndarray, shape (N,) or (0,)
        The rows that were exchanged to factorise the Jacobian.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    slow_start: np.ndarray
    increments: np.ndarray
    scale: np.ndarray
    own_scale: np.ndarray
    unknowns: np.ndarray
    base: np.ndarray
    accepted: np.ndarray
    newton: np.ndarray
    values: np.ndarray
    residuals: np.ndarray
    basis: np.ndarray
    triangle: np.ndarray
    matrix: np.ndarray
    directions: np.ndarray
    hessenberg: np.ndarray
    rotations: np.ndarray
    pivots: np.ndarray

    @classmethod
    def empty(cls, n: int, largest_matrix: int = LARGEST_MATRIX, dtype: type = np.float64
              ) -> 'Memory':
        """Return the memory of an equation of n unknowns before its first solution."""
        side = n if n <= largest_matrix else 0
        m = KRYLOV_DIMENSION if n > min(FAST_MATRIX, largest_matrix) else 0
        shapes = [(3, n), *[(n,)] * 6, *[(4, n)] * 3, (4, 4), (side, side),
                  (m + 1, n) if m else (0, 0), (m + 1, m), (3, m + 1)]
        return cls(*np.zeros((2, 1), dtype=np.int64),  # type: ignore[call-arg]
                   *[np.zeros(shape, dtype) for shape in shapes], np.zeros(side, dtype=np.int64))


class Integrator(ABC):
    """
    A one-step map of (q, p) for Hamilton's equations.

    Attributes
    ----------
    order : int
        Order of convergence on smooth problems.
    requirements : Requirements
        What the method needs of a system, and what it keeps.
    explicit : bool
        Whether a step solves no equation.
    keeps_gradient : bool
        True if a step leaves the gradient at the new state, for nothing more.
    halves : tuple of callable or None
        Two steps of h / 2 that make up the step, if it has a middle to put something in.
    no_solution : str
        What it means that no solution of the step's equation is connected to h = 0; '' where the
        one that solvers find is taken.
    compiled : bool
        False if a step calls what numba cannot compile.
    step : callable
        ``step(kernel, h, options, z, z1, memory)`` maps the point z to z1 and returns
        ``(outcome, residual, gradients)``; it never changes z. ``memory`` is a tuple of Memory,
        one for each implicit equation. It is plain Python in numba's subset, run compiled or as
        it stands.

    """

    order: int
    explicit: bool
    requirements: Requirements
    keeps_gradient: ClassVar[bool] = False
    compiled: bool = True
    no_solution: str = ''
    halves: 'tuple[Callable, Callable] | None' = None
    step: Callable

    def check(self, hamiltonian: Hamiltonian) -> None:  # noqa: B027
        """
        Refuse a Hamiltonian for another reason than those of the requirements; see check_method.

        Raises
        ------
        UnsupportedSystem
            The method does not apply; the message says what would.

        """

    @property
    def kernel_name(self) -> str:
        """Return a name that tells the step from every other one."""
        return type(self).__name__

    @property
    def own(self) -> bool:
        """Return whether all of the step is this package's, whose changes are noticed."""
        return is_own(type(self).__module__)

    def links(self, n: int) -> tuple[int, ...]:
        """Return the ways there are to take one step of n coordinates, the cheapest first."""
        return (0,)

    @property
    def usual_gradients(self) -> int:
        """Return how many gradients a step takes at most as a rule; 0 where there is no rule."""
        return 0

    @abstractmethod
    def options(self, link: int = 0, dimension: int = 1) -> tuple:
        """
        Return what ``step`` takes as its options: numbers, arrays and solvers.

        Parameters
        ----------
        link : int
            Which of the ways to take a step, from 0.
        dimension : int
            The number d of degrees of freedom of the Hamiltonian.

        """

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the number of unknowns of each implicit equation, for n coordinates."""
        return ()

    def memory(self, n: int) -> tuple[Memory, ...]:
        """Return the memory of each implicit equation, for n coordinates."""
        return tuple(Memory.empty(unknowns) for unknowns in self.unknowns(n))

    def substep(self) -> 'Integrator | None':
        """Return the symmetric method of which a failed step is made anew, None for no such."""
        return None

    @staticmethod
    def modified_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                        energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray
                        ) -> np.ndarray | None:
        """
        Return the energy that the map nearly conserves [J], or None if there is none known.

        Its band is O(h^(2 order)).

        Parameters
        ----------
        hamiltonian : Hamiltonian
            H.
        h : float
            Step size [s].
        q, p : np.ndarray, shape (..., d)
            States.
        energy : np.ndarray, shape (...)
            H there [J].
        dH_dq, dH_dp : np.ndarray, shape (..., d)
            Gradient of H there.

        """
        return None
