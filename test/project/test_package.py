# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Enforce the architecture: which module may import what, and what every file must be like."""

import ast
from functools import cache
import inspect
from pathlib import Path
import re
import sys
from xml.etree import ElementTree

import hnn_vi_ros
from hnn_vi_ros import cli
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.exports import exported
from hnn_vi_ros.hamiltonians import DESCRIBED, HAMILTONIANS
from hnn_vi_ros.version import __version__
import pytest
from sources import MODULES, PACKAGE, PYTHON_FILES, relative, ROOT, TEST_FILES, text, tree
import yaml

# The rooms and the modules beside them, from the ground up; each imports only what is before it.
FLOORS = (
    'version', 'exports', 'phase_space', 'errors', 'files', 'kernels', 'hamiltonians', 'models',
    'integrators', 'effects', 'scene', 'recording', 'simulation', 'torch', 'control', 'run',
    'learning', 'identify', 'sweeps', 'codegen', 'envs', 'ros', 'commands', 'cli',
    '__main__', '__init__')
# The same inside two rooms.
INNER_FLOORS = {
    'learning': ('arguments', 'torch_file', 'data', 'families', 'fit', 'judging', 'linear_systems',
                 'graph_of_module', 'export_module', 'import_model', 'user_module', 'tasks',
                 'train', 'evaluate'),
    'ros': ('worlds', 'plumbing', 'settings', 'node_parameters', 'arguments', 'recording',
            'topics', 'replay', 'run', 'services', 'initial_state',
            'controller_node', 'listener_node', 'launching', 'simulator_node')}
REGISTRIES = {'effects': EFFECTS, 'hamiltonians': HAMILTONIANS | DESCRIBED}
CORE_LIBRARIES = {'numpy', 'numba', 'scipy', 'llvmlite', 'pydantic', 'yaml', 'safetensors'}
# Heavy or ROS-only packages: the files that may import them, at the top or inside a function.
HOMES = {
    'launch': r'ros/launching\.py', 'launch_ros': r'ros/launching\.py',
    'torch': r'(learning|identify)/(\w+/)?\w+\.py|models/torch_\w+\.py|torch\.py'
             r'|simulation/(batches|trajectory)/\w+\.py',
    'mcap': r'recording/bags/(mcap|bag)_\w+\.py|learning/data/\w+\.py',
    'zstandard': r'recording/bags/(mcap|bag)_\w+\.py',
    'lz4': r'recording/bags/(mcap|bag)_\w+\.py',
    'rosbags': r'learning/data/sqlite_bag\.py',
    'heyoka': r'integrators/taylor\.py',
    'gymnasium': r'envs\.py',
    'pyarrow': r'sweeps/parquet\.py',
    'ray': r'sweeps/ray_cluster\.py',
    'argcomplete': r'commands/completion\.py',
    'rerun': r'recording/viewer/rerun_\w+\.py',
    'rerun_cli': r'recording/viewer/rerun_stream\.py',
    'contourpy': r'recording/viewer/phase_portrait\.py',
    'matplotlib': r'(learning|identify)/(\w+/)?\w+\.py|simulation/trajectory/\w+\.py'
                  r'|commands/cost_figure\.py',
    'pandas': r'simulation/trajectory/\w+\.py|learning/data/tables\.py',
    'xarray': r'simulation/trajectory/\w+\.py',
    'control': r'control/linear\.py',
}
ROS = {'rclpy', 'rcl_interfaces', 'std_msgs', 'sensor_msgs', 'rosgraph_msgs', 'builtin_interfaces',
       'diagnostic_msgs', 'geometry_msgs', 'nav_msgs', 'visualization_msgs', 'ament_index_python',
       'lifecycle_msgs', 'std_srvs', 'trajectory_msgs', 'rosidl_runtime_py'}


def name_of(path: Path) -> str:
    """Return the name of a module within the package; that of its room for an __init__."""
    parts = path.relative_to(PACKAGE).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' and len(parts) > 1 else parts)


NAMES = {name_of(path): path for path in MODULES}


@cache
def exports_of(module: str) -> dict[str, str]:
    """Return the module of each name that a room exports; empty for any other module."""
    path = NAMES.get(module.partition('.')[2])
    return exported(path) if path is not None and path.name == '__init__.py' else {}


