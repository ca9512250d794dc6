# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensemble of trajectories of one scene, stepped in torch on a given device."""

from collections.abc import Sequence
from typing import NamedTuple, NoReturn

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import ParameterError, StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import (
    ImplicitIntegrator, Integrator, NOT_FINITE, OK, SolverOptions, Tableau)
from hnn_vi_ros.simulation.batches.gradient import make_gradient
from hnn_vi_ros.simulation.batches.steps import BatchState, BatchSystem, first_state, step_of
from hnn_vi_ros.simulation.processors import check_interrupt
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System as CompiledSystem
import numpy as np
import torch

VALID = 'cpu, cuda, cuda:N'


def open_device(name: str) -> torch.device:
    """
    Return an available torch device.

    Parameters
    ----------
    name : str
        ``'cpu'``, ``'cuda'``, or ``'cuda:N'`` for GPU N, counted from 0.

    Raises
    ------
    ValueError
        Unknown name.
    ParameterError
        The GPU is not available.

    """
    kind, _, number = name.partition(':')
    if name != 'cpu' and (kind != 'cuda' or (name != 'cuda' and not number.isdecimal())):
        raise ValueError(f'device = {name!r} is unknown; valid: {VALID}')
    if kind == 'cuda':
        there = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if int(number or 0) >= there:
            raise ParameterError(
                f'device = {name}: torch {torch.__version__} finds {there or "no"} CUDA '
                f'device{"s" * (there != 1)}; use device = cpu, or remove device to use the '
                'compiled loops; a GPU needs its driver and a torch built for CUDA')
    return torch.device(name)


def description(name: str) -> dict[str, str]:
    """Return the device and the library versions, which affect the last digits of results."""
    device = open_device(name)
    found = {'kind': device.type, 'torch': torch.__version__}
    if device.type == 'cuda':
        found |= {'name': torch.cuda.get_device_name(device), 'cuda': str(torch.version.cuda)}
    return found


class Counts(NamedTuple):
    """
    Counters of each of m trajectories, as in ``Simulation``.

    Parameters
    ----------
    rescued, several_solutions : np.ndarray of int, shape (m,)
        Number of rescued steps, and of steps with several solutions.
    costliest, at : np.ndarray of int, shape (m,)
        Maximum number of gradients of a step, and the number of steps at its end.

    """

    rescued: np.ndarray
    several_solutions: np.ndarray
    costliest: np.ndarray
    at: np.ndarray


class BatchRecord(NamedTuple):
    """
    Results of m trajectories.

    Parameters
    ----------
    q, p : np.ndarray, shape (n, m, d)
        Samples; NaN after the failure of a trajectory.
    failures : dict of int to StepFailure
        Failures by number of trajectory.
    counts : Counts
        Counters over all steps.

    """

    q: np.ndarray
    p: np.ndarray
    failures: dict[int, StepFailure]
    counts: Counts


