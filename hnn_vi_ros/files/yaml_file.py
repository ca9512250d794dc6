# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read YAML files into pydantic models, with errors that name file, line and key; JSON schemas."""

from collections.abc import Callable, Mapping, Sequence
import json
from pathlib import Path
import re
from typing import Any, Self, TypeVar

from hnn_vi_ros.errors import did_you_mean, HnnViRosError, offered
from hnn_vi_ros.files.named_code import trust_context
from hnn_vi_ros.files.regular_file import read_limited
from hnn_vi_ros.files.yaml_text import KeyPlaces, MAX_YAML_BYTES, one_line, parse_mapping
from pydantic import BaseModel, ConfigDict, model_validator, ValidationError
from pydantic.json_schema import GenerateJsonSchema


def json_schema(model: type[BaseModel], title: str) -> str:
    """
    Return the schema of a file, JSON Schema draft 2020-12.

    Parameters
    ----------
    model : type of BaseModel
        Schema of the file.
    title : str
        Description of the file.

    """
    schema = model.model_json_schema(schema_generator=_Untitled)
    schema = {'$schema': _Untitled.schema_dialect, **schema, 'title': title}
    return json.dumps(schema, indent=2, ensure_ascii=False)


class _Untitled(GenerateJsonSchema):
    """A JSON schema without titles of keys, which would only repeat their names."""

    def field_title_should_be_set(self, schema: object) -> bool:
        return False


Model = TypeVar('Model', bound=BaseModel)

# Maximum length of a value in an error.
_MAX_SHOWN_VALUE = 60
# Expected form of a value by pydantic's error type, for messages in terms of Python.
_FORMS = {
    'too_short': 'have {min_length} or more entries',
    'too_long': 'have at most {max_length} entries',
    'string_too_short': 'have {min_length} or more characters',
    'string_too_long': 'have at most {max_length} characters',
    'list_type': 'be a list, as in [a, b]', 'is_instance_of': 'be a list, as in [a, b]',
    'dict_type': 'be keys and values, as in {{key: value}}',
    'model_type': 'be keys and values, as in {{key: value}}',
    'string_type': 'be text, in quotes if it looks like a number',
    'string_pattern_mismatch': 'match the pattern {pattern}', 'bool_type': 'be true or false',
    'int_type': 'be a whole number', 'int_from_float': 'be a whole number',
    'float_type': 'be a number'}
# First units in a description: 'h [s]; ...', 'k of each joint [N/m], [N m/rad]'.
_UNITS = re.compile(r'\[[^\[\],]+\](?:(?:,| or) \[[^\[\],]+\])*')


def units_in(description: str | None) -> tuple[str, ...]:
    """Return the units in brackets in a description; several for several kinds."""
    found = _UNITS.search(description or '')
    return tuple(re.findall(r'\[(.*?)\]', found[0])) if found else ()


class StrictModel(BaseModel):
    """A schema that rejects unknown keys, strings in place of numbers, NaN and infinity."""

    model_config = ConfigDict(extra='forbid', strict=True, allow_inf_nan=False, frozen=True)

    @model_validator(mode='after')
    def _checked(self) -> Self:
        self._check()
        return self

    def _check(self) -> None:
        """Raise ValueError if keys do not fit each other."""


def read_yaml(path: Path, schema: type[Model], error: type[HnnViRosError],
              trust_code: bool = True) -> tuple[Model, KeyPlaces]:
    """
    Read and validate one YAML file; return the places of its keys as well.

    Parameters
    ----------
    path : Path
        Path of the file, of at most 1 MiB.
    schema : type of BaseModel
        Schema of the file.
    error : type of HnnViRosError
        Exception to raise, with one line a problem: file, line, key, expected value.
    trust_code : bool, optional
        False if the user has not named the file, which then must not name Python code.

    """
    data, places = parse_mapping(read_text(path, error), path, error)
    return validate(data, places, schema, error, trust_code=trust_code), places


