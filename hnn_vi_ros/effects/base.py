# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base classes of effects: one for each way to act on a system."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from functools import cache
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, TYPE_CHECKING

from hnn_vi_ros.effects.commands import Reference
from hnn_vi_ros.errors import listed, reduce_error
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator, PhasePoint, PointWork, Step
from hnn_vi_ros.kernels import Energy, Functions, Gradient, HessianVector, Parameters
from hnn_vi_ros.phase_space import columns, Coordinate, leaders, motor_names, scalar_columns
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.models import Checkpoint


class Place(IntEnum):
    """
    Place where an effect acts, from the innermost to the outermost.

    An effect acts between steps when a command arrives, is added to H, or acts as a force at the
    method's nodes, between the two halves of the step, before and after the step, on the resulting
    state to keep it on a manifold, or around all of these. Effects in the same place act in the
    scene's order, the first one innermost.
    """

    COMMANDS = -1
    ENERGY = 0
    NODES = 1
    MIDDLE = 2
    AROUND = 3
    MANIFOLD = 4
    OUTSIDE = 5


class EffectState(NamedTuple):
    """
    State that the effects of a simulation share and that persists from step to step.

    Parameters
    ----------
    clock : np.ndarray, shape (2,)
        Time at the start of the step [s], and its rounding error from compensated summation.
    work : np.ndarray, shape (K, 2)
        Work of each of the scene's K effects on the system [J], and its rounding error.
    pending : np.ndarray, shape (K,)
        Work in the attempted step [J].
    command : np.ndarray, shape (d + 1,)
        The last commanded force on each coordinate, and its expiry time [s].
    draws : np.ndarray, shape (3,)
        Counts of random numbers drawn before the step and in it, and the number of the stream.
    gauge : np.ndarray, shape (d, d)
        The linear vector potential of all magnetic fields, c A(q) = gauge q. The kinetic momentum
        M v is p - gauge q.
    resting : np.ndarray, shape (K,)
        Internal variable x of each effect that is an InternalForce. Bags have this name.
    on_stops : np.ndarray of int64, shape (E, S)
        1 for each of the S stops of each of the E effects on which a coordinate rests; E = 0 if no
        effect has rigid stops.
    expiry : np.ndarray, shape (1,)
        Expiry time of the wrench on a link [s], part of snapshots of scenes that have one.
    step : np.ndarray, shape (1,)
        Size of the attempted step [s], not part of snapshots; 1 before the first step.
    part : np.ndarray, shape (1,)
        A time within the part of the step that is being taken [s], NaN between steps; not part of
        snapshots. See CutAtKnots.
    reference : Reference
        The reference that servos follow.

    """

    clock: np.ndarray
    work: np.ndarray
    pending: np.ndarray
    command: np.ndarray
    draws: np.ndarray
    gauge: np.ndarray
    resting: np.ndarray
    on_stops: np.ndarray
    expiry: np.ndarray
    step: np.ndarray
    part: np.ndarray
    reference: Reference

    @classmethod
    def empty(cls, effects: int, dimension: int, knots: int = 0,
              stops: tuple[int, int] = (0, 0)) -> 'EffectState':
        """Return the state before the first step, with space for knots of a path and stops."""
        return cls(np.zeros(2), np.zeros((effects, 2)), np.zeros(effects),
                   np.zeros(dimension + 1), np.zeros(3, dtype=np.int64),
                   np.zeros((dimension, dimension)), np.zeros(effects),
                   np.zeros(stops, dtype=np.int64), np.zeros(1), np.ones(1), np.full(1, np.nan),
                   Reference.empty(dimension, knots))

    def reset(self, stream: int, time: float = 0.0,
              held: Mapping[str, np.ndarray] | None = None) -> None:
        """
        Return to the state before the first step.

        Parameters
        ----------
        stream : int
            Number of the stream of random numbers.
        time : float, optional
            Simulated time [s].
        held : mapping of str to np.ndarray, optional
            A snapshot whose commands stay active until they expire.

        """
        for array in (self.clock, self.work, self.pending, self.command, self.draws,
                      self.resting, self.on_stops, self.expiry, *self.reference):
            array[...] = 0
        self.clock[0], self.draws[2], self.step[0], self.part[0] = time, stream, 1.0, np.nan
        if held is not None:
            self.command[...] = held['live.command']
            self.expiry[...] = held.get('wrench.expiry', 0.0)
            for name, array in zip(Reference._fields, self.reference, strict=True):
                array[...] = held[f'live.reference.{name}'][:len(array)]


