# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Hamiltonian of each model family."""

from hnn_vi_ros.models.control_affine import ControlAffineHamiltonian
from hnn_vi_ros.models.lagrangian import LagrangianHamiltonian
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.models.separable import SeparableHamiltonian
from hnn_vi_ros.models.symplectic_form import SymplecticFormHamiltonian
from hnn_vi_ros.models.variational import VariationalHamiltonian

FAMILIES: dict[str, type[LearnedHamiltonian]] = {
    'hnn': NeuralHamiltonian,
    'separable_hnn': SeparableHamiltonian,
    'dissipative_hnn': NeuralHamiltonian,
    'dgnet': NeuralHamiltonian,
    'vin': VariationalHamiltonian,
    'lagrangian': LagrangianHamiltonian,
    'control_affine': ControlAffineHamiltonian,
    'symplectic_form': SymplecticFormHamiltonian,
}
