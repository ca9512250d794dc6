# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Print the script by which a shell completes ``hnn``, made of the parsers themselves."""

import argparse

from hnn_vi_ros.command_line import named
from hnn_vi_ros.commands import arguments
from hnn_vi_ros.commands.table import COMMANDS, first_line, parser_of
from hnn_vi_ros.errors import optional
from hnn_vi_ros.files.resources import shipped_names
from hnn_vi_ros.integrators import INTEGRATORS

# Function that completes a name or a YAML file, by shell. tcsh knows no functions.
_FUNCTION = {
    'bash': '{function}() {{ compgen -W "{names}" -- "$1"; compgen -f -X "!*.yaml" -- "$1"; }}',
    'zsh': "{function}() {{ _alternative 'names:{kind}:({names})' 'files:file:_files' }}",
}


def main(argv: list[str]) -> int:
    """Print the script of a shell."""
    shell = arguments.completion().parse_args(argv).shell
    with optional('shtab', 'completion'):
        import shtab
    offered = {kind: shipped_names(kind) for kind in ('scene', 'sweep', 'training')}
    functions = [_FUNCTION[shell].format(function=named(kind)[shell], kind=kind,
                                         names=' '.join(names))
                 for kind, names in (offered | {'integrator': list(INTEGRATORS)}).items()
                 if shell in _FUNCTION]
    print(shtab.complete(whole_parser(), shell, preamble={shell: '\n'.join(functions)}))
    return 0


def whole_parser() -> argparse.ArgumentParser:
    """Return one parser of all commands with all their options."""
    parser = argparse.ArgumentParser('hnn')
    commands = parser.add_subparsers()
    for name in COMMANDS:
        own = parser_of(name)
        # `hnn new-scene` is `hnn new_scene`.
        dashed = [name.replace('_', '-')] if '_' in name else []
        commands.add_parser(name, aliases=dashed, parents=[own], add_help=False,
                            help=first_line(own))
    return parser
