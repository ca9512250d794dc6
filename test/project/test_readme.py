# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that pages show are understood, and the code that they show runs."""

from collections.abc import Iterator
from pathlib import Path
import re
import shlex
import subprocess
import sys

from hnn_vi_ros.commands.table import COMMANDS, parser_of
from hnn_vi_ros.files.resources import shipped_names
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.data.bags import BagData
from hnn_vi_ros.ros import settings as parameters
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
from sources import blocks, python_files, ROOT
import yaml

PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md')),
         *sorted((ROOT / 'docs').glob('[!_]*/*.md'))]
TABLES = {'simulator': parameters.PARAMETERS, 'replay': parameters.REPLAY_PARAMETERS,
          'controller': parameters.CONTROLLER_PARAMETERS}
PARAMETERS = {name: {item.name: item for item in table} for name, table in TABLES.items()}
# What stands for something of the reader's.
READERS = re.compile(r'my_|^\./|\.npz$|\.yaml$')


def shown(page: Path) -> list[str]:
    """Return the lines of the blocks for a shell, those that go on joined."""
    return [line for block in blocks(page, 'bash')
            for line in block.replace('\\\n', ' ').splitlines()]


def test_readme_begins_with_the_two_commands_of_a_new_machine_which_ci_calls():
    first = [line.partition('  ')[0] for line in shown(ROOT / 'README.md')[:3]]
    assert first[1:] == ['make run', 'make test']
    called = (ROOT / '.ci' / 'run').read_text()
    assert all(re.search(rf'^ *(time )?{command}\b', called, re.M) for command in first[1:])


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
    assert words_of('srun ros2 run hnn_vi_ros list scenes > a  # b') == ['list', 'scenes']
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
    called = r'(?:ros2 run hnn_vi_ros|[`\'"]hnn|with: hnn) (?!hnn\b)([a-z_]+)\b'
    named = {(name, path.name) for path in (
        *PAGES, *ROOT.glob('*.md'), *(ROOT / 'config').rglob('*.yaml'),
        *python_files('hnn_vi_ros', 'launch'))
        for name in re.findall(called, path.read_text(encoding='utf-8'))}
    assert len(named) > 20
    assert not {(name, page) for name, page in named if name not in COMMANDS}


# Code.

SHIPPED_SCENE = ROOT / 'config' / 'scenes' / 'harmonic_oscillator.yaml'


def run(code: str, names: dict[str, object] | None = None) -> dict[str, object]:
    """Run a block of Python; return its names."""
    names = {} if names is None else names
    exec(compile(code, 'page', 'exec'), names)
    return names


def test_listener_of_the_tutorial_is_the_executable():
    source = (ROOT / 'hnn_vi_ros/ros/listener_node.py').read_text(encoding='utf-8')
    (listener,) = (block for block in blocks(ROOT / 'docs/tutorials/first-simulation.md', 'python')
                   if 'class Listener' in block)
    # What a RobustNode is more than a Node is of no interest there.
    _, _, body = listener.strip().partition('class Listener(Node):\n')
    assert body and f'class Listener(RobustNode):\n{body}' in source


def test_first_scene_of_a_page_is_a_shipped_one():
    for page in ('README.md', 'docs/tutorials/scene.md'):
        assert blocks(ROOT / page, 'yaml')[0] == SHIPPED_SCENE.read_text(encoding='utf-8'), page


def test_data_of_a_bag_are_valid_as_the_page_shows_them():
    data = blocks(ROOT / 'docs/how-to/log-to-model.md', 'yaml')[0]
    assert BagData.model_validate(yaml.safe_load(data)['data']).block == 2.0


def test_readme_python_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(ROOT / 'README.md', 'python')
    run(example)
    exact, learned = capsys.readouterr().out.splitlines()
    assert exact.startswith('(1001, 1) ') and float(exact.split()[-1]) < 1e-14
    assert learned.startswith('(1001, 1) 0.0025')
    assert (tmp_path / 'oscillator.png').is_file()


def test_python_tutorial_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for example in blocks(ROOT / 'docs/tutorials/python.md', 'python'):
        run(example, names)
    assert '(2, 1000, 1)' in capsys.readouterr().out
    assert names['pushed'].work[-1] != 0.0


def test_quadrotor_of_the_tutorial_climbs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(ROOT / 'docs/tutorials/quadrotor.md', 'python')
    names = run(example)
    # A tenth of g for 2 s is 1.962 m; the drag takes less than a tenth of that.
    height = names['height']
    assert 0.9 * 1.962 < height[-1] - height[0] < 1.962


def test_bag_example_reads_the_bag_of_a_run(tmp_path, monkeypatch, capsys):
    values = {'duration': 1, 'real_time_factor': 0, 'rerun_sink': 'none', 'discovery_time': 0}
    subprocess.run(
        [sys.executable, '-c', 'from hnn_vi_ros.cli import simulator; simulator()', '--ros-args',
         *[word for name, value in values.items() for word in ('-p', f'{name}:={value}')]],
        cwd=tmp_path, capture_output=True, timeout=120, check=True)
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(ROOT / 'docs/how-to/bags.md', 'python')
    run(example)
    assert re.match(r'runs/harmonic_oscillator-.*/bag 1.0 s 0.[45]\d+ J', capsys.readouterr().out)


def test_effect_of_your_own_works():
    (source,) = blocks(ROOT / 'docs/how-to/effects.md', 'python')
    names = run(source, {'__name__': 'wind'})
    wind = names['Wind']('x', coefficient=0.5, speed=2.0)
    simulation = Simulation(HAMILTONIANS['free_particle'](), INTEGRATORS['gauss8'](), 0.1, [0.0],
                            [0.0], [wind])
    simulation.advance(10)
    # v = u (1 - exp(-b t / m)); the round-off of ten steps.
    assert simulation.p[0] == pytest.approx(2.0 * (1.0 - np.exp(-0.5)), abs=1e-13)
    assert simulation.works['Wind'] == pytest.approx(simulation.energy, abs=1e-13)
