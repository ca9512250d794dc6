# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The action of simulation_interfaces that takes steps; its messages are stand-ins."""

import pytest
from simulation_stand_ins import active_simulator, FAILED, interfaces, now, OK, Simulator


@pytest.fixture
def simulator(monkeypatch: pytest.MonkeyPatch) -> Simulator:
    """Return an active simulator that serves the action."""
    return active_simulator(monkeypatch, interfaces())


class Goal:
    """A goal handle that notes what becomes of it."""

    def __init__(self, simulator: Simulator, steps: int):
        self.request = simulator.offered['~/simulate_steps'][0].Goal(steps=steps)
        self.is_cancel_requested, self.end, self.told = False, '', []

    def publish_feedback(self, feedback) -> None:
        self.told.append((feedback.completed_steps, feedback.remaining_steps))

    def succeed(self) -> None:
        self.end += 'succeeded'

    def abort(self) -> None:
        self.end += 'aborted'

    def canceled(self) -> None:
        self.end += 'canceled'


def execute(simulator: Simulator, goal: Goal):
    return simulator.offered['~/simulate_steps'][1](goal)


@pytest.mark.parametrize('steps, end, code', [(3, 'succeeded', OK), (5, 'aborted', FAILED)])
def test_goal_ends_as_its_steps_do_and_its_result_says_why(simulator, steps, end, code):
    goal = Goal(simulator, steps)
    answer = now(execute(simulator, goal)).result
    assert (goal.end, answer.result, answer.error_message) == (
        end, code, '' if code == OK else '5')


def test_goal_without_a_world_is_aborted_with_a_reason(simulator):
    simulator.control, goal = None, Goal(simulator, 3)
    answer = now(execute(simulator, goal)).result
    assert goal.end == 'aborted' and answer.result == FAILED
    assert 'not configured' in answer.error_message


def test_goal_tells_its_first_and_last_batch_and_does_not_flood_its_client(simulator):
    goal = Goal(simulator, 1000)
    work = execute(simulator, goal)
    work.send(None)
    for done in range(10, 1001, 10):
        simulator.control.progress(done, 1000 - done)
    # A hundred batches in far less than the two seconds that so many feedbacks would take.
    assert goal.told[0] == (10, 990) and goal.told[-1] == (1000, 0)
    assert len(goal.told) < 50
    work.close()


def test_goal_that_is_cancelled_ends_at_the_step_it_has_reached(simulator):
    goal, other = Goal(simulator, 1000), Goal(simulator, 1000)
    work = execute(simulator, goal)
    work.send(None)
    # The cancellation of another goal is none of this one.
    simulator.cancel(other)
    assert not simulator.control.waiting.done()
    simulator.cancel(goal)
    goal.is_cancel_requested = True
    answer = now(work).result
    assert goal.end == 'canceled' and answer.result == FAILED
    assert 'cancelled' in answer.error_message


def test_goal_that_was_cancelled_before_it_began_takes_no_step(simulator):
    goal = Goal(simulator, 1000)
    goal.is_cancel_requested = True
    work = execute(simulator, goal)
    assert now(work).result.result == FAILED and goal.end == 'canceled'
