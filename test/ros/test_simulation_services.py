# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Services and the action of simulation_interfaces, by its definition; messages are stand-ins."""

from pathlib import Path
from unittest.mock import Mock

from hnn_vi_ros.ros.services import INTERFACES, offer_services, service_name
from hnn_vi_ros.ros.settings import Settings
from lifecycle_msgs.msg import State
from messages import refused
import pytest
from scene_files import scene_text, write_scene
from simulation_stand_ins import (
    active_simulator, FAILED, INCORRECT_STATE, interfaces, LOADING, NO_WORLD, NOT_FOUND, now, OK,
    PAUSED, PLAYING, QUITTING, Simulator, STOPPED, UNSUPPORTED)

OWN = {'~/set_pause', '~/reset', '~/step', '~/start_recording', '~/stop_recording'}
SHIPPED = 'package://hnn_vi_ros/config/scenes/exact_pendulum.yaml'
CODE = scene_text("python, factory: 'os:abort'")


@pytest.fixture
def simulator(monkeypatch: pytest.MonkeyPatch) -> Simulator:
    """Return an active simulator that serves version 2 of the interfaces."""
    return active_simulator(monkeypatch, interfaces())


def state_of(node: Simulator) -> int:
    return node.call('get_simulation_state').state.state


def set_state(node: Simulator, wanted: int) -> int:
    state = node.offered['~/set_simulation_state'][0].Request().state
    state.state = wanted
    return node.code('set_simulation_state', state=state)


def test_simulation_interfaces_that_are_not_installed_cost_nothing(monkeypatch):
    node = Simulator(monkeypatch, dict.fromkeys(interfaces()))
    offer_services(node)
    assert node.offered.keys() == OWN


def test_package_that_lacks_something_else_is_an_error_not_an_absent_package(monkeypatch):
    modules = interfaces()
    del modules['simulation_interfaces.srv']

    def fail(name: str):
        raise ModuleNotFoundError("No module named 'numpy'", name='numpy')
    monkeypatch.setattr('hnn_vi_ros.ros.services.import_module', fail)
    with refused(ModuleNotFoundError):
        active_simulator(monkeypatch, modules)


@pytest.mark.parametrize('worlds, expected', [
    (True, [20, 21, 22, 24, 25, 26, 31, 32, 33, 40, 42, 43, 44, 45]),
    (False, [20, 21, 22, 24, 25, 26, 31, 32, 33])])
def test_features_are_exactly_those_that_the_installed_version_lets_us_serve(
        monkeypatch, worlds, expected):
    node = active_simulator(monkeypatch, interfaces(worlds))
    features = node.call('get_simulator_features').features
    assert features.features == expected and features.spawn_formats == []
    known = [name for name in INTERFACES if worlds or 'World' not in name]
    assert node.offered.keys() - OWN == {f'~/{service_name(name)}' for name in known}


def test_state_is_played_paused_stopped_and_told(simulator):
    control = simulator.control
    assert state_of(simulator) == PLAYING
    # Each transition, and once more: 101 is ALREADY_IN_TARGET_STATE.
    for wanted in (PAUSED, STOPPED, PAUSED, PLAYING, STOPPED, PLAYING):
        assert set_state(simulator, wanted) == OK
        assert state_of(simulator) == wanted
        assert set_state(simulator, wanted) == 101
        assert control.paused is (wanted != PLAYING)
    # To stop is to reset all, and to pause a stopped run is not.
    assert control.resets == [True, True]
    for other in (NO_WORLD, LOADING, 6, 255):
        assert set_state(simulator, other) == UNSUPPORTED
    assert state_of(simulator) == PLAYING


def test_state_that_cannot_be_stopped_at_is_a_transition_error_and_leaves_a_pause(simulator):
    simulator.control.refused = 'behind a wall'
    assert set_state(simulator, STOPPED) == 102
    assert state_of(simulator) == PAUSED


def test_quitting_ends_the_process_from_any_state(simulator):
    assert set_state(simulator, QUITTING) == OK and simulator.ended == [0]
    simulator.control = None
    assert set_state(simulator, QUITTING) == OK and simulator.ended == [0, 0]


def test_node_that_is_not_active_says_so_in_the_codes_of_each_interface(simulator):
    simulator.control.active = False
    for wanted in (PLAYING, PAUSED, STOPPED):
        assert set_state(simulator, wanted) == INCORRECT_STATE
    simulator.control = simulator.run = None
    assert state_of(simulator) == NO_WORLD
    simulator.state = State.TRANSITION_STATE_CONFIGURING
    assert state_of(simulator) == LOADING
    assert set_state(simulator, PLAYING) == INCORRECT_STATE
    assert simulator.code('reset_simulation') == INCORRECT_STATE
    # By the definition of StepSimulation, whatever keeps it from stepping is OPERATION_FAILED.
    assert simulator.code('step_simulation') == FAILED
    assert simulator.code('get_current_world') == 101
    assert simulator.code('unload_world') == INCORRECT_STATE
    assert simulator.code(
        'load_world', world_resource=resource(simulator, SHIPPED)) == INCORRECT_STATE


