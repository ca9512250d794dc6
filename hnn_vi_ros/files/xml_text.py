# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read untrusted XML within limits: elements, attributes and text.

A document type declaration is rejected, and with it all entities except the predefined ones:
nothing is expanded and no other file is read.
"""

from dataclasses import dataclass, field
from itertools import count
from xml.parsers import expat

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.files.yaml_text import one_line

MAX_XML_BYTES = 8 << 20
MAX_DEPTH = 64
MAX_ELEMENTS = 100_000


@dataclass(frozen=True, eq=False)
class Element:
    """
    An element.

    Parameters
    ----------
    tag : str
        Name, with the namespace prefix.
    attributes : dict of str to str
        Values by name.
    line : int
        Line at which it starts.
    children : list of Element
        Child elements in order.
    parts : list of str
        Parts of its own text.

    """

    tag: str
    attributes: dict[str, str]
    line: int
    children: list['Element'] = field(default_factory=list)
    parts: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """Return its own text without spaces at the ends."""
        return ''.join(self.parts).strip()

    def named(self, tag: str) -> list['Element']:
        """Return the children with a given name."""
        return [child for child in self.children if child.tag == tag]


def parse_xml(text: bytes, where: object, error: type[HnnViRosError]) -> Element:
    """
    Return the root of an XML document.

    Parameters
    ----------
    text : bytes
        XML document.
    where : object
        Source of the document, for error messages.
    error : type of HnnViRosError
        Exception to raise, with one line: source, line, problem.

    """
    if len(text) > MAX_XML_BYTES:
        raise error(f'{where}: more than {MAX_XML_BYTES >> 20} MiB of XML')
    parser, numbers = expat.ParserCreate(), count(1)
    # Stack of open elements, below a parent of the root.
    opened = [Element('', {}, 0)]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(opened) > MAX_DEPTH:
            raise _Refused(f'elements nested deeper than {MAX_DEPTH}')
        if next(numbers) > MAX_ELEMENTS:
            raise _Refused(f'more than {MAX_ELEMENTS} elements')
        element = Element(tag, attributes, parser.CurrentLineNumber)
        opened[-1].children.append(element)
        opened.append(element)

    def refuse_doctype(*_declaration: object) -> None:
        raise _Refused('a document type declaration, which could expand without bound or name '
                       'other files; remove it')

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _tag: opened.pop()
    parser.CharacterDataHandler = lambda part: opened[-1].parts.append(part)
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = refuse_doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as problem:
        raise error(f'{where}:{problem.lineno}: not XML: {expat.ErrorString(problem.code)}'
                    ) from problem
    except (_Refused, LookupError, ValueError) as problem:
        # ValueError: an unknown encoding, or one that is not single-byte.
        raise error(f'{where}:{parser.CurrentLineNumber}: {one_line(problem)}') from problem
    # Well-formed XML has exactly one root.
    return opened[0].children[0]


class _Refused(Exception):
    """A rejected document."""
