# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The live page in a browser: its networks and integrators against those of the package."""

from base64 import b64decode
from importlib.util import module_from_spec, spec_from_file_location
import json
from pathlib import Path
import re
import shutil
import subprocess

from hnn_vi_ros import load_scene, simulate
import numpy as np
import pytest

TOOL = Path(__file__).parents[2] / 'docs' / 'tools' / 'live_page.py'
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)
OPTIONS = ('--headless=new', '--no-sandbox', '--disable-dev-shm-usage', '--no-first-run',
           '--disable-gpu', '--host-resolver-rules=MAP * ~NOTFOUND', '--dump-dom')
# Duration and step size [s] of each scene.
RUNS = {'pendulum': (100.0, 0.05), 'double_pendulum': (2.0, 0.01)}
STATES = {name: np.random.default_rng(2).uniform(-1.0, 1.0, (32, 2 * d))
          for name, d in (('pendulum', 1), ('double_pendulum', 2))}
DRIVER = """<script>
playing = false;
const found = {};
for (const [name, {start}] of Object.entries(DATA)) {
  const model = new Model(DATA[name]), [duration, h] = RUNS[name];
  const rates = STATES[name].map((z) => { const own = new Float64Array(z.length);
    model.rates(z, own); return [...own]; });
  const paths = Object.fromEntries(Object.keys(METHODS).map((method) => {
    const run = new Simulation(model, method, h, start);
    while (run.t < duration - h / 2) if (!run.step()) break;
    return [method, [...run.z]];
  }));
  found[name] = {rates, paths};
}
document.body.replaceChildren(JSON.stringify(found));
</script>"""


@pytest.fixture(scope='module')
def page(tmp_path_factory) -> Path:
    """Return the page."""
    spec = spec_from_file_location('live_page', TOOL)
    tool = module_from_spec(spec)
    spec.loader.exec_module(tool)
    path = tmp_path_factory.mktemp('live') / 'live.html'
    tool.write_live(path)
    return path


def content(page: Path, folder: Path, *options: str) -> str:
    """Return the document of a page after its scripts have run."""
    return subprocess.run([str(BROWSER), *OPTIONS, *options, f'--user-data-dir={folder}',
                           page.as_uri()],
                          capture_output=True, text=True, check=True, timeout=150).stdout


@pytest.fixture(scope='module')
def found(page, tmp_path_factory) -> dict:
    """Return the rates at some states, and the last states of runs, in the browser."""
    folder = tmp_path_factory.mktemp('driven')
    given = (f'<script>const RUNS = {json.dumps(RUNS)}, STATES = '
             f'{json.dumps({name: rows.tolist() for name, rows in STATES.items()})};</script>')
    (folder / 'driven.html').write_text(
        page.read_text().replace('</body>', f'{given}{DRIVER}</body>'))
    text = content(folder / 'driven.html', folder)
    return json.loads(re.search('<body[^>]*>(.*?)</body>', text, re.DOTALL)[1])


pytestmark = [pytest.mark.timeout(180), pytest.mark.skipif(
    BROWSER is None, reason=f'needs a browser: one of {", ".join(BROWSERS)}')]


@pytest.mark.parametrize('name', RUNS)
def test_page_has_the_gradients_of_the_package(name, found, page):
    q, p = np.split(STATES[name], 2, axis=1)
    dH_dq, dH_dp = load_scene(name).create_hamiltonian().gradient(q, p)
    expected = np.hstack([dH_dp, -dH_dq])
    # Roundings of sums of 64 products in each layer.
    assert np.abs(found[name]['rates'] - expected).max() <= 1e-13 * np.abs(expected).max()
    assert page.stat().st_size < 200_000


@pytest.mark.filterwarnings('ignore::hnn_vi_ros.errors.AlarmWarning')
@pytest.mark.parametrize('method', [
    'variational_euler', *(pytest.param(name, marks=pytest.mark.long) for name in (
        'explicit_euler', 'rk4', 'implicit_midpoint', 'gauss4'))])
def test_page_has_the_paths_of_the_package(method, found):
    for name, (duration, h) in RUNS.items():
        run = simulate(name, duration, step_size=h, integrator=method)
        last = np.hstack([run.q[-1], run.p[-1]])
        assert np.abs(found[name]['paths'][method] - last).max() <= 1e-10, name


def test_page_shows_time_energy_and_error(page, tmp_path):
    driven = tmp_path / 'driven.html'
    driven.write_text(page.read_text().replace(
        '</body>', '<script>restart(); playing = false; work(5, 1e9); show();</script></body>'))
    shown = dict(re.findall('<(?:td|span) id="(.*?)">(.*?)</', content(driven, tmp_path)))
    assert shown['t'] == '5.0 s'
    for side in '01':
        assert float(shown[f'worst{side}'].split()[0]) > 0.0
        assert float(shown[f'path{side}']) > 0.0 and float(shown[f'cost{side}']) > 1.0


def test_committed_page_is_current(page):
    data = '<script id="data" type="application/json">(.*?)</script>'
    committed, written = (path.read_text(encoding='utf-8') for path in (
        TOOL.parents[1] / '_static' / 'live.html', page))
    assert re.sub(data, '', committed) == re.sub(data, '', written)
    old, new = (json.loads(re.search(data, text)[1]) for text in (committed, written))
    for name, own in new.items():
        # Rounding of another machine changes the reference by less than a line's width.
        paths = [np.frombuffer(b64decode(one[name].pop('reference'))) for one in (old, new)]
        assert np.abs(np.subtract(*paths)).max() < 1e-6
        assert own == old[name]


def test_page_opens_without_a_network(page):
    assert not re.findall(r'(?:src|href)="|https?://|import\(|fetch\(', page.read_text())
