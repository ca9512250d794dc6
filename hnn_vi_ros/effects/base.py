# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base of effects, in each of the ways in which one can act on a system."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol

from hnn_vi_ros.effects.commands import Reference
from hnn_vi_ros.errors import listed, reduce_error
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.base import Integrator, Point, PointWork, Step
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.phase_space import columns, Coordinate, scalar_columns
import numpy as np


class Place(IntEnum):
    """
    Place of an effect, from the inside of a step to its outside.

    It joins H; is a force at the method's own nodes; acts between the two halves of the step; or
    before and after the step; keeps the state that then results on a manifold; or acts around
    all of that. Effects in one place act in the scene's order, the first one innermost.
    """

    ENERGY = 0
    NODES = 1
    MIDDLE = 2
    AROUND = 3
    MANIFOLD = 4
    OUTSIDE = 5


class EffectState(NamedTuple):
    """
    State that the effects of one simulation share, and keep from step to step.

    Parameters
    ----------
    clock : np.ndarray, shape (2,)
        Time at the start of the step [s], and what compensated summation rounded off it.
    work : np.ndarray, shape (K, 2)
        Work that each of the scene's K effects has done on the system [J], and its rounding.
    pending : np.ndarray, shape (K,)
        Work in the step that is being tried [J].
    command : np.ndarray, shape (d + 1,)
        The force that was last commanded, for each coordinate, and until when it holds [s].
    draws : np.ndarray, shape (3,)
        Random numbers drawn, those drawn in the step being tried, and the stream's number.
    gauge : np.ndarray, shape (d, d)
        The vector potential of all magnetic fields is linear: c A(q) = gauge q. The momentum that
        belongs to the velocity, M v, is p - gauge q.
    resting : np.ndarray, shape (K,)
        1 where the effect is a wall on which its coordinate rests.
    reference : Reference
        What servos follow.

    """

    clock: np.ndarray
    work: np.ndarray
    pending: np.ndarray
    command: np.ndarray
    draws: np.ndarray
    gauge: np.ndarray
    resting: np.ndarray
    reference: Reference

    @classmethod
    def empty(cls, effects: int, dimension: int, knots: int = 0) -> 'EffectState':
        """Return the state before the first step, with room for the knots of a path."""
        return cls(np.zeros(2), np.zeros((effects, 2)), np.zeros(effects), np.zeros(dimension + 1),
                   np.zeros(3, dtype=np.int64), np.zeros((dimension, dimension)),
                   np.zeros(effects), Reference.empty(dimension, knots))

    def reset(self, stream: int, time: float = 0.0,
              held: Mapping[str, np.ndarray] | None = None) -> None:
        """Go back to before the first step; a snapshot's commands go on until their time-outs."""
        for array in (self.clock, self.work, self.pending, self.command, self.draws,
                      self.resting, *self.reference):
            array[...] = 0
        self.clock[0], self.draws[2] = time, stream
        if held is not None:
            self.command[...] = held['live.command']
            for name, array in zip(Reference._fields, self.reference, strict=True):
                array[...] = held[f'live.reference.{name}'][:len(array)]


class EffectError(ValueError):
    """
    An effect that does not fit the system, the method or the other effects.

    Parameters
    ----------
    index : int
        Its place in the scene's list.
    message : str
        What is wrong.

    """

    def __init__(self, index: int, message: str):
        super().__init__(message)
        self.index = index

    __reduce__ = reduce_error


