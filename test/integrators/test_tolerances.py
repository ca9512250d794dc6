# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of dop853 beside its tolerance, and of the choice of auto, on fifteen systems."""

from functools import cache

from hnn_vi_ros import export
from hnn_vi_ros.integrators import Dop853
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import InitialValueProblem, Method, Simulation, Tolerance
from hnn_vi_ros.simulation.accuracy.automatic_choice import calibrate, problem_of
from hnn_vi_ros.simulation.accuracy.trials import CalibrationTask
from hnn_vi_ros.simulation.dense_step import record_at
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch

DAMPING = {'kind': 'damping', 'rate': 0.4}
DRIVE = {'kind': 'periodic_drive', 'coordinate': 'angle', 'amplitude': 3.0, 'frequency': 0.4}
# Scenes with their effects, or others: conservative, damped, driven, with friction, from URDF.
SYSTEMS = {
    'exact_pendulum': None, 'exact_double_pendulum': None, 'kepler': None, 'henon_heiles': None,
    'fput_chain': None, 'tao': None, 'pendulum': None, 'learned_kepler': None,
    'damped_pendulum': None, 'exact_damped_driven_pendulum': None, 'two_joint_arm': None,
    'six_joint_arm': [{'kind': 'joint_friction', 'from': 'urdf'}],
    'double_pendulum': [{**DAMPING, 'rate': [0.3, 0.1]}],
    'separable_pendulum': [DRIVE, {
        'kind': 'quadratic_drag', 'coordinates': ['angle'], 'coefficient': 0.3}],
    'exported': [DAMPING]}
TOLERANCES, DURATION = (1e-4, 1e-6, 1e-8, 1e-10), 4.0
TIMES = np.linspace(0.0, DURATION, 41)[1:]
TIGHT = Method('dop853').within(1e-12)


class Exported(torch.nn.Module):
    """A pendulum whose mass depends on a layer."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.layer = torch.nn.Linear(1, 4, dtype=torch.float64)

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        q, p = z[..., :1], z[..., 1:]
        mass = 1.0 + 0.1 * torch.tanh(self.layer(torch.sin(q))).sum(-1)
        return p[..., 0] ** 2 / (2.0 * mass) + 4.0 * (1.0 - torch.cos(q[..., 0]))


@pytest.fixture(scope='module')
def problem(tmp_path_factory):
    """Return a function that returns a system by name, and its exact path."""
    folder = tmp_path_factory.mktemp('systems')

    @cache
    def found(name: str) -> tuple[InitialValueProblem, np.ndarray]:
        if name == 'exported':
            export(Exported(), folder / 'net.safetensors', ['angle'],
                   {'q': [(-3.0, 3.0)], 'p': [(-6.0, 6.0)]})
            scene = Scene.build(
                hamiltonian={'kind': 'hnn', 'model': str(folder / 'net.safetensors')},
                integrator='gauss8', step_size=0.1, initial_state=([1.5], [0.0]))
        else:
            scene = load_scene(name)
        system = problem_of(scene if SYSTEMS[name] is None else scene.changed(
            {'effects': SYSTEMS[name]}))
        return system, truth(system)
    return found


def truth(problem: InitialValueProblem) -> np.ndarray:
    """Return (q, p) at the times by scipy, from the compiled rates, forces included."""
    simulation = problem.simulation('dop853', 0.1)
    kernel, n, d = simulation.system.kernel, simulation.system.kernel.dimension, problem.q.size
    start = np.zeros(2 * n)
    start[:d], start[n:n + d] = problem.q, problem.p

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        dH_dq, dH_dp = np.empty((2, n))
        kernel.gradient(kernel.parameters, z[:n].copy(), z[n:].copy(), dH_dq, dH_dp)
        return np.append(dH_dp, -dH_dq)
    found = solve_ivp(rates, (0.0, DURATION), start, 'DOP853', TIMES, rtol=1e-13, atol=1e-14)
    assert found.success
    return np.hstack([found.y.T[:, :d], found.y.T[:, n:n + d]])


def error_of(simulation: Simulation, exact: np.ndarray) -> float:
    return float(np.abs(np.hstack(record_at(simulation, TIMES)) - exact).max())


def growth_of(system: InitialValueProblem) -> float:
    """Return by how much a small displacement of the initial state grows at most."""
    d, simulation = system.q.size, system.simulation(TIGHT, 0.1)
    states = []
    for direction in np.vstack([np.zeros(2 * d), 1e-7 * np.eye(2 * d)]):
        simulation.restart(system.q + direction[:d], system.p + direction[d:])
        states.append(np.hstack(record_at(simulation, TIMES)))
    return float(np.abs(np.array(states[1:]) - states[0]).max()) / 1e-7


@pytest.mark.parametrize('name', SYSTEMS)
def test_error_of_dop853_is_that_of_steps_of_its_tolerance_on(name, problem, measured):
    (system, exact), errors = problem(name), []
    growth, size = growth_of(system), 1.0 + np.abs(exact).max()
    for tolerance in TOLERANCES:
        simulation = Simulation(
            system.hamiltonian, Dop853(tolerance, tolerance), 0.1, system.q, system.p,
            system.effects)
        errors.append(error_of(simulation, exact))
        # Each internal step adds an error of the tolerance, which then grows as neighbouring
        # motions part; scipy at 1e-13 errs alike.
        most = simulation.internal_steps[0] * growth * size * (tolerance + 1e-13)
        measured('true error', f'dop853, {name}, tolerance {tolerance:g}', errors[-1],
                 f'<= {most:.1g}')
        assert errors[-1] <= most
    assert errors == sorted(errors, reverse=True)


@pytest.mark.long
@pytest.mark.parametrize('name', SYSTEMS)
@pytest.mark.parametrize('error', [1e-3, 1e-7])
def test_auto_holds_a_path_error_on(name, error, problem, measured):
    system, exact = problem(name)
    choice = calibrate(CalibrationTask(system, Tolerance('path_error', error, DURATION)))
    method = Method(choice.method, choice.arguments)
    found = error_of(system.simulation(method, choice.step_size), exact)
    measured('error of the choice of auto, over its tolerance', f'{name}, path_error {error:g}, '
             f'{method}, h = {choice.step_size:.3g}', found / error, '<= 1')
    assert found <= error
