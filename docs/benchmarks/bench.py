# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure this package against its peers: the runner of `make bench`."""

import argparse
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
import os
from pathlib import Path
import sys
import time

from benchmarks.measurement import Row, Settings
from benchmarks.report import (
    as_markdown, as_table, draw, Group, measured_here, read_groups, shown, write_groups)

# A group of rows: its module, and its approximate duration [s].
GROUPS = {
    'gradient': ('benchmarks.gradient', 45.0),
    'modules': ('benchmarks.modules', 150.0),
    'adjoint': ('benchmarks.adjoint', 120.0),
    'euler_step': ('benchmarks.euler_step', 20.0),
    'path_error': ('benchmarks.path_error', 105.0),
    'exact': ('benchmarks.exact', 60.0),
    'many': ('benchmarks.many', 360.0),
    'scale': ('benchmarks.scale', 600.0),
    'effects': ('benchmarks.effects', 180.0),
    'auto': ('benchmarks.auto', 60.0),
    'guards': ('benchmarks.guards', 60.0),
    'node': ('benchmarks.node_load', 200.0),
    'robots': ('benchmarks.robots', 120.0),
    'cold_start': ('benchmarks.cold_start', 150.0),
}
# Read when a library is loaded: too late to set here.
_SINGLE_THREAD = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'XLA_FLAGS')

Measure = Callable[[Settings], Iterator[Row]]


def run(groups: Mapping[str, tuple[Measure, float]], repetitions: int, quick: bool,
        done: Callable[[str, list[Row]], None] = lambda name, rows: None) -> dict[str, list[Row]]:
    """
    Measure groups of rows one after another, and print each row and the time that is left.

    Parameters
    ----------
    groups : mapping
        From a name to a function that yields rows, and about how long it takes [s].
    repetitions, quick
        See Settings.
    done : callable, optional
        Takes the rows of each group once they are measured.

    Raises
    ------
    ValueError
        Two rows have the same name.

    """
    rows, known = dict[str, list[Row]](), set[str]()
    start, left = time.monotonic(), {name: seconds for name, (_, seconds) in groups.items()}
    settings = Settings(repetitions, quick, lambda text: print(f'  {text} ...', flush=True))
    for name, (measure, _) in groups.items():
        print(f'{name}: {time.monotonic() - start:.0f} s gone'
              + ('' if quick else f', about {sum(left.values()) / 60.0:.0f} min left'), flush=True)
        rows[name] = []
        for row in measure(settings):
            if row.name in known:
                raise ValueError(f'two rows are named {row.name!r}')
            known.add(row.name)
            rows[name].append(row)
            print(f'  = {row.name}: {shown(row)}', flush=True)
        del left[name]
        done(name, rows[name])
    return rows


def write(groups: Mapping[str, Group], folder: Path) -> None:
    """Write benchmarks.md, .json and .png into a folder; keep other groups."""
    known = read_groups(folder / 'benchmarks.json') | groups
    known = {name: known[name] for name in dict.fromkeys([*GROUPS, *groups]) if name in known}
    write_groups(folder / 'benchmarks.json', known)
    (folder / 'benchmarks.md').write_text(as_markdown(known))
    draw(known, folder / 'benchmarks.png')


def main(argv: list[str]) -> int:
    """Run the selected groups; results of --quick are not written."""
    parser = argparse.ArgumentParser(prog='bench', description=__doc__)
    parser.add_argument('--rows', nargs='+', choices=GROUPS, default=list(GROUPS),
                        metavar='GROUP', help=f'groups to measure: {", ".join(GROUPS)}')
    parser.add_argument('--quick', action='store_true', help='few and short repetitions')
    parser.add_argument('--out', type=Path, default=Path('docs/evidence'),
                        help='folder for benchmarks.md and benchmarks.json')
    arguments = parser.parse_args(argv)
    if missing := [name for name in _SINGLE_THREAD if name not in os.environ]:
        parser.error(f'{", ".join(missing)} must be set to keep the peers to one thread; '
                     'use: make bench')
    modules = {name: import_module(GROUPS[name][0]) for name in arguments.rows}

    def done(name: str, rows: list[Row]) -> None:
        """Write a group at once, so that an interruption loses no other."""
        if not arguments.quick:
            write({name: measured_here(rows, getattr(modules[name], 'SEED', None))},
                  arguments.out)
    rows = run({name: (module.rows, GROUPS[name][1]) for name, module in modules.items()},
               3 if arguments.quick else 21, arguments.quick, done)
    print(as_table([row for group in rows.values() for row in group]))
    if arguments.quick:
        print('Not written: only what is measured without --quick is.')
        return 0
    print(f'Written: {arguments.out}/benchmarks.md and benchmarks.json')
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
