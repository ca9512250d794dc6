# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Forces of effects as arrows on the bodies of a mechanism."""

from pathlib import Path

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS, MECHANISMS
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.recording.viewer.rerun_entities import ForceArrows
import numpy as np
import pytest
from rerun_reader import read


def sample(q: list[float], p: list[float], step: int = 0, motors: list[float] | None = None
           ) -> Sample:
    """Return a sample of masses of 1 kg."""
    return Sample(step, step, np.array(q), np.array(p), np.zeros(len(q)), np.array(p), 0.0, 0.0,
                  0.0, motors=None if motors is None else np.array(motors))


def arrows(kind: str, effects: list, one: Sample, hamiltonian=None) -> tuple[dict, float]:
    """Return vectors [N] of each force, shape (bodies, 3), and the scale."""
    hamiltonian = hamiltonian or HAMILTONIANS['free_particle'](names=['x', 'z'])
    made = ForceArrows(effects, hamiltonian, MECHANISMS[kind], 0.5, 1.0, 1.0)
    found = {name: np.array(next(batch.as_arrow_array().to_pylist() for batch in columns
                                 if 'vectors' in str(batch.component_descriptor())))
             for name, columns in made.columns([one])}
    return {name: vectors[0] / made.scale for name, vectors in found.items()}, made.scale


def test_forces_of_a_body_by_its_place_are_those_of_the_effects():
    effects = [EFFECTS['gravity'](coordinate='z', mass=2.0), EFFECTS['damping'](rate=0.5),
               EFFECTS['magnetic_field'](plane=['x', 'z'], charge=3.0, field=2.0)]
    found, scale = arrows('cartesian_pendulum', effects, sample([0.3, -0.4], [1.0, 2.0]))
    # float32, and differences of places: a millionth.
    assert found['gravity'] == pytest.approx(np.array([[0.0, 0.0, -19.62]]), abs=1e-4)
    # c v x B: across the velocity, which is p here, of size c B v.
    field = found['magnetic_field'][0]
    assert np.linalg.norm(field) == pytest.approx(6.0 * np.sqrt(5.0), rel=1e-5)
    assert abs(field @ [1.0, 0.0, 2.0]) < 1e-4
    # Of the momentum of the velocity, p - c A(q).
    assert found['damping'].shape == (1, 3) and found['damping'][0, 1] == 0.0
    # One newton is 1, 2 or 5 times a power of ten long, and the largest force is in the view.
    assert f'{scale:e}'[0] in '125' and scale * 19.62 <= 1.0 < 2.5 * scale * 19.62


def test_force_of_a_magnetic_field_is_what_the_motion_shows():
    run = simulate('charged_particle', 0.02)
    scene = load_scene('charged_particle')
    hamiltonian = scene.create_hamiltonian()
    one = sample(run.q[1].tolist(), run.p[1].tolist())
    h = float(run.t[1] - run.t[0])
    velocity = (run.q[2] - run.q[0]) / (2.0 * h)
    one = Sample(**{**vars(one), 'dH_dp': velocity})
    found, _ = arrows('charged_particle', scene.create_effects(), one, hamiltonian)
    # m a of 1 kg, by second differences: (h omega)^2 / 12 of it, and the rounding of q.
    acceleration = (run.q[2] - 2.0 * run.q[1] + run.q[0]) / h**2
    assert found['magnetic_field'][0, :2] == pytest.approx(acceleration, rel=1e-3, abs=1e-6)


def test_torque_is_drawn_as_the_force_across_the_rod_and_of_several_rods_makes_all_torques():
    drive = EFFECTS['periodic_drive'](coordinate='angle', amplitude=3.0, frequency=0.25)
    # At t = 2 step sizes of 0.5 s the drive is at a quarter: none; at 4, at its lowest.
    one = sample([0.7], [0.0], 4)
    found, _ = arrows('pendulum', [drive], one, HAMILTONIANS['pendulum']())
    assert found['periodic_drive'][0] == pytest.approx(
        -3.0 * np.array([np.cos(0.7), 0.0, np.sin(0.7)]), abs=1e-5)
    q, torques = np.array([0.4, -1.1]), np.array([2.0, -0.5])
    both, _ = arrows('double_pendulum', [], sample(q.tolist(), [0.0, 0.0], 0, torques.tolist()),
                     HAMILTONIANS['double_pendulum']())
    upper, lower = both['motors']
    along = [np.array([np.cos(angle), 0.0, np.sin(angle)]) for angle in q]
    # The upper angle moves both bobs, the lower one the second.
    assert [along[0] @ (upper + lower), along[1] @ lower] == pytest.approx(torques, abs=1e-5)


def test_recording_holds_arrows_and_says_how_long_a_newton_is(tmp_path: Path):
    path = tmp_path / 'run.rrd'
    simulate('exact_damped_driven_pendulum', 0.1).to_rerun(path)
    found = read(path)
    assert {'/world/forces/damping', '/world/forces/periodic_drive'} <= found.keys()
    drive = np.array(found['/world/forces/periodic_drive']['Arrows3D:vectors']).reshape(-1, 3)
    told = ' '.join(np.ravel(found['/events']['TextLog:text']))
    assert ('force arrows, 1 N is 0.05 m long: damping green, periodic_drive pink') in told
    # 10.7 N m at t = 0, on a rod drawn 1 m long.
    assert np.linalg.norm(drive[0]) == pytest.approx(0.05 * 10.7, rel=1e-5)
