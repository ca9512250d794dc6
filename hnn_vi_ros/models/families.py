# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The model families: each row gives the contents of a card, the kernel and the training class."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple


class NetworkShape(NamedTuple):
    """
    Numbers of inputs and outputs of a network in a model of d coordinates.

    Parameters
    ----------
    inputs : int
        Inputs per coordinate: 2 for a network of (q, p) or (q, v), 1 for a network of q.
    outputs : callable
        ``outputs(d, found)`` returns the required number of outputs, given the ``found`` number.

    """

    inputs: int
    outputs: Callable[[int, int], int] = lambda d, found: 1


@dataclass(frozen=True)
class Family:
    """
    A family of models.

    Classes are given by name and imported lazily: reading a card needs no compiler, and simulating
    needs no torch.

    Parameters
    ----------
    networks : mapping of str to NetworkShape
        Networks in a model file; a single network is not named in it. Without networks the file
        contains H as a graph, traced from the trained module.
    compiled : str
        ``room.module:Class`` of the LearnedHamiltonian.
    trained : str
        ``room.module:Class`` of the learning.families.base.Family.
    constants : tuple of str
        Further entries of the card that are learned or required.
    conservative : bool
        True if H is constant along the training motions.
    canonical : bool
        True if the coordinates are canonical.
    dissipation : str
        Network that can be the D of the effect learned_dissipation; '' if none.
    averaged : str
        ``room.module:Class`` of the mean of several models; '' if not supported.
    measured_momenta : bool
        True if p is in the data; False if it is the model's own, p = M(q) q' with its own M.

    """

    networks: Mapping[str, NetworkShape] = field(default_factory=dict)
    compiled: str = 'models.graphs.hamiltonian:GraphHamiltonian'
    trained: str = ''
    constants: tuple[str, ...] = ()
    conservative: bool = True
    canonical: bool = True
    dissipation: str = ''
    averaged: str = ''
    measured_momenta: bool = True

    @property
    def hamiltonian(self) -> type:
        """Return the class of the compiled Hamiltonian; its argument is a checkpoint."""
        return _class(self.compiled)

    @property
    def mean(self) -> type:
        """Return the class of the mean of several models; its argument is their checkpoint."""
        return _class(self.averaged)

    @property
    def trainer(self) -> Any:
        """Return the torch module; its arguments are choice, hidden widths, scales and seed."""
        return _class(self.trained)


def _class(name: str) -> Any:
    module, _, own = name.partition(':')
    return getattr(import_module(f'hnn_vi_ros.{module}'), own)


FAMILIES = {
    'hnn': Family(
        {'energy': NetworkShape(2)}, 'models.neural:NeuralHamiltonian',
        'learning.families.hnn:HNN', dissipation='energy',
        averaged='models.ensemble:EnsembleHamiltonian'),
    'separable_hnn': Family(
        {'kinetic': NetworkShape(1), 'potential': NetworkShape(1)},
        'models.neural:SeparableHamiltonian', 'learning.families.hnn:SeparableHNN',
        averaged='models.ensemble:EnsembleHamiltonian'),
    'dissipative_hnn': Family(
        {'energy': NetworkShape(2), 'dissipation': NetworkShape(2)},
        'models.neural:NeuralHamiltonian', 'learning.families.hnn:DissipativeHNN',
        conservative=False,
        dissipation='dissipation'),
    'dgnet': Family(
        {'energy': NetworkShape(2)}, 'models.neural:NeuralHamiltonian',
        'learning.families.hnn:DGNet', constants=('friction',), conservative=False),
    'vin': Family(
        {'potential': NetworkShape(1)}, 'models.neural:VariationalHamiltonian',
        'learning.families.lagrangian:VIN', constants=('mass',)),
    'lagrangian': Family(
        {'lagrangian': NetworkShape(2)}, 'models.lagrangian:LagrangianHamiltonian',
        'learning.families.lagrangian:LagrangianNetwork', constants=('mass', 'velocities')),
    'symplectic_form': Family(
        {'one_form': NetworkShape(2, lambda d, found: 2 * d), 'energy': NetworkShape(2)},
        'models.symplectic_form:SymplecticFormHamiltonian',
        'learning.families.lagrangian:SymplecticForm', constants=('mass',), canonical=False),
    'control_affine': Family(
        {'mass_inverse': NetworkShape(1, lambda d, found: d * (d + 1) // 2),
         'potential': NetworkShape(1),
         'input_map': NetworkShape(1, lambda d, found: -(-found // d) * d)},
        'models.graphs.hamiltonian:GraphHamiltonian', 'learning.families.hnn:ControlAffine',
        conservative=False),
    # The inputs of its networks are features of q in the card's ``mechanical`` entry, which also
    # states if there is a third network, of friction.
    'mechanical': Family(
        {'mass': NetworkShape(1), 'potential': NetworkShape(1)},
        'models.mechanical:MechanicalHamiltonian',
        'learning.families.mechanical:MechanicalNetwork', constants=('mechanical',),
        conservative=False, averaged='models.mechanical:MechanicalHamiltonian',
        measured_momenta=False),
    # It models one body; the card's ``lie_group`` entry lists the inputs of its networks, and
    # further networks for dissipation and for an input map.
    'lie_group': Family(
        {'mass': NetworkShape(1), 'potential': NetworkShape(1)},
        'models.lie_group:LieGroupHamiltonian', 'learning.families.lie_group:LieGroupNetwork',
        constants=('lie_group',),
        conservative=False),
    # Not trained here: a torch module that was exported, as a graph of operations.
    'graph': Family(),
}
