# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Combination of a Hamiltonian, the effects of a scene and a method, for compilation."""

from collections.abc import Sequence
from copy import copy
from functools import cached_property
import math
from operator import attrgetter
from typing import Any, cast, NamedTuple
import warnings

from hnn_vi_ros.effects import (
    Account, add_effect, add_forces, ClosedChains, Command, Commanded, contents, CutAtKnots,
    Effect, effect_name, EffectError, EFFECTS, EffectState, EFFORT, Force, Joined, JointCommand,
    JointPath, LINK_WRENCH, LoopManifold, Manifold, NUMBERS, OBSERVATION, PAYLOAD,
    PayloadChanges, Place, ServoTarget, StepLayer, TimeDrive, with_arrays, Wrapped)
from hnn_vi_ros.errors import listed, StateError, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian, LoopRows
from hnn_vi_ros.integrators import (
    check_method, Integrator, method_name, methods_that, NO_SOLUTION, PhasePoint, REASONS,
    REDUNDANT)
from hnn_vi_ros.kernels import Block, by_address, flat, Kernel, kind_of, original, provide, Target
from hnn_vi_ros.phase_space import (
    angle_columns, check_state, columns, Coordinate, leaders, scalar_columns)
import numpy as np
from numpy.typing import ArrayLike

# Tolerance of limits for rounding, relative to the limit and to one unit.
_LIMIT_TOLERANCE = 1e-9


class Cause(NamedTuple):
    """
    An effect in an account of energy.

    Parameters
    ----------
    label : str
        Name of the effect in the scene.
    effect : Effect
        The effect.
    parameters : tuple
        The result of ``resolve``.
    place : int
        Index of its internal variable in EffectState.
    rows : dict of str to int
        Rows of its works in EffectState, by joint as in '/elbow', or by ''.

    """

    label: str
    effect: Effect
    parameters: Any
    place: int
    rows: dict[str, int]