class BatchSimulation:
    """
    Many trajectories of one scene, each solved separately.

    If the method's own solver fails at a step of a trajectory, ``Simulation`` takes this step,
    with all its fallbacks: Newton's method, continuation, sub-steps. If these fail too, the
    trajectory fails, with the same reason as in ``Simulation``.

    Parameters
    ----------
    hamiltonian, integrator, step_size, effects, on_failure
        See Simulation.
    device : str
        See ``open_device``.

    Raises
    ------
    UnsupportedSystem
        An effect, H or the method is not supported on a device.
    ValueError, ParameterError
        See ``open_device``.

    """

    def __init__(self, hamiltonian: Hamiltonian, integrator: Integrator, step_size: float,
                 effects: Sequence[Effect], on_failure: str, device: str):
        self._device = open_device(device)
        if effects:
            labels = CompiledSystem(hamiltonian, effects, integrator).labels
            raise UnsupportedSystem(
                f'{", ".join(labels)}: a device does not support effects; remove device, or the '
                'effects')
        self._step = step_of(integrator, hamiltonian)
        assert isinstance(integrator, ImplicitIntegrator), 'the only methods with a step here'
        self._hamiltonian, self._integrator, self._h = hamiltonian, integrator, step_size
        self._on_failure, self._alone = on_failure, None
        options: SolverOptions | Tableau = integrator.options(dimension=hamiltonian.dimension)
        options = options.solver if isinstance(options, Tableau) else options
        self._system = BatchSystem(
            make_gradient(hamiltonian, self._device), hamiltonian.dimension,
            hamiltonian.kernel.gradient_scale, step_size, options)

    def __reduce__(self) -> NoReturn:
        """Raise TypeError: the batch cannot be copied or pickled."""
        raise TypeError('a batch on a device cannot be copied; build a new one')

    _alone: Simulation | None

    def record(self, q: np.ndarray, p: np.ndarray, samples: Sequence[int]) -> BatchRecord:
        """
        Simulate from initial states, and return samples.

        Parameters
        ----------
        q, p : np.ndarray, shape (m, d)
            Initial states.
        samples : sequence of int
            Numbers of steps at which to take samples, in increasing order.

        """
        m, d = q.shape
        z = torch.from_numpy(np.hstack([q, p]).T.copy()).to(self._device)
        state = first_state(self._system, self._integrator, z)
        out = np.full((len(samples), 2 * d, m), np.nan)
        counts, failures = Counts(*np.zeros((4, m), dtype=np.int64)), dict[int, StepFailure]()
        rows, steps, last = np.arange(m), 0, samples[-1] if samples else 0
        while steps < last and len(rows):
            steps += 1
            state = self._advanced(state, steps, rows, counts, failures)
            if len(failures) > m - len(rows):
                left = [k for k, row in enumerate(rows) if row not in failures]
                chosen = torch.tensor(left, dtype=torch.int64, device=self._device)
                state, rows = state.of(chosen), rows[left]
            if steps in samples:
                out[samples.index(steps)][:, rows] = state.z.cpu().numpy()
        out[[k for k, steps in enumerate(samples) if steps == 0]] = z.cpu().numpy()
        q_out, p_out = out.transpose(0, 2, 1)[..., :d], out.transpose(0, 2, 1)[..., d:]
        return BatchRecord(
            np.ascontiguousarray(q_out), np.ascontiguousarray(p_out), failures, counts)

    def _advanced(self, state: BatchState, steps: int, rows: np.ndarray, counts: Counts,
                  failures: dict[int, StepFailure]) -> BatchState:
        """Return the state after step number `steps`, taken by Simulation where necessary."""
        check_interrupt()
        state, outcome, gradients = self._take_one(state)
        more = gradients > counts.costliest[rows]
        counts.costliest[rows[more]], counts.at[rows[more]] = gradients[more], steps
        for k in (outcome != OK).nonzero()[:, 0].tolist():
            row = int(rows[k])
            try:
                z, slope = self._take_alone(state.z[:, k].cpu().numpy(), row, steps, counts)
            except StepFailure as failure:
                failures[row] = failure.dated((steps - 1) * self._h)
                continue
            state.z[:, k], state.slope[:, k] = (
                torch.from_numpy(part).to(self._device) for part in (z, slope))
            # Discard the history: it does not fit the next initial guess.
            state.carry[:, k], state.counts[:, k] = 0.0, 0
        return state

    def _take_one(self, state: BatchState) -> tuple[BatchState, torch.Tensor, np.ndarray]:
        """Return states after a step, or before it if it failed; outcomes; gradient counts."""
        after, outcome, gradients = self._step(self._system, state)
        finite = (after.z.isfinite() & after.slope.isfinite()).all(dim=0)
        outcome = torch.where((outcome == OK) & ~finite, NOT_FINITE, outcome)
        z = torch.where(outcome == OK, after.z, state.z)
        return after._replace(z=z), outcome, gradients.cpu().numpy()

    def _take_alone(self, z: np.ndarray, row: int, steps: int, counts: Counts
                    ) -> tuple[np.ndarray, np.ndarray]:
        """Take step number `steps` in compiled loops; return z and (H_q, H_p) after it."""
        q, p = np.split(z, 2)
        if self._alone is None:
            self._alone = Simulation(self._hamiltonian, self._integrator, self._h, q, p,
                                     on_failure=self._on_failure)
        alone = self._alone
        alone.restart(q, p)
        alone.advance(1)
        counts.rescued[row] += alone.rescued
        counts.several_solutions[row] += alone.several_solutions
        if alone.costliest[0] > counts.costliest[row]:
            counts.costliest[row], counts.at[row] = alone.costliest[0], steps
        return np.append(alone.q, alone.p), np.append(alone.dH_dq, alone.dH_dp)
