# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Identify two masses from noisy measurements, and simulate them with other steps and methods.

System and input are from S. Moradi et al., Port-Hamiltonian neural networks with output error
noise models, Automatica 187 (2026), and of its public notebook: two masses with a cubic spring and
two dampers, a multisine of 100 frequencies up to 1 Hz on the second mass, 10 Hz. The training data
are both positions with noise, not the velocity of the second mass, which is the test.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from hnn_vi_ros.files import Parser
from hnn_vi_ros.identify.arguments import identify as command_line
from hnn_vi_ros.identify.identify import identify
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build, Simulation
from matplotlib.figure import Figure
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from studies.known_tables import keep, parser_of, save

TABLE = 'two_masses'
RATE, RMS, NOISE = 10.0, 0.5, 0.001
FREQUENCIES = 0.01 * np.arange(1, 101)
TRAIN, TEST, SKIPPED = 2000, 5000, 300
SEEDS = 5
METHODS = {'gauss4': (0.2, 0.1, 0.05), 'variational_euler': (0.2, 0.1, 0.05)}
FREE = 'm1', 'm2', 'k1', 'k3', 'k2'
TRUE = {'m1': 1.0, 'm2': 1.0, 'k1': 1.0, 'k3': 0.1, 'k2': 1.0}
DAMPING = 0.5

# x is the position of the first mass, s the distance of the second from it, less that at rest: the
# dampers then act on one coordinate each, and a force on the second mass on both.
_SCENE = """hamiltonian:
  kind: formula
  coordinates: [{name: x, q_unit: m}, {name: s, q_unit: m}]
  H: (p_x - p_s)^2/(2*m1) + p_s^2/(2*m2) + k1*x^2/2 + k3*x^4/4 + k2*s^2/2
  parameters: {m1: 0.7, m2: 1.5, k1: 1.5, k3: 0.0, k2: 0.7}
effects:
- {kind: joint_friction, damping: {x: 0.2, s: 0.2}}
- {kind: external_force, coordinates: [x, s], timeout: 1.0}
integrator: {kind: gauss4}
step_size: 0.1
initial_state: {q: [0.0, 0.0], p: [0.0, 0.0]}
"""


