# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Turn networks of the public Lie-group Hamiltonian code into those of the family lie_group.

It saves one state_dict of several networks of layers linear1, linear2, ..., of tanh between them:

    so3    M_net, V_net, g_net, and Dw_net where there is friction; all see R row by row
    se3    M_net1 and Dv_net, which see x; M_net2 and Dw_net, which see R; V_net and g_net of both

Those of matrices give a lower triangular L, the diagonal first, then what is below it by rows:
M^-1 = (L + sqrt(epsilon)) (L + sqrt(epsilon))^T + floor, and D = L L^T. The family's networks have
the same form, with entries in another order; two networks that see different things become one
whose layers are blocks.

References
----------
T. Duong, A. Altawaitan, J. Stanley, N. Atanasov, Port-Hamiltonian Neural ODE Networks on Lie
Groups for Robot Dynamics Learning and Control, IEEE Trans. Robot. 40 (2024).

"""

from collections.abc import Mapping, Sequence
from typing import Any

from hnn_vi_ros.errors import listed
from hnn_vi_ros.models.checkpoint import Layers
from hnn_vi_ros.models.lie_group_card import LieGroupCard
import numpy as np
from scipy.linalg import block_diag

BODIES = ('so3', 'se3')
# Where our outputs, L by rows, stand in theirs.
_ORDER = [0, 3, 1, 4, 5, 2]
_ON_DIAGONAL = [0, 2, 5]
# Of each of our networks: theirs, one for each block of 3 x 3.
_SOURCES = {
    'so3': {'mass': ['M_net'], 'potential': ['V_net'], 'dissipation': ['Dw_net'],
            'input_map': ['g_net']},
    'se3': {'mass': ['M_net1', 'M_net2'], 'potential': ['V_net'],
            'dissipation': ['Dv_net', 'Dw_net'], 'input_map': ['g_net']}}


def body_networks(found: Mapping[str, Layers], layout: str, epsilon: float, floor: float
                  ) -> tuple[LieGroupCard, dict[str, Layers]]:
    """
    Return what a body's networks see, and those networks.

    Parameters
    ----------
    found : mapping of str to Layers
        The networks of a file, by the name before their layers.
    layout : str
        One of BODIES.
    epsilon : float
        Whose root is added to the diagonal of the root of M^-1 [1].
    floor : float
        What is added to the diagonal of M^-1 [1].

    Raises
    ------
    ValueError
        Networks are missing, others are there, or one has another number of inputs or outputs.

    """
    names = {name.removesuffix('.mlp'): layers for name, layers in found.items()}
    sources = _SOURCES[layout]
    needed = {name for network in ('mass', 'potential', 'input_map') for name in sources[network]}
    every = needed | set(sources['dissipation'])
    if not (needed <= names.keys() <= every) or 0 < len(
            names.keys() & set(sources['dissipation'])) < len(sources['dissipation']):
        raise ValueError(f'networks {listed(sorted(names)) or "none"}; the layout {layout} has '
                         f'{", ".join(sorted(needed))}, and for friction '
                         f'{", ".join(sources["dissipation"])}')
    seen: list[Any] = ['attitude'] if layout == 'so3' else ['position', 'attitude']
    size = 3 * len(seen)
    friction = sources['dissipation'][0] in names
    card = LieGroupCard(
        kind='rotation' if layout == 'so3' else 'pose', mass_scale=[1.0] * size, floor=floor,
        diagonal='any', mass_depends_on=seen, potential_depends_on=seen,
        dissipation_depends_on=seen if friction else None, input_map_depends_on=seen)
    inputs, networks = size + 6, {}
    for network, own in sources.items():
        if network == 'dissipation' and not friction:
            continue
        matrices = network in ('mass', 'dissipation')
        for name, block in zip(own, [(9,)] if len(own) == 1 else [(3,), (9,)], strict=True):
            expected = block[0] if matrices else inputs
            outputs = {'potential': 1, 'input_map': 0}.get(network, 6)
            _check(name, names[name], expected, outputs, size)
        if matrices:
            networks[network] = _blocks([
                _root(names[name], epsilon if network == 'mass' else 0.0) for name in own])
        else:
            networks[network] = names[own[0]]
    return card, networks


def _check(name: str, layers: Layers, inputs: int, outputs: int, size: int) -> None:
    first, last = layers.weights[0].shape[1], len(layers.weights[-1])
    if first != inputs or (last != outputs if outputs else last % size):
        raise ValueError(f'{name} has {first} inputs and {last} outputs, expected {inputs} and '
                         f'{outputs or f"a multiple of {size}"}')


def _root(layers: Layers, epsilon: float) -> Layers:
    """Return a network of L by rows, from one of its diagonal and what is below."""
    weights, biases = list(layers.weights), list(layers.biases)
    weights[-1], biases[-1] = weights[-1][_ORDER], biases[-1][_ORDER]
    biases[-1][_ON_DIAGONAL] += np.sqrt(epsilon)
    return Layers(tuple(weights), tuple(biases))


def _blocks(networks: Sequence[Layers]) -> Layers:
    """Return one network of the inputs and outputs of some of as many layers, side by side."""
    if len({len(layers.weights) for layers in networks}) > 1:
        raise ValueError('the networks of the two blocks have different numbers of layers')
    return Layers(
        tuple(block_diag(*weights) for weights in zip(
            *(layers.weights for layers in networks), strict=True)),
        tuple(np.concatenate(biases) for biases in zip(
            *(layers.biases for layers in networks), strict=True)))
