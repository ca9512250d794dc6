# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The members of an ensemble as companions of its mean, and their spread."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
import math
from pathlib import Path
from typing import Any, cast, Protocol
import warnings

from hnn_vi_ros.effects import Command
from hnn_vi_ros.errors import AlarmWarning, SceneError, StateError, StepFailure
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum
from hnn_vi_ros.models import Checkpoint, ConfinedHamiltonian, EnsembleCard, FAMILIES
from hnn_vi_ros.scene import Parts, Scene
from hnn_vi_ros.simulation import build, changed_parts, simulate, Simulation, Trajectory
import numpy as np


class Companion(Protocol):
    """Companion of a simulation; it raises no errors that would disturb the simulation."""

    def advance(self, n: int) -> None:
        """Take the same number of steps as the simulation."""

    def set_command(self, command: Command) -> None:
        """Set a command that the simulation has accepted."""

    def begin(self, simulation: Simulation) -> None:
        """Restart from the state of the simulation, at its step."""


def with_companions(simulation: Simulation, companions: Sequence[Companion]) -> Simulation:
    """Return the simulation wrapped with its companions; unchanged if there are none."""
    return cast(Simulation, AccompaniedSimulation(simulation, companions)) \
        if companions else simulation


class AccompaniedSimulation:
    """
    A simulation with companions, which take the same steps and the same commands.

    Parameters
    ----------
    simulation : Simulation
        The simulation; attributes that are not listed below are forwarded to it.
    companions : sequence of Companion
        Its companions.

    """

    def __init__(self, simulation: Simulation, companions: Sequence[Companion]):
        self._simulation, self._companions = simulation, companions
        self._begin()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def advance(self, n: int, until: float = math.inf) -> int:
        """Take n steps or fewer and return the number taken, or raise; see Simulation."""
        taken = self._simulation.advance(n, until)
        for companion in self._companions:
            companion.advance(taken)
        return taken

    def set_command(self, command: Command) -> None:
        """Set a command, or raise ValueError and change nothing; see Simulation."""
        self._simulation.set_command(command)
        for companion in self._companions:
            companion.set_command(command)

    def restart(self, *arguments: Any, **more: Any) -> None:
        """Restart; see Simulation."""
        self._simulation.restart(*arguments, **more)
        self._begin()

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Restore a snapshot; companions restart from its state."""
        self._simulation.restore(snapshot)
        self._begin()

    def _begin(self) -> None:
        for companion in self._companions:
            companion.begin(self._simulation)


@dataclass(frozen=True)
class SpreadTrajectory:
    """
    The trajectories of the mean of an ensemble and of its members.

    Parameters
    ----------
    mean : Trajectory
        Trajectory of the mean Hamiltonian.
    members : tuple of Trajectory
        Trajectory of each member from the same initial state. If members have their own
        momenta, they start from the same q and q', with their own p and energy.
    spread_q, spread_p : np.ndarray, shape (n, d)
        Half-widths of the bands around q and p of the mean: the standard deviation over the
        members times the factors of the card (1 without a calibration). Here p is the momentum
        of the mean for a member's q and q'. Infinite from the failure of a member on.
    level : float or None
        Share of errors that the bands cover in motions like those of the calibration; None
        without a calibration.

    """

    mean: Trajectory
    members: tuple[Trajectory, ...]
    spread_q: np.ndarray
    spread_p: np.ndarray
    level: float | None


def ensemble_card(parts: Parts) -> EnsembleCard:
    """
    Return the card of the ensemble whose mean is the Hamiltonian of a scene.

    Raises
    ------
    ModelError, SceneError
        The Hamiltonian is not the mean of an ensemble.

    """
    scene, hamiltonian, *_ = parts
    if isinstance(hamiltonian, ConfinedHamiltonian):
        raise SceneError(f'{scene.place("hamiltonian")}: each member is confined to its training '
                         'domain by its own walls, so that the spread is meaningless; set '
                         'confine: false')
    card = getattr(getattr(hamiltonian, 'checkpoint', None), 'card', None)
    if card is None or card.ensemble is None or getattr(scene.hamiltonian, 'member', None):
        raise SceneError(f'{scene.place("hamiltonian")}: is not the mean of an ensemble, whose '
                         'members could diverge; name the file of an ensemble, from train '
                         '--ensemble N, without member')
    return card.ensemble


def member_scenes(scene: Scene, count: int) -> list[Scene]:
    """
    Return the scene with the mean replaced by each of the first members of its ensemble.

    Effects with friction or an input map from the same file are replaced too. Initial states
    remain the mean's; see ``members_of``.
    """
    choice, files = scene.hamiltonian.model_dump(), scene.model_files()

    def effect_of(effect: Any, k: int) -> dict[str, Any]:
        found: dict[str, Any] = effect.model_dump()
        name, whole = found.get('model'), found.get('member', 0) is None
        if whole and name is not None and files[name] == files[choice['model']]:
            found['member'] = k
        return found
    return [scene.changed({
        'hamiltonian': {**choice, 'member': k}, 'uncertainty': None, 'events': [],
        'effects': [effect_of(effect, k) for effect in scene.effects]})
        for k in range(1, count + 1)]


def members_of(parts: Parts) -> list[Parts]:
    """Return the parts of each member; if it has its own momenta, p is that of the same q'."""
    scene, count = parts.scene, len(ensemble_card(parts).members)
    members = [own.parts() for own in member_scenes(scene, count)]
    if measured_momenta(parts.hamiltonian):
        return members
    mean, state = build(parts).hamiltonian, scene.initial_state
    q, p = np.array(state.q), np.array(state.p)
    return [own._replace(scene=own.scene.changed({'initial_state': {'q': state.q, 'p': (
        same_velocity(mean, build(own).hamiltonian, q, p).tolist())}})) for own in members]


