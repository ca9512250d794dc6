# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read untrusted YAML within limits that are checked first, and write YAML; only plain data.

All YAML, from a file, a bag or a topic, is read with ``parse_yaml``. Numbers are decimal, as in
YAML 1.2; dates and numbers to base 60 are strings; keys are strings. Tags, aliases, directives and
anything beyond a limit are rejected. The output of ``dump_yaml`` is read back unchanged.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import re
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
import yaml
from yaml.composer import Composer, ComposerError
from yaml.parser import ParserError
from yaml.reader import Reader
from yaml.scanner import ScannerError

MAX_YAML_BYTES = 1 << 20
MAX_DEPTH = 32
# Maximum number of keys, values and lists; the longest initial state has 20,000.
MAX_NODES = 50_000
# Maximum length of a number; all integers with this many digits are in the range of a float.
MAX_NUMBER = 300
MAX_KEY = 256
# Maximum length of an error message.
_MAX_MESSAGE = 1000

_INT, _FLOAT = 'tag:yaml.org,2002:int', 'tag:yaml.org,2002:float'
# Regular expressions without backtracking: their time is linear in the scalar's length.
_INTEGER = re.compile(r'[-+]?(?:0|[1-9][0-9]*)\Z')
_REAL = re.compile(
    r'(?:[-+]?(?:(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+'
    r'|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN))\Z')
_FIRST_CHARACTERS = list('-+.0123456789')
# In YAML each of these line breaks starts a line, and a byte order mark may come first.
_DIRECTIVE = re.compile('(?:\\A|[\n\r\x85\u2028\u2029])\ufeff?%')


@dataclass(frozen=True)
class KeyPlaces:
    """
    Line numbers of the keys of a YAML text.

    Parameters
    ----------
    where : str
        Source of the text, a file or a topic.
    lines : dict of tuple of str to int
        Line of each key; items of a list have the keys '0', '1', ... The line is 0 if the data
        were not read from a text.

    """

    where: str
    lines: dict[tuple[str, ...], int]

    @classmethod
    def of_data(cls, data: object, where: str) -> 'KeyPlaces':
        """Return the keys of plain data that were not read from a text."""
        return cls(where, dict.fromkeys(_keys(data, ()), 0))

    @property
    def top(self) -> str:
        """Return ``where:line`` of the root."""
        return f'{self.where}:1' if self.lines[()] else self.where

    def follow(self, key: Sequence[str | int]) -> tuple[str, ...]:
        """Return the part of a key or of a pydantic location that the text contains."""
        followed: tuple[str, ...] = ()
        for part in key:
            if (*followed, str(part)) in self.lines:
                followed = (*followed, str(part))
        return followed

    def place(self, *key: str | int) -> str:
        """Return ``where:line: key``; for a missing key, the line of its parent."""
        line = self.lines[self.follow(key)]
        where = f'{self.where}:{line}' if line else self.where
        return f'{where}: {".".join(map(str, key)) or "the file"}'


def parse_yaml(text: bytes | str, where: object, error: type[HnnViRosError]
               ) -> tuple[Any, KeyPlaces]:
    """
    Return the plain data of one YAML document, and the places of its keys.

    Parameters
    ----------
    text : bytes or str
        UTF-8; at most 1 MiB, 32 levels deep, 50,000 keys and values.
    where : object
        Source of the text, for error messages.
    error : type of HnnViRosError
        Exception to raise, with one line: ``where:line:`` and the problem.

    """
    raw = text.encode('utf-8', 'surrogatepass') if isinstance(text, str) else text
    if len(raw) > MAX_YAML_BYTES:
        raise error(f'{where}: larger than {MAX_YAML_BYTES >> 20} MiB, the limit of such YAML')
    try:
        decoded = raw.decode('utf-8')
    except UnicodeDecodeError as problem:
        line = raw.count(b'\n', 0, problem.start) + 1
        raise error(f'{where}:{line}: not UTF-8 ({problem.reason}); expected YAML, which is '
                    'text') from problem
    for pattern, what in ((Reader.NON_PRINTABLE, 'a character that YAML does not allow'),
                          (_DIRECTIVE, 'a directive; remove the line that begins with %')):
        if found := pattern.search(decoded):
            raise error(f'{where}:{decoded.count(chr(10), 0, found.end() - 1) + 1}: {what}')
    try:
        loader = _Loader(decoded)
        root = loader.get_single_node()
        if root is None:
            raise error(f'{where}:1: is empty; expected YAML')
        return loader.construct_document(root), KeyPlaces(
            str(where), dict(_lines(root, (), root.start_mark.line + 1)))
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark or problem.context_mark
        what = ', '.join(filter(None, (problem.context, problem.problem)))
        if isinstance(problem, ScannerError | ParserError):
            # Message of the library, which describes a tab as a character that starts no token.
            here = decoded[mark.index:mark.index + 1] if mark else ''
            what = 'a tab; indent with spaces' if here == '\t' else f'not YAML: {what}'
        raise error(f'{where}:{mark.line + 1 if mark else 1}: {one_line(what)}') from problem
    except yaml.YAMLError as problem:
        raise error(f'{where}:1: {one_line(problem)}') from problem


