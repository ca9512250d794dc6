# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Redirects from earlier addresses of pages to their present ones."""

from pathlib import Path

# Earlier names of pages and present ones, below the root of the site and without suffix.
MOVED = {
    'evidence': 'evidence/index', 'live': 'concepts/energy',
    'architecture': 'concepts/architecture', 'glossary': 'reference/glossary',
    'simulation-interfaces': 'reference/services',
    'environments': 'how-to/control', 'identify-robot': 'how-to/machines',
    'paper-figures': 'evidence/verification', 'turning-bodies': 'how-to/machines',
    **{page: f'how-to/{page}' for page in (
        'control', 'gradients', 'identify', 'machines', 'ros2-control', 'scale',
        'troubleshooting', 'twin', 'uncertainty')},
    **{page: f'evidence/{page}' for page in (
        'accuracy-and-cost', 'automatic-choice', 'bag-to-model', 'benchmarks', 'hard-cases',
        'learning', 'verification')},
    **{f'{folder}accuracy/{scene}': 'evidence/accuracy-and-cost' for folder in ('', 'evidence/')
       for scene in (
           'double_pendulum', 'exact_double_pendulum', 'exact_harmonic_oscillator',
           'exact_pendulum', 'harmonic_oscillator', 'henon_heiles', 'kepler',
           'learned_henon_heiles', 'learned_kepler', 'pendulum')},
    'concepts/coordinates': 'concepts/energy', 'concepts/symplectic': 'concepts/energy',
    'evidence/paper-figures': 'evidence/verification',
    'how-to/bodies': 'tutorials/quadrotor', 'how-to/choose-effects': 'how-to/effects',
    'how-to/dashboards': 'how-to/picture', 'how-to/environments': 'how-to/control',
    'how-to/events': 'reference/scene', 'how-to/grippers-and-linkages': 'how-to/robots',
    'how-to/identify-robot': 'how-to/machines',
    'how-to/import-checkpoint': 'how-to/bring-your-network',
    'how-to/own-effect': 'how-to/effects', 'how-to/replay': 'how-to/bags',
    'how-to/sdf-and-mjcf': 'how-to/robots', 'how-to/security': 'how-to/launch',
    'how-to/turning-bodies': 'how-to/machines', 'how-to/where-energy-goes': 'how-to/effects',
    'reference/keys/hamiltonians': 'reference/keys/scene',
    'reference/keys/integrators': 'reference/keys/scene',
    'reference/machine-keys': 'reference/families',
    'reference/scene-options': 'reference/scene',
    'reference/simulation-interfaces': 'reference/services',
    'tutorials/bag-to-verdict': 'how-to/log-to-model', 'tutorials/emps_drive': 'evidence/fits',
    'tutorials/formula': 'tutorials/scene',
    'tutorials/sweeps': 'how-to/scale', 'tutorials/train': 'how-to/log-to-model',
    'tutorials/tuning-accuracy': 'how-to/accuracy'}


def write(site: Path) -> None:
    """Write a page at each earlier address, which opens the present one."""
    for page, moved in MOVED.items():
        path, url = site / f'{page}.html', f'{"../" * page.count("/")}{moved}.html'
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            f'<!DOCTYPE html>\n<meta charset="utf-8">\n<title>{moved}</title>\n'
            f'<meta http-equiv="refresh" content="0; url={url}">\n<a href="{url}">{moved}</a>\n',
            encoding='utf-8')
