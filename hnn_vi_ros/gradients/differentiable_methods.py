# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Methods whose steps are differentiated, and those that are refused by name."""

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import method_name, methods_that
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.integrators.partitioned import PartitionedTableau
from hnn_vi_ros.integrators.workspaces import LARGEST_MATRIX


def differentiable_tableau(hamiltonian: Hamiltonian, integrator: Integrator) -> PartitionedTableau:
    """Return the tableau of a method, or raise UnsupportedSystem."""
    tableau = integrator.partitioned
    if tableau is None:
        able = methods_that(lambda method: method.partitioned is not None, hamiltonian)
        raise UnsupportedSystem(f'{method_name(integrator)} is not differentiable yet; methods '
                                f'that are: {able}')
    if not hamiltonian.canonical:
        raise UnsupportedSystem('a model of the family symplectic_form is not differentiable yet: '
                                'its second derivatives are differences')
    return tableau


def check_unknowns(integrator: Integrator, tableau: PartitionedTableau, d: int) -> None:
    """Raise UnsupportedSystem if a step of d coordinates has too many unknowns in its stages."""
    unknowns = 2 * tableau.stages * d
    if unknowns > LARGEST_MATRIX:
        raise UnsupportedSystem(
            f'{method_name(integrator)} has {tableau.stages} stages of {d} coordinates, '
            f'{unknowns} unknowns, of which up to {LARGEST_MATRIX} are differentiable; take a '
            'method of fewer stages')