class EffectError(ValueError):
    """
    Mismatch between an effect and the system, the method or the other effects.

    Parameters
    ----------
    index : int
        Index of the effect in the scene's list.
    message : str
        The mismatch.

    """

    def __init__(self, index: int, message: str):
        super().__init__(message)
        self.index = index

    __reduce__ = reduce_error


class Effect(ABC):
    """
    An addition to a Hamiltonian system: a potential, a force, or a change of the step.

    Attributes
    ----------
    acts : Place
        Default place; ``place`` may return another one for a method.
    conservative : bool
        True if it leaves the energy H, including its own potential, unchanged.
    single : bool
        True if a scene can list only one effect of its kind.
    batched : bool
        True if it can act on several trajectories that step together.
    turns : bool
        True if it can act on systems with rotations.
    random : bool
        True if it draws random numbers.
    corrects_command : bool
        True if its work is a part of that of the effect that applies the command.
    passive : bool
        True if it only takes energy from the system; what it does not store is heat.
    limits : bool
        True if its parameters are stops at joint limits, which commands must respect.
    stops : bool
        True if its parameters name columns of coordinates with rigid stops.
    by_motors : bool or None
        True if the numbers of a command are those of a model's motors, False if they are those of
        coordinates, None if it accepts no numbers.
    drawn : bool
        True if the viewer draws its force as an arrow, which takes microseconds of plain Python.
    knots : int
        Number of knots of a path that it needs space for; see Reference.
    internal : bool
        True for an InternalForce.
    frequency : float
        Frequency of a force that oscillates in time [Hz], 0 for none.
    stiff : bool
        True if it has a ``fastest_rate``, which steps should resolve.
    cuts_at_knots : bool
        True if it jumps at the knots of the reference, where steps are cut; see CutAtKnots.
    model : Checkpoint or None
        Model with its networks, if it is an effect of one.
    excludes : mapping of Place to str
        Places where no other effect may act, each with a clause of the error message that gives
        the reason.

    """

    acts: ClassVar[Place]
    conservative: bool = False
    single: ClassVar[bool] = False
    batched: ClassVar[bool] = True
    turns: ClassVar[bool] = False
    random: ClassVar[bool] = False
    corrects_command: ClassVar[bool] = False
    passive: bool = False
    limits: ClassVar[bool] = False
    stops: ClassVar[bool] = False
    by_motors: bool | None = None
    drawn: ClassVar[bool] = False
    knots: ClassVar[int] = 0
    internal: ClassVar[bool] = False
    frequency: float = 0.0
    stiff: ClassVar[bool] = False
    cuts_at_knots: bool = False
    model: 'Checkpoint | None' = None
    excludes: ClassVar[Mapping[Place, str]] = MappingProxyType({})

    def place(self, integrator: Integrator) -> Place:
        """Return the place where it acts in steps of this method."""
        return self.acts

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method keeps its properties with this effect."""
        return integrator.requirements.hamiltonian

    def fastest_rate(self, parameters: Any, inverse_mass: np.ndarray) -> float:
        """Return the fastest rate of its own small motions [rad/s], from H_pp."""
        raise NotImplementedError

    @abstractmethod
    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Parameters:
        """
        Return the first argument of the effect's compiled functions: numbers and arrays.

        Parameters
        ----------
        coordinates : sequence of Coordinate
            The d coordinates of the system.
        state : EffectState
            The state of the simulation's effects.

        Raises
        ------
        ValueError
            A name or a length does not match the coordinates; the message lists the valid ones.

        """

    def resolve_on(self, hamiltonian: Hamiltonian, state: EffectState) -> Parameters:
        """Return the result of ``resolve`` on H; overridden where more of H is needed."""
        return self.resolve(hamiltonian.coordinates, state)

    def changing(self, parameters: Any) -> dict[str, np.ndarray]:
        """Return arrays of its own that commands change, by name, for snapshots."""
        return {}

    def stored_energy(self, parameters: Any, q: np.ndarray, x: float) -> dict[str, float]:
        """
        Return the energies that it stores [J], by joint, or by '' if there is only one.

        Parameters
        ----------
        parameters : tuple
            The result of ``resolve``.
        q : np.ndarray, shape (d,)
            Coordinates.
        x : float
            Its internal variable; see EffectState.

        """
        return {}

    def check_beside(self, others: Sequence['Effect']) -> None:  # noqa: B027
        """Raise ValueError if it does not fit the effects of its scene, itself included."""

    def check_state(  # noqa: B027
            self, hamiltonian: Hamiltonian, parameters: Any, q: np.ndarray) -> None:
        """
        Raise ValueError if the effect cannot act on an initial state.

        Parameters
        ----------
        hamiltonian : Hamiltonian
            H with the effects that are added to it.
        parameters : tuple
            The result of ``resolve``.
        q : np.ndarray, shape (d,) or (m d,)
            Coordinates of one trajectory, or of m trajectories in sequence.

        Raises
        ------
        ValueError
            The effect cannot act at q; the message gives the reason.

        """


class Joined(Effect):
    """
    An effect that is added to H.

    Attributes
    ----------
    keeps_separable : bool
        True if a separable H(q, p) = T(p) + V(q) stays separable.
    smooth : bool
        True if its gradient is continuous; known once it is resolved.

    """

    acts = Place.ENERGY
    conservative = smooth = True
    keeps_separable: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def compose(cls, base_energy: Energy, base_gradient: Gradient,
                base_hessian_vector: HessianVector) -> Functions:
        """
        Return the functions of H with the effect, from the functions of H; see Kernel.

        They are plain Python in numba's subset, and cached by arguments. Their parameters are a
        tuple (base, own, work): the parameters of H, the result of ``resolve``, and a workspace of
        shape (2, d).
        """

    def formulas(self, parameters: Any) -> 'type[Joined]':
        """Return the class of the formulas for the result of ``resolve``, by default this one."""
        return type(self)

    def add_gauge(self, parameters: Any, gauge: np.ndarray) -> None:
        """Add the contribution to the linear vector potential, shape (d, d); see EffectState."""


class Potential(Joined):
    """
    A potential energy V(q), which is added to H.

    The functions are plain Python in numba's subset, for one state, q of shape (d,).

    Attributes
    ----------
    energy : callable
        ``energy(parameters, q)`` returns V [J].
    add_gradient : callable
        ``add_gradient(parameters, q, dH_dq)`` adds V' to the last argument.
    add_hessian_vector : callable
        ``add_hessian_vector(parameters, q, v, product)`` adds V''(q) v to the last argument.

    """

    keeps_separable = True
    energy: Callable[..., float]
    add_gradient: Callable[..., None]
    add_hessian_vector: Callable[..., None]

    @classmethod
    @cache
    def compose(cls, base_energy: Energy, base_gradient: Gradient,
                base_hessian_vector: HessianVector) -> Functions:
        """Return the functions of H(q, p) + V(q)."""
        add_energy, add_gradient = cls.energy, cls.add_gradient
        add_hessian_vector = cls.add_hessian_vector

        def energy(parameters: Parameters, q: np.ndarray, p: np.ndarray) -> float:
            base, own, _ = parameters
            return base_energy(base, q, p) + add_energy(own, q)

        def gradient(parameters: Parameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                     dH_dp: np.ndarray) -> None:
            base, own, work = parameters
            base_gradient(base, q, p, dH_dq, dH_dp)
            d = work.shape[1]
            for a in range(0, q.size, d):
                add_gradient(own, q[a:a + d], dH_dq[a:a + d])

        def hessian_vector(parameters: Parameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                           v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
            base, own, work = parameters
            base_hessian_vector(base, q, p, v_q, v_p, product_q, product_p)
            d = work.shape[1]
            for a in range(0, q.size, d):
                add_hessian_vector(own, q[a:a + d], v_q[a:a + d], product_q[a:a + d])
        return energy, gradient, hessian_vector

    def stored_energy(self, parameters: Any, q: np.ndarray, x: float) -> dict[str, float]:
        """Return V [J]."""
        return {'': self.formulas(parameters).energy(parameters, q)}  # type: ignore[attr-defined]


class Force(Effect):
    """
    A force that acts at the method's nodes (discrete Lagrange-d'Alembert principle).

    The equations become q' = H_p + f_q, p' = -H_q + f_p; the power is f_q . H_q + f_p . H_p.

    Attributes
    ----------
    depends_on_momentum : bool
        True if it depends on p, for given t and q.
    depends_on_state : bool
        True if it depends on q or p, for given t.
    feels_command : bool
        True if it depends on a command other than as a force on its coordinate.
    held : bool
        True if it is constant during a step.
    add_force : callable
        ``add_force(parameters, t, q, p, velocity, f_q, f_p)`` adds f_q and f_p to the last two
        arguments; ``velocity`` is H_p. Arrays have shape (d,). Plain Python in numba's subset.

    References
    ----------
    J. Marsden, M. West, Discrete mechanics and variational integrators, Acta Numerica 2001, 3.

    """

    acts = Place.NODES
    depends_on_momentum: ClassVar[bool]
    depends_on_state: bool = True
    feels_command: bool = False
    held: bool = False
    add_force: Callable[..., None]

    @property
    def rounding(self) -> tuple[float, float]:
        """Return the rounding errors of f_q and f_p, in the units of Kernel.gradient_scale."""
        return 0.0, 0.0

    def joints(self, parameters: Any) -> np.ndarray | None:
        """Return the columns of its joints if each has a work of its own, else None."""
        return None

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method supports this force at its nodes."""
        return integrator.requirements.take_force(self.depends_on_momentum, self.held)


