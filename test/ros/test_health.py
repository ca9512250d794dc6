# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards, provoked in a running simulator: other nodes hear its alarm, the files hold it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from helpers import alarm_of
from hnn_vi_ros import load_scene
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros.run.health import Health
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.diagnostics import ERROR, OK, Status, WARN
from hnn_vi_ros.run import OverrunGuard, Pacer, Sampler
from hnn_vi_ros.simulation import (
    Alarm, BoxGuard, build, EnergyGuard, Guard, make_guards, PoleGuard, RunFacts, Simulation)
from hnn_vi_ros.simulation.guards.bands import BarrierGuard, ResolutionGuard
from hnn_vi_ros.simulation.guards.facts import BAND_LIMIT, CHANGE_LIMIT
from hnn_vi_ros.simulation.guards.samples import SampleBlock
from hnn_vi_ros.simulation.guards.steps import CostGuard, RescueGuard, SolutionGuard
import numpy as np
from peer import hearing, values_of
from processes import finish, read_bag, start
import pytest
from rclpy.executors import SingleThreadedExecutor
from rerun_reader import read
from scene_files import FAILING, scene_text
from std_msgs.msg import Float64
from studies.hard_cases_plan import load_plan

TOPIC = '/diagnostics'
BOX = (np.array([[-1.0, 1.0]]), np.array([[-1.0, 1.0]]))


class Provocation(NamedTuple):
    """A scene that one guard is made for, and what is to be said of it."""

    scene: str
    parameters: dict[str, object]
    kind: str
    level: bytes
    text: str
    status: int = 0


LEAVING = scene_text('hnn, model: pendulum', '', 'variational_euler', q=[0.0], p=[7.5])
# Each level and each way to end; test/simulation/guards provokes every guard without a node.
PROVOCATIONS = {
    'unconverged': Provocation(
        FAILING, {'publish_rate': 2.5}, 'step failed', ERROR, 'no convergence', 1),
    # 7.5 is close to the edge of the box, and the momentum of a pendulum grows nowhere beyond.
    'outside': Provocation(LEAVING, {'duration': 2}, 'out of the training box', WARN,
                           'outside the training domain'),
    # Explicit Euler multiplies the energy of an oscillator by 1 + h^2 in each step.
    'gain': Provocation(
        scene_text(integrator='explicit_euler'),
        {'duration': 200}, 'energy not accounted for', ERROR, 'apart from the work done'),
    # More samples per second than any machine hands out.
    'overrun': Provocation(
        scene_text(integrator='variational_euler'),
        {'duration': 150, 'real_time_factor': 1e6}, 'real-time overrun', WARN, 'behind the clock'),
}


@pytest.fixture
def heard() -> Iterator[tuple[list[DiagnosticArray], SingleThreadedExecutor]]:
    """Give what another node hears on /diagnostics, and its executor."""
    with hearing(DiagnosticArray, TOPIC) as (messages, executor):
        node, = executor.get_nodes()
        # For this one the first step waits.
        node.create_subscription(Float64, '/hnn_simulator/energy', lambda message: None, 10)
        yield messages, executor


def events_of(file: Path) -> list[tuple[int, str, str]]:
    """Return (simulated time [ns], level, text) of the events of a recording."""
    rows = read(file).get('/events', {})
    columns = (rows.get(name, []) for name in ('sim_time', 'TextLog:level', 'TextLog:text'))
    return [(time, level, text) for time, (level,), (text,) in zip(*columns, strict=True)]