class Effect(ABC):
    """
    Something that acts on a Hamiltonian system beside its own H.

    Attributes
    ----------
    acts : Place
        Where it acts, unless ``place`` says otherwise.
    conservative : bool
        Whether it leaves the energy H unchanged, once its potential, if any, has joined H.
    single : bool
        Whether a scene takes only one of its kind.
    lockstep : bool
        Whether it can act on several trajectories that step together.
    turns : bool
        Whether it acts on systems that turn as well.
    limits : bool
        Whether its parameters hold limits of joints: their places, positions and signs.
    knots : int
        How many knots of a path it may follow; see Reference.
    excludes : mapping of Place to str
        Places in which nothing else may act, and why: a clause that follows the other's name.

    """

    acts: ClassVar[Place]
    conservative: bool = False
    single: ClassVar[bool] = False
    lockstep: ClassVar[bool] = True
    turns: ClassVar[bool] = False
    limits: ClassVar[bool] = False
    knots: ClassVar[int] = 0
    excludes: ClassVar[Mapping[Place, str]] = MappingProxyType({})

    def place(self, integrator: Integrator) -> Place:
        """Return where it acts in the steps of a method."""
        return self.acts

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether a method can take the effect without losing what it claims."""
        return integrator.requirements.hamiltonian

    @abstractmethod
    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Parameters:
        """
        Return the numbers and arrays that the effect's compiled functions take first.

        Parameters
        ----------
        coordinates : sequence of Coordinate
            Of the system, d of them.
        state : EffectState
            Of the simulation.

        Raises
        ------
        ValueError
            A name or a length does not fit the coordinates; names the valid ones.

        """

    def check_state(  # noqa: B027
            self, hamiltonian: Hamiltonian, parameters: Any, q: np.ndarray) -> None:
        """
        Refuse a state to begin from.

        Parameters
        ----------
        hamiltonian : Hamiltonian
            H with what joins it.
        parameters : tuple
            What ``resolve`` returned.
        q : np.ndarray, shape (d,) or (m d,)
            Coordinates of one trajectory, or of several one after another.

        Raises
        ------
        ValueError
            The effect cannot act there; says why.

        """


class Joined(Effect):
    """
    An effect that joins H.

    Attributes
    ----------
    keeps_separable : bool
        Whether an H(q, p) = T(p) + V(q) stays one.

    """

    acts = Place.ENERGY
    conservative = True
    keeps_separable: ClassVar[bool] = False

    @abstractmethod
    def join(self, kernel: Kernel, parameters: Any) -> Kernel:
        """Return a kernel of H together with the effect, of what ``resolve`` returned."""

    def add_gauge(self, parameters: Any, gauge: np.ndarray) -> None:
        """Add its share to the linear vector potential, shape (d, d); see EffectState."""


class Potential(Joined):
    """
    A potential energy V(q), which joins H.

    The functions are plain Python in numba's subset, for one state, q of shape (d,).

    Attributes
    ----------
    energy : callable
        ``energy(parameters, q)`` returns V [J].
    add_gradient : callable
        ``add_gradient(parameters, q, dH_dq)`` adds V' to the last.
    add_hessian_vector : callable
        ``add_hessian_vector(parameters, q, v, product)`` adds V''(q) v to the last.

    """

    keeps_separable = True
    energy: Callable[..., float]
    add_gradient: Callable[..., None]
    add_hessian_vector: Callable[..., None]

    def join(self, kernel: Kernel, parameters: Parameters) -> Kernel:
        """Return the kernel of H + V."""
        from hnn_vi_ros.effects.kernels import join_potential
        return join_potential(kernel, type(self), parameters)


class Force(Effect):
    """
    A force that does work, taken at the method's own nodes (discrete Lagrange-d'Alembert).

    Its power is f_q . H_q + f_p . H_p, whatever the force is.

    Attributes
    ----------
    depends_on_momentum : bool
        Whether it changes with p at given t and q.
    add_force : callable
        ``add_force(parameters, t, q, p, velocity, f_q, f_p)`` adds to the last two what joins
        q' = H_p and p' = -H_q; ``velocity`` is H_p. Arrays have shape (d,). Plain Python in
        numba's subset.

    References
    ----------
    J. Marsden, M. West, Discrete mechanics and variational integrators, Acta Numerica 2001,
    part 3.

    """

    acts = Place.NODES
    depends_on_momentum: ClassVar[bool]
    add_force: Callable[..., None]

    @property
    def rounding(self) -> tuple[float, float]:
        """Return the rounding errors of f_q and f_p, as Kernel.gradient_scale does."""
        return 0.0, 0.0

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether the method takes forces at its nodes, and such that depend on p."""
        return integrator.requirements.take_force(self.depends_on_momentum)


