# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run a study: ``make study NAME=work_precision ARGS='--scenes pendulum'``; or list all."""

import ast
from pathlib import Path
import sys

from hnn_vi_ros.cli import run_module
from hnn_vi_ros.errors import did_you_mean


def studies() -> dict[str, str]:
    """Return the name and the first line of the docstring of each study."""
    found = {}
    for file in sorted(Path(__file__).parent.glob('[!_]*.py')):
        tree = ast.parse(file.read_text(encoding='utf-8'))
        if any(isinstance(node, ast.FunctionDef) and node.name == 'main' for node in tree.body):
            found[file.stem] = (ast.get_docstring(tree) or '').partition('\n')[0]
    return found


def main(argv: list[str]) -> int | str | None:
    """Return the exit status of the study that the first word names."""
    there = studies()
    if not argv or argv[0] in ('-h', '--help'):
        width = max(map(len, there))
        print("make study NAME=... ARGS='...', with --help among them for the options:\n")
        print('\n'.join(f'  {name:{width}}  {line}' for name, line in there.items()))
        return 0
    name = argv[0].replace('-', '_')
    if name not in there:
        return f'NAME={argv[0]}: no such study{did_you_mean(name, there)}; valid: ' \
               f'{", ".join(there)}'
    return run_module(f'studies.{name}', argv[1:], name)


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
