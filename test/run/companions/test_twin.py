# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A twin tells how well it follows a machine, here one that is simulated."""

from collections.abc import Iterator
from pathlib import Path

from hnn_vi_ros import load_scene, Scene
from hnn_vi_ros.effects import Observation
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.run import AccompaniedSimulation, Twin, VALID
from hnn_vi_ros.simulation import build, Simulation
from messages import refused
import numpy as np
import pytest
from scene_files import write_scene

STEP, EVERY, NAN = 0.005, 2, float('nan')


def scene_of(folder: Path, length: float = 1.0, angle: float = 1.0, more: str = '',
             **observer: object) -> Scene:
    options = ''.join(f', {name}: {value}' for name, value in observer.items())
    effects = '{kind: external_force, coordinates: [angle], timeout: 1.0}' + (
        f', {{kind: observer, coordinates: [angle]{options}}}' if observer else '') + more
    path = folder / f'{length}-{angle}-{bool(observer)}.yaml'
    return load_scene(write_scene(
        path, f'pendulum, length: {length}', effects, step_size=STEP, q=[angle]))


class Twins:
    """A twin beside the simulation of a scene, and the machine that it follows."""

    def __init__(self, scene: Scene, machine: Scene):
        self.simulation, self.machine = build(scene), build(machine)
        self.twin = Twin(scene, self.simulation)
        self.accompanied = AccompaniedSimulation(self.simulation, [self.twin])

    def follow(self, observations: int, velocity: bool = True) -> list:
        """Observe the machine so often while both are driven; return what was told."""
        reports = []
        for k in range(observations):
            self.accompanied.set_command(seen(self.machine, velocity))
            reports.append(self.twin.newest)
            for one in (self.accompanied, self.machine):
                one.set_command([0.5 * np.sin(0.3 * k)])
                one.advance(EVERY)
        return reports


def seen(machine: Simulation, velocity: bool = True) -> Observation:
    return Observation(('angle',), 0.0, machine.q.copy(), machine.dH_dp.copy() if velocity
                       else np.array([NAN]))


def test_twin_of_a_machine_that_it_knows_predicts_it_to_the_end(tmp_path: Path):
    twins = Twins(scene_of(tmp_path, gain=0.0, deviations=[0.5]), scene_of(tmp_path))
    reports, twin = twins.follow(250), twins.twin
    # A prediction begins at the momentum of the observed velocity, which is rounded.
    assert max(report.normalised for report in reports[1:]) < 1e-20
    assert all(report.error == 0.0 for report in reports)
    # It ends after two seconds all the same; one begins every half of one, the first at once.
    assert len(twin.times) == 1 and twin.valid_prediction_time == pytest.approx(2.0, abs=1e-9)
    assert len(twin.running) == 4


def independent_time(scene: Scene, machine: Simulation, first: int, deviation: float) -> float:
    """Return the valid prediction time of a prediction from the first-th observation on."""
    for k in range(first):
        machine.set_command([0.5 * np.sin(0.3 * k)])
        machine.advance(EVERY)
    prediction = build(scene)
    # p = m l^2 q' of the model's own length, 1.2 m.
    prediction.restart(machine.q, 1.44 * machine.dH_dp)
    k = first
    while ((machine.q[0] - prediction.q[0]) / deviation)**2 < VALID:
        for one in (prediction, machine):
            one.set_command([0.5 * np.sin(0.3 * k)])
            one.advance(EVERY)
        k += 1
    return EVERY * STEP * (k - first)


def test_valid_prediction_time_is_that_of_predictions_from_even_times_on(tmp_path: Path):
    deviation, count = 0.5, 300
    scene = scene_of(tmp_path, length=1.2, gain=0.0, deviations=[deviation], predictions=4)
    alone, machine = scene_of(tmp_path, length=1.2), scene_of(tmp_path)
    twins = Twins(scene, machine)
    twins.follow(count)
    twin = twins.twin
    # One begins every 0.5 s, which is 50 observations; those of the last second may not end.
    times = [independent_time(alone, build(machine), first, deviation)
             for first in range(0, 200, 50)]
    np.testing.assert_allclose(sorted(twin.times)[-1], max(times), atol=1e-9)
    for time in times:
        assert np.abs(np.array(twin.times) - time).min() < 1e-9
    assert twin.valid_prediction_time == np.median(twin.times)


