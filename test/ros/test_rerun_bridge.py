# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The rerun bridge: what it shows of a bag and of a running simulator, from its own process."""

from pathlib import Path
import signal

from executables import Executable
from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros import rerun_bridge
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun
from hnn_vi_ros.ros.rerun_bridge import BridgePicture, RerunBridge, target_of
from hnn_vi_ros.ros.settings import BridgeSettings
from hnn_vi_ros.ros.topics.outputs import LATCHED
from hnn_vi_ros.run import scene_report
from hnn_vi_ros.simulation import build
from messages import assert_message, refused
import numpy as np
from peer import ros
from processes import (
    finish, read_bag, refusal, standard_error, start, start_executable, to_file, wait_until)
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from recorded import as_received, record_run
from rerun_reader import read
from scene_files import write_scene
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from test_health import events_of
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint


def start_bridge(*words: object) -> Executable:
    return start_executable('rerun_bridge', *words)


@pytest.mark.parametrize('kind', ['own', 'of another recorder'])
def test_bridge_shows_the_very_samples_of_a_bag(tmp_path, kind):
    samples = {}
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 300,
                     change=lambda sample: samples.setdefault(sample.step, sample))
    if kind == 'of another recorder':
        bag = as_received(bag, tmp_path / 'a.mcap')
    status, _, log = finish(start_bridge(bag, *to_file(tmp_path / 'a.rrd')))
    assert status == 0 and '300 samples shown' in log
    entities = read(tmp_path / 'a.rrd')
    steps = entities['/state/q']['step']
    # 30 of 3 s each, and the last sample.
    assert 90 <= len(steps) <= 92 and steps[-1] == max(samples)
    for entity, name in (('/state/q', 'q'), ('/state/p', 'p'), ('/energy/H', 'energy'),
                         ('/energy/error', 'energy_error'),
                         ('/energy/modified', 'modified_energy')):
        found = [row[0] for row in entities[entity]['Scalars:scalars']]
        expected = [float(np.ravel(getattr(samples[step], name))[0]) for step in steps]
        # Of H0 and the modified energy, sums of a few terms: a few units in the last place.
        assert np.allclose(found, expected, rtol=4e-15, atol=4e-15), entity
    assert [row[0] for row in entities['/state/q']['Scalars:scalars']] == [
        samples[step].q[0] for step in steps]


def test_bridge_shows_a_bag_that_is_replayed(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 100)
    recording = tmp_path / 'live.rrd'
    bridge = start_bridge(*to_file(recording))
    replay = start_executable('replay', bag, '--discovery-time', 20)
    assert finish(replay)[0] == 0
    # The picture is opened in a moment that the bridge spends compiling; the samples are held.
    wait_until(recording.exists)
    bridge.send_signal(signal.SIGINT)
    status, _, log = finish(bridge, 20.0)
    assert status == 0 and 'showing /hnn_simulator' in log
    run = {run.step_of(stamp): q[0] for run in [RecordedRun(bag)] for stamp, q, _ in run.samples()}
    entities = read(recording)['/state/q']
    assert len(entities['step']) > 20 and entities['step'][-1] == max(run)
    assert [row[0] for row in entities['Scalars:scalars']] == [
        run[step] for step in entities['step']]


def test_signal_lets_the_bridge_show_what_it_has_received(tmp_path, capfd):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 100)
    reader, words = BagReader(bag), to_file(tmp_path / 'a.rrd')
    messages = {channel.topic: [message.data for message in reader.messages([number])]
                for number, channel in reader.channels.items()}
    with ros(*words):
        bridge, peer = RerunBridge(words), rclpy.create_node('peer')
        states = peer.create_publisher(JointState, '/hnn_simulator/state', 1000)
        scene = peer.create_publisher(String, '/hnn_simulator/scene', LATCHED)
        scene.publish(messages['/hnn_simulator/scene'][0])
        executor = SingleThreadedExecutor()
        executor.add_node(bridge)
        bridge.listen()
        assert 'waiting for /hnn_simulator/scene' in capfd.readouterr().err
        wait_until(lambda: executor.spin_once(timeout_sec=0.1) or (tmp_path / 'a.rrd').exists())
        executor.remove_node(bridge)
        wait_until(states.get_subscription_count)
        for data in messages['/hnn_simulator/state']:
            states.publish(data)
        assert states.wait_for_all_acked(Duration(seconds=10))
        rerun_bridge._show_simulator(bridge, [signal.SIGINT])
        bridge.close()
        for node in (bridge, peer):
            node.destroy_node()
    # 30 of 1 s, and the last sample.
    steps = read(tmp_path / 'a.rrd')['/state/q']['step']
    assert len(steps) >= 30 and steps[-1] == RecordedRun(bag).step_of(reader.last)


