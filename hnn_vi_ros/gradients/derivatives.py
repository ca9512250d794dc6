# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs whose derivatives are known: the exact ones of the steps that were taken."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import HnnViRosError, UnsupportedSystem
from hnn_vi_ros.gradients.acting_effects import ActingEffects, check_effects
from hnn_vi_ros.gradients.checkpoints import Block, Checkpoints, Recorded, Segment, segments_of
from hnn_vi_ros.gradients.dependences import Dependence, gradient_of, OnNumber
from hnn_vi_ros.gradients.stages import entry_of, find_stages, pull_back, push_forward, StageWork
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import method_name, methods_that
from hnn_vi_ros.integrators.base import Integrator, PartitionedTableau
from hnn_vi_ros.integrators.workspaces import LARGEST_MATRIX
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.system import System
import numpy as np


def differentiable_tableau(hamiltonian: Hamiltonian, integrator: Integrator) -> PartitionedTableau:
    """Return the tableau of a method, or raise UnsupportedSystem."""
    tableau = integrator.partitioned
    if tableau is None:
        able = methods_that(lambda method: method.partitioned is not None, hamiltonian)
        raise UnsupportedSystem(f'{method_name(integrator)} is not differentiable yet; methods '
                                f'that are: {able}')
    if not hamiltonian.canonical:
        raise UnsupportedSystem('a model of the family symplectic_form is not differentiable yet: '
                                'its second derivatives are differences')
    return tableau


def check_unknowns(integrator: Integrator, tableau: PartitionedTableau, d: int) -> None:
    """Raise UnsupportedSystem if a step of d coordinates has too many unknowns in its stages."""
    unknowns = 2 * tableau.stages * d
    if unknowns > LARGEST_MATRIX:
        raise UnsupportedSystem(
            f'{method_name(integrator)} has {tableau.stages} stages of {d} coordinates, '
            f'{unknowns} unknowns, of which up to {LARGEST_MATRIX} are differentiable; take a '
            'method of fewer stages')


# Most snapshots that are kept, unless fewer are asked for.
_SNAPSHOTS = 1000


class Change(NamedTuple):
    """
    A direction in which all that a run of m trajectories depends on changes at once.

    Parameters
    ----------
    tangents : np.ndarray, shape (m, 2 d)
        How the initial states change.
    others : sequence of (Dependence, np.ndarray)
        What else changes, and by how much; see ``pull_back``.
    commands : np.ndarray, of the shape of the commands, optional
        How these change.

    """

    tangents: np.ndarray
    others: Sequence[tuple[Dependence, np.ndarray]] = ()
    commands: np.ndarray | None = None


