# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation: the state of a scene, advanced by whole steps in compiled code."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import math
from operator import itemgetter
import time
from typing import Any, NoReturn, TYPE_CHECKING
import warnings

from hnn_vi_ros.effects import (
    Command, Effect, LoopManifold, NUMBERS, Observation, PAYLOAD, whole_turns)
from hnn_vi_ros.errors import StateError, StepFailure
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum, Payload
from hnn_vi_ros.integrators import (
    arrays_of, BEYOND, DenseOutput, discard_history, IN_DOUBT, Integrator, is_finite, NO_SOLUTION,
    NOT_FINITE, OK, PairWork, path_in_legendre, PhasePoint, REASONS, step_failure, TaylorWork)
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.simulation.assembly import advance, Loop
from hnn_vi_ros.simulation.dense_step import DenseStep
from hnn_vi_ros.simulation.energy_by_cause import Ledger
from hnn_vi_ros.simulation.following import CommandLaw, follow_each
from hnn_vi_ros.simulation.processors import check_interrupt
from hnn_vi_ros.simulation.rescue import Rescue
from hnn_vi_ros.simulation.state import HEAD, State
from hnn_vi_ros.simulation.system import System
import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from hnn_vi_ros.simulation.second_run import SecondRun

# Relative distance beyond which two solutions of a step count as different.
_MAX_DISTANCE, _FIRST = 1e-8, itemgetter(0)
# Gradients, rescued steps, several solutions, residual, costliest; see Simulation.
_Costs = tuple[int, int, int, float, tuple[int, int]]
# Target wall time of one call of compiled code [s], and largest growth of its number of steps from
# call to call. Signals are handled between calls, which cost some microseconds.
_CALL_TIME, _MAX_GROWTH = 0.02, 16.0
# The shortest step of a clock [s].
_SHORTEST = math.ulp(0.0)


class RescuePending(Exception):
    """Failure of a step while its fallbacks are still being compiled."""