class InternalForce(Force):
    """
    A force on one coordinate whose internal variable x follows the velocity v or a command.

    Within a step v is constant, so that x follows an exact flow and is bounded at any step size:
    x at a node belongs to the time and the v of the node, and the change of x in a step is the
    mean of those at the nodes. This is of order 2. ``add_force`` does not apply.

    Attributes
    ----------
    respond : callable
        ``respond(parameters, x, v, t, h)`` returns the force at the time t since the start of the
        step, where x belongs, and the mean rate of x over the step h. Plain Python in numba's
        subset. The first field of the parameters is the column of the coordinate.
    respond_tangent : callable
        ``respond_tangent(parameters, x, v, t, h, dx, dv)`` returns the changes of both.

    """

    depends_on_momentum, batched, internal = True, False, True
    respond: Callable[..., tuple[float, float]]
    respond_tangent: Callable[..., tuple[float, float]]

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method supports forces of order 2 that depend on the velocity."""
        return (integrator.order <= 2 and integrator.requirements.from_state
                and super().accepts(integrator))


class StepLayer:
    """
    A layer that Wrapped puts around a step, such as a StepEffect.

    Attributes
    ----------
    repeats : bool
        True if it takes the method's step more than once in a step of its own.

    """

    repeats: ClassVar[bool] = False

    @classmethod
    def inner_step(cls, integrator: Integrator) -> Any:
        """Return the part of a method that ``wrap`` takes, by default its step."""
        return integrator.step

    @staticmethod
    @abstractmethod
    def wrap(step: Any, keeps_gradient: bool, /) -> Step:
        """
        Return a step with the layer around it.

        The result is plain Python in numba's subset, and cached by arguments; see Wrapped.

        Parameters
        ----------
        step : callable or tuple
            The result of ``inner_step``.
        keeps_gradient : bool
            True if the method's step reads the gradient at its start.

        """

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the workspace of the layer's step, by default a point."""
        return PointWork(PhasePoint.empty(n))


