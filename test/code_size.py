# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Count the lines of code of each package: ``python test/code_size.py [FOLDER]``.

Blank lines, comments and docstrings are not counted.
"""

import ast
from collections import Counter
from pathlib import Path
import sys

DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def lines_of_code(path: Path) -> int:
    """Return the number of lines of code in a file."""
    text = path.read_text(encoding='utf-8')
    lines = {number for number, line in enumerate(text.splitlines(), 1)
             if line.strip() and not line.strip().startswith('#')}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            text = node.body[0]
            lines -= set(range(text.lineno, (text.end_lineno or text.lineno) + 1))
    return len(lines)


def main() -> None:
    """Print a row for each package, the largest first, and the sum."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1] / 'hnn_vi_ros')
    files, code = Counter[str](), Counter[str]()
    for path in root.rglob('*.py'):
        room = path.relative_to(root).parts[0] if path.parent != root else '(loose)'
        files[room] += 1
        code[room] += lines_of_code(path)
    for room, count in [*code.most_common(), ('all', code.total())]:
        print(f'{room:20}{files[room] or files.total():5} files{count:8} lines')


if __name__ == '__main__':
    main()
