# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Services and topics that others act on a simulator with, and nonsense at every one of them."""

import array
from pathlib import Path
import random
import time

from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros import load_scene
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros.initial_state import initial_state
from hnn_vi_ros.ros.topics.hearing import LARGEST_MESSAGE
from lifecycle_msgs.srv import ChangeState
from messages import refused
import numpy as np
from peer import Peer, simulating, SIMULATOR, stamp, state_of, values_of, wait_for_way_back
from processes import finish, read_bag, standard_error
import pytest
from rcl_interfaces.srv import (
    DescribeParameters, GetParameters, ListParameters, SetParameters, SetParametersAtomically)
from rclpy.parameter import Parameter
from scene_files import write_scene
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
import yaml

FORCE = '{kind: external_force, coordinates: [angle1], timeout: 0.1}'
SERVO = '{kind: servo, coordinates: [angle1, angle2], stiffness: 5.0, damping: 1.0}'
WALL = '{kind: impact, coordinate: x, position: 0.0, restitution: 0.5}'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working directory with two scenes."""
    write_scene(tmp_path / 'arms.yaml', 'double_pendulum', f'{FORCE}, {SERVO}', step_size=0.002,
                q=[0.3, -0.2], p=[0.0, 0.0])
    write_scene(tmp_path / 'wall.yaml', 'free_particle, mass: 2.0, names: [x]', WALL)
    return tmp_path


def test_initial_state_is_the_mirror_image_of_joint_states_and_is_used_at_the_next_reset(folder):
    with simulating(folder, scene='arms.yaml', record_path='bag') as (other, process):
        publisher = other.publisher(JointState, '~/initial_state')
        other.spin_until(lambda: len(other.states) > 100 and publisher.get_subscription_count())
        seen = other.states[-1]
        wanted = JointState(name=list(seen.name)[::-1], position=seen.position[::-1],
                            velocity=seen.velocity[::-1], effort=seen.effort)
        good = {'name': list(seen.name), 'position': seen.position, 'velocity': seen.velocity}

        def taken() -> bool:
            # It is refused while what turns velocities into momenta is being compiled.
            publisher.publish(wanted)
            return '~/initial_state: used at the next reset' in standard_error(process)
        other.spin_until(taken)
        # Nonsense that comes after it leaves it as it is.
        for bad in ({'name': ['a', 'b']}, {'name': list(seen.name)[:1]}, {'name': []},
                    {'name': [seen.name[0]] * 2}, {'position': [float('nan'), 0.0]},
                    {'position': [0.0]}, {'position': [0.0] * 50_000}, {'velocity': []},
                    {'velocity': [float('inf'), 0.0]}):
            publisher.publish(JointState(**good | bad))
            other.spin(0.05)
        # Nothing of it is used before the reset.
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 10)
        assert other.pause().success
        assert other.trigger('reset').success
        assert other.set_parameters(step_count=1).successful
        assert other.trigger('step').success
        other.spin_until(lambda: stamp(other.states[-1]) % 10_000_000 == 2_000_000)
        # One step of h = 2 ms from it: q moves by h q', less than 2e-2 even at 10 rad/s.
        np.testing.assert_allclose(
            state_of(other.states[-1])[:2], seen.position, atol=2e-3 * 10.0)
    assert '~/initial_state: message ignored' in standard_error(process)
    # The new bag says where it begins: at the velocities that were asked for.
    begun = yaml.safe_load(BagReader(folder / 'bag-2').attachment('scene.yaml'))['initial_state']
    assert begun['q'] == list(seen.position)
    hamiltonian = load_scene(folder / 'arms.yaml').create_hamiltonian()
    _, velocity = hamiltonian.gradient(np.array(begun['q']), np.array(begun['p']))
    # The tolerance of the solver.
    np.testing.assert_allclose(velocity, seen.velocity, atol=1e-9)


def test_initial_state_is_answered_and_can_reset_at_once(folder):
    with simulating(folder, scene='wall.yaml', reset_on_initial_state='true',
                    reset_time='true') as (other, _):
        answers = other.hear(DiagnosticArray, '~/state_set')
        publisher = other.publisher(JointState, '~/initial_state')
        other.spin_until(lambda: other.states and publisher.get_subscription_count()
                         and other.node.count_publishers(f'{SIMULATOR}/state_set'))
        wait_for_way_back(other.node, other.spin_until, SIMULATOR)

        def answer(**fields: list[float]):
            count = len(answers)
            publisher.publish(JointState(name=['x'], **fields))
            other.spin_until(lambda: len(answers) > count)
            return answers[-1].status[0]

        good = answer(position=[2.0], velocity=[0.25])
        assert (good.name, good.level, good.message) == (
            'hnn_simulator: initial_state', b'\0', 'reset to this state')
        assert values_of(good) == {'x': '2.0', 'p_x': '0.5'}
        assert stamp(answers[-1]) == 0
        for bad, why in (({'position': [-1.0], 'velocity': [0.0]}, 'x = -1.0 is behind the wall'),
                         ({'position': [], 'velocity': [0.0]}, 'position must be 1 finite')):
            status = answer(**bad)
            assert status.level == b'\2' and why in status.message and not status.values
            # The run goes on, and resets to the state before.
            response = other.trigger('reset')
            assert response.success, response.message
            assert_goes_on(other, 0.25)
        assert other.set_parameters(reset_on_initial_state=False).successful
        assert answer(position=[3.0], velocity=[0.5]).message == 'used at the next reset'
        assert_goes_on(other, 0.25)
        assert other.trigger('reset').success
        assert_goes_on(other, 0.5)


def assert_goes_on(other: Peer, velocity: float) -> None:
    """Assert that the state moves with a velocity."""
    count = len(other.states)
    # What was published before a reset may come yet.
    other.spin_until(lambda: len(other.states) > count + 5 and stamp(other.states[-1]) > stamp(
        other.states[-2]) and other.states[-1].velocity[0] == pytest.approx(velocity, rel=1e-12))


def test_command_that_makes_a_step_fail_leaves_the_node_up_to_be_reset(folder):
    with simulating(folder, scene='arms.yaml') as (other, process):
        publisher = other.publisher(Float64MultiArray, '~/commands')
        other.spin_until(lambda: other.states and publisher.get_subscription_count())
        # The most that is taken, and more than any arm could bear.
        publisher.publish(Float64MultiArray(data=[1e12]))
        other.spin_until(lambda: 'a step failed' in other.trigger('step').message)
        last = other.states[-1]
        other.spin(0.2)
        assert other.states[-1] is last and np.isfinite(state_of(last)).all()
        assert not other.trigger('step').success
        assert other.trigger('reset').success and other.pause(False).success
        other.spin_until(lambda: stamp(other.states[-1]) > stamp(last) + 100_000_000)
    assert 'reset it' in standard_error(process)


def test_recording_is_started_and_stopped_by_service(folder):
    with simulating(folder, scene='wall.yaml', record='false', record_path='bag') as (
            other, process):
        other.spin_until(lambda: other.states)
        assert not other.trigger('stop_recording').success
        for name in ('bag', 'bag-2'):
            answer = other.trigger('start_recording')
            assert (answer.success, answer.message) == (True, str(folder / name))
            again = other.trigger('start_recording')
            assert not again.success
            assert again.message == f'{folder / name}: is already being recorded'
            # First those that were published before, and have not been heard yet.
            other.spin(0.5)
            count = len(other.states)
            other.spin_until(lambda: len(other.states) > count + 50)
            answer = other.trigger('stop_recording')
            assert (answer.success, answer.message) == (True, str(folder / name))
            # Complete, while the simulation goes on.
            stamps = [s for s, _ in read_bag(folder / name)['/hnn_simulator/q']]
            assert len(stamps) >= 50
            assert stamps == list(range(stamps[0], stamps[-1] + 1, 10_000_000))
        # Nothing that exists is overwritten.
        (folder / 'bag-3').write_text('')
        (folder / 'bag-4').write_text('')
        assert other.trigger('start_recording').message == str(folder / 'bag-5')
    assert [line.split()[1] for line in finish(process)[1].splitlines()
            if line.startswith('bag')] == ['bag', 'bag-2', 'bag-5']


def test_initial_state_takes_any_effort_no_other_names_and_no_infinite_energy(folder):
    hamiltonian = load_scene(folder / 'wall.yaml').create_hamiltonian()

    def state(name: str, velocity: float, effort: list[float]):
        message = JointState(name=[name], position=[0.5], velocity=[velocity], effort=effort)
        return initial_state(message, hamiltonian, np.zeros(1))

    assert state('x', 3.0, [1.0]) == ([0.5], [6.0])
    for name, velocity in (('other', 3.0), ('x', 1e200)):
        with refused(ValueError):
            state(name, velocity, [])


NUMBERS = (0.0, -1.0, 1e3, 1e308, -1e308, 5e-324, float('nan'), float('inf'), -float('inf'))


def numbers(chance: random.Random) -> array.array:
    size = chance.choice((0, 1, 2, 2, 2, 2, 3, 100, 10_000, 200_000))
    return array.array('d', [chance.choice((*NUMBERS, chance.gauss(0.0, 3.0)))
                             for _ in range(min(size, 100))] * max(1, size // 100))


def text(chance: random.Random) -> str:
    return ''.join(chance.choice('aZ0~/:{}%\\é\n\t') for _ in range(chance.choice(
        (0, 1, 5, 200)))) * chance.choice((1, 1, 1, 3000))


def nonsense(chance: random.Random, kind: type, names: list[str]):
    if chance.random() < 0.2:
        return chance.randbytes(chance.choice((0, 3, 4, 8, 40, 1000, LARGEST_MESSAGE + 1)))
    if kind is Float64MultiArray:
        return Float64MultiArray(data=numbers(chance))
    given = chance.choice((names, names[::-1], [text(chance) for _ in range(3)]))
    if kind is JointTrajectory:
        return JointTrajectory(joint_names=given, points=[
            JointTrajectoryPoint(
                positions=numbers(chance), velocities=chance.choice(([], numbers(chance))),
                time_from_start=Duration(sec=chance.choice((0, i, -1)), nanosec=10**8 * i))
            for i in range(chance.choice((0, 1, 3)))])
    return JointState(name=given, position=numbers(chance), velocity=numbers(chance),
                      effort=numbers(chance))


def value(chance: random.Random) -> object:
    return chance.choice((
        None, True, -1, 2 ** 62, chance.choice(NUMBERS), text(chance), [1, 2], [1.0, 2.0],
        ['a'], [b'\x00']))


def request(chance: random.Random, kind: type):
    asked = kind.Request()
    names = ['scene', 'step_count', 'real_time_factor', 'energy_band_limit', 'autostart',
             'use_sim_time', 'reset_time', text(chance)]
    if kind is ChangeState:
        # Not those that end the process.
        asked.transition.id = chance.choice([0, 1, 3, 4, 8, 9, *range(10, 256)])
        asked.transition.label = chance.choice(('', '', text(chance)))
    elif kind is SetBool:
        asked.data = chance.random() < 0.5
    elif kind in (SetParameters, SetParametersAtomically):
        asked.parameters = [
            Parameter(chance.choice(names), value=value(chance)).to_parameter_msg()
            for _ in range(chance.choice((0, 1, 3)))]
    elif kind in (GetParameters, DescribeParameters):
        asked.names = [chance.choice(names) for _ in range(chance.choice((0, 1, 500)))]
    elif kind is ListParameters:
        asked.prefixes, asked.depth = [text(chance)], chance.choice((0, 1, 2 ** 63))
    return asked


def works_again(other: Peer) -> bool:
    """Activate, reset and go on; return whether 50 states follow."""
    # Answered after every transition that was asked for before; refused where it is active.
    other.change_state(3)
    assert other.state == 'active'
    # Nobody publishes /clock.
    assert other.set_parameters(real_time_factor=1.0, use_sim_time=False).successful
    answer = other.trigger('reset')
    assert answer.success, answer.message
    other.pause(False)
    count, until = len(other.states), time.monotonic() + 12.0
    other.spin_until(lambda: len(other.states) > count + 50 or time.monotonic() > until)
    return len(other.states) > count + 50


@pytest.mark.parametrize('seconds', [2.0, pytest.param(30.0, marks=pytest.mark.long)])
def test_nonsense_at_every_topic_and_service_leaves_the_node_up_and_its_state_finite(
        folder, seconds):
    chance, names = random.Random(8), ['angle1', 'angle2']
    services = {'set_pause': SetBool, 'reset': Trigger, 'step': Trigger,
                'start_recording': Trigger, 'stop_recording': Trigger,
                'change_state': ChangeState, 'set_parameters': SetParameters,
                'set_parameters_atomically': SetParametersAtomically,
                'get_parameters': GetParameters, 'describe_parameters': DescribeParameters,
                'list_parameters': ListParameters}
    with simulating(folder, scene='arms.yaml', real_time_factor=2) as (other, process):
        kinds = {'commands': Float64MultiArray, 'initial_state': JointState,
                 'joint_commands': JointState, 'joint_trajectory': JointTrajectory}
        publishers = {name: other.publisher(kind, f'~/{name}') for name, kind in kinds.items()}
        other.spin_until(lambda: other.states and all(
            publisher.get_subscription_count() for publisher in publishers.values()))
        clients = {name: other.client(kind, name) for name, kind in services.items()}
        # There is nothing else to send nonsense to.
        heard = other.topics_of()[1] - {'/parameter_events'}
        assert heard <= {f'{SIMULATOR}/{name}' for name in kinds} | {'/clock'}
        sent, until = 0, time.monotonic() + seconds
        while time.monotonic() < until:
            assert process.poll() is None, finish(process)
            for name, publisher in publishers.items():
                publisher.publish(nonsense(chance, kinds[name], names))
            for name in chance.sample(list(services), 3):
                clients[name].call_async(request(chance, services[name]))
            sent += 7
            other.spin(0.005)
        # It can still be brought to do what it is for.
        publishers['initial_state'].publish(JointState(
            name=names, position=[0.1] * len(names), velocity=[0.0] * len(names)))
        other.spin(1.0)
        assert process.poll() is None, finish(process)
        # A busy node still has nonsense to work off, which may stop it once more: any of it.
        for _ in range(10):
            if works_again(other):
                break
        else:
            raise AssertionError(standard_error(process)[-3000:])
        assert np.isfinite([state_of(message) for message in other.states]).all()
        print(f'{sent} messages and requests in {seconds:g} s')
    # One a second at most is told, of whichever topic.
    assert ': message ignored' in standard_error(process)
