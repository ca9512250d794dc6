# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The live page: shipped networks and integrators in plain JavaScript, with a stored reference.

`python docs/tools/live_page.py` writes docs/_static/live.html, which is committed.
"""

from base64 import b64encode
import json
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.models import load_checkpoint
import numpy as np

_SOURCES = Path(__file__).parent / 'live'
COMMITTED = Path(__file__).parents[1] / '_static' / 'live.html'


class _Shown(NamedTuple):
    """Title, duration and interval of the reference [s], step sizes [s] and the one at first."""

    title: str
    duration: float
    interval: float
    steps: tuple[float, ...]
    step: float


# Every step size divides the interval. The double pendulum is chaotic: its Lyapunov time is 8 s.
SHOWN = {
    'pendulum': _Shown('pendulum', 100.0, 0.5, (0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5), 0.1),
    'double_pendulum': _Shown('double pendulum', 20.0, 0.1,
                              (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1), 0.01)}
# Method and step size [s] of the reference, whose errors are rounding errors.
_METHOD, _STEP_SIZE = 'gauss16', 0.01


def write_live(path: Path) -> None:
    """Write the page, which needs no other file."""
    page = (_SOURCES / 'live.html').read_text(encoding='utf-8')
    data = json.dumps({name: _data(name, shown) for name, shown in SHOWN.items()})
    for mark, part in (('/*DATA*/', data),
                       ('/*SOLVER*/', (_SOURCES / 'solver.js').read_text(encoding='utf-8'))):
        before, _, after = page.partition(mark)
        page = before + part + after
    path.write_text(page, encoding='utf-8')


def _data(name: str, shown: _Shown) -> dict[str, Any]:
    """Return the network, the start and the reference of a scene."""
    scene = load_scene(name)
    checkpoint = load_checkpoint(shipped_file('model', name))
    (layers,) = checkpoint.networks.values()
    times = np.arange(round(shown.duration / shown.interval) + 1) * shown.interval
    run = simulate(scene, shown.duration, step_size=_STEP_SIZE, integrator=_METHOD, times=times)
    box = checkpoint.card.box
    return {
        'title': shown.title, 'widths': layers.widths, 'steps': shown.steps, 'step': shown.step,
        'weights': _base64(*(part for pair in zip(*layers, strict=True) for part in pair)),
        'box': [*box.q, *box.p],
        'start': [*scene.initial_state.q, *scene.initial_state.p], 'interval': shown.interval,
        'reference': _base64(np.hstack([run.q, run.p]))}


def _base64(*arrays: np.ndarray) -> str:
    """Return arrays of float64, row by row, as text."""
    return b64encode(b''.join(np.ascontiguousarray(a, '<f8').tobytes() for a in arrays)).decode()


if __name__ == '__main__':
    write_live(COMMITTED)
