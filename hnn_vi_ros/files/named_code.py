# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Python code that data name, as ``package.module:function``: who may name it, and how it is found.

A schema marks what names code by ``NAMES_CODE``. Such a value is refused unless whoever validates
the data says that it is trusted, as is done for files that the user names and for nothing else.
"""

from importlib import import_module
import sys
from typing import Any

from pydantic import AfterValidator, ValidationInfo

_TRUST = 'trust_code'


def trusting(trust_code: bool) -> dict[str, bool]:
    """Return the context of a validation of data that may, or may not, name code."""
    return {_TRUST: trust_code}


def _check(name: str | None, info: ValidationInfo) -> str | None:
    if name is not None and not (info.context or {}).get(_TRUST, False):
        raise ValueError(
            f'{repr(name)[:80]} is code, which is run only for scene files that you name; if you '
            'trust who wrote this, allow it by --trust-code or the parameter trust_code')
    return name


NAMES_CODE = AfterValidator(_check)


def find_beside(folder: str | None) -> None:
    """Let Python's modules be found in a folder too, that of a scene file; None for none."""
    if folder is not None and folder not in sys.path:
        sys.path.append(folder)


def import_named(name: str) -> Any:
    """
    Return what ``package.module:function`` names, from the path of Python's modules.

    Raises
    ------
    Exception
        What importing the module raises, or AttributeError.

    """
    module, _, function = name.partition(':')
    return getattr(import_module(module), function)
