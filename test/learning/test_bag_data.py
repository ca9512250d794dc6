# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Data from bags: the states of recorded motions, and one line for what cannot be used."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from bag_files import ARRAY, array, JOINTS, Message, state, write
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning import read_motions
from hnn_vi_ros.learning.data.bags import BagData, BagMotions
from hnn_vi_ros.learning.data.dataset import BLOCKS, Dataset
from hnn_vi_ros.learning.data.sources import configuration_of, make_dataset
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models import load_checkpoint, NeuralHamiltonian
from hnn_vi_ros.run.recorded_run import RecordedRun
from hnn_vi_ros.scene import load_scene
from messages import misfit, refused
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros.recorded import as_received, record_run
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

OMEGA, MASS = 2.0, 3.0
T = 0.01 * np.arange(1, 501)
DERIVATIVES = {'kind': 'savitzky_golay', 'window': 0.09, 'degree': 4}


def bag(**changes) -> BagData:
    return BagData.model_validate({
        'kind': 'bag', 'joints': ['swing'], 'derivatives': DERIVATIVES, **changes})


def dataset(paths: list[Path], data: BagData) -> Dataset:
    return make_dataset(data, 0, Path(), paths)


def joints(t: np.ndarray, velocity: bool = True, topic: str = '/joint_states',
           amplitude: float = 1.0) -> list[Message]:
    """Return an oscillation as joint states of two joints, the second at rest."""
    return [state(time, ['rest', 'swing'], [0.0, amplitude * np.sin(OMEGA * time)],
                  [0.0, amplitude * OMEGA * np.cos(OMEGA * time)] if velocity else [],
                  topic=topic) for time in t]


def assert_oscillates(data, tolerance: float, mass: float = MASS) -> None:
    q, v = np.sin(OMEGA * data.t), OMEGA * np.cos(OMEGA * data.t)
    for found, expected in ((data.q, q), (data.dq_dt, v), (data.p, mass * v),
                            (data.dp_dt, -mass * OMEGA**2 * q),
                            (data.accelerations, -OMEGA**2 * q)):
        assert np.abs(found[:, 0] - expected).max() < tolerance


def shifted(data, first: float):
    """Let times begin at the first message, as in a bag."""
    return replace(data, t=data.t + first)


# A polynomial of degree 4 in a window of 0.09 s: h^4 times the fifth derivative, some 1e-4.
TOLERANCE = 1e-3


def test_joint_states_and_a_mass_give_momenta_and_rates(tmp_path):
    path = write(tmp_path / 'a.mcap', joints(T))
    data = dataset([path], bag(mass=[MASS]))
    assert_oscillates(shifted(data, T[0]), TOLERANCE)
    assert 'a (480 samples, sha256 ' in data.description
    assert len(np.unique(data.block)) == BLOCKS
    assert (data.trajectory == 0).all()


def test_velocities_that_are_not_recorded_are_estimated(tmp_path):
    recorded = dataset([write(tmp_path / 'a.mcap', joints(T))], bag(mass=[MASS]))
    for more in ({}, {'estimate_velocity': True}):
        path = write(tmp_path / f'b{len(more)}.mcap', joints(T, velocity=bool(more)))
        estimated = dataset([path], bag(mass=[MASS], **more))
        assert_oscillates(shifted(estimated, T[0]), 10.0 * TOLERANCE)
        assert not np.array_equal(estimated.dq_dt, recorded.dq_dt)


def test_arrays_at_other_times_are_brought_to_common_even_ones(tmp_path):
    rng = np.random.default_rng(2)
    uneven, other = np.sort(rng.uniform(0.0, 5.0, 800)), np.linspace(0.1, 4.9, 300)
    path = write(tmp_path / 'a.mcap', [
        *array(uneven, np.stack([uneven, np.sin(OMEGA * uneven)], axis=-1), '/robot/q'),
        *array(other, np.stack([other, MASS * OMEGA * np.cos(OMEGA * other)], axis=-1),
               '/robot/p')])
    data = dataset([path], bag(q='q', p='/robot/p', columns=[1], spacing=0.01))
    assert np.allclose(np.diff(data.t), 0.01, rtol=1e-9)
    # 0.1 s less than ten rows from the first message of q.
    assert_oscillates(shifted(data, uneven[0]), TOLERANCE)
    assert len(data.windows(0.02, 3)) == len(data.t) - 4