class StepEffect(Effect):
    """
    An effect that acts between or around the steps of a method: a flow, a jump, a projection.

    Attributes
    ----------
    wrap : callable
        ``wrap(step, keeps_gradient)`` returns the step with the effect, from the method's; see
        Wrapped. The same function for the same arguments.
    repeats : bool
        Whether it takes the method's step more than once in a step of its own.

    """

    acts = Place.AROUND
    repeats: ClassVar[bool] = False

    @staticmethod
    @abstractmethod
    def wrap(step: Any, keeps_gradient: bool, /) -> Step:
        """Return the step with the effect, from what ``inner_step`` returned."""

    @classmethod
    def inner_step(cls, integrator: Integrator) -> Any:
        """Return what ``wrap`` takes of a method: its step, or the halves of it."""
        return integrator.halves if cls.acts is Place.MIDDLE else integrator.step

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether the method has what the effect takes of it."""
        return super().accepts(integrator) and self.inner_step(integrator) is not None

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the step's own workspace, after those of the method: here a point."""
        return PointWork(Point.empty(n))


class Wrapping(Protocol):
    """Layer that Wrapped puts around a step: a StepEffect, or what acts like one; see there."""

    @staticmethod
    def inner_step(integrator: Integrator, /) -> Any:
        """Return what ``wrap`` takes of a method."""

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...], /) -> tuple[Any, ...]:
        """Return what the step works on after what the method's does."""

    @staticmethod
    def wrap(step: Any, keeps_gradient: bool, /) -> Step:
        """Return the step with what acts around it."""


class Together(Protocol):
    """The constraints of a scene, which act as one around the step."""

    @property
    def kind(self) -> type[Wrapping]:
        """Return what Wrapped puts around a step."""

    @property
    def settings(self) -> Parameters:
        """Return what the wrapped step finds in its options."""

    @property
    def dependent(self) -> str:
        """Return the name of the constraint that made a step fail as REDUNDANT."""

    def check_state(self, q: np.ndarray, p: np.ndarray) -> None:
        """Raise ValueError if a state, of shape (d,), is not one that the constraints allow."""


class Constraint(Effect):
    """Condition that keeps the state on a manifold; all of a kind are solved together."""

    acts = Place.MANIFOLD
    conservative = True
    lockstep = False

    @staticmethod
    @abstractmethod
    def together(listed: Sequence[tuple[int, str, Parameters]], kernel: Kernel, effects: int
                 ) -> Together:
        """
        Return the constraints as one.

        Parameters
        ----------
        listed : sequence of (int, str, tuple)
            Place in the scene, name, and what ``resolve`` returned, of each.
        kernel : Kernel
            Of H with the forces, d coordinates and their channels.
        effects : int
            How many effects there are.

        Raises
        ------
        EffectError
            They do not fit the system or one another.

        """


def coordinate_index(coordinates: Sequence[Coordinate], name: str) -> int:
    """Return the column of a coordinate in q, or raise ValueError with the valid names."""
    places = scalar_columns(coordinates)
    if name not in places:
        raise ValueError(f'no coordinate {name!r}; valid coordinates: {listed(places)}')
    return places[name]


def per_coordinate(coordinates: Sequence[Coordinate], name: str, values: float | Sequence[float]
                   ) -> np.ndarray:
    """Return one number for each column of p, from one for all or a list."""
    array, names = np.array(values, dtype=np.float64), columns(coordinates)[1]
    if array.ndim and array.size != len(names):
        raise ValueError(f'{name} has {array.size} values, expected 1 or one for each of the '
                         f'coordinates {listed(names)}')
    return np.broadcast_to(array, len(names)).copy()
