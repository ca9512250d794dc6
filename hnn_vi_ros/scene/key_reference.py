# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reference of keys, from the schema: text for ``hnn list effects NAME``, tables for the docs."""

from collections.abc import Iterator, Mapping
import json
import re
from textwrap import fill
from typing import Any, NamedTuple

from hnn_vi_ros.errors import did_you_mean, listed, ParameterError
from hnn_vi_ros.files import json_schema
from hnn_vi_ros.scene.scene import Scene

# Key of a scene that takes the kinds of each list.
SCENE_KEYS = {'hamiltonians': 'hamiltonian', 'integrators': 'integrator', 'effects': 'effects'}
# Examples of kinds that need more than their name.
_EXAMPLES = {
    'hnn': 'model: pendulum', 'learned': 'model: pendulum',
    'python': "factory: 'my_module:create'",
    'formula': "coordinates: [x], H: 'p_x^2 / (2*m) + k*x^4 / 4', parameters: {m: 1.0, k: 2.0}",
    'urdf': 'file: my_robot.urdf', 'auto': 'path_error: 0.001, horizon: 10.0',
    'discrete_euler_lagrange': "discrete_lagrangian: 'my_module:L_d', order: 2",
    'gravity': 'coordinate: z', 'spring': 'point: [x, z], anchor: [0.0, 0.0], stiffness: 5.0',
    'magnetic_field': 'plane: [x, y], field: 2.0',
    'soft_wall': 'coordinate: z, position: 0.0, stiffness: 1000.0',
    'potential': "formula: 'k*x^2 / 2', parameters: {k: 3.0}", 'damping': 'rate: 0.1',
    'dry_friction': 'coordinate: x, force: 0.5',
    'quadratic_drag': 'coordinates: [x], coefficient: 0.1',
    'periodic_drive': 'coordinate: x, amplitude: 1.0, frequency: 0.5',
    'external_force': 'coordinates: [x], timeout: 0.5',
    'servo': 'coordinates: [x], stiffness: 40.0, damping: 1.0, effort_limit: 3.0',
    'observer': 'coordinates: [x]', 'learned_dissipation': 'model: damped_pendulum',
    'learned_friction': 'model: dfki_double_pendulum',
    'thermostat': 'temperature: 0.1, rate: 0.5, seed: 1',
    'holonomic_constraint': 'point: [x, z], anchor: [0.0, 0.0], length: 1.0',
    'impact': 'coordinate: x, position: 0.0, restitution: 0.8',
    'joint_friction': 'damping: {x: 0.1}, friction: {x: 0.5}',
    'joint_limits': 'lower: {x: -1.0}, upper: {x: 1.0}',
    'lugre_friction': 'coordinate: x, stiffness: 200.0, friction: 0.5, damping: 0.2',
    'motor': 'coordinate: x, torque_limit: 12.0, no_load_speed: 20.0',
    'family rigid_body': 'file: my_robot.urdf',
}
_WIDTH = 99
_UNIT = re.compile(r'\s*((?:\[[^][]*\](?:, |/| or | and )?)+)\s*$')


