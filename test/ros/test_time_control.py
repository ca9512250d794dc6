# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pace, pause, steps by number, reset and /clock of a simulator in another process."""

import json
import math
from pathlib import Path
import re
import signal
import time
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros import load_scene
from hnn_vi_ros.ros.run import control
from hnn_vi_ros.ros.topics.messages import CLOCK_QOS, ClockEncoder
from hnn_vi_ros.run import Pacer
from hnn_vi_ros.simulation import build
import numpy as np
from peer import Peer, peer, simulating, SIMULATOR, stamp, wait_for_way_back
from processes import finish, read_bag, standard_error, start
import pytest
from rclpy.serialization import deserialize_message
from rerun_reader import read
from rosgraph_msgs.msg import Clock
from scene_files import FAILING, write_scene
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

# An implicit method on a learned H, with a drive that depends on time and a heat bath's noise:
# whatever could be forgotten in a reset.
DRIVE = '{kind: periodic_drive, coordinate: angle, amplitude: 0.3, frequency: 0.7}'
BATH = '{kind: thermostat, temperature: 0.5, rate: 1.0, seed: 3}'
TICK, SECOND = 10_000_000, 10**9


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working directory with scenes."""
    # Each step multiplies the energy by 1.04: after 16 s it has changed by ten times its size.
    write_scene(tmp_path / 'coarse.yaml', integrator='explicit_euler', step_size=0.2)
    write_scene(tmp_path / 'driven.yaml', 'hnn, model: pendulum', DRIVE, 'variational_euler',
                0.002)
    write_scene(tmp_path / 'noisy.yaml', effects=BATH)
    (tmp_path / 'failing.yaml').write_text(FAILING)
    return tmp_path


def pace(other: Peer) -> float:
    """Return how fast simulated time has passed for a second [1]."""
    begin, first = time.monotonic(), stamp(other.states[-1])
    other.spin(1.0)
    return (stamp(other.states[-1]) - first) * 1e-9 / (time.monotonic() - begin)


def test_pause_holds_time_is_not_caught_up_with_and_pace_can_be_changed(folder):
    with simulating(folder, scene='driven.yaml') as (other, _):
        other.spin_until(lambda: len(other.states) > 20)
        assert other.pause().success and other.pause().success
        other.spin(0.2)
        last = stamp(other.states[-1])
        other.spin(2.0)
        assert stamp(other.states[-1]) == last
        assert other.pause(False).success
        other.spin_until(lambda: stamp(other.states[-1]) > last)
        begin, first = time.monotonic(), stamp(other.states[-1])
        other.spin(0.5)
        passed = time.monotonic() - begin
        simulated = (stamp(other.states[-1]) - first) * 1e-9
        # Not the 2 s that were missed: at most the second that a late node makes up for.
        assert simulated - passed < 1.5
        stamps = [stamp(message) for message in other.states]
        assert stamps == list(range(stamps[0], stamps[-1] + 1, TICK))
        for factor in (4, 0.5):
            # An integer does for a double.
            assert other.set_parameters(real_time_factor=factor).successful
            other.spin(0.2)
            # Kept as soon as the machine has time.
            other.spin_until(lambda: pace(other) == pytest.approx(factor, rel=0.35))
        assert other.get_parameter('real_time_factor') == 0.5


def test_step_takes_exactly_so_many_steps_and_only_in_a_pause(folder):
    scene = load_scene(folder / 'driven.yaml')
    expected = build(scene)
    with simulating(folder, scene='driven.yaml', start_paused='true', record_path='bag') as (
            other, _):
        other.wait_for_state('active')
        momenta = other.hear(Float64MultiArray, '~/p', 1000)
        other.spin_until(lambda: other.node.count_publishers(f'{SIMULATOR}/p'))
        wait_for_way_back(other.node, other.spin_until, SIMULATOR)
        assert not other.states
        total = 0
        # One step, a part of a tick, a whole one, many; a sample is five steps.
        for count in (1, 2, 2, 7, 5, 1000):
            assert other.set_parameters(step_count=count).successful
            answer = other.trigger('step')
            assert answer.success, answer.message
            total += count
            # What it took and where it stands, whatever another client has set in between.
            assert json.loads(answer.message) == {
                'steps': count, 'step': total, 'time': total * 2_000_000 / 1e9,
                'stamp': total * 2_000_000}
            expected.advance(count)
            other.spin_until(
                lambda: other.states and stamp(other.states[-1]) == total * 2_000_000)
            other.spin_until(lambda: momenta and momenta[-1].data[0] == expected.p[0])
            assert other.states[-1].position[0] == expected.q[0]
        other.spin(0.1)
        assert stamp(other.states[-1]) == total * 2_000_000
        assert other.pause(False).success
        refused = other.trigger('step')
        assert not refused.success and 'only possible while' in refused.message
    recorded = [s for s, _ in read_bag(folder / 'bag')['/hnn_simulator/p']]
    # 1, 3, 5, 12, 17 steps, where requests ended, and every fifth step.
    assert [s // 2_000_000 for s in recorded[:8]] == [1, 3, 5, 10, 12, 15, 17, 20]


def test_end_of_the_process_answers_who_waits_for_steps(folder):
    process = start(folder, scene='driven.yaml', start_paused='true', step_count=10**8)
    with peer() as other:
        other.wait_for_state('active')
        pending = other.call_async(Trigger, 'step')
        # It is being worked on once another is refused.
        other.spin_until(lambda: 'already' in other.trigger('step').message)
        process.send_signal(signal.SIGINT)
        other.spin_until(pending.done, 20.0)
        assert not pending.result().success
        assert pending.result().message.startswith('the run has ended: ')
    assert finish(process)[0] == 0


@pytest.mark.parametrize('scene', ['driven.yaml', 'noisy.yaml'])
def test_reset_repeats_the_run_bit_by_bit_in_a_new_bag(folder, scene):
    with simulating(folder, scene=scene, record_path='bag', real_time_factor=5) as (other, _):
        other.spin_until(lambda: len(other.states) > 160)
        answer = other.trigger('reset')
        assert answer.success, answer.message
        begun, initial = json.loads(answer.message), load_scene(folder / scene).initial_state
        assert (begun['q'], begun['p'], begun['step']) == (initial.q, initial.p, 0)
        assert not begun['reset_time']
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 160)
        # Also in a pause, and with simulated time.
        assert other.pause().success
        assert other.set_parameters(reset_time=True).successful
        assert other.trigger('reset').success
        other.spin(0.2)
        count = len(other.states)
        other.spin(0.2)
        assert len(other.states) == count
        assert other.pause(False).success
        other.spin_until(lambda: len(other.states) > count + 160)
    runs = [read_bag(folder / name) for name in ('bag', 'bag-2', 'bag-3')]
    for topic in ('/hnn_simulator/q', '/hnn_simulator/p', '/hnn_simulator/energy'):
        first, *others = ([np.array(message.data).tolist() for _, message in run[topic]]
                          for run in runs)
        for again in others:
            n = min(len(first), len(again))
            assert n > 150 and first[:n] == again[:n]
    stamps = [[s for s, _ in run['/hnn_simulator/q']] for run in runs]
    # Time goes on in a plain reset, and begins anew where that was asked for.
    assert 0 < stamps[1][0] - stamps[0][-1] <= 2 * TICK
    assert begun['stamp'] == stamps[1][0] - TICK
    assert stamps[0][0] == stamps[2][0] == TICK


def times_told(text: str) -> list[float]:
    """Return the simulated times that a text or the JSON in it names [s]."""
    return [float(found) for pair in re.findall(r't = ([\d.]+) s|"time": ([\d.]+)', text)
            for found in pair if found]


def test_after_a_reset_every_time_that_is_told_is_that_of_the_stamps(folder):
    """In the log, in services' answers, on /diagnostics, in the bag and in the picture."""
    with simulating(folder, scene='coarse.yaml', record_path='bag', rerun_path='picture.rrd',
                    real_time_factor=20, publish_rate=5) as (other, process):
        told = other.hear(DiagnosticArray, '/diagnostics')
        other.spin_until(lambda: other.states and stamp(other.states[-1]) > 20 * SECOND)
        answer = other.trigger('reset')
        origin = round(times_told(answer.message)[0] * SECOND)
        assert origin > 20 * SECOND
        told.clear()
        other.spin_until(lambda: stamp(other.states[-1]) > origin + 18 * SECOND)
        other.spin_until(lambda: len(told) > 2)
        assert times_told(other.pause().message)[0] * SECOND > origin
        other.set_parameters(step_count=3)
        assert times_told(other.trigger('step').message)[0] * SECOND > origin
    error = standard_error(process)
    # On the air: alarms, and how the run does.
    assert {s.name.rpartition(' ')[2] for m in told for s in m.status} >= {'health', 'integrator'}
    for message in told:
        assert message.header.stamp.sec >= origin // SECOND
        for item in (item for status in message.status for item in status.values):
            if item.key.partition(': ')[2] in ('t [s]', 'since [s]') or item.key in (
                    't [s]', 'since [s]', 'simulated_time [s]'):
                assert float(item.value) * SECOND >= origin
    # In the log, where the alarm is told of each run.
    assert [t for t in times_told(error) if t * SECOND > origin]
    # In the bag of the second run, stamped as it is logged.
    stamps = [when for when, _ in read_bag(folder / 'bag-2')['/hnn_simulator/q']]
    alarms = read_bag(folder / 'bag-2')['/diagnostics']
    assert stamps[0] > origin and alarms
    for when, message in alarms:
        # Trials begin at the initial state.
        assert when in (origin, *stamps)
        assert stamp(message) == when
    # In the picture.
    assert min(min(rows['sim_time']) for rows in read(folder / 'picture-2.rrd').values()) >= origin


