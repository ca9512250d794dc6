# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topics exist where a scene calls for them, and commands act as they should."""

from collections.abc import Iterator
from pathlib import Path

from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros import load_scene
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.messages import ENTRIES
from hnn_vi_ros.ros.topics.outputs import ConfiguredRun
from hnn_vi_ros.ros.topics.topics import Topics
from hnn_vi_ros.run import Monitor, preview_bounds, scene_report
from hnn_vi_ros.simulation import build, EnergyGuard, local_error, SampledScale, Simulation
from nav_msgs.msg import Odometry
import numpy as np
from peer import nodes_of
from processes import wait_until
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from scene_files import FAILING, scene_text
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

OSCILLATOR = scene_text()
KEPLER = scene_text('kepler', '', 'rk4', q=[1.0, 0.0], p=[0.0, 0.75])
MASS, TIMEOUT = 2.0, 0.5
COMMANDED = scene_text(
    f'free_particle, mass: {MASS}, names: [x]',
    f'{{kind: external_force, coordinates: [x], timeout: {TIMEOUT}}}', q=[0.0])
SERVO = scene_text(
    f'free_particle, mass: {MASS}, names: [x, y]',
    '{kind: servo, coordinates: [y, x], stiffness: 50.0, damping: [4.0, 5.0]}',
    q=[0.0, 0.5], p=[0.0, 0.0])
ROBOT = Path(__file__).parents[2] / 'config' / 'robots' / 'two_joint_arm.urdf'
ARM = scene_text(f'urdf, file: {ROBOT}', '{kind: gravity, coordinate: elbow}',
                 q=[0.0, 0.0], p=[0.0, 0.0])
QUADROTOR = scene_text(
    'quadrotor, mass: 2.0, inertia: [0.5, 0.5, 0.5], gravity: 0.0',
    '{kind: external_force, coordinates: [body_fz, body_rx, body_ry, body_rz]}', 'lie_leapfrog',
    q=[1.0, 2.0, 3.0, 0.0, 0.6, 0.0, 0.8], p=[2.0, 0.0, 0.0, 0.0, 0.0, 0.5])
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BOX = (np.array([[-1.0, 1.0]]), np.array([[-1.0, 1.0]]))


def load(folder: Path, text: str):
    (folder / 'scene.yaml').write_text(text)
    return load_scene(folder / 'scene.yaml')


def simulation_of(folder: Path, text: str) -> Simulation:
    return build(load(folder, text))


def sample_of(simulation: Simulation, **changes: float) -> Sample:
    values = {'modified_energy': 0.5, 'energy_error': 0.25} | changes
    return Sample(simulation.steps, 0, simulation.q.copy(), simulation.p.copy(),
                  simulation.dH_dq.copy(), simulation.dH_dp.copy(), simulation.energy, **values)


def open_topics(topics: Topics, simulation: Simulation, mechanism: str | None = None) -> Monitor:
    scale = SampledScale(simulation.hamiltonian)
    monitor = Monitor(simulation, 10, 0.1, None, pytest.fail,
                      [EnergyGuard(0.02, scale)], scale)
    topics.open(ConfiguredRun(simulation, monitor, BOX, mechanism), lambda: 0,
                lambda topic, stamp, payload: None)
    return monitor


@pytest.fixture
def nodes() -> Iterator[tuple[Node, Node, SingleThreadedExecutor]]:
    """Give the simulator's node, another one, and the executor of both."""
    with nodes_of('simulator', 'other') as (nodes, executor):
        yield *nodes, executor


def spin_until(executor: SingleThreadedExecutor, condition) -> None:
    wait_until(lambda: executor.spin_once(timeout_sec=0.02) or condition())


def topics_of(node: Node) -> tuple[set[str], set[str]]:
    """Return what the node publishes and what it hears, but for what every node has."""
    names = node.get_name(), node.get_namespace()
    return tuple(
        {topic for topic, _ in found} - {'/rosout', '/parameter_events'}
        for found in (node.get_publisher_names_and_types_by_node(*names),
                      node.get_subscriber_names_and_types_by_node(*names)))


ALWAYS = {'/simulator/state', '/simulator/q', '/simulator/p', '/simulator/energy', '/joint_states',
          '/simulator/scene', '/simulator/state_set', '/diagnostics'}


