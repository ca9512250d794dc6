# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command lines that pages show are understood: commands, options, parameters and files."""

from collections.abc import Iterator
from pathlib import Path
import re
import shlex

from hnn_vi_ros.commands.table import COMMANDS, EXECUTABLES, parser_of
from hnn_vi_ros.files.resources import shipped_names
from hnn_vi_ros.ros import settings as parameters
from sources import blocks, python_files, ROOT

PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md')),
         *sorted((ROOT / 'docs').glob('[!_]*/*.md'))]
TABLES = {'simulator': parameters.PARAMETERS, 'replay': parameters.REPLAY_PARAMETERS,
          'controller': parameters.CONTROLLER_PARAMETERS,
          'rerun_bridge': parameters.BRIDGE_PARAMETERS}
PARAMETERS = {name: {item.name: item for item in table} for name, table in TABLES.items()}
# What stands for something of the reader's.
READERS = re.compile(r'my_|^\./|\.npz$|\.yaml$')


def shown(page: Path) -> list[str]:
    """Return the lines of the blocks for a shell, those that go on joined."""
    return [line for block in blocks(page, 'bash')
            for line in block.replace('\\\n', ' ').splitlines()]


def words_of(line: str) -> list[str]:
    """Return the command that a line calls and its arguments; nothing of any other program."""
    words = shlex.split(line.partition(' > ')[0], comments=True)
    for begin in (['ros2', 'run', 'hnn_vi_ros'], ['hnn']):
        for k in range(len(words)):
            if words[k:k + len(begin)] == begin:
                return words[k + len(begin):]
    return []


def misunderstood(name: str, *rest: str) -> Iterator[str]:
    """Yield what a command that a page shows has wrong; exits where its options are."""
    arguments, _, of_ros = ' '.join(rest).partition('--ros-args')
    found = vars(parser_of(name).parse_args(arguments.split()))
    for assignment in re.findall(r'-p (\S+)', of_ros):
        parameter, _, value = assignment.partition(':=')
        if parameter == 'use_sim_time':
            continue    # ROS's own, of every node
        item = PARAMETERS[name][parameter]
        kind = type(item.default)
        item.check(value == 'true' if kind is bool else kind(value))
        if parameter == 'scene':
            found['scene'] = value
    for kind in ('scene', 'config', 'sweep'):
        named = found.get(kind)
        if isinstance(named, str | Path) and not READERS.search(str(named)) and \
                str(named) not in shipped_names({'config': 'training'}.get(kind, kind)):
            yield f'there is no {kind} {named}'


def test_commands_that_pages_show_are_understood():
    assert words_of('srun ros2 run hnn_vi_ros scene --list > a  # b') == ['scene', '--list']
    commands = {(page.relative_to(ROOT).as_posix(), tuple(words)) for page in PAGES
                for line in shown(page) if (words := words_of(line))}
    assert len(commands) > 40
    assert {'README.md', 'docs/tutorials/urdf-arm.md'} < {page for page, _ in commands}
    wrong = []
    for page, words in sorted(commands):
        try:
            wrong += [f'{page}: {" ".join(words)}: {problem}' for problem in misunderstood(*words)]
        except (SystemExit, LookupError, ValueError) as problem:
            wrong.append(f'{page}: {" ".join(words)}: {problem!r}')
    assert not wrong, '\n'.join(wrong)


def test_commands_that_are_named_in_a_sentence_are_there():
    # NAME stands for any of them, {name} for the one that a program fills in.
    named = {(name, path.name) for path in (
        *PAGES, *ROOT.glob('*.md'), *(ROOT / 'config').rglob('*.yaml'),
        *python_files('hnn_vi_ros', 'launch'))
        for name in re.findall(r'ros2 run hnn_vi_ros (\w+)', path.read_text(encoding='utf-8'))
        if name != 'NAME'}
    assert len(named) > 20
    wrong = {(name, page) for name, page in named if name not in EXECUTABLES}
    wrong |= {(name, page.name) for page in PAGES for name in re.findall(
        r'`hnn ([a-z_]+)[ `]', page.read_text(encoding='utf-8')) if name not in COMMANDS}
    assert not wrong