def root_node(text: str) -> yaml.Node:
    """Return the root node of a YAML text accepted by ``parse_yaml``, with places of all nodes."""
    return _Loader(text).get_single_node()


def parse_mapping(text: bytes | str, where: object, error: type[HnnViRosError]
                  ) -> tuple[dict[str, Any], KeyPlaces]:
    """Return the mapping in one YAML document; see ``parse_yaml``."""
    data, places = parse_yaml(text, where, error)
    if not isinstance(data, dict):
        raise error(f'{where}:1: expected a mapping of keys to values')
    return data, places


def dump_yaml(data: object) -> str:
    """Return plain data as YAML: keys in order, no folding, repeated values written out."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=2**31, allow_unicode=True)


def one_line(problem: object) -> str:
    """Return a text as one line of printable characters, truncated if it is too long."""
    line = ' '.join(str(problem).split())
    line = ''.join(letter if letter.isprintable() else '?' for letter in line)
    return line if len(line) <= _MAX_MESSAGE else f'{line[:_MAX_MESSAGE]} ...'


class _Dumper(yaml.SafeDumper):
    """Dumper that quotes strings that look like numbers, and writes repeated values out."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    # Only this style preserves line breaks other than \n.
    style = None if text.isprintable() else '"'
    return dumper.represent_scalar('tag:yaml.org,2002:str', text, style)


_Dumper.add_representer(str, _represent_text)
_Dumper.add_implicit_resolver(_FLOAT, _REAL, _FIRST_CHARACTERS)


class _Loader(Composer, yaml.CSafeLoader):
    """
    Compose and construct plain data; reject anything beyond a limit as soon as it occurs.

    The parser is in C; the composer is in Python, where limits can be checked.
    """

    yaml_implicit_resolvers = {
        first: [pair for pair in pairs if pair[0].endswith((':null', ':bool'))]
        for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()}

    def __init__(self, text: str):
        yaml.CSafeLoader.__init__(self, text)
        self.anchors: dict[str, yaml.Node] = {}
        self._depth = self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: object) -> yaml.Node:
        """Compose a node within the limits."""
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise _refusal('an alias; write out its value', event)
        nested = isinstance(event, yaml.CollectionStartEvent)
        self._depth += nested
        self._nodes += 1
        if event.tag is not None:
            raise _refusal('a tag; write plain values, without !', event)
        if self._depth > MAX_DEPTH:
            raise _refusal(f'nested deeper than {MAX_DEPTH}', event)
        if self._nodes > MAX_NODES:
            raise _refusal(f'more than {MAX_NODES} keys and values', event)
        node = super().compose_node(parent, index)
        if node.tag in (_INT, _FLOAT) and len(node.value) > MAX_NUMBER:
            raise _refusal(f'a number of more than {MAX_NUMBER} characters', event)
        self._depth -= nested
        return node

    def compose_mapping_node(self, anchor: str | None) -> yaml.MappingNode:
        """Compose a mapping with unique scalar keys."""
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refusal('a key must be a plain name', key)
            if key.value in seen:
                raise _refusal(f'{key.value[:40]!r}: duplicate key; remove one', key)
            if len(key.value) > MAX_KEY or not key.value.isprintable():
                raise _refusal(f'a key must have at most {MAX_KEY} characters, all printable', key)
            seen.add(key.value)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[str, Any]:
        """Return a mapping whose keys are strings as written."""
        return {key.value: self.construct_object(value, deep=deep) for key, value in node.value}


_Loader.add_implicit_resolver(_INT, _INTEGER, _FIRST_CHARACTERS)
_Loader.add_implicit_resolver(_FLOAT, _REAL, _FIRST_CHARACTERS)


def _refusal(what: str, where: yaml.Event | yaml.Node) -> ComposerError:
    return ComposerError(problem=what, problem_mark=where.start_mark)


def _keys(data: object, key: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Yield each key of plain data, including that of the root."""
    yield key
    items = data.items() if isinstance(data, Mapping) else enumerate(data) \
        if isinstance(data, list) else ()
    for name, value in items:
        yield from _keys(value, (*key, str(name)))


def _lines(node: yaml.Node, key: tuple[str, ...], line: int
           ) -> Iterator[tuple[tuple[str, ...], int]]:
    """Yield each key at and below a node, with its line."""
    yield key, line
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            yield from _lines(value, (*key, name.value), name.start_mark.line + 1)
    elif isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            yield from _lines(item, (*key, str(i)), item.start_mark.line + 1)
