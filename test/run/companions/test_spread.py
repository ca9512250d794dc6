# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The spread of an ensemble, in Python and beside a simulation that runs."""

from dataclasses import replace
from pathlib import Path

from ensembles import ensemble
from hnn_vi_ros import load_scene, simulate, simulate_spread
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.run import AccompaniedSimulation, deviation, Members
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build, SpreadGuard
from hnn_vi_ros.simulation.guards.samples import GuardState
from messages import refused
import numpy as np
import pytest
from scene_files import write_scene

COUNT, FACTOR = 4, np.array([2.0, 3.0])


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    model = ensemble(COUNT)
    card = model.card.ensemble.model_copy(update={'factors': FACTOR.tolist()})
    save_checkpoint(tmp_path / 'several.safetensors', replace(
        model, card=model.card.model_copy(update={'ensemble': card})))
    return load_scene(write_scene(
        tmp_path / 'scene.yaml', 'learned, model: several.safetensors',
        '{kind: external_force, coordinates: [x0], timeout: 10.0}', 'implicit_midpoint', 0.05,
        [0.5], [-0.3], 'uncertainty: {limit: 0.01}\n'))


def member_of(scene: Scene, number: int) -> Scene:
    return scene.changed({'uncertainty': None, 'hamiltonian': {
        **scene.hamiltonian.model_dump(), 'member': number}})


def test_spread_is_the_deviation_of_the_members_times_the_factor(scene: Scene):
    found = simulate_spread(scene, 2.0, every=10)
    assert len(found.members) == COUNT and found.level == 0.9
    q = np.stack([one.q for one in found.members])
    np.testing.assert_allclose(found.spread_q, 2.0 * q.std(axis=0, ddof=1), rtol=1e-14)
    p = np.stack([one.p for one in found.members])
    np.testing.assert_allclose(found.spread_p, 3.0 * p.std(axis=0, ddof=1), rtol=1e-14)
    assert (found.spread_q[0] == 0.0).all() and (found.spread_q[-1] > 0.0).all()
    mean = simulate(scene, 2.0, every=10)
    assert found.mean.q.tobytes() == mean.q.tobytes()
    # The members are the scene with each of them.
    second = simulate(member_of(scene, 2), 2.0, every=10)
    assert second.q.tobytes() == found.members[1].q.tobytes()


def test_members_beside_a_run_step_as_they_do_alone_under_its_commands(scene: Scene):
    members = Members(scene.parts())
    accompanied = AccompaniedSimulation(build(scene), [members])
    accompanied.advance(7)
    accompanied.set_command([0.25])
    accompanied.advance(13)
    states = []
    for k in range(1, COUNT + 1):
        alone = build(member_of(scene, k))
        alone.advance(7)
        alone.set_command([0.25])
        alone.advance(13)
        states.append([*alone.q, *alone.p])
    assert members.spread.tolist() == (FACTOR * deviation(states)).tolist()


def test_run_with_members_is_the_run_without_them(scene: Scene):
    with_members = AccompaniedSimulation(build(scene), [Members(scene.parts())])
    alone = build(scene)
    for simulation in (with_members, alone):
        simulation.set_command([0.1])
        simulation.advance(20)
    assert with_members.q.tobytes() == alone.q.tobytes()
    assert with_members.works == alone.works


def test_members_begin_anew_where_the_run_does(scene: Scene):
    members = Members(scene.parts())
    simulation = AccompaniedSimulation(build(scene), [members])
    simulation.advance(20)
    snapshot = simulation.snapshot()
    assert (members.spread > 0.0).all()
    simulation.restart([0.1], [0.2])
    assert (members.spread == 0.0).all()
    simulation.advance(5)
    simulation.restore(snapshot)
    assert (members.spread == 0.0).all()


def test_member_that_failed_makes_the_spread_infinite():
    spread = deviation([[1.0, 2.0], [1.5, np.inf], [0.5, 3.0]])
    assert spread.tolist() == [0.5, np.inf]


def test_spread_of_an_exact_system_or_of_a_confined_one_is_refused_with_the_remedy(scene: Scene):
    confined = scene.changed({'hamiltonian': {**scene.hamiltonian.model_dump(), 'confine': True}})
    for wrong in ('kepler', confined):
        with refused(SceneError):
            simulate_spread(wrong, 1.0)


@pytest.mark.parametrize('options', [{'every': 4}, {'times': [0.1, 0.3, 2.0]}])
def test_event_that_ends_the_mean_ends_the_members(scene: Scene, options: dict):
    whole = simulate(scene, 2.0, **options)
    middle = float(np.mean(whole.q[-2:]))
    ended = scene.changed({'events': [{'when': f'x0 = {middle!r}', 'then': 'stop'}]})
    found = simulate_spread(ended, 2.0, **options)
    assert found.mean.events and found.mean.t[-1] < 2.0
    assert {one.t.tobytes() for one in found.members} == {found.mean.t.tobytes()}
    assert found.spread_q.shape == found.mean.q.shape and found.spread_q[-1] > 0.0


def test_spread_guard_tells_once_when_its_limit_is_exceeded():
    values = iter([0.0, 0.05, 0.3, 0.4, 0.1, 0.2, np.inf])
    box = np.array([[-2.0, 2.0]]), np.array([[-1.0, 1.0]])
    newest = [0.0]
    guard = SpreadGuard(lambda: np.array([0.0, newest[0]]), box, 0.15)
    zero, told = np.zeros(1), []
    for step, value in enumerate(values):
        newest[0] = value
        alarm = guard.update(GuardState(step, zero, zero, zero, zero, 0.0, 0.0))
        told += [] if alarm is None else [(alarm.step, alarm.value, alarm.limit)]
    assert told == [(2, 0.3, 0.15), (5, 0.2, 0.15)]
