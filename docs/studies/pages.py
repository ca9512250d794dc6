# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation, rendered from templates and the results of studies."""

import math
from pathlib import Path
import re
from typing import Any

from hnn_vi_ros.models import interval_text
from jinja2 import Environment, FileSystemLoader, StrictUndefined

# torch brings it, and so does the builder of the site.
_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).with_name('templates')), undefined=StrictUndefined,
    trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
_TEMPLATES.filters |= {
    # A number in general format with some digits, and in scientific format.
    'g': lambda value, digits=6: f'{value:.{digits}g}',
    'e': lambda value, digits=1: f'{value:.{digits}e}',
    'interval': interval_text,
    # The anchor of a heading, on the site and on GitHub.
    'slug': lambda title: re.sub(r'[^\w\- ]', '', title.lower()).replace(' ', '-'),
    # The lines of a table whose head is in the template.
    'table': lambda rows: '\n'.join(f'| {" | ".join(row)} |' for row in rows)}
_TEMPLATES.tests['known'] = lambda value: not math.isnan(value)


def render(template: str, **values: Any) -> str:
    """Return the text of a template, filled in; it ends in one line break."""
    return _TEMPLATES.get_template(template).render(**values).rstrip('\n') + '\n'
