# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A bag against its own run simulated again, and a run that goes on from a bag."""

from dataclasses import replace
from pathlib import Path
import re

from geometry_msgs.msg import InertiaStamped, WrenchStamped
from hnn_vi_ros import load_scene, Scene
from hnn_vi_ros.commands.scene_tool import main
from hnn_vi_ros.errors import ParameterError, RecordingError
from hnn_vi_ros.files import share_folder
from hnn_vi_ros.kernels import identity
from hnn_vi_ros.learning.data.bag_signals import SignalReader
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.recording.bags.mcap_file import MAGIC
from hnn_vi_ros.run import replay_check
from hnn_vi_ros.ros.replay.picture import write_picture
from hnn_vi_ros.run.recorded_run import CAUSES, RecordedRun, resume
from hnn_vi_ros.run.replay_check import check_replay, check_replays, stamp_gaps, StampGap
from hnn_vi_ros.ros.run.preparation import _continue, _load
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.run import preview_bounds, restore_state, Sampler, STATE_FILE, state_file
from hnn_vi_ros.simulation import build, simulate
from mcap.opcode import Opcode
from messages import assert_message, refused
import numpy as np
from peer import simulating
from processes import finish, refusal, simulator_words, start, start_executable
import pytest
from recorded import as_received, assert_agrees, of_several, record_run, rewritten
from recording.bags.bag_mutations import records_of
import safetensors.numpy
from scene_files import write_scene
from std_msgs.msg import Float64MultiArray

# Learned and exact, implicit, driven in time, with noise, a body that turns, a time in H.
SCENES = ('harmonic_oscillator', 'exact_double_pendulum', 'damped_driven_pendulum',
          'brownian_oscillator', 'free_rigid_body', 'driven_duffing')


@pytest.mark.parametrize('name', SCENES)
def test_bag_agrees_bit_by_bit_with_its_run_simulated_again(tmp_path, name):
    bag = record_run(tmp_path / 'bag', load_scene(name), 100, rate=50.0)
    assert RecordedRun(bag).reader.metadata('hnn_vi_ros') == identity()
    assert_agrees(bag, 100)


def test_energy_by_cause_in_a_bag_is_that_of_simulate_and_is_verified_bit_by_bit(tmp_path):
    scene = load_scene('exact_damped_driven_pendulum').changed({'energy_by_cause': True})
    bag = record_run(tmp_path / 'bag', scene, 50)
    verdict = check_replay(bag)
    assert verdict.good and 'the energy by cause, of 50 samples' in verdict.text, verdict.text
    causes = simulate(scene, 0.5, every=round(0.01 / scene.step_size)).energy_by_cause
    recorded = np.array([values[CAUSES] for _, values in RecordedRun(bag).reported()])
    assert np.array_equal(recorded, causes.values[1:])
    wrong = record_run(tmp_path / 'wrong', scene, 50, change=lambda sample: replace(
        sample, causes=sample.causes + 0.1 * (sample.step > 20)))
    verdict = check_replay(wrong)
    assert not verdict.good and f'{CAUSES} of {causes.names[0]} differs' in verdict.text
    # The run that it would go on from did not account for it.
    plain = record_run(tmp_path / 'plain', load_scene('exact_pendulum'), 5)
    with refused(ParameterError):
        _load(Settings(resume=str(plain), energy_by_cause=True), False)


# Implicit, with noise and a watchdog: four steps from sample to sample, 20 to a time-out.
DRIVEN = ('{kind: external_force, coordinates: [angle1], timeout: 0.05}, '
          '{kind: thermostat, temperature: 0.1, rate: 1.0, seed: 3}')
# Before the first step, at a sample, between two, two at once, and after the watchdog's end.
COMMANDS = {0: [[0.5]], 40: [[1.0]], 57: [[-1.0], [2.0]], 58: [[1.5]], 159: [[-0.5]],
            160: [[0.25]], 203: [[3.0]]}


