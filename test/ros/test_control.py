# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Requests for steps and resets, as Control answers them; the run and the timers are stand-ins."""

import json
import math
from types import SimpleNamespace
from unittest.mock import Mock

from hnn_vi_ros.ros.plumbing.graph import Discovery
from hnn_vi_ros.ros.run.control import Answer, Control
from hnn_vi_ros.ros.run.run import Run
from hnn_vi_ros.ros.settings import Settings
import numpy as np
import pytest
from rclpy.task import Future


class Steps:
    """A run that takes steps in batches of three, and none beyond the hundredth."""

    # Whether a step fails, and what takes it is still being compiled.
    waits = False
    lockstep, locked = None, False

    def __init__(self):
        self.simulation = SimpleNamespace(
            steps=0, time=0.0, q=np.array([1.0]), p=np.array([-0.5]),
            motors=SimpleNamespace(takes=()))
        self.sampler, self.status = SimpleNamespace(stamp=0, time=0.0), SimpleNamespace()
        self.recording = SimpleNamespace(flush=lambda: None)
        # Nothing is due as long as it is not asked for.
        self.pacer = SimpleNamespace(
            restart=lambda: None, timer_period=0.01, due=lambda: False, wait=1.0, led=False)
        self.start, self.at_sample, self.began = (np.array([1.0]), np.array([-0.5])), True, []
        self.watch, self.start_clocks, self.publish_diagnostics, self.tell = (
            Mock() for _ in range(4))

    def step(self, most: float = math.inf) -> int | None:
        if self.waits:
            return None
        taken = int(min(3, most, 100 - self.simulation.steps))
        self._stand(self.simulation.steps + taken)
        return taken

    def _stand(self, steps: int) -> None:
        simulation = self.simulation
        simulation.steps, simulation.time = steps, steps * 0.25
        self.sampler.stamp, self.sampler.time = steps * 250_000_000, steps * 0.25

    def reset(self, time_too: bool) -> None:
        self.began.append((list(self.start[0]), time_too))
        self.simulation.q, self.simulation.p = self.start
        self._stand(0)


@pytest.fixture
def control() -> Control:
    """Return a Control that was activated, in a pause, of a node whose timer is called by hand."""
    node, run = Mock(exit_status=None), Steps()
    node.get_name.return_value, node.get_namespace.return_value = 'hnn_simulator', '/'
    node.get_node_names_and_namespaces.return_value = [('hnn_simulator', '/')]
    made = Control(node, run, Discovery(lambda: 0, 0.0), Settings(start_paused=True))
    assert made.stopped
    made.activate()
    # Discovery is over at once.
    node.create_timer.call_args.args[1]()
    made.run, made.turn = run, node.create_timer.call_args.args[1]
    return made


def answered(control: Control, future: Future) -> Answer:
    """Return the answer to a request, after as many turns as a busy machine takes."""
    while not future.done():
        control.turn()
    return future.result()


def figures(message: str) -> dict:
    """Return the JSON object that a message ends in."""
    return json.loads(message[message.index('{'):])


def test_answer_to_a_request_for_steps_says_how_many_it_took_and_where_the_run_stands(control):
    answers = []
    for count in (5, 2):
        future = control.request_steps(count)
        answers.append(answered(control, future))
    assert [answer.success for answer in answers] == [True, True]
    assert [json.loads(answer.message) for answer in answers] == [
        {'steps': 5, 'step': 5, 'time': 1.25, 'stamp': 1_250_000_000},
        {'steps': 2, 'step': 7, 'time': 1.75, 'stamp': 1_750_000_000}]


@pytest.mark.parametrize('end, reason', [
    (lambda control, future: control.set_paused(False), 'the pause has ended'),
    (lambda control, future: control.reset(False), 'the simulation was reset'),
    (lambda control, future: control.cancel_steps(future), 'cancelled'),
    (lambda control, future: control.deactivate(), 'the node was deactivated')])
def test_request_for_steps_that_is_ended_says_how_many_it_took_until_then(control, end, reason):
    def end_after_six(done: int, left: int) -> None:
        if done == 6:
            assert left == 44
            end(control, future)
    future = control.request_steps(50, end_after_six)
    success, message = answered(control, future)
    assert not success and message.startswith(f'{reason}: ')
    assert (figures(message)['steps'], figures(message)['step']) == (6, 6)
    # Nobody waits any more: the next request is taken.
    if reason != 'the node was deactivated':
        control.set_paused(True)
        assert not control.request_steps(1).done()


def test_request_for_steps_that_fails_says_how_many_were_good(control):
    future = control.request_steps(1000)
    success, message = answered(control, future)
    assert not success and message.startswith('a step failed')
    assert figures(message)['steps'] == 100


def test_request_that_is_not_begun_takes_no_step_and_cancels_none(control):
    first = control.request_steps(50)
    second = control.request_steps(7)
    assert 'already' in second.result().message
    control.cancel_steps(second)
    assert not first.done() and control.run.simulation.steps == 0


def test_answer_to_a_reset_says_at_which_state_and_time_the_run_begins(control):
    control.request_steps(4)
    control.turn()
    # The state of another client's ~/initial_state.
    control.run.start = np.array([0.1]), np.array([1e-17])
    success, message = control.reset(True)
    assert success and json.loads(message) == {
        'q': [0.1], 'p': [1e-17], 'reset_time': True, 'step': 0, 'time': 0.0, 'stamp': 0}


def test_reset_of_the_time_keeps_the_state_and_where_later_resets_go(control):
    control.run.simulation.q = np.array([7.0])
    assert control.reset_time().success
    assert control.run.began == [([7.0], True)]
    control.reset(False)
    assert control.run.began[-1] == ([1.0], False)


@pytest.mark.parametrize('move', [
    lambda control: control.request_steps(1), lambda control: control.set_paused(True),
    lambda control: control.set_paused(False), lambda control: control.activate()])
def test_stopped_run_is_no_more_stopped_once_it_steps_or_is_paused_or_played(control, move):
    control.stopped = True
    control.reset(False)
    assert control.stopped
    move(control)
    assert not control.stopped


@pytest.mark.parametrize('act', [
    lambda control: control.activate(), lambda control: control.deactivate(),
    lambda control: control.set_paused(True), lambda control: control.reset(False),
    lambda control: (control.set_paused(True), control.request_steps(3))],
    ids=['activate', 'deactivate', 'pause', 'reset', 'step'])
def test_clocks_are_started_anew_whenever_the_run_is_halted_or_goes_on(control, act):
    control.set_paused(False)
    control.run.start_clocks.reset_mock()
    act(control)
    assert control.run.start_clocks.called


def test_messages_of_a_sample_leave_before_the_figures_are_evaluated():
    run = Mock(lockstep=None)
    Run._hand_out(run)
    calls = [name for name, _, _ in run.mock_calls]
    order = [calls.index(name) for name in (
        '_monitor.add', '_topics.publish', 'recording.write', '_monitor.evaluate')]
    assert order == sorted(order)


def test_request_for_steps_goes_on_after_a_step_that_waits(control):
    control.run.waits = True
    future = control.request_steps(5)
    control.turn()
    assert not future.done()
    control.run.waits = False
    assert figures(answered(control, future).message)['steps'] == 5


def test_run_goes_on_after_a_step_that_waits(control):
    control.set_paused(False)
    control.run.pacer.due, control.run.pacer.asked = lambda: True, 0.0
    control.run.waits = True
    control.turn()
    assert control.running and control.run.simulation.steps == 0
    control.run.waits = False
    while control.run.simulation.steps == 0:
        control.turn()
