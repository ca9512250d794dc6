# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read a YAML file into a pydantic model; every error names file, line and key."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import os
from pathlib import Path
import re
from typing import TypeVar

from hnn_vi_ros.errors import HnnViRosError
from pydantic import BaseModel, ConfigDict, ValidationError
import yaml

MAX_BYTES = 1 << 20
MAX_DEPTH = 20

Model = TypeVar('Model', bound=BaseModel)


class StrictModel(BaseModel):
    """A schema that refuses unknown keys, strings for numbers, NaN and infinity."""

    model_config = ConfigDict(extra='forbid', strict=True, allow_inf_nan=False, frozen=True)


class _Loader(yaml.SafeLoader):
    """Plain data only: no aliases, and 1e-3 is a number as in YAML 1.2."""


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$'), list('-+.0123456789'))


@dataclass(frozen=True)
class Places:
    """
    Where the keys of a YAML file stand in it.

    Parameters
    ----------
    path : Path
        The file.
    lines : dict of tuple of str to int
        The line of each key; the items of a list count as keys '0', '1', ...

    """

    path: Path
    lines: dict[tuple[str, ...], int]

    def follow(self, key: Sequence[str | int]) -> tuple[str, ...]:
        """Return the parts of a key or of a pydantic location that stand in the file."""
        followed: tuple[str, ...] = ()
        for part in key:
            if (*followed, str(part)) in self.lines:
                followed = (*followed, str(part))
        return followed

    def place(self, *key: str | int) -> str:
        """Return ``file:line: key``; of a key that is left out, the line of what would hold it."""
        line = self.lines[self.follow(key)]
        return f'{self.path}:{line}: {".".join(map(str, key)) or "the file"}'


def load_yaml(path: Path, schema: type[Model], error: type[HnnViRosError]) -> Model:
    """Read and validate one YAML file; see ``read_yaml``."""
    return read_yaml(path, schema, error)[0]


def read_yaml(path: Path, schema: type[Model], error: type[HnnViRosError]
              ) -> tuple[Model, Places]:
    """
    Read and validate one YAML file, and keep where its keys stand.

    Parameters
    ----------
    path : Path
        The file, of at most 1 MiB.
    schema : type of BaseModel
        What the file must hold.
    error : type of HnnViRosError
        The exception to raise, with one line: file, line, key, what is expected.

    """
    root = _compose(path, error)
    try:
        data = _Loader('').construct_document(root)
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as problem:
        raise error(f'{path}: {_one_line(problem)}') from problem
    places = Places(path, dict(_lines(root, (), root.start_mark.line + 1)))
    try:
        return schema.model_validate(data), places
    except ValidationError as problem:
        raise error(_describe(places, schema, problem)) from problem


def _compose(path: Path, error: type[HnnViRosError]) -> yaml.Node:
    try:
        if not os.path.isfile(path):
            raise error(f'{path}: no such file')
        with path.open('rb') as stream:
            raw = stream.read(MAX_BYTES + 1)
        if len(raw) > MAX_BYTES:
            raise error(f'{path}: larger than {MAX_BYTES} bytes, which no such file needs')
        text = raw.decode('utf-8')
        _refuse_aliases_and_depth(path, text, error)
        root = yaml.compose(text, _Loader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, ValueError) as problem:
        raise error(f'{path}: {_one_line(problem)}') from problem
    if not isinstance(root, yaml.MappingNode):
        raise error(f'{path}: expected a mapping of keys to values')
    _refuse_duplicate_keys(path, root, error)
    return root


def _refuse_aliases_and_depth(path: Path, text: str, error: type[HnnViRosError]) -> None:
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1
            raise error(f'{path}:{line}: aliases are not supported; write the value out')
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            raise error(f'{path}:{event.start_mark.line + 1}: nested deeper than {MAX_DEPTH}')


def _refuse_duplicate_keys(path: Path, node: yaml.Node, error: type[HnnViRosError]) -> None:
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_duplicate_keys(path, item, error)
    if isinstance(node, yaml.MappingNode):
        seen = set()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.value in seen:
                line = key.start_mark.line + 1
                raise error(f'{path}:{line}: a key must be a plain name and stand only once')
            seen.add(key.value)
            _refuse_duplicate_keys(path, value, error)


def _describe(places: Places, schema: type[BaseModel], problem: ValidationError) -> str:
    problems = problem.errors(include_url=False)
    # A misspelt key is reported as unknown rather than as missing under its right name; of the
    # types that a value may have, the one that it fits best is the one that was meant.
    first = max(problems, key=lambda p: (p['type'] == 'extra_forbidden', len(p['loc'])))
    loc, problem_type, key = first['loc'], first['type'], places.follow(first['loc'])
    if problem_type == 'extra_forbidden':
        valid = {name for owner in _schemas_at(schema, loc[:-1]) for name in owner.model_fields}
        message = f'unknown key; valid keys: {", ".join(sorted(valid))}'
    elif problem_type in ('union_tag_invalid', 'union_tag_not_found'):
        key, tag = (*key, 'kind'), first['ctx'].get('tag')
        message = 'required' if tag is None else f'unknown kind {tag!r}'
        message += f'; valid kinds: {", ".join(sorted(map(_kind, _schemas_at(schema, loc))))}'
    elif problem_type in ('model_type', 'model_attributes_type'):
        message = 'expected keys and values, as in {key: value}'
    elif problem_type == 'missing':
        key, message = (*key, str(loc[-1])), first['msg']
    else:
        message = ' or '.join(dict.fromkeys(
            p['msg'].removeprefix('Value error, ') for p in problems
            if places.follow(p['loc']) == key))
    # What the file as a whole lacks names its key itself.
    place = places.place(*key) if key else f'{places.path}:1'
    return f'{place}: {_one_line(message)}'


def _lines(node: yaml.Node, key: tuple[str, ...], line: int
           ) -> Iterator[tuple[tuple[str, ...], int]]:
    """Yield each key below a node, its own among them, with its line."""
    yield key, line
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            yield from _lines(value, (*key, name.value), name.start_mark.line + 1)
    elif isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            yield from _lines(item, (*key, str(i)), item.start_mark.line + 1)


def _schemas_at(schema: type[BaseModel], loc: tuple) -> list[type[BaseModel]]:
    """Return the schemas, more than one for a union, to which a pydantic location leads."""
    owners = [schema]
    for part in loc:
        nested = [model for owner in owners for model in _nested_models(owner, part)]
        # Not a key: the number of an item, or the kind that tells the schemas of a union apart.
        owners = nested or [owner for owner in owners if _kind(owner) == part] or owners
    return owners


def _kind(schema: type[BaseModel]) -> str:
    """Return the value of ``kind`` that chooses a schema; empty for one without."""
    field = schema.model_fields.get('kind')
    return getattr(field.annotation, '__args__', ('',))[0] if field else ''


def _nested_models(owner: type[BaseModel], part: object) -> list[type[BaseModel]]:
    field = owner.model_fields.get(str(part))
    found: list[type[BaseModel]] = []
    pending = [field.annotation] if field else []
    while pending:
        annotation = pending.pop()
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            found.append(annotation)
        pending.extend(getattr(annotation, '__args__', ()))
    return found


def _one_line(problem: object) -> str:
    return ' '.join(str(problem).split())