def test_observer_brings_the_simulation_to_the_machine(tmp_path: Path):
    reports = Twins(scene_of(tmp_path, angle=0.4, gain=60.0, damping=10.0),
                    scene_of(tmp_path)).follow(300)
    assert abs(reports[0].error[0]) == pytest.approx(0.6)
    # exp(-5 x 3 s) of it is left, and what observations are held and extrapolated for 10 ms.
    assert max(abs(report.error[0]) for report in reports[-50:]) < 1e-3


def test_velocities_that_are_not_observed_are_those_between_observations(tmp_path: Path):
    reports = Twins(scene_of(tmp_path, gain=0.0, deviations=[0.5]),
                    scene_of(tmp_path, angle=1.5)).follow(20, velocity=False)
    # Before two observations no velocity is known, and nothing is predicted.
    assert np.isnan([report.normalised for report in reports[:2]]).all()
    assert np.isfinite([report.normalised for report in reports[2:]]).all()


@pytest.mark.parametrize('gap', [200, 2000])
def test_nothing_is_predicted_across_a_silence_of_the_machine(tmp_path: Path, gap: int):
    twins = Twins(scene_of(tmp_path, gain=0.0, deviations=[0.5]), scene_of(tmp_path, angle=1.5))
    twins.follow(3, velocity=False)
    for one in (twins.accompanied, twins.machine):
        one.advance(gap)
    twin, running = twins.twin, len(twins.twin.running)
    twins.accompanied.set_command(seen(twins.machine, velocity=False))
    # No velocity is that between observations further apart than the time-out.
    assert len(twin.running) <= running
    # A prediction of which nobody has seen the end tells nothing, least of all 10 s.
    assert len(twin.times) <= 1 and all(time <= 2.0 for time in twin.times)
    assert running == (1 if gap == 200 else 0)


def test_twin_forgets_the_machine_where_the_run_begins_anew(tmp_path: Path):
    twins = Twins(scene_of(tmp_path, length=1.2, gain=0.0), scene_of(tmp_path))
    twins.follow(60)
    twin = twins.twin
    assert twin.times
    twins.accompanied.restart([1.0], [0.0])
    assert twin.newest is None and not twin.times and np.isnan(twin.valid_prediction_time)


def test_observation_far_beyond_a_joint_is_refused_and_not_counted(tmp_path: Path):
    twins = Twins(scene_of(tmp_path, gain=0.0, deviations=[0.5]), scene_of(tmp_path))
    for position, velocity in ((1e300, 0.0), (0.0, -1e300)):
        with refused(ValueError):
            twins.accompanied.set_command(Observation(
                ('angle',), 0.0, np.array([position]), np.array([velocity])))
    assert twins.twin.newest is None


def absurd(size: float, names: tuple[str, ...]) -> Iterator[Observation]:
    """Yield what no machine is observed at, in every way that messages allow."""
    rng, still = np.random.default_rng(5), np.zeros(len(names))
    for _ in range(40):
        yield Observation(names, 0.0, np.full(len(names), size), still)
        yield Observation(names, 0.0, rng.uniform(-size, size, len(names)), still)
        yield Observation(names, rng.uniform(-0.5, 0.5), rng.uniform(-1.0, 1.0, len(names)),
                          rng.uniform(-size, size, len(names)))
        yield Observation(names[:1], 0.0, np.zeros(1), np.zeros(1))
        yield Observation(names, rng.uniform(-size, size), still, still)


@pytest.mark.parametrize('size', [pytest.param(size, marks=pytest.mark.long) if size in (
    1e3, 1e6, 1e9) else size for size in (30.0, 1e3, 1e6, 1e9, 1e300)])
