# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The site: its pages tell all that the code has, and lead to files that are there."""

from importlib import import_module
import json
import re
from textwrap import dedent
from types import ModuleType

import hnn_vi_ros
from hnn_vi_ros.commands import COMMANDS, parser_of
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import MECHANISMS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.ros import settings as parameters
from hnn_vi_ros.ros.run.health import STEP_FAILED
from hnn_vi_ros.ros.topics.inputs import INPUTS
from hnn_vi_ros.ros.topics.outputs import OUTPUTS
from hnn_vi_ros.ros.topics.topics import ENDPOINTS
import numpy as np
import pytest
import redirects
import sources
from sources import MODULES, ROOT

DOCS = ROOT / 'docs'
FOLDERS = ('tutorials', 'how-to', 'reference', 'concepts', 'evidence')
OWN = sorted(path for folder in FOLDERS for path in (DOCS / folder).rglob('*.md'))
NOTEBOOKS = sorted(DOCS.glob('tutorials/*.ipynb'))
PAGES = [ROOT / 'README.md', *sorted(DOCS.glob('*.md')), *OWN, *NOTEBOOKS]
# What `make docs` has built, if it has.
INDEX = DOCS / '_build' / 'html' / 'searchindex.js'


def text(name: str) -> str:
    return (DOCS / name).read_text(encoding='utf-8')


@pytest.fixture(scope='module')
def generate() -> ModuleType:
    """Return the module that writes pages, which is in no package."""
    pytest.importorskip('PIL', reason='pictures of the gallery take pillow')
    return import_module('generate')


def test_root_of_the_site_has_only_the_first_pages():
    assert {path.name for path in DOCS.iterdir() if path.is_file()} == {
        'conf.py', 'index.md', 'install.md'}


def test_earlier_addresses_of_pages_open_the_present_ones(tmp_path):
    redirects.write(tmp_path)
    for page, moved in redirects.MOVED.items():
        assert (DOCS / f'{moved}.md').is_file() and not (DOCS / f'{page}.md').exists()
        path = tmp_path / f'{page}.html'
        (url,) = re.findall(r'http-equiv="refresh" content="0; url=(.*?)"', path.read_text())
        assert (path.parent / url).resolve() == tmp_path / f'{moved}.html'


def test_pages_are_short_and_their_links_lead_to_files():
    wrong = []
    for page in PAGES:
        words = page.read_text(encoding='utf-8')
        links = re.findall(r'\]\((?!http)([^)#\s]+)', words)
        # A forge lacks the pages that `make docs` writes.
        wrong += [f'{page}: no {link}' for link in links if not (page.parent / link).exists()
                  or re.search('(generated|gallery)/', link)]
        if page.parent.name != 'keys' and len(words.splitlines()) > (
                90 if page.name == 'README.md' else 400):
            wrong.append(f'{page} is too long')
    assert not wrong, '\n'.join(wrong)


def test_excerpts_of_how_it_works_are_in_the_files_that_they_name():
    excerpts = sources.blocks(DOCS / 'concepts/how-it-works.md', 'python')
    assert len(excerpts) >= 8
    for excerpt in excerpts:
        first, _, code = excerpt.partition('\n')
        lines, here = sources.text(ROOT / first.removeprefix('# ')).splitlines(), 0
        for part in re.split(r'^ *\.\.\.\n', code, flags=re.MULTILINE):
            count, wanted = len(part.splitlines()), dedent(part).strip('\n')
            here = next((i + count for i in range(here, len(lines)) if wanted == dedent(
                '\n'.join(lines[i:i + count])).strip('\n')), len(lines) + 1)
            assert here <= len(lines), f'{first} has no lines in this order:\n{part}'


def test_notebooks_are_committed_without_what_a_run_leaves():
    for path in NOTEBOOKS:
        code = [cell for cell in json.loads(path.read_text(encoding='utf-8'))['cells']
                if cell['cell_type'] == 'code']
        assert code and not any(
            cell['outputs'] or cell['execution_count'] for cell in code), path


@pytest.mark.skipif(not INDEX.is_file(), reason='make docs builds the site')
@pytest.mark.parametrize('query, page', [
    ('energy drift', 'concepts/energy'), ('URDF', 'tutorials/urdf-arm'),
    ('disk full', 'how-to/bags')])
def test_search_of_the_site_finds_the_page(query, page):
    english = pytest.importorskip(
        'sphinx.search.en', reason='sphinx is not installed; see `make docs`').SearchEnglish({})
    index = json.loads(re.search(r'\((.*)\)', INDEX.read_text(encoding='utf-8'), re.S)[1])

    def pages(word: str, *tables: str) -> set[str]:
        found = [index[table].get(english.stem(word.lower()), []) for table in tables]
        return {index['docnames'][k] for one in found
                for k in ([one] if isinstance(one, int) else one)}

    words = query.split()
    # Pages that have all words are shown, first those that have one in a heading.
    shown = set.intersection(*(pages(word, 'terms', 'titleterms') for word in words))
    first = shown & set.union(*(pages(word, 'titleterms') for word in words))
    assert page in first and len(first) <= 6


