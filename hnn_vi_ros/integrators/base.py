# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base of integrators: what a method declares of itself, and the work space of a step."""

from abc import ABC
from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import ClassVar, Literal, NamedTuple

from hnn_vi_ros.errors import ADVICE, listed, StepFailure
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import is_own, Kernel
import numpy as np
from numpy.typing import ArrayLike


class Node(NamedTuple):
    """
    A stage that begins where those before it have ended, by shares of the step size.

    From (x, c), which are q and p before the first node, it finds Q and P, and advances:

        Q = x + a h H_p(Q, P),  P = c - b h H_q(Q, P)
        x <- x + u h H_p(Q, P),  c <- c - w h H_q(Q, P)
    """

    a: float
    b: float
    u: float
    w: float


class PartitionedTableau(NamedTuple):
    """
    The coefficients of a step of s stages Z_i = (Q_i, P_i), one set for q and one for p.

        Q_i = q + h sum_j a_ij H_p(Z_j),  P_i = p - h sum_j A_ij H_q(Z_j)
        q_(n+1) = q + h sum_j b_j H_p(Z_j),  p_(n+1) = p - h sum_j B_j H_q(Z_j)

    Parameters
    ----------
    q_matrix, p_matrix : np.ndarray, shape (s, s)
        a_ij and A_ij.
    q_weights, p_weights : np.ndarray, shape (s,)
        b_j and B_j.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section II.2.

    """

    q_matrix: np.ndarray
    p_matrix: np.ndarray
    q_weights: np.ndarray
    p_weights: np.ndarray

    @property
    def stages(self) -> int:
        """Return s."""
        return self.q_weights.size

    def nodes(self) -> list[Node]:
        """
        Return the stages one after another.

        Raises
        ------
        ValueError
            A stage does not begin where those before it have ended, or depends on later ones.

        """
        for matrix, weights in ((self.q_matrix, self.q_weights), (self.p_matrix, self.p_weights)):
            ended = np.tril(np.tile(weights, (self.stages, 1)), -1)
            if (matrix - np.diag(np.diag(matrix)) != ended).any():
                raise ValueError('the stages cannot be solved one after another')
        return [Node(*map(float, numbers)) for numbers in zip(
            np.diag(self.q_matrix), np.diag(self.p_matrix), self.q_weights, self.p_weights,
            strict=True)]


def tableau(q_matrix: ArrayLike, p_matrix: ArrayLike, q_weights: ArrayLike,
            p_weights: ArrayLike) -> PartitionedTableau:
    """Return a tableau of numbers in lists; see PartitionedTableau."""
    return PartitionedTableau(*(np.array(part, dtype=np.float64) for part in (
        q_matrix, p_matrix, q_weights, p_weights)))


# The stages of a leapfrog are (q_n, p_half) and (q_(n+1), p_half).
LEAPFROG = tableau([[0.0, 0.0], [0.5, 0.5]], [[0.5, 0.0], [0.5, 0.0]], [0.5, 0.5], [0.5, 0.5])


def in_sequence(base: PartitionedTableau, fractions: Sequence[float]) -> PartitionedTableau:
    """Return the tableau of one step made of steps of a base, of these fractions of h."""
    s, count = base.stages, len(fractions)
    matrices, weights = np.zeros((2, count * s, count * s)), np.zeros((2, count * s))
    for k, fraction in enumerate(fractions):
        own, later = slice(k * s, (k + 1) * s), slice((k + 1) * s, None)
        for matrix, weight, base_matrix, base_weight in zip(
                matrices, weights, base[:2], base[2:], strict=True):
            matrix[own, own] = fraction * base_matrix
            # Stages of later parts start from where this part has ended.
            matrix[later, own] = fraction * base_weight
            weight[own] = fraction * base_weight
    return PartitionedTableau(*matrices, *weights)


