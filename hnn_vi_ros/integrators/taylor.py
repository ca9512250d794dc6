# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Taylor series of formulas, by heyoka."""

from collections.abc import Mapping
from importlib.util import find_spec
from inspect import getclosurevars
import math
import operator
import threading
from typing import Any

from hnn_vi_ros.errors import pip_command
from hnn_vi_ros.hamiltonians import straight_code
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.expressions import Graph, Symbol
from hnn_vi_ros.integrators.base import ENDLESS, Integrator, NOT_FINITE, OK, Point, Requirements
from hnn_vi_ros.integrators.dense_output import DenseOutput
from hnn_vi_ros.kernels.kernel import Kernel
import numpy as np

# Steps of its own in one step, beyond which it is given up: about a second of processor time.
_MOST_STEPS = 1_000_000
# States of a batch: with more, heyoka compiles longer and is no faster.
_LANES = 8
# Nodes of a graph from which on heyoka writes loops, which compile sooner and run slower.
_COMPACT = 1000
_OPERATIONS = {'sum': operator.add, 'raised': operator.pow}
# What names of parts of a held force begin with.
_FORCE = 'f'
_MONOMIALS = frozenset({'scaled', 'product', 'over', 'power', 'sqrt'})
# Series of the latest formulas of each thread, and how many: a restart compiles none again.
_SERIES, _KEPT = threading.local(), 16


