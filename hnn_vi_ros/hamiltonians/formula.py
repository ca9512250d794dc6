# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian given as a formula."""

from functools import cached_property
from typing import Any

from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.hamiltonians.arguments import TIME
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.expressions import Graph
from hnn_vi_ros.hamiltonians.straight_code import check_names, graph_kernel, NAME, read_hamiltonian
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.phase_space import Coordinate, IN_DEGREES
import numpy as np
from pydantic import Field, field_validator

_MAX_COORDINATES = 100


class FormulaCoordinate(StrictModel):
    """A coordinate with units."""

    name: str = Field(pattern=NAME, max_length=100, description='name in the formula')
    q_unit: str = Field('1', max_length=30, description='unit of the coordinate; rad for an angle')
    p_unit: str = Field('1', max_length=30, description='unit of its momentum')

    @field_validator('q_unit')
    @classmethod
    def _check_unit(cls, unit: str) -> str:
        if IN_DEGREES.search(unit):
            raise ValueError(f'{unit}: angles must be in rad, in states and in the formula')
        return unit


class Formula(Hamiltonian):
    """
    H as a formula of coordinates c and momenta p_c, such as ``p_x^2 / (2*m) + k*x^2 / 2``.

    It may contain numbers, names, ``+ - * / ^`` (or ``**``), brackets, ``pi``, and the functions
    abs, acos, acosh, asin, asinh, atan, atan2, atanh, cbrt, cos, cosh, exp, expm1, log, log1p,
    max, min, piecewise, sign, sin, sinh, sqrt, tan and tanh; ``piecewise(x > 0, a, b)`` is a where
    x > 0, and b elsewhere. The momentum of q1 may be called p1. The text is never executed: it is
    parsed, differentiated, and compiled like the other systems. The gradient is computed by
    reverse accumulation, products with H'' by forward accumulation through it; both are exact up
    to round-off.

    ``t`` is the time [s], unless a coordinate or a parameter has this name. The energy account of
    H(q, p, t) contains the work of the drive, the integral of dH/dt.

    Parameters
    ----------
    coordinates : list of str or of mapping
        Names of the coordinates, or each with its units: ``{name: x, q_unit: m, p_unit: kg m/s}``.
    H : str
        The formula [J], at most 4000 characters.
    parameters : dict of str to float, optional
        Values of the other names in the formula, in their units.

    Raises
    ------
    ValueError
        The formula is invalid, a name is unknown or unused, or a coordinate never moves; the
        message gives the column.

    References
    ----------
    A. Griewank, A. Walther, Evaluating Derivatives, 2008, chapters 3 and 5.

    """

    def __init__(self, coordinates: list[str | FormulaCoordinate], H: str,
                 parameters: dict[str, float] | None = None):
        self.coordinates = tuple(map(_coordinate, coordinates))
        self.parameters, self._text = dict(parameters or {}), H
        names = [coordinate.name for coordinate in self.coordinates]
        if not names:
            raise ValueError('coordinates must contain at least one name')
        check_names('coordinates', names, {f'p_{name}' for name in names}, _MAX_COORDINATES)
        graph = self._graph = Graph()
        self._read = read_hamiltonian(graph, names, H, self.parameters)
        root = self._root = self._read.root
        self._momenta = [f'p_{name}' for name in names]
        for name, momentum in zip(names, self._momenta, strict=True):
            if not graph.depending([root], [momentum]):
                raise ValueError(f'H does not depend on {momentum}, so {name} would never move; '
                                 'add its kinetic energy')
        timed = [TIME] if TIME in {*self._read.names} - {*names, *self.parameters} else []
        self.time = np.zeros(2) if timed else None
        both = names + self._momenta + timed
        self._slopes = graph.gradient(root, both)
        d = len(names)
        self.smooth = graph.is_smooth(root, both, self.parameters)
        self.separable = not (graph.depending(self._slopes[:d], self._momenta)
                              or graph.depending(self._slopes[d:2 * d], names + timed))

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        return graph_kernel(self._graph, self._root, [c.name for c in self.coordinates],
                            self._momenta, self.parameters, self.time)

    def check_state(self, q: np.ndarray, p: np.ndarray) -> None:
        """Raise ValueError, with the column, if H or H' is not finite at a state, (d,) each."""
        names = [c.name for c in self.coordinates]
        known = {TIME: 0.0, **self.parameters, **dict(zip(names, q, strict=True)),
                 **dict(zip(self._momenta, p, strict=True))}
        values = self._graph.values([self._root, *self._slopes], known)
        for node in sorted(values):
            if not np.isfinite(values[node]):
                begin, end = self._read.parts.get(node, (0, len(self._text)))
                own = node in self._read.parts
                raise ValueError(
                    f'H column {begin + 1}: {self._text[begin:end]!r:.80} '
                    f'{f"is {values[node]:g}" if own else "has no finite derivative"} at the '
                    'initial state; start elsewhere')


def _coordinate(choice: Any) -> Coordinate:
    if isinstance(choice, str):
        return Coordinate(choice)
    return Coordinate(**FormulaCoordinate.model_validate(choice).model_dump())
