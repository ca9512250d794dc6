# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Redirects from earlier addresses of pages to their present ones."""

from pathlib import Path

_FOLDERS = {
    'concepts': ('architecture',),
    'evidence': (
        'accuracy-and-cost', 'automatic-choice', 'bag-to-model', 'benchmarks', 'hard-cases',
        'learning', 'paper-figures', 'verification', *(f'accuracy/{scene}' for scene in (
            'double_pendulum', 'exact_double_pendulum', 'exact_harmonic_oscillator',
            'exact_pendulum', 'harmonic_oscillator', 'henon_heiles', 'kepler',
            'learned_henon_heiles', 'learned_kepler', 'pendulum'))),
    'how-to': (
        'control', 'environments', 'gradients', 'identify', 'identify-robot', 'machines',
        'ros2-control', 'scale', 'troubleshooting', 'turning-bodies', 'twin',
        'uncertainty'),
    'reference': ('glossary', 'simulation-interfaces')}
# Earlier names of pages and present ones, below the root of the site and without suffix.
MOVED = {'evidence': 'evidence/index'} | {
    page: f'{folder}/{page}' for folder, pages in _FOLDERS.items() for page in pages}


def write(site: Path) -> None:
    """Write a page at each earlier address, which opens the present one."""
    for page, moved in MOVED.items():
        path, url = site / f'{page}.html', f'{"../" * page.count("/")}{moved}.html'
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            f'<!DOCTYPE html>\n<meta charset="utf-8">\n<title>{moved}</title>\n'
            f'<meta http-equiv="refresh" content="0; url={url}">\n<a href="{url}">{moved}</a>\n',
            encoding='utf-8')