@pytest.mark.parametrize('first', [pytest.param(False, marks=pytest.mark.long), True])
def test_twin_goes_on_after_absurd_observations(size: float, first: bool):
    pull = {'kind': 'observer', 'coordinates': ['angle1', 'angle2'], 'gain': 300.0,
            'damping': 20.0, 'deviations': [0.5, 0.5]}
    scene = load_scene('exact_double_pendulum').changed({'effects': [pull]})
    twins, taken = Twins(scene, scene.changed({'effects': []})), 0
    accompanied, machine, names = twins.accompanied, twins.machine, tuple(pull['coordinates'])
    phases = [absurd(size, names), None, absurd(size, names), None]
    for phase in phases if first else phases[1:]:
        for bad in phase or [None] * 200:
            try:
                accompanied.set_command(bad or Observation(
                    names, 0.0, machine.q.copy(), machine.dH_dp.copy()))
                taken += bad is None
            except ValueError as problem:
                assert '\n' not in str(problem)
            for one in (accompanied, machine):
                one.advance(2)
    # Two seconds at rates of at least 8 / s, those of a mass of 2.1 kg m^2, leave exp(-16) of what
    # a wrong one has done. Between two observations the machine is taken to go on as it was seen,
    # for 10 ms, in which gravity changes that by some 20 / s^2.
    assert np.abs(twins.twin.newest.error).max() < 1e-2 and taken > 150 * (1 + first)


def test_gain_that_no_step_takes_is_refused_by_its_name(tmp_path: Path):
    # Of a mass of 1 kg m^2 4 / h^2 without damping.
    for gain, damping in ((1.7e5, 0.0), (1e9, 1.0)):
        scene = scene_of(tmp_path, gain=gain, damping=damping)
        with refused(SceneError):
            Twin(scene, build(scene))
    scene = scene_of(tmp_path, gain=1.5e5)
    assert not Twin(scene, build(scene)).unstable


@pytest.mark.parametrize('restored', [False, True])
def test_prediction_begins_with_the_commands_that_hold_and_no_others(
        tmp_path: Path, restored: bool):
    twins = Twins(scene_of(tmp_path, gain=0.0, deviations=[0.5]), scene_of(tmp_path))
    twin, accompanied, machine = twins.twin, twins.accompanied, twins.machine
    for one in (accompanied, machine):
        one.set_command([5.0])
        # Longer than a command holds, or on the way to there, as where a bag is resumed.
        one.advance(100 if restored else 240)
    if restored:
        accompanied.restore(twins.simulation.snapshot())
    for _ in range(40):
        accompanied.set_command(seen(machine))
        # The momentum of the observed velocity is rounded.
        assert twin.newest.normalised < 1e-20 or np.isnan(twin.newest.normalised)
        for one in (accompanied, machine):
            one.advance(EVERY)
    assert twin.newest.running > 0.3


@pytest.mark.parametrize('gain', [0.0, 20.0])
def test_angles_that_a_driver_keeps_within_a_turn_are_compared_modulo_a_turn(tmp_path, gain):
    """A pendulum that turns over, seen between -pi and pi; the twin counts its turns."""
    twins = Twins(scene_of(tmp_path, gain=gain, deviations=[0.5]), scene_of(tmp_path))
    twin, accompanied, machine = twins.twin, twins.accompanied, twins.machine
    for one in (accompanied, machine):
        one.restart([1.0], [9.0])
    for _ in range(200):
        observation = seen(machine)
        wrapped = (observation.position + np.pi) % (2.0 * np.pi) - np.pi
        accompanied.set_command(observation._replace(position=wrapped))
        # y goes on at the observed velocity: off by g (10 ms)^2 / 2 there, and as much in q.
        assert abs(twin.newest.error[0]) < 1e-3 and not twin.newest.normalised >= VALID
        accompanied.advance(EVERY)
        machine.advance(EVERY)
    assert machine.q[0] > 4.0 * np.pi and abs(accompanied.q[0] - machine.q[0]) < 1e-3


def test_angles_turn_over_where_a_turn_changes_no_force_and_nothing_stops_them(tmp_path):
    def turning(effects: str) -> bool:
        return bool(build(scene_of(tmp_path, more=effects)).system.turning[0])

    assert turning('')
    assert not turning(', {kind: potential, formula: 2 * angle^2}')
    assert not turning(', {kind: impact, coordinate: angle, position: -3.0}')
    assert not build(load_scene('kepler')).system.turning.any()
