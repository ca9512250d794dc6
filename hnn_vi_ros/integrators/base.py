# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of integrators: properties that a method declares, and the workspace of a step."""

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
    A stage that starts from the end of the stages before it, in fractions of the step size.

    From (x, c), which are q and p before the first node, it computes Q and P, and advances:

        Q = x + a h H_p(Q, P),  P = c - b h H_q(Q, P)
        x <- x + u h H_p(Q, P),  c <- c - w h H_q(Q, P)
    """

    a: float
    b: float
    u: float
    w: float


class PartitionedTableau(NamedTuple):
    """
    Coefficients of a step of s stages Z_i = (Q_i, P_i), one set for q and one for p.

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
        Return the stages as nodes that can be solved in sequence.

        Raises
        ------
        ValueError
            A stage does not start from the end of the stages before it, or depends on later ones.

        """
        for matrix, weights in ((self.q_matrix, self.q_weights), (self.p_matrix, self.p_weights)):
            ended = np.tril(np.tile(weights, (self.stages, 1)), -1)
            if (matrix - np.diag(np.diag(matrix)) != ended).any():
                raise ValueError('the tableau is not diagonally implicit')
        return [Node(*map(float, numbers)) for numbers in zip(
            np.diag(self.q_matrix), np.diag(self.p_matrix), self.q_weights, self.p_weights,
            strict=True)]


def tableau(q_matrix: ArrayLike, p_matrix: ArrayLike, q_weights: ArrayLike,
            p_weights: ArrayLike) -> PartitionedTableau:
    """Return the PartitionedTableau of coefficients given as lists."""
    return PartitionedTableau(*(np.array(part, dtype=np.float64) for part in (
        q_matrix, p_matrix, q_weights, p_weights)))


# The stages of a leapfrog are (q_n, p_half) and (q_(n+1), p_half).
LEAPFROG = tableau([[0.0, 0.0], [0.5, 0.5]], [[0.5, 0.0], [0.5, 0.0]], [0.5, 0.5], [0.5, 0.5])


def in_sequence(base: PartitionedTableau, fractions: Sequence[float]) -> PartitionedTableau:
    """Return the tableau of a step composed of steps of a base method, of fractions of h."""
    s, count = base.stages, len(fractions)
    matrices, weights = np.zeros((2, count * s, count * s)), np.zeros((2, count * s))
    for k, fraction in enumerate(fractions):
        own, later = slice(k * s, (k + 1) * s), slice((k + 1) * s, None)
        for matrix, weight, base_matrix, base_weight in zip(
                matrices, weights, base[:2], base[2:], strict=True):
            matrix[own, own] = fraction * base_matrix
            # Stages of later parts start from the end of this part.
            matrix[later, own] = fraction * base_weight
            weight[own] = fraction * base_weight
    return PartitionedTableau(*matrices, *weights)


@dataclass(frozen=True)
class Requirements:
    """
    Requirements and conservation properties of a method; every refusal follows from them.

    Parameters
    ----------
    symmetric, symplectic : bool
        Properties of the map; symplectic in the 2-form that the method's docstring names.
    separable : bool
        True if the method needs H = T(p) + V(q), and forces that do not depend on p.
    coordinates : str
        ``'canonical'``: the method needs canonical (q, p). ``'any'``: it integrates any u' = f(u).
        ``'other'``: it is made for non-canonical coordinates, on which no effect acts.
        ``'group'``: it is made for rotations, which only such methods integrate.
    hamiltonian : bool
        False if the map is not derived from the kernel's H, so that no effect can be added to it.
    forces : bool or str
        True if the map remains valid when forces are added to the kernel's gradient; ``'held'`` if
        it does for one force that is constant in each step.
    from_state : bool
        False if the next step does not continue from the state at the end of the last one; nothing
        may then change that state between steps.

    """

    symmetric: bool
    symplectic: bool
    separable: bool = False
    coordinates: Literal['canonical', 'any', 'other', 'group'] = 'canonical'
    hamiltonian: bool = True
    forces: bool | Literal['held'] = True
    from_state: bool = True

    def take_force(self, depends_on_momentum: bool, held: bool = False) -> bool:
        """Return True if the method can evaluate a force at its nodes."""
        takes = held if self.forces == 'held' else self.forces
        return self.hamiltonian and takes and not (depends_on_momentum and self.separable)

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return the reason for refusing `hamiltonian`, to follow the method's name, or ''."""
        turning = listed(coordinate.name for coordinate in hamiltonian.coordinates
                         if coordinate.kind != 'scalar')
        if turning and self.coordinates != 'group':
            return f'adds to coordinates, which a rotation ({turning}) does not allow'
        if not turning and self.coordinates == 'group':
            return 'needs rotations or poses, but this H has none'
        if not hamiltonian.canonical and self.coordinates == 'canonical':
            names = listed(coordinate.name for coordinate in hamiltonian.coordinates)
            return (f'needs canonical coordinates, but those of this model ({names}) are not: '
                    'the steps would conserve a 2-form other than the learned one')
        if hamiltonian.canonical and self.coordinates == 'other':
            return ('needs coordinates that are not canonical, those of a model of the family '
                    'symplectic_form')
        if hamiltonian.time is not None and not self.take_force(depends_on_momentum=False):
            return 'does not support an H that depends on the time'
        if self.separable and not hamiltonian.separable:
            return (f'needs H = T(p) + V(q), but {type(hamiltonian).__name__} is not '
                    'separable')
        return ''


