# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The complete state of a simulation, which determines its next steps, as a file in a bag."""

from io import BytesIO

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import safetensors_header
from hnn_vi_ros.simulation import Simulation
import safetensors
import safetensors.numpy

# Kept in bags that do not begin at the initial state of their scene: (q, p) lacks the memory of
# the solver, the random numbers drawn, and a command that is being held.
STATE_FILE = 'state.safetensors'
# The state at the end of a bag, from which a run can be resumed.
LAST_STATE_FILE = 'last_state.safetensors'


def state_file(simulation: Simulation) -> bytes:
    """Return the state of a simulation in full precision."""
    return safetensors.numpy.save(simulation.snapshot())


def restore_state(simulation: Simulation, data: bytes, where: str, shift: float = -0.0,
                  name: str = STATE_FILE) -> None:
    """
    Restore a state, so that the simulation continues bit by bit like the saved one.

    Parameters
    ----------
    simulation : Simulation
        Simulation of the same scene.
    data : bytes
        Contents of the file.
    where : str
        Name of the container of the file, for errors.
    shift : float
        Added to each coordinate and momentum; -0.0 changes none, 0.0 changes the sign of -0.0.
    name : str
        Name of the file.

    Raises
    ------
    RecordingError
        The file is not a state of this simulation.

    """
    own = simulation.snapshot()
    try:
        # Check the header first, so that a malformed one cannot allocate a million arrays.
        safetensors_header(BytesIO(data))
        found = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, ValueError, KeyError) as problem:
        raise RecordingError(f'{where}: its {name} is damaged') from problem
    if {key: (array.shape, array.dtype) for key, array in found.items()} != {
            key: (array.shape, array.dtype) for key, array in own.items()}:
        raise RecordingError(f'{where}: its {name} belongs to another simulation; was it '
                             'recorded by another version?')
    # No number in a file may be out of the range of the methods, which all have memories:
    # `way` is the number of the active method.
    methods = {key.partition('.')[0] for key in own if key.startswith('memory')}
    if found['steps'] < 0 or f'memory{found["way"]}' not in methods | {'memory0'}:
        raise RecordingError(f'{where}: its {name} is damaged')
    for key in ('point.q', 'point.p'):
        found[key] = found[key] + shift
    simulation.restore(found)
