# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Print the script by which a shell completes ``hnn``, made of the parsers themselves."""

import argparse

from hnn_vi_ros.command_line import SCENES
from hnn_vi_ros.commands import arguments
from hnn_vi_ros.commands.table import COMMANDS, first_line, parser_of
from hnn_vi_ros.files.optional_package import optional
from hnn_vi_ros.files.resources import shipped_names

# What completes a scene, by shell: a shipped name, or a file. tcsh knows no functions.
_SCENES = {
    'bash': '{name}() {{ compgen -W "{scenes}" -- "$1"; compgen -f -X "!*.yaml" -- "$1"; }}',
    'zsh': "{name}() {{ _alternative 'scenes:scene:({scenes})' 'files:file:_files' }}",
}


def main(argv: list[str]) -> int:
    """Print the script of a shell."""
    shell = arguments.completion().parse_args(argv).shell
    with optional('shtab', 'completion'):
        import shtab
    preamble = {shell: _SCENES[shell].format(
        name=SCENES[shell], scenes=' '.join(shipped_names('scene')))} if shell in _SCENES else {}
    print(shtab.complete(whole_parser(), shell, preamble=preamble))
    return 0


def whole_parser() -> argparse.ArgumentParser:
    """Return one parser of all commands with all their options."""
    parser = argparse.ArgumentParser('hnn')
    commands = parser.add_subparsers()
    for name in COMMANDS:
        own = parser_of(name)
        commands.add_parser(name, parents=[own], add_help=False, help=first_line(own))
    return parser
