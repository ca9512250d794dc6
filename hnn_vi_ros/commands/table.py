# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Commands of ``hnn``: all executables, and some more."""

from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

from hnn_vi_ros.errors import did_you_mean, SceneError
from hnn_vi_ros.files import find_yaml, Parser, YAML_KINDS

# Commands by purpose, each with the module of the package whose ``main(argv)`` it calls.
GROUPS = {
    'simulate': {'run': 'commands.run', 'list': 'commands.names', 'scene': 'commands.scene_tool',
                 'cost': 'commands.cost', 'sweep': 'sweeps.running', 'export': 'codegen.export'},
    'learn': {'train': 'learning.train', 'evaluate': 'learning.evaluate',
              'identify': 'identify.identify', 'check': 'identify.check',
              'import': 'learning.import_model'},
    'control': {'controller': 'ros.controller_node'},
    'ROS': {'simulator': 'ros.simulator_node', 'listener': 'ros.listener_node'},
    'data': {'replay': 'ros.replay.command', 'recover_bag': 'recording.bags.recover_bag'},
    'this installation': {'doctor': 'commands.doctor'},
}
COMMANDS = {name: module for group in GROUPS.values() for name, module in group.items()}
# Commands that are not ROS 2 executables.
_WITHOUT_ROS = ('run', 'list', 'cost', 'check', 'export', 'doctor')
EXECUTABLES = [name for name in COMMANDS if name not in _WITHOUT_ROS]


def module_of(name: str) -> str:
    """Return the name of the module that runs a command."""
    return f'hnn_vi_ros.{COMMANDS[name]}'


def parser_of(name: str) -> Parser:
    """Return the parser of a command, without importing the libraries that its work needs."""
    room = COMMANDS[name].partition('.')[0]
    arguments = import_module(f'hnn_vi_ros.{room}.arguments')
    # A keyword of Python cannot name a function, and a built-in type should not.
    return getattr(arguments, {'import': 'import_model', 'list': 'names'}.get(name, name))()


def check_names(parser: Parser, argv: Sequence[str]) -> None:
    """Raise SceneError for an invalid scene, or a sweep, task or configuration without a file."""
    from hnn_vi_ros.scene import load_scene
    options = parser.parse_args(argv)
    given = [(kind, getattr(options, action.dest)) for action in parser.known
             if (kind := getattr(action, 'names_of', '')) in YAML_KINDS]
    for kind, texts in given:
        for text in [texts] if isinstance(texts, str) else texts or ():
            if kind == 'scene':
                # Without a compiler, all problems of its keys are known as well.
                load_scene(text)
            else:
                find_yaml(kind, text, SceneError)


def hnn() -> Parser:
    """Return the parser of ``hnn``, whose help lists all commands."""
    width = max(map(len, COMMANDS))
    lines = [line for group, names in GROUPS.items() for line in (
        f'{group}:', *(f'  {name:{width}}  {first_line(parser_of(name))}' for name in names), '')]
    parser = Parser('', (
        'Simulate learned and exact Hamiltonians with variational integrators. `hnn COMMAND '
        '--help` lists the arguments of a command.'), [
        'hnn run pendulum --duration 20 --plot pendulum.png', 'hnn list scenes',
        'hnn train --help', 'hnn doctor'], '\n'.join(lines).rstrip())
    parser.usage = 'hnn COMMAND ...'
    return parser


def first_line(parser: Parser) -> str:
    """Return the first sentence of a command's description, as one line."""
    return ' '.join((parser.description or '').partition('. ')[0].rstrip('.').split())


def refuse(word: str) -> NoReturn:
    """Print help or version if requested; otherwise report an unknown command."""
    parser = hnn()
    if word.startswith('-'):
        parser.parse_args([word])
    parser.error(f'unknown command {word!r}{did_you_mean(word, COMMANDS, 0.6)}; valid: '
                 f'{", ".join(COMMANDS)}')