@pytest.fixture(scope='module')
def driven(tmp_path_factory):
    return load_scene(write_scene(
        tmp_path_factory.mktemp('driven') / 'driven.yaml', 'double_pendulum', DRIVEN,
        step_size=0.0025, q=[1.0, 0.5], p=[0.0, 0.0]))


@pytest.mark.parametrize('begin', [None, 30])
def test_run_from_an_initial_command_agrees_bit_by_bit(tmp_path, driven, begin):
    force = {'kind': 'external_force', 'coordinates': ['angle1'], 'timeout': 0.05,
             'initial': [0.7]}
    bag = record_run(tmp_path / 'bag', driven.changed({'effects': [force]}), 100,
                     commands={80: [[-1.0]]}, begin=begin)
    assert_agrees(bag)
    # Its topics do not hold that force.
    assert SignalReader(bag, ['angle1', 'angle2']).commanded_before


@pytest.mark.parametrize('begin', [None, 33])
@pytest.mark.parametrize('name', ['exact_damped_driven_pendulum', 'exact_double_pendulum'])
def test_run_of_dop853_agrees_bit_by_bit_also_from_inside_an_internal_step(tmp_path, name, begin):
    pair = {'kind': 'dop853', 'relative_tolerance': 1e-5, 'absolute_tolerance': 1e-5}
    scene = load_scene(name).changed({'integrator': pair})
    assert_agrees(record_run(tmp_path / 'bag', scene, 100, begin=begin))
    force = {'kind': 'external_force', 'timeout': 0.05,
             'coordinates': [build(scene).hamiltonian.coordinates[0].name]}
    driven = scene.changed({'effects': [force]})
    assert_agrees(record_run(tmp_path / 'driven', driven, 100, commands={
        20: [[0.5]], 30: [[1.0]], 41: [[-1.0]]}, begin=begin))


@pytest.mark.parametrize('begin', [None, 33])
def test_payloads_and_wrenches_act_again_bit_by_bit(tmp_path, begin):
    arm = load_scene('six_joint_arm')
    names = [one.name for one in build(arm).hamiltonian.coordinates]
    scene = arm.changed({
        'hamiltonian': arm.hamiltonian.model_dump(exclude_none=True) | {
            'payload': {'link': 'flange'}},
        'energy_by_cause': True,
        'effects': [{'kind': 'external_force', 'coordinates': names,
                     'gravity_compensation': 'model'}, {'kind': 'link_wrench', 'timeout': 0.1}]})
    load, push = InertiaStamped(), WrenchStamped()
    load.header.frame_id, load.inertia.m, load.inertia.com.z = 'flange', 1.5, 0.1
    push.header.frame_id, push.wrench.force.x, push.wrench.torque.y = 'base/tool', 20.0, 2.0
    bag = record_run(tmp_path / 'bag', scene, 100, commands={
        20: [push], 40: [load], 60: [push]}, begin=begin)
    assert_agrees(bag)
    *_, (_, last) = RecordedRun(bag).reported()
    # The arm moves when the payload comes: its energy jumps, which is the work of that cause.
    ledger = build(scene).ledger
    assert abs(last[CAUSES][ledger.names.index('work/payload')]) > 0.01
    assert abs(last[CAUSES][ledger.names.index('work/link_wrench')]) > 0.01


def test_bag_without_samples_is_not_confirmed_and_says_why(tmp_path, driven):
    verdict = check_replay(record_run(tmp_path / 'bag', driven, 0))
    assert not verdict.good
    assert verdict.text.endswith('bag_0.mcap: contains no samples to compare'), verdict.text


@pytest.mark.parametrize('begin, samples', [
    (None, 100), (0, 100), (40, 90), (60, 85), (62, 85)])
def test_driven_run_agrees_bit_by_bit_also_from_a_bag_begun_while_a_command_is_held(
        tmp_path, driven, begin, samples):
    # At step 60 the one of step 58 is held until step 78; solver and bath have a history. At
    # steps 0 and 40 a command was heard before the bag was asked for, at 0 with no other history.
    assert_agrees(
        record_run(tmp_path / 'bag', driven, 100, commands=COMMANDS, begin=begin), samples)


