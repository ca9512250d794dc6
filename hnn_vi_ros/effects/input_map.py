# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Forces of a command: on named coordinates, or on all through a learned input map."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.attitudes import rotate
from hnn_vi_ros.effects.base import EffectState, motor_index
from hnn_vi_ros.effects.body_forces import add_body_map, body_network, BodyNetwork
from hnn_vi_ros.effects.commands import plus_motors
from hnn_vi_ros.effects.gravity_forces import Compensation, no_compensation
from hnn_vi_ros.errors import listed, ModelError
from hnn_vi_ros.kernels import kept, name_stably
from hnn_vi_ros.models import (
    Checkpoint, fill_outputs, GraphParameters, load_checkpoint, MechanicalCard, pack_network)
from hnn_vi_ros.phase_space import columns, Coordinate, rotations
import numpy as np


def load_map(model: str, member: int | None = None) -> Checkpoint:
    """
    Return a model that has an input map, or a member of an ensemble.

    Raises
    ------
    ModelError
        The model does not exist, is damaged, or has no input map or no such member.

    """
    checkpoint = load_checkpoint(model, ensembles=True).member(member)
    if not has_map(checkpoint):
        raise ModelError(f'{model}: this model of the family {checkpoint.card.family} has no '
                         'input map; give coordinates, or a model of the family control_affine, '
                         'or of mechanical or lie_group trained with input_map: learned')
    return checkpoint


def has_map(model: Checkpoint) -> bool:
    """Return True if a model has a learned input map."""
    mechanical = model.card.mechanical
    return 'input_map' in model.networks or (
        mechanical is not None and mechanical.input_map is not None)


class Columns(NamedTuple):
    """Columns of the coordinates, gains and offsets, one for each number of the command."""

    columns: np.ndarray
    gain: np.ndarray
    offset: np.ndarray


class Axes(NamedTuple):
    """
    Axes on which the numbers of a command act, in systems with rotations.

    Parameters
    ----------
    columns : np.ndarray
        Column in p; for a force along an axis of a body, the column of its momentum along x.
    axes : np.ndarray
        Axis of the body: 0, 1 or 2, or -1 for none.
    quaternions : np.ndarray
        Column in q of the body's quaternion.
    gain, offset : np.ndarray
        Force per unit of each number, and force at zero.

    """

    columns: np.ndarray
    axes: np.ndarray
    quaternions: np.ndarray
    gain: np.ndarray
    offset: np.ndarray


class InputMap(NamedTuple):
    """The network of g(q), and workspace for its d m entries."""

    graph: GraphParameters
    entries: np.ndarray


class InputMatrix(NamedTuple):
    """A constant input map, shape (d, m), and the gain reduction of each motor, (m,)."""

    matrix: np.ndarray
    fade: np.ndarray


class InputParameters(NamedTuple):
    """
    Parameters of the compiled function of an external force.

    Parameters
    ----------
    command, clock : np.ndarray
        See EffectState.
    columns : np.ndarray, shape (m,)
        Columns of the command's numbers in ``command``.
    add : callable
        The function that adds the forces of the numbers; see add_by_column.
    own : Columns, Axes, InputMap, InputMatrix or BodyNetwork
        Its first argument.
    gravity : Compensation
        V'(q) of the coordinates, empty for none.

    """

    command: np.ndarray
    clock: np.ndarray
    columns: np.ndarray
    add: Callable[..., None]
    own: Columns | Axes | InputMap | InputMatrix | BodyNetwork
    gravity: Compensation = no_compensation(0)

    def hold(self, columns: np.ndarray, values: np.ndarray, timeout: float) -> None:
        """Apply numbers of a command; other numbers stay active until they expire."""
        if not self.clock[0] < self.command[-1]:
            self.command[:] = 0.0
        self.command[columns], self.command[-1] = values, self.clock[0] + timeout


def by_name(state: EffectState, coordinates: Sequence[Coordinate], names: Sequence[str],
            gain: float | Sequence[float] = 1.0, offset: float | Sequence[float] = 0.0
            ) -> InputParameters:
    """Return parameters that add each number to the force on its name, or raise ValueError."""
    scale = _per_number('gain', gain, names), _per_number('offset', offset, names)
    if not rotations(coordinates):
        indices = np.array([motor_index(coordinates, name) for name in names])
        return InputParameters(
            state.command, state.clock, indices, add_by_column, Columns(indices, *scale))
    valid = _axes(coordinates)
    unknown = [name for name in names if name not in valid]
    if unknown:
        raise ValueError(f'no coordinate {unknown[0]!r}; valid coordinates: {listed(valid)}')
    if len(names) >= state.command.size:
        raise ValueError(f'coordinates has {len(names)} entries, expected at most '
                         f'{state.command.size - 1}; give forces along body axes or along space '
                         'axes, not both')
    indices, axes, quaternions = np.array([valid[name] for name in names]).T.copy()
    own = Axes(indices, axes, quaternions, *scale)
    return InputParameters(state.command, state.clock, np.arange(len(names)), add_by_axis, own)


