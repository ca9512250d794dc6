# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A potential energy given as a formula."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from hnn_vi_ros.effects.base import EffectState, Joined, Potential
from hnn_vi_ros.hamiltonians import check_names, Code, constants_of, Graph, read_formula
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate, scalar_columns


class FormulaPotential(Potential):
    """
    A potential energy V(q) as a formula of coordinates, such as ``k*(x - y)^2 / 2``.

    Syntax and compilation are as for H in ``hamiltonian: {kind: formula}``, but without the time
    t: for a force that oscillates in time use `periodic_drive`. Energy account: V is part of H.

    Parameters
    ----------
    formula : str
        V [J], at most 4000 characters, without the time t.
    parameters : dict of str to float, optional
        Values of the names in the formula that are not coordinates, in their units.

    Raises
    ------
    ValueError
        The formula is invalid, or a name is unknown or unused; the message gives the column.

    """

    def __init__(self, formula: str, parameters: dict[str, float] | None = None):
        self.formula, self.parameters = formula, dict(parameters or {})
        check_names('parameters', [*self.parameters])
        self._formulas: type[Joined] = FormulaPotential

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> tuple[float, ...]:
        """Return the constant subexpressions of V."""
        columns, graph = scalar_columns(coordinates), Graph()
        own = {name: value for name, value in self.parameters.items() if name not in columns}
        if len(own) < len(self.parameters):
            shared = sorted(self.parameters.keys() & columns)[0]
            raise ValueError(f'parameter {shared!r} has the name of a coordinate; rename it')
        root = read_formula('formula', graph, self.formula, [*columns], own).root
        moving = [name for name in columns if graph.depending([root], [name])]
        if not moving:
            raise ValueError('formula must depend on a coordinate')
        self.smooth = graph.is_smooth(root, moving, own)
        slopes = graph.gradient(root, moving)
        changes = {name: f'change of {name}' for name in moving}
        products = graph.tangents(slopes, changes)
        constants = constants_of(graph, [root, *slopes, *products], [*moving, *changes.values()])
        code = Code(graph, constants, {
            **{name: f'q[{columns[name]}]' for name in moving},
            **{changes[name]: f'v[{columns[name]}]' for name in moving}})
        places = [columns[name] for name in moving]
        self._formulas = _formulas_class(
            code.function('energy', 'q', [], [root]),
            code.function('add_gradient', 'q, dH_dq', [f'dH_dq[{i}]' for i in places], slopes,
                          add=True),
            code.function('add_hessian_vector', 'q, v, product',
                          [f'product[{i}]' for i in places], products, add=True))
        values = graph.values(constants, own)
        return tuple(float(values[a]) for a in constants)

    def formulas(self, parameters: tuple[float, ...]) -> type[Joined]:
        """Return the formulas in the coordinates that were last resolved."""
        return self._formulas


@cache
def _formulas_class(*functions: Callable[..., Any]) -> type[Joined]:
    """Return a class of three functions, under a name that is unique to their sources."""
    names = ('energy', 'add_gradient', 'add_hessian_vector')
    digests = '_'.join(function.__qualname__.rpartition('_')[2] for function in functions)
    made = type(f'FormulaPotential_{digests}', (FormulaPotential,), {
        name: staticmethod(inlined(function))
        for name, function in zip(names, functions, strict=True)})
    made.__module__ = __name__
    return made