def record(samples: int, random: np.random.Generator
           ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the times [s], the force [N] and the true states of a record that begins at rest.

    Returns
    -------
    np.ndarray, np.ndarray, np.ndarray, shapes (samples,), (samples,) and (samples, 4)
        The states are (x, s, x', s').

    """
    t, phases = np.arange(samples) / RATE, random.uniform(0.0, 2.0 * np.pi, len(FREQUENCIES))
    size = RMS * np.sqrt(2.0 / len(FREQUENCIES))

    def force(t: float | np.ndarray) -> np.ndarray:
        angles = 2.0 * np.pi * np.multiply.outer(t, FREQUENCIES) + phases
        return size * np.sin(angles).sum(axis=-1)

    def rates(t: float, z: np.ndarray) -> list[float]:
        x, s, v, w = z
        pull = TRUE['k2'] * s + DAMPING * w
        a = (pull - TRUE['k1'] * x - TRUE['k3'] * x**3 - DAMPING * v) / TRUE['m1']
        return [v, w, a, (force(t) - pull) / TRUE['m2'] - a]
    path = solve_ivp(rates, (0.0, t[-1]), [0.0] * 4, 'DOP853', t, rtol=1e-9, atol=1e-11)
    return t, force(t), path.y.T


def identified(folder: Path, samples: int, random: np.random.Generator) -> Scene:
    """Return the scene with the numbers that ``hnn identify`` finds in a new record."""
    t, u, z = record(samples, random)
    np.savez(folder / 'log.npz', t=t, q=z[:, :2] + NOISE * random.normal(size=(samples, 2)),
             tau=np.stack([u, u], axis=-1))
    (folder / 'scene.yaml').write_text(_SCENE, encoding='utf-8')
    options = command_line().parse_args([
        str(folder / 'scene.yaml'), '--data', str(folder / 'log.npz'), '--inputs', 'spline',
        '--free', *(f'parameters.{name}' for name in FREE), 'joint_friction.damping.x',
        'joint_friction.damping.s'])
    found = identify(load_scene(options.scene), options, folder)
    return found.free.at(found.solution.values)[0]


def driven(simulation: Simulation, t: np.ndarray, u: np.ndarray, positions: bool = False
           ) -> Iterator[None]:
    """
    Advance a simulation step by step, under the mean over each of a spline of the forces u.

    With ``positions``, the mean of F - h^2 F'' / 12, which moves positions as F would, up to h^4;
    identify fits positions with it.
    """
    h, course = simulation.step_size, CubicSpline(t - t[0], u)
    edges = h * np.arange(round((t[-1] - t[0]) / h) + 1)
    integral = course.antiderivative()(edges) - positions * h**2 / 12.0 * course(edges, 1)
    for mean in np.diff(integral) / h:
        simulation.set_command(np.full(simulation.hamiltonian.dimension, mean))
        simulation.advance(1)
        yield


def velocity(scene: Scene, method: str, step_size: float, t: np.ndarray, u: np.ndarray
             ) -> np.ndarray:
    """Return the velocity of the second mass after each step of a simulation from rest [m/s]."""
    simulation = build(scene.changed({'integrator': {'kind': method}, 'step_size': step_size}))
    return np.array([simulation.hamiltonian.gradient(simulation.q, simulation.p)[1].sum()
                     for _ in driven(simulation, t, u)])


def nrms(scene: Scene, method: str, step_size: float, t: np.ndarray, u: np.ndarray,
         measured: np.ndarray) -> float:
    """Return the RMS error of the velocity over its standard deviation, after the transient."""
    found = velocity(scene, method, step_size, t, u)
    every = max(1, round(1.0 / (RATE * step_size)))
    at = np.round(RATE * step_size * np.arange(1, len(found) + 1)[every - 1::every]).astype(int)
    error = found[every - 1::every] - measured[at]
    later = at >= SKIPPED
    return float(np.sqrt(np.mean(error[later]**2)) / measured[SKIPPED:].std())


def measure(seeds: int, train: int, test: int) -> Iterator[tuple[str, int, str, float]]:
    """Yield the errors of each seed, method and step."""
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        with TemporaryDirectory() as name:
            scene = identified(Path(name), train, random)
            t, u, z = record(test, random)
            measured = z[:, 2] + z[:, 3] + NOISE * random.normal(size=test)
            for method, steps in METHODS.items():
                for h in steps:
                    yield f'{h:g}', seed, method, nrms(scene, method, h, t, u, measured)


def draw(values: Sequence[tuple[str, int, str, float]]) -> Figure:
    """Draw the errors over the step size, with the published ones."""
    figure = Figure(figsize=(5.0, 3.4), layout='constrained')
    axes = figure.subplots()
    for method, color in zip(METHODS, ('#d55e00', '#0072b2'), strict=True):
        own = [(float(h), value) for h, _, name, value in values if name == method]
        axes.loglog(*np.array(own).T, 'o', color=color, markersize=4, label=f'ours, {method}')
    axes.plot([0.1, 0.05, 0.02, 0.01], [0.0188, 0.0192, 0.0192, 0.0189], 'k^',
              label='published, its method (RK4)')
    axes.plot([0.1, 0.05, 0.02, 0.01], [0.823, 0.0548, 0.0292, 0.0228], 'kv', fillstyle='none',
              label='published, Euler')
    axes.set(xlabel='step size [s]', ylabel='NRMS of the test')
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def main(argv: Sequence[str]) -> None:
    """Measure the table, and write it with its picture and the page."""
    arguments = parser().parse_args(argv)
    values: list[tuple[str, int, str, float]] = []

    def kept() -> Iterator[tuple[str, int, str, float]]:
        for value in measure(*(1, 300, 500) if arguments.quick else (SEEDS, TRAIN, TEST)):
            values.append(value)
            yield value
    print(keep(arguments.out, TABLE, kept()))
    save(draw(values), arguments.out, TABLE)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = parser_of(TABLE, __doc__)
    found.add_argument('--quick', action='store_true', help='short records, to test the program')
    return found
