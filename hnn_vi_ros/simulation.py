# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A scene compiled into one kernel that advances the state by whole steps."""

from collections.abc import Callable, Sequence
import time
from typing import TYPE_CHECKING
import warnings

from hnn_vi_ros.compilation import entry_point
from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.arithmetic import copy_point, is_finite
from hnn_vi_ros.integrators.base import Integrator, NOT_FINITE, OK, Point, REASONS
from hnn_vi_ros.loops import advance, assemble, take_substeps
from hnn_vi_ros.phase_space import check_state
from hnn_vi_ros.system import System
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.scene import Scene

# A step that fails is tried again in at most 2^6 = 64 sub-steps.
_HALVINGS = 6


class Simulation:
    """
    A Hamiltonian, an integrator and a state that advances by whole steps.

    Time is the count of steps times the step size, never a sum of floats. A failed step leaves
    the last good state in place.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Of d degrees of freedom.
    integrator : Integrator
        The one-step map.
    step_size : float
        h > 0 [s].
    q, p : sequence of float, shape (d,) or (m, d)
        Initial state, or those of m trajectories that step together.
    effects : sequence of Effect
        What acts on the system beside H.

    Attributes
    ----------
    hamiltonian : Hamiltonian
        H with the potentials among the effects.
    conservative, takes_commands : bool
        Whether no effect does work, and whether one is an external force.
    steps : int
        Steps taken since the initial state.
    q, p : np.ndarray, shape (d,) or (m d,), with forces (d,) or (m, d)
        The state; copy it before the next ``advance``.
    dH_dq, dH_dp : np.ndarray, of the shape of q
        -p' and q' there: the gradient of H, less the forces that join it at the method's nodes.
    rescued : int
        Steps that converged only as sub-steps of ``integrator.substep()``.
    residual : float
        Relative residual of the last implicit step [1].
    gradients : int
        Gradients and Hessian-vector products evaluated in steps since the initial state.

    Raises
    ------
    UnsupportedSystem
        The integrator cannot integrate this Hamiltonian with these effects.
    EffectError, ValueError
        An effect, the step size or the state is not usable.
    StepFailure
        H has no finite gradient at the initial state.

    """

    def __init__(self, hamiltonian: Hamiltonian, integrator: Integrator, step_size: float,
                 q: Sequence[float], p: Sequence[float], effects: Sequence[Effect] = ()):
        if not (np.isfinite(step_size) and step_size > 0.0):
            raise ValueError(f'step_size = {step_size} must be a positive number of seconds')
        self._system = System(hamiltonian, effects, integrator)
        self.hamiltonian, self.integrator = self._system.hamiltonian, integrator
        self.conservative, self.takes_commands = (
            self._system.conservative, self._system.takes_commands)
        self.step_size = float(step_size)
        self._kernel, self._method = self._system.kernel, self._system.integrator
        if not self._kernel.compiled:
            warnings.warn(
                f'{type(hamiltonian).__name__} is not a tanh network of ours: its gradient comes '
                'from plain Python or autograd in every step, which is slower', stacklevel=2)
        self._advance, self._step, self._options = assemble(advance, self._kernel, self._method)
        self._entry: Callable | None = None
        self.restart(q, p)

    def restart(self, q: Sequence[float], p: Sequence[float], stream: int = 0) -> None:
        """Begin anew, with the constructor's errors; each stream of a seed has its own noise."""
        q, p = check_state(q, p, self.hamiltonian.dimension)
        self._system.check_state(q, p)
        self._system.live.reset(stream)
        self.steps, self.rescued, self.gradients, self.residual = 0, 0, 0, 0.0
        n = q.size // self.hamiltonian.dimension * self._kernel.dimension
        self._z, self._z1 = Point.empty(n), Point.empty(n)
        self._memory = self._method.memory(n)
        self.q, self.p = self._state(self._z.q), self._state(self._z.p)
        self.q[:], self.p[:] = q.reshape(self.q.shape), p.reshape(self.q.shape)
        # Not the point's own: what a step finds there must not depend on when it was looked at.
        self._dH_dq, self._dH_dp = np.empty((2, n))
        self.dH_dq, self.dH_dp = self._state(self._dH_dq), self._state(self._dH_dp)
        self._evaluate_gradient()
        if not is_finite(self._z):
            raise StepFailure(REASONS[NOT_FINITE], 0.0, self.step_size, np.nan, 0)
        self._update_gradient()
        self._energy0 = self.energy

    def _state(self, array: np.ndarray) -> np.ndarray:
        """Return the view of an array of n unknowns that leaves the channels of forces out."""
        if self._kernel.channels == 0:
            return array
        view = array.reshape(-1, self._kernel.dimension)[:, :self.hamiltonian.dimension]
        return view[0] if len(view) == 1 else view

    def _evaluate_gradient(self) -> None:
        self._kernel.gradient(
            self._kernel.parameters, self._z.q, self._z.p, self._z.dH_dq, self._z.dH_dp)

    def set_command(self, values: Sequence[float]) -> None:
        """Set the external force [N] or [N m] from now on, or raise ValueError and leave it."""
        self._system.command(values)
        self._evaluate_gradient()
        self._update_gradient()

    @classmethod
    def from_scene(cls, scene: 'Scene') -> 'Simulation':
        """Build what a scene describes; HnnViRosError where its parts do not fit together."""
        scene = scene.resolved()
        parts = scene.create_hamiltonian(), scene.create_integrator(), scene.step_size
        effects, state = scene.create_effects(), scene.initial_state
        with scene.placed('initial_state'):
            return cls(*parts, state.q, state.p, effects)

    @property
    def time(self) -> float:
        """Return the simulated time since the initial state [s]."""
        return self.steps * self.step_size

    @property
    def energy(self) -> float:
        """Return H(q, p) [J], the sum of those of several trajectories."""
        kernel, z, d = self._kernel, self._z, self._kernel.dimension
        return sum(float(kernel.energy(kernel.parameters, z.q[a:a + d], z.p[a:a + d]))
                   for a in range(0, z.q.size, d))

    @property
    def works(self) -> dict[str, float]:
        """Return the work that each effect has done on the system since the initial state [J]."""
        works = self._system.live.work.sum(axis=1).tolist()
        return dict(zip(self._system.labels, works, strict=True))

    @property
    def work(self) -> float:
        """Return the work of all effects [J]."""
        return float(self._system.live.work.sum())

    @property
    def budget(self) -> float:
        """Return H - H0 - W [J], which closes at the order of the method."""
        return self.energy - self._energy0 - self.work

    @property
    def modified_energy(self) -> float | None:
        """Return the energy that the integrator nearly conserves [J], None if none is known."""
        if self._method is not self.integrator:
            return None
        value = self.integrator.modified_energy(
            self.step_size, self.energy, self.dH_dq, self.dH_dp)
        return None if value is None else float(value)

    def compile(self) -> float:  # noqa: A003
        """Compile the kernel now, not in the first step; return the wall time it took [s]."""
        start = time.perf_counter()
        self.record(0, 0)
        return time.perf_counter() - start

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return, by name, all arrays that the next steps depend on."""
        stores = {'point': self._z, 'live': self._system.live} | {
            f'memory{k}': store for k, store in enumerate(self._memory)}
        return {f'{name}.{field}': array for name, store in stores.items()
                for field, array in store._asdict().items()}

    def snapshot(self) -> dict[str, np.ndarray]:
        """Return copies of all that the next steps depend on; see ``restore``."""
        return {'steps': np.array(self.steps), 'energy0': np.array(self._energy0)} | {
            name: array.copy() for name, array in self._arrays().items()}

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """
        Go back to a snapshot; the steps that follow are those that followed it, bit by bit.

        Raises
        ------
        KeyError, ValueError
            It was taken from another kind of simulation.

        """
        self.steps, self._energy0 = int(snapshot['steps']), float(snapshot['energy0'])
        for name, array in self._arrays().items():
            array[...] = snapshot[name]
        self._update_gradient()

    def _update_gradient(self) -> None:
        """Make the public gradient that of the state."""
        if self._method.keeps_gradient:
            self._dH_dq[:], self._dH_dp[:] = self._z.dH_dq, self._z.dH_dp
        else:
            self._kernel.gradient(
                self._kernel.parameters, self._z.q, self._z.p, self._dH_dq, self._dH_dp)

    def advance(self, n: int) -> None:
        """Take n steps, or raise StepFailure; see ``record``."""
        self.record(1, n)

    def record(self, samples: int, every: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Take samples times every steps.

        Returns
        -------
        tuple of np.ndarray, shape (samples, d) or (samples, m d)
            q and p after each ``every`` steps.

        Raises
        ------
        StepFailure
            A step did not converge or is not finite; the state is that before the step.

        """
        q_out = np.empty((samples, self._z.q.size))
        p_out = np.empty_like(q_out)
        done, outcome = 0, OK
        while True:
            before = done
            arguments = (self._step, self._kernel, self.step_size, self._options, done, every,
                         self._z, self._z1, self._memory, q_out, p_out)
            if self._entry is None:
                self._entry = entry_point(self._advance, *arguments)
            outcome, done, gradients, residual, spent = self._entry(*arguments)
            self.residual = residual
            self.steps += done - before
            self.gradients += gradients
            if outcome == OK or not (self._step_by_other_solvers() or self._step_in_parts()):
                break
            self.steps += 1
            done += 1
            if done % every == 0:
                q_out[done // every - 1], p_out[done // every - 1] = self._z.q, self._z.p
        self._update_gradient()
        if outcome != OK:
            raise StepFailure(REASONS[outcome], self.time, self.step_size, residual, spent)
        keep = self._state(np.arange(self._z.q.size)).ravel()
        return (q_out[:, keep], p_out[:, keep]) if self._kernel.channels else (q_out, p_out)

    def _step_by_other_solvers(self) -> bool:
        """Take one step with the later links of the chain; False if none converges."""
        for link in range(1, self._method.links):
            loop, step, options = assemble(advance, self._kernel, self._method, link)
            q, p = np.empty((2, 1, self._z.q.size))
            outcome, _, gradients, self.residual, _ = loop(
                step, self._kernel, self.step_size, options, 0, 1, self._z, self._z1,
                self._memory, q, p)
            self.gradients += gradients
            if outcome == OK:
                return True
        return False

    def _step_in_parts(self) -> bool:
        """Take one step as 2, 4, ... sub-steps of a symmetric method; False if none will do."""
        method = self._method.substep()
        if method is None:
            return False
        loop, substep, options = assemble(take_substeps, self._kernel, method)
        live = [array.copy() for array in self._system.live]
        for k in range(1, _HALVINGS + 1):
            z = Point(*[array.copy() for array in self._z])
            recovered, gradients = loop(
                substep, self._kernel, self.step_size, options, 2 ** k, z, self._z1,
                method.memory(self._z.q.size))
            self.gradients += gradients
            if recovered:
                copy_point(z, self._z)
                # What came before is no guide to the next start.
                for store in self._memory:
                    store.count[0] = 0
                self.rescued += 1
                return True
            # Parts of the step may have been taken, and their time and work counted.
            for array, before in zip(self._system.live, live, strict=True):
                array[...] = before
        return False