@cache
def imports(path: Path) -> list[tuple[str, bool]]:
    """
    Return each imported module and whether the import runs when the file is imported.

    Those for type checkers and those inside functions are among them.
    """
    found: list[tuple[str, bool]] = []

    def walk(node: ast.AST, at_top: bool) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                continue
            if isinstance(child, ast.Import):
                found.extend((alias.name, at_top) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f'{path}:{child.lineno}: a relative import'
                for alias in child.names:
                    full = f'{child.module}.{alias.name}'
                    found.append((full if full.partition('.')[2] in NAMES
                                  else exports_of(child.module).get(alias.name, child.module),
                                  at_top))
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            unused = isinstance(child, ast.If) and ast.unparse(child.test) == 'TYPE_CHECKING'
            walk(child, at_top and not inside and not unused)
    walk(tree(path), True)
    return found


@cache
def own_imports(name: str, at_once: bool = False) -> set[str]:
    """Return the modules of this package that a module imports, anywhere in it or at once."""
    if NAMES[name].name == '__init__.py' and name != '__init__':
        # A room imports what it exports when that is used, by those who use it.
        return set()
    return {module.partition('.')[2] or '__init__' for module, at_top in imports(NAMES[name])
            if module.partition('.')[0] == 'hnn_vi_ros' and (at_top or not at_once)} - {name}


def test_imports_run_downwards():
    wrong = []
    for own in NAMES:
        room, *boxes = own.split('.')
        assert room in FLOORS, f'{own} has no floor'
        inner = INNER_FLOORS.get(room, ()) if boxes else ()
        assert not inner or boxes[0] in inner, f'{own} has no floor'
        for module in own_imports(own):
            other, *others = module.split('.')
            if FLOORS.index(other) > FLOORS.index(room) or (
                    inner and other == room and others
                    and inner.index(others[0]) > inner.index(boxes[0])):
                wrong.append(f'{own} imports {module}')
    assert not wrong, '\n'.join(wrong)


def test_other_rooms_import_from_the_room_and_not_from_its_files():
    wrong = [f'{own} imports from {node.module}' for own, path in NAMES.items()
             for node in ast.walk(tree(path)) if isinstance(node, ast.ImportFrom)
             and re.match(r'hnn_vi_ros\.\w+\.', node.module or '')
             and (node.module or '').split('.')[1] != own.partition('.')[0] and own != '__init__']
    assert not wrong, '\n'.join(wrong)


def test_every_name_that_a_room_exports_is_defined_where_it_says():
    wrong = []
    for room, path in NAMES.items():
        for name, module in (exported(path) if path.name == '__init__.py' else {}).items():
            home = tree(NAMES[module.partition('.')[2]])
            defined = {node.name for node in home.body
                       if isinstance(node, ast.ClassDef | ast.FunctionDef)}
            defined |= {node.id for node in ast.walk(home)
                        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
            if name not in defined and name not in exported(NAMES[module.partition('.')[2]]):
                wrong.append(f'{room} exports {name} of {module}')
    assert not wrong, '\n'.join(wrong)


def test_no_public_class_has_the_name_of_one_in_another_file():
    files: dict[str, list[str]] = {}
    for path in MODULES:
        for node in tree(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith('_'):
                files.setdefault(node.name, []).append(relative(path))
    assert {name: where for name, where in files.items() if len(where) > 1} == {}


def test_tests_stand_in_the_rooms_of_what_they_test():
    assert {path.name for path in (ROOT / 'test').glob('*.*')} == {'code_size.py', 'conftest.py'}
    folders = {path.relative_to(ROOT / 'test').parts[0] for path in TEST_FILES}
    # Beside them, what is asked of all methods and effects, the studies of docs/studies, and what
    # is asked of the repository.
    assert folders - {'verification', 'studies', 'project'} <= set(FLOORS) - {'__init__'}


def test_no_module_imports_itself_around_a_circle():
    # Between rooms there is none of any kind: see above. Inside a room, what is imported later, in
    # a function or for types, may be the module whose methods hand out this one's.
    graph = {name: own_imports(name, at_once=True) for name in NAMES}
    # The registry of a room imports what stands in it; what does is not to import the registry.
    done: set[str] = set()
    while free := {name for name, needed in graph.items() if needed <= done} - done:
        done |= free
    assert not graph.keys() - done, 'circles among these, or above them'


def test_what_a_registry_lists_is_imported_by_it_alone():
    # A new one is its file and its row; only what is about some of them, and not about any scene,
    # knows those by name.
    listed = {cls.__module__.partition('.')[2] for registry in REGISTRIES.values()
              for cls in registry.values()}
    # A system that is written as a formula is a kind of its own, and the base of others.
    listed -= {'hamiltonians.formula'}
    wrong = [f'{own} imports {module}' for own in NAMES
             if not own.startswith(('learning.', 'identify.', 'commands.new_scene'))
             and not own.endswith('.registry')
             for module in own_imports(own) & listed]
    assert not wrong, '\n'.join(wrong)
    files = [effect.__module__ for effect in EFFECTS.values()]
    assert len(set(files)) == len(files), 'an effect is a file of its own'


def may_import(own: str, module: str, at_top: bool) -> bool:
    """Return whether a file of the package may import a module."""
    package = module.partition('.')[0]
    if package in ROS:
        return own.startswith('ros/')
    if package == 'torch' and not at_top:
        return True  # loaded on demand: the node's path on a shipped model loads none
    if package in HOMES:
        return re.fullmatch(HOMES[package], own) is not None
    return package in {'hnn_vi_ros', *sys.stdlib_module_names} | CORE_LIBRARIES


def test_packages_are_imported_only_in_their_homes():
    wrong = [f'{relative(path)} imports {module}' for path in MODULES
             for module, at_top in imports(path)
             if not may_import(path.relative_to(PACKAGE).as_posix(), module, at_top)]
    assert not wrong, '\n'.join(wrong)


def test_version_is_the_same_everywhere():
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    setup = re.search(r"version='(.*)'", (ROOT / 'setup.py').read_text())
    changelog = re.search(r'^(\d+\.\d+\.\d+) \(', (ROOT / 'CHANGELOG.rst').read_text(), re.M)
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    recipe = yaml.safe_load((ROOT / 'conda' / 'recipe.yaml').read_text())
    assert manifest.findtext('version') == citation['version'] == __version__
    assert recipe['context']['version'] == __version__
    assert setup is not None and setup.group(1) == __version__
    assert changelog is not None and changelog.group(1) == __version__


def test_recipe_of_conda_requires_what_pip_installs():
    recipe = yaml.safe_load((ROOT / 'conda' / 'recipe.yaml').read_text())
    block = re.search(r'install_requires=\[(.*?)\]', (ROOT / 'setup.py').read_text(), re.S)[1]
    wanted = {text.lower() for text in re.findall(r"'(.*?)'", block)} | {'python>=3.11'}
    # conda-forge has matplotlib without its windows under another name.
    assert {text.replace(' ', '').replace('-base', '') for text in
            recipe['requirements']['run']} == wanted


def test_public_names_are_complete_on_tab_and_typed():
    assert {*dir(hnn_vi_ros), '__version__'} == {*hnn_vi_ros.__all__}
    assert all(getattr(hnn_vi_ros, name) is not None for name in hnn_vi_ros.__all__)
    assert (PACKAGE / 'py.typed').is_file()


def test_every_executable_names_a_function_of_cli():
    entries = re.findall(r"'\w+ = hnn_vi_ros\.cli:(\w+)'", (ROOT / 'setup.py').read_text())
    assert entries and all(callable(getattr(cli, entry)) for entry in entries)
    with pytest.raises(AttributeError, match='no attribute'):
        cli.trian  # noqa: B018


def test_files_are_licensed_and_free_of_machine_paths():
    header = '# Copyright 2026 The hnn_vi_ros Authors\n# SPDX-License-Identifier: Apache-2.0\n'
    wrong = [relative(path) for path in PYTHON_FILES if not text(path).startswith(header)
             or re.search(r'["\'\s]/(?:home|root|Users|work|tmp)/', text(path))]
    assert not wrong, '\n'.join(wrong)


def test_docstrings_begin_with_a_verb_or_the_thing():
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    wrong = [f'{relative(path)}: {getattr(node, "name", "the module")}: {words.splitlines()[0]}'
             for path in MODULES for node in ast.walk(tree(path)) if isinstance(node, kinds)
             and re.match(r'(What|How|Whether|Where|Which|Who|Why|When|Tell)\b',
                          words := ast.get_docstring(node) or '')]
    assert not wrong, 'name the thing, or begin with a verb:\n' + '\n'.join(wrong)


def test_no_constant_of_a_module_is_assigned_twice():
    wrong = []
    for path in MODULES:
        names = [name.id for node in tree(path).body if isinstance(node, ast.Assign)
                 for target in node.targets for name in ast.walk(target)
                 if isinstance(name, ast.Name)]
        wrong += [f'{relative(path)}: {name}' for name in {*names} if names.count(name) > 1]
    assert not wrong, '\n'.join(wrong)


def test_test_files_assert_something():
    wrong = [relative(path) for path in TEST_FILES if not any(
        isinstance(node, ast.FunctionDef) and node.name.startswith('test_')
        and any(isinstance(line, ast.Assert) for line in ast.walk(node))
        for node in ast.walk(tree(path)))]
    assert not wrong, '\n'.join(wrong)


@pytest.mark.parametrize('name', [
    'simulate', 'simulate_many', 'simulate_spread', 'export', 'sweep'])
def test_signature_fits_a_screen(name):
    # Seven lines of eighty characters in the answer of help().
    assert len(str(inspect.signature(getattr(hnn_vi_ros, name)))) <= 560