class Key(NamedTuple):
    """A key of a kind: name, requirement, type, default as JSON ('' if none), unit, meaning."""

    name: str
    required: bool
    type: str
    default: str
    unit: str
    meaning: str


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of a scene."""
    return json.loads(json_schema(Scene, 'A scene of hnn_vi_ros'))


def definitions(part: str) -> dict[str, dict[str, Any]]:
    """
    Return the schema of each kind by name, in the order of the registry.

    Parameters
    ----------
    part : str
        A key of SCENE_KEYS.

    """
    schema, found = scene_schema(), dict[str, dict[str, Any]]()
    for name in dict.fromkeys(references(schema['properties'][SCENE_KEYS[part]])):
        one = schema['$defs'][name]
        kind = one['properties']['kind']
        found |= dict.fromkeys([kind['const']] if 'const' in kind else kind['enum'], one)
    return found


def references(node: Any) -> Iterator[str]:
    """Yield the names of the definitions that a part of a schema refers to."""
    if isinstance(node, dict):
        if '$ref' in node:
            yield node['$ref'].rpartition('/')[2]
        # The mapping of a union by kinds repeats its references.
        for key, value in node.items():
            if key != 'discriminator':
                yield from references(value)
    elif isinstance(node, list):
        for value in node:
            yield from references(value)


def keys_of(definition: dict[str, Any]) -> list[Key]:
    """Return the keys of a kind, except ``kind``."""
    found = []
    for name, one in definition.get('properties', {}).items():
        if name == 'kind':
            continue
        meaning = ' '.join(one.get('description', '').split()).rstrip('.')
        unit = _UNIT.search(meaning)
        found.append(Key(
            name, name in definition.get('required', ()), _type(one),
            json.dumps(one['default']) if one.get('default') is not None else '',
            unit[1] if unit else '', meaning[:unit.start()].rstrip() if unit else meaning))
    return found


def _type(schema: dict[str, Any]) -> str:
    if '$ref' in schema:
        return schema['$ref'].rpartition('/')[2]
    if 'enum' in schema:
        return ', '.join(map(str, schema['enum']))
    if 'const' in schema:
        return str(schema['const'])
    options = [one for key in ('anyOf', 'oneOf') for one in schema.get(key, ())]
    if any('oneOf' in one for one in options):
        return 'a kind, or one of those below'
    if options:
        words = [_type(one) for one in options if one.get('type') != 'null']
        return ' or '.join(dict.fromkeys(words)) if len(words) <= 4 else 'one of those below'
    if schema.get('type') == 'array':
        return f'list of {_type(schema["items"])}' if 'items' in schema else 'list'
    return {'object': 'mapping'}.get(schema.get('type', ''), str(schema.get('type', 'any')))


def example(part: str, name: str) -> str:
    """Return a kind as YAML, with the key of the scene or training configuration."""
    key = SCENE_KEYS.get(part, 'family')
    others = _EXAMPLES.get(name if part in SCENE_KEYS else f'family {name}')
    text = f'{{kind: {", ".join(filter(None, (name, others)))}}}'
    return f'{key}: [{text}]' if part == 'effects' else f'{key}: {text}'


def describe(part: str, name: str, found: Mapping[str, dict[str, Any]]) -> str:
    """
    Return description, keys with units and defaults, and an example of a kind, as plain text.

    Parameters
    ----------
    part, name : str
        The list, and the kind in it.
    found : mapping of str to dict
        Its kinds; see ``definitions``.

    Raises
    ------
    ParameterError
        The name is unknown.

    """
    if name not in found:
        raise ParameterError(f'{part} {name}: unknown{did_you_mean(name, found)}; valid: '
                             f'{listed(found)}')
    lines = [' '.join(found[name].get('description', '').split()), '']
    keys = keys_of(found[name])
    width = max([len(key.name) for key in keys], default=0)
    for key in keys:
        state = 'required' if key.required else f'default {key.default}' if key.default else ''
        facts = ', '.join(filter(None, (key.type, key.unit, state)))
        lines.append(fill(
            f'{key.meaning} ({facts})'.lstrip(), _WIDTH, initial_indent=f'  {key.name:{width}}  ',
            subsequent_indent=' ' * (width + 4), break_long_words=False, break_on_hyphens=False))
    return '\n'.join([*lines, *([] if not keys else ['']), f'Example: {example(part, name)}'])


def key_table(definition: dict[str, Any]) -> list[str]:
    """Return the keys of a kind as a Markdown table; required ones are bold."""
    rows = []
    for key in keys_of(definition):
        shown = f'**`{key.name}`**' if key.required else f'`{key.name}`'
        default = f', default `{key.default}`' if key.default else ''
        cells = (shown, f'{key.type} {key.unit}'.rstrip() + default, key.meaning)
        rows.append(f'| {" | ".join(cell.replace("|", chr(92) + "|") for cell in cells)} |')
    if not rows:
        return ['No keys except `kind`.']
    return ['| key | type, unit, default | meaning |', '|---|---|---|', *rows]
