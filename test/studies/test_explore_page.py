# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page to explore what accuracy costs, driven in a browser without a screen or a net."""

from importlib.util import find_spec
from pathlib import Path
import re
import shutil
import subprocess

from hnn_vi_ros.errors import ParameterError
from messages import refused
import pytest
from studies import explore_page
from studies.results import FLOORS, read_rows

DOCS = Path(__file__).parents[2] / 'docs' / 'evidence' / 'accuracy'
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)
OPTIONS = ('--headless=new', '--no-sandbox', '--disable-dev-shm-usage', '--no-first-run',
           '--disable-gpu', '--host-resolver-rules=MAP * ~NOTFOUND',
           '--virtual-time-budget=10000', '--dump-dom')


def test_page_data_hold_every_committed_row_and_its_floors():
    data = explore_page.page_data(DOCS)
    assert data['count'] == sum(len(read_rows(DOCS / f'{scene}.csv')) for scene in data['scenes'])
    for entry in data['scenes'].values():
        assert {row[2] for row in entry['rows']} >= {float(T) for T in entry['horizons']}
    pendulum = data['scenes']['pendulum']['horizons']['10.0']
    # The learned pendulum, and the accuracy of its reference: round-off, not the model's error.
    assert 0.0 < pendulum['reference'] < 1e-9 < pendulum['path']
    assert data['scenes']['kepler']['horizons']['10.0']['path'] is None


def test_lines_of_methods_and_peers_have_looks_of_their_own():
    lines = explore_page.page_data(DOCS)['lines']
    assert {line['group'] for line in lines.values()} == {'ours', 'peers'}
    looks = [(line['symbol'], line['color'], line['dash']) for line in lines.values()]
    assert len(set(looks)) == len(looks)


def test_missing_rows_are_one_line(tmp_path):
    with refused(ParameterError):
        explore_page.page_data(tmp_path)


def test_missing_plotly_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(explore_page, 'find_spec', lambda name: None)
    with refused(ParameterError):
        explore_page._plotly()


@pytest.mark.long
@pytest.mark.skipif(BROWSER is None, reason=f'needs a browser: one of {", ".join(BROWSERS)}')
@pytest.mark.skipif(find_spec('plotly') is None, reason='plotly is not installed; see `make test`')
@pytest.mark.timeout(180)
def test_page_in_a_browser_names_the_cheapest_row_for_an_error(tmp_path):
    for name in DOCS.glob('*.csv'):
        shutil.copy(name, tmp_path)
    shutil.copy(DOCS / FLOORS, tmp_path)
    page = explore_page.write_explorer(tmp_path)
    url = f'{page.as_uri()}#scene=kepler&horizon=1280.0&x=gradients&y=path&tolerance=1e-6'
    dom = subprocess.run([str(BROWSER), *OPTIONS, f'--user-data-dir={tmp_path / "profile"}', url],
                         capture_output=True, text=True, check=True, timeout=150).stdout
    assert 'requested: ' in dom and 'accuracy of the reference' in dom
    good = [row for row in read_rows(tmp_path / 'kepler.csv') if row.horizon == 1280.0
            and row.finished and row.path_error <= 1e-6
            and row.gradients_per_simulated_second > 0.0]
    best = min(good, key=lambda row: row.gradients_per_simulated_second)
    table = re.search(r'<tbody id="best">(.*?)</tbody>', dom, re.DOTALL)
    assert table is not None
    first = re.findall(r'<td>(.*?)</td>', table[1])[:5]
    assert first[0] == best.method and first[4] == '1'
    assert dom.count('class="trace scatter') >= 10
