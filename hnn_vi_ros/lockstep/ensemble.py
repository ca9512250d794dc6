# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An ensemble of trajectories of one scene that takes its steps in torch."""

from collections.abc import Sequence
from typing import NamedTuple, NoReturn

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.base import Integrator, NOT_FINITE, OK
from hnn_vi_ros.integrators.gauss import Tableau
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import SolverOptions
from hnn_vi_ros.lockstep.devices import open_device
from hnn_vi_ros.lockstep.gradient import make_gradient
from hnn_vi_ros.lockstep.steps import first_state, State, step_of, Stepped, System
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.system import System as CompiledSystem
import numpy as np
import torch


class Counts(NamedTuple):
    """
    Counts of each of m trajectories, as of ``Simulation``.

    Parameters
    ----------
    rescued, several_solutions : np.ndarray of int, shape (m,)
        Steps that were taken otherwise, and those with another solution.
    costliest, at : np.ndarray of int, shape (m,)
        The most gradients of a step, and the number of steps at its end.

    """

    rescued: np.ndarray
    several_solutions: np.ndarray
    costliest: np.ndarray
    at: np.ndarray


class Recorded(NamedTuple):
    """
    Results of m trajectories.

    Parameters
    ----------
    q, p : np.ndarray, shape (n, m, d)
        Samples; NaN from the failure of a trajectory on.
    failures : dict of int to StepFailure
        Of those that failed, by number.
    counts : Counts
        Of all steps.

    """

    q: np.ndarray
    p: np.ndarray
    failures: dict[int, StepFailure]
    counts: Counts


class LockstepEnsemble:
    """
    Many trajectories of one scene, each of which is solved by itself.

    A step that the method's own solver does not take is taken by ``Simulation``, for that
    trajectory alone, with all its fallbacks: by Newton's method, by continuation, in sub-steps.
    What these do not take either fails, with the same reason.

    Parameters
    ----------
    hamiltonian, integrator, step_size, effects, on_failure
        See Simulation.
    device : str
        See ``open_device``.

    Raises
    ------
    UnsupportedSystem
        An effect, H or the method has no step on a device; says what has.
    ValueError, ParameterError
        There is no such device.

    """

    def __init__(self, hamiltonian: Hamiltonian, integrator: Integrator, step_size: float,
                 effects: Sequence[Effect], on_failure: str, device: str):
        self._device = open_device(device)
        if effects:
            labels = CompiledSystem(hamiltonian, effects, integrator).labels
            raise UnsupportedSystem(
                f'{", ".join(labels)}: trajectories step on a device without effects; leave '
                'device out, or the effects')
        self._step = step_of(integrator)
        assert isinstance(integrator, ImplicitIntegrator), 'only such have a step here'
        self._hamiltonian, self._integrator, self._h = hamiltonian, integrator, step_size
        self._on_failure, self._alone = on_failure, None
        options: SolverOptions | Tableau = integrator.options(dimension=hamiltonian.dimension)
        self._system = System(
            make_gradient(hamiltonian, self._device), hamiltonian.dimension,
            hamiltonian.kernel.gradient_scale, step_size,
            options.solver if isinstance(options, Tableau) else options)

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled."""
        raise TypeError('an ensemble on a device cannot be copied: build another one')

    _alone: Simulation | None

    def record(self, q: np.ndarray, p: np.ndarray, samples: Sequence[int]) -> Recorded:
        """
        Take steps from initial states, and samples.

        Parameters
        ----------
        q, p : np.ndarray, shape (m, d)
            Initial states.
        samples : sequence of int
            The numbers of steps, rising, at which to take samples.

        """
        m, d = q.shape
        z = torch.from_numpy(np.hstack([q, p]).T.copy()).to(self._device)
        state = first_state(self._system, self._integrator, z)
        out = np.full((len(samples), 2 * d, m), np.nan)
        counts, failures = Counts(*np.zeros((4, m), dtype=np.int64)), dict[int, StepFailure]()
        most, at = (torch.zeros(m, dtype=torch.int64, device=self._device) for _ in range(2))
        rows = np.arange(m)
        for steps in range(1, (samples[-1] if samples else 0) + 1):
            stepped = self._step(self._system, state)
            gradients, state = stepped.gradients, self._finished(
                state, stepped, steps - 1, rows, counts, failures)
            more = gradients > most
            most, at = torch.where(more, gradients, most), torch.where(more, steps, at)
            if len(failures) > m - len(rows):
                left = [k for k, row in enumerate(rows) if row not in failures]
                chosen = torch.tensor(left, dtype=torch.int64, device=self._device)
                _count(counts, rows, most, at)
                state, rows, most, at = state.of(chosen), rows[left], most[chosen], at[chosen]
            if steps in samples:
                out[samples.index(steps)][:, rows] = state.z.cpu().numpy()
            if not len(rows):
                break
        _count(counts, rows, most, at)
        for k, steps in enumerate(samples):
            if steps == 0:
                out[k] = z.cpu().numpy()
        q_out, p_out = out.transpose(0, 2, 1)[..., :d], out.transpose(0, 2, 1)[..., d:]
        return Recorded(np.ascontiguousarray(q_out), np.ascontiguousarray(p_out), failures, counts)

    def _finished(self, before: State, stepped: Stepped, steps: int, rows: np.ndarray,
                  counts: Counts, failures: dict[int, StepFailure]) -> State:
        """Return the state after a step, with what ``Simulation`` has taken of it."""
        after = stepped.state
        finite = (after.z.isfinite() & after.slope.isfinite()).all(dim=0)
        outcome = torch.where((stepped.outcome == OK) & ~finite, NOT_FINITE, stepped.outcome)
        for k in (outcome != OK).nonzero()[:, 0].tolist():
            try:
                z, slope = self._take_alone(before.z[:, k].cpu().numpy(), int(rows[k]), counts)
            except StepFailure as failure:
                failures[int(rows[k])] = failure.dated(steps * self._h)
                continue
            after.z[:, k], after.slope[:, k] = (
                torch.from_numpy(part).to(self._device) for part in (z, slope))
            # What came before is no guide to the next start.
            after.carry[:, k], after.counts[:, k] = 0.0, 0
        return after

    def _take_alone(self, z: np.ndarray, row: int, counts: Counts
                    ) -> tuple[np.ndarray, np.ndarray]:
        """Take a step of one trajectory by compiled loops; return z and (H_q, H_p) after it."""
        q, p = np.split(z, 2)
        if self._alone is None:
            self._alone = Simulation(self._hamiltonian, self._integrator, self._h, q, p,
                                     on_failure=self._on_failure)
        alone = self._alone
        alone.restart(q, p)
        alone.advance(1)
        counts.rescued[row] += alone.rescued
        counts.several_solutions[row] += alone.several_solutions
        counts.costliest[row] = max(counts.costliest[row], alone.costliest[0])
        return np.append(alone.q, alone.p), np.append(alone.dH_dq, alone.dH_dp)


def _count(counts: Counts, rows: np.ndarray, most: torch.Tensor, at: torch.Tensor) -> None:
    """Enter what the costliest steps of some trajectories took."""
    found, ends = most.cpu().numpy(), at.cpu().numpy()
    more = found > counts.costliest[rows]
    counts.costliest[rows[more]], counts.at[rows[more]] = found[more], ends[more]
