# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
From a bag to a model: record the double pendulum, train on the bag, simulate the model.

Recording and training use the commands of a user. The learned model then starts from states of the
bag, the last one included, and is compared with the exact system. Existing files in the folder of
the run are not made again.
"""

from collections.abc import Sequence
import json
from pathlib import Path
import shlex
import subprocess
import sys

from hnn_vi_ros.errors import ParameterError, RecordingError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.models import load_checkpoint
from hnn_vi_ros.recording import BagReader, decode_float64_multi_array
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import simulate_many, Trajectory
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from studies.pages import render
from studies.results import machine

SCENE, CONFIG, INTEGRATOR = 'exact_double_pendulum', 'double_pendulum_bag', 'gauss8'
RECORDED, SIMULATED, RATE = 60.0, 10.0, 100.0  # [s], [s], [Hz]
# States of the bag from which a simulation starts, and the largest deviations that are promised.
STARTS = 6
ENERGY_BAND, PATH_ERROR = 0.02, 0.05
PAGE, PICTURE = 'bag-to-model.md', 'bag_to_model.png'
# The results that the page is made from.
RESULTS = 'learning/bag_to_model.json'


def main(argv: Sequence[str]) -> int:
    """Make missing files, compare, and write the page; return 1 if a target is missed."""
    arguments = parser().parse_args(argv)
    bag, model = arguments.out / 'bag', arguments.out / f'{CONFIG}.safetensors'
    commands = _commands(bag, model)
    for target, words in zip((bag, model), commands, strict=True):
        if not target.exists():
            _run(words)
    scene = load_scene(SCENE)
    q, p = _starts(bag)
    exact, learned = (simulate_many(each, q, p, SIMULATED, samples=round(SIMULATED * RATE))
                      for each in (_scene(scene), _scene(scene, model)))
    height = float(exact.energy[0, 0] - _energy(scene, np.zeros_like(q[0]), np.zeros_like(q[0])))
    path_errors = np.maximum(_deviation(learned.q, exact.q), _deviation(learned.p, exact.p))
    bands = np.ptp(_energy(scene, learned.q, learned.p), axis=0) / height
    for start, path_error, band in zip(_instants(), path_errors, bands, strict=True):
        print(f'from {start:g} s: path error {path_error:.2%}, energy band {band:.3%}')
    if arguments.docs is not None:
        _keep(arguments.docs, commands, model, height, path_errors, bands)
        _draw(arguments.docs / PICTURE, scene, exact, learned)
    return int(path_errors.max() > PATH_ERROR or bands.max() > ENERGY_BAND)


def _commands(bag: Path, model: Path) -> tuple[list[str], list[str]]:
    values = {'scene': SCENE, 'integrator': INTEGRATOR, 'duration': f'{RECORDED:g}',
              'real_time_factor': '0', 'publish_rate': f'{RATE:g}', 'rerun_sink': 'none',
              'record_path': str(bag)}
    parameters = [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]
    return (['simulator', '--ros-args', *parameters],
            ['train', '--config', CONFIG, '--data', str(bag), '--out', str(model)])


def _run(words: list[str]) -> None:
    """Run an executable of this package, or raise ParameterError if it fails."""
    name, *arguments = words
    code = f'from hnn_vi_ros.cli import {name}; {name}()'
    print(shlex.join(['ros2', 'run', 'hnn_vi_ros', *words]), flush=True)
    status = subprocess.run([sys.executable, '-c', code, *arguments], check=False).returncode
    if status != 0:
        raise ParameterError(f'{name} ended with status {status}; see what it says above')


def _instants() -> list[float]:
    return [RECORDED / STARTS * i for i in range(STARTS + 1)]


def _starts(bag: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of the bag at even times, the first and the last included."""
    reader = BagReader(bag)
    states = []
    for name in ('q', 'p'):
        numbers = [number for number, channel in reader.channels.items()
                   if channel.topic.endswith(f'/{name}')]
        states.append(np.array([decode_float64_multi_array(message.data)
                                for message in reader.messages(numbers)]))
    if len(states[0]) != round(RECORDED * RATE):
        raise RecordingError(f'{bag}: holds {len(states[0])} states, expected '
                             f'{round(RECORDED * RATE)}; remove it, and it is recorded anew')
    rows = np.linspace(0, len(states[0]) - 1, STARTS + 1).round().astype(int)
    return states[0][rows], states[1][rows]