def test_negative_zero_of_an_initial_state_keeps_its_sign(tmp_path):
    # p - h 0.0 keeps it.
    scene = load_scene('exact_pendulum').changed(
        {'initial_state': {'q': [0.0], 'p': [-0.0]}})
    for begin in (None, 3):
        assert_agrees(record_run(tmp_path / f'bag{begin}', scene, 5, begin=begin))


def test_driven_run_whose_commands_are_gone_is_not_certified(tmp_path, driven):
    bag = record_run(tmp_path / 'bag', driven, 100, commands=COMMANDS)
    verdict = check_replay(as_received(bag, tmp_path / 'a.mcap', without=['commands']))
    assert not verdict.good and 'the log does not contain the steps' in verdict.text
    # At which step those acted that came at some time of another clock is not known either.
    assert not check_replay(as_received(bag, tmp_path / 'b.mcap')).good


def test_bag_of_another_recorder_is_verified_and_resumed_by_its_scene_topic(tmp_path):
    scene = load_scene('harmonic_oscillator')
    own = record_run(tmp_path / 'bag', scene, 100)
    bag = as_received(own, tmp_path / 'a.mcap')
    verdict = check_replay(bag)
    assert '100 samples are bit-identical' in verdict.text, verdict.text
    there, here = resume(bag), resume(own)
    assert there.scene.model_dump() == here.scene.model_dump()
    assert (there.step, there.origin) == (here.step, here.origin)


@pytest.fixture(scope='module')
def three(tmp_path_factory, driven):
    """Return a bag of three simulators: a driven one, one whose log was changed, another one."""
    folder = tmp_path_factory.mktemp('three')
    return of_several(
        folder / 'three.mcap', left=record_run(folder / 'left', driven, 100, commands=COMMANDS),
        middle=record_run(folder / 'middle', load_scene('exact_pendulum'), 50,
                          change=lambda sample: replace(sample, q=sample.q + 1e-9)),
        right=record_run(folder / 'right', load_scene('exact_harmonic_oscillator'), 70))


def test_each_simulator_of_a_bag_is_checked_and_named(three):
    verdicts = [*check_replays(three)]
    assert [verdict.good for verdict in verdicts] == [True, False, True]
    for verdict, name, words in zip(verdicts, ('left', 'middle', 'right'), (
            'q, p, dp/dt, H and work of 100 samples are bit-identical',
            'q of angle differs at t = 0.01 s',
            'q, p, dp/dt, H and work of 70 samples are bit-identical'), strict=True):
        assert verdict.text.startswith(f'/{name}/hnn_simulator: {three}: ')
        assert words in verdict.text


def test_one_simulator_of_a_bag_is_chosen_by_its_name(three):
    for name in ('/right/hnn_simulator', 'right/hnn_simulator'):
        verdict, = check_replays(three, node=name)
        assert verdict.good and '70 samples' in verdict.text
    with refused(RecordingError):
        [*check_replays(three, node='rihgt/hnn_simulator')]


def test_run_of_one_of_several_simulators_is_not_resumed_by_chance(three):
    with refused(RecordingError):
        resume(three)


def test_fault_of_one_simulator_does_not_keep_others_from_being_checked(tmp_path, driven):
    bags = {name: record_run(tmp_path / name, load_scene('exact_pendulum'), 5, **more)
            for name, more in (('left', {'origin': -1}), ('right', {}))}
    verdicts = [*check_replays(of_several(tmp_path / 'two.mcap', **bags))]
    assert [verdict.good for verdict in verdicts] == [False, True]
    assert 'origin is not a valid count' in verdicts[0].text


def test_bag_of_another_recorder_that_lacks_a_topic_is_one_line(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 5)
    for without in (['scene'], ['state']):
        with refused(RecordingError):
            check_replay(as_received(bag, tmp_path / 'a.mcap', without=without))


