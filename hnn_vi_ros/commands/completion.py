# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Completion of ``hnn`` in shells: argcomplete queries the parsers."""

import argparse
from functools import partial
import os

import argcomplete
from argcomplete.completers import FilesCompleter
from hnn_vi_ros.commands.table import COMMANDS, parser_of
from hnn_vi_ros.files import shipped_names


def complete() -> None:
    """Answer a shell's request to complete ``COMP_LINE``, and exit."""
    whole = argparse.ArgumentParser(add_help=False)
    commands = whole.add_subparsers()
    # Names of commands may be written with dashes.
    dashed = [word for word in os.environ['COMP_LINE'].split()[1:2]
              if word.replace('-', '_') in COMMANDS]
    for name in (*COMMANDS, *dashed):
        parser = commands.choices[name] = parser_of(name.replace('-', '_'))
        for action in parser.known:
            if kind := getattr(action, 'names_of', ''):
                setattr(action, 'completer', partial(_words, kind))  # noqa: B010
    argcomplete.autocomplete(whole)


def _words(kind: str, prefix: str, **_: object) -> list[str]:
    """Return the names of a kind, and files that are accepted instead."""
    if kind != 'integrator':
        return [*shipped_names(kind), *FilesCompleter()(prefix)]
    # Imported lazily: it takes a second.
    from hnn_vi_ros.integrators import INTEGRATORS
    return [*INTEGRATORS]