def measured_momenta(hamiltonian: Hamiltonian) -> bool:
    """Return True if the members of an ensemble have the same momenta as their mean."""
    checkpoint: Checkpoint = getattr(hamiltonian, 'checkpoint')  # noqa: B009
    return FAMILIES[checkpoint.card.family].measured_momenta


def same_velocity(of: Hamiltonian, other: Hamiltonian, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """
    Return the momenta of another Hamiltonian that give the same velocities.

    Parameters
    ----------
    of, other : Hamiltonian
        The Hamiltonian of `p`, and the one of the returned momenta.
    q, p : np.ndarray, shape (..., d)
        States of `of`.

    Raises
    ------
    StateError
        No momentum gives a velocity.

    """
    return momentum(other, q, of.gradient(q, p)[1], p)


def deviation(members: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """
    Return the standard deviation over members, (sum_k (x_k - mean)^2 / (N - 1))^(1/2).

    Parameters
    ----------
    members : array, shape (N, ...)
        Values of each member; a non-finite one makes the spread infinite.

    """
    values = np.asarray(members)
    finite = np.isfinite(values).all(axis=0)
    with np.errstate(invalid='ignore', over='ignore'):
        return np.where(finite, values.std(axis=0, ddof=1), np.inf)


def simulate_spread(scene: Scene | str | Path, duration: float, *, step_size: float | None = None,
                    integrator: str | None = None,
                    initial_state: tuple[Sequence[float], Sequence[float]] | None = None,
                    effects: Sequence[Mapping[str, Any]] | None = None, **options: Any
                    ) -> SpreadTrajectory:
    """
    Simulate the mean of an ensemble and each of its members, from one initial state.

    Parameters
    ----------
    scene : Scene, str or Path
        Scene as in ``simulate``, whose Hamiltonian is an ensemble.
    duration : float
        Simulated time [s]; an event that stops the mean also ends the members.
    step_size, integrator, initial_state, effects
        Overrides of the scene's values; see ``simulate``.
    **options
        Further arguments of ``simulate``.

    Returns
    -------
    SpreadTrajectory
        The mean, the members and the bands.

    Raises
    ------
    HnnViRosError, ValueError, TypeError
        As in ``simulate``, or the Hamiltonian is not the mean of an ensemble. A member whose
        step fails does not raise: the bands are infinite from there on.

    """
    parts = changed_parts(scene, step_size, integrator, initial_state, effects)
    card = ensemble_card(parts)
    mean, own = simulate(parts, duration, **options), members_of(parts)
    if parts.scene.events:
        # An event may have ended the mean early.
        duration = min(duration, float(mean.t[-1]))
        options |= {'times': mean.t} if 'times' in options else {}
    with warnings.catch_warnings():
        # The mean raises all alarms; the bands show members that leave the box.
        warnings.simplefilter('ignore', AlarmWarning)
        members = [_or_nan(partial(simulate, one, duration, **options), mean) for one in own]
    of_q, of_p = np.split(np.array(card.factors or [1.0, 1.0]), 2)
    momenta = [one.p for one in members]
    if not measured_momenta(parts.hamiltonian):
        whole = build(parts).hamiltonian
        momenta = [_mean_momenta(whole, build(made).hamiltonian, one)
                   for made, one in zip(own, members, strict=True)]
    return SpreadTrajectory(
        mean, tuple(members), of_q * deviation([one.q for one in members]),
        of_p * deviation(momenta), card.level if card.factors else None)


def _mean_momenta(mean: Hamiltonian, member: Hamiltonian, found: Trajectory) -> np.ndarray:
    """Return the momenta of the mean for the velocities of a member; NaN if it failed."""
    if not np.isfinite(found.p).all():
        return found.p
    return same_velocity(member, mean, found.q, found.p)


def _or_nan(simulated: Callable[[], Trajectory], like: Trajectory) -> Trajectory:
    """Return the trajectory; one of NaN if the simulation failed."""
    try:
        return simulated()
    except StepFailure:
        return replace(like, q=np.full_like(like.q, np.nan), p=np.full_like(like.p, np.nan),
                       energy=np.full_like(like.energy, np.nan))


class Members:
    """
    The members of the ensemble of a scene; see Companion.

    A member whose step fails stops there, and the spread becomes infinite. If members have their
    own momenta, p = M_k(q) q', they start at q and q' of the mean. The spread then compares q and
    the momenta of the mean for q and q'.

    Parameters
    ----------
    parts : Parts
        Parts of a scene whose Hamiltonian is the mean of an ensemble.

    Attributes
    ----------
    count : int
        Number of members.
    factors : np.ndarray, shape (2 d,), or None
        Factors on the standard deviations of q, then of p; None if the card has none.
    level : float or None
        Share of errors that these bands cover; None if the card has no factors.

    Raises
    ------
    SceneError
        The Hamiltonian is not the mean of an ensemble.

    """

    def __init__(self, parts: Parts):
        card = ensemble_card(parts)
        self.count = len(card.members)
        self.factors = None if card.factors is None else np.array(card.factors)
        self.level = card.level if card.factors else None
        with warnings.catch_warnings():
            # The mean has already raised the warnings about the scene.
            warnings.simplefilter('ignore')
            self._simulations = [build(own) for own in members_of(parts)]
            # All members have the same type, so that compiling one compiles all.
            self._simulations[0].compile()
            self._simulations[0].compile_rescue()
            self._mean = None if measured_momenta(parts.hamiltonian) else \
                build(parts.copy()).hamiltonian
        if self._mean is not None:
            self._mean.compile()
            self._simulations[0].hamiltonian.compile()
        self._failed: set[int] = set()

    def advance(self, n: int) -> None:
        """See Companion."""
        for k, simulation in enumerate(self._simulations):
            if k not in self._failed:
                try:
                    simulation.advance(n)
                except StepFailure:
                    self._failed.add(k)

    def set_command(self, command: Command) -> None:
        """See Companion."""
        for simulation in self._simulations:
            simulation.set_command(command)

    def begin(self, simulation: Simulation) -> None:
        """See Companion."""
        self._failed.clear()
        for k, own in enumerate(self._simulations):
            try:
                p = simulation.p if self._mean is None else same_velocity(
                    self._mean, own.hamiltonian, simulation.q, simulation.p)
                own.restart(simulation.q, p, step=simulation.steps)
            except (StepFailure, ValueError):
                self._failed.add(k)

    @property
    def failed(self) -> int:
        """Return the number of members that have stopped."""
        return len(self._failed)

    @property
    def spread(self) -> np.ndarray:
        """Return the half-widths of the bands of q, then of p, shape (2 d,)."""
        states = np.array([np.concatenate(self._state(one)) for one in self._simulations])
        states[list(self._failed)] = np.inf
        spread = deviation(states)
        return spread if self.factors is None else self.factors * spread

    def _state(self, own: Simulation) -> tuple[np.ndarray, np.ndarray]:
        """Return q and p of a member; own momenta are converted to the momenta of the mean."""
        if self._mean is None:
            return own.q, own.p
        try:
            return own.q, same_velocity(own.hamiltonian, self._mean, own.q, own.p)
        except StateError:
            return own.q, np.full_like(own.p, np.inf)
