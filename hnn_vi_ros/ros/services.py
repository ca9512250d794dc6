# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the simulator, apart from its lifecycle and parameters."""

from collections.abc import Awaitable, Callable, Mapping
from importlib import import_module
from inspect import isawaitable
import math
import re
import time
from types import ModuleType
from typing import Any

from hnn_vi_ros.errors import HnnViRosError, RecordingError
from hnn_vi_ros.ros.run.control import Answer, Control, Simulator
from hnn_vi_ros.ros.worlds import find_worlds, open_world, World, world_of, WorldError
from hnn_vi_ros.version import __version__
from lifecycle_msgs.msg import State, Transition
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

ACTION = 'SimulateSteps'
_FAILED = 'RESULT_OPERATION_FAILED'
# Least wall time between two feedback messages [s], as each step would flood the client.
_FEEDBACK_PERIOD = 0.02


_INTERFACES = 'simulation_interfaces'
# Interfaces served here, and the features that each adds to the reported ones.
INTERFACES = {
    'GetSimulatorFeatures': (),
    'GetSimulationState': ('SIMULATION_STATE_GETTING',),
    'SetSimulationState': ('SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE'),
    'ResetSimulation': (
        'SIMULATION_RESET', 'SIMULATION_RESET_TIME', 'SIMULATION_RESET_STATE'),
    'StepSimulation': ('STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE'),
    'GetAvailableWorlds': ('AVAILABLE_WORLDS', 'WORLD_TAGS'),
    'GetCurrentWorld': ('WORLD_INFO_GETTING',),
    'LoadWorld': ('WORLD_LOADING',),
    'UnloadWorld': ('WORLD_UNLOADING',),
    ACTION: ('STEP_SIMULATION_ACTION',),
}


def service_name(interface: str) -> str:
    """Return the service name of an interface, relative to the node."""
    return re.sub('(?<!^)(?=[A-Z])', '_', interface).lower()


def offer_simulation_interfaces(simulator: Simulator, group: CallbackGroup) -> None:
    """
    Create the services if simulation_interfaces can be imported.

    Its versions differ: interfaces missing from the installed one are neither served nor reported.

    Parameters
    ----------
    simulator : Simulator
        Simulator node that offers the services.
    group : CallbackGroup
        Callback group of the services.

    """
    try:
        messages, types, actions = (
            import_module(f'{_INTERFACES}.{kind}') for kind in ('msg', 'srv', 'action'))
    except ModuleNotFoundError as problem:
        if not (problem.name or '').startswith(_INTERFACES):
            raise
        # Not installed: services of std_srvs do the same under other names.
        return
    offered = {name: kind for name in INTERFACES
               if (kind := getattr(types, name, None) or getattr(actions, name, None))}
    services = SimulationServices(messages, simulator, offered)
    for interface, kind in offered.items():
        if interface == ACTION:
            ActionServer(simulator, kind, '~/simulate_steps', services.simulate_steps,
                         callback_group=group, cancel_callback=services.cancel_steps)
        else:
            name = service_name(interface)
            simulator.create_service(
                kind, f'~/{name}', services.answering(name), callback_group=group)