@pytest.mark.parametrize('service', [
    'set_simulation_state', 'reset_simulation', 'step_simulation', 'get_current_world'])
def test_refusal_says_that_the_node_is_being_configured(simulator, service):
    simulator.control = simulator.run = None
    simulator.state = State.TRANSITION_STATE_CONFIGURING
    simulator.refusal = 'configuring: compiling the kernel'
    request = simulator.offered[f'~/{service}'][0].Request()
    fields = {'state': request.state} if service == 'set_simulation_state' else {}
    assert simulator.call(service, **fields).result.error_message == simulator.refusal


def test_first_version_knows_no_state_without_a_world(monkeypatch):
    node = active_simulator(monkeypatch, interfaces(worlds=False))
    node.control = node.run = None
    assert state_of(node) == STOPPED


def test_reset_is_of_state_time_or_both_and_nothing_else_is_reset(simulator):
    assert [simulator.code('reset_simulation', scope=scope)
            for scope in (0, 1, 2, 3, 255)] == [OK] * 5
    assert simulator.control.resets == [True, 'time', False, True, True]
    for scope in (4, 5, 6, 7, 8, 128, 254):
        assert simulator.code('reset_simulation', scope=scope) == UNSUPPORTED
    assert len(simulator.control.resets) == 5
    simulator.control.refused = 'behind a wall'
    answer = simulator.call('reset_simulation', scope=2).result
    assert (answer.result, answer.error_message) == (FAILED, 'behind a wall')


def test_step_takes_the_count_of_its_request_and_not_the_parameter(simulator):
    simulator.settings = Settings(step_count=50)
    assert simulator.code('step_simulation', steps=4) == OK
    assert simulator.control.waiting.result().message == '4'
    answer = simulator.call('step_simulation', steps=5).result
    assert (answer.result, answer.error_message) == (FAILED, '5')


def resource(simulator: Simulator, uri: str, text: str = ''):
    found = simulator.offered['~/load_world'][0].Request().world_resource
    found.uri, found.resource_string = uri, text
    return found


def test_worlds_are_the_scenes_that_can_be_loaded(simulator):
    worlds = {world.name: world for world in simulator.call('get_available_worlds').worlds}
    assert worlds['exact_pendulum'].world_resource.uri == SHIPPED
    assert worlds['exact_pendulum'].tags[0] == 'pendulum' and worlds['exact_pendulum'].description
    # Its model is not shipped.
    assert 'air_track' not in worlds


def test_worlds_are_filtered_by_any_or_all_tags(simulator):
    wanted = {'damping', 'periodic_drive'}
    tags = simulator.offered['~/get_available_worlds'][0].Request().filter
    tags.tags = list(wanted)
    worlds = simulator.call('get_available_worlds').worlds
    for mode, matches in ((0, wanted.intersection), (1, wanted.issubset)):
        tags.filter_mode = mode
        found = simulator.call('get_available_worlds', filter=tags).worlds
        expected = [world.name for world in worlds if matches(world.tags)]
        assert [world.name for world in found] == expected
        assert 0 < len(expected) < len(worlds)


def test_worlds_of_a_folder_are_found_and_one_that_is_not_there_is_told(simulator, tmp_path):
    write_scene(tmp_path / 'own.yaml')
    (tmp_path / 'code.yaml').write_text(CODE)
    (tmp_path / 'other.yaml').write_text('a: 1')
    sources = [str(tmp_path), tmp_path.as_uri(), 'https://example.com/worlds']
    assert simulator.code('get_available_worlds', additional_sources=sources) == NOT_FOUND
    answer = simulator.call(
        'get_available_worlds', additional_sources=sources, continue_on_error=True)
    assert answer.result.result == OK and 'example.com' in answer.result.error_message
    assert [world.name for world in answer.worlds[-2:]] == ['own', 'own']


@pytest.mark.parametrize('uri, text, code', [
    ('', '', 102), ('', 'hamiltonian: {kind: kepler}', UNSUPPORTED), ('nothing', '', NOT_FOUND),
    ('/no/where.yaml', '', NOT_FOUND), ('world.sdf', '', 101), ('https://a.b/c.yaml', '', 101),
    ('http://[', '', 101), ('package://other/config/scenes/kepler.yaml', '', 101),
    ('package://hnn_vi_ros/config/scenes/../../x.yaml', '', 101), ('a\0b', '', NOT_FOUND),
    ('bad.yaml', '', 103), ('absent.yaml', '', 104), ('code.yaml', '', 106)])
def test_world_that_cannot_be_loaded_is_refused_by_its_code_and_the_run_goes_on(
        simulator, tmp_path, monkeypatch, uri, text, code):
    monkeypatch.chdir(tmp_path)
    Path('bad.yaml').write_text('hamiltonian: [')
    write_scene(Path('absent.yaml'), 'hnn, model: absent')
    Path('code.yaml').write_text(CODE)
    control = simulator.control
    answer = simulator.call('load_world', world_resource=resource(simulator, uri, text)).result
    assert answer.result == code and '\n' not in answer.error_message
    assert simulator.control is control and state_of(simulator) == PLAYING


