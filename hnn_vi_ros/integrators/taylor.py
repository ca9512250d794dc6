# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Taylor series of formulas, by heyoka."""

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from inspect import getclosurevars
import math
import operator
import threading
from typing import Any

from hnn_vi_ros.errors import pip_command
from hnn_vi_ros.hamiltonians import (
    check_between, Graph, Hamiltonian, straight_code, SWITCHES, Symbol)
from hnn_vi_ros.integrators.base import (
    ENDLESS, Integrator, NOT_FINITE, OK, PhasePoint, Requirements)
from hnn_vi_ros.integrators.dense_output import DenseOutput
from hnn_vi_ros.kernels import Kernel
import numpy as np

# Maximum number of series in one step, and of series that are checked one by one: about a second
# of processor time.
_MAX_STEPS, _MAX_PARTS = 1_000_000, 10_000
# States of a batch; heyoka compiles longer for more, and is no faster.
_BATCH_STATES = 8
# Number of graph nodes from which on heyoka writes loops, which compile faster and run slower.
_COMPACT_NODES = 1000
_OPERATIONS = {'sum': operator.add, 'raised': operator.pow}
# Prefix of the names of components of a force that is constant in a step.
_FORCE = 'f'
_MONOMIALS = frozenset({'scaled', 'product', 'over', 'power', 'sqrt'})
# Allowed change of energy of a series, in units of its tolerance; and per series of a step.
_MAX_ENERGY_CHANGE, _MAX_SERIES_CHANGE = 10.0, 10.0
# The shortest allowed series, relative to the step; and the factor in length after which a series
# is accepted if its energy error did not improve by the last factor.
_SHORTEST_SERIES, _LENGTH_RATIO, _MIN_GAIN = 2.0**-40, 256.0, 16.0
_EPS = float(np.finfo(np.float64).eps)
# Number of compiled series that each thread keeps: a restart and an equal formula reuse them.
_CACHE_SIZE = 32


class _SeriesCache(threading.local):
    """Compiled series of the thread: by kernel, which is kept alive, and by formula."""

    def __init__(self) -> None:
        self._known: dict[Any, tuple[Any, Any]] = {}

    def __call__(self, key: Any, owner: Any, make: Callable[[], Any]) -> Any:
        """Return the series of a key, made at the first call."""
        if key not in self._known:
            made = make()
            while len(self._known) >= _CACHE_SIZE:
                del self._known[next(iter(self._known))]
            self._known[key] = owner, made
        return self._known[key][1]


_CACHE = _SeriesCache()


