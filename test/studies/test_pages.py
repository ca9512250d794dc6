# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Committed pages are what their templates make of the committed results, to the byte."""

from pathlib import Path

import pytest
from studies import bag_to_model, hard_cases_report, published_page, turning_costs
from studies.accuracy_page import as_page, FOLDER, PAGE, scene_page
from studies.explore_page import read_cards, rows_of
from studies.results import Results

DOCS = Path(__file__).parents[2] / 'docs'


def pages_on_accuracy() -> dict[Path, str]:
    folder = DOCS / FOLDER
    found = {scene: Results.read(card, rows_of(folder, scene))
             for scene, card in read_cards(folder).items()}
    results = {scene: entry for scene, entry in found.items()
               if 'number of --runs' in entry.identity}
    return {DOCS / PAGE: as_page(results)} | {
        folder / f'{scene}.md': scene_page(scene, entry) for scene, entry in results.items()}


def page_on_learning() -> dict[Path, str]:
    return {DOCS / published_page.PAGE: published_page.as_page(
        DOCS, published_page.read_results(DOCS))}


def page_on_turning_bodies() -> dict[Path, str]:
    # Written by hand around the part that is measured.
    before, _, rest = (DOCS / turning_costs.PAGE).read_text().partition(turning_costs.BEGIN)
    after = rest.partition(turning_costs.END)[2]
    part = turning_costs.page_part(DOCS / FOLDER)
    return {DOCS / turning_costs.PAGE:
            f'{before}{turning_costs.BEGIN}\n\n{part}\n{turning_costs.END}{after}'}


PAGES = {
    'accuracy': pages_on_accuracy, 'learning': page_on_learning,
    'hard cases': lambda: {
        DOCS / hard_cases_report.PAGE: hard_cases_report.page_of(DOCS)},
    'bag to model': lambda: {DOCS / bag_to_model.PAGE: bag_to_model.as_page(DOCS)},
    'turning bodies': page_on_turning_bodies}


@pytest.mark.parametrize('name', PAGES)
def test_page_is_what_its_template_makes_of_the_stored_results(name):
    pages = PAGES[name]()
    assert pages
    for path, text in pages.items():
        assert path.read_text(encoding='utf-8') == text, path
