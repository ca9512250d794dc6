# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Print the script by which a shell completes ``hnn``, made of the parsers themselves."""

from collections.abc import Iterable, Iterator

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.commands.table import COMMANDS, parser_of
from hnn_vi_ros.files.resources import shipped_names
from hnn_vi_ros.integrators import INTEGRATORS

# Where there is no name to offer, and next to names, each shell offers files.
_SCRIPT = {'bash': """\
_hnn() {{
    local place=$COMP_CWORD word=${{COMP_WORDS[COMP_CWORD]}} names=''
    local command=${{COMP_WORDS[1]}} before=${{COMP_WORDS[COMP_CWORD-1]}}
{cases}
    mapfile -t COMPREPLY < <(
        compgen -W "$names" -- "$word"; [[ $word == -* ]] || compgen -f -- "$word")
}}
complete -o filenames -F _hnn hnn
""", 'zsh': """\
#compdef hnn
local place=$((CURRENT - 1)) word=$words[CURRENT] names=''
local command=$words[2] before=$words[CURRENT-1]
{cases}
compadd -- ${{=names}}
[[ $word == -* ]] || _files
"""}


def main(argv: list[str]) -> int:
    """Print the script of a shell."""
    shell = arguments.completion().parse_args(argv).shell
    print(_SCRIPT[shell].format(cases='\n'.join(_cases())), end='')
    return 0


def _cases() -> Iterator[str]:
    """Yield lines, of any shell, that set ``names`` to what can stand in a place."""
    offered = {kind: shipped_names(kind) for kind in ('scene', 'sweep', 'training')}
    offered['integrator'] = [*INTEGRATORS]
    options: list[str] = []
    places: list[str] = []
    for name in COMMANDS:
        own = parser_of(name)
        first: list[str] = []
        for action in own.known:
            names = offered.get(getattr(action, 'names_of', ''), list(action.choices or ()))
            if action.option_strings and names:
                places += [_case(f'"{name} {option}"', names) for option in action.option_strings]
            elif not action.option_strings:
                first += names
        options.append(_case(name, [*own.options, *first]))
    yield 'if [[ $place == 1 ]]; then'
    yield f"    names='{' '.join(COMMANDS)}'"
    yield 'else'
    # Dashes may stand in names of commands, too.
    yield '    case ${command//-/_} in'
    yield from options
    yield '    esac'
    yield '    case "${command//-/_} $before" in'
    yield from places
    yield '    esac'
    yield 'fi'


def _case(pattern: str, names: Iterable[object]) -> str:
    return f"        {pattern}) names='{' '.join(map(str, names))}';;"
