# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files for hosts, editors and containers: they are valid, and what they name is there."""

from configparser import ConfigParser
import json
import re

from hnn_vi_ros.ros.topics.outputs import OUTPUTS
from sources import ROOT
import yaml

# The kinds of fields that GitHub's syntax of issue forms has.
FIELDS = {'markdown', 'textarea', 'input', 'dropdown', 'checkboxes', 'upload'}


def test_issue_forms_have_what_github_asks_for():
    for form in (ROOT / '.github' / 'ISSUE_TEMPLATE').glob('*.yml'):
        if form.stem == 'config':
            continue
        found = yaml.safe_load(form.read_text())
        assert {'name', 'description', 'body'} <= set(found), form
        assert {field['type'] for field in found['body']} <= FIELDS, form
        ids = [field['id'] for field in found['body'] if field['type'] != 'markdown']
        assert ids and len(ids) == len(set(ids)), form
        assert all(field['attributes']['label'] for field in found['body']), form


def test_workflow_runs_scripts_that_are_there():
    jobs = yaml.safe_load((ROOT / '.github/workflows/ci.yml').read_text())['jobs']
    steps = [step for job in jobs.values() for step in job['steps']]
    assert steps and all(('run' in step) != ('uses' in step) for step in steps)
    assert all(re.fullmatch(r'actions/[\w-]+@v\d+', step['uses'])
               for step in steps if 'uses' in step)
    scripts = {word for step in steps for word in re.findall(r'^\.\S+', step.get('run', ''))}
    assert scripts == {'.ci/run'} and all((ROOT / script).is_file() for script in scripts)


def test_package_is_built_on_each_distribution_that_is_taken():
    job = yaml.safe_load((ROOT / '.github/workflows/distributions.yml').read_text())[
        'jobs']['industrial_ci']
    taken = re.search(r'^    (jazzy( \| \w+)*)\)$', (ROOT / 'requirements/make_venv').read_text(),
                      re.MULTILINE)
    assert job['strategy']['matrix']['distribution'] == taken[1].split(' | ')
    files = re.findall(r'\$TARGET_REPO_PATH/(\S+)',
                       job['env']['AFTER_INSTALL_TARGET_DEPENDENCIES'])
    assert len(files) == 4 and all((ROOT / file).is_file() for file in files)


def test_hooks_before_a_commit_are_linters_of_the_tests():
    (repository,) = yaml.safe_load((ROOT / '.pre-commit-config.yaml').read_text())['repos']
    hooks = {hook['id'] for hook in repository['hooks']}
    linters = (ROOT / 'test' / 'project' / 'test_linters.py').read_text()
    assert all(f'satisfy_{hook}(' in linters for hook in hooks)
    assert all({'name', 'entry', 'language'} <= set(hook) for hook in repository['hooks'])


def test_citation_has_what_its_format_asks_for():
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    assert {'cff-version', 'message', 'title', 'authors'} <= set(citation)
    assert re.fullmatch(r'\d{4}-\d\d-\d\d', citation['date-released'])
    assert all({'type', 'title', 'authors'} <= set(work) for work in citation['references'])


def test_layout_of_foxglove_shows_topics_that_there_are():
    text = (ROOT / 'config/foxglove/simulator.json').read_text()
    there = {output.topic.replace('~', '/hnn_simulator') for output in OUTPUTS}
    there |= {topic if topic[0] == '/' else f'/{topic}' for topic in there}
    services = (ROOT / 'docs/reference/services.md').read_text()
    shown = re.findall(r'"(/[\w/]+)[."]', text)
    asked = re.findall(r'"serviceName": "/hnn_simulator/(\w+)"', text)
    assert len(asked) == 3 and all(f'`~/{name}`' in services for name in asked)
    topics = {name for name in shown if name.rpartition('/')[2] not in asked}
    assert {'/joint_states', '/diagnostics', '/hnn_simulator/energy'} <= topics <= there


def test_containers_and_editors_have_files_that_can_be_read():
    container = json.loads((ROOT / '.devcontainer/devcontainer.json').read_text())
    target = container['postCreateCommand'].split()[1]
    assert re.search(rf'^{target}:', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    editors = ConfigParser()
    editors.read_string('[top]\n' + (ROOT / '.editorconfig').read_text())
    assert editors['top']['root'] == 'true' and editors['*.py']['max_line_length'] == '99'
