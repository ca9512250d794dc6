# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Command-line parsers of the nodes; imports nothing of ROS, so that help appears at once."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

from hnn_vi_ros.files import Parser
from hnn_vi_ros.ros.settings import (
    CONTROLLER_PARAMETERS, help_of, PARAMETERS, REPLAY_PARAMETERS, Specification)

_SIMULATOR = """\
The node publishes ~/state, ~/q, ~/p, ~/energy, joint_states, ~/scene, ~/state_set and
/diagnostics; if the scene or a parameter requires them, also robot_description, ~/markers,
~/odometry, ~/events, ~/joint_trajectory_state, ~/uncertainty, ~/prediction_error, ~/accuracy,
~/loop_forces, ~/energy_by_cause and /clock. It subscribes to ~/initial_state; with motors, to
~/commands, ~/joint_commands, ~/joint_trajectory and ~/wrench; with an observer, to ~/observations;
with a payload, to ~/payload.
Services: ~/set_pause, ~/step, ~/reset, ~/start_recording, ~/stop_recording and those of its
lifecycle. ~ is /hnn_simulator."""
_REPLAY = """\
The node publishes the topics of the bag and, with publish_clock, /clock. Services: ~/set_pause
and ~/step. ~ is /hnn_replay. Each parameter is also an option."""
_CONTROLLER = """\
The node subscribes to joint_states (for rotating bodies, hnn_simulator/state) and publishes
commands on hnn_simulator/joint_commands or hnn_simulator/commands, in its namespace, and
/diagnostics. Services: those of its lifecycle."""
_LISTENER = """\
The node subscribes to hnn_simulator/energy, and has no parameters."""


def simulator() -> Parser:
    """Return the parser of ``simulator``."""
    return Parser('simulator', (
        'Simulate a scene in real time; publish, record and visualise it.'), [
            'hnn simulator --ros-args -p scene:=pendulum -p duration:=10.0',
            'hnn simulator --ros-args -p integrator:=gauss8 -p record:=false',
            'hnn simulator --ros-args --params-file my.yaml -r __ns:=/arm',
            'hnn simulator --ros-args '
            '-p qos_overrides./hnn_simulator/q.publisher.reliability:=best_effort'],
        _details(_SIMULATOR, PARAMETERS), [item.name for item in PARAMETERS])


def replay() -> Parser:
    """Return the parser of ``replay``."""
    parser = Parser('replay', (
        'Publish a recorded bag, verify it by simulating it again, or show it in rerun.'), [
            'hnn replay runs/pendulum-20260101T120000Z/bag --rate 2 --loop',
            'hnn replay BAG --verify',
            'hnn replay BAG --rerun bag.rrd',
            'hnn replay BAG --ros-args -p publish_clock:=true'],
        _details(_REPLAY, REPLAY_PARAMETERS))
    parser.add_argument('bag', type=Path, metavar='BAG', help=(
        'folder of a bag, or its .mcap file, which may be truncated'))
    parser.add_argument('--verify', action='store_true', help=(
        'simulate the bag again from its own scene, and compare its states bit by bit'))
    parser.add_argument('--rerun', type=Path, metavar='FILE', help=(
        'write a recording of the bag for rerun: a new .rrd file'))
    parser.add_argument('--node', default='', metavar='NAME', help=(
        'with --verify or --rerun: the run of this simulator, such as /left/hnn_simulator '
        '(default: all in the bag)'))
    parser.add_argument('--trust-code', action='store_true', help=(
        'with --verify or --rerun: run the Python code named in the scene of the bag'))
    for item in REPLAY_PARAMETERS:
        kind = {'action': 'store_true', 'default': None} if isinstance(item.default, bool) \
            else {'type': type(item.default)}
        parser.add_argument(f'--{item.name.replace("_", "-")}', help=item.description, **kind)
    return parser


def controller() -> Parser:
    """Return the parser of ``controller``."""
    return Parser('controller', 'Control a simulator or a machine as defined in a task.', [
        'hnn controller --ros-args -p task:=swing_up',
        'hnn controller --ros-args -p task:=my.yaml -p scene:=my_scene.yaml',
        'hnn controller --ros-args -r joint_states:=/robot/joint_states '
        '-p simulator:=/robot'],
        _details(_CONTROLLER, CONTROLLER_PARAMETERS),
        [item.name for item in CONTROLLER_PARAMETERS])


def listener() -> Parser:
    """Return the parser of ``listener``."""
    return Parser('listener', 'Print the energy of a running simulator once a second.', [
        'hnn listener'], _LISTENER)


def _details(interface: str, table: Sequence[Specification]) -> str:
    """Return the help text on the interface of a node and its parameters."""
    entries = []
    for item in table:
        entries += [f'  {item.name}', fill(
            help_of(item), 97, initial_indent='      ', subsequent_indent='      ',
            break_long_words=False)]
    return '\n'.join([interface, '', 'parameters (--ros-args -p NAME:=VALUE):', *entries])