class TaylorWork:
    """The series of one system, compiled by heyoka for one trajectory and for several at once."""

    def __init__(self, tolerance: float):
        self._tolerance = tolerance
        self._kernel: Kernel | None = None
        self._made: dict[int, Any] = {}
        # Imported here: an extra that no other method needs.
        import heyoka
        self._heyoka: Any = heyoka

    def series(self, kernel: Kernel, lanes: int) -> Any:
        """Return heyoka's integrator of so many states, compiled again for other parameters."""
        own = _original(kernel)
        if own is not self._kernel:
            self._kernel, self._made = own, {}
        if lanes not in self._made:
            graph, roots = _rates(own)
            known = vars(_SERIES)
            key = repr((graph.nodes, roots, self._tolerance, lanes))
            if key not in known:
                while len(known) >= _KEPT:
                    del known[next(iter(known))]
                known[key] = self._compiled(graph, roots, lanes)
            self._made[lanes] = known[key]
        return self._made[lanes]

    def _compiled(self, graph: Graph, roots: list[int], lanes: int) -> Any:
        """Return heyoka's integrator of rates."""
        names, state = _names(len(roots) // 2), np.zeros(len(roots))
        kind = self._heyoka.taylor_adaptive
        if lanes > 1:
            kind, state = self._heyoka.taylor_adaptive_batch, np.zeros((len(roots), lanes))
        return kind([*zip(self._heyoka.make_vars(*names), self._expressions(graph, roots),
                          strict=True)], state,
                    tol=self._tolerance, compact_mode=len(graph.nodes) > _COMPACT)

    def advance(self, kernel: Kernel, h: float, states: np.ndarray, **options: Any) -> Any:
        """Advance a state, shape (2 d,), or several, (2 d, lanes); return what heyoka says."""
        several = states.ndim > 1
        series = self.series(kernel, states.shape[1] if several else 1)
        series.state[:] = states
        if kernel.channels:
            series.pars[:] = _held_force(kernel, states)
        if several:
            series.set_time(0.0)
            series.propagate_until(h, max_steps=_MOST_STEPS)
            outcomes = [(row[0], row[3]) for row in series.propagate_res]
        else:
            series.time = 0.0
            outcome, _, _, steps, *path = series.propagate_until(
                h, max_steps=_MOST_STEPS, **options)
            if options:
                return path[0]
            outcomes = [(outcome, steps)]
        states[:] = series.state
        ends = self._heyoka.taylor_outcome
        for outcome, _ in outcomes:
            if outcome != ends.time_limit:
                return ENDLESS if outcome == ends.step_limit else NOT_FINITE, 0
        return OK, sum(steps for _, steps in outcomes)

    def path(self, kernel: Kernel, h: float, state: np.ndarray) -> DenseOutput:
        """Return the series through a step of length h [s] from (q, p), shape (2 d,)."""
        found = self.advance(kernel, h, state.copy(), c_output=True)
        # From coefficients of powers of time to those of powers of the share of each part.
        powers = np.diff(found.times)[:, None] ** np.arange(found.tcs.shape[2])
        coefficients = (found.tcs * powers[:, None, :]).transpose(2, 0, 1)
        return DenseOutput(found.tcs.shape[2] - 1, np.ascontiguousarray(coefficients),
                           state.size // 2, found.times / found.times[-1])

    def _expressions(self, graph: Graph, roots: list[int]) -> list[Any]:
        """Return nodes of a graph as expressions of heyoka."""
        found: dict[int, Any] = {}
        for a in graph.needed(roots):
            kind, *rest = graph.nodes[a]
            parts = [found[part] for part in graph.arguments(a)]
            if kind == 'number':
                found[a] = self._heyoka.expression(rest[0])
            elif kind == 'name':
                found[a] = self._heyoka.par[int(rest[0][1:])] if rest[0].startswith(_FORCE) \
                    else self._heyoka.make_vars(rest[0])
            elif kind in _MONOMIALS:
                found[a] = self._product(found, *_monomial(graph, a))
            elif kind == 'versine':
                found[a] = 2.0 * self._heyoka.sin(0.5 * parts[0]) ** 2.0
            else:
                found[a] = (_OPERATIONS.get(kind) or getattr(self._heyoka, kind))(*parts)
        return [found[root] for root in roots]

    def _product(self, found: Mapping[int, Any], factor: float, powers: Mapping[int, float]
                 ) -> Any:
        """Return a number times powers of what was found."""
        product = self._heyoka.expression(factor)
        for base, exponent in powers.items():
            if abs(exponent) == 1.0:
                product = product * found[base] if exponent > 0.0 else product / found[base]
            elif exponent:
                product = product * found[base] ** exponent
        return product


def _monomial(graph: Graph, a: int) -> tuple[float, dict[int, float]]:
    """Return a node as a number times powers: x / (r sqrt(r)) takes one series for r^-1.5."""
    kind, *rest = graph.nodes[a]
    if kind not in _MONOMIALS:
        return 1.0, {a: 1.0}
    if kind == 'sqrt':
        # Not of its own factors: the root of x^2 is no power of x.
        return 1.0, {rest[0]: 0.5}
    exponents = {'over': (1.0, -1.0), 'power': (float(rest[-1]),)}.get(kind, (1.0, 1.0))
    factor, powers = (rest[0] if kind == 'scaled' else 1.0), dict[int, float]()
    for part, exponent in zip(graph.arguments(a), exponents, strict=False):
        more, inside = _monomial(graph, part)
        factor *= more ** exponent
        for base, own in inside.items():
            powers[base] = powers.get(base, 0.0) + own * exponent
    return factor, powers


def _original(kernel: Kernel) -> Kernel:
    # Imported here: who only reads a scene compiles nothing.
    from hnn_vi_ros.kernels.addresses import original
    return original(kernel)


def _held_force(kernel: Kernel, state: np.ndarray) -> np.ndarray:
    """Return the force that a step holds, as the gradient at its start leaves it, shape (d,)."""
    (q, p), slopes = np.split(state, 2), np.empty((2, kernel.dimension))
    kernel.gradient(kernel.parameters, q, p, slopes[0], slopes[1])
    space: np.ndarray = _original(kernel).parameters[3]
    return space[3, :kernel.dimension - kernel.channels]


def _names(d: int) -> list[str]:
    return [f'{half}{i}' for half in 'qp' for i in range(d)]


def _rates(kernel: Kernel) -> tuple[Graph, list[int]]:
    """Return q' and p' as nodes of a graph, or raise TypeError where they are no formulas."""
    graph, d = Graph(), kernel.dimension
    z = np.array([Symbol(graph, graph.name(name)) for name in _names(d)])
    slopes = np.array([Symbol(graph, graph.number(0.0))] * (2 * d))
    _fill(kernel, z[:d], z[d:], slopes[:d], slopes[d:])
    # Of a cyclic coordinate, on which H does not depend, the slope is a number.
    return graph, [one.node if isinstance(one, Symbol) else graph.number(one)
                   for one in (*slopes[d:], *-slopes[:d])]


def _fill(kernel: Kernel, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray
          ) -> None:
    """Fill the gradient at symbols, of a formula and of potentials that join it."""
    kernel = _original(kernel)
    gradient: Any = getattr(kernel.gradient, 'py_func', kernel.gradient)
    inside = getclosurevars(gradient).nonlocals
    if 'add_all' in inside:
        # One that is held; its channel is the time, and its power times -1.
        base, d = kernel.parameters[0], q.size - 1
        _fill(kernel._replace(gradient=inside['base_gradient'], parameters=base),
              q[:d], p[:d], dH_dq[:d], dH_dp[:d])
        force = [Symbol(q[0].graph, q[0].graph.name(f'{_FORCE}{i}')) for i in range(d)]
        dH_dq[:d] = [slope - own for slope, own in zip(dH_dq, force, strict=False)]
        dH_dq[d] = -sum((v * own for v, own in zip(dH_dp, force, strict=False)), q[0] * 0.0)
        dH_dp[d] = q[0] * 0.0 + 1.0
    elif 'add_gradient' in inside:
        base, own, _ = kernel.parameters
        _fill(kernel._replace(gradient=inside['base_gradient'], parameters=base),
              q, p, dH_dq, dH_dp)
        inside['add_gradient'](own, q, dH_dq)
    elif gradient.__module__ == straight_code.__name__:
        gradient(kernel.parameters, q, p, dH_dq, dH_dp)
    else:
        raise TypeError(f'{kernel.gradient} is no formula')


class Taylor(Integrator):
    """
    Taylor series of the motion, of an order and in steps of its own as the tolerance asks for.

    A step goes from the state at its start to that at its end, over as many series as that takes:
    long steps cost least. Neither symplectic nor symmetric; with small tolerances the energy is
    kept to round-off, over long times too. For H as a formula: exact systems in scalar
    coordinates, ``formula``, robots of up to three joints; for potentials that join it, and for
    commands to ``external_force``, which a step holds. With ``pip install heyoka``.

    Parameters
    ----------
    tolerance : float
        Error of a series, relative to the state or absolute, whichever allows more; from 1e-16
        to 1e-3 [1]. The order is 1 - ln(tolerance) / 2.

    Raises
    ------
    ValueError
        A tolerance out of its range.

    References
    ----------
    F. Biscani, D. Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial
    mechanics, Mon. Not. R. Astron. Soc. 504 (2021).

    """

    explicit, compiled = True, False
    requirements = Requirements(symmetric=False, symplectic=False, forces='held')

    def __init__(self, tolerance: float = 1e-12):
        if not 1e-16 <= tolerance <= 1e-3:
            raise ValueError(f'tolerance = {tolerance} must be from 1e-16 to 1e-3')
        self._tolerance = float(tolerance)
        self.order = math.ceil(1.0 - 0.5 * math.log(tolerance))

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return why it takes no such Hamiltonian, to follow its name, or ''."""
        problem = super().refusal(hamiltonian)
        if problem:
            return problem
        try:
            _rates(hamiltonian.kernel)
        except (TypeError, ValueError):
            joined = getattr(hamiltonian, 'base', hamiltonian)
            return (f'needs a formula, with potentials at most, which {type(joined).__name__}'
                    f'{"" if joined is hamiltonian else " with these effects"} is not: no '
                    'network, no robot of more than three joints, no field, no abs')
        if find_spec('heyoka') is None:
            return ('needs the Python package heyoka; install it with: '
                    f'{pip_command("heyoka>=7.13,<8")}')
        return ''

    def own_times(self, kernel: Kernel) -> tuple[float, float]:
        """Return the time of a step in Python, and of each series; see Integrator."""
        nodes = len(_rates(_original(kernel))[0].nodes)
        return 1e-5, 7e-8 + 5e-11 * nodes * self.order ** 2

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the series, which are compiled in the first step; see Integrator."""
        return (TaylorWork(self._tolerance),)

    @staticmethod
    def step(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
             memory: tuple[TaylorWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        d, work = kernel.dimension, memory[0]
        lanes = z.q.size // d
        if lanes == 1:
            state = np.concatenate([z.q, z.p])
            outcome, spent = work.advance(kernel, h, state)
            z1.q[:], z1.p[:] = state[:d], state[d:]
            return outcome, 0.0, spent
        total, states = 0, np.hstack([z.q.reshape(lanes, d), z.p.reshape(lanes, d)])
        for first in range(0, lanes, _LANES):
            # The last batch is filled up with copies of its last state.
            rows = np.minimum(np.arange(first, first + _LANES), lanes - 1)
            batch = np.ascontiguousarray(states[rows].T)
            outcome, spent = work.advance(kernel, h, batch)
            if outcome != OK:
                return outcome, 0.0, total
            states[rows], total = batch.T, total + spent
        z1.q[:], z1.p[:] = states[:, :d].ravel(), states[:, d:].ravel()
        return OK, 0.0, total
