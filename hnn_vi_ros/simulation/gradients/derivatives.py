# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Differentiable runs, with the exact derivatives of the discrete steps."""

from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.effects import Effect, EffectState, LARGEST, LoopManifold
from hnn_vi_ros.errors import HnnViRosError, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import (
    Integrator, LARGEST_MATRIX, method_name, methods_that, PartitionedTableau)
from hnn_vi_ros.kernels import compiled_loop, entry_point, Kernel
from hnn_vi_ros.simulation.gradients.acting_effects import (
    ActingEffects, check_effects, on_numbers)
from hnn_vi_ros.simulation.gradients.closed_steps import ClosedSteps, InnerStep
from hnn_vi_ros.simulation.gradients.dependences import Dependence, MIDDLE, OnNumber, StateSequence
from hnn_vi_ros.simulation.gradients.stages import (
    Acting, fill_gradients, find_stages, pull_back, push_forward, StageDerivatives)
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System
import numpy as np


def differentiable_tableau(hamiltonian: Hamiltonian, integrator: Integrator) -> PartitionedTableau:
    """Return the tableau of a method, or raise UnsupportedSystem."""
    tableau = integrator.partitioned
    if tableau is None:
        able = methods_that(lambda method: method.partitioned is not None, hamiltonian)
        raise UnsupportedSystem(f'{method_name(integrator)} is not differentiable yet; valid '
                                f'methods: {able}')
    if not hamiltonian.canonical:
        raise UnsupportedSystem('a model of the family symplectic_form is not differentiable yet: '
                                'its second derivatives are finite differences')
    return tableau


def check_unknowns(integrator: Integrator, tableau: PartitionedTableau, d: int) -> None:
    """Raise UnsupportedSystem if the stages of d coordinates have too many unknowns."""
    unknowns = 2 * tableau.stages * d
    if unknowns > LARGEST_MATRIX:
        raise UnsupportedSystem(
            f'{method_name(integrator)} has {tableau.stages} stages of {d} coordinates, '
            f'{unknowns} unknowns; at most {LARGEST_MATRIX} are differentiable; use a method '
            'with fewer stages')


# Relative spacing of differences with respect to commands; smallest command size to be relative
# to, as a share of the largest command.
_SPACING, _MIN_SHARE = 2e-3, 1e-3
# Minimum number of steps differentiated at a time.
_MIN_PIECE_STEPS = 64


class Segment(NamedTuple):
    """Range of consecutive steps."""

    first: int
    length: int

    @property
    def steps(self) -> np.ndarray:
        """Return the zero-based indices of the steps, shape (K,)."""
        return self.first + np.arange(self.length)