@dataclass(frozen=True)
class Requirements:
    """
    Needs and claims of a method; every refusal of a system or an effect derives from it.

    Parameters
    ----------
    symmetric, symplectic : bool
        Properties of the map; symplectic in the 2-form that the method's docstring names.
    separable : bool
        Whether it needs H = T(p) + V(q), and forces that do not depend on p.
    coordinates : str
        ``'canonical'`` if it needs (q, p) that are; ``'any'`` if it is as good for a field
        u' = f(u) in any coordinates; ``'other'`` if it is made for those that are not canonical,
        on which no effect acts; ``'group'`` if it is made for those that turn. No other method
        takes such.
    hamiltonian : bool
        False if the map is made of something else than the kernel's H, which no effect can join.
    forces : bool or str
        Whether the map stays right where the kernel's gradient holds forces as well; ``'held'``
        if it does for forces that are the same all through a step, and for one of them.
    from_state : bool
        False if the next step starts elsewhere than at the state that the last one ended in:
        nothing may change that state between them.

    """

    symmetric: bool
    symplectic: bool
    separable: bool = False
    coordinates: Literal['canonical', 'any', 'other', 'group'] = 'canonical'
    hamiltonian: bool = True
    forces: bool | Literal['held'] = True
    from_state: bool = True

    def take_force(self, depends_on_momentum: bool, held: bool = False) -> bool:
        """Return whether the method takes a force at its nodes."""
        takes = held if self.forces == 'held' else self.forces
        return self.hamiltonian and takes and not (depends_on_momentum and self.separable)

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return why a Hamiltonian cannot be integrated, to follow the method's name, or ''."""
        turning = listed(coordinate.name for coordinate in hamiltonian.coordinates
                         if coordinate.kind != 'scalar')
        if turning and self.coordinates != 'group':
            return (f'adds to coordinates, which would take a rotation ({turning}) off its '
                    'group')
        if not turning and self.coordinates == 'group':
            return 'is made for rotations and poses, of which this H has none'
        if not hamiltonian.canonical and self.coordinates == 'canonical':
            names = listed(coordinate.name for coordinate in hamiltonian.coordinates)
            return (f'needs canonical coordinates, which those of this model ({names}) are not: '
                    'its steps, those of eq. (6) too, would keep another 2-form than the one it '
                    'learned')
        if hamiltonian.canonical and self.coordinates == 'other':
            return ('is made for coordinates that are not canonical, those of a model of the '
                    'family symplectic_form')
        if self.separable and not hamiltonian.separable:
            return (f'needs H = T(p) + V(q), but {type(hamiltonian).__name__} does not '
                    'separate')
        return ''


# Outcomes of one step, as numbers that compiled code can return.
(OK, NO_CONVERGENCE, NOT_FINITE, BEYOND, NO_MASS, REDUNDANT, IN_DOUBT, NO_SOLUTION,
 TURNED, NOT_HELD, NO_IMPACT, ENDLESS) = range(12)
REASONS = {NO_CONVERGENCE: 'no convergence', NOT_FINITE: 'not finite',
           BEYOND: 'beyond the limit of stability',
           NO_MASS: 'H_pp is not positive definite, so that there are no masses',
           REDUNDANT: 'it depends on the constraints before it',
           NO_SOLUTION: 'no solution is connected to h = 0',
           TURNED: 'a body would turn by nearly pi or more in one step',
           NOT_HELD: 'no impulses hold the constraints over the step',
           NO_IMPACT: 'its impacts cannot be followed',
           ENDLESS: 'the steps of its own that it takes become too many, or too short'}
# Remedies for the user where another step size or method is no cure.
REMEDIES = {NO_MASS: 'start elsewhere, or take another model', REDUNDANT: 'leave it out',
            ENDLESS: 'start elsewhere, or use another integrator; time_transformed takes fewer '
                     'with a larger force'}
# What may be done about a step that fails; see Rescue.
ON_FAILURE = ('substep', 'implicit', 'stop')


# The step of a method, with the outcome, the residual and the evaluations; see Integrator.step.
Step = Callable[..., tuple[int, float, int]]


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
    def empty(cls, n: int, dtype: type = np.float64) -> 'Point':
        """Return a point of n zeros in each array."""
        return cls(*np.zeros((6, n), dtype))


class PointWork(NamedTuple):
    """
    The workspace of what takes steps from one point to another.

    Parameters
    ----------
    point : Point
        Between two of them.

    """

    point: Point


def step_failure(outcome: int, t: float, h: float, residual: float, evaluations: int,
                 reason: str = '') -> StepFailure:
    """Return the error of a step with an outcome, whose reason may be told more closely."""
    # For any other outcome it is not the residual of an unsolved equation.
    unsolved = residual if outcome == NO_CONVERGENCE else math.nan
    return StepFailure(reason or REASONS[outcome], t, h, unsolved, evaluations,
                       REMEDIES.get(outcome, ADVICE))