def test_stamps_of_headers_count_unless_the_log_is_asked_for(tmp_path):
    jitter = np.random.default_rng(1).uniform(0.0, 0.004, len(T))
    late = [(topic, kind, time + late, data) for (topic, kind, time, data), late
            in zip(joints(T), jitter, strict=True)]
    path = write(tmp_path / 'a.mcap', late)
    assert_oscillates(shifted(dataset([path], bag(mass=[MASS])), T[0]), TOLERANCE)
    by_log = dataset([path], bag(mass=[MASS], stamps='log'))
    assert np.abs(by_log.t[0] - T[10]) > 1e-4


def test_nothing_is_made_up_where_one_topic_has_a_gap(tmp_path):
    some = T[(T < 1.5) | (T > 3.0)]
    path = write(tmp_path / 'a.mcap', sorted([
        *joints(T), *array(some, MASS * OMEGA * np.cos(OMEGA * some), '/p')],
        key=lambda message: message[2]))
    data = shifted(dataset([path], bag(p='p')), T[0])
    assert not ((data.t > 1.5) & (data.t < 3.0)).any()
    assert set(data.trajectory) == {0, 1}
    assert set(data.block[data.trajectory == 0]).isdisjoint(data.block[data.trajectory == 1])
    assert_oscillates(data, TOLERANCE)


def test_several_bags_are_joined_and_split_by_blocks_of_time(tmp_path):
    paths = [write(tmp_path / f'{i}.mcap', joints(T, amplitude=1.0 + i)) for i in range(2)]
    data = dataset(paths, bag(block=0.5))
    assert len(data.q) == 960 and set(data.trajectory) == {0, 1}
    assert len(np.unique(data.block)) == 20
    train, validation = data.split(0.2, seed=3)
    assert len(np.unique(validation.block)) == 4
    assert set(train.block).isdisjoint(validation.block)
    assert data.description.startswith('0, 1 (960 samples')


def test_topic_without_a_slash_at_the_start_is_the_same(tmp_path):
    path = write(tmp_path / 'a.mcap', joints(T, topic='joint_states'))
    assert_oscillates(shifted(dataset([path], bag(mass=[MASS])), T[0]), TOLERANCE)


def test_whole_name_of_a_topic_is_preferred_to_the_end_of_another(tmp_path):
    both = [*joints(T), *joints(T, topic='/b/joint_states', amplitude=2.0)]
    path = write(tmp_path / 'a.mcap', sorted(both, key=lambda message: message[2]))
    assert np.abs(dataset([path], bag(q='joint_states')).q).max() <= 1.0
    assert np.abs(dataset([path], bag(q='b/joint_states')).q).max() > 1.5


def assert_exact(data, scene, tolerance: float) -> None:
    dH_dq, dH_dp = scene.create_hamiltonian().gradient(data.q, data.p)
    assert np.abs(data.dq_dt - dH_dp).max() < tolerance
    assert np.abs(data.dp_dt + dH_dq).max() < tolerance


def test_joints_that_follow_others_are_no_coordinates_of_a_configuration(tmp_path):
    names = ['thumb_angle', 'tip_angle', 'pad_angle']
    own = [state(time, names, [time, 0.5 * time, 2.0 * time]) for time in T[:3]]
    whole = state(T[0], ['pad_angle', 'p_pad_angle', 'thumb_angle', 'p_thumb_angle'], [0.0] * 4,
                  topic='/hnn_simulator/state')
    for bag_of, joints_of in (([*own, whole], ['thumb_angle', 'pad_angle']), (own, names)):
        found = configuration_of([str(write(tmp_path / 'a.mcap', bag_of))])
        assert [one['name'] for one in found['coordinates']] == joints_of
        assert found['data']['joints'] == joints_of


@pytest.mark.parametrize('close', [True, False])
def test_bag_of_the_simulator_holds_exact_states_even_when_unfinished(tmp_path, close):
    scene = load_scene('exact_double_pendulum')
    path = record_run(tmp_path / 'bag', scene, 300, close=close)
    data = dataset([path], bag(
        joints=['angle1', 'angle2'], p='p', dp_dt='state', derivatives=None))
    assert_exact(data, scene, 1e-12)
    assert len(data.q) == 280


