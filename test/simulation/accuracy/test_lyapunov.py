# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lyapunov times, against the variational equations and for motions that are not chaotic."""


from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import lyapunov_time
from hnn_vi_ros.simulation.accuracy import automatic_choice
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp

REGULAR = {
    'oscillator': ('harmonic_oscillator', [1.0], [0.0], 0.1),
    'pendulum that turns over': ('pendulum', [0.0], [8.0], 0.02),
    'pendulum next to its separatrix': ('pendulum', [3.1], [0.0], 0.02),
    'Hénon-Heiles at a low energy': ('henon_heiles', [0.05, 0.0], [0.0, 0.05], 0.1),
    'eccentric orbit': ('kepler', [0.5, 0.0], [0.0, np.sqrt(3.0)], 0.01),
}


def scene_of(kind: str, q: list[float], p: list[float], h: float,
             method: str = 'generalized_leapfrog') -> Scene:
    """Build a scene."""
    return Scene.build(hamiltonian=kind, integrator=method, step_size=h, initial_state=(q, p))


@pytest.mark.parametrize('name', REGULAR)
def test_lyapunov_time_of_a_regular_motion_is_infinite(name: str):
    scene = scene_of(*REGULAR[name])
    assert lyapunov_time(scene, 4096 * scene.step_size) == np.inf


def tangent_growth(duration: float, q: list[float], p: list[float]) -> float:
    """Return the exponent of Hénon and Heiles' system from its variational equations [1/s]."""
    def field(t: float, z: np.ndarray) -> np.ndarray:
        x, y, px, py, dx, dy, dpx, dpy = z
        return np.array([px, py, -x - 2 * x * y, -y - x * x + y * y, dpx, dpy,
                         -(1 + 2 * y) * dx - 2 * x * dy, -2 * x * dx - (1 - 2 * y) * dy])
    z, growth = np.array([*q, *p, 1.0, 0.0, 0.0, 0.0]), 0.0
    for _ in range(int(duration / 10.0)):
        z = solve_ivp(field, (0.0, 10.0), z, method='DOP853', rtol=1e-10, atol=1e-12).y[:, -1]
        size = np.linalg.norm(z[4:])
        growth, z[4:] = growth + np.log(size), z[4:] / size
    return growth / duration


def test_lyapunov_time_of_a_chaotic_motion_is_that_of_the_variational_equations():
    q, p = [0.0, -0.25], [0.42, 0.1]
    found = lyapunov_time(scene_of('henon_heiles', q, p, 0.05))
    # Exponents over some twenty Lyapunov times fluctuate by a quarter of their value.
    assert found == pytest.approx(1.0 / tangent_growth(2000.0, q, p), rel=0.5)


def test_lyapunov_time_takes_the_name_of_a_scene():
    assert lyapunov_time('exact_harmonic_oscillator', 4.0) == np.inf


def test_lyapunov_time_takes_the_method_that_auto_chooses(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr(automatic_choice, 'calibrate', lambda task: automatic_choice.Choice(
        'gauss4', 0.1, 1e-4, 10.0, 1e-3, 4e3, {}, 0.5))
    scene = Scene.build(
        hamiltonian='harmonic_oscillator', initial_state=([1.0], [0.0]),
        integrator={'kind': 'auto', 'energy_error': 1e-3, 'horizon': 10.0})
    assert lyapunov_time(scene, 4.0) == np.inf


def test_a_motion_that_runs_away_has_no_lyapunov_time_and_that_is_said():
    """Beyond h = 2 the method of Størmer and Verlet is unstable on the oscillator of 1 rad/s."""
    with pytest.raises(HnnViRosError, match='diverged to .*, where rounding hides a neighbour'):
        lyapunov_time(scene_of('harmonic_oscillator', [1.0], [0.0], 2.1, 'stormer_verlet'))


@pytest.mark.parametrize('name, duration, error', [
    ('henon_heiles', -1.0, ValueError), ('henon_heiles', np.nan, ValueError),
    ('henon_heiles', '1 s', TypeError), ('bouncing_mass', None, ValueError)])
def test_lyapunov_time_refuses_what_it_cannot_use_in_a_sentence(name, duration, error):
    with refused(error):
        lyapunov_time(load_scene(name), duration)


def test_lyapunov_time_is_the_same_each_time():
    scene = scene_of('henon_heiles', [0.0, -0.25], [0.42, 0.1], 0.1)
    assert lyapunov_time(scene) == lyapunov_time(scene)
