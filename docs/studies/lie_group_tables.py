# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure models of the family lie_group: on published data, and over long times."""

from collections.abc import Callable, Sequence
import json
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.integrators.lie.lie_leapfrog import LieLeapfrog
from hnn_vi_ros.learning.data.arrays import read_bodies
from hnn_vi_ros.learning.families.lie_group import LieGroupNetwork
from hnn_vi_ros.learning.fit.body import joined
from hnn_vi_ros.learning.fit.config import find_config, load_config
from hnn_vi_ros.learning.tasks.body import INTERVALS, published_loss
from hnn_vi_ros.models import Checkpoint, load_checkpoint, turn_matrices
from hnn_vi_ros.models.lie_group import LieGroupHamiltonian
from hnn_vi_ros.simulation import Simulation
import numpy as np
from scipy.integrate import solve_ivp

# Each model with its test data, and the loss that its kind was published with.
CASES = {'turning_pendulum': ('so3_pendulum.npz', 2.0e-7),
         'damped_turning_pendulum': ('so3_pendulum_friction.npz', None),
         'flying_quadrotor': ('se3_quadrotor.npz', 4.0e-7)}
# A pendulum that is let go at an angle of 2 rad, and when it is looked at [s].
ANGLE, _EVERY = 2.0, 0.5
# The interval of the data, in which models of this kind are integrated [s], and the tolerances of
# torchdiffeq's dopri5.
INTERVAL, _RTOL, _ATOL = 0.05, 1e-7, 1e-9


class LongRun(NamedTuple):
    """Course of H [J], and of the norm of R^T R - 1, at times [s]."""

    t: np.ndarray
    energy_error: np.ndarray
    distance: np.ndarray


def test_loss(model: Checkpoint, name: str, data: Path) -> float:
    """Return the loss of a model as published; see body.published_loss."""
    config = load_config(find_config(name))
    _, test, _ = read_bodies(data, config.data, config.coordinates[0].kind)
    windows = joined([motion.windows(INTERVALS) for motion in test])
    return published_loss(LieGroupNetwork.of(model), config, windows)


def matrix_field(model: Checkpoint) -> tuple[Callable[[np.ndarray], np.ndarray],
                                             Callable[[np.ndarray], float]]:
    """
    Return the rates of (R row by row, p), shape (12,), and H: how others integrate such models.

    They take R for nine numbers, R' = R omega^ and p' = p x omega - g^* V_R, of a constant mass.
    """
    attitudes = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    inverse = LieGroupHamiltonian(model).gradient(attitudes, np.eye(3))[1]
    weights, biases = model.networks['potential']

    def layers(R: np.ndarray) -> list[np.ndarray]:
        found = [R]
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            found.append(np.tanh(weight @ found[-1] + bias))
        return found

    def rates(z: np.ndarray) -> np.ndarray:
        p, R, slope = z[9:], z[:9].reshape(3, 3), weights[-1][0]
        omega = inverse @ p
        for weight, a in zip(weights[-2::-1], layers(z[:9])[:0:-1], strict=True):
            slope = (slope * (1.0 - a * a)) @ weight
        A = R.T @ slope.reshape(3, 3)
        a, b, c = omega
        turning = R @ np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        torque = np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
        x, y, w = p
        bend = np.array([y * c - w * b, w * a - x * c, x * b - y * a])
        return np.concatenate([turning.ravel(), bend - torque])

    def energy(z: np.ndarray) -> float:
        return float(0.5 * z[9:] @ inverse @ z[9:]
                     + weights[-1][0] @ layers(z[:9])[-1] + biases[-1][0])
    return rates, energy


def long_runs(model: Checkpoint, step_size: float, end: float) -> dict[str, LongRun]:
    """Return runs of a learned pendulum, by the name of the integrator."""
    half = 0.5 * ANGLE
    q, count = np.array([0.0, 0.0, np.sin(half), np.cos(half)]), round(end / _EVERY)
    t = _EVERY * np.arange(count + 1)
    run = Simulation(LieGroupHamiltonian(model), LieLeapfrog('exponential'), step_size, q,
                     [0.0, 0.0, 0.0])
    states = []
    for _ in range(count + 1):
        states.append(np.concatenate([turn_matrices(run.q[None]).ravel(), run.p]))
        run.advance(round(_EVERY / step_size))
    rates, energy = matrix_field(model)
    z0 = np.concatenate([turn_matrices(q[None]).ravel(), np.zeros(3)])
    found = {'lie_leapfrog': np.array(states),
             'RK4 on matrices': _rk4(rates, z0, count),
             'dopri5 on matrices': solve_ivp(
                 lambda _, z: rates(z), (0.0, t[-1]), z0, 'RK45', t, rtol=_RTOL, atol=_ATOL).y.T}
    return {name: _looked_at(t, np.array(z), energy) for name, z in found.items()}


