# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What every effect offers, in the three ways in which one can act on a system."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple

from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Live(NamedTuple):
    """
    What the effects of one simulation share, and keep from step to step.

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

    """

    clock: np.ndarray
    work: np.ndarray
    pending: np.ndarray
    command: np.ndarray
    draws: np.ndarray
    gauge: np.ndarray
    resting: np.ndarray

    @classmethod
    def empty(cls, effects: int, dimension: int) -> 'Live':
        """Return the state before the first step."""
        return cls(np.zeros(2), np.zeros((effects, 2)), np.zeros(effects),
                   np.zeros(dimension + 1), np.zeros(3, dtype=np.int64),
                   np.zeros((dimension, dimension)), np.zeros(effects))

    def reset(self, stream: int) -> None:
        """Go back to before the first step, on a stream of random numbers."""
        for array in (self.clock, self.work, self.pending, self.command, self.draws,
                      self.resting):
            array[...] = 0
        self.draws[2] = stream


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


class Effect(ABC):
    """
    Something that acts on a Hamiltonian system beside its own H.

    Attributes
    ----------
    conservative : bool
        Whether it leaves the energy H unchanged, once its potential, if any, has joined H.

    """

    conservative: ClassVar[bool] = False

    def accepts(self, integrator: Integrator) -> bool:
        """Tell whether a method can take the effect without losing what it claims."""
        return integrator.uses_hamiltonian

    @abstractmethod
    def resolve(self, coordinates: Sequence[Coordinate], live: Live) -> tuple:
        """
        Return the numbers and arrays that the effect's compiled functions take first.

        Parameters
        ----------
        coordinates : sequence of Coordinate
            Of the system, d of them.
        live : Live
            Of the simulation.

        Raises
        ------
        ValueError
            A name or a length does not fit the coordinates; names the valid ones.

        """


class Potential(Effect):
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

    conservative = True
    energy: Callable
    add_gradient: Callable
    add_hessian_vector: Callable


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

    depends_on_momentum: ClassVar[bool]
    add_force: Callable

    @property
    def rounding(self) -> tuple[float, float]:
        """Return the rounding errors of f_q and f_p, as Kernel.gradient_scale does."""
        return 0.0, 0.0

    def splits(self, integrator: Integrator) -> bool:
        """Tell whether the method takes the force's exact flow around its steps instead."""
        return False

    def accepts(self, integrator: Integrator) -> bool:
        """Tell whether the method takes forces at its nodes, and such that depend on p."""
        return integrator.takes_forces and not (
            self.depends_on_momentum and integrator.separable_only)


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

    wrap: Callable
    repeats: ClassVar[bool] = False

    @staticmethod
    def inner_step(integrator: Integrator) -> Callable | tuple[Callable, Callable]:
        """Return what ``wrap`` takes of a method: its step."""
        return integrator.step


def coordinate_index(coordinates: Sequence[Coordinate], name: str) -> int:
    """Return the place of a coordinate, or raise ValueError with the valid names."""
    names = [coordinate.name for coordinate in coordinates]
    if name not in names:
        raise ValueError(f'no coordinate {name!r}; valid coordinates: {", ".join(names)}')
    return names.index(name)


def per_coordinate(coordinates: Sequence[Coordinate], name: str, values: float | Sequence[float]
                   ) -> np.ndarray:
    """Return one number for each coordinate, shape (d,), from one for all or a list."""
    array = np.array(values, dtype=np.float64)
    if array.ndim and array.size != len(coordinates):
        raise ValueError(
            f'{name} has {array.size} values, expected 1 or one for each of the coordinates '
            f'{", ".join(coordinate.name for coordinate in coordinates)}')
    return np.broadcast_to(array, len(coordinates)).copy()
