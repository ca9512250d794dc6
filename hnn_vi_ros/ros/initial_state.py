# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Initial states received on ~/initial_state, and the answers on ~/state_set."""

from collections.abc import Callable
from functools import partial

from hnn_vi_ros.hamiltonians import Hamiltonian, momentum
from hnn_vi_ros.ros.run.control import Answer
from hnn_vi_ros.ros.run.run import Run
from hnn_vi_ros.ros.topics.diagnostics import DiagnosticsPublisher, ERROR, OK, state_values, Status
from hnn_vi_ros.ros.topics.inputs import INITIAL_STATE, places_of
from hnn_vi_ros.ros.topics.outputs import STATE_SET
from hnn_vi_ros.ros.topics.topics import Topics
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState


def initial_state(message: JointState, hamiltonian: Hamiltonian, p0: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Convert a joint state to q and p: position = q, velocity = dH/dp, effort is not used.

    Parameters
    ----------
    message : JointState
        Message with every coordinate once, in any order; joints that follow them are not used.
    hamiltonian : Hamiltonian
        Hamiltonian that gives the momenta of the velocities.
    p0 : np.ndarray, shape (d,)
        Start of the search for p.

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
        raise ValueError('joint states cannot describe rotating bodies; set initial_state in the '
                         'scene')
    places = places_of(hamiltonian.coordinates, message.name, 'name')
    values = []
    for field in ('position', 'velocity'):
        array = np.array(getattr(message, field), dtype=np.float64)
        if array.shape != (len(message.name),) or not np.isfinite(array).all():
            raise ValueError(f'{field} must be {len(message.name)} finite numbers')
        values.append(array[places])
    q, velocity = values
    with np.errstate(all='ignore'):
        p = momentum(hamiltonian, q, velocity, p0)
        finite = np.isfinite([hamiltonian.energy(q, p), *np.ravel(hamiltonian.gradient(q, p))])
    if not finite.all():
        raise ValueError(f'H has no finite value and gradient at q = {q.tolist()}, velocity '
                         f'{velocity.tolist()}')
    return q, p


# Maximum length of an answer [characters].
_MAX_ANSWER_LENGTH = 1000


def subscribe_initial_states(node: Node, topics: Topics, run: Run,
                             reset: Callable[[], Answer | None]) -> None:
    """
    Accept states for the next reset, and publish an answer to each.

    An answer is one status: accepted or not, with the reason, and q and p in full precision.

    Parameters
    ----------
    node : Node
        The simulator node.
    topics : Topics
        Publishers and subscriptions of the node.
    run : Run
        Run that begins at the states.
    reset : callable
        Resets at once, or returns None if that is not requested.

    """
    answers = DiagnosticsPublisher(node, partial(topics.send, STATE_SET), run.scene.name)

    def answer(level: bytes, text: str, values: dict[str, str]) -> None:
        answers.publish([Status('initial_state', level, text[:_MAX_ANSWER_LENGTH], values)],
                        run.sampler.stamp)

    def take(message: JointState) -> None:
        try:
            if not run.simulation.rescue_ready:
                raise ValueError('the conversion of velocities to momenta is still being '
                                 'compiled: send it again in a few seconds')
            q, p = initial_state(message, run.simulation.hamiltonian, run.start[1])
            run.simulation.check_state(q, p)
            run.start = q, p
            done, text = reset(), 'used at the next reset'
            if done is not None:
                if not done.success:
                    raise ValueError(done.message)
                text = 'reset to this state'
        except ValueError as problem:
            answer(ERROR, ' '.join(str(problem).split()), {})
            raise
        answer(OK, text, state_values(run.simulation.hamiltonian.coordinates, q, p))
        node.get_logger().info(f'~/initial_state: {text}', throttle_duration_sec=1.0)

    topics.subscriptions.hear(INITIAL_STATE, take)
