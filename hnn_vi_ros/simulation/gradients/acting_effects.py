# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects that do work in differentiable runs: forces, commands and damping."""

from collections.abc import Sequence
import math
from typing import Any

from hnn_vi_ros.effects import (
    Effect, effect_name, EFFECTS, Force, Joined, NUMBERS, per_coordinate, Place)
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.simulation.gradients.stages import Acting
from hnn_vi_ros.simulation.state import State
from hnn_vi_ros.simulation.system import System
import numpy as np


class ActingEffects:
    """
    Effects of a system that do work, inside its steps and around them.

    Parameters
    ----------
    system : System
        System of H with all effects.
    hamiltonian : Hamiltonian
        Hamiltonian of d coordinates.
    effects : sequence of Effect
        All effects.
    h : float
        Step size [s].

    Raises
    ------
    UnsupportedSystem
        The combination of effects is not differentiable.

    """

    def __init__(self, system: System, hamiltonian: Hamiltonian, effects: Sequence[Effect],
                 h: float):
        self.rates = flow_rates(hamiltonian, system.method, effects)
        if system.effect_state.gauge.any() and self.rates.any():
            raise UnsupportedSystem('the effect damping is not differentiable yet in magnetic '
                                    'fields; remove one of them')
        self._system, self._h, self._channels = system, h, system.kernel.channels
        self.internal = system.kernel.internal
        # Channels of internal variables keep these; all others are reset.
        kept = np.arange(self._channels) < self.internal
        self._flow = np.concatenate([
            np.ones(len(self.rates)), kept,
            np.exp(-0.5 * h * self.rates), np.zeros(self._channels)])
        # Channels with the absolute time: the others count from the start of the step.
        self.timed = np.concatenate([
            ~kept[:self.internal], [not effect.internal for effect in effects
                                    if effect.place(system.method) is Place.NODES],
            [True] * (hamiltonian.time is not None)])
        self.any = self._channels > 0 or bool(self.rates.any())
        # True if commands do more than add forces on coordinates.
        self.feels = system.motors.size > 0 and any(
            getattr(effect, 'feels_command', False) for effect in effects)
        timeouts = [effect.timeout for effect in effects if hasattr(effect, 'timeout')]
        self._timeout, self._effects = min(timeouts, default=np.inf), effects

    def check_commands(self, commands: np.ndarray, every: int) -> None:
        """Check that `commands`, shape (..., c), fit the effects and can hold `every` steps."""
        if NUMBERS not in self._system.motors.takes:
            raise UnsupportedSystem('no effect of the scene accepts commands; add external_force '
                                    'with its coordinates')
        if commands.shape[-1] != self._system.motors.size:
            raise ValueError(f'commands have {commands.shape[-1]} numbers per row, expected '
                             f'{self._system.motors.size}')
        if every * self._h > self._timeout * (1.0 + 1e-9):
            raise ValueError(f'each command is held for {every * self._h:g} s, but timeout = '
                             f'{self._timeout:g} s of external_force is shorter; increase it')

    def acting(self, times: np.ndarray, commands: np.ndarray) -> Acting:
        """Return the inputs of effects in steps at times, (K, m), under commands, (K, m, c)."""
        state = self._system.effect_state
        state.step[:] = self._h
        rows = np.zeros((*times.shape, state.command.size))
        if commands.shape[-1]:
            rows[..., :-1], rows[..., -1] = commands @ self._system.places, np.inf
        else:
            state.command[:] = 0.0
            self._system.motors.begin()
            rows[:] = state.command
        none = np.zeros((0, *times.shape[1:], self._flow.size, self._flow.size))
        return Acting(state.clock, state.command, times, rows, self._flow, none, none)

    def padded(self, states: np.ndarray, internal: np.ndarray | None = None) -> np.ndarray:
        """
        Return states, shape (..., 2 d), extended by the channels of forces to (..., 2 D).

        Internal variables, shape (m, number of them), belong to the first of states (K, m, 2 d).
        """
        if not self._channels:
            return states
        q, p = np.split(states, 2, axis=-1)
        channels = np.zeros((*states.shape[:-1], self._channels))
        both = np.concatenate([q, channels, p, channels], axis=-1)
        if internal is not None:
            both[0, :, q.shape[-1]:q.shape[-1] + self.internal] = internal
        return both

    def internal_of(self, rows: np.ndarray, state: State) -> np.ndarray:
        """Return the internal variables in rows, (m, R), of a simulation's state."""
        effects = [i for i, effect in enumerate(self._effects) if effect.internal]
        return rows[:, state.column('live.resting') + np.array(effects, dtype=int)]

    def cut(self, states: np.ndarray) -> np.ndarray:
        """Return states without channels."""
        q, p = np.split(states, 2, axis=-1)
        d = len(self.rates)
        return np.concatenate([q[..., :d], p[..., :d]], axis=-1) if self._channels else states

    def flowed(self, states: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """
        Return the change of states around steps with damping rates, shape (K, 2, m, 2 D).

        Parameters
        ----------
        states : np.ndarray, shape (K + 1, m, 2 D)
            States before and after each of K steps.
        rates : np.ndarray, shape (d,)
            Change of each rate.

        """
        channels = np.zeros(self._channels)
        per_momentum = np.concatenate([np.zeros(len(rates)), channels, rates, channels])
        half = np.stack([states[:-1] * self._flow, states[1:]], axis=1)
        return -0.5 * self._h * half * per_momentum


def flow_rates(hamiltonian: Hamiltonian, integrator: Integrator, effects: Sequence[Effect]
               ) -> np.ndarray:
    """Return the damping rates of the momenta, applied around steps, shape (d,) [1/s]."""
    rates = np.zeros(hamiltonian.dimension)
    for effect in effects:
        if effect.place(integrator) is Place.AROUND and hasattr(effect, 'rate'):
            rates += per_coordinate(hamiltonian.coordinates, 'rate', effect.rate)
    return rates


def check_effects(effects: Sequence[Effect], integrator: Integrator) -> None:
    """Raise UnsupportedSystem, naming differentiable effects, if an effect is not one of them."""
    for effect in effects:
        place = effect.place(integrator)
        if getattr(effect, 'gravity_compensation', None):
            raise UnsupportedSystem(f'{effect_name(effect)}: its gravity_compensation is not '
                                    'differentiable yet; remove it')
        if place is Place.ENERGY or (place is Place.NODES and _is_known(type(effect))):
            continue
        if type(effect) is not EFFECTS['damping'] or place is not Place.AROUND:
            able = ', '.join(name for name, kind in EFFECTS.items()
                             if issubclass(kind, Joined) or _is_known(kind))
            raise UnsupportedSystem(f'the effect {effect_name(effect)} is not differentiable yet; '
                                    f'effects that are: {able}; remove others')


def on_numbers(effects: Sequence[Effect]) -> list[Effect]:
    """Return effects whose servo is commanded by plain numbers, unless other effects are."""
    servo: Any = next((one for one in effects if type(one) is EFFECTS['servo']), None)
    if servo is None or any(NUMBERS in getattr(one, 'takes', ()) for one in effects):
        return [*effects]
    if servo.delay or servo.rate_limit < math.inf:
        raise UnsupportedSystem('servo: its delay and its rate limit are not differentiable; '
                                'remove them, and delay or limit the commands')
    taken = servo.on_numbers()
    return [taken if one is servo else one for one in effects]


def _is_known(kind: type) -> bool:
    """Return whether a force depends only on time, state and numeric commands."""
    return issubclass(kind, Force) and (kind.knots == 0 or kind is EFFECTS['servo'])
