# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reference paths of errors, and the error of a learned H."""

from collections.abc import Mapping
from dataclasses import dataclass
import math
import re
from typing import Any

from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.models import EnergyError, NeuralHamiltonian
from hnn_vi_ros.simulation import InitialValueProblem
from hnn_vi_ros.simulation.accuracy.path_reference import (
    best_reference, exact_path, PathReference, refined_path)
from hnn_vi_ros.simulation.accuracy.trials import survey
import numpy as np


@dataclass(frozen=True)
class ModelDiscrepancy:
    """
    Error of a learned H, whatever integrates it.

    Parameters
    ----------
    path : float
        Largest distance between the motions of the learned and of the true H at the instants;
        NaN where either is not verified.
    energy : float
        Largest change of the true H along the motion of the learned one [J].
    box : EnergyError or None
        Error of the learned H all over its box, from its model card, if it is there.

    """

    path: float
    energy: float
    box: EnergyError | None = None


@dataclass(frozen=True)
class Floor:
    """
    Error below which nothing is known, or gained, up to a horizon.

    Parameters
    ----------
    how : str
        Method of the reference.
    accuracy : float
        Accuracy of its path; infinity without a path.
    model : ModelDiscrepancy or None
        Error of a learned H.

    """

    how: str
    accuracy: float = math.inf
    model: ModelDiscrepancy | None = None

    @property
    def verified(self) -> bool:
        """Return whether paths were compared."""
        return math.isfinite(self.accuracy)

    def as_json(self) -> dict[str, Any]:
        """Return the entry that ``of_json`` reads."""
        model = self.model
        return {'how': self.how, 'reference': _or_none(self.accuracy),
                'path': _or_none(model.path) if model else None,
                'energy': model.energy if model else None,
                'box': model.box.model_dump() if model and model.box else None}

    @classmethod
    def of_json(cls, entry: Mapping[str, Any]) -> 'Floor':
        """Read the entry of ``as_json``; raise KeyError if it is incomplete."""
        model = None if entry['energy'] is None else ModelDiscrepancy(
            math.nan if entry['path'] is None else entry['path'], entry['energy'],
            EnergyError(**entry['box']) if entry['box'] else None)
        accuracy = entry['reference']
        return cls(entry['how'], math.inf if accuracy is None else accuracy, model)


def make_reference(hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray, horizon: float
                   ) -> PathReference:
    """Return the path from an initial state up to a horizon [s], without a time limit."""
    problem = InitialValueProblem(hamiltonian, (), q0, p0)
    known = survey(problem, horizon, horizon)
    return best_reference(problem, horizon, horizon, known, math.inf)


def true_hamiltonian(hamiltonian: Hamiltonian) -> Hamiltonian | None:
    """Return the H that a network was taught, by its model card; None where that is unknown."""
    if not isinstance(hamiltonian, NeuralHamiltonian):
        return None
    found = re.fullmatch(r'\d+ exact samples of (\w+)\((.*)\)',
                         hamiltonian.checkpoint.card.dataset)
    if found is None or found[1] not in HAMILTONIANS:
        return None
    pairs = [item.split('=') for item in found[2].split(', ') if item]
    return HAMILTONIANS[found[1]](**{key: float(value) for key, value in pairs})


def floor_of(reference: PathReference, hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray
             ) -> Floor:
    """Return the accuracy of a reference, and the error of a learned H."""
    accuracy = reference.accuracy if reference.verified else math.inf
    truth = true_hamiltonian(hamiltonian)
    if truth is None:
        return Floor(reference.how, accuracy)
    assert isinstance(hamiltonian, NeuralHamiltonian), 'only such were taught'
    energies = truth.energy(*np.split(reference.states, 2, axis=1))
    instants, path = reference.instants, math.nan
    problem = InitialValueProblem(truth, (), q0, p0)
    exact = exact_path(problem, instants) or refined_path(problem, instants, survey(
        problem, instants.count * instants.gap, instants.base), math.inf, shorten=False)
    if reference.verified and exact is not None and exact.verified:
        path = float(np.abs(reference.states - exact.states[:len(reference.states)]).max())
    return Floor(reference.how, accuracy, ModelDiscrepancy(
        path, float(np.abs(energies - truth.energy(q0, p0)).max(initial=0.0)),
        hamiltonian.checkpoint.card.energy_error))


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