@pytest.mark.parametrize('first', ['active', 'inactive', 'unconfigured'])
def test_world_is_loaded_from_any_state_and_left_stopped(simulator, first):
    simulator.settings = Settings(resume='bag')
    if first != 'active':
        now(simulator.change_state(4))
    if first == 'unconfigured':
        now(simulator.change_state(2))
    answer = simulator.call('load_world', world_resource=resource(simulator, SHIPPED))
    assert answer.result.result == OK and answer.world.name == 'exact_pendulum'
    assert (simulator.settings.scene, simulator.settings.resume) == ('exact_pendulum', '')
    assert simulator.state == State.PRIMARY_STATE_ACTIVE and state_of(simulator) == STOPPED
    current = simulator.call('get_current_world').world
    assert (current.name, current.world_resource.uri) == ('exact_pendulum', SHIPPED)
    assert set_state(simulator, PLAYING) == OK and simulator.control.running


def test_world_that_fails_to_configure_leaves_none_and_says_why(simulator):
    simulator.refused = 'bag: exists already'
    answer = simulator.call('load_world', world_resource=resource(simulator, SHIPPED)).result
    assert (answer.result, answer.error_message) == (FAILED, 'bag: exists already')
    assert state_of(simulator) == NO_WORLD


def test_world_is_unloaded_once(simulator):
    assert simulator.code('unload_world') == OK
    assert state_of(simulator) == NO_WORLD
    assert simulator.code('unload_world') == 101


def test_world_that_goes_on_from_a_bag_has_no_uri(simulator):
    simulator.settings = Settings(resume='bag')
    world = simulator.call('get_current_world').world
    assert world.name == 'exact_harmonic_oscillator' and world.world_resource.uri == ''


def test_uri_stands_in_the_message_itself_in_the_first_versions(monkeypatch):
    node = active_simulator(monkeypatch, interfaces(resource=False))
    assert SHIPPED in {world.uri for world in node.call('get_available_worlds').worlds}
    assert node.code('load_world', uri=SHIPPED) == OK
    assert node.call('get_current_world').world.uri == SHIPPED


def goal_of(simulator: Simulator, steps: int) -> Mock:
    """Return a goal handle that notes what becomes of it."""
    return Mock(request=simulator.offered['~/simulate_steps'][0].Goal(steps=steps),
                is_cancel_requested=False)


def end_of(goal: Mock) -> list[str]:
    return [call for call, *_ in goal.method_calls if call != 'publish_feedback']


def execute(simulator: Simulator, goal: Mock):
    return simulator.offered['~/simulate_steps'][1](goal)


@pytest.mark.parametrize('steps, end, code', [(3, 'succeed', OK), (5, 'abort', FAILED)])
def test_goal_ends_as_its_steps_do_and_its_result_says_why(simulator, steps, end, code):
    goal = goal_of(simulator, steps)
    answer = now(execute(simulator, goal)).result
    assert (end_of(goal), answer.result, answer.error_message) == (
        [end], code, '' if code == OK else '5')


def test_goal_without_a_world_is_aborted_with_a_reason(simulator):
    simulator.control, goal = None, goal_of(simulator, 3)
    answer = now(execute(simulator, goal)).result
    assert end_of(goal) == ['abort'] and answer.result == FAILED
    assert 'not configured' in answer.error_message


def test_goal_tells_its_first_and_last_batch_and_does_not_flood_its_client(simulator):
    goal = goal_of(simulator, 1000)
    work = execute(simulator, goal)
    work.send(None)
    for done in range(10, 1001, 10):
        simulator.control.progress(done, 1000 - done)
    # A hundred batches in far less than the two seconds that so many feedbacks would take.
    told = [(call.args[0].completed_steps, call.args[0].remaining_steps)
            for call in goal.publish_feedback.call_args_list]
    assert told[0] == (10, 990) and told[-1] == (1000, 0)
    assert len(told) < 50
    work.close()


def test_goal_that_is_cancelled_ends_at_the_step_it_has_reached(simulator):
    goal, other = goal_of(simulator, 1000), goal_of(simulator, 1000)
    work = execute(simulator, goal)
    work.send(None)
    # The cancellation of another goal is none of this one.
    simulator.cancel(other)
    assert not simulator.control.waiting.done()
    simulator.cancel(goal)
    goal.is_cancel_requested = True
    answer = now(work).result
    assert end_of(goal) == ['canceled'] and answer.result == FAILED
    assert 'cancelled' in answer.error_message


def test_goal_that_was_cancelled_before_it_began_takes_no_step(simulator):
    goal = goal_of(simulator, 1000)
    goal.is_cancel_requested = True
    work = execute(simulator, goal)
    assert now(work).result.result == FAILED and end_of(goal) == ['canceled']