@pytest.mark.parametrize('name', PROVOCATIONS)
def test_guard_raises_an_alarm_that_is_heard_and_logged(tmp_path, heard, name):
    found, (messages, executor) = PROVOCATIONS[name], heard
    (tmp_path / 'scene.yaml').write_text(found.scene)
    begin = time.monotonic()
    process = start(tmp_path, **{
        'scene': 'scene.yaml', 'record_path': 'bag', 'real_time_factor': 0,
        'discovery_time': 30} | found.parameters)
    while process.poll() is None:
        executor.spin_once(timeout_sec=0.05)
    for _ in range(50):
        executor.spin_once(timeout_sec=0.0)
    status, _, error = finish(process)
    assert status == found.status
    # Over DDS. Some messages may be missed, but each alarm but an overrun is told again.
    told = [s for message in messages for s in message.status
            if s.name == 'hnn_simulator: health' and s.level != OK]
    assert any(found.kind in (values_of(s).get('alarm'), *(
        key.partition(':')[0] for key in values_of(s))) for s in told)
    assert {s.hardware_id for s in told} == {'scene'}
    # In the files, which are closed, alone.
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()
    bag = read_bag(tmp_path / 'bag')
    assert all(np.isfinite(message.data).all() for _, message in bag['/hnn_simulator/q'])
    alarms = [(stamp, *message.status) for stamp, message in bag[TOPIC]]
    stamp, alarm = next((s, a) for s, a in alarms if values_of(a)['alarm'] == found.kind)
    assert alarm.name == 'hnn_simulator: health' and bytes([alarm.level]) == found.level
    assert found.text in alarm.message
    assert {'step [1]', 't [s]', 'times [1]'} < values_of(alarm).keys()
    assert stamp in {0, *(stamp for stamp, _ in bag['/hnn_simulator/q'])}
    # In the log, every ten seconds at most.
    assert 1 <= error.count(found.text) <= 2 + (time.monotonic() - begin) / 10.0
    assert ('[ERROR]' in error) == (b'\x02' in {bytes([a.level]) for _, a in alarms})


def test_alarm_is_logged_at_the_first_sample_outside_the_box(tmp_path):
    (tmp_path / 'scene.yaml').write_text(LEAVING)
    status, _, error = finish(start(
        tmp_path, scene='scene.yaml', record_path='bag', rerun_path='picture.rrd',
        real_time_factor=0, stop_outside_box='true'))
    assert status == 1 and 'stopped by stop_outside_box' in error
    bag, box = read_bag(tmp_path / 'bag'), load_scene('pendulum').create_hamiltonian().box
    z = np.hstack([[message.data for _, message in bag[f'/hnn_simulator/{x}']] for x in 'qp'])
    low, high = np.concatenate(box).T
    outside = np.maximum(z - high, low - z).max(axis=1) > 0.0
    # Nothing comes after it.
    assert outside.tolist() == [False] * (len(z) - 1) + [True]
    (stamp, message), = bag[TOPIC]
    assert stamp == bag['/hnn_simulator/q'][-1][0] > 0
    excess = (2.0 * np.maximum(z[-1] - high, low - z[-1]) / (high - low)).max()
    values = values_of(message.status[0])
    assert float(values['value [half-widths]']) == pytest.approx(excess, rel=1e-5)
    assert float(values['t [s]']) == pytest.approx(stamp * 1e-9)
    shown = [(when, text) for when, level, text in events_of(tmp_path / 'picture.rrd')
             if level == 'ERROR']
    assert shown[0] == (stamp, f'out of the training box: {message.status[0].message}')


def test_bag_of_a_run_without_alarm_holds_no_diagnostics(tmp_path):
    assert finish(start(tmp_path, record_path='bag', real_time_factor=0, duration=1))[0] == 0
    assert TOPIC not in read_bag(tmp_path / 'bag')


def fixed(scale: float) -> Callable[[SampleBlock], np.ndarray]:
    """Return a scale that is the same at all samples [J]."""
    return lambda block: np.full(len(block.step), scale)


def simulation_of(hamiltonian: str = 'harmonic_oscillator', method: str = 'variational_euler',
                  q: tuple = (1.0,), p: tuple = (0.0,), effects: tuple = ()) -> Simulation:
    return Simulation(
        HAMILTONIANS[hamiltonian](), INTEGRATORS[method](), 0.01, q, p, effects)