class StepEffect(Effect, StepLayer):
    """An effect that acts between or around steps of a method: a flow, a jump or a projection."""

    acts = Place.AROUND

    @classmethod
    def inner_step(cls, integrator: Integrator) -> Any:
        """Return the part of a method that ``wrap`` takes: its step, or the two halves."""
        return integrator.halves if cls.acts is Place.MIDDLE else integrator.step

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method keeps its properties and has the part that ``wrap`` takes."""
        return super().accepts(integrator) and self.inner_step(integrator) is not None


def motor_index(coordinates: Sequence[Coordinate], name: str) -> int:
    """Return the column on which the motor of a coordinate acts; see ``coordinate_index``."""
    return coordinate_index(coordinates, motor_names(coordinates).get(name, name))


def coordinate_index(coordinates: Sequence[Coordinate], name: str) -> int:
    """Return the column of a coordinate in q, or raise ValueError with the valid names."""
    indices = scalar_columns(coordinates)
    if name not in indices:
        leader = leaders(coordinates).get(name)
        why = '' if leader is None else f': this joint follows {leader}; name that one'
        raise ValueError(f'no coordinate {name!r}{why}; valid coordinates: {listed(indices)}')
    return indices[name]


def per_coordinate(coordinates: Sequence[Coordinate], name: str, values: float | Sequence[float]
                   ) -> np.ndarray:
    """Return one number for each column of p, from a number for all columns or a list."""
    array, names = np.array(values, dtype=np.float64), columns(coordinates)[1]
    if array.ndim and array.size != len(names):
        raise ValueError(f'{name} has {array.size} values, expected 1, or one for each of the '
                         f'coordinates {listed(names)}')
    return np.broadcast_to(array, len(names)).copy()
