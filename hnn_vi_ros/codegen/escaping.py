# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Text of scenes and models in generated files, in which it must not become code."""

import re
from typing import Literal
from xml.sax.saxutils import escape

from hnn_vi_ros.files import one_line

# Patterns that mean something in a text of each language, and what is written instead.
_REPLACED = {
    # The ends of comments; and ??/, which is a backslash, and joins lines.
    'comment': (r'\*(?=/)|/(?=\*)|\?(?=\?)|\\', r'\g<0> '),
    'string': (r'["\\?]', r'\\\g<0>'),
    'markdown': (r'[]!"#$&\'()*+<>\\^_`{|}~[]', r'\\\g<0>'),
    'name': (r'\W|^(?=\d)', '_')}


def escaped(text: str, language: Literal['comment', 'string', 'markdown', 'name', 'xml']) -> str:
    """
    Return any text as one line that is only text in a generated file.

    Parameters
    ----------
    text : str
        Untrusted text.
    language : str
        ``'comment'`` or ``'string'`` of C, ``'markdown'``, ``'xml'`` for elements and attributes
        in double quotes, or ``'name'`` for identifiers of C and CMake, and file names.

    """
    line = one_line(text)
    if language == 'xml':
        return escape(line, {'"': '&quot;'})
    pattern, instead = _REPLACED[language]
    return re.sub(pattern, instead, line, flags=re.ASCII)


def identifier(text: str) -> str:
    """Return a text as an identifier of C."""
    return escaped(text, 'name') or '_'