PLACED = [ResolutionGuard, EnergyGuard, CostGuard, BarrierGuard, PoleGuard, RescueGuard]


@pytest.mark.parametrize('simulation, expected', [
    (simulation_of(), PLACED),
    (simulation_of('pendulum'), PLACED),
    (simulation_of('henon_heiles', q=(0.0, 0.1), p=(0.1, 0.0)), PLACED),
    (simulation_of('pendulum', effects=[EFFECTS['damping'](0.1)]),
     [EnergyGuard, CostGuard, RescueGuard]),
    # Gravity beside a pendulum's own moves its separatrix, which is searched for.
    (simulation_of('pendulum', effects=[EFFECTS['gravity']('angle', 1.0, 1.0)]), PLACED),
    (build(load_scene('pendulum')),
     [BoxGuard, ResolutionGuard, EnergyGuard, CostGuard, BarrierGuard, SolutionGuard,
      RescueGuard]),
], ids=['oscillator', 'pendulum', 'henon_heiles', 'damped', 'joined', 'learned'])
def test_guards_are_those_that_the_scene_calls_for(simulation, expected):
    guards = make_guards(RunFacts(simulation))
    assert [type(guard) for guard in guards] == expected


def test_guards_of_the_node_have_the_limits_of_the_study():
    defaults = Settings()
    limits = load_plan().guards
    assert (defaults.energy_band_limit, defaults.energy_change_limit) == (
        limits.under_resolved, limits.drift) == (BAND_LIMIT, CHANGE_LIMIT)


class Parts:
    """A Health whose outlets only note what they are told."""

    def __init__(self, guards: Sequence[Guard] = ()):
        self.published: list[Status] = []
        self.recorded: list[tuple[int, bool]] = []
        self.events: list[tuple[str, str]] = []
        self.lines: list[tuple[str, str]] = []
        # As after a reset at 5 s.
        self.health = Health(lambda step: 5_000_000_000 + step * 10_000_000, guards, self, self,
                             lambda *line: self.lines.append(line))

    def publish(self, statuses: list[Status], stamp: int, record: bool = True) -> None:
        self.published += statuses
        self.recorded.append((stamp, record))

    def event(self, *event: str) -> None:
        self.events.append(event)


def alarm(kind: str, step: int = 1) -> Alarm:
    return Alarm(kind, step, 0.5, 0.25, f'{kind} at {step}', 'J')


def test_health_tells_every_alarm_but_logs_a_kind_only_now_and_then(monkeypatch):
    parts, now = Parts(), 100.0
    monkeypatch.setattr(time, 'monotonic', lambda: now)
    for step in range(1, 6):
        parts.health.add(alarm('under-resolved', step), 10_000_000 * step)
    parts.health.add(alarm('separatrix not resolved'), 60_000_000)
    assert len(parts.published) == len(parts.recorded) == len(parts.events) == 6
    assert parts.recorded[-1] == (60_000_000, True)
    assert [text for text, _ in parts.lines] == [
        'under-resolved: t = 5.01 s: under-resolved at 1',
        'separatrix not resolved: t = 5.01 s: separatrix not resolved at 1']
    now = 111.0
    parts.health.add(alarm('under-resolved', 7), 70_000_000)
    assert len(parts.lines) == 3


def test_health_is_well_and_then_as_bad_as_the_worst_alarm_and_says_its_newest():
    parts = Parts()
    assert parts.health.status()[1:3] == (OK, 'no alarm')
    for kind, step in (('under-resolved', 1), (EnergyGuard.kind, 2), ('under-resolved', 3)):
        parts.health.add(alarm(kind, step), 0)
    status = parts.health.status()
    assert (status.level, status.message) == (ERROR, f'{EnergyGuard.kind} at 2')
    assert status.values['under-resolved: times [1]'] == 2
    assert status.values['under-resolved: step [1]'] == 3
    assert status.values[f'{EnergyGuard.kind}: value [J]'] == 0.5
    assert [told.level for told in parts.published] == [WARN, ERROR, WARN]