def _rk4(rates: Callable[[np.ndarray], np.ndarray], z: np.ndarray, count: int) -> np.ndarray:
    found, h = [z], INTERVAL
    for _ in range(count):
        for _ in range(round(_EVERY / h)):
            a = rates(z)
            b = rates(z + 0.5 * h * a)
            c = rates(z + 0.5 * h * b)
            z = z + h / 6.0 * (a + 2.0 * (b + c) + rates(z + h * c))
        found.append(z)
    return np.array(found)


def _looked_at(t: np.ndarray, z: np.ndarray, energy: Callable[[np.ndarray], float]) -> LongRun:
    H = np.array([energy(state) for state in z])
    R = z[:, :9].reshape(-1, 3, 3)
    gram = R.transpose(0, 2, 1) @ R - np.eye(3)
    return LongRun(t, np.abs(H - H[0]), np.linalg.norm(gram, axis=(1, 2)))


def draw(runs: dict[str, LongRun], path: Path) -> None:
    """Draw energy and distance from the group over time."""
    # Imported here: numbers alone need no library that draws.
    from matplotlib.figure import Figure
    figure = Figure(figsize=(8.0, 3.2), layout='constrained')
    axes = figure.subplots(1, 2)
    for name, run in runs.items():
        axes[0].plot(run.t[1:], run.energy_error[1:] + 1e-17, label=name, linewidth=0.9)
        axes[1].plot(run.t[1:], run.distance[1:] + 1e-17, label=name, linewidth=0.9)
    for ax, title in zip(axes, ('|H(t) - H(0)| [J]', 'norm of R^T R - 1'), strict=True):
        ax.set(yscale='log', xlabel='t [s]', title=title)
        ax.grid(alpha=0.3)
    # Between the curves of the group there is room.
    axes[1].legend(loc='center right')
    figure.savefig(path, dpi=110)


def seed_losses(folder: Path, data: Path) -> dict[str, dict[str, float]]:
    """Return the losses of other seeds, whose models are files NAME-SEED.safetensors, by both."""
    found: dict[str, dict[str, float]] = {}
    for path in sorted(folder.glob('*-*.safetensors')):
        name, _, seed = path.stem.rpartition('-')
        if name in CASES:
            found.setdefault(name, {})[seed] = test_loss(
                load_checkpoint(path), name, data / CASES[name][0])
    if not found:
        raise DataError(f'{folder}: no model NAME-SEED.safetensors; valid names: '
                        f'{", ".join(CASES)}')
    return found


def measure(data: Path, models: dict[str, Path], end: float) -> tuple[
        dict[str, Any], dict[str, LongRun]]:
    """Return the table of losses and of long runs, and these runs."""
    table: dict[str, Any] = {'test_loss': {}}
    for name, path in models.items():
        file, published = CASES[name]
        loss = test_loss(load_checkpoint(path), name, data / file)
        table['test_loss'][name] = {
            'ours': loss, 'published': published,
            'met': None if published is None else loss <= published}
    pendulum = load_checkpoint(models['turning_pendulum'])
    scheme = pendulum.card.scheme
    assert scheme is not None, 'it was trained through a method'
    runs = long_runs(pendulum, scheme.step_size, end)
    table['long_run'] = {'end': end, 'angle': ANGLE} | {
        name: {'energy_band': float(run.energy_error.max()),
               'energy_at_end': float(run.energy_error[-1]),
               'distance': float(run.distance.max())} for name, run in runs.items()}
    return table, runs


def main(argv: Sequence[str]) -> None:
    """Write the table, and the picture, of the page on bodies that turn."""
    arguments = parser().parse_args(argv)
    table, runs = measure(arguments.data, {path.stem: path for path in arguments.models},
                          arguments.end)
    if arguments.seeds is not None:
        table['seeds'] = seed_losses(arguments.seeds, arguments.data)
    arguments.json.write_text(json.dumps(table, indent=1) + '\n', encoding='utf-8')
    draw(runs, arguments.picture)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('lie_group_tables', __doc__, [
        'make study NAME=lie_group_tables ARGS="--data DATA --models MODEL --json FILE '
        '--picture FILE"'])
    found.add_argument('--data', type=Path, required=True, help='folder of the published data')
    found.add_argument('--models', type=Path, nargs='+', required=True,
                       help=f'model files with the names {", ".join(CASES)}')
    found.add_argument('--end', type=float, default=1000.0, help='end of the long runs [s]')
    found.add_argument('--seeds', type=Path, help=(
        'folder of models with other seeds, NAME-SEED.safetensors'))
    found.add_argument('--json', type=Path, required=True, help='table to write')
    found.add_argument('--picture', type=Path, required=True, help='picture to write')
    return found
