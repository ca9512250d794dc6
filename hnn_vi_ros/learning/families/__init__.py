# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Model families: what is learned, each a torch module that gives its networks to a file."""

from hnn_vi_ros.learning.families.control_affine import ControlAffine
from hnn_vi_ros.learning.families.dgnet import DGNet
from hnn_vi_ros.learning.families.dissipative_hnn import DissipativeHNN
from hnn_vi_ros.learning.families.hnn import HNN
from hnn_vi_ros.learning.families.lagrangian import LagrangianNetwork
from hnn_vi_ros.learning.families.separable_hnn import SeparableHNN
from hnn_vi_ros.learning.families.symplectic_form import SymplecticForm
from hnn_vi_ros.learning.families.vin import VIN

FAMILIES = {
    'hnn': HNN,
    'separable_hnn': SeparableHNN,
    'dissipative_hnn': DissipativeHNN,
    'dgnet': DGNet,
    'vin': VIN,
    'lagrangian': LagrangianNetwork,
    'control_affine': ControlAffine,
    'symplectic_form': SymplecticForm,
}