class Simulation:
    """
    Simulation of a Hamiltonian by an integrator, advanced in whole steps.

    Time is the number of steps times the step size, never a sum of floats. A failed step leaves
    the last valid state in place.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of d degrees of freedom; with rotations d is the number of columns of q.
    integrator : Integrator
        One-step method.
    step_size : float
        Step size h > 0 [s].
    q, p : sequence of float, shape (d,) or (m, d)
        Initial state, or m initial states of trajectories that step together; p and related
        arrays have one column less for each rotation.
    effects : sequence of Effect
        Effects on the system in addition to H.
    on_failure : str
        Reaction to a failed step: ``'substep'``, ``'implicit'`` or ``'stop'``; see
        Rescue.
    energy_by_cause : bool, optional
        True to account for the energy by cause; see Ledger.

    Attributes
    ----------
    hamiltonian : Hamiltonian
        H including the potentials among the effects.
    effects : tuple of Effect
        Effects in addition to H.
    conservative, takes_commands : bool
        True if no effect does work, and if an effect takes commands of plain numbers.
    command_size, command_names : int, sequence of str
        Number of entries of such a command, and their names, if they have names.
    motors : Motors
        Effects that take commands.
    system : System
        Compiled H with the effects and the method.
    ledger : Ledger or None
        Account of the energy by cause, if requested.
    steps : int
        Number of steps since the initial state.
    q, p : np.ndarray, shape (d,) or (m, d)
        State, in the shape of the initial one; copy it before the next ``advance``.
    dH_dq, dH_dp : np.ndarray, of the shape of q
        -p' and q' at the state: gradient of H minus the forces applied at the method's nodes.
    rescued, several_solutions : int
        Number of steps taken in sub-steps or by the implicit midpoint rule, and number of steps in
        which a solver found another solution than the one connected to h = 0.
    residual : float
        Relative residual of the last implicit step [1].
    gradients, usual_gradients : int
        Number of gradients and Hessian-vector products since the initial state, and usual maximum
        number per step, 0 if unknown.
    costliest : tuple of (int, int)
        Maximum number of gradients of a step, and number of steps at its end.
    rescue_ready : bool
        If True, a failed step compiles its fallbacks when needed. Set it to False before running
        ``compile_rescue`` in another thread, which sets it to True at the end: until then a failed
        step raises RescuePending, and leaves the simulation as before the step.

    Raises
    ------
    UnsupportedSystem
        The integrator does not support this Hamiltonian with these effects.
    EffectError, ValueError
        Invalid effect, step size or state.
    StepFailure
        H has no finite gradient at the initial state.

    """

    def __init__(self, hamiltonian: Hamiltonian, integrator: Integrator, step_size: float,
                 q: ArrayLike, p: ArrayLike, effects: Sequence[Effect] = (),
                 on_failure: str = 'substep', energy_by_cause: bool = False,
                 warn: bool = True):
        if not (np.isfinite(step_size) and step_size > 0.0):
            raise ValueError(f'step_size = {step_size} must be a positive number of seconds')
        self.system = system = System(hamiltonian, effects, integrator, by_joint=energy_by_cause)
        # The run with other steps that follows this one, and trials of steps.
        self.second: SecondRun | None = None
        self._probe: Probe | None = None
        self._shape: tuple[int, ...] = ()
        self._parts = hamiltonian, effects, on_failure
        self._kernel, self.step_size = system.kernel, float(step_size)
        self.hamiltonian, self.integrator = system.hamiltonian, integrator
        self._rescue, self.rescue_ready = Rescue(system, on_failure), True
        # Loops by index of the active method; the second one is compiled on first use.
        self._loops = {0: Loop(advance, self._kernel, self._rescue.methods[0])}
        self._most = 1  # steps per call of compiled code
        self.effects = tuple(effects)
        self.conservative, self.motors = system.conservative, system.motors
        self.takes_commands = NUMBERS in self.motors.takes
        self.command_names, self.command_size = self.motors.names, self.motors.size
        timeout = min((getattr(effect, 'timeout', np.inf) for effect in effects
                       if NUMBERS in getattr(effect, 'takes', ())), default=np.inf)
        if warn and timeout < self.step_size:
            warnings.warn(f'external_force: a command acts for whole steps of {step_size:g} s, '
                          f'longer than its timeout of {timeout:g} s; use a smaller step_size',
                          stacklevel=2)
        self.usual_gradients = system.integrator.usual_gradients
        self._follow: Loop | None = None
        self._most_followed = 1
        if warn and not self._kernel.compiled:
            warnings.warn(
                f'{type(hamiltonian).__name__} is not compiled: plain Python or autograd computes '
                'its gradient in every step, which is slower', stacklevel=2)
        self.ledger: Ledger | None = None
        self.restart(q, p)
        if energy_by_cause:
            self.ledger = Ledger(system, self.q.ravel())

    def __reduce__(self) -> NoReturn:
        """Raise TypeError: a simulation cannot be copied or pickled."""
        raise TypeError('a simulation cannot be copied: compiled code holds the addresses of its '
                        'arrays; build a new one and pass snapshot() of this one to its restore()')

    def _begin(self, n: int, step: int) -> None:
        """Allocate a state of n unknowns, and reset the counters, starting at a step."""
        self.steps, self.gradients, self.residual = step, 0, 0.0
        self.rescued, self.several_solutions, self.costliest = 0, 0, (0, step)
        self._z, self._z1 = PhasePoint.empty(n), PhasePoint.empty(n)
        self._active, self._memories = 0, self._rescue.memories(n)
        self.state = State(self._arrays(), self._z)
        # Separate from the point's arrays: steps must not depend on when these are read.
        self._dH_dq, self._dH_dp = np.empty((2, n))

    def restart(self, q: ArrayLike, p: ArrayLike, stream: int = 0, step: int = 0,
                held: dict[str, np.ndarray] | None = None) -> None:
        """Restart from a state at a step, holding a snapshot's commands; errors as in __init__."""
        q, p = self.system.check_state(q, p)
        if self.second is not None:
            self.second.begin_anew()
        self.system.effect_state.reset(stream, step * self.step_size, held)
        if held is None:
            self.motors.begin()
        if self._probe is not None and q.shape != self._shape:
            self._probe = None
        self._begin(q.size // self.hamiltonian.dimension * self._kernel.dimension, step)
        self._shape, self._momenta = q.shape, p.shape[-1]
        self.q, self.p = self._state(self._z.q), self._state(self._z.p)[..., :self._momenta]
        self.q[:], self.p[:] = q, p
        self._start = q.copy(), p.copy()
        self.dH_dq = self._state(self._dH_dq)
        self.dH_dp = self._state(self._dH_dp)[..., :self._momenta]
        self._evaluate_gradient()
        if not is_finite(self._z):
            raise StepFailure(REASONS[NOT_FINITE], 0.0, self.step_size, np.nan, 0,
                              'H has no finite gradient at the initial state; start elsewhere')
        self._update_gradient()
        self._energy0 = self.energy

    def follow_by(self, second: 'SecondRun | None') -> None:
        """Have a second run follow the next steps, or none."""
        self.second = second

    def sibling(self, steps: float = 1.0, tolerances: float = 1.0) -> 'Simulation':
        """
        Return a simulation of the same system in the same code, with its own memory.

        Parameters
        ----------
        steps, tolerances : float
            Its step size, and the tolerances of its method, relative to those of this one.

        """
        hamiltonian, effects, on_failure = self._parts
        other = Simulation(hamiltonian.copy(), self.integrator.scaled(tolerances),
                           steps * self.step_size, *self._start, effects, on_failure, warn=False)
        other.rescue_ready = self.rescue_ready
        return other

    @property
    def probe(self) -> 'Probe':
        """Return the simulation in which steps are tried."""
        if self._probe is None:
            self._probe = Probe(self)
        return self._probe

    def take_numbers(self, hamiltonian: Hamiltonian, effects: Sequence[Effect]) -> bool:
        """Replace numbers at the next `restart`; return False if that needs a rebuild."""
        system = self.system.with_numbers(hamiltonian, effects)
        if system is None:
            return False
        self._parts, self._probe = (hamiltonian, effects, self._parts[2]), None
        self.system, self.hamiltonian, self.motors = system, system.hamiltonian, system.motors
        if self.ledger is not None:
            self.ledger = Ledger(system, self.q.ravel())
        return True

    def check_state(self, q: ArrayLike, p: ArrayLike) -> None:
        """Raise StateError for an invalid initial state."""
        self.system.check_state(q, p)

    def _state(self, array: np.ndarray) -> np.ndarray:
        """Return a view of arrays of n unknowns, (..., n), without the channels of forces."""
        before = array.shape[:-1]
        view = array.reshape(*before, *self._shape[:-1], self._kernel.dimension)
        return view[..., :self.hamiltonian.dimension]

    def set_command(self, command: Command, limited: bool = True) -> None:
        """Set the command of forces or joints; on ValueError the previous one is kept."""
        q = self.q.reshape(-1, self.hamiltonian.dimension)[0]
        if isinstance(command, Observation) and self.system.turning.any():
            command = self._at_nearest_turns(command, q + command.delay * self.dH_dp[:q.size])
        if isinstance(command, Payload):
            self._change_payload(command)
        else:
            self.motors.command(command, q, limited)
        self._evaluate_gradient()
        self._update_gradient()
        if self.second is not None:
            self.second.command(command)

    def _change_payload(self, payload: Payload) -> None:
        """Replace the payload at constant velocities; the jump of the energy is its work."""
        before, velocity = self.energy, self.hamiltonian.gradient(self.q, self.p)[1]
        row = self.row
        self.motors.command(payload, self.q)
        try:
            self.p[...] = momentum(self.hamiltonian, self.q, velocity, self.p)
        except StateError as problem:
            self.put(row)
            raise StateError(
                f'payload of {payload.mass:g} kg at {payload.centre}: no momenta keep the '
                'velocities; give a smaller mass, centre or inertia') from problem
        self.system.effect_state.work[self.system.labels.index(PAYLOAD), 0] += self.energy - before
        for memory in self._memories:
            discard_history(memory)

    def _at_nearest_turns(self, seen: Observation, q: np.ndarray) -> Observation:
        """Return an observation with periodic angles shifted by full turns to be nearest to q."""
        names = columns(self.hamiltonian.coordinates)[0]
        own = [names.index(name) if name in names else -1 for name in seen.names]
        turning = np.array([k >= 0 and self.system.turning[k] for k in own], dtype=bool)
        return seen._replace(position=seen.position - whole_turns(seen.position - q[own], turning))

    @property
    def internal_steps(self) -> np.ndarray:
        """
        Return counts of the internal steps of `dop853` since the initial state, shape (3,).

        They are accepted and rejected ones, and accepted ones whose size stability limits; zeros
        for other methods.
        """
        work = self._memories[0][0] if self._memories[0] else None
        return work.kept.tally[:3].copy() if isinstance(work, PairWork) else np.zeros(3, np.int64)

    @property
    def workspace(self) -> Any:
        """Return the workspace of the active method that has internal steps; None without."""
        return next((workspace for workspace in self._memories[self._active]
                     if hasattr(workspace, 'own_step') or isinstance(workspace, TaylorWork)), None)

    @property
    def connected(self) -> bool:
        """Return whether steps may have several solutions and need the one connected to h = 0."""
        return self.system.integrator.no_solution != '' and not self.hamiltonian.separable

    @property
    def energy(self) -> float:
        """Return H(q, p) [J], summed over several trajectories."""
        return sum(self.system.energies(self._z))

    @property
    def works(self) -> dict[str, float]:
        """Return the work done on the system by each effect since the initial state [J]."""
        works = self.system.effect_state.work.sum(axis=1).tolist()
        return {cause.label: sum(works[row] for row in cause.rows.values())
                for cause in self.system.causes()}

    @property
    def work(self) -> float:
        """Return the work of all effects [J]."""
        return float(self.system.effect_state.work.sum()) if self.system.labels else 0.0

    @property
    def loop_forces(self) -> np.ndarray:
        """
        Return the forces in the loops of a robot, shape (L, 6), in the mean over the last step.

        They are forces [N] and moments [N m]; see LoopManifold.forces. ValueError without loops.
        """
        if not isinstance(self.system.constraints, LoopManifold):
            raise ValueError('the scene has no loops, and so no forces in them')
        kept = (workspace.kept for workspace in self._memories[self._active]
                if hasattr(workspace, 'kept'))
        means = next(own.means for own in kept if hasattr(own, 'means'))
        return self.system.constraints.forces(self.q.ravel(), means)

    @property
    def initial_energy(self) -> float:
        """Return H0 of the energy balance [J]."""
        return self._energy0

    @property
    def energy_balance(self) -> float:
        """Return the energy error H - H0 - W [J], which is of the order of the method."""
        return self.energy - self._energy0 - self.work

    @property
    def causes(self) -> np.ndarray | None:
        """Return the energy by cause [J], in the order of the ledger's names; None without."""
        return None if self.ledger is None else self.ledger.values(
            self.q.ravel(), self.energy, self.energy_balance)

    @property
    def energies(self) -> tuple[float, float | None]:
        """Return energy and modified energy [J], at little more than the cost of one of them."""
        energy, more = self.energy, self.modification
        return energy, None if more is None else energy + more

    @property
    def modification(self) -> float | None:
        """Return the modified energy minus the energy [J], None if unknown."""
        if self.system.integrator is not self.integrator:
            return None
        value = self.integrator.modified_energy(
            self.hamiltonian, self.step_size, self.q, self.p, 0.0, self.dH_dq, self.dH_dp)
        return None if value is None else float(value.sum())

    @property
    def modified_energy(self) -> float | None:
        """Return the energy that the integrator nearly conserves [J], None if unknown."""
        return self.energies[1]

    def snapshot(self) -> dict[str, np.ndarray]:
        """Return copies of all arrays that the next steps depend on, by name; see ``restore``."""
        # The names 'way' and 'live' are those in the files of existing bags.
        counts = {'steps': self.steps, 'energy0': self._energy0, 'way': self._active}
        return {name: np.array(value) for name, value in counts.items()} | {
            name: array.copy() for name, array in self.state.named.items()}

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Restore a snapshot of an equal simulation; the following steps are bit-identical."""
        self.put(self.state.row_of(snapshot))
        if self.second is not None:
            self.second.begin_anew()

    @property
    def row(self) -> np.ndarray:
        """Return a snapshot as one array, shape (R,); see State."""
        return self.state.row(self._energy0, self.steps, self._active)

    def put(self, row: np.ndarray) -> None:
        """Restore a row of an equal simulation; the following steps are bit-identical."""
        self._energy0, self.steps, self._active = float(row[0]), int(row[1]), max(int(row[2]), 0)
        self.state.put(row)
        if row[2] < 0.0:
            self._evaluate_gradient()
        self._update_gradient()

    def put_from(self, other: 'Simulation', row: np.ndarray) -> None:
        """Restore a row of another simulation of the same system, with other steps."""
        # The gradient in the row may contain mean rates over its steps.
        self.system.effect_state.step[:] = other.system.effect_state.step
        self.put(row)

    def rows(self, z: np.ndarray, time: ArrayLike = 0.0, step: ArrayLike = 0) -> np.ndarray:
        """Return rows, (m, R), of states (q, p), (m, 2 d), at step `step`, time + step h [s]."""
        time = np.asarray(time) + np.asarray(step) * self.step_size
        return self.state.fresh(z, self.hamiltonian.dimension, time, step)

    def work_in(self, rows: np.ndarray) -> float:
        """Return the work of all effects, summed over rows [J]."""
        first = 3 + 6 * self._kernel.dimension + 2
        return float(rows[:, first:first + self.system.effect_state.work.size].sum())

    def follow(self, rows: np.ndarray, commands: np.ndarray, hold: int = 1,
               law: CommandLaw | None = None) -> tuple[np.ndarray, np.ndarray]:
        """
        Take steps of many states with individual commands, in one compiled loop.

        The rows are independent, and the steps are bit-identical to those of a simulation that
        was restored from the row. The state of this simulation is overwritten.

        Parameters
        ----------
        rows : np.ndarray, shape (m, R)
            See ``row`` and ``rows``. On return the final rows, or those before a failed step.
        commands : np.ndarray, shape (m, N, c) or (m, N, 0)
            Commands of plain numbers, which do not expire; with shape (m, N, 0) the commands
            in the rows continue.
        hold : int, optional
            Number of steps per command.
        law : CommandLaw, optional
            Feedback and limits, which are applied to the commands in place.

        Returns
        -------
        tuple of np.ndarray, shape (m, N + 1, 2 d) and (m,)
            States (q, p), NaN after a failed step; and numbers of steps taken.

        """
        rows_in, count, c = commands.shape
        path = np.empty((rows_in, count + 1, 2 * self.hamiltonian.dimension))
        taken = np.empty(rows_in, dtype=np.int64)
        if self._follow is None:
            self._follow = Loop(follow_each, self._kernel, self._rescue.methods[0])
        law, first, steps = law or CommandLaw.none(c), 0, max(1, hold * count)
        while first < rows_in:
            part = slice(first, first + max(1, self._most_followed // steps))
            begin, first = time.perf_counter(), part.stop
            self._follow(self.step_size, hold, count, self._z, self._z1, self._memories[0],
                         self.state.flat, rows[part], self.system.effect_state.command,
                         self.system.places, law.of(part), commands[part], path[part],
                         taken[part])
            if first < rows_in:
                seconds = time.perf_counter() - begin
                self._most_followed = max(1, int(
                    self._most_followed * min(_MAX_GROWTH, _CALL_TIME / seconds)))
                check_interrupt()
        return path, taken

    def follow_on(self, rows: np.ndarray, commands: np.ndarray, hold: int = 1,
                  strict: bool = True) -> np.ndarray:
        """
        Return the path of ``follow``, with failed steps retried by fallbacks.

        If all fallbacks fail it raises StepFailure if strict; otherwise the row, and its path from
        there on, are NaN.
        """
        before = rows.copy()
        path, taken = self.follow(rows, commands, hold)
        for m in np.flatnonzero((taken < hold * commands.shape[1]) & ~np.isnan(before[:, 2])):
            self.put(before[m])
            path[m, 1:] = np.nan
            try:
                for n, command in enumerate(commands[m]):
                    if command.size:
                        self.set_command(command)
                    self.advance(hold)
                    path[m, n + 1, :self.q.size + self.p.size] = np.append(self.q, self.p)
                rows[m] = self.row
            except StepFailure:
                if strict:
                    raise
                rows[m] = np.nan
        return path

    def advance(self, n: int, until: float = math.inf) -> int:
        """
        Take n steps, or raise StepFailure; see ``record``.

        Parameters
        ----------
        n : int
            Number of steps.
        until : float, optional
            Deadline, as a value of ``time.perf_counter`` [s].

        Returns
        -------
        int
            Number of steps taken, at least one.

        """
        before, (q, p) = self.steps, np.empty((2, 1, self._z.q.size))
        self._take(n, q, p, until)
        return self.steps - before

    def dense_step(self) -> DenseStep:
        """Take one step and return it with dense output, or raise StepFailure."""
        return DenseStep(self, self.system.integrator is self.integrator
                         and self._kernel.channels == 0 and not self.hamiltonian.rotations,
                         lambda: self.system.cuts)

    def record(self, samples: int, every: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Take samples times every steps, and return the samples.

        Returns
        -------
        tuple of np.ndarray, shape (samples, d) or (samples, m, d)
            q and p after each ``every`` steps.

        Raises
        ------
        StepFailure
            A step did not converge, or its result is not finite; the state is that before it.

        """
        q_out, p_out = np.empty((2, samples, self._z.q.size))
        self._take(every, q_out, p_out)
        return (np.ascontiguousarray(self._state(q_out)),
                np.ascontiguousarray(self._state(p_out)[..., :self._momenta]))

    @property
    def time(self) -> float:
        """Return the simulated time since the initial state [s]."""
        return self.steps * self.step_size

    def compile(self) -> float:  # noqa: A003
        """Compile the kernel before the first step; return the wall time [s]."""
        start = time.perf_counter()
        self._take(0, *np.empty((2, 0, self._z.q.size)))
        return time.perf_counter() - start

    def shared(self) -> tuple[Any, ...]:
        """Return kernel, step, h, options, points, workspaces and fallbacks, all compiled."""
        own = self.step_size, self._z, self._z1, self._memories[0]
        return (*self._loop(0).shared(*own, *np.empty((2, 1, self._z.q.size)), 1),
                self._rescue.fallbacks(0, *own))

    def compile_rescue(self) -> None:
        """Compile the fallbacks of failed steps now; another thread may take steps meanwhile."""
        try:
            n = self._z.q.size
            for active, memory in enumerate(self._rescue.memories(n)):
                own = self.step_size, PhasePoint.empty(n), PhasePoint.empty(n), memory
                self._loop(active).shared(*own, *np.empty((2, 1, n)), 1)
                self._rescue.fallbacks(active, *own)
        finally:
            self.rescue_ready = True

    def _loop(self, active: int) -> Loop:
        """Return the cached loop of a method."""
        if active not in self._loops:
            self._loops[active] = Loop(advance, self._kernel, self._rescue.methods[active])
        return self._loops[active]

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return all arrays that the next steps depend on, by name."""
        groups: dict[str, Any] = {'point': self._z, 'live': self.system.effect_state} | {
            f'memory{active}.{k}': workspace.kept for active, memory in enumerate(self._memories)
            for k, workspace in enumerate(memory) if hasattr(workspace, 'kept')}
        return {name: array for place, group in groups.items()
                for name, array in arrays_of(place, group)
                if name not in ('live.step', 'live.part', 'live.expiry')
                and (array.size or name != 'live.on_stops')
                } | self.system.changing

    def _evaluate_gradient(self) -> None:
        self._kernel.gradient(
            self._kernel.parameters, self._z.q, self._z.p, self._z.dH_dq, self._z.dH_dp)

    def _update_gradient(self) -> None:
        """Update the public gradient to the current state."""
        if self._rescue.methods[self._active].keeps_gradient:
            self._dH_dq[:], self._dH_dp[:] = self._z.dH_dq, self._z.dH_dp
        else:
            self._kernel.gradient(
                self._kernel.parameters, self._z.q, self._z.p, self._dH_dq, self._dH_dp)

    def _take(self, every: int, q_out: np.ndarray, p_out: np.ndarray, until: float = math.inf
              ) -> None:
        """Take the steps to the last sample, or up to the deadline, or raise StepFailure."""
        done, last, begun, second = 0, len(q_out) * every, self.steps, self.second
        if second is None or not last:
            self._take_steps(done, last, every, q_out, p_out, until)
        while second is not None and done < last:
            span, recorded = second.span()
            span = min(span, last - done)
            if recorded:
                self._take_recorded(second, done, span, every, q_out, p_out, until)
            else:
                self._take_steps(done, done + span, every, q_out, p_out, until)
            if self.steps - begun < done + span:
                break  # the deadline has passed
            done += span
        self._update_gradient()

    def _take_recorded(self, second: 'SecondRun', done: int, span: int, every: int,
                       q_out: np.ndarray, p_out: np.ndarray, until: float) -> None:
        """Take `span` steps after step `done` as in ``_take``, and pass their states on."""
        begun, (q, p) = self.steps, np.empty((2, span, self._z.q.size))
        try:
            self._take_steps(0, span, 1, q, p, until)
        finally:
            second.take(q[:self.steps - begun])
        # Samples are at the steps after `done` that are whole multiples.
        first = every - 1 - done % every
        sampled = q[first:self.steps - begun:every], p[first:self.steps - begun:every]
        for out, part in zip((q_out, p_out), sampled, strict=True):
            out[done // every:done // every + len(part)] = part

    def _take_steps(self, done: int, last: int, every: int, q_out: np.ndarray, p_out: np.ndarray,
                    until: float) -> None:
        """Take the steps after step `done` up to `last`, and record samples; see ``_take``."""
        changed = -1
        begun, before, costs = done, self.row, self._costs
        while True:
            outcome, done, residual, spent = self._run(done, last, every, q_out, p_out)
            if outcome != OK and not self.rescue_ready:
                self._go_back(before, costs, done - begun)
                raise RescuePending
            if outcome == BEYOND and (self._active == 0 or done > changed):
                self._change_method()
                changed = done
                continue
            if outcome != OK:
                failure = self._take_failed_step(outcome, residual, spent)
                if failure is not None:
                    # Discard all traces of the failed step in the arrays for the next steps: a
                    # replay repeats only successful steps.
                    costs = self._costs
                    self._go_back(before, costs, done - begun)
                    self._costs = costs
                    raise failure
                done += 1
                if done % every == 0:
                    q_out[done // every - 1], p_out[done // every - 1] = self._z.q, self._z.p
            if done >= last or time.perf_counter() >= until:
                break
            check_interrupt()
            begun, before, costs = done, self.row, self._costs

    def _run(self, done: int, last: int, every: int, q_out: np.ndarray, p_out: np.ndarray
             ) -> tuple[int, int, float, int]:
        """Call the loop; return outcome, steps done, residual and gradients of the last step."""
        begin, loop = time.perf_counter(), self._loop(self._active)
        outcome, now, gradients, self.residual, spent, most, costliest = loop(
            self.step_size, done, every, self._z, self._z1, self._memories[self._active],
            q_out, p_out, min(last, done + self._most))
        if now - done == self._most:
            seconds = time.perf_counter() - begin
            self._most = max(1, int(self._most * min(_MAX_GROWTH, _CALL_TIME / seconds)))
        self.costliest = max(self.costliest, (most, self.steps + costliest + 1 - done), key=_FIRST)
        self.steps, self.gradients = self.steps + now - done, self.gradients + gradients
        self.rescued += (now - done) * (self._active != 0)
        return outcome, now, self.residual, spent

    @property
    def _costs(self) -> _Costs:
        """Return the counters of costs."""
        return (self.gradients, self.rescued, self.several_solutions, self.residual,
                self.costliest)

    @_costs.setter
    def _costs(self, costs: _Costs) -> None:
        """Set the counters of costs."""
        (self.gradients, self.rescued, self.several_solutions, self.residual,
         self.costliest) = costs

    def _go_back(self, row: np.ndarray, costs: _Costs, done: int) -> None:
        """Repeat the successful steps from a row, to discard all traces of a failed one."""
        self.put(row)
        self._costs = costs
        q, p = np.empty((2, 1, self._z.q.size))
        self._take_steps(0, done, max(done, 1), q, p, math.inf)
        self._update_gradient()

    def _change_method(self) -> None:
        """Switch to the other method, started as from an initial state."""
        self._active = 1 - self._active
        discard_history(self._memories[self._active])
        self._evaluate_gradient()
        self.gradients += 1

    def _take_failed_step(self, outcome: int, residual: float, spent: int) -> StepFailure | None:
        """Take one step by the fallbacks; return the failure if all of them fail."""
        z, z1 = self._z, self._z1
        doubtful = np.append(z1.q, z1.p)
        taken = self._rescue.take_step(
            self._active, self.step_size, z, z1, self._memories[self._active])
        if outcome == IN_DOUBT:
            outcome, residual = taken.outcome, taken.residual
            self.several_solutions += taken.ok and not (taken.rescued or np.allclose(
                doubtful, np.append(z.q, z.p), _MAX_DISTANCE, _MAX_DISTANCE * abs(doubtful).max()))
        self.gradients += taken.gradients
        self.rescued += taken.rescued or (taken.ok and self._active != 0)
        self.residual = self.residual if np.isnan(taken.residual) else taken.residual
        spent += taken.gradients
        if not taken.ok:
            outcome = taken.outcome if taken.outcome == NO_SOLUTION else outcome
            reason = self.system.reason(outcome)
            if taken.given_up:
                reason += f', abandoned after {taken.given_up} gradients in sub-steps'
            return step_failure(outcome, self.time, self.step_size, residual, spent, reason)
        self.steps += 1
        self.costliest = max(self.costliest, (spent, self.steps), key=_FIRST)
        return None


class Probe:
    """
    Trials of steps from rows of a simulation, in another one that shares its code.

    The simulation itself is not touched, so that a trial leaves no trace in its steps.

    Parameters
    ----------
    simulation : Simulation
        Simulation whose rows are tried.

    """

    def __init__(self, simulation: Simulation):
        self._of, self._own = simulation, simulation.sibling()

    @property
    def _h(self) -> float:
        return self._of.step_size

    def trial(self, row: np.ndarray, step_size: float, samples: int = 1, every: int = 1
              ) -> tuple[np.ndarray, np.ndarray]:
        """
        Take steps of another size from a row.

        Parameters
        ----------
        row : np.ndarray, shape (R,)
            Row of the simulation; see ``Simulation.row``.
        step_size : float
            Step size of the trial [s].
        samples, every : int, optional
            See ``record``. With `dop853`, whose internal steps do not depend on the step size, the
            tolerances are divided by every^8, as errors of steps of 1 / every would be.

        Returns
        -------
        tuple of np.ndarray, shape (samples, d) or (samples, m, d)
            q and p after each ``every`` steps.

        Raises
        ------
        StepFailure
            A step did not converge, or its result is not finite.

        """
        # Earlier solutions at another step size do not fit as initial guesses.
        with self._at(self._of.state.without_counts(row)) as clock:
            self._own.step_size = step_size
            if isinstance(clock, PairWork):
                clock.factor[0] = float(every) ** -self._of.integrator.order
            return self._own.record(samples, every)

    def clock_trial(self, row: np.ndarray, elapsed: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return q and p at a time after a row [s], for a method with internal steps.

        The internal steps have the same lengths as in a whole step of the clock.
        """
        with self._at(row) as clock:
            clock.own_step[:], self._own.step_size = self._h, elapsed
            self._own.advance(1)
            return self._own.q.copy(), self._own.p.copy()

    def own_states(self, row: np.ndarray) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """
        Return the states at the ends of a method's internal steps within a step of the clock.

        Parameters
        ----------
        row : np.ndarray, shape (R,)
            Row at the start of the step.

        Returns
        -------
        list of (float, np.ndarray, np.ndarray)
            Time since the row [s], q and p of shape (d,).

        """
        found: list[tuple[float, np.ndarray, np.ndarray]] = []
        h, elapsed, simulation = self._h, 0.0, self._own
        with self._at(row) as clock:
            ahead, n = clock.kept, simulation.state.size
            clock.own_step[0] = h
            while True:
                lead = float(ahead.clock[1]) if ahead.count[0] else 0.0
                end = elapsed + lead
                if end >= h:
                    return found
                if end > 0.0:
                    found.append((end, ahead.state.q[:n].copy(), ahead.state.p[:n].copy()))
                # Use the shortest step of the clock that takes one more internal step.
                simulation.step_size = math.nextafter(lead, math.inf)
                simulation.advance(1)
                elapsed += simulation.step_size

    def series(self, row: np.ndarray) -> DenseOutput:
        """Return the path of an adaptive method in a step from a row, shape (R,)."""
        simulation, work = self._own, self._of.workspace
        if isinstance(work, TaylorWork):
            return work.path(simulation.system.kernel, self._h,
                             row[HEAD:HEAD + 2 * simulation.state.size])
        h, time, ends, parts = self._h, 0.0, [0.0], list[np.ndarray]()
        d = simulation.hamiltonian.dimension
        with self._at(row) as work:
            kept = work.kept
            while time < h:
                # In the shortest step of the clock an internal step is taken, if needed.
                work.own_step[:], simulation.step_size = (h, h - time), _SHORTEST
                simulation.advance(1)
                lead, length = kept.clock[0, 0], kept.length[0]
                simulation.step_size = min(lead, h - time)
                begin = 1.0 - lead / length
                parts.append(np.hstack([path_in_legendre(
                    path[:, :d], begin, begin + simulation.step_size / length)
                    for path in (kept.path_q, kept.path_p)]))
                work.own_step[1] = h - time
                simulation.advance(1)
                time = h if lead >= h - time else time + lead
                ends.append(time / h)
        return DenseOutput(7, np.stack(parts, axis=1), d, np.array(ends), in_legendre=True)

    @contextmanager
    def _at(self, row: np.ndarray) -> Iterator[Any]:
        """Start from a row, with the step size of the simulation; yield the internal clock."""
        simulation = self._own
        simulation.rescue_ready, simulation.step_size = self._of.rescue_ready, self._h
        simulation.put_from(self._of, row)
        clock = simulation.workspace
        try:
            yield clock
        except StepFailure as failure:
            failure.h = self._h
            raise failure.dated(int(row[1]) * self._h) from None
        finally:
            if hasattr(clock, 'own_step'):
                clock.own_step[:] = 0.0
            if isinstance(clock, PairWork):
                clock.factor[0] = 1.0
