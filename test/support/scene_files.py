# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scene files written by tests, composed of parts in YAML."""

from collections.abc import Sequence
from pathlib import Path


def scene_text(kind: str = 'harmonic_oscillator', effects: str = '',
               integrator: str = 'generalized_leapfrog', step_size: float = 0.01,
               q: Sequence[float] = (1.0,), p: Sequence[float] = (0.0,), more: str = '') -> str:
    """Return the text of a scene; the kinds of H and integrator may be followed by parameters."""
    return (f'hamiltonian: {{kind: {kind}}}\neffects: [{effects}]\n'
            f'integrator: {{kind: {integrator}}}\nstep_size: {step_size}\n'
            f'initial_state: {{q: {[*q]}, p: {[*p]}}}\n{more}')


def write_scene(path: Path, *parts: str, **other: object) -> Path:
    """Write a scene file with the parts of `scene_text`."""
    path.write_text(scene_text(*parts, **other))
    return path


# The paper's iteration does not converge in its 17th step.
FAILING = scene_text('tao', '', 'variational_euler, solver: fixed_point', 0.4, p=[-1.0])
ACTED_ON = """\
hamiltonian: {kind: free_particle, mass: 2.0, names: [x, y]}
effects:
  - {kind: gravity, coordinate: y}
  - kind: damping
    rate: 0.1
  - {kind: spring, point: [x], anchor: [0]}
integrator: {kind: generalized_leapfrog}
step_size: 0.01
initial_state: {q: [1.0, 0], p: [0, 0]}
"""
