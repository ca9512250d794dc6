# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions cut into windows, and models with free numbers that predict them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple, Protocol

from hnn_vi_ros.effects import Effect, PeriodicDrive
from hnn_vi_ros.errors import DataError, HnnViRosError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.learning.data.motions import EvenMotion
import numpy as np


class CannotFollow(DataError):
    """A model that cannot be simulated through the windows from its initial values."""


# Place of the delay of the input [s], which belongs to no part of a model.
DELAY = 'input_delay'


def delays(place: str) -> bool:
    """Return True if a number changes the inputs: DELAY, a servo's, or its rate limit."""
    return place == DELAY or (place.startswith('effects.') and place.endswith(
        ('.delay', '.rate_limit')))


@dataclass(frozen=True)
class Number:
    """
    A number to be identified.

    Parameters
    ----------
    name : str
        Name as given by the user.
    place : str
        Place in the model, such as that in a scene; or DELAY.
    unit : str
        Unit, '' if unknown.
    start, low, high : float
        Initial guess and bounds.
    size : float, optional
        Usual size; default: that of the initial guess.
    closed : bool
        True if the model accepts the bounds themselves.

    """

    name: str
    place: str
    unit: str
    start: float
    low: float = -math.inf
    high: float = math.inf
    size: float | None = None
    closed: bool = False


class ModelParts(NamedTuple):
    """
    Parts that simulate a model.

    Parameters
    ----------
    hamiltonian, integrator, effects, on_failure
        See Simulation.
    step_size : float
        Largest step [s]; a whole number of steps fits between samples.
    delay : float
        Delay of the measured forces [s].

    """

    hamiltonian: Hamiltonian
    integrator: Integrator
    effects: Sequence[Effect]
    step_size: float
    on_failure: str = 'stop'
    delay: float = 0.0


class ParametricModel(Protocol):
    """A model with free numbers: a scene, or a rigid body of training."""

    @property
    def name(self) -> str:
        """Return the name for messages."""

    @property
    def numbers(self) -> Sequence[Number]:
        """Return the n free numbers."""

    def parts_at(self, values: np.ndarray) -> ModelParts:
        """Return the parts at values of the numbers, (n,), or raise HnnViRosError."""


def refusals(model: ParametricModel, values: np.ndarray, steps: np.ndarray) -> dict[int, str]:
    """Return why a model refuses numbers that are within their bounds a step away, by index."""
    found = dict[int, str]()
    for k, number in enumerate(model.numbers):
        for value in (values[k] - steps[k], values[k] + steps[k]):
            if number.low <= value <= number.high:
                try:
                    model.parts_at(np.where(np.arange(len(values)) == k, value, values))
                except HnnViRosError as reason:
                    found[k] = str(reason)
    return found


class KnownModel(NamedTuple):
    """A model without free numbers; see ParametricModel."""

    name: str
    parts: ModelParts
    numbers: Sequence[Number] = ()

    def parts_at(self, values: np.ndarray) -> ModelParts:
        """Return the parts."""
        return self.parts


# Tolerance in steps: sample times further from whole steps would shift the phase of a drive.
_OFF_GRID = 0.01


def check_times(effects: Sequence[Effect], motions: Sequence[EvenMotion], h: float) -> None:
    """Raise DataError if samples do not fall on whole steps, which would shift a drive's phase."""
    if any(isinstance(effect, PeriodicDrive) for effect in effects):
        for motion in motions:
            off = abs(motion.t[0] / h - round(motion.t[0] / h))
            if off > _OFF_GRID:
                raise DataError(f'{motion.name}: begins at {motion.t[0]:.9g} s, which is not a '
                                f'multiple of the step {h:g} s with which the drive of the scene '
                                'counts time; shift the times')


# Time-out of the external force, which gets a value at every step [s]; an effect that has it is
# taken as it is.
FOREVER = 1e9


class MeasuredColumns(NamedTuple):
    """
    Coordinates that were measured, and what is known of the others.

    Parameters
    ----------
    columns : np.ndarray of int, shape (k,)
        Columns of the measured coordinates.
    rest : np.ndarray, shape (2, d)
        Coordinates and velocities from which the search of the others begins.
    spread : np.ndarray, shape (d,)
        Size of the coordinates' motion; 0 for one that needs no search.
    rotors : sequence of (int, int)
        Columns of rotors that were not measured, and of their joints, where they begin.

    """

    columns: np.ndarray
    rest: np.ndarray
    spread: np.ndarray
    rotors: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True, eq=False)
