# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Model files of earlier versions: that they load, and that their energies are those of then.

``older`` holds random models of version 0.2.0 (commit 85c01391), with the energies that its code
gave. Commit c174e397 wrote the exported module, and c836215b the mean of two mechanisms.
"""

from pathlib import Path

from hnn_vi_ros.models import load_learned
import numpy as np
import pytest

FOLDER = Path(__file__).parent / 'older'
# A state (q, p), and H there.
BODY = [0.61, -0.764, 0.125, -0.17], [-0.812, -0.134, -0.042]
TWO = [0.247, -0.414], [-0.826, -0.87]
ENERGIES = {
    'hnn': (*TWO, -0.20368737229376985),
    'separable_hnn': (*TWO, -0.0007254350205002091),
    'dissipative_hnn': (*TWO, -0.20368737229376985),
    'dgnet': (*TWO, -0.20368737229376985),
    'vin': (*TWO, -0.22241717542403472),
    'lagrangian': (*TWO, 0.4404519278683268),
    'control_affine': (*TWO, 0.17956843914301304),
    'symplectic_form': (*TWO, -0.028961957203774757),
    'mechanical': (*TWO, 1.5308556065630379),
    'lie_group': (*BODY, 1.2926228978931342),
    'graph': (*TWO, 3.093172789706796),
    'mean_of_hnn': ([0.247], [-0.414], -0.3078432760100348),
    'mean_of_mechanical': (*TWO, 0.672165329663348)}
# Some hundred operations on numbers of order one; 0.2.0 added them in another order.
ROUND_OFF = 1e-14


@pytest.mark.parametrize('name', ENERGIES)
def test_older_file_of_each_family_has_the_energy_of_its_version(name: str):
    q, p, energy = ENERGIES[name]
    hamiltonian = load_learned(FOLDER / f'{name}.safetensors')
    assert abs(hamiltonian.energy(np.array(q), np.array(p)) - energy) <= ROUND_OFF