def test_every_error_and_alarm_has_a_remedy_on_the_page_on_troubleshooting(generate):
    errors, explained = generate.error_page(), text('reference/diagnostics.md')
    wrong = [error.__name__ for error in generate.errors()
             if not error.remedy or f'| `{error.__name__}` |' not in errors]
    wrong += [guard.__name__ for guard in generate.guards()
              if f'{guard.kind}`' not in explained
             or ' '.join(guard.remedy.split())[1:] not in explained]
    assert not wrong, wrong
    page = text('how-to/troubleshooting.md')
    assert STEP_FAILED in page
    defined = {name for path in MODULES for name in re.findall(
        r'^class (\w+)\(HnnViRosError', sources.text(path), re.MULTILINE)}
    assert defined <= {error.__name__ for error in generate.errors()}


def test_written_pages_list_parameters_and_commands(generate):
    page = generate.parameter_page()
    for table in (parameters.PARAMETERS, parameters.REPLAY_PARAMETERS):
        assert generate.markdown_table(table) in page
    page = generate.command_page()
    assert all(parser_of(name).format_help().strip() in page for name in COMMANDS)


def test_committed_pages_are_current_and_have_every_key(generate):
    pages = generate.committed_pages()
    assert {name: text(f'reference/{name}') for name in pages} == pages, 'run make keys'
    schema = json.loads((ROOT / 'config' / 'scene.schema.json').read_text(encoding='utf-8'))
    keys = {key for one in (schema, *schema['$defs'].values())
            for key in one.get('properties', {})} - {'kind'}
    assert not {key for key in keys if f'`{key}`' not in ''.join(pages.values())}


def test_reference_lists_topics_effects_integrators_and_public_names():
    page = text('reference/topics.md')
    assert not {one.topic for one in ENDPOINTS if f'`{one.topic}`' not in page}
    for one in (*OUTPUTS, *INPUTS):
        kind = one.message_type
        shown = f'{kind.__module__.partition(".")[0]}/{kind.__name__}'
        assert re.search(rf'^\|.*`{one.topic}`.*\| `{shown}` \|', page, re.MULTILINE), one.topic
    rows = re.findall(r'^\| `(\w+)` \| .* \| (kept|changes) \| .* \|$',
                      text('reference/effects.md'), re.MULTILINE)
    assert rows == [(kind, 'kept' if effect.conservative else 'changes')
                    for kind, effect in EFFECTS.items()]
    page = text('reference/integrators.md')
    # Those of Gauss between the first two and the last are not named one by one.
    left_out = {f'{kind}{order}' for kind in ('gauss', 'lie_gauss') for order in range(8, 16, 2)}
    assert not {name for name in INTEGRATORS if f'`{name}`' not in page} - left_out
    listed = re.findall(r'\.\. auto(?:function|class):: ([\w.]+)', text('reference/api.md'))
    public = {name for name in hnn_vi_ros.__all__ if not name.startswith('__')}
    assert public | {'hnn_vi_ros.torch.simulate', 'hnn_vi_ros.envs.SceneEnv'} <= {*listed}


def test_gallery_has_a_card_for_each_scene(generate, tmp_path, monkeypatch):
    monkeypatch.setenv('HNN_DOCS_GALLERY', 'none')
    (tmp_path / 'docs').mkdir()
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    generate.write_gallery(tmp_path / 'docs')
    page = (tmp_path / 'docs' / 'gallery' / 'index.md').read_text(encoding='utf-8')
    scenes = [path.stem for path in (ROOT / 'config' / 'scenes').glob('*.yaml')]
    assert scenes and all(f'[{name}](../../config/scenes/{name}.yaml)' in page for name in scenes)
    assert [path.name for path in (tmp_path / 'docs' / 'gallery').glob('*.md')] == ['index.md']


def test_sketch_is_seen_from_above_only_if_the_motion_is_flat(generate):
    from sketch import _view
    q = np.array([[-1.0, 0.0], [0.0, 1.0], [1.0, 0.5]])
    assert np.array_equal(_view(MECHANISMS['kepler'](q, 1.0)), np.eye(3)[[0, 1]])
    for name, along in (('mass_spring', q[:, :1]), ('spring_chain', q)):
        assert np.array_equal(_view(MECHANISMS[name](along, 1.0)), np.eye(3)[[0, 2]])


def test_gallery_draws_a_scene_once(generate, tmp_path):
    from gallery import draw
    path = ROOT / 'config' / 'scenes' / 'exact_harmonic_oscillator.yaml'
    assert draw('exact_harmonic_oscillator', path, tmp_path) == ''
    picture = tmp_path / 'exact_harmonic_oscillator.png'
    made = picture.stat().st_mtime_ns
    assert draw('exact_harmonic_oscillator', path, tmp_path) == ''
    assert picture.stat().st_mtime_ns == made