class Integrator(ABC):
    """
    A one-step map of (q, p) for Hamilton's equations.

    Attributes
    ----------
    order : int
        Order of convergence on smooth problems.
    requirements : Requirements
        The method's demands on a system, and its conservation properties.
    explicit : bool
        Whether a step solves no equation.
    keeps_gradient : bool
        True if a step leaves the gradient at the new state, for nothing more.
    halves : tuple of callable or None
        Two steps of h / 2 that make up the step, if it has a middle to put something in.
    equations : tuple of int
        For each implicit equation, how many unknowns it has for each coordinate.
    no_solution : str
        Meaning of a step's equation without a solution connected to h = 0; '' where the
        one that solvers find is taken.
    fallback : str
        Name of the method whose sub-steps redo a failed step, where this one is not symmetric
        and does so itself; '' for none.
    compiled : bool
        False if a step calls what numba cannot compile.
    step : callable
        ``step(kernel, h, options, z, z1, memory)`` maps the point z to z1 and returns
        ``(outcome, residual, gradients)``; it never changes z. The method ``memory`` returns the
        argument of this name. It is plain Python in numba's subset, run compiled or interpreted.

    """

    order: int
    explicit: bool
    requirements: Requirements
    keeps_gradient: ClassVar[bool] = False
    compiled: bool = True
    no_solution: str = ''
    fallback: str = ''
    halves: 'tuple[Callable, Callable] | None' = None
    equations: tuple[int, ...] = ()
    step: Callable

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return why it takes no such Hamiltonian, to follow its name, or ''; see Requirements."""
        return self.requirements.refusal(hamiltonian)

    @property
    def kernel_name(self) -> str:
        """Return a name that is unique to the step."""
        return type(self).__name__

    @property
    def own(self) -> bool:
        """Return whether all of the step is this package's, whose changes are noticed."""
        return is_own(type(self).__module__)

    def attempts(self, n: int) -> tuple[int, ...]:
        """Return the attempts at one step of n coordinates, the cheapest first."""
        return (0,)

    @property
    def usual_gradients(self) -> int:
        """Return how many gradients a step takes at most as a rule; 0 if no rule holds."""
        return 0

    def own_times(self, kernel: Kernel) -> tuple[float, float]:
        """
        Return the time of a step besides its gradients, fixed and for each gradient [s].

        They are of one machine, and the same everywhere: what is chosen by them does not depend
        on how busy a machine is.
        """
        return (2e-8, 0.0) if self.explicit else (1.5e-7, 2e-8)

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """
        Return what ``step`` takes as its options: numbers, arrays and solvers; here none.

        Parameters
        ----------
        attempt : int
            Which of the attempts at a step, from 0.
        dimension : int
            The number d of degrees of freedom of the Hamiltonian.

        """
        return ()

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the number of unknowns of each implicit equation, for n coordinates."""
        return tuple(each * n for each in self.equations)

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspaces of a step of n coordinates, none for no such; see workspaces."""
        return ()

    @property
    def partitioned(self) -> PartitionedTableau | None:
        """Return the step as a partitioned Runge-Kutta method, for derivatives; None if none."""
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


def euler_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                 energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray) -> np.ndarray:
    """Return H + (h / 2) H_q . H_p [J], conserved up to O(h^2); see Integrator."""
    return energy + 0.5 * h * np.sum(dH_dq * dH_dp, axis=-1)


def leapfrog_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                    energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray
                    ) -> np.ndarray:
    """
    Return the modified energy of the generalised leapfrog up to O(h^4) [J]; see Integrator.

        H~ = H + (h^2 / 24) (2 H_p . H_qq H_p - H_q . H_pp H_q + 2 H_q . H_pq H_p)

    It follows from that of symplectic Euler, H -+ (h / 2) H_q . H_p
    + (h^2 / 12) (H_p . H_qq H_p + H_q . H_pp H_q + 4 H_q . H_pq H_p), by the formula of Baker,
    Campbell and Hausdorff for half a step of it and half a step of its adjoint. Where H separates
    the last term is zero, and it is that of Störmer-Verlet.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, sections III.4, IX.3.

    """
    zero = np.zeros_like(dH_dq)
    along_q, mixed = hamiltonian.hessian_vector(q, p, dH_dp, zero)
    _, along_p = hamiltonian.hessian_vector(q, p, zero, dH_dq)
    terms = dH_dp * along_q - 0.5 * dH_dq * along_p + dH_dq * mixed
    return energy + h * h / 12.0 * np.sum(terms, axis=-1)


def midpoint_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                    energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray
                    ) -> np.ndarray:
    """
    Return the modified energy of the implicit midpoint rule up to O(h^4) [J]; see Integrator.

        H~ = H - (h^2 / 24) f . H'' f,    f = (H_p, -H_q)

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section IX.3.

    """
    along_q, along_p = hamiltonian.hessian_vector(q, p, dH_dp, -dH_dq)
    return energy - h * h / 24.0 * np.sum(dH_dp * along_q - dH_dq * along_p, axis=-1)
