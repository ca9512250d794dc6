# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the package simulation_interfaces, the same for all simulators."""

from collections.abc import Mapping
from importlib import import_module
import re
from types import ModuleType
from typing import Any

from hnn_vi_ros.ros.run.control import Answer, Simulator
from hnn_vi_ros.ros.services.simulate_steps import ACTION, SimulateSteps
from hnn_vi_ros.ros.services.world_services import WorldServices
from hnn_vi_ros.version import __version__
from lifecycle_msgs.msg import State
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

_PACKAGE = 'simulation_interfaces'
# What each interface that is served here adds to the features that are reported.
INTERFACES = {
    'GetSimulatorFeatures': (),
    'GetSimulationState': ('SIMULATION_STATE_GETTING',),
    'SetSimulationState': ('SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE'),
    'ResetSimulation': (
        'SIMULATION_RESET', 'SIMULATION_RESET_TIME', 'SIMULATION_RESET_STATE'),
    'StepSimulation': ('STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE'),
    'GetSpawnables': ('SPAWNABLES',),
    'GetAvailableWorlds': ('AVAILABLE_WORLDS', 'WORLD_TAGS'),
    'GetCurrentWorld': ('WORLD_INFO_GETTING',),
    'LoadWorld': ('WORLD_LOADING',),
    'UnloadWorld': ('WORLD_UNLOADING',),
    ACTION: ('STEP_SIMULATION_ACTION',),
}


def service_name(interface: str) -> str:
    """Return the name under which an interface is served, relative to the node's."""
    return re.sub('(?<!^)(?=[A-Z])', '_', interface).lower()


def offer_simulation_interfaces(node: Node, simulator: Simulator, group: CallbackGroup) -> bool:
    """
    Create the services if simulation_interfaces can be imported; return whether it can.

    Its versions differ: what the installed one does not have is neither served nor reported.

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
        messages, types, actions = (
            import_module(f'{_PACKAGE}.{kind}') for kind in ('msg', 'srv', 'action'))
    except ModuleNotFoundError as problem:
        if not (problem.name or '').startswith(_PACKAGE):
            raise
        # Not installed: std_srvs do the same under other names.
        return False
    offered = {name: kind for name in INTERFACES
               if (kind := getattr(types, name, None) or getattr(actions, name, None))}
    handlers = (SimulationServices(messages, simulator, offered),
                WorldServices(messages, simulator))
    for interface, kind in offered.items():
        name = service_name(interface)
        if interface == ACTION:
            SimulateSteps(node, kind, messages.Result, simulator, group)
            continue
        handler = next(found for owner in handlers if (found := getattr(owner, name, None)))
        node.create_service(kind, f'~/{name}', handler, callback_group=group)
    return True


class SimulationServices:
    """
    Answer what is asked of the simulation as a whole.

    Parameters
    ----------
    messages : module
        ``simulation_interfaces.msg``.
    simulator : Simulator
        What they act on.
    offered : mapping
        The interfaces that are served, by name.

    """

    def __init__(self, messages: ModuleType, simulator: Simulator, offered: Mapping[str, type]):
        self._simulator = simulator
        self._result, self._state = messages.Result, messages.SimulationState
        kinds = messages.SimulatorFeatures
        self._features = sorted(getattr(kinds, feature) for name in offered
                                for feature in INTERFACES[name] if hasattr(kinds, feature))

    def get_simulator_features(self, request: Any, response: Any) -> Any:
        """Return what is supported."""
        response.features.features = self._features
        response.features.custom_info = (
            f'hnn_vi_ros {__version__}: worlds and spawnables are scenes, one at a time')
        return response

    def get_simulation_state(self, request: Any, response: Any) -> Any:
        """Return whether simulated time advances, and whether there is a world at all."""
        response.state.state = self._now()
        return self._fill(response, self._result.RESULT_OK)

    def set_simulation_state(self, request: Any, response: Any) -> Any:
        """Play, pause, stop, which is to pause and to reset all, or end the process."""
        control, wanted, states = self._simulator.control, request.state.state, self._state
        codes = type(response)
        if wanted == states.STATE_QUITTING:
            self._simulator.stop(0, 'quit by set_simulation_state')
            return self._fill(response, self._result.RESULT_OK)
        if wanted not in (states.STATE_PLAYING, states.STATE_PAUSED, states.STATE_STOPPED):
            return self._fill(response, self._result.RESULT_FEATURE_UNSUPPORTED,
                              'only playing, paused, stopped and quitting can be set')
        if control is None or not control.active:
            return self._fill(
                response, self._result.RESULT_INCORRECT_STATE,
                self._simulator.refusal if control is None else
                'the node is not active: use its lifecycle services, or load_world')
        if wanted == self._now():
            return self._fill(response, codes.ALREADY_IN_TARGET_STATE, 'already in that state')
        control.set_paused(wanted != states.STATE_PLAYING)
        if wanted == states.STATE_STOPPED:
            answer = control.reset(True)
            if not answer.success:
                return self._fill(response, codes.STATE_TRANSITION_ERROR, answer.message)
            control.stopped = True
        return self._fill(response, self._result.RESULT_OK)

    def reset_simulation(self, request: Any, response: Any) -> Any:
        """Reset state, time or both, which is the default; there are no spawned entities."""
        control, scopes, scope = self._simulator.control, type(request), request.scope
        if control is None:
            return self._fill(response, self._result.RESULT_INCORRECT_STATE,
                              self._simulator.refusal)
        if scope in (scopes.SCOPE_DEFAULT, scopes.SCOPE_ALL):
            scope = scopes.SCOPE_TIME | scopes.SCOPE_STATE
        if scope & ~(scopes.SCOPE_TIME | scopes.SCOPE_STATE):
            return self._fill(response, self._result.RESULT_FEATURE_UNSUPPORTED,
                              f'scope {scope}: expected that of time, state, both or all')
        if scope == scopes.SCOPE_TIME:
            return self._answer(response, control.reset_time())
        return self._answer(response, control.reset(bool(scope & scopes.SCOPE_TIME)))

    async def step_simulation(self, request: Any, response: Any) -> Any:
        """Take a number of steps in a pause."""
        control = self._simulator.control
        if control is None:
            return self._answer(response, Answer(False, self._simulator.refusal))
        return self._answer(response, await control.request_steps(int(request.steps)))

    def _now(self) -> int:
        control, states = self._simulator.control, self._state
        if control is None:
            loading = self._simulator.state == State.TRANSITION_STATE_CONFIGURING
            # Versions before worlds could be loaded know no state without one.
            return getattr(states, 'STATE_LOADING_WORLD' if loading else 'STATE_NO_WORLD',
                           states.STATE_STOPPED)
        if control.running:
            return states.STATE_PLAYING
        return states.STATE_STOPPED if control.stopped else states.STATE_PAUSED

    def _answer(self, response: Any, answer: Answer) -> Any:
        kind = (self._result.RESULT_OK if answer.success
                else self._result.RESULT_OPERATION_FAILED)
        return self._fill(response, kind, '' if answer.success else answer.message)

    def _fill(self, response: Any, kind: int, message: str = '') -> Any:
        response.result.result, response.result.error_message = kind, message
        return response