def test_state_that_is_not_of_the_simulation_is_refused_and_changes_nothing():
    simulation = build(load_scene('exact_pendulum'))
    good = safetensors.numpy.load(state_file(simulation))
    states = [good | change for change in (
        {'steps': np.zeros(3)}, {'way': np.array(7)}, {'way': np.array(-1)},
        {'steps': np.array(-1)})]
    states.append({name: value for name, value in good.items() if name != 'steps'})
    for data in (*map(safetensors.numpy.save, states), b'', bytes(100)):
        with refused(RecordingError):
            restore_state(simulation, data, 'bag')
    assert simulation.steps == 0


def test_bags_of_a_commanded_simulator_agree_bit_by_bit_whenever_they_were_begun(
        tmp_path: Path, driven):
    with simulating(tmp_path, scene=driven.source, record_path='bag') as (other, _):
        publisher = other.publisher(Float64MultiArray, '~/commands', 10)
        other.spin_until(lambda: other.states and publisher.get_subscription_count())

        def drive(count: int) -> None:
            for i in range(count):
                seen = len(other.states)
                publisher.publish(Float64MultiArray(data=[(-1.0)**i]))
                # Now and then for longer than the watchdog allows; on a machine that is busy for
                # as long as it takes the simulator, whose queue is short, to come to it.
                other.spin(0.1 if i % 7 == 0 else 0.007)
                other.spin_until(lambda before=seen: len(other.states) > before)

        drive(30)
        assert other.trigger('stop_recording').success
        drive(5)
        assert other.trigger('start_recording').success
        drive(30)
        assert other.trigger('reset').success
        drive(20)
    for name in ('bag', 'bag-2', 'bag-3'):
        assert len(list(RecordedRun(tmp_path / name).commands())) > 10
        assert_agrees(tmp_path / name)


def shift(stamp: int, size: float):
    """Return what changes the last coordinate from a stamp on, as another path would."""
    def change(sample):
        if sample.stamp >= stamp:
            sample.q[-1] += size * max(1.0, abs(sample.q[-1]))
        return sample
    return change


@pytest.fixture
def elsewhere(monkeypatch):
    """Let this machine be another than that of the logs."""
    monkeypatch.setattr(replay_check, 'identity', lambda: identity() | {'processor': 'another'})


def test_difference_on_the_same_machine_is_named_and_not_good(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_double_pendulum'), 100,
                     change=shift(500_000_000, 1e-15))
    verdict = check_replay(bag)
    assert not verdict.good and '\n' not in verdict.text
    for words in ('49 samples are bit-identical', ' differs at t = 0.5 s by ',
                  'within what round-off explains'):
        assert words in verdict.text


@pytest.mark.parametrize('size, within', [(1e-15, True), (1e-9, False)])
def test_difference_elsewhere_is_good_within_round_off_alone(tmp_path, elsewhere, size, within):
    bag = record_run(tmp_path / 'bag', load_scene('exact_double_pendulum'), 100,
                     change=shift(500_000_000, size))
    verdict = check_replay(bag)
    assert verdict.good == within
    assert ('is within' if within else 'is beyond') in verdict.text
    assert f'processor is {identity()["processor"]}' in verdict.text


@pytest.mark.parametrize('name, change', [
    ('H', lambda sample: replace(sample, energy=np.nextafter(sample.energy, 9.0))),
    ('work', lambda sample: replace(sample, work=np.nextafter(sample.work, 9.0))),
    ('dp/dt of angle', lambda sample: replace(sample, dH_dq=np.nextafter(sample.dH_dq, 9.0)))])
def test_change_of_the_last_bit_of_what_the_state_tells_beside_q_and_p_is_named(
        tmp_path, name, change):
    bag = record_run(tmp_path / 'bag', load_scene('exact_damped_driven_pendulum'), 20,
                     change=lambda sample: change(sample) if sample.stamp == 10**8 else sample)
    verdict = check_replay(bag)
    assert not verdict.good
    assert ' 9 samples are bit-identical, on' in verdict.text
    assert f'then {name} differs at t = 0.1 s by ' in verdict.text