def test_failure_after_a_reset_is_told_at_the_time_of_the_stamps(folder):
    process = start(folder, scene='failing.yaml', record_path='bag', publish_rate=2.5,
                    real_time_factor=10, start_paused='true', step_count=10)
    with peer() as other:
        other.wait_for_state('active')
        # Refused until the timer runs.
        other.spin_until(lambda: other.trigger('step').success)
        assert other.trigger('reset').success
        assert other.pause(False).success
        status, _, error = finish(process)
    assert status == 1
    # It fails in the 17th step of 0.4 s, which begins after 16 of them; the reset was after 10.
    lines = [line for line in error.splitlines() if '[ERROR]' in line]
    assert len(lines) == 2 and all(set(times_told(line)) == {10.4} for line in lines)
    # Before it comes the alarm that steps are too large.
    when, message = read_bag(folder / 'bag-2')['/diagnostics'][-1]
    assert times_told(message.status[0].message) == [10.4] and when == round(10.4 * SECOND)


def test_run_as_fast_as_possible_answers(folder):
    with simulating(folder, scene='driven.yaml', real_time_factor=0) as (other, _):
        other.wait_for_state('active')
        assert other.pause().success


def test_clock_is_that_of_the_samples_at_100_hz_monotonic_over_a_reset_and_never_zero(folder):
    with simulating(folder, scene='driven.yaml', publish_rate=500, publish_clock='true',
                    real_time_factor=0.5) as (other, _):
        ticks: list[int] = []
        other.node.create_subscription(
            Clock, '/clock', lambda m: ticks.append(m.clock.sec * 10**9 + m.clock.nanosec),
            CLOCK_QOS)
        other.spin_until(lambda: len(ticks) > 50)
        info, = other.node.get_publishers_info_by_topic('/clock')
        assert info.qos_profile.reliability.name == 'BEST_EFFORT'
        assert other.trigger('reset').success
        count = len(ticks)
        other.spin_until(lambda: len(ticks) > count + 50)
        assert ticks[0] > 0
        # Some may be lost on the way, or be replaced by newer ones.
        assert min(np.diff(ticks)) >= TICK and np.median(np.diff(ticks)) <= 2 * TICK
        stamps = {stamp(message) for message in other.states}
        assert len(stamps & set(ticks)) > 50
        assert other.set_parameters(reset_time=True).successful
        assert other.trigger('reset').success
        other.spin_until(lambda: (np.diff(ticks) < 0).sum() == 1)
        other.spin(0.2)
        assert min(ticks) > 0 and (np.diff(ticks) < 0).sum() == 1