def at(q: float, step: int, energy: float = 0.5) -> Sample:
    """Return a sample whose coordinate, step and energy alone matter."""
    return replace(Sampler(simulation_of(), 100.0).sample(), q=np.array([q]), step=step,
                   energy=energy, modified_energy=energy)


def watched(guard: Guard, samples: Sequence[Sample]) -> Parts:
    """Return what was told of samples, the last one being the newest."""
    parts = Parts([guard])
    for sample in samples:
        if (found := alarm_of(guard, sample)) is not None:
            parts.health.add(found, sample.stamp)
    return parts


def test_box_alarm_says_how_far_outside_the_newest_sample_is():
    guard, samples = BoxGuard(BOX), [at(q, step) for step, q in enumerate((0.9, 1.01, 1.5, 1.25))]
    status = watched(guard, samples).health.status(samples[-1])
    assert '0.25 half-widths outside' in status.message
    kind = BoxGuard.kind
    assert status.values[f'{kind}: value [half-widths]'] == pytest.approx(0.25)
    assert (status.values[f'{kind}: step [1]'], status.values[f'{kind}: t [s]']) == (3, '5.03')
    assert status.values[f'{kind}: since [s]'] == '5.01'
    assert status.values[f'{kind}: times [1]'] == 1


def test_box_alarm_that_is_over_says_so_and_how_far_outside_the_state_was():
    samples = [at(q, step) for step, q in enumerate((1.01, 1.5, 0.5))]
    status = watched(BoxGuard(BOX), samples).health.status(samples[-1])
    assert status.level == WARN and status.values[f'{BoxGuard.kind}: value [half-widths]'] == 0.0
    assert 'inside the training domain again, after up to 0.5 half-widths' in status.message


@pytest.mark.parametrize('guard, text', [
    (ResolutionGuard(0.1, fixed(0.5)), 'energy error exceeds 10 % of the energy scale'),
    (BarrierGuard('separatrix', 0.55), 'the energy error is 0.4 J'),
    (EnergyGuard(0.02, fixed(0.02)), 'changed by more than 1000 % of the energy scale')])
def test_alarm_of_energy_has_the_values_of_the_newest_sample(guard, text):
    samples = [at(1.0, step, 0.5 + change) for step, change in enumerate((0.0, 0.25, 0.4))]
    status = watched(guard, samples).health.status(samples[-1])
    assert status.values[f'{guard.kind}: value [J]'] == pytest.approx(0.4)
    assert text in status.message


def test_health_forgets_an_overrun_once_it_is_reported():
    parts = Parts()
    parts.health.add(alarm(OverrunGuard.kind), 0)
    assert parts.health.status().level == WARN
    assert parts.health.status().level == OK


def test_overrun_guard_speaks_once_for_each_overrun():
    now = 0.0
    pacer = Pacer(0.01, 1.0, lambda: now)
    guard = OverrunGuard(pacer)
    sample = Sampler(simulation_of(), 100.0).sample()
    said = []
    for now in (0.5, 1.5, 1.51, 1.52, 3.5, 3.51):
        pacer.due()
        found = guard.update(sample)
        said.append(None if found is None else found.value)
    assert said == [None, 1.0, None, None, 2.0, None]


@pytest.mark.parametrize(('led', 'disk', 'cause'), [
    (True, '', '/clock jumped, for example because of two'),
    (False, '', 'use a lower real_time_factor'),
    (False, 'the disk of /bag takes 2 s for a write', 'the disk of /bag takes 2 s')])
def test_overrun_names_its_cause(led: bool, disk: str, cause: str):
    now = 0.0
    pacer = Pacer(0.01, 1.0, lambda: now, lambda: led)
    guard, now = OverrunGuard(pacer, lambda: disk), 20.0
    pacer.due()
    assert cause in guard.update(Sampler(simulation_of(), 100.0).sample()).message
