# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated machines of the study beyond_data: their equations, and what is written."""

from pathlib import Path

from hnn_vi_ros.learning.data.arrays import Archive
import numpy as np
from studies.beyond_data import Machine, step, write_machine


def energy(machine: Machine, q: np.ndarray, v: np.ndarray) -> float:
    """Return the energy of two links, a rotor that its gear turns, and the ripple."""
    (I1, I2), (g1, g2) = machine.inertia, machine.gravity
    first, second = v[0, 0], v[0].sum()
    links = 0.5 * I1 * first**2 + 0.5 * I2 * second**2 + machine.coupling * np.cos(
        q[0, 1]) * first * second
    rotor = 0.5 * machine.rotor * (first + machine.gear * v[0, 1])**2
    return links + rotor - g1 * np.cos(q[0, 0]) - g2 * np.cos(q[0].sum()) - \
        machine.ripple / 12.0 * np.cos(12.0 * q[0, 1])


def test_machine_without_friction_conserves_its_energy():
    machine = Machine.of(0)
    free = machine._replace(viscous=0.0 * machine.viscous, coulomb=0.0 * machine.coulomb)
    q, v, none = np.array([[0.5, -0.9]]), np.array([[2.0, -3.0]]), np.zeros((1, 2))
    before = energy(free, q, v)
    for _ in range(500):
        q, v = step(free, q, v, none, 1e-3)
    # Of order 4, with rates of some 36 rad/s (12 times 3 rad/s): (36e-3)^4 of about 5 J.
    assert abs(energy(free, q, v) - before) < 1e-5
    for _ in range(500):
        q, v = step(machine, q, v, none, 1e-3)
    assert energy(machine, q, v) < before


def test_second_half_of_the_runs_is_twice_as_fast(tmp_path: Path):
    write_machine(tmp_path / 'machine.npz', 0)
    arrays = Archive(tmp_path / 'machine.npz').arrays
    assert {key.partition('/')[2] for key in arrays} == {'t', 'q', 'dq', 'tau'}
    slow, fast = (np.sqrt(np.mean([arrays[f'{name}_{k}/dq']**2 for k in range(4)]))
                  for name in ('slow', 'fast'))
    assert 1.5 * slow < fast < 3.0 * slow
