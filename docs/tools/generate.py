# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of the site that are written from the code: parameters, scenes, errors, commands."""

from collections.abc import Iterator, Sequence
from importlib import import_module
import json
from pathlib import Path
import pkgutil
from typing import Any

from gallery import write_gallery
import hnn_vi_ros
from hnn_vi_ros.commands import COMMANDS, parser_of
from hnn_vi_ros.errors import AlarmWarning, HnnViRosError
from hnn_vi_ros.ros import settings as parameters
from hnn_vi_ros.run import OverrunGuard
from hnn_vi_ros.simulation import Guard
from live_page import write_live

# In the folder of the site's sources, and in no commit.
FOLDER = 'generated'
# Modules with user errors that are not in hnn_vi_ros.errors.
_OTHER_ERRORS = ('hnn_vi_ros.ros.worlds',)
_SCENE_PARTS = {'hamiltonian': 'Hamiltonians', 'integrator': 'Integrators', 'effects': 'Effects'}


def write_pages(docs: Path) -> None:
    """
    Write every generated page, the live page and the gallery.

    Parameters
    ----------
    docs : Path
        The folder of the site's sources.

    """
    folder = docs / FOLDER
    folder.mkdir(exist_ok=True)
    schema = json.loads((docs.parent / 'config' / 'scene.schema.json').read_text('utf-8'))
    pages = {
        'parameters.md': parameter_page(), 'commands.md': command_page(),
        'scene-keys.md': scene_page(schema), 'errors.part.md': error_table(),
        'alarms.part.md': alarm_table()}
    for name, text in pages.items():
        _write(folder / name, text)
    write_live(folder / 'live.html')
    write_gallery(docs)


def parameter_page() -> str:
    """Return the page on the parameters of the nodes, from their declarations."""
    text = ['# Parameters', '', (
        'Generated from the declarations in `hnn_vi_ros/ros`. A parameter that can be set '
        '*always* takes effect between two steps. Set them with `--ros-args -p NAME:=VALUE`, in a '
        'parameter file, as an argument of a launch file, or with `ros2 param set`.'), '']
    for node, table in (('simulator', parameters.PARAMETERS),
                        ('controller', parameters.CONTROLLER_PARAMETERS),
                        ('replay', parameters.REPLAY_PARAMETERS),
                        ('rerun_bridge', parameters.BRIDGE_PARAMETERS)):
        changes = ' can be set |' if node == 'simulator' else ''
        text += [f'## {node}', '', f'| parameter | default | unit |{changes} meaning |',
                 '|---|---|---|---|' + '---|' * bool(changes),
                 markdown_table(table), '']
    return '\n'.join(text)


def markdown_table(table: Sequence[parameters.Specification]) -> str:
    """Return parameters as rows of a table, with when they change if that differs."""
    rows, differs = [], len({item.changes for item in table}) > 1
    for item in table:
        choices = f' ({", ".join(item.choices)})' if item.choices else ''
        changes = f'{item.changes} | ' if differs else ''
        rows.append(f'| `{item.name}` | {parameters.as_markdown(item.default)} | {item.unit} | '
                    f'{changes}{item.description}{choices} |')
    return '\n'.join(rows)


def command_page() -> str:
    """Return the page on the executables, with the output of `--help`."""
    text = ['# Commands', '', (
        'If the package was installed with pip, run `hnn NAME`. In a ROS workspace run `ros2 run '
        'hnn_vi_ros NAME`; `hnn` is in `lib/hnn_vi_ros`. `run`, `cost`, `doctor` and `completion` '
        'are commands of `hnn` only.'), '']
    for name in COMMANDS:
        text += [f'## {name}', '', '```text', parser_of(name).format_help().strip(), '```', '']
    return '\n'.join(text)


def scene_page(schema: dict[str, Any]) -> str:
    """Return the page on the keys of a scene, from the schema of its YAML."""
    text = ['# Keys of a scene', '', (
        'Generated from `config/scene.schema.json`, with which editors complete and check scenes. '
        'Keys in **bold** are required.'), '', '## The scene', '',
        *_key_table(schema), '']
    for key, title in _SCENE_PARTS.items():
        text += [f'## {title}', '', f'Choices of `{key}`, listed by `kind`.', '']
        for name in dict.fromkeys(_references(schema['properties'][key])):
            one = schema['$defs'][name]
            kind = one['properties'].get('kind', {})
            kinds = [kind['const']] if 'const' in kind else kind.get('enum', [name])
            text += [f'### {", ".join(kinds)}', '', _sentence(one.get('description', '')), '',
                     *_key_table(one), '']
    rest = [name for name in schema['$defs'] if name not in {
        *(found for key in _SCENE_PARTS for found in _references(schema['properties'][key]))}]
    text += ['## Other parts', '']
    for name in rest:
        one = schema['$defs'][name]
        text += [f'### {name}', '', _sentence(one.get('description', '')), '',
                 *_key_table(one), '']
    return '\n'.join(text)


