# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Enforce the architecture: which module may import what, and what every file must be like."""

import ast
from collections.abc import Iterator
from pathlib import Path
import re
import sys
from xml.etree import ElementTree

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.version import __version__
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'hnn_vi_ros'
MODULES = sorted(PACKAGE.rglob('*.py'))
TEST_FILES = sorted((ROOT / 'test').rglob('test_*.py'))
PYTHON_FILES = [*MODULES, *sorted((ROOT / 'test').rglob('*.py')), ROOT / 'setup.py',
                *sorted((ROOT / 'launch').glob('*.py'))]

# The folders and files whose names stand for a layer; the first that fits counts.
LAYERS = {
    'ros': 'ros', 'studies': 'studies', 'learning': 'learning', 'sinks': 'sinks', 'cli': 'cli',
    'scene': 'scene', 'ensemble': 'scene', 'scene_tool': 'cli',
    **dict.fromkeys(('automatic_choice', 'build', 'calibration', 'events', 'lyapunov',
                     'path_reference'), 'scene'),
    'recover_bag': 'cli', '__init__': 'cli',
}
ARROWS = {
    'core': {'core'},
    'scene': {'core', 'scene'},
    'sinks': {'core', 'sinks'},
    'learning': {'core', 'learning', 'scene', 'sinks'},
    'studies': {'core', 'scene', 'sinks', 'learning', 'studies'},
    'ros': {'core', 'scene', 'sinks', 'studies', 'ros'},
    'cli': {'core', 'scene', 'sinks', 'learning', 'studies', 'ros', 'cli'},
}
CORE_LIBRARIES = {'numpy', 'numba', 'scipy', 'llvmlite', 'pydantic', 'yaml', 'safetensors'}
# Heavy or ROS-only packages: the files that may import them, at the top or inside a function.
HOMES = {
    'launch': r'ros/launching\.py', 'launch_ros': r'ros/launching\.py',
    'torch': r'learning/(families/)?\w+\.py|hamiltonians/torch_module\.py|studies/peers\.py',
    'torchdiffeq': r'studies/peers\.py',
    'jax': r'studies/peers\.py',
    'diffrax': r'studies/peers\.py',
    'mcap': r'sinks/(mcap|bag|sqlite)_\w+\.py',
    'zstandard': r'sinks/(mcap|bag|sqlite)_\w+\.py',
    'lz4': r'sinks/(mcap|bag|sqlite)_\w+\.py',
    'rerun': r'sinks/rerun_\w+\.py',
    'contourpy': r'sinks/phase_portrait\.py',
    'matplotlib': r'learning/\w+\.py|studies/\w+\.py',
    'tqdm': r'learning/\w+\.py|studies/\w+\.py',
}
ROS = {'rclpy', 'rcl_interfaces', 'std_msgs', 'sensor_msgs', 'rosgraph_msgs', 'builtin_interfaces',
       'diagnostic_msgs', 'geometry_msgs', 'visualization_msgs', 'ament_index_python',
       'lifecycle_msgs', 'std_srvs', 'rosidl_runtime_py'}


def relative(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def layer(module: str) -> str:
    first = module.split('.')[1] if '.' in module else '__init__'
    return LAYERS.get(first, 'core')


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test).endswith('TYPE_CHECKING')


def imports(path: Path) -> Iterator[tuple[str, bool]]:
    """Yield each imported module and whether the import runs when the file is imported."""
    def walk(node: ast.AST, at_top: bool) -> Iterator[tuple[str, bool]]:
        for child in ast.iter_child_nodes(node):
            if is_type_checking(child):
                continue
            if isinstance(child, ast.Import):
                yield from ((alias.name, at_top) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f'{path}:{child.lineno}: a relative import'
                yield child.module, at_top
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            yield from walk(child, at_top and not inside)
    yield from walk(ast.parse(path.read_text()), True)


@pytest.mark.parametrize('path', MODULES, ids=relative)
def test_imports_follow_the_arrows(path):
    own = layer('.'.join(('hnn_vi_ros', *path.relative_to(PACKAGE).with_suffix('').parts)))
    for module, _ in imports(path):
        if module.partition('.')[0] == 'hnn_vi_ros':
            assert layer(module) in ARROWS[own], f'{own} imports {module}'


@pytest.mark.parametrize('path', MODULES, ids=relative)
def test_packages_are_imported_only_in_their_homes(path):
    own = relative(path)
    for module, at_top in imports(path):
        package = module.partition('.')[0]
        if package in ROS:
            assert own.startswith('ros/'), f'{own} imports {module}'
        elif package == 'torch' and not at_top:
            continue  # loaded on demand: the node's path on a shipped model loads none
        elif package in HOMES:
            assert re.fullmatch(HOMES[package], own), f'{own} imports {module}'
        elif package != 'hnn_vi_ros' and package not in sys.stdlib_module_names:
            assert package in CORE_LIBRARIES, f'{own} imports {module}'


def test_version_is_the_same_everywhere():
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    setup = re.search(r"version='(.*)'", (ROOT / 'setup.py').read_text())
    changelog = re.search(r'^(\d+\.\d+\.\d+) \(', (ROOT / 'CHANGELOG.rst').read_text(), re.M)
    assert manifest.findtext('version') == __version__
    assert setup is not None and setup.group(1) == __version__
    assert changelog is not None and changelog.group(1) == __version__


def test_every_executable_names_a_function_of_cli():
    entries = re.findall(r"'\w+ = hnn_vi_ros\.cli:(\w+)'", (ROOT / 'setup.py').read_text())
    tree = ast.parse((PACKAGE / 'cli.py').read_text())
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert entries and set(entries) <= functions


@pytest.mark.parametrize('path', PYTHON_FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_file_is_short_licensed_and_free_of_machine_paths(path):
    text = path.read_text()
    lines = text.splitlines()
    assert len(lines) <= 400 or path in TEST_FILES
    assert lines[0] == '# Copyright 2026 The hnn_vi_ros Authors'
    assert lines[1] == '# SPDX-License-Identifier: Apache-2.0'
    assert not re.search(r'["\'\s]/(?:home|root|Users|work|tmp)/', text)


@pytest.mark.parametrize('path', TEST_FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_test_file_asserts_something(path):
    tree = ast.parse(path.read_text())
    tests = [node for node in ast.walk(tree)
             if isinstance(node, ast.FunctionDef) and node.name.startswith('test_')]
    assert tests
    assert any(isinstance(node, ast.Assert) for test in tests for node in ast.walk(test))


@pytest.mark.parametrize('effect', EFFECTS.values(), ids=lambda effect: effect.__name__)
def test_effect_is_a_file_of_its_own_of_at_most_100_lines(effect):
    path = PACKAGE.parent / f'{effect.__module__.replace(".", "/")}.py'
    classes = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.ClassDef)]
    assert [node.name for node in classes] == [effect.__name__]
    assert len(path.read_text().splitlines()) <= 100
