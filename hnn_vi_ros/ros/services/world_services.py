# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The services of simulation_interfaces that list and load worlds, which are scenes."""

from types import ModuleType
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.ros.run.control import Simulator
from hnn_vi_ros.run.worlds import find_worlds, open_world, World, world_of, WorldError
from lifecycle_msgs.msg import State, Transition
from rclpy.parameter import Parameter


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
