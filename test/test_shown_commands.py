# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command lines that pages show are understood: commands, options, parameters and files."""

from pathlib import Path
import re
import shlex

from hnn_vi_ros.commands.table import COMMANDS as KNOWN, parser_of
from hnn_vi_ros.files.resources import shipped_names
from hnn_vi_ros.ros import settings as parameters
import pytest

ROOT = Path(__file__).parents[1]
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
    blocks = re.findall(r'```bash\n(.*?)```', page.read_text(encoding='utf-8'), re.DOTALL)
    return [line for block in blocks for line in block.replace('\\\n', ' ').splitlines()]


def words_of(line: str) -> list[str]:
    """Return the command that a line calls and its arguments; nothing of any other program."""
    words = shlex.split(line.partition(' > ')[0], comments=True)
    for begin in (['ros2', 'run', 'hnn_vi_ros'], ['hnn']):
        for k in range(len(words)):
            if words[k:k + len(begin)] == begin:
                return words[k + len(begin):]
    return []


COMMANDS = sorted({(page.relative_to(ROOT).as_posix(), tuple(words)) for page in PAGES
                   for line in shown(page) if (words := words_of(line))})


def test_pages_show_commands_and_all_of_them_are_read():
    assert len(COMMANDS) > 40
    assert {'README.md', 'docs/tutorials/urdf-arm.md'} < {page for page, _ in COMMANDS}
    assert words_of('srun ros2 run hnn_vi_ros scene --list > a  # b') == ['scene', '--list']


@pytest.mark.parametrize('page, words', COMMANDS, ids=lambda one: ' '.join(one)[:60]
                         if isinstance(one, tuple) else one)
def test_command_of_a_page_is_understood(page, words):
    name, *rest = words
    arguments, _, of_ros = ' '.join(rest).partition('--ros-args')
    # Exits where an option, or what it takes, is not understood.
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
        if isinstance(named, str | Path) and not READERS.search(str(named)):
            folder = {'config': 'training'}.get(kind, kind)
            assert str(named) in shipped_names(folder), (kind, named)


@pytest.mark.parametrize('page', PAGES[:1] + sorted((ROOT / 'docs' / 'tutorials').glob('*.md')),
                         ids=lambda path: path.stem)
def test_executable_that_a_page_names_in_a_sentence_is_there(page):
    named = set(re.findall(r'`(?:ros2 run hnn_vi_ros|hnn) ([a-z_]+)[ `]',
                           page.read_text(encoding='utf-8')))
    assert named <= KNOWN.keys()