@pytest.mark.parametrize('begin', [None, 150])
def test_times_of_a_simulators_bag_are_its_own_on_which_drives_depend(tmp_path, begin):
    path = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 200, begin=begin)
    (motion,), _ = read_motions(Path(), BagMotions(), ['angle'], [path])
    first, *_ = next(RecordedRun(path).samples())
    assert motion.t[0] == 1e-9 * first >= 0.01


@pytest.mark.parametrize('begin', [None, 0])
def test_force_of_a_command_that_is_not_in_the_bag_is_not_taken_for_none(tmp_path, begin):
    scene = load_scene('exact_pendulum').with_overrides(0.01, 'implicit_midpoint', effects=[
        {'kind': 'external_force', 'coordinates': ['angle'], 'timeout': 10.0}])
    path = record_run(tmp_path / 'bag', scene, 200,
                      commands={0: [[0.5]], 100: [[-0.5]]}, begin=begin)
    data = dataset([path], bag(joints=['angle'], commands='commands', stamps='log'))
    # Of the rows that are left at each end as margins nothing is asked.
    assert set(np.unique(data.commands)) == ({0.5, -0.5} if begin is None else {-0.5})
    motions, told = read_motions(Path(), BagMotions(), ['angle'], [path])
    assert set(np.unique(np.concatenate([motion.tau for motion in motions]))) == (
        {0.5, -0.5} if begin is None else {-0.5})
    # Samples at steps 1 to 99.
    for description in (data.description, told):
        assert ('an unknown force for 99 samples' in description) == (begin == 0)


def test_state_of_the_simulator_is_preferred_in_its_bags_and_in_those_of_other_recorders(tmp_path):
    scene = load_scene('exact_double_pendulum')
    own = record_run(tmp_path / 'bag', scene, 300)
    config = bag(joints=['angle1', 'angle2'], derivatives=None)
    # Each of these jitters would spoil a pairing by the times of reception.
    for path in (own, *(as_received(own, tmp_path / f'{jitter}.mcap', jitter=jitter)
                        for jitter in (0.0004, 0.004, 0.04))):
        data = dataset([path], config)
        assert len(data.q) == 280
        assert_exact(data, scene, 1e-12)
    for without, other in ((['joint_states'], config), (['p', 'energy'], bag(
            joints=['angle1', 'angle2'], p='state', dp_dt='state', derivatives=None))):
        data = dataset([as_received(own, tmp_path / 'a.mcap', without=without)], other)
        # Estimated velocities: of some rad/s, whose rates change within a tenth of a second.
        assert_exact(data, scene, 0.1 if without == ['joint_states'] else 1e-12)


@pytest.mark.parametrize('changes', [{'p': 'p'}, {'p': 'p', 'dp_dt': 'state'},
                                     {'q': 'q', 'p': 'state'}])
def test_stamped_and_unstamped_topics_that_disagree_in_time_are_an_error(tmp_path, changes):
    own = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 300)
    config = bag(joints=['angle'], derivatives=None, **changes)
    assert len(dataset([own], config).q) == 280
    for jitter in (0.0005, 0.01):
        path = as_received(own, tmp_path / f'{jitter}.mcap', jitter=jitter)
        with refused(DataError):
            dataset([path], config)
    # Who says so takes them as they are.
    assert len(dataset([path], config.model_copy(update={'stamps': 'log'})).q) > 100


EMPTY = Float64MultiArray()


