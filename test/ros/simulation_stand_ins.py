# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for simulation_interfaces, which has no wheel, and for what its services act on."""

from collections.abc import Awaitable, Callable
import copy
from dataclasses import replace
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.ros.run.control import Answer
from hnn_vi_ros.ros.services import offer_services
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.scene import load_scene
from lifecycle_msgs.msg import State, Transition
import pytest
from rclpy.task import Future

OK, UNSUPPORTED, NOT_FOUND, INCORRECT_STATE, FAILED = 1, 0, 2, 3, 4
STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD, LOADING = range(6)
FEATURES = {
    'SPAWNING': 0, 'SPAWNABLES': 14, 'SIMULATION_RESET': 20, 'SIMULATION_RESET_TIME': 21,
    'SIMULATION_RESET_STATE': 22, 'SIMULATION_RESET_SPAWNED': 23, 'SIMULATION_STATE_GETTING': 24,
    'SIMULATION_STATE_SETTING': 25, 'SIMULATION_STATE_PAUSE': 26, 'STEP_SIMULATION_SINGLE': 31,
    'STEP_SIMULATION_MULTIPLE': 32, 'STEP_SIMULATION_ACTION': 33}
WORLD_FEATURES = {
    'WORLD_LOADING': 40, 'WORLD_RESOURCE_STRING': 41, 'WORLD_TAGS': 42, 'WORLD_UNLOADING': 43,
    'WORLD_INFO_GETTING': 44, 'AVAILABLE_WORLDS': 45}


class Message:
    """What a generated message does: fields only, and constants of the class."""

    fields: dict[str, Any] = {}

    def __init__(self, **given: Any):
        for name, default in self.fields.items():
            setattr(self, name, given.pop(name, copy.deepcopy(default)))
        assert not given, given

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in self.fields, name
        super().__setattr__(name, value)


def message(constants: dict[str, int] | None = None, **fields: Any) -> type:
    """Return a type of messages with constants and fields, by their defaults."""
    return type('Stand', (Message,), {'fields': fields, **(constants or {})})


def service(request: type, response: type) -> type:
    """Return a type of services."""
    return type('Service', (), {'Request': request, 'Response': response})


def interfaces(worlds: bool = True, resource: bool = True) -> dict[str, ModuleType]:
    """
    Return the modules of simulation_interfaces.

    Parameters
    ----------
    worlds : bool
        Whether they know worlds; version 1.0 does not.
    resource : bool
        Whether a URI stands in a message of its own, as since version 2.

    """
    modules = {name: ModuleType(name) for name in (
        'simulation_interfaces', *(f'simulation_interfaces.{kind}'
                                   for kind in ('msg', 'srv', 'action')))}
    msg, srv, action = list(modules.values())[1:]
    _add_messages(msg, worlds, resource)
    _add_services(srv, msg)
    if worlds:
        _add_world_services(srv, msg, resource)
    action.SimulateSteps = type('SimulateSteps', (), {
        'Goal': message(steps=0), 'Result': message(result=msg.Result()),
        'Feedback': message(completed_steps=0, remaining_steps=0)})
    return modules


def _add_messages(msg: ModuleType, worlds: bool, resource: bool) -> None:
    msg.Result = message({'RESULT_FEATURE_UNSUPPORTED': 0, 'RESULT_OK': 1, 'RESULT_NOT_FOUND': 2,
                          'RESULT_INCORRECT_STATE': 3, 'RESULT_OPERATION_FAILED': 4},
                         result=0, error_message='')
    states = ['STOPPED', 'PLAYING', 'PAUSED', 'QUITTING', *['NO_WORLD', 'LOADING_WORLD'] * worlds]
    msg.SimulationState = message(
        {f'STATE_{name}': i for i, name in enumerate(states)}, state=0)
    msg.SimulatorFeatures = message(
        FEATURES | (WORLD_FEATURES if worlds else {}),
        features=[], spawn_formats=[], custom_info='')
    msg.TagsFilter = message({'FILTER_MODE_ANY': 0, 'FILTER_MODE_ALL': 1}, tags=[], filter_mode=0)
    msg.Resource = message(uri='', resource_string='')
    uri = {'uri': ''}
    msg.WorldResource = message(name='', description='', tags=[], **(
        {'world_resource': msg.Resource()} if resource else uri))


def _add_services(srv: ModuleType, msg: ModuleType) -> None:
    empty, answer = message(), message(result=msg.Result())
    state = message(state=msg.SimulationState())
    srv.GetSimulatorFeatures = service(empty, message(features=msg.SimulatorFeatures()))
    srv.GetSimulationState = service(
        empty, message(state=msg.SimulationState(), result=msg.Result()))
    srv.SetSimulationState = service(state, message(
        {'ALREADY_IN_TARGET_STATE': 101, 'STATE_TRANSITION_ERROR': 102}, result=msg.Result()))
    srv.ResetSimulation = service(message(
        {'SCOPE_DEFAULT': 0, 'SCOPE_TIME': 1, 'SCOPE_STATE': 2, 'SCOPE_SPAWNED': 4,
         'SCOPE_ALL': 255}, scope=0), answer)
    srv.StepSimulation = service(message(steps=1), answer)
    # There, and not served.
    srv.SpawnEntity = srv.GetEntityState = service(empty, answer)