def test_bridge_shows_state_alarms_and_timing_of_a_running_simulator_and_alarms_of_its_bag(
        tmp_path):
    # At a step that does not resolve the close encounters.
    write_scene(tmp_path / 'kepler.yaml', 'kepler, mu: 1.0', '', 'variational_euler',
                q=[1.9, 0.0], p=[0.0, 0.22941573387056177], more='mechanism: kepler\n')
    live = tmp_path / 'live.rrd'
    bridge = start_bridge(*to_file(live))
    wait_until(lambda: 'waiting for /hnn_simulator/scene' in standard_error(bridge))
    status, _, said = finish(start(tmp_path, scene='kepler.yaml', duration=9, real_time_factor=3,
                                   record_path='bag', discovery_time=20))
    assert status == 0 and 'under-resolved: t = ' in said
    # The bridge may still be compiling for the picture; what it has received it shows at the end.
    wait_until(live.exists, 120.0)
    bridge.send_signal(signal.SIGINT)
    status, _, log = finish(bridge, 20.0)
    assert status == 0 and 'showing /hnn_simulator' in log
    entities = read(live)
    # 30 samples a simulated second, each whole: the variational Euler method's first step.
    steps = entities['/state/q']['step']
    assert steps == sorted(set(steps)) and len(steps) > 180
    q, p = (np.array(entities[f'/state/{name}']['Scalars:scalars']) for name in 'qp')
    kinetic, depth = 0.5 * (p * p).sum(axis=1), 1.0 / np.linalg.norm(q, axis=1)
    energy = np.ravel(entities['/energy/H']['Scalars:scalars'])
    assert (np.abs(energy - (kinetic - depth)) <= 1e-14 * depth).all()
    assert any(name.startswith('/world/') for name in entities)
    again = start_bridge(tmp_path / 'bag', *to_file(tmp_path / 'again.rrd'))
    assert finish(again)[0] == 0
    # A busy machine may have added alarms of overruns.
    alarms = [(stamp, 'WARN', f'under-resolved: {message.status[0].message}')
              for stamp, message in read_bag(tmp_path / 'bag')['/diagnostics']
              if ('alarm', 'under-resolved') in (
                  (item.key, item.value) for item in message.status[0].values)]
    shown = [event for event in events_of(tmp_path / 'again.rrd')
             if event[2].startswith('under-resolved')]
    assert shown == alarms != []
    shown = [text for _, _, text in events_of(live) if text.startswith('under-resolved')]
    assert [text for _, _, text in alarms] == shown
    figures = entities['/timing/microseconds_per_step']['Scalars:scalars']
    assert all(0.0 < median <= p99 for median, p99 in figures) and len(figures) >= 2


def test_mistake_is_one_line():
    for words in (['nothing'], ['--ros-args', '-p', 'rerun_sink:=file'],
                  ['--ros-args', '-p', 'rerun_sink:=paper']):
        assert_message(refusal('rerun_bridge', *words))


def test_picture_after_a_reset_leaves_those_of_before_alone(tmp_path):
    scene = load_scene('exact_pendulum')
    report = scene_report(scene, build(scene))
    (tmp_path / 'a-2.rrd').touch()
    with ros(*to_file(tmp_path / 'a.rrd')):
        bridge = RerunBridge()
        for origin in range(3):
            bridge._on_scene(String(data=dump_yaml(report | {'origin': origin})))
        bridge.close()
    assert bridge.problem is None and (tmp_path / 'a-2.rrd').stat().st_size == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        'a.rrd', 'a-2.rrd', 'a-3.rrd', 'a-4.rrd'}


def test_port_out_of_its_range_is_a_parameter_error():
    for port in ('0', '65536', '-1', 'x', '1.5'):
        with refused(ParameterError):
            target_of(BridgeSettings(rerun_sink='serve', rerun_path=port))


def test_targets_are_those_of_the_sinks(tmp_path):
    assert target_of(BridgeSettings(rerun_sink='serve', rerun_path='')) == 9876
    assert target_of(BridgeSettings(rerun_sink='serve', rerun_path='1234')) == 1234
    assert target_of(BridgeSettings(rerun_sink='connect')).startswith('rerun+http://')
    assert target_of(BridgeSettings(rerun_sink='file', rerun_path='a.rrd')) == Path('a.rrd')


def plan_of(names: list[str], points: list[tuple[list[float], list[float]]]) -> JointTrajectory:
    message = JointTrajectory(joint_names=names, points=[
        JointTrajectoryPoint(positions=q, velocities=v) for q, v in points])
    message.header.stamp.nanosec = 20_000_000
    return message


@pytest.mark.filterwarnings('ignore')
def test_plan_is_drawn_by_its_momenta_and_what_is_none_is_refused_in_a_line(tmp_path):
    scene = load_scene('exact_double_pendulum')
    picture = BridgePicture(scene)
    picture.open(tmp_path / 'plan.rrd', 'plan')
    q, v = np.array([[0.1, 0.2], [0.3, 0.4]]), np.array([[1.0, -1.0], [0.5, 0.0]])
    # In another order.
    picture.plan(plan_of(['angle2', 'angle1'], [
        (one[::-1].tolist(), rate[::-1].tolist()) for one, rate in zip(q, v, strict=True)]))
    for message in (plan_of(['angle1'], []), plan_of(['angle1', 'angle1'], []),
                    plan_of(['angle1', 'angle2'], [([1.0], [0.0, 0.0])]),
                    plan_of(['angle1', 'angle2'], [([1.0, 2.0], [])]),
                    plan_of(['angle1', 'angle2'], [([1.0, np.nan], [0.0, 0.0])]),
                    plan_of(['angle1', 'angle2'], [([1.0, 0.0], [np.inf, 0.0])])):
        with refused(ValueError):
            picture.plan(message)
    picture.close()
    found = read(tmp_path / 'plan.rrd')['/phase/angle1/plan']
    assert found['sim_time'] == [20_000_000]
    (strip,), = found['LineStrips2D:strips']
    strip = np.array(strip)
    assert np.allclose(strip[:, 0], q[:, 0])
    model = scene.create_hamiltonian()
    p = np.array([np.linalg.solve(np.array([model.gradient(one, unit)[1] for unit in np.eye(2)]).T,
                                  rate) for one, rate in zip(q, v, strict=True)])
    # The recording has 24 bits.
    assert np.allclose(strip[:, 1], p[:, 0], rtol=1e-6)
