# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Learned Hamiltonians: model files, their cards and the compiled networks.

Trained networks are simulated here, without torch. Training is in ``learning``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.models.attitude_features import group_of, see_attitude, turn_matrices, widened
    from hnn_vi_ros.models.box_error import (
        energy_error, energy_spread, EnergyError, Interval, interval_text, rows_of_each)
    from hnn_vi_ros.models.checkpoint import (
        Checkpoint, complete_checkpoint, file_digest, load_checkpoint, save_checkpoint)
    from hnn_vi_ros.models.confined import ConfinedHamiltonian, load_learned
    from hnn_vi_ros.models.domain import (
        CandidateCard, Domain, domain_of, DomainCard, Errors, force_unit, SelectionCard)
    from hnn_vi_ros.models.ensemble import load_member
    from hnn_vi_ros.models.exact_prior import exact_system, exact_systems, functions_of
    from hnn_vi_ros.models.families import FAMILIES
    from hnn_vi_ros.models.graphs.graph import Builder, graph_data, read_graph
    from hnn_vi_ros.models.graphs.hamiltonian import GraphHamiltonian
    from hnn_vi_ros.models.graphs.machine import GraphParameters
    from hnn_vi_ros.models.lagrangian import midpoint_action
    from hnn_vi_ros.models.learned import LearnedHamiltonian, warn_of_scheme
    from hnn_vi_ros.models.lie_group_card import LieGroupCard, PoseInput
    from hnn_vi_ros.models.machine_text import (
        equation_text, parameters_text, ratio_unit, sum_text)
    from hnn_vi_ros.models.mechanical import prior_kernel
    from hnn_vi_ros.models.mechanical_card import (
        check_prior, check_row, CoulombTerm, entries_of, FittedNumber, FrictionCard, is_periodic,
        Kind, mean_card, MechanicalCard, MOST_MEMBERS, PriorCard, Quantity, StribeckTerm)
    from hnn_vi_ros.models.model_card import (
        averaged_families, Box, CoordinateCard, EnsembleCard, ModelCard, PredictionError, Scheme,
        Units)
    from hnn_vi_ros.models.networks.activations import SMOOTH
    from hnn_vi_ros.models.networks.layers import Layers, widths_of
    from hnn_vi_ros.models.neural import (
        NeuralHamiltonian, SeparableHamiltonian, VariationalHamiltonian)
    from hnn_vi_ros.models.outputs import fill_outputs, pack_friction, pack_network
    from hnn_vi_ros.models.planar_chain import (
        chain_angles, CHAINS, HIGHEST_POWER, is_spring, OFFSET, parameter_names, parameter_places,
        PLANAR_CHAIN, unit_terms)
    from hnn_vi_ros.models.rigid_body_card import (
        BaseParameter, EACH, Identification, INERTIAL, pseudo_inertia, RIGID_BODY, tree_card,
        TreeCard, values_of)
    from hnn_vi_ros.models.symplectic_form import irregularity, REMEDY
    from hnn_vi_ros.models.torch_module import rows_of, TorchHamiltonian
    from hnn_vi_ros.models.torch_network import Network

__getattr__, __dir__ = lazy_exports(__name__)
