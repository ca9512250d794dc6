# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The gallery: a card for each shipped scene, with its picture, its YAML and what it shows.

`HNN_DOCS_GALLERY` is a comma-separated list of the scenes to draw (default: all; `none` for none).
A picture is made once for each version of its scene and its model.
"""

import hashlib
import io
import json
import math
import os
from pathlib import Path
import sys
import warnings

from hnn_vi_ros import load_scene, simulate, Trajectory
from hnn_vi_ros.errors import AlarmWarning, ModelError
from PIL import Image
from sketch import sketch
import yaml

_ROBOTS = 'Robots and bodies that turn'
# Keys: whether the model is learned, and whether effects act.
_TOPICS = {(True, False): 'Learned models', (True, True): 'Learned models with effects',
           (False, False): 'Formulas', (False, True): 'Formulas with effects'}
# Commands [N, N m] over time [s], without which these scenes rest. The quadrotor hovers, and rises
# and sinks by about its size.
_COMMANDS = {
    'quadrotor': lambda t: [0.8 * 9.81 * (1.0 + 0.05 * math.cos(t)), 0.0, 0.0, 0.0],
    'cart_pole': lambda t: [2.0 * math.cos(2.0 * t)],
    'motor_pendulum': lambda t: [1.5 * math.cos(2.5 * t)],
    'realaigym_double_pendulum': lambda t: [0.6 * math.cos(3.0 * t), 0.0]}
# Version of the pictures: another number makes all of them again.
_VERSION = '10'


def write_gallery(docs: Path) -> None:
    """
    Write the page of cards and the pictures.

    Parameters
    ----------
    docs : Path
        The folder of the site's sources.

    """
    folder, sources = docs / 'gallery', docs.parent / 'config' / 'scenes'
    folder.mkdir(exist_ok=True)
    scenes = {path.stem: path for path in sorted(sources.glob('*.yaml'))}
    asked = os.environ.get('HNN_DOCS_GALLERY', 'all')
    wanted = set(scenes) if asked == 'all' else set(asked.split(',')) - {'none'}
    if wanted - set(scenes):
        raise ValueError(f'HNN_DOCS_GALLERY: no scenes {", ".join(sorted(wanted - set(scenes)))}')
    topics: dict[str, list[str]] = {topic: [] for topic in (*_TOPICS.values(), _ROBOTS)}
    bare = []
    for name, path in scenes.items():
        why = draw(name, path, folder) if name in wanted else 'left out of this build'
        if (folder / f'{name}.png').is_file():
            topics[topic_of(path)].append(card(name, path))
        else:
            bare.append(f'- {_link(name)}: {description(path)} ({why})')
    text = ['# Gallery', '', (
        f'The {len(scenes)} shipped scenes. `hnn run NAME --plot NAME.png` runs one, and '
        '`hnn simulator --ros-args -p scene:=NAME` runs it as a node. Each name opens its YAML.'),
        '']
    for topic, cards in topics.items():
        if cards:
            text += [f'## {topic}', '', '::::{container} gallery', *cards, '::::', '']
    if bare:
        text += ['## Without a picture', '', *bare, '']
    write(folder / 'index.md', '\n'.join(text))


def draw(name: str, path: Path, folder: Path) -> str:
    """Draw a scene, if that is not done already; return why it cannot be, or nothing."""
    key = hashlib.sha256(path.read_bytes() + _VERSION.encode())
    model = path.parents[2] / 'resource' / 'models' / f'{_model(path)}.safetensors'
    if model.is_file():
        key.update(model.read_bytes())
    stamps_path = folder / 'pictures.json'
    stamps = json.loads(stamps_path.read_text('utf-8')) if stamps_path.is_file() else {}
    if stamps.get(name) == key.hexdigest() and (folder / f'{name}.png').is_file():
        return ''
    try:
        scene = load_scene(name)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', AlarmWarning)
            run = simulate(scene, commands=_COMMANDS.get(name))
    except ModelError:
        return 'its model is not shipped because of the licence of its data; train it first'
    print(f'gallery: {run}', file=sys.stderr)
    mechanism_picture(run).save(folder / f'{name}.png')
    stamps[name] = key.hexdigest()
    stamps_path.write_text(json.dumps(stamps, indent=1), encoding='utf-8')
    return ''


def picture_of(name: str) -> Image.Image:
    """Return the picture of a shipped scene."""
    return mechanism_picture(simulate(load_scene(name)))


def mechanism_picture(run: Trajectory) -> Image.Image:
    """Draw the mechanism at the end of a run, with the path behind it, or a phase portrait."""
    if run.mechanism() is not None:
        return sketch(run)
    try:
        figure = run.phase_portrait()
    except ValueError:
        # Rotations have no phase plane.
        figure = run.plot()
    film = io.BytesIO()
    figure.savefig(film, dpi=80)
    return Image.open(film).convert('RGB')


def card(name: str, path: Path) -> str:
    """Return the part of the page that shows one scene."""
    return (f':::{{container}} card\n![{name}]({name}.png)\n\n{_link(name)}\n\n'
            f'{description(path)}\n:::')


def _link(name: str) -> str:
    return f'[{name}](../../config/scenes/{name}.yaml)'


def topic_of(path: Path) -> str:
    """Return the heading under which the gallery shows a scene."""
    scene = yaml.safe_load(path.read_text('utf-8'))
    if scene['hamiltonian']['kind'] == 'urdf' or scene.get('mechanism') == 'turning_body':
        return _ROBOTS
    return _TOPICS['model' in scene['hamiltonian'], bool(scene.get('effects'))]


def description(path: Path) -> str:
    """Return the description of a scene."""
    return str(yaml.safe_load(path.read_text('utf-8')).get('description', '')).rstrip('.')


def write(path: Path, text: str) -> None:
    """Write a file if that changes it."""
    if not path.is_file() or path.read_text('utf-8') != text:
        path.write_text(text, encoding='utf-8')


def _model(path: Path) -> str:
    return str(yaml.safe_load(path.read_text('utf-8'))['hamiltonian'].get('model', ''))
