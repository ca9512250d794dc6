# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Services and topics that others act on a simulator with."""

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros import load_scene
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros.initial_state import initial_state
from messages import refused
import numpy as np
from peer import Peer, simulating, SIMULATOR, stamp, state_of, values_of, wait_for_way_back
from processes import finish, read_bag, standard_error
import pytest
from scene_files import write_scene
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
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
