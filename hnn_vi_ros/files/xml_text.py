# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read XML: elements and attributes alone, whoever wrote it, within limits.

A document type declaration is refused, and with it all entities but XML's own, so that nothing is
expanded and no other file is read.
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
    An element; text between elements is not kept.

    Parameters
    ----------
    tag : str
        Its name, with the prefix of a namespace.
    attributes : dict of str to str
        By name.
    line : int
        Where it begins.
    children : list of Element
        Those in it, in their order.

    """

    tag: str
    attributes: dict[str, str]
    line: int
    children: list['Element'] = field(default_factory=list)

    def named(self, tag: str) -> list['Element']:
        """Return the children of a name."""
        return [child for child in self.children if child.tag == tag]


def parse_xml(text: bytes, where: object, error: type[HnnViRosError]) -> Element:
    """
    Return the root of an XML document.

    Parameters
    ----------
    text : bytes
        The document.
    where : object
        What holds it, for errors.
    error : type of HnnViRosError
        The exception to raise, with one line: where, the line, what is wrong.

    """
    if len(text) > MAX_XML_BYTES:
        raise error(f'{where}: more than {MAX_XML_BYTES >> 20} MiB of XML')
    parser, numbers = expat.ParserCreate(), count(1)
    # The elements that are open, within one that holds the root.
    opened = [Element('', {}, 0)]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(opened) > MAX_DEPTH:
            raise _Refused(f'elements nested more than {MAX_DEPTH} deep')
        if next(numbers) > MAX_ELEMENTS:
            raise _Refused(f'more than {MAX_ELEMENTS} elements')
        element = Element(tag, attributes, parser.CurrentLineNumber)
        opened[-1].children.append(element)
        opened.append(element)

    def refuse_doctype(*_declaration: object) -> None:
        raise _Refused('a document type declaration, which could expand without bound or name '
                       'other files; remove it')

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _tag: opened.pop()
    parser.StartDoctypeDeclHandler = refuse_doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as problem:
        raise error(f'{where}:{problem.lineno}: no XML: {expat.ErrorString(problem.code)}'
                    ) from problem
    except (_Refused, LookupError, ValueError) as problem:
        # The latter of an encoding that is not known, or not one of single bytes.
        raise error(f'{where}:{parser.CurrentLineNumber}: {one_line(problem)}') from problem
    # There is one in all XML.
    return opened[0].children[0]


class _Refused(Exception):
    """A document that is not read."""