def _scene(scene: Scene, model: Path | None = None) -> Scene:
    """Return the scene with the precise method, and the learned Hamiltonian if there is one."""
    changes = {'integrator': {'kind': INTEGRATOR}}
    if model is not None:
        changes['hamiltonian'] = {'kind': 'hnn', 'model': str(model.resolve())}
    return Scene.model_validate(scene.model_dump() | changes)


def _deviation(learned: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return the largest relative deviation of each motion, shape (m,), of (N, m, d)."""
    return (np.abs(learned - exact).max(axis=0) / np.abs(exact).max(axis=0)).max(axis=1)


def _energy(scene: Scene, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    return scene.create_hamiltonian().energy(q, p)


def _keep(docs: Path, commands: tuple[list[str], list[str]], model: Path, height: float,
          path_errors: np.ndarray, bands: np.ndarray) -> None:
    """Write the results and the page."""
    card = load_checkpoint(model).card
    record, train = (shlex.join(['ros2', 'run', 'hnn_vi_ros', *words]) for words in commands)
    found = {
        'machine': machine(), 'record': record, 'train': train, 'config': CONFIG,
        'dataset': card.dataset, 'loss': card.losses['validation_loss'], 'seed': card.seed,
        'recorded': RECORDED, 'simulated': SIMULATED, 'integrator': INTEGRATOR,
        'step': load_scene(SCENE).step_size, 'height': height,
        'runs': list(zip(_instants(), path_errors.tolist(), bands.tolist(), strict=True)),
        'promised': {'path_error': PATH_ERROR, 'energy_band': ENERGY_BAND}}
    (docs / RESULTS).parent.mkdir(parents=True, exist_ok=True)
    (docs / RESULTS).write_text(json.dumps(found, indent=1) + '\n', encoding='utf-8')
    (docs / PAGE).write_text(as_page(docs), encoding='utf-8')
    print(docs / PAGE)


def as_page(docs: Path) -> str:
    """Return the page, from the results in the docs."""
    return render(PAGE, **json.loads((docs / RESULTS).read_text(encoding='utf-8')))


def _draw(path: Path, scene: Scene, exact: Trajectory, learned: Trajectory) -> None:
    """Draw the motion from the last state of the bag, and the energies of all."""
    figure = Figure(figsize=(9.0, 6.0), layout='constrained')
    FigureCanvasAgg(figure)
    motion, energies = figure.subplots(2, 1, sharex=True)
    names = [coordinate.name for coordinate in scene.create_hamiltonian().coordinates]
    for i, (name, colour) in enumerate(zip(names, ('#1f4e9c', '#f28e2b'), strict=True)):
        motion.plot(exact.t, exact.q[:, -1, i], color=colour, label=f'{name}, exact')
        motion.plot(exact.t, learned.q[:, -1, i], '--', color='black', linewidth=1.0,
                    label='learned' if i == 0 else None)
    motion.set(title='From the last state of the bag on', ylabel='q [rad]')
    motion.margins(y=0.2)
    motion.legend(loc='upper right', ncols=3)
    height = exact.energy[0, 0]
    energies.plot(learned.t, 100.0 * (_energy(scene, learned.q, learned.p) / height - 1.0),
                  linewidth=0.8)
    energies.set(title='Energy along the learned paths, all starts', xlabel='t [s]',
                 ylabel='exact H / H(0) - 1 [%]')
    for axes in (motion, energies):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
    print(path)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('bag_to_model', __doc__, [
        'make study NAME=bag_to_model ARGS="--docs docs/evidence"'])
    found.add_argument('--out', type=Path, default=Path('bag_to_model'), metavar='DIR',
                       help='folder of the bag and the model (default: bag_to_model)')
    found.add_argument('--docs', type=Path, metavar='DIR',
                       help='also write the page bag-to-model.md and its picture to this folder')
    return found
