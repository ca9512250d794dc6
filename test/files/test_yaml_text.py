# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The one loader of YAML: what it reads, what it refuses and how early, and what is written."""

import ast
from pathlib import Path

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import dump_yaml, parse_mapping, parse_yaml, yaml_text
from hypothesis import given, settings, strategies
from messages import refused
import pytest

PACKAGE = Path(yaml_text.__file__).parents[1]
LEVELS = yaml_text.MAX_DEPTH
# Nine levels of nine aliases each: 3.5e8 values.
BOMB = 'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{name}: &{name} [{", ".join(9 * ["*" + before])}]\n'
    for before, name in zip('abcdefgh', 'bcdefghi', strict=True))


def parse(text: bytes | str) -> object:
    return parse_yaml(text, 'here', RecordingError)[0]


def refusal(text: bytes | str) -> str:
    with pytest.raises(RecordingError) as caught:
        parse(text)
    assert '\n' not in str(caught.value) and len(str(caught.value)) < 1200
    return str(caught.value)


@pytest.mark.parametrize('text, value', [
    ('1', 1), ('-5', -5), ('+7', 7), ('0', 0), ('1e-3', 1e-3), ('1.5', 1.5), ('.5', 0.5),
    ('-2.E+3', -2e3), ('.inf', float('inf')), ('1:1:1', '1:1:1'), ('1:1.5', '1:1.5'),
    ('2020-13-45', '2020-13-45'), ('2020-01-02 03:04:05', '2020-01-02 03:04:05'),
    ('010', '010'), ('0x1F', '0x1F'), ('1_000', '1_000'), ('\u0661', '\u0661'), ('=', '='),
    ('~', None), ('true', True), ('off', False), ('{1: a, true: b}', {'1': 'a', 'true': 'b'}),
    ('{<<: {a: 1}}', {'<<': {'a': 1}}), ('[&a 1, 2]', [1, 2]), ('9' * 300, int('9' * 300)),
])
def test_scalar_is_read_as_plain_data(text, value):
    found = parse(text)
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize('text, words', [
    ('a: 1\nb: ' + '9' * 5000, 'here:2: a number of more than 300 characters'),
    ('a: 1\nb: ' + '1' * 5000 + '.5', 'here:2: a number of more than 300'),
    ('a: !!python/object/apply:os.getcwd []', 'here:1: a tag'), ('a: !!binary aGk=', 'a tag'),
    ('a: !own 1', 'a tag'), ('a: ! 1', 'a tag'), ('!!map {a: 1}', 'a tag'),
    ('%TAG ! tag:x,2020:\n---\na: 1', 'here:1: a directive'),
    ('a: 1\n...\n%YAML 1.1\n---\nb: 1', 'here:3: a directive'), ('\r%YAML 1.1', 'a directive'),
    ('a: 1\nb: 2\na: 3', "here:3: 'a': duplicate key; remove one"),
    ('? [a]\n: 1', 'a key must be a plain name'), ('"a\\nb": 1', 'a key must have'),
    ('"\\e[31m": 1', 'printable'), ('? ' + 'k' * 257 + '\n: 1', 'at most 256'),
    ('a: &a [*a]', 'here:1: an alias; write out its'), ('a: *b', 'an alias'),
    (BOMB, 'here:2: an alias'),
    ('a: [', 'here:2: not YAML: while parsing'), ('a: b: c', 'here:1: not YAML: mapping'),
    ('a:\n\tb: c', 'here:2: a tab; indent with spaces'),
    ('a: 1\n--- b', 'here:2: expected a single document'), ('', 'here:1: is empty; expected YAML'),
    ('a: \x00', 'a character that YAML does not allow'), (b'a: 1\nb: \xff', 'here:2: not UTF-8 '),
    ('\ud800', 'not UTF-8'), ('a: ' + 'x' * yaml_text.MAX_YAML_BYTES, 'larger than 1 MiB'),
], ids=range(27))
def test_refusal_is_one_line_that_names_the_place(text, words):
    assert words in refusal(text)


@pytest.mark.parametrize('begin, end', [('[', ']'), ('{a: ', '}'), ('- ', ''), ('? ', '')])
def test_depth_is_refused_at_its_limit(begin, end):
    if begin != '? ':
        parse(begin * LEVELS + '1' + end * LEVELS)
    for levels in (LEVELS + 1, 20_000):
        assert f'nested deeper than {LEVELS}' in refusal(begin * levels + '1' + end * levels)


def test_number_of_nodes_is_refused_at_its_limit():
    # The root is one.
    assert len(parse(f'[{"1," * (yaml_text.MAX_NODES - 1)}]')) == yaml_text.MAX_NODES - 1
    assert 'more than 50000 keys and values' in refusal(f'[{"1," * yaml_text.MAX_NODES}]')


