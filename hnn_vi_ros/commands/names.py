# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""List names with a line each, or the keys of one name."""

from typing import Any

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.scene import definitions, describe, LISTS, SCENE_KEYS

# Lists whose names have keys.
WITH_KEYS = (*SCENE_KEYS, 'families')


def main(argv: list[str]) -> int:
    """Print a line for each name; with a name, its keys."""
    options = arguments.names().parse_args(argv)
    what, name = options.what, options.name
    if name is not None and what not in WITH_KEYS:
        raise ParameterError(f'{what} {name}: {what} have no keys; a NAME is valid after: '
                             f'{", ".join(WITH_KEYS)}')
    if name is not None:
        print(describe(what, name, schemas(what)))
        return 0
    found = LISTS[what]() if what in LISTS else {
        name: ' '.join(one['description'].partition('\n\n')[0].split())
        for name, one in schemas(what).items()}
    width = max(map(len, found))
    for name, description in found.items():
        print(f'{name:{width}}  {description}')
    return 0


def schemas(what: str) -> dict[str, dict[str, Any]]:
    """Return the JSON schema of each kind in one of WITH_KEYS; the families need torch."""
    if what in SCENE_KEYS:
        return definitions(what)
    from hnn_vi_ros.learning import family_schemas
    return {name: schema.model_json_schema() for name, schema in family_schemas().items()}
