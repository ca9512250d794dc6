# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Energy over long runs, next to DART and Gymnasium: a chain of ten links, and the Acrobot.

The chain is that of DART's test of its variational integrator (pull request 2764): 0.7 kg and
0.02 kg m2 at each joint, 0.3 m apart, released from 0.4 rad. The Acrobot is released at rest from
angles up to 1 rad; the starts of the published figures (Gymnasium, thread 1714) are not known.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import NamedTuple

from hnn_vi_ros.files import Parser
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, Simulation
from matplotlib.figure import Figure
import numpy as np
from studies.known_tables import keep, parser_of, save

TABLE = 'energy_drift'
LINKS, CHAIN_STEPS, CHAIN_STEP = 10, 100_000, 1e-3
CHAIN_METHODS = 'variational_euler', 'implicit_midpoint', 'gauss4'
END, SEEDS = 100.0, 5
# Step sizes of Gymnasium's rk4 and of our method [s]. The last pair costs equal numbers of
# gradients; in each pair ours takes less processor time.
PAIRS = {0.2: 0.1, 0.05: 0.1, 0.01: 0.05}
METHOD = 'gauss8'

_LINK = """<link name="l{0}"><inertial><mass value="0.7"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="j{0}" type="continuous"><parent link="{1}"/><child link="l{0}"/>
  <origin xyz="{2} 0 0"/><axis xyz="0 1 0"/></joint>
"""
# The equations of Sutton and Barto's book, as in Gymnasium: inertias about the joints.
_ACROBOT = """hamiltonian:
  kind: formula
  coordinates: [{name: a, q_unit: rad, p_unit: kg m2/s}, {name: b, q_unit: rad, p_unit: kg m2/s}]
  H: >-
    (I2 * p_a^2 - 2 * (I2 + m2*l1*r2*cos(b)) * p_a * p_b
    + (I1 + I2 + m2*l1^2 + 2*m2*l1*r2*cos(b)) * p_b^2)
    / (2 * (I2 * (I1 + m2*l1^2) - (m2*l1*r2*cos(b))^2))
    - (m1*r1 + m2*l1) * g * cos(a) - m2*r2 * g * cos(a + b)
  parameters: {m1: 1.0, m2: 1.0, l1: 1.0, r1: 0.5, r2: 0.5, I1: 1.25, I2: 1.25, g: 9.8}
"""


class Course(NamedTuple):
    """Relative energy error at every step, processor time [s], and coordinates at the end."""

    error: np.ndarray
    seconds: float
    end: np.ndarray


def scene_of(hamiltonian: str, method: str, step_size: float, q: Sequence[float]) -> Simulation:
    """Return a simulation of a system at rest."""
    with TemporaryDirectory() as name:
        folder, d = Path(name), len(q)
        links = ''.join(_LINK.format(k, f'l{k - 1}' if k else 'base', 0.3 if k else 0.0)
                        for k in range(LINKS))
        (folder / 'chain.urdf').write_text(
            f'<robot name="chain"><link name="base"/>{links}</robot>', encoding='utf-8')
        (folder / 'scene.yaml').write_text(
            f'{hamiltonian}integrator: {{kind: {method}}}\nstep_size: {step_size}\n'
            f'initial_state: {{q: {[*map(float, q)]}, p: {[0.0] * d}}}\n', encoding='utf-8')
        return build(load_scene(folder / 'scene.yaml'))


def ours(simulation: Simulation, steps: int) -> Course:
    """Return the energy errors of a run, relative to the energy at its start."""
    hamiltonian: Hamiltonian = simulation.hamiltonian
    first = float(hamiltonian.energy(simulation.q, simulation.p))
    simulation.compile()
    start = time.process_time()
    q, p = simulation.record(steps, 1)
    seconds = time.process_time() - start
    return Course((hamiltonian.energy(q, p) - first) / abs(first), seconds, simulation.q)


def chain(method: str, steps: int) -> Course:
    """Return the run of the chain of ten links."""
    return ours(scene_of('hamiltonian: {kind: urdf, file: chain.urdf}\n', method, CHAIN_STEP,
                         [0.4] * LINKS), steps)