@pytest.mark.parametrize('text, accuracy, mechanism, published, heard', [
    (OSCILLATOR, False, None, set(), set()),
    (OSCILLATOR, True, None, {'/simulator/accuracy'}, set()),
    (f'{OSCILLATOR}energy_by_cause: true\n', False, None, {'/simulator/energy_by_cause'}, set()),
    (OSCILLATOR, False, 'mass_spring', {'/simulator/markers'}, set()),
    (COMMANDED, False, None, set(), {'/simulator/commands', '/simulator/joint_commands'}),
    (SERVO, False, None, {'/simulator/joint_trajectory_state'},
     {'/simulator/joint_commands', '/simulator/joint_trajectory'}),
    (QUADROTOR, False, None, {'/simulator/odometry'}, {
        '/simulator/commands', '/simulator/joint_commands', '/simulator/wrench'}),
    (QUADROTOR.replace('body_fz', 'body_z'), False, None, {'/simulator/odometry'}, {
        '/simulator/commands', '/simulator/joint_commands'}),
    (ARM, False, None, {'/robot_description'}, set()),
], ids=['bare', 'accuracy', 'causes', 'mechanism', 'commands', 'servo', 'body', 'forces in space',
        'robot'])
def test_topics_that_are_not_called_for_do_not_exist(
        tmp_path, nodes, text, accuracy, mechanism, published, heard):
    node, _, _ = nodes
    topics = Topics(node, Settings(publish_accuracy=accuracy))
    open_topics(topics, simulation_of(tmp_path, text), mechanism)
    assert topics_of(node) == (ALWAYS | published, heard)


def test_robot_and_scene_are_described_for_those_who_come_later(tmp_path, nodes):
    node, other, executor = nodes
    topics = Topics(node, Settings())
    # By its URDF, also where potentials have joined its energy.
    open_topics(topics, simulation_of(tmp_path, ARM))
    topics.publish_scene('description: any')
    for topic, expected in (('/robot_description', ROBOT.read_text()),
                            ('/simulator/scene', 'description: any')):
        heard = []
        other.create_subscription(String, topic, heard.append, LATCHED)
        spin_until(executor, lambda heard=heard: heard)
        assert heard[0].data == expected


def test_accuracy_has_its_entries_in_the_order_of_its_label(tmp_path, nodes):
    node, _, _ = nodes
    simulation = simulation_of(tmp_path, OSCILLATOR)
    topics = Topics(node, Settings(publish_accuracy=True))
    monitor = open_topics(topics, simulation)
    energy0, expected = simulation.energy, None
    for _ in range(2):
        gradients = simulation.gradients
        monitor.advance(10)
        # Estimated at the first sample, and not yet again.
        expected = expected or local_error(simulation)
        sample = sample_of(simulation, work=0.125)
        monitor.add(sample)
        monitor.evaluate()
        message = deserialize_message(topics.publish(sample)[-1], Float64MultiArray)
        dimension, = message.layout.dim
        assert dimension.label == ','.join(ENTRIES)
        assert dimension.size == len(message.data) == len(ENTRIES)
        found = dict(zip(ENTRIES, message.data, strict=True))
        figures = monitor.timing.figures
        # No sample has cost anything yet, and the run is too short for a drift.
        assert np.isnan([found.pop('drift_per_hour'),
                         found.pop('largest_real_time_factor')]).all()
        assert found == {
            'H': simulation.energy, 'modified_H': 0.5, 'energy_error': 0.25, 'work': 0.125,
            'energy_balance': simulation.energy - energy0 - 0.125,
            'residual': simulation.residual,
            'iterations': (simulation.gradients - gradients) / 10,
            'microseconds_per_step_median': figures.microseconds_per_step_median,
            'microseconds_per_step_p99': figures.microseconds_per_step_p99,
            'energy_scale': monitor.energy_scale, 'modified_energy_band': monitor.energy.band,
            'gradients_per_step': figures.gradients_per_step, 'local_error': expected}
        assert figures.microseconds_per_step_p99 > 0.0


def test_accuracy_ends_with_the_invariants_of_the_scene(tmp_path, nodes):
    simulation = simulation_of(tmp_path, KEPLER)
    topics = Topics(nodes[0], Settings(publish_accuracy=True))
    monitor = open_topics(topics, simulation)
    sample = sample_of(simulation)
    monitor.add(sample)
    message = deserialize_message(topics.publish(sample)[-1], Float64MultiArray)
    assert message.layout.dim[0].label == ','.join([*ENTRIES, 'angular_momentum'])
    assert message.data[-1] == 0.75 == simulation.q[0] * simulation.p[1]


