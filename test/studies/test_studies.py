# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Studies as a whole: how they are run and fail, and their committed pages and figures."""

from importlib import import_module
import json
from pathlib import Path
import sys

from benchmarks import campaign
from messages import assert_message
import numpy as np
from PIL import Image
import pytest
from sources import ROOT
from studies import (
    bag_to_model, hard_cases_report, known_tables, paper_figures, path_error, published_page,
    turning_costs)
from studies.__main__ import main, studies
from studies.accuracy_page import as_page, FOLDER, PAGE, results_of

DOCS = ROOT / 'docs' / 'evidence'


def test_studies_are_listed_with_what_they_do(capsys):
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()[2:]
    assert len(lines) == len(studies()) > 10
    assert all(len(line.split()) > 4 for line in lines)


def test_help_of_a_study_tells_every_option_and_how_it_is_run():
    for name in studies():
        parser = import_module(f'studies.{name}').parser()
        assert f'make study NAME={name}' in parser.format_help()
        assert all(action.help for action in parser._actions), name


def test_unknown_study_is_one_line_with_the_nearest():
    text = main(['paper_figure'])
    assert isinstance(text, str) and 'did you mean paper_figures?' in text and '\n' not in text


@pytest.mark.parametrize('arguments', [
    'paper-figures --out /dev/null/x', 'work_precision --scenes nothing',
    'published_tables --quick --out /dev/null/x'])
def test_error_of_the_user_is_one_line(arguments):
    assert_message(main(arguments.split()))


def test_missing_peer_is_one_line_before_anything_is_measured(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'torchdiffeq', None)
    said = main(['work_precision', '--scenes', 'pendulum', '--peers', '--docs',
                 str(tmp_path / 'out')])
    assert isinstance(said, str) and '\n' not in said
    assert 'the Python package torchdiffeq is missing' in said
    assert not (tmp_path / 'out').exists()


# Pages are what their templates make of the committed results, to the byte.

def pages_on_accuracy() -> dict[Path, str]:
    return {DOCS / PAGE: as_page(results_of(DOCS))}


def page_on_learning() -> dict[Path, str]:
    return {DOCS / published_page.PAGE: published_page.as_page(
        DOCS, published_page.read_results(DOCS))}


def page_on_turning_bodies() -> dict[Path, str]:
    # Written by hand around the part that is measured.
    path = DOCS.parent / turning_costs.PAGE
    before, _, rest = path.read_text().partition(turning_costs.BEGIN)
    after = rest.partition(turning_costs.END)[2]
    part = turning_costs.page_part(DOCS / FOLDER)
    return {path: f'{before}{turning_costs.BEGIN}\n\n{part}\n{turning_costs.END}{after}'}


def page_on_the_automatic_choice() -> dict[Path, str]:
    rows = json.loads((DOCS / 'automatic-choice.json').read_text(encoding='utf-8'))
    return {DOCS / 'automatic-choice.md': campaign.page([campaign.Row(**row) for row in rows])}


PAGES = {
    'accuracy': pages_on_accuracy, 'learning': page_on_learning,
    'automatic choice': page_on_the_automatic_choice,
    'hard cases': lambda: {
        DOCS / hard_cases_report.PAGE: hard_cases_report.page_of(DOCS),
        DOCS / hard_cases_report.PICTURES / hard_cases_report.GRID:
            hard_cases_report.grid_of(DOCS)},
    'published tables': lambda: {DOCS / known_tables.PAGE: known_tables.as_page(DOCS)},
    'path error': lambda: {DOCS / path_error.PAGE: path_error.as_page(DOCS)},
    'bag to model': lambda: {DOCS / bag_to_model.PAGE: bag_to_model.as_page(DOCS)},
    'turning bodies': page_on_turning_bodies}


@pytest.mark.parametrize('name', PAGES)
def test_page_is_what_its_template_makes_of_the_stored_results(name):
    pages = PAGES[name]()
    assert pages
    for path, text in pages.items():
        assert path.read_text(encoding='utf-8') == text, path


def read(path: Path) -> np.ndarray:
    """Return the table of a CSV file."""
    return np.genfromtxt(path, delimiter=',', names=True)


def test_paper_figures_are_regenerated_as_committed(tmp_path):
    assert paper_figures.main(['--out', str(tmp_path)]) == 0
    new, committed = read(tmp_path / 'paper_figures.csv'), read(DOCS / 'paper_figures.csv')
    assert new.dtype.names == committed.dtype.names
    for name in new.dtype.names:
        # Written with 9 digits; another CPU rounds the network's sums in another order, and the
        # growth of a difference over 10^4 steps of an oscillator is at most linear.
        assert np.abs(new[name] - committed[name]).max() < 1e-8
    for figure in ('paper_figure_1.png', 'paper_figure_2.png'):
        with Image.open(tmp_path / figure) as image:
            assert image.width >= 900
            assert len(image.convert('L').getcolors(256)) > 20


def test_paper_figures_show_growth_for_explicit_euler_only():
    table = read(DOCS / 'paper_figures.csv')
    euler, variational = table['explicit_euler_energy'], table['variational_euler_energy']
    assert euler[-1] > 2.5 * euler[0]
    assert np.abs(variational / variational[0] - 1.0).max() < 0.01