def errors() -> list[type[Exception]]:
    """Return every error and warning that users can meet, once."""
    for module in _OTHER_ERRORS:
        import_module(module)
    return [*_subclasses(HnnViRosError), AlarmWarning]


def guards() -> list[type[Guard]]:
    """Return every guard whose alarm users can meet."""
    for module in pkgutil.iter_modules(import_module('hnn_vi_ros.simulation.guards').__path__):
        import_module(f'hnn_vi_ros.simulation.guards.{module.name}')
    assert issubclass(OverrunGuard, Guard)
    # Bases of several guards have no kind of their own.
    return [guard for guard in _subclasses(Guard) if hasattr(guard, 'kind')
            and guard.__module__.startswith('hnn_vi_ros')]


def error_table() -> str:
    """Return a row for each error: its class, when it is raised, the remedy."""
    rows = [f'| `{error.__name__}` | {_first(error)} | {_sentence(error.remedy)} |'
            for error in errors()]
    return '\n'.join(['| error | raised when | remedy |', '|---|---|---|', *rows, ''])


def alarm_table() -> str:
    """Return a row for each alarm: its name, the condition that it checks, the remedy."""
    names = {'not conserved': '`<name> not conserved`',
             'not resolved': '`<barrier> not resolved`'}
    rows = [f'| {names.get(guard.kind, f"`{guard.kind}`")} | {_first(guard)} | '
            f'{_sentence(guard.remedy)} |' for guard in guards()]
    return '\n'.join(['| alarm | checked condition | remedy |', '|---|---|---|', *rows, ''])


def _subclasses(base: type) -> Iterator[Any]:
    for cls in base.__subclasses__():
        if cls.__module__.startswith(hnn_vi_ros.__name__):
            yield cls
            yield from _subclasses(cls)


def _first(cls: type) -> str:
    """Return the first sentence of a docstring, on one line."""
    return ' '.join((cls.__doc__ or '').strip().partition('\n\n')[0].split()).replace('|', r'\|')


def _sentence(text: str) -> str:
    text = ' '.join(text.split())
    return f'{text[:1].upper()}{text[1:]}{"" if text.endswith((".", ":")) or not text else "."}'


def _references(node: Any) -> Iterator[str]:
    """Yield the names of the definitions that a part of a schema refers to."""
    if isinstance(node, dict):
        if '$ref' in node:
            yield node['$ref'].rpartition('/')[2]
        # The mapping of a union by kinds says the same again.
        for key, value in node.items():
            if key != 'discriminator':
                yield from _references(value)
    elif isinstance(node, list):
        for value in node:
            yield from _references(value)


def _key_table(schema: dict[str, Any]) -> list[str]:
    """Return the keys of an object as a table."""
    rows = []
    for name, one in schema.get('properties', {}).items():
        if name == 'kind':
            continue
        shown = f'**`{name}`**' if name in schema.get('required', ()) else f'`{name}`'
        default = f'`{json.dumps(one["default"])}`' if one.get('default') is not None else ''
        meaning = one.get('description', '').replace('|', r'\|').replace('\n', ' ')
        rows.append(f'| {shown} | {_type(one)} | {default} | {meaning} |')
    if not rows:
        return ['No keys except `kind`.']
    return ['| key | type | default | meaning |', '|---|---|---|---|', *rows]


def _type(schema: dict[str, Any]) -> str:
    """Return the type of a key in a few words."""
    if '$ref' in schema:
        return schema['$ref'].rpartition('/')[2]
    if 'enum' in schema:
        return ', '.join(f'`{value}`' for value in schema['enum'])
    if 'const' in schema:
        return f'`{schema["const"]}`'
    options = [one for key in ('anyOf', 'oneOf') for one in schema.get(key, ())]
    if any('oneOf' in one for one in options):
        return 'a kind, or one of those below'
    if options:
        words = [_type(one) for one in options if one.get('type') != 'null']
        return ' or '.join(dict.fromkeys(words)) if len(words) <= 4 else 'one of those below'
    if schema.get('type') == 'array':
        return f'list of {_type(schema["items"])}' if 'items' in schema else 'list'
    if schema.get('type') == 'object':
        return 'mapping'
    return str(schema.get('type', 'any'))


def _write(path: Path, text: str) -> None:
    """Write a file only if it changes, so that Sphinx reads only new files again."""
    if not path.is_file() or path.read_text('utf-8') != text:
        path.write_text(text, encoding='utf-8')