class TaylorWork:
    """The series of one system, compiled by heyoka for one trajectory and for a batch."""

    def __init__(self, tolerance: float):
        self._tolerance = tolerance
        # Imported lazily: an optional package that no other method needs.
        import heyoka
        self._heyoka: Any = heyoka

    def series(self, kernel: Kernel, lanes: int, scales: np.ndarray) -> Any:
        """Return heyoka's integrator for a batch of ``lanes`` scaled states; see ``_scales``."""
        own, how = _original(kernel), (self._tolerance, lanes, scales.tobytes())

        def made() -> Any:
            graph, roots = _rates(own)
            return _CACHE(repr((graph.nodes, roots, *how)), None,
                          lambda: self._compiled(graph, roots, lanes, scales))
        return _CACHE((id(own), *how), own, made)

    def _compiled(self, graph: Graph, roots: list[int], lanes: int, scales: np.ndarray) -> Any:
        """Return heyoka's integrator of the rates in a graph."""
        names, state = _names(len(roots) // 2), np.zeros(len(roots))
        kind = self._heyoka.taylor_adaptive
        if lanes > 1:
            kind, state = self._heyoka.taylor_adaptive_batch, np.zeros((len(roots), lanes))
        rates = self._expressions(graph, roots, dict(zip(names, scales, strict=True)))
        return kind([*zip(self._heyoka.make_vars(*names), rates, strict=True)], state,
                    tol=self._tolerance, compact_mode=len(graph.nodes) > _COMPACT_NODES)

    def advance(self, kernel: Kernel, h: float, states: np.ndarray,
                parts: list[tuple[float, np.ndarray]] | None = None) -> tuple[int, int]:
        """
        Advance states, shape (lanes, 2 d), by h [s]; return the outcome and the number of series.

        Parameters
        ----------
        kernel, h, states
            Arguments of the step.
        parts : list, optional
            Receives length and coefficients, (2 d, order + 1), of each series of one state.

        """
        begin, scales = states.copy(), _scales(kernel, h, states)
        forces = _held_force(kernel, states[0]) if kernel.channels else np.empty(0)
        counts = self._whole(kernel, h, states, scales, forces, parts)
        for i, (first, row) in enumerate(zip(begin, states, strict=True)):
            room = _MAX_SERIES_CHANGE * (1 + counts[i])
            if not (counts[i] and self._keeps(kernel, first, row, scales, room)):
                outcome, counts[i] = self._by_parts(kernel, h, first, row, scales, forces, parts)
                if outcome != OK:
                    return outcome, sum(counts)
        return OK, sum(counts)

    def _whole(self, kernel: Kernel, h: float, states: np.ndarray, scales: np.ndarray,
               forces: np.ndarray, parts: list[tuple[float, np.ndarray]] | None) -> list[int]:
        """Advance states by as many series as needed; return their numbers, 0 for a failure."""
        series, end = self.series(kernel, len(states), scales), self._heyoka.taylor_outcome
        series.state[:] = (states / scales).T.reshape(series.state.shape)
        if kernel.channels:
            series.pars[:] = forces if len(states) == 1 else forces[:, None]
        if len(states) > 1:
            series.set_time(0.0)
            series.propagate_until(h, max_steps=_MAX_STEPS)
            found = [(row[0], row[3]) for row in series.propagate_res]
        else:
            series.time = 0.0
            outcome, _, _, count, path, *_ = series.propagate_until(
                h, max_steps=_MAX_STEPS, c_output=parts is not None)
            found = [(outcome, count)]
            if parts is not None and path is not None:
                parts.extend(zip(np.diff(path.times), path.tcs * scales[:, None], strict=True))
        states[:] = series.state.T.reshape(states.shape) * scales
        return [count if outcome == end.time_limit else 0 for outcome, count in found]

    def _by_parts(self, kernel: Kernel, h: float, first: np.ndarray, last: np.ndarray,
                  scales: np.ndarray, forces: np.ndarray,
                  parts: list[tuple[float, np.ndarray]] | None) -> tuple[int, int]:
        """Fill the last state, using series that conserve the energy, shortened if needed."""
        series, state, time, limit = self.series(kernel, 1, scales), first.copy(), 0.0, h
        worst = 0.0, 0.0
        if parts is not None:
            parts.clear()
        for count in range(1, _MAX_PARTS):
            rest = h - time
            series.state[:], series.time = state / scales, 0.0
            if kernel.channels:
                series.pars[:] = forces
            _, length = series.step(limit if abs(limit) < abs(rest) else rest, write_tc=True)
            last[:] = series.state * scales
            drift, _ = _energy_drift(kernel, state, last)
            kept = self._keeps(kernel, state, last, scales, 1.0)
            # If far shorter series do not improve the energy, its error is rounding.
            if kept or (abs(length) * _LENGTH_RATIO < worst[0] and drift * _MIN_GAIN > worst[1]):
                if parts is not None:
                    parts.append((length, series.tc * scales[:, None]))
                if length == rest:
                    return OK, count
                state, time, limit = last.copy(), time + length, 2.0 * length
                worst = (0.0, 0.0) if kept else worst
            else:
                worst = worst if worst[0] else (abs(length), drift)
                limit = 0.5 * (length if np.isfinite(length) and length else limit)
                if abs(limit) < _SHORTEST_SERIES * abs(h):
                    return (ENDLESS if np.isfinite(drift) else NOT_FINITE), count
        return ENDLESS, count

    def _keeps(self, kernel: Kernel, first: np.ndarray, last: np.ndarray, scales: np.ndarray,
               room: float) -> bool:
        """Return True if the energy changes by no more than the errors of ``room`` series."""
        error = room * _MAX_ENERGY_CHANGE * max(self._tolerance, _EPS)
        drift, size = _energy_drift(kernel, first, last)
        return drift <= error * size or drift <= error * max(
            _terms(kernel, state, scales) for state in (first, last))

    def path(self, kernel: Kernel, h: float, state: np.ndarray) -> DenseOutput:
        """Return the series through a step of length h [s] from (q, p), shape (2 d,)."""
        parts: list[tuple[float, np.ndarray]] = []
        self.advance(kernel, h, state[None].copy(), parts)
        lengths, series = np.array([length for length, _ in parts]), np.stack(
            [coefficients for _, coefficients in parts])
        # Convert coefficients in powers of time to powers of the fraction of each part.
        powers = lengths[:, None] ** np.arange(series.shape[2])
        times = np.append(0.0, np.cumsum(lengths))
        return DenseOutput(series.shape[2] - 1, np.ascontiguousarray(
            (series * powers[:, None, :]).transpose(2, 0, 1)), state.size // 2, times / times[-1])

    def _expressions(self, graph: Graph, roots: list[int], scales: Mapping[str, float]
                     ) -> list[Any]:
        """Return the rates of a graph as heyoka expressions of the scaled state."""
        found: dict[int, Any] = {}
        for a in graph.needed(roots):
            kind, *rest = graph.nodes[a]
            parts = [found[part] for part in graph.arguments(a)]
            if kind == 'number':
                found[a] = self._heyoka.expression(rest[0])
            elif kind == 'name':
                found[a] = self._heyoka.par[int(rest[0][1:])] if rest[0].startswith(_FORCE) \
                    else _scaled(scales[rest[0]], self._heyoka.make_vars(rest[0]))
            elif kind in _MONOMIALS:
                found[a] = self._product(found, *_monomial(graph, a))
            elif kind == 'versine':
                found[a] = 2.0 * self._heyoka.sin(0.5 * parts[0]) ** 2.0
            else:
                found[a] = (_OPERATIONS.get(kind) or getattr(self._heyoka, kind))(*parts)
        return [_scaled(1.0 / scale, found[root])
                for scale, root in zip(scales.values(), roots, strict=True)]

    def _product(self, found: Mapping[int, Any], factor: float, powers: Mapping[int, float]
                 ) -> Any:
        """Return a number times powers of the given expressions."""
        product = self._heyoka.expression(factor)
        for base, exponent in powers.items():
            if exponent == int(exponent):
                whole = _whole_power(found[base], abs(int(exponent)))
                product = product * whole if exponent > 0.0 else product / whole
            else:
                product = product * found[base] ** exponent
        return product


def _monomial(graph: Graph, a: int) -> tuple[float, dict[int, float]]:
    """Return a node as a number times powers: x / (r sqrt(r)) takes one series for r^-1.5."""
    kind, *rest = graph.nodes[a]
    if kind not in _MONOMIALS:
        return 1.0, {a: 1.0}
    if kind == 'sqrt':
        # Factors of it are not expanded: the root of x^2 is not a power of x.
        return 1.0, {rest[0]: 0.5}
    exponents = {'over': (1.0, -1.0), 'power': (float(rest[-1]),)}.get(kind, (1.0, 1.0))
    factor, powers = (rest[0] if kind == 'scaled' else 1.0), dict[int, float]()
    for part, exponent in zip(graph.arguments(a), exponents, strict=False):
        more, inside = _monomial(graph, part)
        factor *= more ** exponent
        for base, own in inside.items():
            powers[base] = powers.get(base, 0.0) + own * exponent
    return factor, powers


def _whole_power(base: Any, exponent: int) -> Any:
    """Return a power by products, because heyoka's own series is not finite where x is zero."""
    if exponent < 2:
        return base if exponent else 1.0
    half = _whole_power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


def _scaled(scale: float, expression: Any) -> Any:
    return expression if scale == 1.0 else scale * expression


def _power(size: float) -> float:
    """Return a power of 2^10 near a size, usually 1; 1 if the size is zero or not finite."""
    return 2.0 ** (10 * round(math.log2(size) / 10.0)) if 0.0 < size < np.inf else 1.0


def _scales(kernel: Kernel, h: float, states: np.ndarray) -> np.ndarray:
    """
    Return a scale for each of (q, p), shape (2 d,), one for all q and one for all p.

    heyoka's tolerance is absolute below 1. At rest, and at zero, the scale is that of the motion:
    p' T with T^2 = q / q'', and q' T with T^2 = p / p'', T <= h. Scales are powers of 2, so that
    scaling is exact.
    """
    d, n = kernel.dimension, kernel.dimension - kernel.channels
    scales, energy = np.ones(2 * d), 1.0
    halves = states.reshape(-1, 2, d)[..., :n]
    if not all(1.0 / 32.0 < size < 32.0 for size in np.abs(halves).max(axis=(0, 2)).tolist()):
        sizes = np.abs(halves).max(axis=2)
        for own, state in zip(sizes, states, strict=True):
            rates, turns = (np.abs(row.reshape(2, d)[:, :n]).max(axis=1)
                            for row in _time_derivatives(kernel, state))
            with np.errstate(divide='ignore', invalid='ignore'):
                moved = rates * np.fmin(np.sqrt(own / turns)[::-1], abs(h))
            own[:] = np.fmax(own, moved)
            energy = float(rates @ own[::-1])
        scales[:n], scales[d:d + n] = map(_power, sizes.max(axis=0))
    # The channel of a force: time, and work.
    scales[n:d], scales[d + n:] = _power(abs(h)), _power(energy)
    return scales


def _time_derivatives(kernel: Kernel, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return z' and z'' of a state, shape (2 d,) each."""
    (q, p), rates, turns = np.split(state, 2), *np.empty((2, 2, kernel.dimension))
    kernel.gradient(kernel.parameters, q, p, rates[1], rates[0])
    rates[1] *= -1.0
    kernel.hessian_vector(kernel.parameters, q, p, rates[0], rates[1], turns[1], turns[0])
    return rates.ravel(), turns.ravel()


def _energy_drift(kernel: Kernel, first: np.ndarray, last: np.ndarray) -> tuple[float, float]:
    """Return the energy difference of two states minus the work, and the energy scale [J]."""
    d = kernel.dimension
    before, after = (kernel.energy(kernel.parameters, state[:d], state[d:])
                     for state in (first, last))
    work = last[-1] - first[-1] if kernel.channels else 0.0
    return abs(after - before - work), abs(before)


def _terms(kernel: Kernel, state: np.ndarray, scales: np.ndarray) -> float:
    """Return abs(H) plus the size of its change with the whole state [J]."""
    d, n = kernel.dimension, kernel.dimension - kernel.channels
    (q, p), slopes = np.split(state, 2), np.zeros((2, d))
    kernel.gradient(kernel.parameters, q, p, slopes[0], slopes[1])
    slopes[:, n:] = 0.0
    largest = max(1.0, float(np.abs(state / scales).max()))
    return abs(float(kernel.energy(kernel.parameters, q, p))) + largest * float(
        np.abs(slopes.ravel() * scales).sum())


def _is_kink(graph: Graph, a: int) -> bool:
    """Return True if a node has a kink, or is abs(x) to a power, such as the root of a square."""
    kind, *rest = graph.nodes[a]
    if kind in SWITCHES:
        return True
    exponent = 0.5 if kind == 'sqrt' else graph.value(rest[1]) if kind == 'raised' else None
    if exponent is None:
        return False
    _, powers = _monomial(graph, rest[0])
    return any(graph.nodes[base][0] == 'versine' or (own % 2.0 == 0.0 != own * exponent % 2.0)
               for base, own in powers.items() if own)


def _original(kernel: Kernel) -> Kernel:
    # Imported lazily: reading a scene needs no compiler.
    from hnn_vi_ros.kernels import original
    return original(kernel)


def _held_force(kernel: Kernel, state: np.ndarray) -> np.ndarray:
    """Return the force of a step that is constant in it, from the gradient at its start, (d,)."""
    (q, p), slopes = np.split(state, 2), np.empty((2, kernel.dimension))
    kernel.gradient(kernel.parameters, q, p, slopes[0], slopes[1])
    space: np.ndarray = _original(kernel).parameters[3]
    return space[3, :kernel.dimension - kernel.channels]


def _names(d: int) -> list[str]:
    return [f'{half}{i}' for half in 'qp' for i in range(d)]


def _rates(kernel: Kernel) -> tuple[Graph, list[int]]:
    """Return q' and p' as nodes of a graph, or raise TypeError if they are not formulas."""
    graph, d = Graph(), kernel.dimension
    z = np.array([Symbol(graph, graph.name(name)) for name in _names(d)])
    slopes = np.array([Symbol(graph, graph.number(0.0))] * (2 * d))
    _fill(kernel, z[:d], z[d:], slopes[:d], slopes[d:])
    problem = next((a for a in graph.needed([one.node for one in slopes if isinstance(
        one, Symbol)]) if _is_kink(graph, a)), None)
    if problem is not None:
        raise ValueError('a root of squares has a kink')
    # For a cyclic coordinate, on which H does not depend, the slope is a number.
    return graph, [one.node if isinstance(one, Symbol) else graph.number(one)
                   for one in (*slopes[d:], *-slopes[:d])]


def _fill(kernel: Kernel, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray
          ) -> None:
    """
    Fill the gradient at symbols, for a formula and for potentials added to it.

    The parts of a gradient are found in its closure. A kernel cannot name them: it is an argument
    of compiled code, which takes numbers and functions, and no classes.
    """
    kernel = _original(kernel)
    gradient: Any = getattr(kernel.gradient, 'py_func', kernel.gradient)
    inside = getclosurevars(gradient).nonlocals
    if 'add_all' in inside:
        # A force that is constant in a step; its channel is the time, and its power times -1.
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
        raise TypeError(f'{kernel.gradient} is not a formula')


class Taylor(Integrator):
    """
    Taylor series of the motion, with order and internal steps determined by the tolerance.

    A step maps the state at its start to that at its end with as many series as needed: long steps
    cost least. Neither symplectic nor symmetric; with small tolerances the energy is conserved to
    round-off, also over long times. Use it for very high accuracy if H is a formula: exact systems
    in scalar coordinates, ``formula``, robots of up to three joints; with potentials, and commands
    to ``external_force``, constant in a step. Needs ``pip install heyoka``.

    Parameters
    ----------
    tolerance : float
        Error of a series, relative to q and to p, or to the expected motion if they are smaller;
        from 1e-16 to 1e-3 [1]. The order is 1 - ln(tolerance) / 2. Series that change the energy
        by more than that are shortened, such as near walls of high powers.

    Raises
    ------
    ValueError
        A tolerance is out of its range.

    References
    ----------
    F. Biscani, D. Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial
    mechanics, Mon. Not. R. Astron. Soc. 504 (2021).

    """

    explicit, compiled, tolerances = True, False, ('tolerance',)
    useful_tolerances = 1e-16, 1e-3
    requirements = Requirements(symmetric=False, symplectic=False, forces='held')

    def __init__(self, tolerance: float = 1e-12):
        check_between(*self.useful_tolerances, tolerance=tolerance)
        self._tolerance = float(tolerance)
        self.order = math.ceil(1.0 - 0.5 * math.log(tolerance))

    def scaled(self, factor: float) -> 'Taylor':
        """Return the method with its tolerance times a factor, within the useful ones."""
        least, most = self.useful_tolerances
        return self if factor == 1.0 else Taylor(min(max(factor * self._tolerance, least), most))

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return the reason this method cannot integrate `hamiltonian`, '' if it can."""
        problem = super().refusal(hamiltonian)
        if problem:
            return problem
        try:
            _rates(hamiltonian.kernel)
        except (TypeError, ValueError):
            joined = getattr(hamiltonian, 'base', hamiltonian)
            return ('supports smooth formulas, robots of up to three joints, and potentials, not '
                    f'{type(joined).__name__}'
                    f'{"" if joined is hamiltonian else " with these effects"}: networks, other '
                    'forces, and kinks, as in abs(x) or (x^2)^1.5, have no series')
        if find_spec('heyoka') is None:
            return ('needs the Python package heyoka; install it with: '
                    f'{pip_command("heyoka>=7.13,<8")}')
        return ''

    def own_times(self, kernel: Kernel) -> tuple[float, float]:
        """Return the time of a step in Python, and of each series."""
        nodes = len(_rates(_original(kernel))[0].nodes)
        return 2e-5, 7e-8 + 5e-11 * nodes * self.order ** 2

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the series, which are compiled in the first step."""
        return (TaylorWork(self._tolerance),)

    @staticmethod
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple[TaylorWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        d, work, total = kernel.dimension, memory[0], 0
        states = np.hstack([z.q.reshape(-1, d), z.p.reshape(-1, d)])
        for first in range(0, len(states), _BATCH_STATES):
            # The last batch is filled up with copies of its last state.
            rows = np.arange(first, first + (_BATCH_STATES if len(states) > 1 else 1))
            rows = np.minimum(rows, len(states) - 1)
            batch = states[rows]
            outcome, spent = work.advance(kernel, h, batch)
            if outcome != OK:
                return outcome, 0.0, total
            states[rows], total = batch, total + spent
        z1.q[:], z1.p[:] = states[:, :d].ravel(), states[:, d:].ravel()
        return OK, 0.0, total
