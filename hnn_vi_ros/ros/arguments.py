# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Command-line parsers of the nodes; imports nothing of ROS, so that help appears at once."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

from hnn_vi_ros.files import Parser
from hnn_vi_ros.ros.settings import (
    BRIDGE_PARAMETERS, CONTROLLER_PARAMETERS, help_of, PARAMETERS, REPLAY_PARAMETERS,
    Specification)

_SIMULATOR = """\
It publishes ~/state, ~/q, ~/p, ~/energy, joint_states, ~/scene, ~/state_set and /diagnostics; as
far as the scene or a parameter calls for them robot_description, ~/markers, ~/odometry, ~/events,
~/joint_trajectory_state, ~/uncertainty, ~/prediction_error, ~/accuracy and /clock. It hears
~/initial_state and, where the scene has motors, ~/commands, ~/joint_commands, ~/joint_trajectory
and ~/wrench, where it has an observer ~/observations. Services: ~/set_pause,
~/step, ~/reset, ~/start_recording, ~/stop_recording, and those of its lifecycle; ~ is
/hnn_simulator."""
_REPLAY = """\
It publishes the topics of the bag and, with publish_clock, /clock. Services: ~/set_pause, ~/step;
~ is /hnn_replay. Each parameter is an option as well."""
_BRIDGE = """\
It subscribes to the topics of the simulator, and offers nothing."""
_CONTROLLER = """\
It hears joint_states, or hnn_simulator/state of bodies that turn, and commands
hnn_simulator/joint_commands, or hnn_simulator/commands, in its namespace. It publishes
/diagnostics. Services: those of its lifecycle."""
_LISTENER = """\
It subscribes to hnn_simulator/energy, and has no parameters."""


def simulator() -> Parser:
    """Return the parser of ``simulator``."""
    return Parser('simulator', (
        'Simulate a scene at the pace of the clock. Publish, record and show it.'), [
            'ros2 run hnn_vi_ros simulator --ros-args -p scene:=pendulum -p duration:=10.0',
            'ros2 run hnn_vi_ros simulator --ros-args -p integrator:=gauss8 -p record:=false',
            'ros2 run hnn_vi_ros simulator --ros-args --params-file my.yaml -r __ns:=/arm',
            'ros2 run hnn_vi_ros simulator --ros-args '
            '-p qos_overrides./hnn_simulator/q.publisher.reliability:=best_effort'],
        _details(_SIMULATOR, PARAMETERS), [item.name for item in PARAMETERS])


def replay() -> Parser:
    """Return the parser of ``replay``."""
    parser = Parser('replay', (
        'Publish a bag again, or simulate it again and compare.'), [
            'ros2 run hnn_vi_ros replay runs/pendulum-20260101T120000Z/bag --rate 2 --loop',
            'ros2 run hnn_vi_ros replay BAG --verify',
            'ros2 run hnn_vi_ros replay BAG --ros-args -p publish_clock:=true'],
        _details(_REPLAY, REPLAY_PARAMETERS))
    parser.add_argument('bag', type=Path, metavar='BAG', help=(
        'folder of a bag, or its .mcap file; one that was cut off will do'))
    parser.add_argument('--verify', action='store_true', help=(
        'simulate the bag again, from its own scene, and compare bit by bit'))
    parser.add_argument('--node', default='', metavar='NAME', help=(
        'with --verify: the simulator whose run is checked, such as /left/hnn_simulator; all of '
        'the bag without it'))
    parser.add_argument('--trust-code', action='store_true', help=(
        'with --verify: run Python code that the scene in the bag names'))
    for item in REPLAY_PARAMETERS:
        kind = {'action': 'store_true', 'default': None} if isinstance(item.default, bool) \
            else {'type': type(item.default)}
        parser.add_argument(f'--{item.name.replace("_", "-")}', help=item.description, **kind)
    return parser


def rerun_bridge() -> Parser:
    """Return the parser of ``rerun_bridge``."""
    parser = Parser('rerun_bridge', (
        'Show a running simulator or a bag in rerun. It runs in a process of its own, so that '
        'the simulation waits for nothing.'), [
            'ros2 run hnn_vi_ros rerun_bridge',
            'ros2 run hnn_vi_ros rerun_bridge BAG --ros-args -p rerun_sink:=file '
            '-p rerun_path:=bag.rrd'],
        _details(_BRIDGE, BRIDGE_PARAMETERS), [item.name for item in BRIDGE_PARAMETERS])
    parser.add_argument('bag', type=Path, nargs='?', metavar='BAG', help=(
        'folder of a bag, or its .mcap file, to show in place of a running simulator'))
    parser.add_argument('--trust-code', action='store_true', help=(
        'run Python code that a scene names, which others may have written'))
    return parser


def controller() -> Parser:
    """Return the parser of ``controller``."""
    return Parser('controller', 'Command a simulator or a machine by a task.', [
        'ros2 run hnn_vi_ros controller --ros-args -p task:=swing_up',
        'ros2 run hnn_vi_ros controller --ros-args -p task:=my.yaml -p scene:=my_scene.yaml',
        'ros2 run hnn_vi_ros controller --ros-args -r joint_states:=/robot/joint_states '
        '-p simulator:=/robot'],
        _details(_CONTROLLER, CONTROLLER_PARAMETERS),
        [item.name for item in CONTROLLER_PARAMETERS])


def listener() -> Parser:
    """Return the parser of ``listener``."""
    return Parser('listener', 'Print the energy of a running simulator once a second.', [
        'ros2 run hnn_vi_ros listener'], _LISTENER)


def _details(interface: str, table: Sequence[Specification]) -> str:
    """Return the help text on the interface of a node and its parameters."""
    entries = []
    for item in table:
        entries += [f'  {item.name}', fill(
            help_of(item), 97, initial_indent='      ', subsequent_indent='      ',
            break_long_words=False)]
    return '\n'.join([interface, '', 'parameters (--ros-args -p NAME:=VALUE):', *entries])