@pytest.mark.parametrize('messages, changes', [
    ([], {}), (joints(T), {'p': 'joint_states'}),
    ([*joints(T, topic='/a/joint_states'), *joints(T, topic='/b/joint_states')], {}),
    ([('/q', 'std_msgs/msg/Float64', t, serialize_message(Float64())) for t in T], {'q': 'q'}),
    (joints(np.concatenate([T, T])), {'on_bad': 'fail'}),
    (joints(T[::-1] * 0.0 + 1.0), {'stamps': 'log'}),
    (array(T, np.where(T > 2.0, np.nan, T), '/q'), {'q': 'q'}),
    (array(T, np.stack([T, T], axis=-1), '/q'), {'q': 'q'}),
    (array(T, T, '/q'), {'q': 'q', 'columns': [1]}),
    (array(T, T, '/q'), {'q': 'q', 'stamps': 'header'}),
    (joints(T, velocity=False), {'velocity': 'joint_states'}), (joints(T[:20]), {}),
    (joints(T[:40]), {'derivatives': {'kind': 'savitzky_golay', 'window': 0.5}}),
    ([('/q', ARRAY, t, serialize_message(EMPTY)[:9]) for t in T], {'q': 'q'}),
    ([('/joint_states', JOINTS, t, serialize_message(JointState(
        name=['swing'], position=[1.0]))) for t in T], {'stamps': 'log'}),
    (joints(T), {'spacing': 1e-9})], ids=range(16))
def test_unusable_bag_gives_one_line_that_says_what_is_in_it(tmp_path, messages, changes):
    path = write(tmp_path / 'a.mcap', sorted(messages, key=lambda message: message[2]))
    with refused(DataError):
        dataset([path], bag(**changes))


@pytest.mark.parametrize('changes', [
    {'joints': ['a', 'a']}, {'columns': [0, 1]}, {'p': 'p', 'mass': [1.0]},
    {'velocity': 'v', 'estimate_velocity': True}, {'mass': [1.0, 2.0]}, {'spacing': 0.0}])
def test_contradictory_bag_description_is_refused(changes):
    with misfit():
        bag(**changes)


CONFIG = """
coordinates: [{name: swing, q_unit: rad, p_unit: kg m2/s}]
data:
  kind: bag
  joints: [swing]
  mass: [3.0]
hidden: [16]
adam_steps: 300
lbfgs_steps: 200
test_fraction: 0.2
"""


def test_bags_become_a_model_in_one_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('swing.yaml').write_text(CONFIG)
    bags = [str(write(tmp_path / f'{i}.mcap', joints(T, amplitude=0.5 * (1 + i))))
            for i in range(2)]
    main(['--config', 'swing.yaml', '--data', *bags])
    losses = load_checkpoint('models/swing.safetensors').card.losses
    # Blocks of time that training never saw, of motions that it did see.
    assert losses['test_loss'] < 1e-3
    hamiltonian = NeuralHamiltonian(load_checkpoint('models/swing.safetensors'))
    q, p = np.array([0.5]), np.array([-2.0])
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    tolerance = 0.01 + 3.0 * np.sqrt(hamiltonian.checkpoint.card.losses['validation_loss'])
    assert dH_dp == pytest.approx(p / MASS, abs=tolerance * OMEGA)
    assert dH_dq == pytest.approx(MASS * OMEGA**2 * q, abs=tolerance * MASS * OMEGA**2)


@pytest.mark.parametrize('more', ['', '  paths: [none]\n'])
def test_configuration_without_its_bags_is_one_line(tmp_path, monkeypatch, more):
    monkeypatch.chdir(tmp_path)
    Path('swing.yaml').write_text(CONFIG.replace('  mass', f'{more}  mass'))
    with refused(DataError):
        main(['--config', 'swing.yaml'])


def positions(t: np.ndarray, q: np.ndarray) -> list[Message]:
    return [state(time, ['swing'], [position]) for time, position in zip(t, q, strict=True)]


@pytest.mark.parametrize('other', [2, 10])
def test_second_publisher_of_positions_in_a_bag_is_told(tmp_path, caplog, other):
    """It sends zeros, each second or tenth message; noise and one outlier are no publisher."""
    rng = np.random.default_rng(3)
    q = 0.3 + np.sin(OMEGA * T) + 1e-3 * rng.normal(size=T.size)
    q[77] = 0.0
    dataset([write(tmp_path / 'one.mcap', positions(T, q))], bag())
    assert 'jump away' not in caplog.text
    q[::other] = 0.0
    with suppress(DataError):  # those of a tenth of the messages are faults of a sensor as well
        dataset([write(tmp_path / 'two.mcap', positions(T, q))], bag())
    assert caplog.text.count('positions jump away and back in ') == 1
