# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""All that the next steps of a simulation depend on, as a file that a bag keeps."""

from io import BytesIO

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import safetensors_header
from hnn_vi_ros.simulation import Simulation
import safetensors
import safetensors.numpy

# In bags that do not begin at the initial state of their scene: with (q, p) alone, what a solver
# remembers, the random numbers drawn and a command that is held would be lost.
STATE_FILE = 'state.safetensors'


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
