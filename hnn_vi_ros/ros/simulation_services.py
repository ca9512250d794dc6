# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the package simulation_interfaces, the same for all simulators."""

from importlib import import_module
from types import ModuleType
from typing import Any, TYPE_CHECKING

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

if TYPE_CHECKING:
    from hnn_vi_ros.ros.services import Simulator

_FEATURES = (
    'SIMULATION_RESET', 'SIMULATION_RESET_TIME', 'SIMULATION_RESET_STATE',
    'SIMULATION_STATE_GETTING', 'SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE',
    'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE')
SERVICES = ('get_simulator_features', 'get_simulation_state', 'set_simulation_state',
            'reset_simulation', 'step_simulation')


def offer_simulation_interfaces(node: Node, simulator: 'Simulator', group: CallbackGroup) -> bool:
    """
    Create the services if simulation_interfaces can be imported; tell whether it can.

    Parameters
    ----------
    node : Node
        That offers them.
    simulator : Simulator
        What they act on.
    group : CallbackGroup
        Which they belong to.

    """
    try:
        messages = import_module('simulation_interfaces.msg')
        types = import_module('simulation_interfaces.srv')
    except ModuleNotFoundError:
        # Not installed: std_srvs do the same under other names.
        return False
    services = SimulationServices(messages, simulator)
    for name in SERVICES:
        kind = getattr(types, name.title().replace('_', ''))
        node.create_service(kind, f'~/{name}', getattr(services, name), callback_group=group)
    return True


class SimulationServices:
    """
    Answer the services of simulation_interfaces.

    Parameters
    ----------
    messages : module
        ``simulation_interfaces.msg``.
    simulator : Simulator
        What they act on.

    """

    def __init__(self, messages: ModuleType, simulator: 'Simulator'):
        self._simulator = simulator
        self._result, self._state = messages.Result, messages.SimulationState
        self._features = [getattr(messages.SimulatorFeatures, name) for name in _FEATURES]

    def get_simulator_features(self, request: Any, response: Any) -> Any:
        """Tell what is supported."""
        response.features.features = self._features
        return response

    def get_simulation_state(self, request: Any, response: Any) -> Any:
        """Tell whether simulated time goes on; a node that is not active is stopped."""
        response.state.state = self._now()
        return self._fill(response, self._result.RESULT_OK)

    def set_simulation_state(self, request: Any, response: Any) -> Any:
        """Play, pause, or stop, which is to pause and reset."""
        control, wanted, states = self._simulator.control, request.state.state, self._state
        if wanted not in (states.STATE_PLAYING, states.STATE_PAUSED, states.STATE_STOPPED):
            return self._fill(response, self._result.RESULT_FEATURE_UNSUPPORTED,
                              'only playing, paused and stopped can be set')
        if control is None or not control.active:
            return self._fill(response, self._result.RESULT_INCORRECT_STATE,
                              'the node is not active: use its lifecycle services')
        if wanted == self._now():
            already = getattr(type(response), 'ALREADY_IN_TARGET_STATE', self._result.RESULT_OK)
            return self._fill(response, already, 'already in that state')
        control.set_paused(wanted != states.STATE_PLAYING)
        if wanted == states.STATE_STOPPED:
            return self._answer(response, control.reset(True))
        return self._fill(response, self._result.RESULT_OK)

    def reset_simulation(self, request: Any, response: Any) -> Any:
        """Reset state, time or both, which is the default; there are no spawned entities."""
        control, scope = self._simulator.control, request.scope
        if control is None:
            return self._fill(response, self._result.RESULT_INCORRECT_STATE,
                              'the node is not configured')
        every = scope in (request.SCOPE_DEFAULT, request.SCOPE_ALL)
        if not every and not scope & request.SCOPE_STATE:
            return self._fill(response, self._result.RESULT_FEATURE_UNSUPPORTED,
                              'the state is always reset, the time only with it')
        return self._answer(response, control.reset(bool(every or scope & request.SCOPE_TIME)))

    async def step_simulation(self, request: Any, response: Any) -> Any:
        """Take a number of steps in a pause."""
        control = self._simulator.control
        if control is None or not (control.active and control.paused):
            return self._fill(response, self._result.RESULT_INCORRECT_STATE,
                              'only in a pause of an active node')
        return self._answer(response, await control.request_steps(int(request.steps)))

    def _now(self) -> int:
        control = self._simulator.control
        if control is None or not control.active:
            return self._state.STATE_STOPPED
        return self._state.STATE_PAUSED if control.paused else self._state.STATE_PLAYING

    def _answer(self, response: Any, answer: tuple[bool, str]) -> Any:
        success, message = answer
        kind = self._result.RESULT_OK if success else self._result.RESULT_OPERATION_FAILED
        return self._fill(response, kind, '' if success else message)

    def _fill(self, response: Any, kind: int, message: str = '') -> Any:
        response.result.result, response.result.error_message = kind, message
        return response