class SimulationServices:
    """
    Handlers of simulation_interfaces.

    A handler fills in its response and may return a message; it raises WorldError to refuse.

    Parameters
    ----------
    messages : module
        ``simulation_interfaces.msg``.
    simulator : Simulator
        Simulator node that the services act on.
    offered : mapping
        Interfaces that are served, by name.

    """

    def __init__(self, messages: ModuleType, simulator: Simulator, offered: Mapping[str, Any]):
        self._simulator, self._messages, self._offered = simulator, messages, offered
        # The goal of the running action, and the future of its answer.
        self._goal: tuple[Any, Future] | None = None
        kinds = messages.SimulatorFeatures
        self._features = sorted(getattr(kinds, feature) for name in offered
                                for feature in INTERFACES[name] if hasattr(kinds, feature))

    def answering(self, name: str) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return the callback of a service, which reports the errors of its handler."""
        handler = getattr(self, name)

        async def answer(request: Any, response: Any) -> Any:
            code = 'RESULT_OK'
            try:
                done = handler(request, response)
                message = await done if isawaitable(done) else done
            except HnnViRosError as problem:
                code, message = getattr(problem, 'code', _FAILED), str(problem)
            return self._fill(response, code, message or '')
        return answer

    def get_simulator_features(self, request: Any, response: Any) -> None:
        """Return the supported features."""
        response.features.features = self._features
        response.features.custom_info = (
            f'hnn_vi_ros {__version__}: worlds are scenes, one at a time')

    def get_simulation_state(self, request: Any, response: Any) -> None:
        """Return the state: playing, paused, stopped, or without a world."""
        response.state.state = self._now()

    def set_simulation_state(self, request: Any, response: Any) -> None:
        """Play, pause, stop (which pauses and resets state and time), or end the process."""
        wanted, states = request.state.state, self._messages.SimulationState
        if wanted == states.STATE_QUITTING:
            self._simulator.stop(0, 'quit by set_simulation_state')
            return
        if wanted not in (states.STATE_PLAYING, states.STATE_PAUSED, states.STATE_STOPPED):
            raise WorldError('RESULT_FEATURE_UNSUPPORTED',
                             'only playing, paused, stopped and quitting can be set')
        control = self._control('RESULT_INCORRECT_STATE')
        if not control.active:
            raise WorldError('RESULT_INCORRECT_STATE', 'the node is not active: use its lifecycle '
                             'services, or load_world')
        if wanted == self._now():
            raise WorldError('ALREADY_IN_TARGET_STATE', 'already in this state')
        control.set_paused(wanted != states.STATE_PLAYING)
        if wanted == states.STATE_STOPPED:
            _check_answer(control.reset(True), 'STATE_TRANSITION_ERROR')
            control.stopped = True

    def reset_simulation(self, request: Any, response: Any) -> None:
        """Reset state, time or both (the default); there are no spawned entities."""
        scopes, scope = type(request), request.scope
        control = self._control('RESULT_INCORRECT_STATE')
        if scope in (scopes.SCOPE_DEFAULT, scopes.SCOPE_ALL):
            scope = scopes.SCOPE_TIME | scopes.SCOPE_STATE
        if scope & ~(scopes.SCOPE_TIME | scopes.SCOPE_STATE):
            raise WorldError('RESULT_FEATURE_UNSUPPORTED',
                             f'scope {scope}: expected SCOPE_TIME, SCOPE_STATE, both or SCOPE_ALL')
        _check_answer(control.reset_time() if scope == scopes.SCOPE_TIME
                      else control.reset(bool(scope & scopes.SCOPE_TIME)))

    async def step_simulation(self, request: Any, response: Any) -> None:
        """Take a number of steps in a pause."""
        _check_answer(await self._control(_FAILED).request_steps(int(request.steps)))

    async def get_available_worlds(self, request: Any, response: Any) -> str:
        """List the scenes with matching tags; all of them are on this machine."""
        found, problems = await self._simulator.in_thread(lambda: find_worlds(
            request.additional_sources, request.continue_on_error))
        response.worlds = [self._resource(world) for world in found
                           if _matches(request.filter, world.tags)]
        return '; '.join(problems)

    def get_current_world(self, request: Any, response: Any) -> None:
        """Return the loaded scene."""
        if self._simulator.run is None:
            raise WorldError('NO_WORLD_LOADED', self._simulator.refusal)
        world = world_of(self._simulator.run.scene)
        # A scene in a bag has no URI.
        response.world = self._resource(
            world._replace(uri='') if self._simulator.settings.resume else world)

    async def load_world(self, request: Any, response: Any) -> None:
        """Load another scene by cleanup, configure and activate; the run is then stopped."""
        source = getattr(request, 'world_resource', request)
        if not source.uri:
            raise WorldError(*(
                ('RESULT_FEATURE_UNSUPPORTED', 'resource_string: a world is loaded by its uri')
                if source.resource_string else
                ('NO_RESOURCE', 'uri: expected one of those of ~/get_available_worlds')))
        scene, name = await self._simulator.in_thread(lambda: open_world(
            source.uri, self._simulator.scene_of_the_start))
        await self._unload()
        await self._configure(name)
        response.world = self._resource(world_of(scene))

    async def unload_world(self, request: Any, response: Any) -> None:
        """Close the files and discard the scene, by the transition cleanup."""
        if self._simulator.state == State.PRIMARY_STATE_UNCONFIGURED:
            raise WorldError('NO_WORLD_LOADED', self._simulator.refusal)
        await self._unload()

    async def simulate_steps(self, goal: ServerGoalHandle) -> Any:
        """
        Take the steps of an action goal; a second goal is answered at once, as by the service.

        Every goal is accepted: by the definition of the action, one that cannot be reached gets a
        result with the reason, which a rejection could not contain.
        """
        control = self._simulator.control
        if control is None:
            return self._finish(goal, Answer(False, self._simulator.refusal))
        future = control.request_steps(int(goal.request.steps), self._feedback(goal))
        if not future.done():
            self._goal = goal, future
            if goal.is_cancel_requested:
                # Cancelled before it began.
                control.cancel_steps(future)
        return self._finish(goal, await future)

    def _feedback(self, goal: ServerGoalHandle) -> Callable[[int, int], None]:
        """Return a callback that reports progress: after the first batch and the last."""
        last = -math.inf

        def tell(done: int, left: int) -> None:
            nonlocal last
            now = time.monotonic()
            if left == 0 or now - last >= _FEEDBACK_PERIOD:
                last = now
                goal.publish_feedback(
                    self._offered[ACTION].Feedback(completed_steps=done, remaining_steps=left))
        return tell

    def cancel_steps(self, goal: ServerGoalHandle) -> CancelResponse:
        """Cancel the remaining steps of a goal; steps already taken remain."""
        if self._goal is not None and self._goal[0] == goal and self._simulator.control:
            self._simulator.control.cancel_steps(self._goal[1])
        return CancelResponse.ACCEPT

    def _finish(self, goal: ServerGoalHandle, answer: Answer) -> Any:
        if answer.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return self._fill(self._offered[ACTION].Result(),
                          'RESULT_OK' if answer.success else _FAILED,
                          '' if answer.success else answer.message)

    def _control(self, code: str) -> Control:
        """Return the control of the run; WorldError with this code if there is none."""
        if self._simulator.control is None:
            raise WorldError(code, self._simulator.refusal)
        return self._simulator.control

    def _now(self) -> int:
        control, states = self._simulator.control, self._messages.SimulationState
        if control is None:
            loading = self._simulator.state == State.TRANSITION_STATE_CONFIGURING
            # Versions without worlds have no state for a missing one.
            return getattr(states, 'STATE_LOADING_WORLD' if loading else 'STATE_NO_WORLD',
                           states.STATE_STOPPED)
        if control.running:
            return states.STATE_PLAYING
        return states.STATE_STOPPED if control.stopped else states.STATE_PAUSED

    async def _unload(self) -> None:
        """Change to unconfigured, if that is possible at once; else raise WorldError."""
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
            raise WorldError(_FAILED, found.reason)
        if not await simulator.change_state(Transition.TRANSITION_CONFIGURE):
            raise WorldError(_FAILED, 'the node could not be configured')
        control = self._control(_FAILED)
        control.set_paused(True)
        await simulator.change_state(Transition.TRANSITION_ACTIVATE)
        control.stopped = True

    def _resource(self, world: World) -> Any:
        resource = self._messages.WorldResource(
            name=world.name, description=world.description, tags=list(world.tags))
        # The first versions had the URI in the message itself.
        getattr(resource, 'world_resource', resource).uri = world.uri
        return resource

    def _fill(self, response: Any, code: str, message: str) -> Any:
        # The response with the features has no result.
        if hasattr(response, 'result'):
            kind = getattr(type(response), code, None)
            response.result.result = getattr(self._messages.Result, code) if kind is None else kind
            response.result.error_message = message
        return response


def _check_answer(answer: Answer, code: str = _FAILED) -> None:
    """Raise WorldError if an answer is a refusal."""
    if not answer.success:
        raise WorldError(code, answer.message)


def _matches(wanted: Any, tags: tuple[str, ...]) -> bool:
    """Return True if the tags of a world satisfy a TagsFilter."""
    if not wanted.tags:
        return True
    enough = all if wanted.filter_mode == type(wanted).FILTER_MODE_ALL else any
    return enough(tag in tags for tag in wanted.tags)


def offer_services(simulator: Simulator) -> None:
    """
    Create the services, including simulation_interfaces if that is installed.

    Parameters
    ----------
    simulator : Simulator
        Simulator node that offers the services.

    """
    def record(method: str, words: str) -> Answer:
        """Start or complete a bag; the answer is its absolute path."""
        assert simulator.run is not None, 'it has a control'
        try:
            path = getattr(simulator.run.recording, method)()
        except RecordingError as problem:
            return Answer(False, str(problem))
        simulator.run.tell(f'{words} {path}', 'INFO')
        return Answer(True, path)

    def answering(handler: Callable[[Control, Any], Any]) -> Callable[[Any, Any], Any]:
        async def answer(request: Any, response: Any) -> Any:
            done = Answer(False, simulator.refusal) if simulator.control is None \
                else handler(simulator.control, request)
            response.success, response.message = await done if isawaitable(done) else done
            return response
        return answer

    # The services share a reentrant group, so that a long call of ~/step does not block others.
    group = ReentrantCallbackGroup()
    for name, kind, handler in (
            ('~/set_pause', SetBool, lambda control, request: control.set_paused(request.data)),
            ('~/reset', Trigger, lambda control, _: control.reset(simulator.settings.reset_time)),
            ('~/step', Trigger, lambda control, _: control.request_steps(
                simulator.settings.step_count)),
            ('~/start_recording', Trigger, lambda *_: record('start_bag', 'recording to')),
            ('~/stop_recording', Trigger, lambda *_: record('stop_bag', 'recorded'))):
        simulator.create_service(kind, name, answering(handler), callback_group=group)
    offer_simulation_interfaces(simulator, group)