@pytest.mark.parametrize('scene', ['exact_damped_driven_pendulum', 'exact_double_pendulum'])
@pytest.mark.parametrize('name', ['energy', 'work', 'dH_dq'])
def test_energy_work_and_force_are_good_elsewhere_within_round_off_alone(
        tmp_path, elsewhere, scene, name):
    for size, within in ((1e-14, True), (1e-7, False)):
        bag = record_run(tmp_path / f'bag{within}', load_scene(scene), 20, change=lambda sample:
                         replace(sample, **{name: getattr(sample, name) + size}))
        verdict = check_replay(bag)
        assert verdict.good == within, verdict.text


def test_round_off_of_H_elsewhere_is_of_its_terms_not_of_their_sum(tmp_path, elsewhere):
    # q^2 / 2, with terms of 5e5 J that have a round-off of 6e-11 J each.
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x'],
                     'H': '(x + 1000)^2/2 - 1000*x - 500000 + p_x^2/2'},
        integrator='stormer_verlet', step_size=0.01, initial_state=([0.7], [0.3]))
    for size, within in ((1e-10, True), (1e-7, False)):
        bag = record_run(tmp_path / f'bag{within}', scene, 20, change=lambda sample:
                         replace(sample, energy=sample.energy + size))
        verdict = check_replay(bag)
        assert verdict.good == within, verdict.text


def test_sample_that_is_no_number_is_not_explained_by_round_off(tmp_path, elsewhere):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 20,
                     change=shift(10**8, np.nan))
    verdict = check_replay(bag)
    assert not verdict.good and 'is beyond' in verdict.text


@pytest.mark.parametrize('begin', [None, 62])
def test_bag_without_its_first_samples_is_not_certified(tmp_path, driven, begin):
    bag = record_run(tmp_path / 'bag', driven, 100, begin=begin)
    assert_agrees(bag)
    own = RecordedRun(bag).reader
    verdict = check_replay(
        rewritten(own, tmp_path / 'a.mcap', lambda message: message.time > 5 * 10**8))
    assert not verdict.good and 'samples are missing in 1 gaps' in verdict.text


def test_samples_that_are_there_twice_are_named_and_not_confirmed(tmp_path):
    reader = RecordedRun(record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 40)).reader
    bag = rewritten(reader, tmp_path / 'a.mcap', times=lambda message: 1 + (
        2 * 10**8 <= message.time < 3 * 10**8))
    verdict = check_replay(bag)
    assert not verdict.good
    assert ' of 40 samples are bit-identical' in verdict.text
    assert 'BUT 10 samples are duplicates, the first at t = 0.2 s' in verdict.text


@pytest.mark.parametrize('keep', ['summary', 'metadata.yaml'])
def test_last_chunk_that_is_cut_out_is_missed_by_what_counts_it(tmp_path, monkeypatch, keep):
    monkeypatch.setattr('hnn_vi_ros.recording.bags.mcap_sink.CHUNK_SIZE', 2**13)
    path = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 100) / 'bag_0.mcap'
    records = records_of(path.read_bytes())
    last = max(i for i, record in enumerate(records) if record[0] == Opcode.CHUNK)
    end = next(i for i in range(last, len(records)) if records[i][0] == Opcode.METADATA)
    if keep == 'summary':
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    path.write_bytes(MAGIC + b''.join(records[:last] + records[end:] * (keep == 'summary')))
    verdict = check_replay(tmp_path / 'bag')
    assert not verdict.good
    assert 'samples are bit-identical' in verdict.text and f'{keep} ' in verdict.text
    assert re.search(r'contains \d+ messages, but its .* counts? 501', verdict.text)


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', b'\0\1\0\0\xff\xff\xff\x7fabc'])
@pytest.mark.parametrize('topic', ['scene', 'commands'])
def test_message_that_is_none_of_its_type_is_one_line(tmp_path, driven, topic, data):
    reader = RecordedRun(record_run(tmp_path / 'bag', driven, 5, commands=COMMANDS)).reader
    numbers = [n for n, c in reader.channels.items() if c.topic.endswith(topic)]
    bag = rewritten(reader, tmp_path / 'a.mcap', own=topic == 'commands', change=lambda message:
                    message._replace(data=data) if message.channel in numbers else message)
    with refused(RecordingError):
        check_replay(bag)