def test_duration_counts_simulated_time_without_pauses(folder):
    # Begun by steps, so that no busy machine is through before it is paused.
    process = start(folder, scene='driven.yaml', duration=3, record_path='bag', real_time_factor=2,
                    start_paused='true', step_count=50)
    with peer() as other:
        other.wait_for_state('active')
        other.spin_until(lambda: other.trigger('step').success)
        other.spin(0.5)
        assert process.poll() is None
        other.pause(False)
        other.spin_until(lambda: process.poll() is not None)
    assert finish(process)[0] == 0
    assert [s for s, _ in read_bag(folder / 'bag')['/hnn_simulator/q']] == [
        TICK * tick for tick in range(1, 301)]


def test_pacer_follows_a_clock_that_others_set():
    now = 5.0
    pacer = Pacer(0.01, 1.0, lambda: now, lambda: True)

    def taken() -> int:
        count = 0
        while pacer.due():
            count += 1
        return count

    # Slowly, as fast as the wall, fast, at once; standing; and by sums that are rounded.
    ticks = []
    for advance in (0.001, 0.01, 0.1, 9.0, 0.0):
        begin = now
        counts = []
        for i in range(20 if advance < 1.0 else 1):
            now = begin + (i + 1) * advance
            counts.append(taken())
        ticks.append(sum(counts))
    assert ticks == [2, 20, 200, 900, 0]
    # Back: it goes on from there. Beyond ten seconds forth: one tick, and an overrun.
    now -= 8.0
    assert taken() == 0
    now += 0.05
    assert taken() == 5 and pacer.overruns == 0
    now += 11.0
    assert taken() == 1 and pacer.overruns == 1
    assert pacer.wait == math.inf
    # Steps of 80 ms are eight ticks.
    pacer.restart()
    for _ in range(3):
        now += 0.08
        assert taken() == 8
    assert pacer.burst == pytest.approx(8.0)