def acrobot_simulation(step_size: float, angles: np.ndarray) -> Simulation:
    """Return our Acrobot, released at rest."""
    return scene_of(_ACROBOT, METHOD, step_size, angles)


def acrobot(step_size: float, angles: np.ndarray, end: float) -> Course:
    """Return our run of the Acrobot."""
    return ours(acrobot_simulation(step_size, angles), round(end / step_size))


def gymnasium(dt: float, angles: np.ndarray, end: float) -> Course:
    """Return the run of Gymnasium's Acrobot without torque, stepped as in ``step``."""
    # Installed with the peers of `make bench`.
    from gymnasium.envs.classic_control.acrobot import AcrobotEnv, rk4
    rates, states = AcrobotEnv()._dsdt, [np.array([*angles, 0.0, 0.0])]
    start = time.process_time()
    for _ in range(round(end / dt)):
        states.append(rk4(rates, np.append(states[-1], 0.0), [0.0, dt])[:4])
    seconds = time.process_time() - start
    a, b, v, w = np.array(states).T
    coupling = 1.25 + 0.5 * np.cos(b)
    energy = (0.5 * ((2.25 + 2.0 * coupling - 1.25) * v**2 + 1.25 * w**2) + coupling * v * w
              - 9.8 * (1.5 * np.cos(a) + 0.5 * np.cos(a + b)))
    return Course(energy[1:] / abs(energy[0]) - energy[0] / abs(energy[0]), seconds,
                  states[-1][:2])


def starts() -> list[np.ndarray]:
    """Return the angles of each seed [rad]."""
    return [np.random.default_rng(seed).uniform(-1.0, 1.0, 2) for seed in range(SEEDS)]


def measure(chain_steps: int, end: float, figure: Figure
            ) -> Iterator[tuple[str, int, str, float]]:
    """Yield the values of both tables, and draw them."""
    left, right = figure.subplots(1, 2)
    for method in CHAIN_METHODS:
        error, seconds, _ = chain(method, chain_steps)
        yield 'chain', 0, method, float(np.abs(error).max())
        yield 'chain', 0, f'{method}, seconds of the run', seconds
        t = CHAIN_STEP * np.arange(1, len(error) + 1)
        shown = slice(None, None, max(1, len(error) // 500))
        left.plot(t[shown], np.abs(error[shown]) + 1e-17, label=method, linewidth=0.8)
    runs: dict[str, list[list[Course]]] = {'Gymnasium rk4': [], METHOD: []}
    for dt, h in PAIRS.items():
        for name, step, run in (('Gymnasium rk4', dt, gymnasium), (METHOD, h, acrobot)):
            courses = [run(step, angles, end) for angles in starts()]
            runs[name].append(courses)
            for seed, (error, seconds, _) in enumerate(courses):
                yield f'acrobot {dt:g}', seed, name, float(np.abs(error).max())
                yield f'acrobot {dt:g}', seed, f'{name}, seconds of the run', seconds
    for (name, found), color in zip(runs.items(), ('#0072b2', '#d55e00'), strict=True):
        every = [course for courses in found for course in courses]
        right.loglog([course.seconds for course in every],
                     [np.abs(course.error).max() for course in every], 'o', markersize=4,
                     color=color, label=name)
    left.set(yscale='log', xlabel='t [s]', title='chain of ten links: |H - H(0)| / |H(0)|')
    right.set(xlabel='processor time of 100 s [s]', title='Acrobot: largest |H - H(0)| / |H(0)|')
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)


def main(argv: Sequence[str]) -> None:
    """Measure both tables, and write them with their picture and the page."""
    arguments = parser().parse_args(argv)
    figure = Figure(figsize=(9.0, 3.4), layout='constrained')
    steps, end = (1000, 2.0) if arguments.quick else (CHAIN_STEPS, END)
    print(keep(arguments.out, TABLE, measure(steps, end, figure)))
    save(figure, arguments.out, TABLE)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = parser_of(TABLE, __doc__)
    found.add_argument('--quick', action='store_true', help='short runs, to test the program')
    return found
