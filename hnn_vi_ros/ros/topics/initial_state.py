# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Initial states from messages like those that the simulator publishes as joint states."""

from hnn_vi_ros.effects.commands import printable
from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.legendre import momenta
import numpy as np
from sensor_msgs.msg import JointState


def initial_state(message: JointState, hamiltonian: Hamiltonian, p0: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return q and p of a joint state: position = q, velocity = dH/dp, effort is not used.

    Parameters
    ----------
    message : JointState
        With every coordinate once, in any order.
    hamiltonian : Hamiltonian
        H, whose momenta belong to the velocities.
    p0 : np.ndarray, shape (d,)
        Where the search for p begins.

    Returns
    -------
    tuple of np.ndarray, shape (d,)
        q and p, at which H has a finite gradient.

    Raises
    ------
    ValueError
        The message is not a state of the system; one line.

    """
    if hamiltonian.rotations:
        raise ValueError('no joint states make a state of bodies that turn; write it into the '
                         "scene's initial_state")
    names = [coordinate.name for coordinate in hamiltonian.coordinates]
    if len(message.name) != len(names) or sorted(message.name) != sorted(names):
        raise ValueError(f'name = [{printable(message.name)}] must be the coordinates '
                         f'{listed(names)}, each once')
    places = [list(message.name).index(name) for name in names]
    values = []
    for field in ('position', 'velocity'):
        array = np.array(getattr(message, field), dtype=np.float64)
        if array.shape != (len(names),) or not np.isfinite(array).all():
            raise ValueError(f'{field} must be {len(names)} finite numbers')
        values.append(array[places])
    q, velocity = values
    with np.errstate(all='ignore'):
        p = momenta(hamiltonian, q, velocity, p0)
        finite = np.isfinite([hamiltonian.energy(q, p), *np.ravel(hamiltonian.gradient(q, p))])
    if not finite.all():
        raise ValueError(f'H has no finite value and gradient at q = {q.tolist()}, velocity '
                         f'{velocity.tolist()}')
    return q, p