class Windows:
    """
    Pieces of measured motions, each starting at an unknown state.

    Parameters
    ----------
    motions : sequence of EvenMotion
        Motions, which have the same sampling interval.
    run, first : np.ndarray of int, shape (W,)
        Run and first sample of each window.
    measured : np.ndarray, shape (W, T, C)
        Measured coordinates, then their velocities if they were measured.
    there : np.ndarray of bool, shape (W, T)
        Mask of the samples in each window, since windows differ in length.
    start : np.ndarray, shape (W, 2, d)
        Smoothed coordinates and velocities at the first samples; those of
        ``MeasuredColumns.rest`` if they were not measured.
    columns : np.ndarray of int, shape (k,)
        Columns of the measured coordinates.

    """

    motions: Sequence[EvenMotion]
    run: np.ndarray
    first: np.ndarray
    measured: np.ndarray
    there: np.ndarray
    start: np.ndarray
    columns: np.ndarray

    @property
    def rates(self) -> bool:
        """Return True if velocities were measured."""
        return self.measured.shape[2] > len(self.columns)

    @property
    def spacing(self) -> float:
        """Return the time between samples [s]."""
        return self.motions[0].spacing

    @property
    def times(self) -> np.ndarray:
        """Return the start time of each window [s], shape (W,)."""
        return np.array([self.motions[run].t[first]
                         for run, first in zip(self.run, self.first, strict=True)])


def windows_in(windows: Windows, rows: np.ndarray) -> Windows:
    """Return some of the windows."""
    return replace(windows, **{name: getattr(windows, name)[rows] for name in (
        'run', 'first', 'measured', 'there', 'start')})


def cut_windows(motions: Sequence[EvenMotion], horizon: float, seen: MeasuredColumns | None = None
                ) -> Windows:
    """
    Cut runs into windows whose lengths are as equal as whole samples allow.

    Parameters
    ----------
    motions : sequence of EvenMotion
        Measured motions.
    horizon : float
        Maximum length of a window [s]; each one has at least two samples.
    seen : MeasuredColumns, optional
        The measured coordinates; by default all.

    """
    most = max(2, int(horizon / motions[0].spacing * (1.0 + 1e-9)) + 1)
    return _windows_of(motions, [
        (run, part) for run, motion in enumerate(motions) for part in np.array_split(
            np.arange(len(motion.t)), math.ceil(len(motion.t) / most))], seen)


def windows_at(motions: Sequence[EvenMotion], starts: Sequence[tuple[int, int]], count: int
               ) -> Windows:
    """Return windows of `count` intervals, or up to a run's end, from samples (run, first)."""
    return _windows_of(motions, [
        (run, np.arange(first, min(first + count + 1, len(motions[run].t))))
        for run, first in starts], None)


def refined(windows: Windows, motions: Sequence[EvenMotion]) -> Windows:
    """Return the same windows with all samples instead of every n-th."""
    every, pieces = round(windows.spacing / motions[0].spacing), []
    for run, first in enumerate(windows.first[windows.run == run] for run in range(len(motions))):
        pieces += [(run, part) for part in np.split(
            np.arange(len(motions[run].t)), every * first[1:])]
    return _windows_of(motions, pieces, None)


def _windows_of(motions: Sequence[EvenMotion], pieces: Sequence[tuple[int, np.ndarray]],
                seen: MeasuredColumns | None) -> Windows:
    """Return windows of given samples of runs."""
    longest = max(len(part) for _, part in pieces)
    channels = [motion.measured for motion in motions]
    measured = np.zeros((len(pieces), longest, channels[0].shape[1]))
    there = np.zeros((len(pieces), longest), dtype=bool)
    for w, (run, part) in enumerate(pieces):
        measured[w, :len(part)] = channels[run][part]
        there[w, :len(part)] = True
    first = np.array([part[0] for _, part in pieces])
    columns = np.arange(motions[0].q.shape[1]) if seen is None else seen.columns
    start = np.zeros((len(pieces), 2, len(columns))) if seen is None else np.tile(
        seen.rest, (len(pieces), 1, 1))
    start[:, :, columns] = [[motions[run].q_smooth[part[0]], motions[run].v_smooth[part[0]]]
                            for run, part in pieces]
    for rotor, joint in () if seen is None else seen.rotors:
        start[:, :, rotor] = start[:, :, joint]
    return Windows(motions, np.array([run for run, _ in pieces]), first, measured, there, start,
                   columns)
