# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Commands of ``hnn``: every executable, and some more."""

from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

from hnn_vi_ros.command_line import Parser
from hnn_vi_ros.errors import did_you_mean

# Each command, by what it is for, and the module whose ``main(argv)`` it calls.
GROUPS = {
    'simulate': {
        'run': 'hnn_vi_ros.commands.run',
        'scene': 'hnn_vi_ros.commands.scene_tool',
        'cost': 'hnn_vi_ros.commands.cost',
        'sweep': 'hnn_vi_ros.sweeps.sweep'},
    'learn': {
        'train': 'hnn_vi_ros.learning.train',
        'evaluate': 'hnn_vi_ros.learning.evaluate',
        'identify': 'hnn_vi_ros.learning.scene_numbers.identify',
        'import_checkpoint': 'hnn_vi_ros.learning.import_checkpoint'},
    'control': {
        'controller': 'hnn_vi_ros.ros.controller_node'},
    'ROS': {
        'simulator': 'hnn_vi_ros.ros.simulator_node',
        'rerun_bridge': 'hnn_vi_ros.ros.rerun_bridge',
        'listener': 'hnn_vi_ros.ros.listener_node'},
    'data': {
        'replay': 'hnn_vi_ros.ros.replay.replay_node',
        'recover_bag': 'hnn_vi_ros.bags.recover_bag'},
    'this installation': {
        'doctor': 'hnn_vi_ros.commands.doctor',
        'completion': 'hnn_vi_ros.commands.completion'},
}
COMMANDS = {name: module for group in GROUPS.values() for name, module in group.items()}
# Older names, and what they mean.
ALIASES = {'new_scene': ('scene', '--new')}
# ROS 2 finds the others as executables.
_WITHOUT_ROS = ('run', 'cost', 'doctor', 'completion')
EXECUTABLES = [name for name in (*COMMANDS, *ALIASES) if name not in _WITHOUT_ROS]


def module_of(name: str, argv: Sequence[str]) -> str:
    """Return the name of the module that does what a command is asked for."""
    if name == 'sweep' and {'mcap', '--episodes=mcap'} & {*argv}:
        # Bags are made of messages of ROS, which no other sweep takes.
        return 'hnn_vi_ros.ros.replay.episode_bags'
    return COMMANDS[name]


def parser_of(name: str) -> Parser:
    """Return the parser of a command, without the libraries that its work takes."""
    room = COMMANDS[name].split('.')[1]
    arguments = import_module(f'hnn_vi_ros.{room}.arguments')
    return getattr(arguments, name)()


def hnn() -> Parser:
    """Return the parser of the one command, whose help lists all commands."""
    width = max(map(len, COMMANDS))
    lines = [line for group, names in GROUPS.items() for line in (
        f'{group}:', *(f'  {name:{width}}  {first_line(parser_of(name))}' for name in names), '')]
    parser = Parser('', (
        'Simulate learned and exact Hamiltonians with variational integrators. `hnn COMMAND '
        '--help` lists the arguments of a command.'), [
        'hnn run pendulum --duration 20 --plot pendulum.png', 'hnn scene --list',
        'hnn train --help', 'hnn doctor'], '\n'.join(lines).rstrip())
    parser.usage = 'hnn COMMAND ...'
    return parser


def first_line(parser: Parser) -> str:
    """Return the first sentence of a command's description, as one line."""
    return ' '.join((parser.description or '').partition('. ')[0].rstrip('.').split())


def refuse(word: str) -> NoReturn:
    """Print help or the version, if that is the word, or that there is no such command."""
    parser = hnn()
    if word.startswith('-'):
        parser.parse_args([word])
    parser.error(f'unknown command {word!r}{did_you_mean(word, COMMANDS, 0.6)}; valid: '
                 f'{", ".join(COMMANDS)}')
