# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Regenerate figures 1 and 2 of the paper from the shipped model, as PNG and CSV."""

from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import simulate, Trajectory
import numpy as np

# As in the paper, section 5.
STEP_SIZE, DURATION = 0.01, 100.0
METHODS = {'explicit_euler': 'explicit Euler', 'variational_euler': 'variational integrator'}
# Blue and orange as in the paper, distinguishable in grey.
Q_COLOR, P_COLOR, ENERGY_COLOR = '#1f4e9c', '#f28e2b', '#222222'


def main(argv: list[str]) -> int:
    """Run both methods and write the two figures and their data into a folder."""
    out = parser().parse_args(argv).out
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / 'paper_figures.csv').touch()
        runs = simulate_methods()
        for path in (write_csv(out / 'paper_figures.csv', runs),
                     draw_trajectories(out / 'paper_figure_1.png', runs),
                     draw_energies(out / 'paper_figure_2.png', runs)):
            print(path)
    except OSError as problem:
        raise ParameterError(f'--out {out}: cannot be written ({problem.strerror}); '
                             'give a folder that can be written') from problem
    return 0


def simulate_methods() -> dict[str, Trajectory]:
    """Simulate the learned oscillator with each method; the keys are the methods' names."""
    scene = load_scene('harmonic_oscillator')
    return {name: simulate(scene, DURATION, step_size=STEP_SIZE, integrator=name)
            for name in METHODS}


def write_csv(path: Path, runs: dict[str, Trajectory]) -> Path:
    """Write t [s] and, for each method, q [m], p [kg m/s] and H [J]: every tenth step."""
    columns = {'t': next(iter(runs.values())).t}
    for name, run in runs.items():
        columns |= {f'{name}_q': run.q[:, 0], f'{name}_p': run.p[:, 0],
                    f'{name}_energy': run.energy}
    table = np.column_stack(list(columns.values()))[::10]
    np.savetxt(path, table, delimiter=',', header=','.join(columns), comments='', fmt='%.9g')
    return path


def draw_trajectories(path: Path, runs: dict[str, Trajectory]) -> Path:
    """Draw figure 1: q and p over time, one panel a method."""
    figure, axes = _panels(f'Learned harmonic oscillator, h = {STEP_SIZE:g} s')
    largest = max(np.abs([run.q, run.p]).max() for run in runs.values())
    for ax, (name, run) in zip(axes, runs.items(), strict=True):
        ax.plot(run.t, run.q[:, 0], color=Q_COLOR, linewidth=1.0, label='q [m]')
        ax.plot(run.t, run.p[:, 0], color=P_COLOR, linewidth=1.0, linestyle='--',
                label='p [kg m/s]')
        # One scale for both panels, with room for the legend above the curves.
        ax.set(title=METHODS[name], ylabel='q, p', ylim=(-1.1 * largest, 1.6 * largest))
        ax.legend(loc='upper left', ncols=2)
    return _save(figure, path)


def draw_energies(path: Path, runs: dict[str, Trajectory]) -> Path:
    """Draw figure 2: the learned energy over time, one panel a method."""
    figure, axes = _panels(f'Energy of the learned harmonic oscillator, h = {STEP_SIZE:g} s')
    for ax, (name, run) in zip(axes, runs.items(), strict=True):
        ax.plot(run.t, run.energy, color=ENERGY_COLOR, linewidth=1.0)
        ax.set(title=METHODS[name], ylabel='H(q, p) [J]')
        # One scale from zero for both panels shows growth and conservation in proportion.
        ax.set_ylim(0.0, 1.05 * max(run.energy.max() for run in runs.values()))
        if name == 'variational_euler':
            _draw_inset(ax, run)
    return _save(figure, path)


def _draw_inset(ax: Any, run: Trajectory) -> None:
    """Draw how the energy of the last ten seconds stays in its band, which no panel resolves."""
    late = run.t >= DURATION - 10.0
    inset = ax.inset_axes([0.55, 0.5, 0.43, 0.42])
    inset.plot(run.t[late], 1e3 * (run.energy[late] - run.energy[0]), color=ENERGY_COLOR,
               linewidth=0.8)
    inset.set_title('H - H(0) [mJ], last 10 s', fontsize=8)
    inset.tick_params(labelsize=7)
    inset.grid(alpha=0.3)


def _panels(title: str) -> tuple:
    from matplotlib.figure import Figure
    figure = Figure(figsize=(9.0, 6.0), layout='constrained')
    axes = figure.subplots(2, 1, sharex=True)
    figure.suptitle(title)
    axes[-1].set(xlabel='t [s]', xlim=(0.0, DURATION))
    for ax in axes:
        ax.grid(alpha=0.3)
    return figure, axes


def _save(figure: object, path: Path) -> Path:
    figure.savefig(path, dpi=120)
    return path


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('paper_figures', __doc__, [
        'make study NAME=paper_figures ARGS="--out figures"'])
    found.add_argument('--out', type=Path, default=Path('docs/evidence'), metavar='DIR',
                       help='folder to write to (default: docs/evidence)')
    return found
