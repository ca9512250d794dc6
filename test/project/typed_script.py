# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Script that mypy must accept with --strict; see test_linters.py. It is never run."""

from pathlib import Path

from hnn_vi_ros import load_scene, Scene, simulate, simulate_many, Trajectory
import numpy as np

scene: Scene = load_scene('pendulum')
own: Scene = Scene.build(hamiltonian='pendulum', integrator={'kind': 'gauss4'}, step_size=0.1,
                         initial_state=(np.array([1.0]), [0.0]))
run: Trajectory = simulate(own, duration=1.0, initial_state=(np.array([0.5]), [0.0]),
                           times=np.linspace(0.0, 1.0, 5))
run = simulate(lambda q, p: p**2 / 2 + q**4, 1.0, 0.0, duration=1.0, step_size=0.1)
state: tuple[np.ndarray, np.ndarray] = run[:5](0.05)
Trajectory.load(Path('run.safetensors')).to_csv('run.csv')
run = simulate('quadrotor', 1.0, commands=np.zeros((100, 4)))
run = simulate(scene, 1.0, commands=lambda t: [t])
many: Trajectory = simulate_many(scene, q=[[0.1], [0.2]], p=np.zeros((2, 1)), duration=1.0)
names: list[str] = run.names[0]
largest: float = float(np.abs(run.energy).max())
kinds = [alarm.kind for alarm in run.alarms]
run.plot(['angle']).savefig('plot.png')
many.select(0).phase_portrait().savefig('portrait.png')
run.to_rerun(Path('run.rrd'))
print(run.to_dataframe().describe(), run.to_xarray().attrs, names, largest, kinds)