def validate(data: Mapping[str, Any], places: KeyPlaces | Callable[[], KeyPlaces],
             schema: type[Model], error: type[HnnViRosError], *, trust_code: bool = False
             ) -> Model:
    """
    Return the model of data that were read from YAML.

    Parameters
    ----------
    data : mapping
        The data read.
    places : KeyPlaces or callable
        Places of the keys, or a function that returns them; used only for errors.
    schema, error
        See ``read_yaml``.
    trust_code : bool, optional
        True if the data may name Python code that is run; see ``named_code``.

    """
    try:
        return schema.model_validate(data, context=trust_context(trust_code))
    except ValidationError as problem:
        known = places() if callable(places) else places
        raise error(*_describe(known, schema, problem)) from problem


def read_text(path: Path, error: type[HnnViRosError]) -> bytes:
    """Return the content of a regular file; raise an error if it is larger than YAML may be."""
    try:
        return read_limited(path, MAX_YAML_BYTES)
    except OSError as problem:
        raise error(f'{path}: {problem.strerror}; give a YAML file') from problem


def in_plain_words(problem: ValidationError) -> str:
    """Describe the first error of data that do not fit a schema, with its key."""
    first = problem.errors(include_url=False)[0]
    words = {'missing': 'required', 'extra_forbidden': 'unknown key'}
    said = words.get(first['type']) or _wrong_value([first], ())
    return one_line(': '.join(filter(None, ('.'.join(map(str, first['loc'])), said))))


def _describe(places: KeyPlaces, schema: type[BaseModel], problem: ValidationError) -> list[str]:
    """Return a line for each problem, in the order of the schema."""
    problems = problem.errors(include_url=False)
    kept: list[Any] = []
    # Among the alternatives of a union, the one with the deepest match was probably intended.
    for own in sorted(problems, key=lambda p: (p['type'] == 'extra_forbidden', len(p['loc'])),
                      reverse=True):
        if not any(_excludes(places, other, own) for other in kept):
            kept.append(own)
    return [_one_problem(places, schema, own, problems) for own in problems if own in kept]


def _excludes(places: KeyPlaces, first: Any, second: Any) -> bool:
    """Return True if a problem is a consequence of another."""
    loc, other, types = first['loc'], second['loc'], (first['type'], second['type'])
    if types == ('extra_forbidden', 'missing') and loc[:-1] == other[:-1]:
        # A misspelt key is reported as unknown rather than as missing under its correct name.
        return bool(did_you_mean(str(loc[-1]), [str(other[-1])]))
    at = next((i for i, (a, b) in enumerate(zip(loc, other, strict=False)) if a != b), None)
    if at is None:
        return True
    # They part at different keys, or at the names of alternatives, which are not in the file.
    return not any(
        places.follow(part[:at + 1]) != places.follow(part[:at])
        or (own['type'] == 'missing' and at + 1 == len(part))
        for own, part in ((first, loc), (second, other)))


def _one_problem(places: KeyPlaces, schema: type[BaseModel], first: Any, problems: Sequence[Any]
                 ) -> str:
    loc, problem_type, key = first['loc'], first['type'], places.follow(first['loc'])
    if problem_type == 'extra_forbidden':
        valid = {name for owner in _schemas_at(schema, loc[:-1]) for name in owner.model_fields}
        message = f'unknown key{offered(str(loc[-1]), sorted(valid), "valid keys")}'
    elif problem_type in ('union_tag_invalid', 'union_tag_not_found'):
        key, tag = (*key, 'kind'), first['ctx'].get('tag')
        kinds = sorted(map(_kind, _schemas_at(schema, loc)))
        message = f'required; valid kinds: {", ".join(kinds)}' if tag is None else \
            f'unknown kind {repr(tag)[:80]}{offered(str(tag), kinds, "valid kinds")}'
    elif problem_type in ('model_type', 'model_attributes_type'):
        kinds = sorted(filter(None, map(_kind, _schemas_at(schema, loc))))
        named = kinds and (first['input'] if first['input'] in kinds else kinds[0])
        message = f'expected {{kind: {named}}}, and further keys' if named else \
            'expected keys and values, as in {key: value}'
        message += f', not {_quoted(first["input"])}'
    elif problem_type == 'missing':
        key = (*key, str(loc[-1]))
        said = ' or '.join(_descriptions(schema, loc))
        message = f'required: {said}' if said else 'required'
    else:
        message = _wrong_value([p for p in problems if places.follow(p['loc']) == key],
                               _units_at(schema, loc, key))
    # The message about a missing top-level key already contains its name.
    place = places.place(*key) if key else places.top
    return f'{place}: {one_line(message)}'