class RunRecord(NamedTuple):
    """
    Record of a run.

    Parameters
    ----------
    z : np.ndarray, shape (m, 2 d)
        Initial states.
    every : int
        Number of steps between samples.
    first : np.ndarray of int, shape (m,)
        Index of the first step of each trajectory.
    commands : np.ndarray or None
        See ``DifferentiableRun.record``.
    segments : list of Segment
        Segments of all steps.
    starts : list of np.ndarray, shape (m, R)
        Rows at the start of each segment; see ``Simulation.follow``.
    last : np.ndarray, shape (K + 1, m, 2 d)
        States before and after the steps of the last segment; K is 0 without steps.

    """

    z: np.ndarray
    every: int
    first: np.ndarray
    commands: np.ndarray | None
    segments: list[Segment]
    starts: list[np.ndarray]
    last: np.ndarray

    @property
    def samples(self) -> int:
        """Return the number of samples after the initial states."""
        return sum(segment.length for segment in self.segments) // self.every

    def samples_in(self, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices of a segment's states that are samples, and of these samples."""
        after = segment.steps + 1
        inside = np.flatnonzero(after % self.every == 0)
        return 1 + inside, after[inside] // self.every

    def commands_in(self, segment: Segment) -> np.ndarray:
        """Return the commands of the steps of a segment, shape (K, m, c); c = 0 without any."""
        if self.commands is None:
            return np.zeros((segment.length, len(self.z), 0))
        rows = self.commands[segment.steps // self.every]
        return rows if rows.ndim == 3 else np.repeat(rows[:, None], len(self.z), axis=1)


def segments_of(steps: int) -> list[Segment]:
    """Return steps split into segments of sqrt(steps), at least 64."""
    stride = max(_MIN_PIECE_STEPS, math.isqrt(steps))
    return [Segment(a, min(stride, steps - a)) for a in range(0, steps, stride)]


class Change(NamedTuple):
    """
    Direction of differentiation: joint change of the inputs of a run of m trajectories.

    Parameters
    ----------
    tangents : np.ndarray, shape (m, 2 d)
        Changes of the initial states.
    others : sequence of (Dependence, np.ndarray)
        Dependences on other parameters, with their changes; see ``pull_back``.
    commands : np.ndarray, of the shape of the commands, optional
        Changes of the commands.

    """

    tangents: np.ndarray
    others: Sequence[tuple[Dependence, np.ndarray]] = ()
    commands: np.ndarray | None = None


class DifferentiableRun:
    """
    Run of several trajectories, with vector-Jacobian and Jacobian-vector products.

    The states are bit-identical to the results of Simulation. Each step is differentiated by the
    implicit function theorem (see stages): the result is the derivative of the discrete
    trajectory, exact to round-off, not an approximation of the derivative of the flow.

    For N steps only sqrt(N) snapshots are stored, and the states from the last one to the end
    (checkpointing). Products recompute the steps between snapshots bit-identically.

    Parameters
    ----------
    hamiltonian, integrator, step_size, effects
        See Simulation. A failed step ends the run, because sub-steps would be a different map.
        Effects may be potentials added to H, forces that depend on time and state or take
        commands of plain numbers, or damping.

    Attributes
    ----------
    kernel : Kernel
        Current kernel of H with its effects, by address.
    recorded : Recorded
        Record of the last run; may be replaced by that of an earlier run with the same numbers.

    Raises
    ------
    UnsupportedSystem
        The method or an effect is not differentiable yet; the message names supported ones.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VI.4, on
    the tangents of symplectic methods. J. Sanz-Serna, Symplectic Runge-Kutta schemes for adjoint
    equations, automatic differentiation, optimal control, and more, SIAM Review 58 (2016).
    A. Griewank, A. Walther, Evaluating Derivatives, 2008, chapter 12, on checkpoints.

    """

    def __init__(self, hamiltonian: Hamiltonian, integrator: Integrator, step_size: float,
                 effects: Sequence[Effect] = ()):
        self._tableau = differentiable_tableau(hamiltonian, integrator)
        check_effects(effects, integrator)
        self._integrator, self._h = integrator, float(step_size)
        self._build(hamiltonian, on_numbers(effects))

    def _build(self, hamiltonian: Hamiltonian, effects: Sequence[Effect]) -> None:
        self._hamiltonian, self._effects = hamiltonian, list(effects)
        self._system = System(hamiltonian, effects, self._integrator)
        self._acting = ActingEffects(self._system, hamiltonian, effects, self._h)
        self.kernel, self._closed = self._system.kernel, self._closed_steps()
        # The derivative of velocities at the ends of steps to their momenta, (K, m, d, d).
        self._by_velocity = np.zeros(0)
        self._d = self.kernel.dimension  # channels included
        check_unknowns(self._integrator, self._tableau, self._d)
        self._work = StageDerivatives.empty(self._tableau.stages, self._d)
        self._simulation: Simulation | None = None
        self._entries: dict[Callable[..., int], Callable[..., int]] = {}

    def _closed_steps(self) -> ClosedSteps | None:
        """Return the derivatives of impulses that keep loops closed; None without loops."""
        loops = self._system.constraints
        return ClosedSteps(loops, self._system.hamiltonian, self._h) if isinstance(
            loops, LoopManifold) else None

    def take_numbers(self, hamiltonian: Hamiltonian, effects: Sequence[Effect], step_size: float
                     ) -> None:
        """
        Replace the numbers of H and effects, and the step size, for subsequent runs.

        The compiled functions, and usually their memory, are reused.

        Parameters
        ----------
        hamiltonian, effects, step_size
            Arguments as in the constructor, of the same types.

        """
        self._h, effects = float(step_size), on_numbers(effects)
        system = self._system.with_numbers(hamiltonian, effects)
        if system is None or not (self._simulation is None
                                  or self._simulation.take_numbers(hamiltonian, effects)):
            self._build(hamiltonian, effects)
            return
        self._system = system
        self._hamiltonian, self._effects = hamiltonian, list(effects)
        self._acting = ActingEffects(self._system, hamiltonian, effects, self._h)
        self._closed = self._closed_steps()
        if self._simulation is not None:
            self._simulation.step_size = self._h

    def record(self, z: np.ndarray, samples: int, every: int = 1,
               commands: np.ndarray | None = None, first: np.ndarray | None = None) -> np.ndarray:
        """
        Simulate from initial states, record the run, and return samples.

        Parameters
        ----------
        z : np.ndarray, shape (m, 2 d)
            Initial states (q, p) of m trajectories.
        samples, every : int
            Number of samples, and number of steps between them.
        commands : np.ndarray, shape (samples, c) or (samples, m, c), optional
            Commands of effects, each held until the next sample, shared by all trajectories or
            individual.
        first : np.ndarray of int, shape (m,), optional
            Index of the first step of each trajectory, for time-dependent forces; 0 by default.

        Returns
        -------
        np.ndarray, shape (samples + 1, m, 2 d)
            (q, p) at the initial states and at the samples.

        Raises
        ------
        StepFailure
            A step did not converge, or its result is not finite.
        ValueError
            Invalid initial states or commands.

        """
        if commands is not None:
            self._acting.check_commands(commands, every)
            # Copy the commands, since pull_back needs them and the caller may change them.
            commands = commands.copy()
        z = self._system.closed(z)
        begin = np.zeros(len(z), dtype=int) if first is None else np.array(first, dtype=int)
        recorded = RunRecord(z.copy(), every, begin, commands, segments_of(samples * every), [],
                             z[None])
        rows = self._stepper(z).rows(z, step=begin)
        sampled = np.empty((samples + 1, *z.shape))
        sampled[0], states = z, recorded.last
        for segment in recorded.segments:
            recorded.starts.append(rows.copy())
            states = self._advance(recorded, rows, segment)
            inside, at = recorded.samples_in(segment)
            sampled[at] = states[inside]
        self.recorded = recorded._replace(last=states)
        return sampled

    def closed_directions(self, z: np.ndarray) -> np.ndarray:
        """
        Return orthonormal directions of closed states, shape (2 d, m, 2 d).

        The first ones keep the loops closed: two for each degree of freedom.
        """
        assert self._closed is not None, 'the robot has loops'
        nearest, _ = self._closed.initial(self._system.closed(z))
        # Singular values of a projection, which is oblique, are 0, or 1 and larger.
        return np.moveaxis(np.linalg.svd(nearest)[0], -1, 0)

    def pull_back(self, cotangents: np.ndarray, dependences: Sequence[Dependence] = (),
                  by_commands: np.ndarray | None = None) -> tuple[np.ndarray, list[np.ndarray]]:
        """
        Return the gradient of a function of the samples of the last run.

        Parameters
        ----------
        cotangents : np.ndarray, shape (samples + 1, m, 2 d)
            Gradient of the function with respect to each sample.
        dependences : sequence of Dependence
            Parameters to differentiate with respect to; see ``on_step_size`` and
            ``OnDifferences``.
        by_commands : np.ndarray, of the shape of the commands, optional
            Output: gradient with respect to commands.

        Returns
        -------
        tuple of (np.ndarray, list of np.ndarray)
            Gradients with respect to initial states, shape (m, 2 d), and to each parameter.

        """
        others = [np.zeros(()) for _ in dependences]
        if by_commands is not None:
            by_commands[...] = 0.0
        recorded = self.recorded
        following = self._acting.padded(np.zeros_like(cotangents[0]))
        for segment in reversed(recorded.segments):
            states = self._states(segment)
            acting, stages, states = self._stages(segment, states)
            local = np.zeros((segment.length + 1, *following.shape))
            inside, at = recorded.samples_in(segment)
            local[inside] = self._acting.padded(cotangents[at])
            local[-1] += following
            directions = np.empty_like(stages)
            felt = np.empty((segment.length, 2, *local.shape[1:]))
            self._call(pull_back, acting, stages, local, directions, felt)
            following = local[0]
            at_stages, weights = self._states_at(stages, acting), self._halves(directions)
            others = [total + dependence.contracted(at_stages, weights)
                      + self._by_rates(dependence, states, felt)
                      for total, dependence in zip(others, dependences, strict=True)]
            if self._closed is not None:
                ends, weights = self._at_ends(states[1:], local[1:], self._by_velocity)
                others = [total + dependence.contracted(ends, weights)
                          for total, dependence in zip(others, dependences, strict=True)]
            if by_commands is not None:
                felt = np.einsum('kmi,ckmi->kmc', directions, self._by_commands(acting, stages))
                np.add.at(by_commands, segment.steps // recorded.every,
                          felt.sum(axis=1) if by_commands.ndim == 2 else felt)
        first = cotangents[0] + self._acting.cut(following)
        if self._closed is not None:
            nearest, by_velocity = self._closed.initial(recorded.z)
            begin, felt = (self._acting.padded(part)[None] for part in (recorded.z, first))
            ends, weights = self._at_ends(begin, felt, by_velocity[None])
            others = [total + dependence.contracted(ends, weights)
                      for total, dependence in zip(others, dependences, strict=True)]
            first = np.einsum('mij,mi->mj', nearest, first)
        return first, [np.asarray(total) for total in others]

    def push_forward(self, changes: Sequence[Change]) -> np.ndarray:
        """
        Return the directional derivatives of the last samples, (r, samples + 1, m, 2 d).

        Parameters
        ----------
        changes : sequence of Change
            The r directions, for which each step is taken and factorised only once.

        """
        recorded = self.recorded
        sampled = np.empty((len(changes), recorded.samples + 1, *recorded.z.shape))
        sampled[:, 0] = np.stack([change.tangents for change in changes])
        if self._closed is not None:
            nearest, by_velocity = self._closed.initial(recorded.z)
            sampled[:, 0] = np.einsum('mij,rmj->rmi', nearest, sampled[:, 0])
            begin = self._acting.padded(recorded.z)[None]
            for r, change in enumerate(changes):
                sampled[r, 0, :, by_velocity.shape[1]:] += self._closing(
                    change, begin, by_velocity[None])[0]
        before = self._acting.padded(sampled[:, 0])
        for segment in recorded.segments:
            acting, stages, states = self._stages(segment, self._states(segment))
            local = np.empty((segment.length + 1, *before.shape))
            local[0] = before
            sources = np.zeros((segment.length, *before.shape[:2], stages.shape[2]))
            added = np.zeros((segment.length, 2, *before.shape))
            for r, change in enumerate(changes):
                self._add_sources(sources[:, r], added[:, :, r], change, stages, states, acting)
                if change.commands is not None:
                    sources[:, r] += np.einsum(
                        'kmc,ckmi->kmi', recorded._replace(commands=change.commands).commands_in(
                            segment), self._by_commands(acting, stages))
            self._call(push_forward, acting, stages, sources, added, local)
            inside, at = recorded.samples_in(segment)
            sampled[:, at] = self._acting.cut(local[inside]).swapaxes(0, 1)
            before = local[-1]
        return sampled

    def jacobians(self, states: np.ndarray, times: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """
        Return the Jacobians of the last states by the first states and by constant commands.

        Parameters
        ----------
        states : np.ndarray, shape (K + 1, m, 2 d)
            States before and after each step of m trajectories.
        times : np.ndarray, shape (K, m)
            Start times of the steps [s].
        commands : np.ndarray, shape (m, c)
            Commands, held during all steps.

        Returns
        -------
        np.ndarray, shape (m, 2 d, 2 d + c)
            The Jacobians; NaN for trajectories with a step that has no derivative.

        """
        m, n, c = *states.shape[1:], commands.shape[1]
        acting = self._acting.acting(times, np.broadcast_to(commands, (len(times), m, c)))
        acting, stages, _ = self._found(acting, self._acting.padded(states))
        sources = np.zeros((len(times), n + c, m, stages.shape[2]))
        sources[:, n:] = self._by_commands(acting, stages).swapaxes(0, 1)
        local = np.zeros((len(times) + 1, n + c, m, 2 * self._d))
        local[0, :n] = self._acting.padded(np.eye(n))[:, None]
        self._run(push_forward, acting, stages, sources, np.zeros((len(times), 2, *local.shape[1:])
                                                                  ), local)
        return self._acting.cut(local[-1]).transpose(1, 2, 0)

    def _states(self, segment: Segment) -> np.ndarray:
        """Return the states before and after a segment's steps, shape (K + 1, m, 2 d)."""
        recorded = self.recorded
        if segment is recorded.segments[-1]:
            return recorded.last
        start = recorded.starts[recorded.segments.index(segment)]
        return self._advance(recorded, start.copy(), segment)

    def _advance(self, recorded: RunRecord, rows: np.ndarray, segment: Segment) -> np.ndarray:
        """Take a segment's steps, starting at rows; return the states, (K + 1, m, 2 d)."""
        commands = recorded.commands_in(segment).swapaxes(0, 1)
        path = self._stepper(recorded.z).follow_on(rows, np.ascontiguousarray(commands))
        return np.ascontiguousarray(path.swapaxes(0, 1))

    def _stepper(self, z: np.ndarray) -> Simulation:
        """Return the simulation used for stepping rows; its own state is irrelevant."""
        if self._simulation is None:
            q, p = np.split(z[0], 2)
            self._simulation = Simulation(
                self._hamiltonian, self._integrator, self._h, q, p, self._effects, 'stop')
        return self._simulation

    def _add_sources(self, sources: np.ndarray, added: np.ndarray, change: Change,
                     stages: np.ndarray, states: np.ndarray, acting: Acting) -> None:
        """Add the sources from changes of parameters in a segment; see stages.push_forward."""
        for dependence, much in change.others:
            both = dependence.changed(self._states_at(stages, acting), much)
            sources += both.reshape(2, *sources.shape[:2], -1).transpose(1, 2, 0, 3).reshape(
                sources.shape)
            rates = getattr(dependence, 'rates', None)
            if rates is not None:
                flowed = much * self._acting.flowed(states, rates)
                if self._closed is not None:
                    flowed[:, 1] = np.einsum('kmij,kmj->kmi', acting.after, flowed[:, 1])
                added += flowed
        if self._closed is not None:
            d = len(self._acting.rates)
            added[:, 1, :, self._d:self._d + d] += self._closing(
                change, states[1:], self._by_velocity)

    def _closing(self, change: Change, ends: np.ndarray, by_velocity: np.ndarray) -> np.ndarray:
        """Return the change of the projection of momenta at ends of steps, shape (K, m, d)."""
        at, d = self._at_ends(ends, ends, by_velocity)[0], len(self._acting.rates)
        found = np.zeros((*ends.shape[:2], d))
        for dependence, much in change.others:
            velocity = dependence.changed(at, much)[1].reshape(*ends.shape[:2], self._d)
            found += np.einsum('kmij,kmj->kmi', by_velocity, velocity[..., :d])
        return found

    @property
    def on_step_size(self) -> Dependence:
        """Return the dependence on h for a fixed number of steps; the final time changes too."""
        if self._acting.any or self._closed is not None:
            raise UnsupportedSystem('the step size is not differentiable yet together with '
                                    'forces, damping, loops or a time in H; remove one of them')
        # In a step, h only occurs as a factor of H'.
        return OnNumber(lambda at: at.gradient(self.kernel) / self._h)

    def _stages(self, segment: Segment, states: np.ndarray
                ) -> tuple[Acting, np.ndarray, np.ndarray]:
        """Return effect inputs, stages of steps, (K, m, 2 s d), and states with channels."""
        recorded = self.recorded
        times = (recorded.first + segment.steps[:, None]) * self._h
        acting = self._acting.acting(times, recorded.commands_in(segment))
        begin = recorded.starts[recorded.segments.index(segment)]
        states = self._acting.padded(states, self._acting.internal_of(
            begin, self._stepper(recorded.z).state) if self._acting.internal else None)
        acting, stages, failed = self._found(acting, states)
        self._check(failed, times, 'its stages could not be recomputed to round-off')
        return acting, stages, states

    def _found(self, acting: Acting, states: np.ndarray) -> tuple[Acting, np.ndarray, int]:
        """Return the inputs and stages of steps, and the first step without; see find_stages."""
        stages = np.empty((*states[1:].shape[:2], 2 * self._tableau.stages * self._d))
        starts, ends = states[:-1], states[1:].copy()
        if self._closed is not None:
            both = np.stack([starts, ends]).reshape(2, -1, states.shape[2])
            *around, by_velocity, starts = self._closed.around(both, self._alone(acting))
            starts, before, after, self._by_velocity = (
                part.reshape(*ends.shape[:2], *part.shape[1:])
                for part in (starts, *around, by_velocity))
            acting = acting._replace(before=before, after=after)
        return acting, stages, self._run(
            find_stages, acting, starts, ends, self._closed is None, stages)

    def _alone(self, acting: Acting) -> InnerStep:
        """Return the steps of the method without impulses, each of them alone."""
        count = acting.times.size
        single = acting._replace(times=acting.times.reshape(1, count),
                                 commands=acting.commands.reshape(1, count, -1))

        def step(starts: np.ndarray, wanted: bool) -> tuple[np.ndarray, np.ndarray | None]:
            ends, n = starts.copy(), starts.shape[1]
            stages = np.empty((1, count, 2 * self._tableau.stages * self._d))
            self._run(find_stages, single, starts[None], ends[None], False, stages)
            if not wanted:
                return ends, None
            local = np.zeros((2, n, count, n))
            local[0] = np.eye(n)[:, None]
            self._run(push_forward, single, stages, np.zeros((1, n, count, stages.shape[2])),
                      np.zeros((1, 2, n, count, n)), local)
            return ends, local[1].transpose(1, 2, 0)
        return step

    def _at_ends(self, ends: np.ndarray, cotangents: np.ndarray, by_velocity: np.ndarray
                 ) -> tuple[StateSequence, np.ndarray]:
        """Return the ends of steps, and the cotangents of (H_q, H_p) there, shape (2, N)."""
        d = len(self._acting.rates)
        weights = np.zeros((2, *ends.shape[:2], self._d))
        weights[1, ..., :d] = np.einsum(
            'kmij,kmi->kmj', by_velocity, cotangents[..., self._d:self._d + d])
        q, p = (np.ascontiguousarray(part).ravel() for part in np.split(ends, 2, axis=-1))
        return StateSequence.at(q, p), weights.reshape(2, -1)

    def _by_rates(self, dependence: Dependence, states: np.ndarray, felt: np.ndarray
                  ) -> np.ndarray:
        """Return the contribution of damping rates to a gradient, shape ()."""
        rates = getattr(dependence, 'rates', None)
        return np.zeros(()) if rates is None else np.array(float(
            (felt * self._acting.flowed(states, rates)).sum()))

    def _by_commands(self, acting: Acting, stages: np.ndarray) -> np.ndarray:
        """Return the derivatives of H' at stages by each command, shape (c, K, m, 2 s d)."""
        places, s = self._system.places, self._tableau.stages
        if not self._acting.feels:
            # A force is subtracted from H_q.
            found = np.zeros((len(places), 2, s, self._d))
            found[:, 0, :, :places.shape[1]] = -places[:, None]
            return np.broadcast_to(found.reshape(len(places), 1, 1, stages.shape[2]),
                                   (len(places), *stages.shape))
        found = np.zeros((len(places), *stages.shape))
        for slopes, place in zip(found, places, strict=True):
            size = np.abs(acting.commands[..., :-1] @ place)
            # A servo that is off does not depend on its command.
            size[size > LARGEST] = 0.0
            # Stay on one side of zero: friction under load has a kink at a sign change.
            spacing = _SPACING * np.maximum(size, _MIN_SHARE * (size.max(initial=0.0) or 1.0))
            for offset, (weight, _) in MIDDLE.items():
                commands = acting.commands.copy()
                commands[..., :-1] += offset * spacing[..., None] * place
                both = self._states_at(stages, acting._replace(commands=commands)).gradient(
                    self.kernel).reshape(2, *stages.shape[:2], -1)
                slopes += weight / spacing[..., None] * np.concatenate([*both], axis=-1)
        return found

    def _call(self, loop: Callable[..., int], acting: Acting, *arrays: np.ndarray) -> None:
        """Run a loop of the module stages over steps, or raise."""
        self._check(self._run(loop, acting, *arrays), acting.times,
                    'the matrix of its equation is singular')

    def _run(self, loop: Callable[..., int], acting: Acting, *arrays: np.ndarray | bool,
             kernel: Kernel | None = None) -> int:
        arguments = self._h, self._tableau, acting, *arrays, self._work
        if loop not in self._entries:
            self._entries[loop] = entry_point(
                compiled_loop(loop, self.kernel, ''), self.kernel, *arguments) \
                if self.kernel.compiled else loop
        return self._entries[loop](kernel or self.kernel, *arguments)

    @staticmethod
    def _check(failed: int, times: np.ndarray, problem: str) -> None:
        """Raise HnnViRosError if a step at one of the times has no derivative."""
        if failed >= 0:
            raise HnnViRosError(
                f'the step at t = {times.flat[failed]:.9g} s has no derivative: {problem}; use a '
                'smaller step_size or another integrator')

    def _states_at(self, stages: np.ndarray, acting: Acting) -> StateSequence:
        """Return the stages as States, with the time in channels; kernel clocks are at 0."""
        channels = self.kernel.channels
        if channels:
            stages = stages.copy()
            q = stages[..., :stages.shape[2] // 2].reshape(*stages.shape[:2], -1, self._d)
            q[..., self._d - channels:] += acting.times[:, :, None, None] * self._acting.timed
        at = StateSequence.at(*self._halves(stages))
        if not self._acting.feels:
            return at

        def gradient(kernel: Kernel) -> np.ndarray:
            found = np.empty((2, *stages.shape[:2], stages.shape[2] // 2))
            self._run(fill_gradients, acting, stages, found, kernel=kernel)
            return found.reshape(2, -1)
        return at._replace(gradient=gradient)

    def beside(self, hamiltonian: Hamiltonian, effects: Sequence[Effect]) -> System:
        """Return a system with other numbers that shares the command array."""
        state = EffectState.empty(len(self._system.labels), hamiltonian.dimension)
        shared = self._system.effect_state
        return System(hamiltonian, on_numbers(effects), self._integrator, state._replace(
            command=shared.command, step=shared.step))

    def _halves(self, stages: np.ndarray) -> np.ndarray:
        """Return the concatenated q parts and p parts of all stages, shape (2, N)."""
        s = self._tableau.stages
        return np.ascontiguousarray(
            stages.reshape(-1, 2, s * self._d).swapaxes(0, 1)).reshape(2, -1)
