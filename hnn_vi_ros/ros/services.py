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
# Least wall time between two feedbacks [s]; thousands of steps a second would flood the client.
_PERIOD = 0.02


_INTERFACES = 'simulation_interfaces'
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


def offer_simulation_interfaces(simulator: Simulator, group: CallbackGroup) -> None:
    """
    Create the services if simulation_interfaces can be imported.

    Its versions differ: what the installed one does not have is neither served nor reported.

    Parameters
    ----------
    simulator : Simulator
        That offers them.
    group : CallbackGroup
        Which they belong to.

    """
    try:
        messages, types, actions = (
            import_module(f'{_INTERFACES}.{kind}') for kind in ('msg', 'srv', 'action'))
    except ModuleNotFoundError as problem:
        if not (problem.name or '').startswith(_INTERFACES):
            raise
        # Not installed: std_srvs do the same under other names.
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
    Answer what is asked of the simulation and of worlds.

    A handler fills in its response and returns a message, usually none; it refuses by WorldError.

    Parameters
    ----------
    messages : module
        ``simulation_interfaces.msg``.
    simulator : Simulator
        What they act on.
    offered : mapping
        The interfaces that are served, by name.

    """

    def __init__(self, messages: ModuleType, simulator: Simulator, offered: Mapping[str, Any]):
        self._simulator, self._messages, self._offered = simulator, messages, offered
        # The goal of the action that steps are taken for, and what will hold their end.
        self._goal: tuple[Any, Future] | None = None
        kinds = messages.SimulatorFeatures
        self._features = sorted(getattr(kinds, feature) for name in offered
                                for feature in INTERFACES[name] if hasattr(kinds, feature))

    def answering(self, name: str) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return the callback of a service, which reports what its handler raises."""
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
        """Return what is supported."""
        response.features.features = self._features
        response.features.custom_info = (
            f'hnn_vi_ros {__version__}: worlds and spawnables are scenes, one at a time')

    def get_simulation_state(self, request: Any, response: Any) -> None:
        """Return whether simulated time advances, and whether there is a world at all."""
        response.state.state = self._now()

    def set_simulation_state(self, request: Any, response: Any) -> None:
        """Play, pause, stop, which is to pause and to reset all, or end the process."""
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
            raise WorldError('ALREADY_IN_TARGET_STATE', 'already in that state')
        control.set_paused(wanted != states.STATE_PLAYING)
        if wanted == states.STATE_STOPPED:
            _done(control.reset(True), 'STATE_TRANSITION_ERROR')
            control.stopped = True

    def reset_simulation(self, request: Any, response: Any) -> None:
        """Reset state, time or both, which is the default; there are no spawned entities."""
        scopes, scope = type(request), request.scope
        control = self._control('RESULT_INCORRECT_STATE')
        if scope in (scopes.SCOPE_DEFAULT, scopes.SCOPE_ALL):
            scope = scopes.SCOPE_TIME | scopes.SCOPE_STATE
        if scope & ~(scopes.SCOPE_TIME | scopes.SCOPE_STATE):
            raise WorldError('RESULT_FEATURE_UNSUPPORTED',
                             f'scope {scope}: expected that of time, state, both or all')
        _done(control.reset_time() if scope == scopes.SCOPE_TIME
              else control.reset(bool(scope & scopes.SCOPE_TIME)))

    async def step_simulation(self, request: Any, response: Any) -> None:
        """Take a number of steps in a pause."""
        _done(await self._control(_FAILED).request_steps(int(request.steps)))

    async def get_spawnables(self, request: Any, response: Any) -> str:
        """List the scenes: what can be had here, though one at a time and by load_world."""
        found, problems = await self._simulator.in_thread(
            lambda: find_worlds(request.sources, True))
        response.spawnables = [self._spawnable(world) for world in found]
        return '; '.join(problems)

    async def get_available_worlds(self, request: Any, response: Any) -> str:
        """List the scenes whose tags match; none of them is anywhere but on this machine."""
        found, problems = await self._simulator.in_thread(lambda: find_worlds(
            request.additional_sources, request.continue_on_error))
        response.worlds = [self._resource(world) for world in found
                           if _matches(request.filter, world.tags)]
        return '; '.join(problems)

    def get_current_world(self, request: Any, response: Any) -> None:
        """Return which scene is loaded."""
        if self._simulator.run is None:
            raise WorldError('NO_WORLD_LOADED', self._simulator.refusal)
        world = world_of(self._simulator.run.scene)
        # No URI leads to the scene in a bag.
        response.world = self._resource(
            world._replace(uri='') if self._simulator.settings.resume else world)

    async def load_world(self, request: Any, response: Any) -> None:
        """Simulate another scene: through cleanup, configure and activate to a stopped run."""
        source = getattr(request, 'world_resource', request)
        if not source.uri:
            raise WorldError(*(
                ('RESULT_FEATURE_UNSUPPORTED', 'resource_string: a world is loaded by its uri')
                if source.resource_string else
                ('NO_RESOURCE', 'uri: expected one of those of ~/get_available_worlds')))
        scene, name = await self._simulator.in_thread(lambda: open_world(source.uri))
        await self._unload()
        await self._configure(name)
        response.world = self._resource(world_of(scene))

    async def unload_world(self, request: Any, response: Any) -> None:
        """Close the files and forget the scene: the transition cleanup."""
        if self._simulator.state == State.PRIMARY_STATE_UNCONFIGURED:
            raise WorldError('NO_WORLD_LOADED', self._simulator.refusal)
        await self._unload()

    async def simulate_steps(self, goal: ServerGoalHandle) -> Any:
        """
        Take the steps of a goal of the action; a second goal is answered at once, as a service is.

        Every goal is accepted: by the definition, one that cannot be reached is answered by a
        result that says why, which a rejection could not do.
        """
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
                    self._offered[ACTION].Feedback(completed_steps=done, remaining_steps=left))
        return tell

    def cancel_steps(self, goal: ServerGoalHandle) -> CancelResponse:
        """Take no more steps of this goal; what was taken is not taken back."""
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
        """Return the control of the run; WorldError with this code while there is none."""
        if self._simulator.control is None:
            raise WorldError(code, self._simulator.refusal)
        return self._simulator.control

    def _now(self) -> int:
        control, states = self._simulator.control, self._messages.SimulationState
        if control is None:
            loading = self._simulator.state == State.TRANSITION_STATE_CONFIGURING
            # Versions before worlds could be loaded know no state without one.
            return getattr(states, 'STATE_LOADING_WORLD' if loading else 'STATE_NO_WORLD',
                           states.STATE_STOPPED)
        if control.running:
            return states.STATE_PLAYING
        return states.STATE_STOPPED if control.stopped else states.STATE_PAUSED

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
            raise WorldError(_FAILED, found.reason)
        if not await simulator.change_state(Transition.TRANSITION_CONFIGURE):
            raise WorldError(_FAILED, 'the node could not be configured')
        control = self._control(_FAILED)
        control.set_paused(True)
        await simulator.change_state(Transition.TRANSITION_ACTIVATE)
        control.stopped = True

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

    def _fill(self, response: Any, code: str, message: str) -> Any:
        # That of the features has no result.
        if hasattr(response, 'result'):
            kind = getattr(type(response), code, None)
            response.result.result = getattr(self._messages.Result, code) if kind is None else kind
            response.result.error_message = message
        return response


def _done(answer: Answer, code: str = _FAILED) -> None:
    """Raise WorldError where an answer is a refusal."""
    if not answer.success:
        raise WorldError(code, answer.message)


def _matches(wanted: Any, tags: tuple[str, ...]) -> bool:
    """Return whether a world's tags are what a TagsFilter asks for."""
    if not wanted.tags:
        return True
    enough = all if wanted.filter_mode == type(wanted).FILTER_MODE_ALL else any
    return enough(tag in tags for tag in wanted.tags)


def offer_services(simulator: Simulator) -> None:
    """
    Create the services, with simulation_interfaces where it is installed.

    Parameters
    ----------
    simulator : Simulator
        That offers them.

    """
    def record(method: str, words: str) -> Answer:
        """Begin or complete a bag; the answer is its absolute path."""
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

    # They have a group of their own: a long call of ~/step keeps no other waiting.
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
