# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The models of the published tables, trained from logs as by a user."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import tempfile
from typing import Any

from hnn_vi_ros.effects import Damping, Effect, LearnedDissipation
from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import load_learned, save_checkpoint
from hnn_vi_ros.simulation import Simulation
import numpy as np
from pydantic import Field
from studies.published_data import Orbits

COORDINATES = {1: ['q'], 4: ['x1', 'x2', 'y1', 'y2']}
QUICK_STEPS = 20
# Longer than any orbit [s]: a split keeps the whole orbit together.
_WHOLE = 1e6
# Length of held-out parts of one long orbit [s].
_BLOCK = 5.0


class Training(StrictModel):
    """Training of one model of the tables; other settings have their defaults."""

    seeds: list[int] = Field(min_length=1, description='of data, split and initial weights')
    hidden: list[int] = Field([64, 64], min_length=1, description='widths of the hidden layers')
    adam_steps: int = Field(300, ge=1)
    lbfgs_steps: int = Field(0, ge=0)
    linearity: float = Field(0.0, ge=0.0)
    rows: int | None = Field(None, ge=10, description=(
        'states of the training data, or pairs of neighbours, at random; default all'))
    orbits: int | None = Field(None, ge=10, description='drawn; default as published')

    def quick(self) -> 'Training':
        """Return the first seed and a few steps, to see that everything runs."""
        return self.model_copy(update={
            'seeds': self.seeds[:1], 'hidden': [8], 'adam_steps': QUICK_STEPS, 'orbits': 10,
            'rows': 100, 'lbfgs_steps': min(self.lbfgs_steps, QUICK_STEPS)})


@dataclass(frozen=True)
class Model:
    """A learned H and its dissipative effects."""

    hamiltonian: Hamiltonian
    effects: tuple[Effect, ...] = ()

    def field(self, z: np.ndarray) -> np.ndarray:
        """Return (H_p, -H_q) at states (q, p) of shape (..., 2 d), without dissipation."""
        dH_dq, dH_dp = self.hamiltonian.gradient(*np.split(z, 2, axis=-1))
        return np.concatenate([dH_dp, -dH_dq], axis=-1)

    def follow(self, starts: np.ndarray, spacing: float, samples: int, method: str,
               longest: float) -> np.ndarray:
        """
        Simulate orbits with our own simulator.

        Parameters
        ----------
        starts : np.ndarray, shape (m, 2 d)
            Initial states (q, p).
        spacing : float
            Time from one sample to the next [s].
        samples : int
            Number of samples, including the first.
        method : str
            A name from INTEGRATORS.
        longest : float
            Bound of the step size [s]; a whole number of steps lies between two samples.

        Returns
        -------
        np.ndarray, shape (m, samples, 2 d)
            The states; the first are ``starts``.

        """
        d, m = self.hamiltonian.dimension, len(starts)
        every = int(np.ceil(spacing / longest - 1e-9))
        simulation = Simulation(self.hamiltonian, INTEGRATORS[method](), spacing / every,
                                starts[:, :d], starts[:, d:], self.effects)
        path = np.concatenate([part.reshape(samples - 1, m, d)
                               for part in simulation.record(samples - 1, every)], axis=-1)
        return np.concatenate([starts[None], path]).transpose(1, 0, 2)


def train_on_rates(training: Training, orbits: Orbits, seed: int, family: str = 'hnn') -> Model:
    """
    Train a model on rates of change at noisy states.

    Parameters
    ----------
    training : Training
        Widths, numbers of steps, and how many states.
    orbits : Orbits
        The training data.
    seed : int
        Seed of the choice of states, the split and the initial weights.
    family : str
        ``'hnn'`` or ``'dissipative_hnn'``.

    """
    table = _table(orbits, orbits.rates)
    rows = _chosen(len(table), training.rows, seed)
    return _train(training, seed, table[rows], {'kind': family}, {'kind': 'vector_field'})


def train_on_differences(training: Training, orbits: Orbits, seed: int, friction: bool = False
                         ) -> Model:
    """
    Train a DGNet: the discrete gradient between neighbours against their difference.

    Parameters
    ----------
    training, orbits, seed
        As for ``train_on_rates``, with pairs of neighbours for states; of the rates only the
        size is used, to measure errors in.
    friction : bool
        Also learn linear friction.

    """
    table = _table(orbits, np.gradient(orbits.noisy, orbits.t, axis=1))
    if training.rows is not None:
        first = np.flatnonzero(table[:-1, 0] == table[1:, 0])
        first = first[_chosen(len(first), training.rows, seed)]
        table = table[np.stack([first, first + 1], axis=-1).ravel()]
        table[:, 0] = np.repeat(np.arange(len(first)), 2)
    return _train(training, seed, table, {'kind': 'dgnet', 'friction': friction},
                  {'kind': 'discrete_gradient', 'step_size': float(np.diff(orbits.t).min())},
                  block=_BLOCK if friction else _WHOLE)


def _train(training: Training, seed: int, table: np.ndarray, family: dict[str, Any],
           loss: dict[str, Any], block: float | None = None) -> Model:
    # Imported late: torch takes seconds, and errors should appear at once.
    from hnn_vi_ros.learning.data.sources import make_dataset
    from hnn_vi_ros.learning.fit.config import FieldConfig
    from hnn_vi_ros.learning.fit.field import fit_field
    from hnn_vi_ros.learning.tasks.field import describe
    names = COORDINATES[(table.shape[1] - 2) // 4]
    momenta = [f'p_{name}' for name in names]
    rates = [[f'd{name}' for name in part] for part in (names, momenta)]
    config = FieldConfig.model_validate({
        'coordinates': [{'name': name} for name in names],
        'data': {'kind': 'measured', 'trial': 'trial', 'time': 't', 'q': names, 'p': momenta,
                 'dq_dt': rates[0], 'dp_dt': rates[1], 'block': block,
                 'columns': ['trial', 't', *names, *momenta, *rates[0], *rates[1]]},
        'family': family, 'loss': loss, 'seed': seed,
        **training.model_dump(exclude={'seeds', 'rows', 'orbits'})})
    with tempfile.TemporaryDirectory() as folder:
        log, model = Path(folder) / 'orbits.txt', Path(folder) / 'model.safetensors'
        np.savetxt(log, table, fmt='%.17g')
        dataset = make_dataset(config.data, seed, log, [str(log)])
        save_checkpoint(model, describe(
            None, fit_field(config, dataset), config, model.stem, 'published_tables'))
        effects = {'dgnet': Damping, 'dissipative_hnn': LearnedDissipation}
        kind = effects.get(family['kind']) if family.get('friction', True) else None
        return Model(load_learned(model), () if kind is None else (kind(model=str(model)),))


def _table(orbits: Orbits, rates: np.ndarray) -> np.ndarray:
    """Return the rows of a measured log: trial, t [s], q, p, dq/dt and dp/dt."""
    m, n, width = orbits.noisy.shape
    return np.column_stack([np.repeat(np.arange(m), n), np.tile(orbits.t, m),
                            orbits.noisy.reshape(-1, width), rates.reshape(-1, width)])


def _chosen(count: int, rows: int | None, seed: int) -> Sequence[int]:
    """Return a sorted random selection of `rows` of `count` indices."""
    if rows is None or rows >= count:
        return np.arange(count)
    return np.sort(np.random.default_rng(seed).choice(count, rows, replace=False))