class DifferentiableRun:
    """
    A run of some trajectories, and products of its derivatives with vectors.

    Its states equal a Simulation's bit by bit, and with several trajectories they equal the blocks
    of ``simulate_many``. Each step is differentiated as taken, by the implicit function
    theorem (see stages): what comes out is the derivative of the discrete trajectory, to
    round-off, not an approximation of that of the flow.

    Of N steps only sqrt(N) snapshots are kept, or as few as ``record`` is asked for, and the
    states between the last one and the end. A product takes the other steps between two of them
    once more, bit by bit.

    Parameters
    ----------
    hamiltonian, integrator, step_size, effects
        As of Simulation. A step that fails ends the run: one taken in parts would be another map.
        The effects may join H, be forces that depend on time and state, take commands of plain
        numbers, or be damping.

    Raises
    ------
    UnsupportedSystem
        The method or an effect is not differentiable yet; names those that are.

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
        self._build(hamiltonian, effects)

    def _build(self, hamiltonian: Hamiltonian, effects: Sequence[Effect]) -> None:
        self._hamiltonian, self._effects = hamiltonian, list(effects)
        self._system = System(hamiltonian, effects, self._integrator)
        self._acting = ActingEffects(self._system, hamiltonian, effects, self._h)
        self._kernel = self._system.kernel
        self._d = self._kernel.dimension  # channels included
        check_unknowns(self._integrator, self._tableau, self._d)
        self._work = StageWork.empty(self._tableau.stages, self._d)
        self._simulation: Simulation | None = None
        self._entries: dict[Callable[..., int], Callable[..., int]] = {}

    def take_numbers(self, hamiltonian: Hamiltonian, effects: Sequence[Effect], step_size: float
                     ) -> None:
        """
        Take other numbers of the same H, effects and step size, for runs from now on.

        The compiled functions, and as a rule their memory, are shared with the runs before.

        Parameters
        ----------
        hamiltonian, effects, step_size
            As of the constructor, of the same kinds.

        """
        self._h = float(step_size)
        if not (self._system.take_numbers(hamiltonian, effects) and (
                self._simulation is None
                or self._simulation.take_numbers(hamiltonian, effects))):
            self._build(hamiltonian, effects)
            return
        self._hamiltonian, self._effects = hamiltonian, list(effects)
        self._acting = ActingEffects(self._system, hamiltonian, effects, self._h)
        if self._simulation is not None:
            self._simulation.step_size = self._h

    def record(self, z: np.ndarray, samples: int, every: int = 1,
               commands: np.ndarray | None = None, first: np.ndarray | None = None,
               checkpoints: int | None = None) -> np.ndarray:
        """
        Take samples every so many steps, from initial states on.

        Parameters
        ----------
        z : np.ndarray, shape (m, 2 d)
            (q, p) of m trajectories.
        samples, every : int
            How many, and steps from one to the next.
        commands : np.ndarray, shape (samples, c) or (samples, m, c), optional
            Of an effect that takes them, each held until the next sample; for all trajectories,
            or for each, which then step alone.
        first : np.ndarray of int, shape (m,), optional
            The step at which each trajectory begins, for forces that depend on time; those next to
            each other that begin together step together.
        checkpoints : int, optional
            Most snapshots that are kept of a block of trajectories: with few of them the way back
            takes steps more often (see Checkpoints). By default the square root of the number of
            steps, up to a thousand.

        Returns
        -------
        np.ndarray, shape (samples + 1, m, 2 d)
            (q, p) at the initial states and at the samples.

        Raises
        ------
        StepFailure
            A step did not converge or is not finite.
        ValueError
            The states are not usable.

        """
        segments = segments_of(samples * every)
        begin = np.zeros(len(z), dtype=int) if first is None else np.array(first, dtype=int)
        # Copies, with which the way back goes whatever becomes of the caller's.
        commands = None if commands is None else commands.copy()
        recorded = Recorded(z.copy(), every, begin, commands, segments, [])
        self.go_back_to(recorded)
        # In the last segment the states themselves are kept.
        before = max(len(segments) - 1, 0)
        most = min(_SNAPSHOTS, max(before, 1)) if checkpoints is None else checkpoints
        sampled = np.empty((samples + 1, *z.shape))
        sampled[0] = z
        for rows in recorded.together():
            simulation, kept = self._start(rows), Checkpoints(before, most)
            states = sampled[:1, rows]
            for k, segment in enumerate(segments):
                kept.pass_by(k, simulation.snapshot)
                states = self._advance(simulation, rows, segment)
                inside, at = recorded.samples_in(segment)
                sampled[at, rows] = states[inside]
            recorded.blocks.append(Block(rows, kept, states))
        return sampled

    @property
    def recorded(self) -> Recorded:
        """Return the record of the last run."""
        return self._recorded

    def go_back_to(self, recorded: Recorded) -> None:
        """Make an earlier run, of the same numbers, the last one."""
        self._recorded = recorded
        self._acting.set_commands(recorded.commands, recorded.every)

    def pull_back(self, cotangents: np.ndarray, dependences: Sequence[Dependence] = (),
                  by_commands: np.ndarray | None = None) -> tuple[np.ndarray, list[np.ndarray]]:
        """
        Return the gradient of what depends on the samples of the last run.

        Parameters
        ----------
        cotangents : np.ndarray, shape (samples + 1, m, 2 d)
            Its gradient by each of them.
        dependences : sequence of Dependence
            On what else its gradient is asked for; see ``on_step_size`` and ``on_number``.
        by_commands : np.ndarray, of the shape of the commands, optional
            Filled with the gradient by them.

        Returns
        -------
        tuple of (np.ndarray, list of np.ndarray)
            The gradient by the initial states, shape (m, 2 d), and by each of those.

        """
        gradient, others = cotangents[0].copy(), [np.zeros(()) for _ in dependences]
        if by_commands is not None:
            by_commands[...] = 0.0
        recorded = self._recorded
        for block in recorded.blocks:
            following = self._acting.padded(np.zeros_like(gradient[block.rows]))
            for segment, states in self._backwards(block):
                stages, states = self._stages(segment, block.rows, states)
                local = np.zeros((segment.length + 1, *following.shape))
                inside, at = recorded.samples_in(segment)
                local[inside] = self._acting.padded(cotangents[at, block.rows])
                local[-1] += following
                directions = np.empty_like(stages)
                felt = np.empty((segment.length, 2, *local.shape[1:]))
                self._call(pull_back, segment, block.rows, stages, local, directions, felt)
                following = local[0]
                at_stages = self._timed(stages, segment, block.rows)
                weights = self._halves(directions)
                others = [total + dependence.contracted(*at_stages, weights)
                          + self._by_rates(dependence, states, felt)
                          for total, dependence in zip(others, dependences, strict=True)]
                if by_commands is not None:
                    self._add_by_commands(by_commands, directions, segment, block.rows)
            gradient[block.rows] += self._acting.cut(following)
        return gradient, [np.asarray(total) for total in others]

    def push_forward(self, changes: Sequence[Change]) -> np.ndarray:
        """
        Return how the samples of the last run change in directions, (r, samples + 1, m, 2 d).

        Parameters
        ----------
        changes : sequence of Change
            r of them, for which the steps are taken and differentiated together.

        """
        recorded = self._recorded
        sampled = np.empty((len(changes), recorded.samples + 1, *recorded.z.shape))
        for block in recorded.blocks:
            rows = block.rows
            tangents = np.stack([change.tangents[rows] for change in changes])
            sampled[:, 0, rows], before = tangents, self._acting.padded(tangents)
            for segment, states in self._forwards(block):
                stages, states = self._stages(segment, rows, states)
                local = np.empty((segment.length + 1, *before.shape))
                local[0] = before
                sources = np.zeros((segment.length, *before.shape[:2], stages.shape[2]))
                added = np.zeros((segment.length, 2, *before.shape))
                for r, change in enumerate(changes):
                    self._add_sources(sources[:, r], added[:, :, r], change, stages, states,
                                      segment, rows)
                self._call(push_forward, segment, rows, stages, sources, added, local)
                inside, at = recorded.samples_in(segment)
                sampled[:, at, rows] = self._acting.cut(local[inside]).swapaxes(0, 1)
                before = local[-1]
        return sampled

    def _backwards(self, block: Block) -> Iterator[tuple[Segment, np.ndarray]]:
        """Yield the segments from the last one on, each with its states; see _advance."""
        segments, rows = self._recorded.segments, block.rows
        if segments:
            yield segments[-1], block.last
        if len(segments) > 1:
            simulation = self._start(rows)
            for k in block.kept.backwards(
                    simulation.restore, lambda k: self._advance(simulation, rows, segments[k]),
                    simulation.snapshot):
                yield segments[k], self._advance(simulation, rows, segments[k])

    def _forwards(self, block: Block) -> Iterator[tuple[Segment, np.ndarray]]:
        """Yield the segments from the first one on, each with its states; see _advance."""
        *segments, last = self._recorded.segments or [Segment(0, 0)]
        if segments:
            simulation = self._start(block.rows)
            for segment in segments:
                yield segment, self._advance(simulation, block.rows, segment)
        if last.length:
            yield last, block.last

    def _add_sources(self, sources: np.ndarray, added: np.ndarray, change: Change,
                     stages: np.ndarray, states: np.ndarray, segment: Segment, block: slice
                     ) -> None:
        """Add what changes of all but states do in a segment; see stages.push_forward."""
        halves = sources.reshape(*sources.shape[:2], 2, -1)
        for dependence, much in change.others:
            both = dependence.changed(*self._timed(stages, segment, block), much)
            halves += both.reshape(2, *sources.shape[:2], -1).transpose(1, 2, 0, 3)
            rates = getattr(dependence, 'rates', None)
            if rates is not None:
                added += much * self._acting.flowed(states) * self._acting.per_momentum(rates)
        if change.commands is not None:
            self._add_commands(halves, change.commands, segment, block)
        sources[...] = halves.reshape(sources.shape)

    @property
    def on_step_size(self) -> Dependence:
        """Return the dependence on h: of so many steps, so the time at their end changes too."""
        if self._acting.any:
            raise UnsupportedSystem('the step size is not differentiable yet together with forces '
                                    'or damping; leave one of them out')
        # In a step h occurs only as a factor of H'.
        return OnNumber(lambda q, p: gradient_of(self._kernel, q, p) / self._h)

    def _start(self, block: slice) -> Simulation:
        """Return the simulation with its trajectories at the initial states of a block."""
        q, p = np.split(self._recorded.z[block], 2, axis=1)
        if self._simulation is None:
            self._simulation = Simulation(
                self._hamiltonian, self._integrator, self._h, q, p, self._effects, 'stop')
        self._simulation.restart(q, p, step=int(self._recorded.first[block.start]))
        return self._simulation

    def _advance(self, simulation: Simulation, block: slice, segment: Segment) -> np.ndarray:
        """Take a segment's steps; return the states before and after, shape (K + 1, m, 2 d)."""
        before = np.concatenate([simulation.q, simulation.p], axis=1)[None]
        return np.concatenate([before, self._acting.advance(
            simulation, block, *segment, self._recorded.every)])

    def _stages(self, segment: Segment, block: slice, states: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray]:
        """Return the stages of a segment's steps, (K, m, 2 s d), and the states as kernels do."""
        states = self._acting.padded(states)
        stages = np.empty((*states[1:].shape[:2], 2 * self._tableau.stages * self._d))
        self._call(find_stages, segment, block, states, stages)
        return stages, states

    def _by_rates(self, dependence: Dependence, states: np.ndarray, felt: np.ndarray
                  ) -> np.ndarray:
        """Return the gradient by what changes rates of damping, shape ()."""
        rates = getattr(dependence, 'rates', None)
        return np.zeros(()) if rates is None else np.array(float(
            (felt * self._acting.flowed(states) * self._acting.per_momentum(rates)).sum()))

    def _add_by_commands(self, gradient: np.ndarray, directions: np.ndarray, segment: Segment,
                         block: slice) -> None:
        """Add the gradient by the commands that hold in a segment: a force lessens H_q."""
        places = self._acting.places
        d, s = places.shape[1], self._tableau.stages
        on_q = directions[..., :s * self._d].reshape(*directions.shape[:2], s, self._d)
        felt = -on_q[..., :d].sum(axis=2) @ places.T
        rows = segment.steps // self._recorded.every
        if gradient.ndim == 2:
            np.add.at(gradient, rows, felt.sum(axis=1))
        else:
            np.add.at(gradient[:, block], rows, felt)

    def _add_commands(self, sources: np.ndarray, commands: np.ndarray, segment: Segment,
                      block: slice) -> None:
        """Add to the sources what commands that change make of H_q at the stages."""
        places = self._acting.places
        d, s = places.shape[1], self._tableau.stages
        rows = segment.steps // self._recorded.every
        change = commands[rows][:, None] if commands.ndim == 2 else commands[rows, block]
        view = sources[:, :, 0].reshape(*sources.shape[:2], s, self._d)
        view[..., :d] -= (change @ places)[:, :, None]

    def _call(self, loop: Callable[..., int], segment: Segment, block: slice,
              *arrays: np.ndarray) -> None:
        """Run a loop of the module stages over the steps of a segment, or raise."""
        times = self._times(segment, block)
        acting = self._acting.acting(block, segment.first, times, self._recorded.every)
        arguments = self._h, self._tableau, acting, *arrays, self._work
        if loop not in self._entries:
            self._entries[loop] = entry_of(loop, self._kernel, *arguments)
        failed = self._entries[loop](self._kernel, *arguments)
        if failed >= 0:
            t = times[failed]
            problem = 'its stages are not found again to round-off' if loop is find_stages else \
                'the matrix of its equation is singular'
            raise HnnViRosError(f'the step at t = {t:.9g} s has no derivative: {problem}; use a '
                                'smaller step_size or another integrator')

    def _times(self, segment: Segment, block: slice) -> np.ndarray:
        """Return the times at which a segment's steps begin [s], shape (K,)."""
        return (self._recorded.first[block.start] + segment.steps) * self._h

    def _timed(self, stages: np.ndarray, segment: Segment, block: slice
               ) -> tuple[np.ndarray, np.ndarray]:
        """Return the stages' halves for a kernel whose clock is at the start of the run."""
        channels = self._kernel.channels
        if channels:
            stages = stages.copy()
            q = stages[..., :stages.shape[2] // 2].reshape(*stages.shape[:2], -1, self._d)
            q[..., self._d - channels:] += self._times(segment, block)[:, None, None, None]
        q, p = self._halves(stages)
        return q, p

    def _halves(self, stages: np.ndarray) -> np.ndarray:
        """Return the q parts, then the p parts, of all stages one after another: (2, N)."""
        s = self._tableau.stages
        return np.ascontiguousarray(
            stages.reshape(-1, 2, s * self._d).swapaxes(0, 1)).reshape(2, -1)