def _add_world_services(srv: ModuleType, msg: ModuleType, resource: bool) -> None:
    empty, none = message(), {'NO_WORLD_LOADED': 101}
    srv.GetAvailableWorlds = service(
        message(additional_sources=[], filter=msg.TagsFilter(), offline_only=False,
                continue_on_error=False), message(result=msg.Result(), worlds=[]))
    srv.GetCurrentWorld = service(empty, message(
        none, result=msg.Result(), world=msg.WorldResource()))
    srv.LoadWorld = service(
        message(**{'world_resource': msg.Resource()} if resource else msg.Resource.fields),
        message({'UNSUPPORTED_FORMAT': 101, 'NO_RESOURCE': 102, 'RESOURCE_PARSE_ERROR': 103,
                 'MISSING_ASSETS': 104, 'UNSUPPORTED_ELEMENTS': 106},
                result=msg.Result(), world=msg.WorldResource()))
    srv.UnloadWorld = service(empty, message(none, result=msg.Result()))


class Simulator:
    """A node that offers services, and what they act on; nothing is simulated."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, modules: dict[str, ModuleType | None]):
        self.offered: dict[str, tuple[type, Callable]] = {}
        self.settings = Settings()
        self.run, self.control = None, None
        self.state, self.ended = State.PRIMARY_STATE_UNCONFIGURED, []
        self.refused, self.refusal = '', 'the node is not configured'
        self.scene_of_the_start = ''
        for name, module in modules.items():
            monkeypatch.setitem(sys.modules, name, module)
        # An action server of rclpy needs the type support of real messages.
        monkeypatch.setattr(
            'hnn_vi_ros.ros.services.ActionServer', self._serve)

    def create_service(self, kind: type, name: str, handler: Callable, callback_group) -> None:
        self.offered[name] = kind, handler

    def _serve(self, node, kind, name, execute, callback_group, cancel_callback) -> None:
        self.offered[name] = kind, execute
        self.cancel = cancel_callback

    def stop(self, status: int, reason: str) -> None:
        self.ended.append(status)

    async def in_thread(self, work: Callable[[], Any]) -> Any:
        return work()

    def set_parameters_atomically(self, parameters: list) -> SimpleNamespace:
        self.settings = replace(
            self.settings, **{parameter.name: parameter.value for parameter in parameters})
        return SimpleNamespace(successful=True)

    async def change_state(self, transition: int) -> bool:
        if transition == Transition.TRANSITION_CONFIGURE:
            if self.refused:
                raise HnnViRosError(self.refused)
            self.load(self.settings.scene)
        elif transition == Transition.TRANSITION_CLEANUP:
            self.run = self.control = None
            self.state = State.PRIMARY_STATE_UNCONFIGURED
        else:
            active = transition == Transition.TRANSITION_ACTIVATE
            self.control.active = active
            self.state = State.PRIMARY_STATE_ACTIVE if active else State.PRIMARY_STATE_INACTIVE
        return True

    def load(self, scene: str) -> None:
        """Be configured."""
        self.run, self.control = SimpleNamespace(scene=load_scene(scene)), Controlled()
        self.control.active, self.state = False, State.PRIMARY_STATE_INACTIVE

    def call(self, name: str, **fields: Any) -> Any:
        """Return the response of a service to a request."""
        kind, handler = self.offered[f'~/{name}']
        return now(handler(kind.Request(**fields), kind.Response()))

    def code(self, name: str, **fields: Any) -> int:
        """Return the result of a service."""
        return self.call(name, **fields).result.result


def now(answer: Any) -> Any:
    """Return what a handler returns, or its coroutine at once."""
    if not isinstance(answer, Awaitable):
        return answer
    with pytest.raises(StopIteration) as ended:
        answer.send(None)
    return ended.value.value


class Controlled:
    """A Control that only notes what it is told; it fails beyond four steps."""

    def __init__(self):
        self.active, self.paused, self.stopped = True, False, False
        self.resets: list[bool | str] = []
        self.refused, self.waiting, self.progress = '', None, None

    @property
    def running(self) -> bool:
        return self.active and not self.paused

    def set_paused(self, paused: bool) -> Answer:
        self.paused, self.stopped = paused, False
        return Answer(True, '')

    def reset(self, time_too: bool) -> Answer:
        self.resets.append(time_too)
        return Answer(not self.refused, self.refused)

    def reset_time(self) -> Answer:
        self.resets.append('time')
        return Answer(True, '')

    def request_steps(self, count: int, progress: Callable | None = None) -> Future:
        self.waiting, self.progress = Future(), progress
        if count < 100:
            self.waiting.set_result(Answer(count < 5, f'{count}'))
        return self.waiting

    def cancel_steps(self, future: Future) -> None:
        if future is self.waiting:
            future.set_result(Answer(False, 'cancelled'))


def active_simulator(monkeypatch: pytest.MonkeyPatch, modules: dict[str, ModuleType]) -> Simulator:
    """Return a simulator that offers its services and simulates."""
    node = Simulator(monkeypatch, modules)
    offer_services(node)
    node.load('exact_harmonic_oscillator')
    node.control.active, node.state = True, State.PRIMARY_STATE_ACTIVE
    return node