def test_agreement_elsewhere_says_so(tmp_path, elsewhere):
    verdict = check_replay(record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 20))
    assert verdict.good and 'other than those of the log' in verdict.text


@pytest.mark.parametrize('scene, described', [
    ('harmonic_oscillator', {'model_sha256': 'another'}),
    ('exact_pendulum', {'origin': 1}), ('exact_pendulum', {'step_size': 1e-11}),
    ('exact_pendulum', {'step_size': 1e-300}), ('exact_pendulum', {'step_size': 5e-324})])
def test_log_of_another_model_of_no_whole_steps_or_of_too_many_is_refused(
        tmp_path, scene, described):
    with refused(RecordingError):
        check_replay(record_run(tmp_path / 'bag', load_scene(scene), 5, **described))


def test_steps_of_next_to_no_time_are_one_line_to_node_and_picture(tmp_path, monkeypatch):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 5, step_size=5e-324)
    run = RecordedRun(bag)
    with refused(ParameterError):
        Sampler(build(run.scene), 100.0)
    with refused(RecordingError):
        write_picture(bag, tmp_path / 'a.rrd')
    monkeypatch.setattr(BagReader, 'attachment', lambda self, name: b'publish_rate: 100.0')
    with refused(RecordingError):
        run.spacing  # noqa: B018  refused when it is read


@pytest.mark.parametrize('rate', [
    '1.0e-300', '1.0e-12', '5.0e-324', '.inf', '.nan', '-1.0', 'often', '[]'])
def test_rate_in_a_bag_that_is_none_is_one_line(tmp_path, monkeypatch, rate):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 5)
    attachment = BagReader.attachment
    monkeypatch.setattr(BagReader, 'attachment', lambda self, name: (
        f'publish_rate: {rate}'.encode() if name == 'parameters.yaml' else attachment(self, name)))
    with refused(RecordingError):
        check_replay(bag)


def test_state_of_a_step_beyond_all_stamps_is_one_line(tmp_path):
    scene = load_scene('exact_pendulum')
    run = RecordedRun(record_run(tmp_path / 'bag', scene, 5, begin=3))
    state = safetensors.numpy.load(run.reader.attachment(STATE_FILE))
    state['steps'] = np.array(2**62)
    bag = rewritten(run.reader, tmp_path / 'a.mcap',
                    files={STATE_FILE: safetensors.numpy.save(state)})
    with refused(RecordingError):
        check_replay(bag)
    nothing = rewritten(run.reader, tmp_path / 'b.mcap', lambda message: not message.time,
                        files={STATE_FILE: safetensors.numpy.save(state)})
    assert not check_replay(nothing).good