def _wrong_value(problems: Sequence[Any], units: Sequence[str]) -> str:
    """Describe the expected value, as far as the error types tell, and the given one."""
    if any(p['type'] in ('value_error', 'assertion_error') for p in problems):
        # The message of a validator in this package, which includes the value if useful.
        return ' or '.join(dict.fromkeys(p['msg'].removeprefix('Value error, ') for p in problems))
    shown = _quoted(problems[0]['input'])
    if {p['type'] for p in problems} <= {'float_type', 'float_parsing'}:
        what = 'number of seconds, e.g. 0.001' if [*units] == ['s'] else \
            f'number{_bracketed(units)}'
        return f'{shown} is not a {what}'
    words = re.findall(r"'([^']*)'", problems[0].get('ctx', {}).get('expected', ''))
    if words and len(problems) == 1:
        hint = did_you_mean(str(problems[0]['input']), words)
        return f'{shown} is unknown{hint}; valid: {", ".join(words)}'
    forms = [f'must {_FORMS[p["type"]].format(**p.get("ctx", {}))}' if p['type'] in _FORMS else
             re.sub('^Input should be ', 'must be ', p['msg']) for p in problems]
    if all(text.startswith('must be ') for text in forms):
        # 'must be a number or a list', not 'must be a number or must be a list'.
        forms = [text.removeprefix('must be ') for text in forms]
        return f'must be {" or ".join(dict.fromkeys(forms))}{_bracketed(units)}, not {shown}'
    return f'{" or ".join(dict.fromkeys(forms))}, not {shown}'


def _quoted(value: object) -> str:
    """Return a value as shown in an error."""
    return repr(value) if len(repr(value)) <= _MAX_SHOWN_VALUE else \
        f'{repr(value)[:_MAX_SHOWN_VALUE]} ...'


def _descriptions(schema: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Return the descriptions of the key at a pydantic location."""
    fields = (owner.model_fields.get(str(loc[-1])) for owner in _schemas_at(schema, loc[:-1]))
    return [*dict.fromkeys(field.description for field in fields if field and field.description)]


def _bracketed(units: Sequence[str]) -> str:
    named = ' or '.join(f'[{unit}]' for unit in units if unit != '1')
    return f' {named}' if named else ''


def _units_at(schema: type[BaseModel], loc: tuple[int | str, ...], key: Sequence[str]
              ) -> tuple[str, ...]:
    """Return the units in brackets in the description of a number."""
    units: set[tuple[str, ...]] = set()
    for i, part in enumerate(loc):
        # The description of a mapping applies to its values, whose keys are not fields.
        if part in key and (fields := [owner.model_fields[part] for owner in _schemas_at(
                schema, loc[:i]) if isinstance(part, str) and part in owner.model_fields]):
            units = {own for field in fields if (own := units_in(field.description))}
    return units.pop() if len(units) == 1 else ()


def _schemas_at(schema: type[BaseModel], loc: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """Return the schemas at a pydantic location; several for a union."""
    owners = [schema]
    for part in loc:
        nested = [model for owner in owners for model in _nested_models(owner, part)]
        # Not a key: the index of an item, or the kind that selects a schema of a union.
        owners = nested or [owner for owner in owners if _kind(owner) == part] or owners
    return owners


def _kind(schema: type[BaseModel]) -> str:
    """Return the value of ``kind`` that selects a schema; '' if it has none."""
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