class Motors:
    """
    Effects of a system that take commands.

    Parameters
    ----------
    effects : sequence of (Effect, tuple)
        All effects of a scene, each with the result of ``resolve``.
    coordinates : sequence of Coordinate
        Coordinates of the system.

    Attributes
    ----------
    takes : frozenset of str
        Possible contents of a command; see ``contents``.
    size : int
        Number of entries of a command of plain numbers; 0 if none is taken.
    names : sequence of str
        Names of these entries; empty if they have no names.
    effects : list of (Effect, tuple)
        The effects that take commands.

    """

    def __init__(self, effects: Sequence[tuple[Effect, Any]], coordinates: Sequence[Coordinate]):
        self._leaders, self._columns = leaders(coordinates), scalar_columns(coordinates)
        self.effects: list[tuple[Any, Any]] = [
            (effect, own) for effect, own in effects if isinstance(effect, Commanded)]
        self.takes = frozenset[str]().union(*(effect.takes for effect, _ in self.effects))
        driven = [(effect.names, own.columns.size) for effect, own in self.effects
                  if NUMBERS in effect.takes]
        self._stops: list[Any] = [own for effect, own in effects if effect.limits]
        # At most one effect takes plain numbers.
        self.names: Sequence[str] = driven[0][0] if driven else ()
        self.size: int = driven[0][1] if driven else 0

    def begin(self) -> None:
        """Apply the commands that act before the first command is set."""
        for effect, own in self.effects:
            effect.begin(own)

    def command(self, command: Command, q: np.ndarray, limited: bool = True) -> None:
        """
        Pass a command to the effects that take it.

        Parameters
        ----------
        command : Command
            Command of forces, of joints or of a path.
        q : np.ndarray, shape (d,)
            Current coordinates.
        limited : bool, optional
            Reject positions beyond the joint limits of the scene.

        Raises
        ------
        ValueError
            No effect takes the command, it is invalid, or it contains a position beyond the joint
            limits of the scene; nothing is changed.

        """
        command = with_arrays(command)
        held = contents(command)
        for content in sorted(held - self.takes):
            kind = {OBSERVATION: 'observer', NUMBERS: 'external_force', LINK_WRENCH: 'link_wrench',
                    EFFORT: 'external_force'}.get(content, 'servo')
            if content == PAYLOAD:
                raise ValueError('the scene accepts no payload: its hamiltonian has none; add '
                                 'payload: {link: LINK} to it')
            raise ValueError(f'the scene accepts no {content}: it has no {kind} of joints')
        if isinstance(command, JointCommand | JointPath):
            for i, name in enumerate(command.names):
                if name in self._leaders and (isinstance(command, JointPath) or not np.isnan(
                        [values[i] for values in command[1:]]).all()):
                    raise ValueError(f'joint {name!r} follows {self._leaders[name]!r} and takes '
                                     f'no commands; command {self._leaders[name]!r} instead')
        prepared = [effect.prepare(command, own, q) for effect, own in self.effects
                    if effect.takes & held]
        if limited and isinstance(command, JointCommand):
            self._check_limits(command.names, command.position[None])
        elif limited and isinstance(command, JointPath) and len(command.times):
            self._check_limits(command.names, command.positions)
        for put in prepared:
            put()

    def limits(self, name: str) -> tuple[float, float]:
        """Return the positions of a joint between which commands are accepted."""
        low, high = -math.inf, math.inf
        for stops in self._stops:
            mine = stops.columns == self._columns.get(name)
            for limit, sign in zip(stops.positions[mine], stops.signs[mine], strict=True):
                reach = limit - sign * _LIMIT_TOLERANCE * (1.0 + abs(limit))
                low, high = (max(low, reach), high) if sign > 0 else (low, min(high, reach))
        return low, high

    def _check_limits(self, names: Sequence[str], positions: np.ndarray) -> None:
        """Raise ValueError if positions (n, m) of m joints are beyond a stop."""
        for stops in self._stops:
            for name, wanted in zip(names, positions.T, strict=True):
                mine = stops.columns == self._columns.get(name)
                for limit, sign in zip(stops.positions[mine], stops.signs[mine], strict=True):
                    beyond = sign * (wanted - limit) < -_LIMIT_TOLERANCE * (1.0 + abs(limit))
                    if beyond.any():
                        raise ValueError(
                            f'position of {name} is {wanted[beyond.argmax()]:g}, beyond its '
                            f'{"lower" if sign > 0 else "upper"} limit {limit:g}; give a position '
                            'within the joint_limits of the scene')

    def forces(self, t: float, q: np.ndarray, p: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the generalised forces of all motors at a state, shape (d,) [N] or [N m]."""
        f_q, f_p = np.zeros((2, p.size))
        for effect, own in self.effects:
            if isinstance(effect, Force):
                effect.add_force(own, t, q, p, velocity, f_q, f_p)
        return f_p

    @property
    def servo_target(self) -> ServoTarget | None:
        """Return the current target of a servo; None if there is none."""
        targets = (effect.servo_target(own) for effect, own in self.effects)
        return next((target for target in targets if target is not None), None)


def refill(kernel: Kernel, other: Kernel) -> bool:
    """
    Replace the parameters of a kernel by address in place, with another kernel's.

    Parameters
    ----------
    kernel : Kernel
        Kernel from ``by_address``; compiled code that uses it sees the new numbers.
    other : Kernel
        Kernel of a Hamiltonian that differs only in numbers, by address or not.

    Returns
    -------
    bool
        False, with nothing changed, if more than numbers differs or `kernel` is not by address.

    """
    if not isinstance(kernel.parameters, Target):
        return False
    memory: Any = Block.of(kernel.parameters.words)
    own, other = memory.kernel, original(other)
    if own[:3] != other[:3] or own[4:] != other[4:] \
            or kind_of(own.parameters) != kind_of(other.parameters):
        return False
    kernel.parameters.words[3:] = flat(other.parameters)
    memory.kernel, memory.held = other, other.parameters
    # Update the entries that it calls by address as well.
    provide(kernel, *memory.entries)
    return True


class JoinedHamiltonian(Hamiltonian):
    """
    Hamiltonian with effects added to it, such as potentials and magnetic fields.

    Parameters
    ----------
    base : Hamiltonian
        H without effects.
    joined : sequence of (Joined, tuple)
        Effects, each with its resolved parameters.

    """

    def __init__(self, base: Hamiltonian, joined: Sequence[tuple[Joined, tuple]]):
        self.base, self._joined = base, joined
        self.coordinates, self.robot = base.coordinates, base.robot
        self.carrier = base.carrier
        self.box, self.time = base.box, base.time
        self.smooth = base.smooth and all(effect.smooth for effect, _ in joined)
        self.provenance, self.scheme = base.provenance, base.scheme
        self.separable = base.separable and all(effect.keeps_separable for effect, _ in joined)

    # Delegated to the base, since a scene may set them later.
    invariants = property(attrgetter('base.invariants'))

    @cached_property
    def gauge(self) -> np.ndarray | None:
        """Return the total gauge of the magnetic fields, None without them."""
        gauge = np.zeros((self.dimension, self.dimension))
        for effect, parameters in self._joined:
            effect.add_gauge(parameters, gauge)
        return gauge if gauge.any() else None

    def copy(self) -> 'JoinedHamiltonian':
        """Return a copy with its own working memory."""
        return JoinedHamiltonian(self.base.copy(), self._joined)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the kernel of H with the effects."""
        kernel = self.base.kernel
        for effect, parameters in self._joined:
            kernel = add_effect(kernel, effect, parameters)
        return kernel


class System:
    """
    Compiled parts of a simulation with effects; without effects, H and the method themselves.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of d coordinates.
    effects : sequence of Effect
        Effects in the order of the scene.
    integrator : Integrator
        Integration method.
    effect_state : EffectState, optional
        State of another system of the same effects, to be shared.
    by_joint : bool, optional
        True to account for the work of each joint; the last digits of states then may differ.

    Attributes
    ----------
    hamiltonian : Hamiltonian
        H including potentials.
    kernel : Kernel
        Kernel of H with the forces.
    method, integrator : Integrator
        The method alone, and wrapped in the effects around its steps.
    effect_state : EffectState
        State of the effects that persists from step to step.
    labels : list of str
        Name of each effect: its kind, with its index if the kind occurs more than once.
    conservative, batched : bool
        True if no effect does work, and if several trajectories can step together.
    commanded, layered : bool
        True if forces change between steps, by commands or at random, and if effects act around
        steps.
    unbatched : list of str
        Names of the effects and of the method due to which they cannot.
    motors : Motors
        Effects that take commands.
    constraints : Manifold, LoopManifold or None
        Holonomic constraints, or loops.
    joints : dict of int to np.ndarray
        Columns of the joints of effects whose works are accounted for by joint, by index. The
        first has the row of the effect in EffectState.work; those of the others follow all
        effects.

    Raises
    ------
    EffectError
        An effect names an unknown coordinate, or cannot be combined with another effect.
    UnsupportedSystem
        The method does not support an effect or the Hamiltonian; the message names those that do.

    """

    def __init__(self, hamiltonian: Hamiltonian, effects: Sequence[Effect],
                 integrator: Integrator, effect_state: EffectState | None = None,
                 by_joint: bool = False):
        if hamiltonian.carrier is not None:
            effects = [*effects, PayloadChanges(hamiltonian)]
        if hamiltonian.loops is not None:
            effects = [*effects, ClosedChains(hamiltonian.loops)]
        if hamiltonian.time is not None:
            effects = [*effects, TimeDrive(hamiltonian.time)]
        self._effects, self.method, self._by_joint = list(effects), integrator, by_joint
        self.effect_state = effect_state or EffectState.empty(
            len(effects) * (hamiltonian.dimension if by_joint else 1), hamiltonian.dimension,
            sum(one.knots for one in effects),
            (len(effects), 2 * hamiltonian.dimension) if any(one.stops for one in effects)
            else (0, 0))
        kinds = [effect_name(effect) for effect in effects]
        self.labels = [kind if kinds.count(kind) == 1 else f'{kind}_{index}'
                       for index, kind in enumerate(kinds)]
        self.conservative = all(effect.conservative for effect in effects)
        self.unbatched = [label for effect, label in zip(effects, self.labels, strict=True)
                          if not effect.batched]
        if not integrator.requirements.from_state:
            self.unbatched.append(method_name(integrator))
        if by_joint:
            # The works of trajectories that step together are only known in sum.
            self.unbatched.append('energy_by_cause')
        self.batched = not self.unbatched
        if not hamiltonian.canonical or hamiltonian.rotations:
            self._check_coordinates(hamiltonian, integrator)
        self._places = [effect.place(integrator) for effect in effects]
        self._cuts_at_knots = any(effect.cuts_at_knots for effect in effects)
        self.layered = self._cuts_at_knots or any(place > Place.NODES for place in self._places)
        self.commanded = any(isinstance(effect, Commanded) or effect.random for effect in effects)
        self._check_together()
        self._check(integrator, hamiltonian)
        self._parameters = [self._resolve(index, hamiltonian) for index in range(len(effects))]
        self.motors = Motors(list(zip(effects, self._parameters, strict=True)),
                             hamiltonian.coordinates)
        joined = [(cast(Joined, effects[i]), self._parameters[i]) for i in self._in(Place.ENERGY)]
        self.hamiltonian = JoinedHamiltonian(hamiltonian, joined) if joined else hamiltonian
        check_method(integrator, self.hamiltonian)
        if not self.hamiltonian.smooth:
            warnings.warn(
                'the gradient of H is discontinuous, as at a kink of abs or relu: methods lose '
                'their order there, and implicit steps may have no solution; use a smooth '
                'function, such as sqrt(x^2 + w^2) for abs(x), or train with another activation',
                stacklevel=3)
        self._assemble(integrator)

    def with_numbers(self, hamiltonian: Hamiltonian, effects: Sequence[Effect]) -> 'System | None':
        """
        Return a system with other numbers, in the memory of this one, which it replaces.

        Compiled code that uses this memory sees the new numbers.

        Parameters
        ----------
        hamiltonian, effects
            Hamiltonian and effects of the same kinds as the system's.

        Returns
        -------
        System or None
            None if they do not fit into this memory.

        """
        if not self._effects:
            # Without effects, the system is H itself.
            if not refill(self.kernel, hamiltonian.kernel):
                return None
            other = copy(self)
            other.hamiltonian = hamiltonian
            return other
        # Reset the sum that magnetic fields add to.
        self.effect_state.gauge[...] = 0.0
        other = System(hamiltonian, effects, self.method, self.effect_state, self._by_joint)
        for i, place in enumerate(self._places):
            if place > Place.NODES:
                # Assign in place, since the method refers to these arrays.
                if not _assign(self._parameters[i], other._parameters[i]):
                    return None
                other._parameters[i] = self._parameters[i]
        if other._places != self._places or other._cuts_at_knots != self._cuts_at_knots \
                or not refill(self.kernel, other.kernel):
            return None
        other.kernel, other.integrator = self.kernel, self.integrator
        if isinstance(self.constraints, LoopManifold):
            other.constraints = self.constraints  # whose arrays the method refers to
        return other

    @cached_property
    def turning(self) -> np.ndarray:
        """
        Return a mask of the columns of q that are periodic angles, shape (d,).

        They are in rad, without stops, and a full turn leaves H' unchanged at an asymmetric state.
        """
        d = self.hamiltonian.dimension
        q, p = np.cos(1.0 + np.arange(d)**2), np.sin(2.0 + np.arange(d)**2)
        # With rotations, q and p have different columns, and turns are not counted.
        turning = angle_columns(self.hamiltonian.coordinates) & (not self.hamiltonian.rotations)
        for effect, parameters in zip(self._effects, self._parameters, strict=True):
            if effect.stops:
                turning[cast(Any, parameters).columns] = False
        here = np.concatenate(self.hamiltonian.gradient(q, p)) if turning.any() else q
        for k in np.flatnonzero(turning):
            there = q + 2.0 * math.pi * (np.arange(d) == k)
            turning[k] = np.allclose(np.concatenate(self.hamiltonian.gradient(there, p)), here,
                                     rtol=0.0, atol=_LIMIT_TOLERANCE * np.abs(here).max())
        return turning

    @cached_property
    def places(self) -> np.ndarray:
        """Return the effect of each entry of a command on each coordinate, shape (c, d)."""
        held = self.effect_state.command
        before, rows = held.copy(), []
        for unit in np.eye(self.motors.size):
            held[:] = 0.0
            self.motors.command(unit, held[:-1])
            rows.append(held[:-1].copy())
        held[:] = before
        return np.array(rows).reshape(-1, held.size - 1)

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Return the arrays of the effects themselves that commands change, by name."""
        return {name: array for effect, own in self.motors.effects
                for name, array in effect.changing(own).items()}

    @property
    def cuts(self) -> int:
        """Return the number of steps cut by walls, trials included; the path has kinks there."""
        # Effects that cut steps count the cuts in their parameters.
        counts = (getattr(self._parameters[i], 'cuts', None) for i in self._in(Place.OUTSIDE))
        return sum(int(count[0]) for count in counts if count is not None)

    def check_state(self, q: ArrayLike, p: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """
        Return new arrays of a valid state, of shape (d,) or (m, d), or raise.

        Raises
        ------
        EffectError
            Constraints are dependent at the state, or a gradient differs from its function.
        StateError
            The state is not finite, behind a wall, violates constraints, has a wrong shape, or
            has several trajectories while an effect supports only one.

        """
        try:
            return self._checked(q, p)
        except EffectError:
            raise  # it has the index of the effect in the scene
        except ValueError as problem:
            raise StateError(str(problem)) from problem

    def closed(self, z: np.ndarray) -> np.ndarray:
        """Return states, shape (m, 2 d), with loops closed; raise as ``check_state`` does."""
        if isinstance(self.constraints, LoopManifold) or not self.batched:
            return np.array([np.concatenate(self.check_state(*np.split(one, 2))) for one in z])
        self.check_state(*np.split(z, 2, axis=1))
        return z

    def _checked(self, q: ArrayLike, p: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        states = check_state(q, p, self.hamiltonian.dimension, self.hamiltonian.rotations)
        flat_q, flat_p = (part.ravel() for part in states)
        if not self.batched and flat_q.size > self.hamiltonian.dimension:
            raise ValueError(f'q and p contain several states, but {", ".join(self.unbatched)} '
                             'supports one at a time; use simulate_many')
        for effect, parameters in zip(self._effects, self._parameters, strict=True):
            effect.check_state(self.hamiltonian, parameters, flat_q)
        if isinstance(self.constraints, LoopManifold):
            q, p = self.constraints.check_state(flat_q, flat_p)
            return q.reshape(states[0].shape), p.reshape(states[1].shape)
        if self.constraints is not None:
            self.constraints.check_state(flat_q, flat_p)
        return states

    def fastest_rate(self, q: np.ndarray, t: float) -> float:
        """Return the fastest rate of stiff effects at q, (d,), and t, 0 without any [rad/s]."""
        stiff = [(effect, own) for effect, own in zip(
            self._effects, self._parameters, strict=True) if effect.stiff]
        if not stiff:
            return 0.0
        inverse_mass = self.hamiltonian.inverse_mass(q, np.zeros(q.size), t)
        return max(effect.fastest_rate(own, inverse_mass) for effect, own in stiff)

    def energies(self, z: PhasePoint) -> list[float]:
        """Return H of each trajectory of a point [J]."""
        return self.kernel.energies(z.q, z.p).tolist()

    def reason(self, outcome: int) -> str:
        """Return the reason of a failed step, given its outcome."""
        if outcome == NO_SOLUTION:
            return self.method.no_solution
        if outcome == REDUNDANT and self.constraints is not None:
            return f'{self.constraints.dependent}: {REASONS[outcome]}'
        return REASONS[outcome]

    def _in(self, place: Place) -> list[int]:
        """Return the indices of the effects that act at a place, in the scene's order."""
        return [i for i, own in enumerate(self._places) if own is place]

    def _check_together(self) -> None:
        """Raise EffectError for effects that cannot be combined."""
        kinds = [type(effect) for effect in self._effects]
        for index, effect in enumerate(self._effects):
            if effect.single and kinds[index] in kinds[:index]:
                raise EffectError(
                    index, f'a scene may contain only one {effect_name(effect)}; combine the two')
            if effect.by_motors is False and any(one.by_motors for one in self._effects):
                motors = next(one for one in self._effects if one.by_motors)
                raise EffectError(
                    index, f'{self.labels[index]} applies commands to coordinates, but '
                    f'{effect_name(motors)} to the motors of its model; give both coordinates, '
                    'or use learned_friction and external_force with the same model')
            try:
                effect.check_beside(self._effects)
            except ValueError as problem:
                raise EffectError(index, str(problem)) from problem
            for place, reason in effect.excludes.items():
                for other in self._in(place):
                    if other == index:
                        continue
                    raise EffectError(
                        index, f'{effect_name(effect)} does not combine with '
                        f'{effect_name(self._effects[other])}, {reason}; remove one of them')

    def _check(self, integrator: Integrator, hamiltonian: Hamiltonian) -> None:
        for effect, label in zip(self._effects, self.labels, strict=True):
            if not effect.accepts(integrator):
                able = methods_that(effect.accepts, hamiltonian)
                raise UnsupportedSystem(f'{method_name(integrator)} does not support the effect '
                                        f'{label}; valid methods: {able}')

    def _check_coordinates(self, hamiltonian: Hamiltonian, integrator: Integrator) -> None:
        check_method(integrator, hamiltonian)
        names = listed(coordinate.name for coordinate in hamiltonian.coordinates)
        for index, (effect, label) in enumerate(zip(self._effects, self.labels, strict=True)):
            if hamiltonian.rotations and not effect.turns:
                able = ', '.join(kind for kind, other in EFFECTS.items() if other.turns)
                raise EffectError(index, f'{label} supports only scalar coordinates, but this H '
                                         f'has others ({names}); remove it; valid effects: '
                                         f'{able}')
        if self._effects and not hamiltonian.canonical:
            raise EffectError(0, f'{self.labels[0]} needs canonical momenta, but this model '
                                 f'({names}) has none; remove all effects, or simulate a '
                                 'model of another family')

    def _resolve(self, index: int, hamiltonian: Hamiltonian) -> tuple:
        try:
            return self._effects[index].resolve_on(hamiltonian, self.effect_state)
        except ValueError as problem:
            raise EffectError(index, str(problem)) from problem

    def around(self, integrator: Integrator) -> Integrator:
        """
        Return another method with the same effects in and around its steps.

        Raises
        ------
        UnsupportedSystem
            The method does not support an effect; the message names it.

        """
        for effect, label in zip(self._effects, self.labels, strict=True):
            if not effect.accepts(integrator):
                raise UnsupportedSystem(
                    f'on_failure: {type(integrator).__name__} does not support the effect '
                    f'{label}; use on_failure: substep or stop')
        return self._wrapped(integrator)

    def _assemble(self, integrator: Integrator) -> None:
        """Build the kernel and the wrapped method."""
        self.kernel, self._taken = self.hamiltonian.kernel, self._in(Place.NODES)
        forces = {i: cast(Force, self._effects[i]) for i in self._taken}
        self.joints: dict[int, np.ndarray] = {}
        for i, force in forces.items() if self._by_joint else ():
            columns = force.joints(self._parameters[i])
            if columns is not None and columns.size > 1:
                self.joints[i] = columns
        if forces:
            self.kernel = add_forces(
                self.kernel, list(forces.values()), [self._parameters[i] for i in forces],
                self.effect_state, self._taken, self.joints)
        if integrator.requirements.coordinates != 'other':
            # Methods for other coordinates read the parameters of their own model family.
            self.kernel = by_address(self.kernel)
        listed = [(i, self.labels[i], self._parameters[i]) for i in self._in(Place.MANIFOLD)]
        self.constraints: Manifold | LoopManifold | None = None
        if listed and isinstance(self._effects[-1], ClosedChains):
            self.constraints = LoopManifold(
                self._effects[-1].loops, cast(LoopRows, self._parameters[-1]), self.kernel,
                self.effect_state.pending.size)
        elif listed:
            self.constraints = Manifold(listed, self.kernel, self.effect_state.pending.size)
        self.integrator = self._wrapped(integrator)

    def _wrapped(self, integrator: Integrator) -> Integrator:
        """Wrap a method in the effects around its nodes, place by place, and in Account."""
        around = sorted((place, i) for i, place in enumerate(self._places) if place > Place.NODES)
        for place, i in around:
            kind = cast(type[StepLayer], type(self._effects[i]))
            settings: Any = self._parameters[i]
            if self.constraints is not None and place is Place.MANIFOLD:
                if i != self._in(place)[0]:
                    continue  # the first constraint represents all
                kind, settings = self.constraints.kind, self.constraints.constraints
            integrator = Wrapped(integrator, kind, (settings, self.effect_state, i))
        if self._cuts_at_knots:
            integrator = Wrapped(integrator, CutAtKnots, (self.effect_state,))
        if self._taken or around:
            internal = [i for i in self._taken if self._effects[i].internal]
            more = sum(own.size - 1 for own in self.joints.values())
            rows = len(self._effects) + np.arange(more)
            integrator = Wrapped(integrator, Account, (
                self.effect_state, np.array([*internal, *self._taken, *rows], dtype=np.int64),
                len(internal)))
        return integrator

    def causes(self) -> list[Cause]:
        """Return the causes of changes of H, one for each effect or each of its joints."""
        names, more = columns(self.hamiltonian.coordinates)[1], len(self._effects)
        found = []
        for i, (effect, label) in enumerate(zip(self._effects, self.labels, strict=True)):
            own = self.joints.get(i, np.zeros(1, dtype=int))
            rows = [i, *range(more, more + own.size - 1)]
            more += own.size - 1
            found.append(Cause(label, effect, self._parameters[i], i, {
                f'/{names[column]}' if i in self.joints else '': row
                for column, row in zip(own.tolist(), rows, strict=True)}))
        return found


def _assign(old: Any, new: Any) -> bool:
    """Copy new parameters into the arrays of old ones; return False if they do not fit."""
    if isinstance(old, tuple) and isinstance(new, tuple):
        return len(old) == len(new) and all(map(_assign, old, new))
    if isinstance(old, np.ndarray) and isinstance(new, np.ndarray):
        if old is not new and old.shape == new.shape:
            old[...] = new
        return old.shape == new.shape
    return bool(old == new)