@pytest.mark.parametrize('name', ['exact_double_pendulum', 'exact_damped_driven_pendulum'])
def test_run_resumed_from_a_log_goes_on_as_the_unbroken_one(tmp_path, name):
    scene = load_scene(name)
    whole = record_run(tmp_path / 'whole', scene, 200)
    bag = record_run(tmp_path / 'bag', scene, 100, close=False)
    resumption = resume(bag)
    simulation = build(resumption.scene)
    simulation.restart(simulation.q.copy(), simulation.p.copy(), step=resumption.step)
    run = RecordedRun(whole)
    samples = list(run.samples())
    assert resumption.step == run.step_of(samples[99][0]) == simulation.steps
    assert np.array_equal(simulation.q, samples[99][1])
    assert np.array_equal(simulation.p, samples[99][2])
    for stamp, q, p in samples[100:]:
        simulation.advance(run.step_of(stamp) - simulation.steps)
        # No solver memory is kept: equal to the implicit equation's round-off, which grows.
        assert np.allclose(simulation.q, q, rtol=0.0, atol=1e-10)
        assert np.allclose(simulation.p, p, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize('name', [
    'exact_double_pendulum', 'exact_damped_driven_pendulum', 'brownian_oscillator',
    'bouncing_mass'])
def test_run_resumed_from_a_closed_log_has_the_bits_of_the_unbroken_one(tmp_path, name):
    """Its work and its energy error go on as well."""
    scene = load_scene(name).changed({'energy_by_cause': True})
    whole = build(scene)
    whole.advance(150)
    record_run(tmp_path / 'bag', scene, 100, rate=1.0 / scene.step_size)
    found_scene, found = _load(Settings(resume=str(tmp_path / 'bag')), False)
    simulation = build(found_scene)
    line, = _continue(simulation, found_scene, found, 'bag')
    assert line.text == f'resumed bag at t = {100 * scene.step_size:g} s from its complete state'
    preview_bounds(simulation, 1.0)
    simulation.advance(50)
    own, other = (Sampler(one, 1.0 / scene.step_size).sample() for one in (simulation, whole))
    for field in ('step', 'q', 'p', 'dH_dq', 'energy', 'energy_error', 'work', 'causes'):
        assert np.array_equal(getattr(own, field), getattr(other, field)), field


def test_log_is_resumed_with_other_effects(tmp_path):
    """The scene that is written of it is the recorded one, until its effects are changed."""
    scene, bag = load_scene('exact_damped_driven_pendulum'), tmp_path / 'bag'
    record_run(bag, scene, 100)
    file = tmp_path / 'scene.yaml'
    assert main(['--new', str(file), '--like', str(bag)]) == 0
    assert load_scene(file).model_dump() == scene.model_dump()
    file.write_text(file.read_text().replace('effects:', 'effects:\n- {kind: gravity, '
                                             'coordinate: angle}'))
    written, found = _load(Settings(resume=str(bag), scene=str(file)), False)
    assert next(effect.kind for effect in written.effects) == 'gravity'
    simulation = build(written)
    line, = _continue(simulation, written, found, 'bag')
    last = [*RecordedRun(bag).samples()][-1]
    assert line.text.endswith(' from q and p alone') and np.array_equal(simulation.q, last[1])
    with refused(ParameterError):
        _load(Settings(resume=str(bag), scene='exact_double_pendulum'), False)
    with refused(RecordingError):
        main(['--new', str(file), '--force', '--like', str(tmp_path / 'none.mcap')])


def test_resumed_log_is_verified_from_its_own_first_step(tmp_path):
    scene = load_scene('exact_damped_driven_pendulum')
    resumption = resume(record_run(tmp_path / 'bag', scene, 100))
    second = record_run(tmp_path / 'second', resumption.scene, 50, first_step=resumption.step)
    assert_agrees(second, 50)
    assert resume(second).step == resumption.step + 50 * resumption.step // 100
    # As if the first step were forgotten: the drive would be out of step.
    with refused(RecordingError):
        check_replay(record_run(tmp_path / 'third', resumption.scene, 5,
                                first_step=resumption.step, origin=10**12))


def test_simulator_resumes_a_bag_or_refuses_in_one_line(tmp_path, monkeypatch):
    given = {'scene': 'harmonic_oscillator', 'resume': 'bag', 'duration': 1}
    record_run(tmp_path / 'bag', load_scene('harmonic_oscillator'), 100)
    assert finish(start(tmp_path, real_time_factor=0, record_path='second', **given))[0] == 0
    assert RecordedRun(tmp_path / 'second').first_step == 100
    assert_agrees(tmp_path / 'second', 100)
    monkeypatch.chdir(tmp_path)
    for wrong in ({'step_size': 0.02}, {'integrator': 'gauss4'}, {'resume': 'nowhere'}):
        assert_message(refusal('simulator', *simulator_words(**given | wrong)))


def test_bag_without_states_or_scene_cannot_be_resumed(tmp_path):
    for bag in (tmp_path / 'nothing', tmp_path):
        with refused(RecordingError):
            resume(bag)


def test_verify_option_tells_the_verdict_and_its_status(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 20)
    status, out, error = finish(start_executable('replay', bag, '--verify'), 120.0)
    assert (status, error) == (0, '')
    assert '20 samples are bit-identical' in out


def test_verify_option_refuses_what_only_playing_heeds(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 5)
    for words in (['--rate', '2'], ['--loop'], ['--publish-clock'],
                  ['--ros-args', '-p', 'rate:=2.0']):
        assert_message(refusal('replay', bag, '--verify', *words))


# Bags that an earlier version recorded; see test/fixtures/README.md.

RECORDED = Path(__file__).resolve().parents[1] / 'fixtures' / 'recorded'
BAGS = sorted(path.parent for path in RECORDED.glob('*/metadata.yaml'))
# What bits depend on, when the sources are meant to compute the same.
BITS = ('numpy', 'numba', 'llvmlite', 'machine', 'processor', 'processor_features')
SAMPLES = {'servo_arm': 37}


def test_bags_are_those_of_ten_scenes():
    assert [bag.name for bag in BAGS] == [
        'bouncing_mass', 'brownian_oscillator', 'damped_driven_pendulum', 'emps_drive',
        'heavy_top', 'pendulum', 'servo_arm', 'six_joint_arm', 'spherical_pendulum', 'twin_arm']
    assert RecordedRun(RECORDED / 'damped_driven_pendulum').first_step == 50
    heard = {topic.rpartition('/')[2] for name in ('servo_arm', 'twin_arm')
             for _, topic, _ in RecordedRun(RECORDED / name).commands()}
    assert heard == {'commands', 'joint_commands', 'joint_trajectory', 'observations'}


@pytest.mark.parametrize('bag', BAGS, ids=lambda bag: bag.name)
def test_recorded_bag_is_had_again_bit_by_bit(bag, tmp_path, monkeypatch):
    # Elsewhere than the bag, with the robots that are installed with the package.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(share_folder().parents[1]))
    verdict = check_replay(bag)
    assert verdict.good, verdict.text
    there, here = BagReader(bag).metadata('hnn_vi_ros'), identity()
    if all(there[name] == here[name] for name in BITS):
        # Other sources alone would let replay explain a difference by round-off.
        assert f' of {SAMPLES.get(bag.name, 50)} samples are bit-identical' in verdict.text
        assert '; then ' not in verdict.text


# Gaps among stamps that come evenly, and none where they do not.

TICK = 10_000_000
GRID = [TICK * i for i in range(100)]


def test_missing_stamps_are_counted_where_they_are_missing():
    stamps = [stamp for stamp in GRID if not 30 * TICK <= stamp < 50 * TICK and stamp != 70 * TICK]
    assert stamp_gaps(stamps[::-1]) == [
        StampGap(29 * TICK, 50 * TICK, 20), StampGap(69 * TICK, 71 * TICK, 1)]


def test_stamps_that_are_rounded_to_nanoseconds_are_even():
    stamps = [round(i * 10**9 / 3) for i in range(300)]
    assert stamp_gaps(stamps) == []
    del stamps[100:110]
    assert [gap.count for gap in stamp_gaps(stamps)] == [10]


@pytest.mark.parametrize('stamps', [
    [], [5], [1, 2, 50], sorted([*GRID, 31 * TICK + 7, 31 * TICK + 9]),
    np.cumsum(np.random.default_rng(1).uniform(0.5e9, 3e9, 300)).astype(int).tolist(),
], ids=['none', 'one', 'few', 'single steps in a pause', 'wall time'])
def test_stamps_without_a_grid_or_with_more_have_no_gaps(stamps):
    assert stamp_gaps(stamps) == []
