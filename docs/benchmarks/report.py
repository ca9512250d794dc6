# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark's table: for people in Markdown, for programs in JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, UTC
from importlib.metadata import PackageNotFoundError, version
import json
import math
from pathlib import Path
import platform

from benchmarks.measurement import Row
from studies.results import commit, machine

_PACKAGES = ('numpy', 'numba', 'llvmlite', 'scipy', 'jax', 'jaxlib', 'diffrax', 'torch',
             'torchdiffeq', 'pin', 'mujoco')
_HEADING = """\
# Benchmarks

The ratio is our figure divided by the figure of the peer, which is another tool, or the same task
without a feature: below 1 we are faster. Ratios in **bold** exceed their
[target](#rows-that-miss-their-target).

We and the peer alternate in one run, with one thread each unless the row says otherwise; the ratio
is the median. [benchmarks.json](benchmarks.json) also contains targets, quartiles, seeds, dates,
versions and further rows. `make bench` repeats the measurement and writes this page;
`make bench ARGS='--rows robots'` measures one group of rows.

![Ratios of each group](benchmarks.png)
"""

# Comparisons with ourselves: the page shows their rows that miss the target.
_OWN = ('effects', 'auto')


@dataclass(frozen=True)
class Group:
    """
    Rows that were measured together.

    Parameters
    ----------
    where : str
        The machine, commit, versions, date and seed.
    rows : list of Row
        In the order of the table.

    """

    where: str
    rows: list[Row]


def measured_here(rows: list[Row], seed: int | None = None) -> Group:
    """Return rows with their origin: this machine, commit, versions and time."""
    return Group('; '.join([
        machine(), f'commit {commit()}', f'Python {platform.python_version()}',
        ', '.join(map(_version, _PACKAGES)),
        f'{datetime.now(UTC):%Y-%m-%d %H:%M} UTC', *([] if seed is None else [f'seed {seed}'])]),
        rows)


def write_groups(path: Path, groups: Mapping[str, Group]) -> None:
    """Write all that is known of the rows, by group."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({name: asdict(group) for name, group in groups.items()}, indent=2)
                    + '\n')


def read_groups(path: Path) -> dict[str, Group]:
    """Return the groups of a file of ``write_groups``; none without a file."""
    if not path.is_file():
        return {}
    return {name: Group(group['where'], [
        Row(**row | {'quartiles': tuple(row['quartiles'])}) for row in group['rows']])
        for name, group in json.loads(path.read_text()).items()}


def as_table(rows: Sequence[Row]) -> str:
    """Return the rows that have a target as a Markdown table."""
    lines = ['| row | ours | peer | ratio |', '|---|---|---|---|']
    for row in (row for row in rows if row.target is not None):
        ratio = f'**{shown(row)}**' if row.met is False else shown(row)
        lines.append(f'| {row.name} | {row.ours} | {row.peer} | {ratio} |')
    return '\n'.join(lines) + '\n'


def as_markdown(groups: Mapping[str, Group]) -> str:
    """Return the whole document."""
    missed = [row for group in groups.values() for row in group.rows if row.met is False]
    rows = [row for name, group in groups.items() for row in group.rows
            if name not in _OWN or row in missed]
    # Rows that miss for the same reason share an entry.
    reasons: dict[str, list[str]] = {}
    for row in missed:
        reasons.setdefault(row.miss or 'not explained yet.', []).append(
            f'**{row.name}**, {_number(row.ratio)} (target {row.target:g})')
    misses = [f'- {"; ".join(names)}: {reason}' for reason, names in reasons.items()]
    # Groups that were measured with the same commit and machine share a line.
    wheres: dict[str, list[str]] = {}
    for name, group in groups.items():
        wheres.setdefault('; '.join(group.where.split('; ')[:2]), []).append(name)
    lines = [_HEADING, as_table(rows), '## Rows that miss their target\n',
             '\n'.join(misses or ['None.']) + '\n', '## Machines and commits\n',
             *(f'- {", ".join(names)}: {where}' for where, names in wheres.items())]
    return '\n'.join(lines) + '\n'


def draw(groups: Mapping[str, Group], path: Path) -> Path:
    """Draw the ratios to peers of the rows that have a target, by group."""
    from matplotlib.figure import Figure
    rows = [(name, row) for name, group in groups.items() for row in group.rows
            if row.target is not None and not row.unit and row.ratio > 1e-4]
    figure = Figure(figsize=(8.0, 4.2), layout='constrained')
    axes = figure.subplots()
    names = list(dict.fromkeys(name for name, _ in rows))
    axes.axvspan(1e-4, 1.0, color='#eaf4ea', zorder=0)
    axes.scatter([row.target for _, row in rows], [names.index(name) for name, _ in rows],
                 color='#555555', marker='|', s=220.0, label='target of a row')
    for met, colour, label in ((True, '#0072b2', 'target met'),
                               (False, '#d55e00', 'missed: right of its target')):
        found = [(row.ratio, names.index(name)) for name, row in rows if row.met is met]
        axes.scatter([x for x, _ in found], [y for _, y in found], color=colour, label=label)
    axes.axvline(1.0, color='grey', linestyle=':', label='equal to the peer')
    numbers = [number for _, row in rows for number in (row.ratio, row.target)]
    axes.set(xscale='log', xlim=(0.7 * min(numbers), 1.6 * max(numbers)), yticks=range(len(names)),
             yticklabels=[name.replace('_', ' ') for name in names])
    axes.set_xlabel('our time or error over that of the peer; left is better, green: better than '
                    'the peer')
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    figure.legend(loc='outside upper center', ncols=4, frameon=False)
    figure.savefig(path, dpi=110)
    return path


def shown(row: Row) -> str:
    """Return the ratio of a row with its unit."""
    return 'not judged' if math.isnan(row.ratio) else f'{_number(row.ratio)} {row.unit}'.rstrip()


def _number(value: float) -> str:
    """Return a ratio with two decimals, or with two digits where that would be 0.00."""
    return f'{value:.2f}' if not 0.0 < abs(value) < 0.01 else f'{value:.2g}'


def _version(name: str) -> str:
    try:
        return f'{name} {version(name)}'
    except PackageNotFoundError:
        return f'no {name}'