def _per_number(what: str, values: float | Sequence[float], names: Sequence[str]) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    if array.ndim and array.size != len(names):
        raise ValueError(f'{what} has {array.size} values, expected 1 or one for each of '
                         f'{listed(names)}')
    return np.broadcast_to(array, len(names)).copy()


def _axes(coordinates: Sequence[Coordinate]) -> dict[str, tuple[int, int, int]]:
    """Return the column, axis and quaternion of each valid name; see Axes."""
    (q, p), valid = columns(coordinates), {}
    for coordinate in coordinates:
        for name in columns([coordinate])[1]:
            valid[name] = p.index(name), -1, 0
        if coordinate.kind == 'pose':
            for axis, letter in enumerate('xyz'):
                valid[f'{coordinate.name}_f{letter}'] = (
                    p.index(f'{coordinate.name}_x'), axis, q.index(f'{coordinate.name}_qx'))
    return valid


def by_map(state: EffectState, model: Checkpoint, coordinates: Sequence[Coordinate]
           ) -> InputParameters:
    """Return parameters that add g(q) u or A u to all coordinates, or raise ValueError."""
    d, mechanical = len(coordinates), model.card.mechanical
    if model.card.lie_group is not None:
        own_map = body_network(model, 'input_map', coordinates)
        count = own_map.entries.size // own_map.force.size
        if count >= state.command.size:
            raise ValueError(f'the model has {count} inputs; H supports at most '
                             f'{state.command.size - 1}')
        return InputParameters(state.command, state.clock, np.arange(count), add_body_map, own_map)
    if rotations(coordinates):
        raise ValueError('the input map of the model needs scalar coordinates, but H has others; '
                         'give coordinates')
    if mechanical is not None:
        motors = motors_of(mechanical)
        rows, count = motors.matrix.shape
        if rows != d:
            raise ValueError(f'the model maps {count} inputs to {rows} coordinates; H has {d} '
                             'coordinates')
        return InputParameters(state.command, state.clock, np.arange(count), add_by_matrix, motors)
    inputs, *_, entries = model.card.layout['input_map']
    if inputs != d or entries > d * d:
        raise ValueError(f'the model maps {entries // inputs} inputs to {inputs} coordinates; '
                         f'H has {d} coordinates, and supports at most as many inputs')
    graph = pack_network(model.networks['input_map'], model.card.activation)
    own = InputMap(graph, np.zeros(entries))
    return InputParameters(state.command, state.clock, np.arange(entries // d), add_by_map, own)


def motors_of(card: MechanicalCard) -> InputMatrix:
    """Return the input matrix of a machine's motors; by default each drives its own joint."""
    matrix = np.eye(len(card.kinds)) if card.input_map is None else np.array(
        card.input_map, dtype=np.float64)
    return InputMatrix(matrix, np.array(card.fade or np.zeros(matrix.shape[1])))


@kept(error_model='numpy')
def add_by_column(own: Columns, command: np.ndarray, q: np.ndarray, p: np.ndarray,
                  f_p: np.ndarray) -> None:
    """Add gain * number + offset to each of some coordinates."""
    columns = own.columns
    for k in range(columns.size):
        f_p[columns[k]] += own.gain[k] * command[columns[k]] + own.offset[k]


@kept(error_model='numpy')
def add_by_axis(own: Axes, command: np.ndarray, q: np.ndarray, p: np.ndarray,
                f_p: np.ndarray) -> None:
    """Add gain * number + offset to a column of p, or along an axis of a body."""
    columns, axes, quaternions, gain, offset = own
    for k in range(columns.size):
        axis, at, value = axes[k], columns[k], gain[k] * command[k] + offset[k]
        if axis < 0:
            f_p[at] += value
        else:
            force = rotate(q, quaternions[k], (value if axis == 0 else 0.0,
                                               value if axis == 1 else 0.0,
                                               value if axis == 2 else 0.0))
            for i in range(3):
                f_p[at + i] += force[i]


@kept(error_model='numpy')
def add_by_map(own: InputMap, command: np.ndarray, q: np.ndarray, p: np.ndarray,
               f_p: np.ndarray) -> None:
    """Add g(q) u; g is stored row by row, and u is the first part of the command."""
    entries = own.entries
    fill_outputs(own.graph, q, entries)
    m = entries.size // f_p.size
    for i in range(f_p.size):
        for k in range(m):
            f_p[i] += entries[i * m + k] * command[k]


@kept(error_model='numpy')
def add_by_matrix(own: InputMatrix, command: np.ndarray, q: np.ndarray, p: np.ndarray,
                  f_p: np.ndarray) -> None:
    """Add A u / (1 + g abs(u)), where u is the first part of the command."""
    for i in range(f_p.size):
        f_p[i] = plus_motors(f_p[i], own.matrix, own.fade, command, i)


for _function in (add_by_column, add_by_axis, add_by_map, add_by_matrix):
    # Functions in the parameters of compiled functions need a name; see identify.
    name_stably(_function)