def test_forces_in_loops_are_those_of_the_last_step(nodes):
    simulation = build(load_scene('four_bar'))
    topics = Topics(nodes[0], Settings(publish_loop_forces=True))
    open_topics(topics, simulation)
    simulation.advance(10)
    message = deserialize_message(topics.publish(sample_of(simulation))[-1], JointState)
    assert message.name == [f'coupler-rocker.{kind}.{axis}' for kind in ('force', 'moment')
                            for axis in 'xyz']
    assert np.array_equal(message.position, simulation.loop_forces.ravel())


def test_wrench_in_the_frame_of_a_body_is_the_command_that_is_recorded(tmp_path, nodes):
    node, other, executor = nodes
    simulation, recorded = simulation_of(tmp_path, QUADROTOR), []
    topics = Topics(node, Settings())
    monitor = Monitor(simulation, 10, 0.1, None, pytest.fail)
    topics.open(ConfiguredRun(simulation, monitor, BOX, frame_id='map'), lambda: 0,
                lambda topic, stamp, payload: recorded.append((topic, payload)))
    received: list[Odometry] = []
    other.create_subscription(Odometry, '/simulator/odometry', received.append, 10)
    publisher = other.create_publisher(WrenchStamped, '/simulator/wrench', 1)
    spin_until(executor, publisher.get_subscription_count)
    message = WrenchStamped()
    message.header.frame_id = 'body'
    message.wrench.force.z, message.wrench.torque.x = 4.0, 0.3
    publisher.publish(message)
    spin_until(executor, lambda: recorded)
    (topic, payload), = recorded
    assert topic.name == '/simulator/commands' and topic.type == 'std_msgs/msg/Float64MultiArray'
    assert list(deserialize_message(payload, Float64MultiArray).data) == [4.0, 0.3, 0.0, 0.0]
    # Thrust along the third axis of the body, turned about y by 2 atan(0.6 / 0.8).
    assert -simulation.dH_dq[:3] == pytest.approx([4.0 * 0.96, 0.0, 4.0 * 0.28], rel=1e-14)
    while not received:
        topics.publish(sample_of(simulation))
        executor.spin_once(timeout_sec=0.02)
    assert (received[0].header.frame_id, received[0].child_frame_id) == ('map', 'body')


def test_scene_report_names_effects(tmp_path):
    scene = load(tmp_path, COMMANDED)
    simulation = build(scene)
    report = scene_report(scene, simulation, origin=5)
    assert report['effects'] == [
        {'kind': 'external_force', 'coordinates': ['x'], 'timeout': TIMEOUT, 'model': None,
         'member': None, 'initial': None, 'gain': 1.0, 'offset': 0.0,
         'gravity_compensation': None, 'file': None}]
    assert report['conservative'] is False
    assert (report['origin'], report['first_step']) == (5, 0)
    assert report['hamiltonian'] == {'kind': 'free_particle', 'mass': MASS, 'names': ['x']}


def test_look_ahead_leaves_the_simulation_as_it_was(tmp_path):
    simulation, fresh = (simulation_of(tmp_path, OSCILLATOR) for _ in range(2))
    before = simulation.snapshot()
    preview_bounds(simulation, 10.0)
    after = simulation.snapshot()
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[key], after[key]) for key in before)
    assert (simulation.gradients, simulation.rescued, simulation.residual) == (0, 0, 0.0)
    simulation.advance(1000)
    fresh.advance(1000)
    assert (simulation.q == fresh.q).all() and (simulation.p == fresh.p).all()


def test_look_ahead_finds_the_extent_of_the_motion(tmp_path):
    (q,), (p,) = preview_bounds(simulation_of(tmp_path, OSCILLATOR), 7.0)
    # The unit circle, with a margin of a tenth of its diameter; h = 0.01 misses 1e-4 of it.
    for low, high in (q, p):
        assert (low, high) == (pytest.approx(-1.2, abs=1e-3), pytest.approx(1.2, abs=1e-3))


def test_look_ahead_shows_what_does_not_move_with_room_around_it(tmp_path):
    found = preview_bounds(simulation_of(tmp_path, COMMANDED), 1.0)
    np.testing.assert_array_equal(found, [[[-1.0, 1.0]]] * 2)


def test_look_ahead_of_a_step_that_fails_ends_there(tmp_path):
    simulation = simulation_of(tmp_path, FAILING)
    found = preview_bounds(simulation, 100.0)
    assert simulation.steps == 0 and simulation.q[0] == 1.0
    assert np.isfinite(found).all()