# Outcomes of one step, as numbers that compiled code can return.
(OK, NO_CONVERGENCE, NOT_FINITE, BEYOND, NO_MASS, REDUNDANT, IN_DOUBT, NO_SOLUTION,
 TURNED, NOT_HELD, NO_IMPACT, ENDLESS) = range(12)
REASONS = {NO_CONVERGENCE: 'no convergence', NOT_FINITE: 'not finite',
           BEYOND: 'beyond the stability limit',
           NO_MASS: 'H_pp is not positive definite, so there are no masses',
           REDUNDANT: 'it depends on earlier constraints',
           NO_SOLUTION: 'no solution is connected to h = 0',
           TURNED: 'a body would rotate by almost pi rad or more in one step',
           NOT_HELD: 'no impulses satisfy the constraints over the step',
           NO_IMPACT: 'its impacts cannot be resolved',
           ENDLESS: 'the internal steps became too many or too short'}
# Advice for the user in cases that another step size or method does not solve.
REMEDIES = {NO_MASS: 'start elsewhere, or use another model', REDUNDANT: 'remove it',
            ENDLESS: 'start elsewhere, or use another integrator; time_transformed needs fewer '
                     'with a larger force'}
# Policies for a step that fails; see Rescue.
ON_FAILURE = ('substep', 'implicit', 'stop')


# A step function returns the outcome, the residual and the evaluations; see Integrator.step.
Step = Callable[..., tuple[int, float, int]]


class PhasePoint(NamedTuple):
    """
    A state of one trajectory, or of several in sequence; each array has shape (n,).

    Parameters
    ----------
    q, p : np.ndarray
        Coordinates and momenta.
    q_carry, p_carry : np.ndarray
        The rounding errors of q and p, kept by compensated summation.
    dH_dq, dH_dp : np.ndarray
        The gradient of H at (q, p), if the method stores it.

    """

    q: np.ndarray
    p: np.ndarray
    q_carry: np.ndarray
    p_carry: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'PhasePoint':
        """Return a point of n zeros in each array."""
        return cls(*np.zeros((6, n), dtype))


class PointWork(NamedTuple):
    """
    Workspace of a step that consists of several steps.

    Parameters
    ----------
    point : Point
        An intermediate point.

    """

    point: PhasePoint


