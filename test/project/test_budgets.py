# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
No room is larger than its budget in `budgets.csv`.

Whoever raises a budget writes the reason beside it; whoever makes a room smaller lowers it.
"""

from collections import Counter
import csv
from pathlib import Path

from code_size import lines_of_code
import pytest
from sources import PACKAGE, ROOT

# Lines, or words, by which a budget may exceed its room before it has to be lowered.
_SLACK = {'tests': 500, 'docs': 500}
_DEFAULT_SLACK = 40
# Pages that are generated when the site is built.
_GENERATED = {'_build', 'gallery', 'generated'}


def sizes() -> Counter[str]:
    """Return lines of code by room, lines of Python of the tests, and words of the pages."""
    found = Counter[str]()
    for path in PACKAGE.rglob('*.py'):
        place = path.relative_to(PACKAGE)
        found[place.parts[0] if place.parent != Path() else '(loose)'] += lines_of_code(path)
    for folder in ('test', 'docs/benchmarks'):
        for path in (ROOT / folder).rglob('*.py'):
            found['tests'] += len(path.read_text(encoding='utf-8').splitlines())
    for path in (ROOT / 'docs').rglob('*.md'):
        if not _GENERATED & set(path.relative_to(ROOT / 'docs').parts):
            found['docs'] += len(path.read_text(encoding='utf-8').split())
    return found


def budgets() -> dict[str, tuple[int, str]]:
    """Return the budget of each room, and the reason for it."""
    table = Path(__file__).with_name('budgets.csv').read_text(encoding='utf-8').splitlines()
    return {row['room']: (int(row['budget']), row['why']) for row in csv.DictReader(table)}


def test_every_room_has_a_budget_with_a_reason():
    assert budgets().keys() == sizes().keys()
    assert all(why for _, why in budgets().values())


@pytest.mark.parametrize('room', budgets())
def test_room_is_within_its_budget_and_the_budget_close_to_it(room):
    size, (budget, _) = sizes()[room], budgets()[room]
    assert size <= budget, f'{room} has {size}: remove what it has twice, or say why it grew'
    assert budget - size <= _SLACK.get(room, _DEFAULT_SLACK), f'lower the budget of {room}: {size}'
