# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Identify the Silverbox by the command of docs/evidence/fits.md, and simulate the test record.

T. Wigren, J. Schoukens, Three free data sets for development and benchmarking in nonlinear system
identification, ECC 2013. The record is not shipped: silverbox/silverbox.npz in --data has the
arrays t, u and y of multisine_train and multisine_test.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
import re
import shlex
from tempfile import TemporaryDirectory

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.identify.arguments import identify as command_line
from hnn_vi_ros.identify.identify import identify
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build
from matplotlib.figure import Figure
import numpy as np
from scipy.optimize import least_squares
from studies.known_tables import keep, parser_of, save
from studies.two_masses import driven

TABLE, FILE = 'silverbox', 'silverbox/silverbox.npz'
GUIDE = Path(__file__).parents[1] / 'evidence' / 'fits.md'
TRAIN, SKIPPED = 12_000, 50
DRAG = '- {kind: quadratic_drag, coordinates: [y], coefficient: 0.01}\n'
MODELS = {'six numbers': '', 'seven numbers': DRAG}


def documented() -> tuple[str, list[str]]:
    """Return the scene and the words of the command, as the guide prints them."""
    part = GUIDE.read_text(encoding='utf-8').partition('## Silverbox')[2]
    scene, command = re.search(r'```yaml\n(.*?)```.*?```bash\n(.*?)```', part, re.DOTALL).groups()
    return scene, shlex.split(command.replace('\\\n', ' '))


def identified(folder: Path, train: dict[str, np.ndarray], more: str) -> Scene:
    """Return the scene of the guide, with the numbers that its command finds."""
    text, words = documented()
    (folder / 'silverbox.yaml').write_text(text.replace('effects:\n', f'effects:\n{more}'),
                                           encoding='utf-8')
    np.savez(folder / 'silverbox.npz', t=train['t'], q=train['y'][:, None],
             tau=train['u'][:, None])
    words = [str(folder / word) if word.startswith('silverbox.') else word for word in words[2:]]
    at = words.index('--free') + 1
    words[at:at] = ['quadratic_drag.coefficient'] if more else []
    options = command_line().parse_args(words[:words.index('--write')])
    found = identify(load_scene(options.scene), options, folder)
    return found.free.at(found.solution.values)[0]


def simulated(scene: Scene, test: dict[str, np.ndarray]) -> np.ndarray:
    """
    Return y at all samples of a free simulation [V].

    The initial state is fitted to the samples before those that are judged.
    """
    spacing = float(test['t'][-1] - test['t'][0]) / (len(test['t']) - 1)
    every = round(spacing / scene.known_step_size)
    # The spacing of the record to all its digits: its phase is that of 35 s.
    simulation = build(scene.changed({'step_size': spacing / every}))

    def run(state: np.ndarray, samples: int) -> np.ndarray:
        simulation.restart(state[:1], state[1:] / spacing)
        steps = driven(simulation, test['t'][:samples], test['u'][:samples], True)
        return np.array([state[0], *(simulation.q[0] for _ in steps)])[::every]

    first = test['y'][:SKIPPED]
    start = least_squares(lambda state: run(state, SKIPPED) - first,
                          [first[0], 0.5 * (first[2] - first[0])], x_scale=0.01)
    return run(start.x, len(test['t']))


def measure(data: dict[str, dict[str, np.ndarray]], errors: dict[str, np.ndarray]
            ) -> Iterator[tuple[str, int, str, float]]:
    """Yield the error of each model, and keep its course."""
    for name, more in MODELS.items():
        with TemporaryDirectory() as folder:
            scene = identified(Path(folder), data['train'], more)
            error = simulated(scene, data['test']) - data['test']['y']
        errors[name] = error
        yield 'test', 0, name, 1e3 * float(np.sqrt(np.mean(error[SKIPPED:]**2)))


def read(path: Path, train: int | None = None, test: int | None = None
         ) -> dict[str, dict[str, np.ndarray]]:
    """Return the first samples of both records, or raise DataError."""
    try:
        with np.load(path) as arrays:
            return {name: {key: arrays[f'multisine_{name}/{key}'][:count] for key in 'tuy'}
                    for name, count in (('train', train), ('test', test))}
    except (OSError, KeyError, ValueError) as problem:
        raise DataError(f'{path}: cannot be read as the records of the Silverbox ({problem}); see '
                        '--data') from problem


def main(argv: Sequence[str]) -> None:
    """Measure the table, and write it with its picture and the page."""
    arguments = parser().parse_args(argv)
    data = read(arguments.data / FILE, *(600, 600) if arguments.quick else (TRAIN, None))
    errors: dict[str, np.ndarray] = {}
    print(keep(arguments.out, TABLE, measure(data, errors)))
    figure = Figure(figsize=(8.0, 3.0), layout='constrained')
    axes = figure.subplots()
    for name, error in errors.items():
        axes.plot(data['test']['t'], 1e3 * error, linewidth=0.5, label=name)
    axes.set(xlabel='t [s]', ylabel='error of y [mV]', ylim=(-2.0, 2.0))
    axes.legend()
    save(figure, arguments.out, TABLE)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = parser_of(TABLE, __doc__, " ARGS='--data FOLDER'")
    found.add_argument('--data', type=Path, required=True, help='folder of the data sets')
    found.add_argument('--quick', action='store_true', help='short records, to test the program')
    return found