def step_failure(outcome: int, t: float, h: float, residual: float, evaluations: int,
                 reason: str = '') -> StepFailure:
    """Return the exception for a failed step, with a more specific reason if one is given."""
    # For other outcomes it is not the residual of an unsolved equation.
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
        Requirements on a system, and conservation properties.
    explicit : bool
        True if a step solves no equation.
    tolerances : tuple of str
        Arguments that are tolerances of internal steps; () for a method without them.
    useful_tolerances : tuple of float
        Smallest and largest useful tolerance.
    keeps_gradient : bool
        True if a step leaves the gradient at the new state at no extra cost.
    halves : tuple of callable or None
        Two steps of h / 2 that compose the step, if something can be inserted between them.
    equations : tuple of int
        For each implicit equation, its number of unknowns per coordinate.
    no_solution : str
        Message when a step's equation has no solution connected to h = 0; '' if any solution that
        the solvers find is accepted.
    fallback : str
        Name of the method whose sub-steps redo a failed step, if this method is not symmetric and
        cannot do so itself; '' for none.
    compiled : bool
        False if a step calls functions that numba cannot compile.
    step : callable
        ``step(kernel, h, options, z, z1, memory)`` maps the point z to z1 and returns ``(outcome,
        residual, gradients)``; it never changes z. The method ``memory`` allocates its last
        argument. It is plain Python in numba's subset, run compiled or interpreted.

    """

    order: int
    explicit: bool
    requirements: Requirements
    tolerances: ClassVar[tuple[str, ...]] = ()
    useful_tolerances: ClassVar[tuple[float, float]] = (0.0, 0.0)
    keeps_gradient: ClassVar[bool] = False
    compiled: bool = True
    no_solution: str = ''
    fallback: str = ''
    halves: 'tuple[Callable, Callable] | None' = None
    equations: tuple[int, ...] = ()
    step: Callable

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return the reason this method cannot integrate `hamiltonian`, '' if it can."""
        return self.requirements.refusal(hamiltonian)

    def scaled(self, factor: float) -> 'Integrator':
        """Return the method with its tolerances times a factor; itself if it has none."""
        return self

    @property
    def kernel_name(self) -> str:
        """Return a name that is unique to the step."""
        return type(self).__name__

    @property
    def own(self) -> bool:
        """Return True if all code of the step is in this package, whose changes are detected."""
        return is_own(type(self).__module__)

    def attempts(self, n: int) -> tuple[int, ...]:
        """Return the attempts at one step of n coordinates, the cheapest first."""
        return (0,)

    @property
    def usual_gradients(self) -> int:
        """Return the usual maximum number of gradients in a step; 0 if there is none."""
        return 0

    def own_times(self, kernel: Kernel) -> tuple[float, float]:
        """
        Return the time of a step without its gradients: a fixed part, and one per gradient [s].

        The values were measured on one machine and are constants, so that choices based on them do
        not depend on the load of the machine.
        """
        return (4e-8, 0.0) if self.explicit else (1.5e-7, 2e-8)

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """
        Return the options of ``step``, which are numbers, arrays and solvers; () by default.

        Parameters
        ----------
        attempt : int
            Zero-based index of the attempt at a step.
        dimension : int
            Number d of degrees of freedom of the Hamiltonian.

        """
        return ()

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the number of unknowns of each implicit equation, for n coordinates."""
        return tuple(each * n for each in self.equations)

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspaces of a step of n coordinates; () if it needs none."""
        return ()

    @property
    def partitioned(self) -> PartitionedTableau | None:
        """Return the tableau of the step for derivatives, None if it is no Runge-Kutta method."""
        return None

    @staticmethod
    def modified_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                        energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray
                        ) -> np.ndarray | None:
        """
        Return the energy that the map nearly conserves [J], or None if it is unknown.

        Its deviation is O(h^(2 order)).

        Parameters
        ----------
        hamiltonian : Hamiltonian
            The Hamiltonian.
        h : float
            Step size [s].
        q, p : np.ndarray, shape (..., d)
            States.
        energy : np.ndarray, shape (...)
            H at the states [J].
        dH_dq, dH_dp : np.ndarray, shape (..., d)
            Gradient of H at the states.

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

    It follows from the modified energy of symplectic Euler, H -+ (h / 2) H_q . H_p
    + (h^2 / 12) (H_p . H_qq H_p + H_q . H_pp H_q + 4 H_q . H_pq H_p), and the Baker-Campbell-
    Hausdorff formula for half a step of it and half a step of its adjoint. If H is separable, the
    last term is zero and H~ is that of Störmer-Verlet.

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
