# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Forces of a command: on named coordinates, or on all of them by a learned input map."""

from collections.abc import Callable
from typing import NamedTuple

from hnn_vi_ros.effects.base import EffectState
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.kernels.compilation import identify, kept
from hnn_vi_ros.models.checkpoint import Checkpoint, load_checkpoint
from hnn_vi_ros.models.outputs import evaluate_outputs, pack_outputs, PackedOutputs
import numpy as np


def load_map(model: str) -> Checkpoint:
    """
    Return a model that has an input map.

    Raises
    ------
    ModelError
        The model does not exist, is damaged, or has none.

    """
    checkpoint = load_checkpoint(model)
    if not has_map(checkpoint):
        raise ModelError(f'{model}: this model of the family {checkpoint.card.family} has no '
                         'input map, as the family control_affine has, and mechanical with '
                         'input_map: learned; give coordinates')
    return checkpoint


def has_map(model: Checkpoint) -> bool:
    """Tell whether a model has learned what its motors do."""
    mechanical = model.card.mechanical
    return 'input_map' in model.networks or (
        mechanical is not None and mechanical.input_map is not None)


class Places(NamedTuple):
    """Places of the coordinates, one for each number."""

    places: np.ndarray


class InputMap(NamedTuple):
    """The network of g(q), and space for its d m entries."""

    outputs: PackedOutputs
    entries: np.ndarray


class InputMatrix(NamedTuple):
    """An input map that is the same everywhere, shape (d, m)."""

    matrix: np.ndarray


class InputParameters(NamedTuple):
    """
    What the compiled function of an external force takes.

    Parameters
    ----------
    command, clock : np.ndarray
        See EffectState.
    places : np.ndarray, shape (m,)
        Those of the command's numbers in ``command``.
    add : callable
        Adds the forces of the numbers; see add_by_place.
    own : Places, InputMap or InputMatrix
        What it takes first.

    """

    command: np.ndarray
    clock: np.ndarray
    places: np.ndarray
    add: Callable[..., None]
    own: Places | InputMap | InputMatrix


def by_place(state: EffectState, places: np.ndarray) -> InputParameters:
    """Return what adds each number to a coordinate, of these places."""
    return InputParameters(state.command, state.clock, places, add_by_place, Places(places))


def by_map(state: EffectState, model: Checkpoint, d: int) -> InputParameters:
    """Return what adds g(q) u, or A u, to d coordinates, or raise ValueError."""
    mechanical = model.card.mechanical
    if mechanical is not None:
        matrix = np.array(mechanical.input_map, dtype=np.float64)
        if len(matrix) != d:
            raise ValueError(f'the model maps {matrix.shape[1]} numbers to {len(matrix)} '
                             f'coordinates; H has {d} coordinates')
        return InputParameters(state.command, state.clock, np.arange(matrix.shape[1]),
                               add_by_matrix, InputMatrix(matrix))
    inputs, *_, entries = model.card.layout['input_map']
    if inputs != d or entries > d * d:
        raise ValueError(f'the model maps {entries // inputs} numbers to {inputs} coordinates; '
                         f'H has {d} coordinates, and takes at most as many numbers')
    own = InputMap(pack_outputs(model, 'input_map'), np.zeros(entries))
    return InputParameters(state.command, state.clock, np.arange(entries // d), add_by_map, own)


@kept(error_model='numpy')
def add_by_place(own: Places, command: np.ndarray, q: np.ndarray, p: np.ndarray,
                 f_p: np.ndarray) -> None:
    """Add one number of the command to each of some coordinates."""
    places = own.places
    for k in range(places.size):
        f_p[places[k]] += command[places[k]]


@kept(error_model='numpy')
def add_by_map(own: InputMap, command: np.ndarray, q: np.ndarray, p: np.ndarray,
               f_p: np.ndarray) -> None:
    """Add g(q) u, with the entries of g row by row, and u the first numbers of the command."""
    entries = own.entries
    evaluate_outputs(own.outputs, q, p, entries)
    m = entries.size // f_p.size
    for i in range(f_p.size):
        for k in range(m):
            f_p[i] += entries[i * m + k] * command[k]


@kept(error_model='numpy')
def add_by_matrix(own: InputMatrix, command: np.ndarray, q: np.ndarray, p: np.ndarray,
                  f_p: np.ndarray) -> None:
    """Add A u, with u the first numbers of the command."""
    matrix = own.matrix
    for i in range(f_p.size):
        for k in range(matrix.shape[1]):
            f_p[i] += matrix[i, k] * command[k]


for _function in (add_by_place, add_by_map, add_by_matrix):
    # They are among the parameters of compiled functions; see identify.
    identify(_function)