def test_pacer_owes_nothing_after_a_pause_and_counts_no_overrun():
    now = 0.0
    pacer = Pacer(0.01, 1.0, lambda: now)
    now = 0.015
    assert pacer.due() and not pacer.due()
    now = 100.0
    pacer.restart()
    assert not pacer.due()
    now = 100.0101
    assert pacer.due() and not pacer.due()
    pacer.set_pace(10.0)
    now += 0.0011
    assert pacer.due() and not pacer.due()
    assert pacer.overruns == 0


def test_pacer_catches_up_with_a_stall_by_ticks_that_are_apart():
    now, taken = 0.0, []
    pacer = Pacer(0.001, 1.0, lambda: now)
    # A stall of ten ticks, in a loop that sleeps as it is told to.
    now = 0.01
    while now < 0.06:
        if pacer.due():
            taken.append(now)
        else:
            now += max(pacer.wait, 0.0) + 1e-7
    gaps = np.diff(taken)
    assert gaps.min() >= 0.00075 and gaps[:30] == pytest.approx(0.00075, abs=1e-6)
    # No tick is lost: those of the first 60 ms are taken, and the last ones in time.
    assert len(taken) == 59 and gaps[-10:] == pytest.approx(0.001, abs=1e-6)


def left_for_others(monkeypatch, phase: float, seconds: float, slow: int) -> tuple[float, bool]:
    """Return the time to the next tick at the end of a call, and whether a slow one ended it."""
    now, taken = 100.0, 0

    def sleep(wait: float) -> None:
        nonlocal now
        # It ends late, as it does.
        now += wait + 6e-5

    def step() -> int:
        nonlocal now, taken
        now += 0.95e-3 if taken == slow else seconds
        taken += 1
        return 1
    pacer = Pacer(0.001, 1.0, lambda: now)
    run = SimpleNamespace(at_sample=True, pacer=pacer, step=step, locked=False,
                          simulation=SimpleNamespace(motors=SimpleNamespace(takes=())))
    monkeypatch.setattr(control, 'time', SimpleNamespace(monotonic=lambda: now, sleep=sleep))
    now += phase
    control.Control._on_timer(SimpleNamespace(active=True, paused=False, run=run))
    return pacer.wait, taken == slow + 1


@pytest.mark.parametrize('seconds', [2e-4, 3.5e-4, 4.5e-4])
def test_executor_has_its_turn_where_a_tick_leaves_time_for_it(monkeypatch, seconds):
    """Whenever the call of the timer begins, and wherever in it a tick is slow."""
    for phase in np.arange(0.0, 1e-3, 1e-4):
        for slow in range(12):
            left, ends_slow = left_for_others(monkeypatch, phase, seconds, slow)
            # All that a tick leaves, but for sleep that ends late.
            assert ends_slow or left > 1e-3 - seconds - 2e-4


def test_clock_throttles_drops_repetitions_and_follows_a_jump_back():
    encoder, stamps = ClockEncoder(), []
    for now in (0, 0, TICK // 2, TICK, TICK, TICK + 1, 2 * TICK, 35_000_000, 4_000_000_001, TICK,
                TICK, 2 * TICK):
        for payload in encoder.encode(SimpleNamespace(stamp=now)):
            clock = deserialize_message(payload, Clock).clock
            stamps.append(clock.sec * 10**9 + clock.nanosec)
    assert stamps == [TICK, 2 * TICK, 35_000_000, 4_000_000_001, TICK, 2 * TICK]
