# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""All that the next steps of a simulation depend on, as a file that a bag keeps."""

from collections.abc import Mapping
from io import BytesIO
from types import EllipsisType

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.limits import safetensors_header
from hnn_vi_ros.simulation import Simulation
import numpy as np
import safetensors
import safetensors.numpy

# In bags that do not begin at the initial state of their scene: with (q, p) alone, what a solver
# remembers, the random numbers drawn and a command that is held would be lost.
STATE_FILE = 'state.safetensors'

# Older bags kept all arrays of one general workspace; some of them held the values that outlive
# a step: today's name, the array, and its row.
_EARLIER: dict[str, tuple[str, int | EllipsisType]] = {
    'slopes': ('increments', 0), 'multipliers': ('newton', ...), 'clock': ('triangle', 0),
    'wanted': ('triangle', 0), 'v_q': ('values', 0), 'v_p': ('values', 1),
    'state.q': ('values', 0), 'state.p': ('values', 1), 'state.q_carry': ('values', 2),
    'state.p_carry': ('values', 3), 'state.dH_dq': ('residuals', 0),
    'state.dH_dp': ('residuals', 1)}


def state_file(simulation: Simulation) -> bytes:
    """Return the state of a simulation, to its last bit."""
    return safetensors.numpy.save(simulation.snapshot())


def restore_state(simulation: Simulation, data: bytes, where: str, shift: float = -0.0) -> None:
    """
    Let a simulation go on from a state, bit by bit as the one that it was taken of.

    Parameters
    ----------
    simulation : Simulation
        Of the same scene.
    data : bytes
        Of the file.
    where : str
        What holds it, for errors.
    shift : float
        Added to each coordinate and momentum; -0.0 changes none, 0.0 the sign of -0.0.

    Raises
    ------
    RecordingError
        It is no state of this simulation.

    """
    own = simulation.snapshot()
    try:
        # What claims a million arrays has none of them made.
        safetensors_header(BytesIO(data))
        found = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, ValueError, KeyError) as problem:
        raise RecordingError(f'{where}: its {STATE_FILE} is damaged') from problem
    found = _of_today(found, own)
    if {name: (array.shape, array.dtype) for name, array in found.items()} != {
            name: (array.shape, array.dtype) for name, array in own.items()}:
        raise RecordingError(f'{where}: its {STATE_FILE} is that of another simulation; '
                             'was it recorded by another version?')
    # No number in a file may point beyond the methods, each with its memories: `way` is the
    # number of the active method.
    methods = {name.partition('.')[0] for name in own if name.startswith('memory')}
    if found['steps'] < 0 or f'memory{found["way"]}' not in methods | {'memory0'}:
        raise RecordingError(f'{where}: its {STATE_FILE} is damaged')
    for name in ('point.q', 'point.p'):
        found[name] = found[name] + shift
    simulation.restore(found)


def _of_today(found: dict[str, np.ndarray], own: Mapping[str, np.ndarray]
              ) -> dict[str, np.ndarray]:
    """Return a state under today's names, if it has the names of older bags."""
    general = {name.rpartition('.')[0] for name in found if name.endswith('.triangle')}
    state = {name: array for name, array in found.items()
             if name.rpartition('.')[0] not in general or name in own}
    # Those of before there were servos follow nothing.
    state |= {name: np.zeros_like(array) for name, array in own.items()
              if name.startswith('live.reference.') and name not in found}
    for name in own.keys() - found.keys():
        place, field = '.'.join(name.split('.')[:2]), '.'.join(name.split('.')[2:])
        array, row = _EARLIER.get(field, ('', ...))
        if place in general and (earlier := found.get(f'{place}.{array}')) is not None:
            state[name] = np.atleast_2d(earlier)[row].ravel()[:own[name].size]
    return state
