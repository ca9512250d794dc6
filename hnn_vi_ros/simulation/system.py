# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian together with the effects that a scene lists, made ready for a method."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
import warnings

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.effects.base import Effect, EffectError, Force, Live, Potential, StepEffect
from hnn_vi_ros.effects.damping import Damping
from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.effects.holonomic_constraint import HolonomicConstraint
from hnn_vi_ros.effects.impact import Impact
from hnn_vi_ros.effects.kernels import add_forces, join_magnetic_field, join_potential
from hnn_vi_ros.effects.learned_dissipation import LearnedDissipation
from hnn_vi_ros.effects.magnetic_field import MagneticField
from hnn_vi_ros.effects.manifold import Manifold
from hnn_vi_ros.effects.thermostat import Thermostat
from hnn_vi_ros.effects.wrapped import Account, Wrapped
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.base import Integrator, NO_SOLUTION, REASONS, REDUNDANT
from hnn_vi_ros.integrators.composition import Composition
from hnn_vi_ros.kernels.kernel import Kernel
import numpy as np

_KINDS = {effect: kind for kind, effect in EFFECTS.items()}


class JoinedHamiltonian(Hamiltonian):
    """
    A Hamiltonian with potentials and magnetic fields joined to it.

    Parameters
    ----------
    base : Hamiltonian
        H without them.
    joined : sequence of (Effect, tuple)
        Potential or MagneticField, each with its resolved parameters.

    """

    def __init__(self, base: Hamiltonian, joined: Sequence[tuple[Effect, tuple]]):
        self.base, self._joined = base, joined
        self.coordinates = base.coordinates
        self.separable = base.separable and all(
            isinstance(effect, Potential) for effect, _ in joined)

    @property
    def invariants(self) -> Mapping[str, Callable[[np.ndarray, np.ndarray], float]]:
        """Return what is watched of the motion."""
        return self.base.invariants

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the box in which the base was learned."""
        return self.base.box

    @cached_property
    def gauge(self) -> np.ndarray | None:
        """Return that of the magnetic fields that are joined; see Live."""
        gauge = np.zeros((self.dimension, self.dimension))
        for effect, parameters in self._joined:
            if isinstance(effect, MagneticField):
                x, y, b = parameters
                gauge[x, y] -= b
                gauge[y, x] += b
        return gauge if gauge.any() else None

    @property
    def smooth(self) -> bool:
        """Tell whether the gradient of the base is continuous."""
        return self.base.smooth

    @property
    def provenance(self) -> dict[str, str]:
        """Return what identifies the data behind the base."""
        return self.base.provenance

    @property
    def scheme(self) -> tuple[str, float] | None:
        """Return the method and step size [s] of the base."""
        return self.base.scheme

    def twin(self) -> 'JoinedHamiltonian':
        """Return the same function with working memory of its own."""
        return JoinedHamiltonian(self.base.twin(), self._joined)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        kernel = self.base.kernel
        for effect, parameters in self._joined:
            if isinstance(effect, MagneticField):
                kernel = join_magnetic_field(kernel, parameters)
            else:
                kernel = join_potential(kernel, type(effect), parameters)
        return kernel


class System:
    """
    What a simulation of some effects compiles; without effects, H and the method themselves.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of d coordinates.
    effects : sequence of Effect
        In the scene's order.
    integrator : Integrator
        The method.

    Attributes
    ----------
    hamiltonian : Hamiltonian
        H with the potentials joined.
    kernel : Kernel
        That of H, with the forces.
    method, integrator : Integrator
        The method, by itself and with what acts around its steps.
    live : Live
        What the effects keep from step to step.
    labels : list of str
        A name for each effect: its kind, with its place where that stands more than once.
    conservative : bool
        Whether no effect does work.
    lockstep : bool
        Whether several trajectories can step together.

    Raises
    ------
    EffectError
        An effect names an unknown coordinate, or does not combine with another.
    UnsupportedSystem
        The method cannot take an effect or the Hamiltonian; names those that can.

    """

    def __init__(self, hamiltonian: Hamiltonian, effects: Sequence[Effect],
                 integrator: Integrator):
        self._effects, self.method = list(effects), integrator
        self.live = Live.empty(len(effects), hamiltonian.dimension)
        # An effect of the user's own goes by the name of its class.
        kinds = [_KINDS.get(type(effect), type(effect).__name__) for effect in effects]
        self.labels = [kind if kinds.count(kind) == 1 else f'{kind}_{index}'
                       for index, kind in enumerate(kinds)]
        self.conservative = all(effect.conservative for effect in effects)
        self.lockstep = integrator.goes_on_from_state and not self._all(
            Thermostat, HolonomicConstraint, Impact)
        if not hamiltonian.canonical:
            self._check_coordinates(hamiltonian, integrator)
        self._check(integrator)
        self._parameters = [self._resolve(index, hamiltonian) for index in range(len(effects))]
        joined = [(effects[i], self._parameters[i]) for i in self._all(Potential, MagneticField)]
        self.hamiltonian = JoinedHamiltonian(hamiltonian, joined) if joined else hamiltonian
        integrator.check(self.hamiltonian)
        if not hamiltonian.smooth:
            warnings.warn(
                'the gradient of H jumps, as that of every relu network does: no method keeps its '
                'order there, and implicit steps may find no solution; train with another '
                'activation', stacklevel=3)
        forces = self._forces(integrator)
        self._assemble(integrator, forces, [
            i for i in self._all(StepEffect, HolonomicConstraint) if i not in forces])

    @property
    def takes_commands(self) -> bool:
        """Whether there is an external force."""
        return bool(self._all(ExternalForce))

    def command(self, values: Sequence[float]) -> None:
        """Set the external force, or raise ValueError and leave it as it is."""
        if not self.takes_commands:
            raise ValueError('no effect of the scene is an external_force: it takes no commands')
        for index in self._all(ExternalForce):
            self._effects[index].take(values, self._parameters[index])

    def check_state(self, q: np.ndarray, p: np.ndarray) -> None:
        """
        Raise ValueError if a state, of shape (d,) or (m d,), is behind a wall or off its rods.

        Also for m > 1 trajectories together, where an effect takes only one.
        """
        if not self.lockstep and q.size > self.hamiltonian.dimension:
            raise ValueError('q and p are several states, but thermostat, impact, '
                             'holonomic_constraint and time_transformed take one at a time; use '
                             'simulate_many')
        for index in self._all(Damping, Thermostat):
            self._effects[index].check_state(self.hamiltonian, q)
        for index in self._all(Impact):
            self._effects[index].check_state(self._parameters[index], q)
        if self._manifold is not None:
            self._manifold.check_state(q, p)

    def reason(self, outcome: int) -> str:
        """Return why a step failed."""
        if outcome == NO_SOLUTION:
            return self.method.no_solution
        return f'{self._manifold.dependent}: {REASONS[outcome]}' if outcome == REDUNDANT else \
            REASONS[outcome]

    def _all(self, *kinds: type[Effect]) -> list[int]:
        return [i for i, effect in enumerate(self._effects) if isinstance(effect, kinds)]

    def _forces(self, integrator: Integrator) -> list[int]:
        """Return the effects that the method takes at its nodes."""
        return [i for i in self._all(Force) if not self._effects[i].splits(integrator)]

    def _check(self, integrator: Integrator) -> None:
        for single in (ExternalForce, Thermostat):
            if len(self._all(single)) > 1:
                raise EffectError(self._all(single)[1],
                                  f'a scene takes one {_KINDS[single]} only; join the two')
        if self._all(HolonomicConstraint):
            for index in self._all(Thermostat, Impact):
                raise EffectError(index, f'{_KINDS[type(self._effects[index])]} does not combine '
                                         'with holonomic_constraint, off which its impulses would '
                                         'lead; leave one of them out')
            for index in self._all(LearnedDissipation):
                raise EffectError(index, 'learned_dissipation does not combine with '
                                         'holonomic_constraint, whose force would do work where '
                                         'the velocity is not H_p; leave one of them out')
        for effect, label in zip(self._effects, self.labels, strict=True):
            if not effect.accepts(integrator):
                name = _name(integrator)
                able = [key for key, method in INTEGRATORS.items()
                        if method.uses_hamiltonian and method.takes_canonical
                        and effect.accepts(method())]
                if isinstance(integrator, Composition):
                    name += f' over {integrator.base.kernel_name}'
                raise UnsupportedSystem(f'{name} cannot take the effect {label}; methods that '
                                        f'can: {", ".join(able)}')

    def _check_coordinates(self, hamiltonian: Hamiltonian, integrator: Integrator) -> None:
        names = ', '.join(coordinate.name for coordinate in hamiltonian.coordinates)
        if integrator.canonical_only:
            raise UnsupportedSystem(
                f'{_name(integrator)} needs canonical coordinates, which those of this model '
                f'({names}) are not: its steps, those of eq. (6) too, would keep another 2-form '
                'than the one it learned; use variational_midpoint, or to compare with: '
                'explicit_euler, rk4, dop853')
        if self._effects:
            raise EffectError(0, f'{self.labels[0]} acts on canonical momenta, which those of '
                                 f'this model ({names}) have not; leave all effects out, or '
                                 'simulate a model of another family')

    def _resolve(self, index: int, hamiltonian: Hamiltonian) -> tuple:
        try:
            return self._effects[index].resolve(hamiltonian.coordinates, self.live)
        except ValueError as problem:
            raise EffectError(index, str(problem)) from problem

    def around(self, integrator: Integrator) -> Integrator:
        """
        Return another method with the same effects in its steps and around them.

        Raises
        ------
        UnsupportedSystem
            It cannot take one of them; names it.

        """
        for effect, label in zip(self._effects, self.labels, strict=True):
            if not effect.accepts(integrator):
                raise UnsupportedSystem(f'on_failure: {type(integrator).__name__} cannot take the '
                                        f'effect {label}; use on_failure: substep or stop')
        return self._wrapped(integrator)

    def _assemble(self, integrator: Integrator, forces: list[int], around: list[int]) -> None:
        """Make the kernel and the method."""
        self.kernel, self._taken, self._around = self.hamiltonian.kernel, forces, around
        if forces:
            self.kernel = add_forces(self.kernel, [self._effects[i] for i in forces],
                                     [self._parameters[i] for i in forces], self.live)
        rods = self._all(HolonomicConstraint)
        self._manifold = Manifold(
            [(i, self.labels[i], self._parameters[i]) for i in rods], self.kernel,
            len(self._effects)) if rods else None
        self.integrator = self._wrapped(integrator)

    def _wrapped(self, integrator: Integrator) -> Integrator:
        """Wrap a method: bath inside, then flows, rods, walls, and the account."""
        rods, walls = self._all(HolonomicConstraint), self._all(Impact)
        flows = [i for i in self._around if i not in rods + walls + self._all(Thermostat)]

        def wrap(i: int, settings: tuple) -> None:
            nonlocal integrator
            integrator = Wrapped(integrator, type(self._effects[i]), (settings, self.live, i))

        for i in self._all(Thermostat) + flows:
            wrap(i, self._parameters[i])
        if self._manifold is not None:
            integrator = Wrapped(integrator, self._manifold.kind,
                                 (self._manifold.constraints, self.live, rods[0]))
        for i in walls:
            wrap(i, self._parameters[i])
        if self._taken or self._around:
            integrator = Wrapped(
                integrator, Account, (self.live, np.array(self._taken, dtype=np.int64)))
        return integrator


def _name(integrator: Integrator) -> str:
    """Return the name of a method in a scene."""
    return next((key for key, method in INTEGRATORS.items() if type(integrator) is method),
                type(integrator).__name__)
