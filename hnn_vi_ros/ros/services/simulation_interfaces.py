# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Services and action of the package simulation_interfaces, the same for all simulators."""

from collections.abc import Callable, Mapping
from importlib import import_module
import math
import re
import time
from types import ModuleType
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.ros.run.control import Answer, Simulator
from hnn_vi_ros.run.worlds import find_worlds, open_world, World, world_of, WorldError
from hnn_vi_ros.version import __version__
from lifecycle_msgs.msg import State, Transition
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

ACTION = 'SimulateSteps'
# Least wall time between two feedbacks [s]; thousands of steps a second would flood the client.
_PERIOD = 0.02


class SimulateSteps:
    """
    Serve the action.

    Every goal is accepted: by the definition, one that cannot be reached is answered by a result
    that says why, which a rejection could not do.

    Parameters
    ----------
    node : Node
        That serves it.
    kind : type
        ``simulation_interfaces.action.SimulateSteps``.
    codes : type
        ``simulation_interfaces.msg.Result``.
    simulator : Simulator
        The simulator to step.
    group : CallbackGroup
        Which it belongs to.

    """

    def __init__(self, node: Node, kind: type, codes: type, simulator: Simulator,
                 group: CallbackGroup):
        self._kind, self._codes, self._simulator = kind, codes, simulator
        self._goal: tuple[Any, Future] | None = None
        ActionServer(node, kind, '~/simulate_steps', self._execute, callback_group=group,
                     cancel_callback=self._on_cancel)

    async def _execute(self, goal: ServerGoalHandle) -> Any:
        """Take the steps of a goal; a second goal is answered at once, as a second service is."""
        control = self._simulator.control
        if control is None:
            return self._finish(goal, Answer(False, self._simulator.refusal))
        future = control.request_steps(int(goal.request.steps), self._feedback(goal))
        if not future.done():
            self._goal = goal, future
            if goal.is_cancel_requested:
                # Since before it began.
                control.cancel_steps(future)
        return self._finish(goal, await future)

    def _feedback(self, goal: ServerGoalHandle) -> Callable[[int, int], None]:
        """Return what reports progress to a client: after the first batch, and the last."""
        last = -math.inf

        def tell(done: int, left: int) -> None:
            nonlocal last
            now = time.monotonic()
            if left == 0 or now - last >= _PERIOD:
                last = now
                goal.publish_feedback(
                    self._kind.Feedback(completed_steps=done, remaining_steps=left))
        return tell

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Take no more steps of this goal; what was taken is not taken back."""
        if self._goal is not None and self._goal[0] == goal and self._simulator.control:
            self._simulator.control.cancel_steps(self._goal[1])
        return CancelResponse.ACCEPT

    def _finish(self, goal: ServerGoalHandle, answer: Answer) -> Any:
        result, codes = self._kind.Result(), self._codes
        if answer.success:
            result.result.result = codes.RESULT_OK
            goal.succeed()
            return result
        result.result.result = codes.RESULT_OPERATION_FAILED
        result.result.error_message = answer.message
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result


class WorldServices:
    """
    Answer what is asked of worlds.

    Parameters
    ----------
    messages : module
        ``simulation_interfaces.msg``.
    simulator : Simulator
        What they act on.

    """

    def __init__(self, messages: ModuleType, simulator: Simulator):
        self._simulator, self._messages = simulator, messages
        self._result = messages.Result

    async def get_spawnables(self, request: Any, response: Any) -> Any:
        """List the scenes: what can be had here, though one at a time and by load_world."""
        found, problems = await self._simulator.in_thread(
            lambda: find_worlds(request.sources, True))
        response.spawnables = [self._spawnable(world) for world in found]
        return self._fill(response, 'RESULT_OK', '; '.join(problems))

    async def get_available_worlds(self, request: Any, response: Any) -> Any:
        """List the scenes whose tags match; none of them is anywhere but on this machine."""
        try:
            found, problems = await self._simulator.in_thread(lambda: find_worlds(
                request.additional_sources, request.continue_on_error))
        except WorldError as problem:
            return self._fill(response, problem.code, str(problem))
        response.worlds = [self._resource(world) for world in found
                           if _matches(request.filter, world.tags)]
        return self._fill(response, 'RESULT_OK', '; '.join(problems))

    def get_current_world(self, request: Any, response: Any) -> Any:
        """Return which scene is loaded."""
        if self._simulator.run is None:
            return self._fill(response, 'NO_WORLD_LOADED', self._simulator.refusal)
        world = world_of(self._simulator.run.scene)
        # No URI leads to the scene in a bag.
        response.world = self._resource(
            world._replace(uri='') if self._simulator.settings.resume else world)
        return self._fill(response, 'RESULT_OK')

    async def load_world(self, request: Any, response: Any) -> Any:
        """Simulate another scene: through cleanup, configure and activate to a stopped run."""
        source = getattr(request, 'world_resource', request)
        try:
            if not source.uri:
                raise WorldError(*(
                    ('RESULT_FEATURE_UNSUPPORTED', 'resource_string: a world is loaded by its uri')
                    if source.resource_string else
                    ('NO_RESOURCE', 'uri: expected one of those of ~/get_available_worlds')))
            scene, name = await self._simulator.in_thread(lambda: open_world(source.uri))
            await self._unload()
            await self._configure(name)
        except WorldError as problem:
            return self._fill(response, problem.code, str(problem))
        except HnnViRosError as problem:
            return self._fill(response, 'RESULT_OPERATION_FAILED', str(problem))
        response.world = self._resource(world_of(scene))
        return self._fill(response, 'RESULT_OK')

    async def unload_world(self, request: Any, response: Any) -> Any:
        """Close the files and forget the scene: the transition cleanup."""
        if self._simulator.state == State.PRIMARY_STATE_UNCONFIGURED:
            return self._fill(response, 'NO_WORLD_LOADED', self._simulator.refusal)
        try:
            await self._unload()
        except WorldError as problem:
            return self._fill(response, problem.code, str(problem))
        return self._fill(response, 'RESULT_OK')

    async def _unload(self) -> None:
        """Go to unconfigured from wherever that can be done from at once."""
        simulator = self._simulator
        if simulator.state == State.PRIMARY_STATE_ACTIVE:
            await simulator.change_state(Transition.TRANSITION_DEACTIVATE)
        if simulator.state == State.PRIMARY_STATE_INACTIVE:
            await simulator.change_state(Transition.TRANSITION_CLEANUP)
        if simulator.state != State.PRIMARY_STATE_UNCONFIGURED:
            raise WorldError('RESULT_INCORRECT_STATE', 'a world is being loaded: wait for it')

    async def _configure(self, scene: str) -> None:
        """Load a scene and wait at its initial state."""
        simulator = self._simulator
        found = simulator.set_parameters_atomically(
            [Parameter('scene', value=scene), Parameter('resume', value='')])
        if not found.successful:
            raise WorldError('RESULT_OPERATION_FAILED', found.reason)
        if not await simulator.change_state(Transition.TRANSITION_CONFIGURE):
            raise WorldError('RESULT_OPERATION_FAILED', 'the node could not be configured')
        simulator.control.set_paused(True)
        await simulator.change_state(Transition.TRANSITION_ACTIVATE)
        simulator.control.stopped = True

    def _spawnable(self, world: World) -> Any:
        spawnable = self._messages.Spawnable(description=world.description)
        getattr(spawnable, 'entity_resource', spawnable).uri = world.uri
        return spawnable

    def _resource(self, world: World) -> Any:
        resource = self._messages.WorldResource(
            name=world.name, description=world.description, tags=list(world.tags))
        # The first versions had the URI in the message itself.
        getattr(resource, 'world_resource', resource).uri = world.uri
        return resource

    def _fill(self, response: Any, code: str, message: str = '') -> Any:
        kind = getattr(type(response), code, None)
        response.result.result = getattr(self._result, code) if kind is None else kind
        response.result.error_message = message
        return response


def _matches(wanted: Any, tags: tuple[str, ...]) -> bool:
    """Return whether a world's tags are what a TagsFilter asks for."""
    if not wanted.tags:
        return True
    enough = all if wanted.filter_mode == type(wanted).FILTER_MODE_ALL else any
    return enough(tag in tags for tag in wanted.tags)


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