@pytest.mark.parametrize('text, most', [
    ('[' * 10**6, LEVELS + 1), ('- ' * 500_000, LEVELS + 1), ('{a: ' * 250_000, 2 * LEVELS + 1),
    (BOMB, 15), ('[' + '1,' * 500_000, yaml_text.MAX_NODES + 1), ('!a ' * 300_000, 1),
    (''.join(f'%TAG !{i}! x\n' for i in range(50_000)) + '--- 1', 0)],
    ids=['brackets', 'dashes', 'braces', 'bomb', 'items', 'tags', 'directives'])
def test_no_more_is_composed_than_shows_that_a_limit_is_exceeded(monkeypatch, text, most):
    composed, compose = [], yaml_text._Loader.compose_node

    def count(*arguments):
        composed.append(1)
        return compose(*arguments)
    monkeypatch.setattr(yaml_text._Loader, 'compose_node', count)
    refusal(text)
    assert len(composed) <= most


@pytest.mark.timeout(120)
@pytest.mark.parametrize('unit', [
    '1:', '1', '1.', '.', '+', '1e', '0', '-', '_', ' ', '\n', '#', '"', "'", 'a', '&a ', '*a ',
    '? ', ': ', 'a: ', '- ', '|\n ', '!', '%', '\\', '{', ',', 'é', '\t', '\r', '\ufeff'])
def test_megabyte_of_one_thing_is_read_or_refused(unit):
    text = unit * (yaml_text.MAX_YAML_BYTES // len(unit.encode()) - 8)
    for whole in (text, f'a: {text}', f'a: "{text}'):
        try:
            parse(whole)
        except RecordingError as problem:
            assert '\n' not in str(problem)


def test_places_are_those_of_the_keys():
    data, places = parse_mapping('a: 1\nb:\n  c: [1,\n    {d: 2}]\n', 'here', RecordingError)
    assert data == {'a': 1, 'b': {'c': [1, {'d': 2}]}}
    assert places.place('b', 'c', 1, 'd') == 'here:4: b.c.1.d'
    assert places.place('b', 'x') == 'here:2: b.x'
    with refused(RecordingError):
        parse_mapping('[a]', 'here', RecordingError)


def test_yaml_is_read_in_one_place():
    readers = {'load', 'safe_load', 'full_load', 'load_all', 'safe_load_all', 'unsafe_load',
               'compose', 'parse', 'scan'}
    for path in PACKAGE.rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                assert node.value.id != 'yaml' or node.attr not in readers, path


NAMES = strategies.text(strategies.characters(categories=('L', 'N', 'P', 'S')), min_size=1,
                        max_size=20)
# What a string may look like.
TRAPS = strategies.sampled_from([
    '1e3', '1.5e3', '2020-01-02', '1:1:1', '010', '0x1', 'yes', 'null', '~', '', ' a ', '=', '<<',
    '!a', '&a', '*a', '%a', '- a', 'a: b', '#', '\n', '\r\n', '\x85', '\u2028', '\ufeff', '.inf',
    '1_000', "'", '"', '1e5' * 3, 'a' * 5000])
TEXTS = strategies.one_of(TRAPS, strategies.text(
    strategies.characters(exclude_categories=('Cs',)), max_size=30))
DATA = strategies.recursive(
    strategies.one_of(strategies.none(), strategies.booleans(), strategies.integers(),
                      strategies.floats(allow_nan=False), TEXTS),
    lambda inner: strategies.lists(inner, max_size=4) | strategies.dictionaries(
        NAMES, inner, max_size=4), max_leaves=20)


@given(data=DATA)
@settings(max_examples=300)
def test_data_that_are_written_are_read_back_unchanged(data):
    found = parse(dump_yaml(data))
    assert found == data and repr(found) == repr(data)


def test_list_that_is_written_often_is_read_back():
    often = [list(range(50))] * 50
    assert parse(dump_yaml(often)) == often


@given(text=strategies.one_of(
    strategies.binary(max_size=200), strategies.text(max_size=100),
    strategies.lists(strategies.sampled_from([
        '[', ']', '{', '}', '- ', 'a: ', '? ', '&a ', '*a', '!t ', '|\n', '>', "'", '"', '\n  ',
        '\n', '%', '---', '...', '#', '\\x', '1', ',', '\t', '\x85', '<<', '\ud800']),
        max_size=60).map(''.join)))
@settings(max_examples=500)
def test_any_text_is_plain_data_or_a_refusal_of_one_line(text):
    try:
        parse(text)
    except RecordingError as problem:
        assert '\n' not in str(problem) and str(problem).startswith('here:')
