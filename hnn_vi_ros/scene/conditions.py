# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions such as ``angle1 = 0``, which a scene states as text; none of it is run as code."""

import ast
from collections.abc import Callable
import operator
from typing import Any

from hnn_vi_ros.errors import did_you_mean, listed
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.phase_space import columns
import numpy as np

_LONGEST = 200
_Number = np.ndarray | np.float64
_OPERATORS: dict[type[ast.operator], Callable[[_Number, _Number], _Number]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow}
_SIGNS: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg, ast.UAdd: operator.pos}
_FUNCTIONS: dict[str, Callable[[_Number], _Number]] = {
    'abs': np.abs, 'cos': np.cos, 'sin': np.sin, 'sqrt': np.sqrt}
_GRAMMAR = ('an equation of numbers, pi, the coordinates c, their momenta p_c and velocities v_c, '
            'and H, with + - * / **, brackets, abs, cos, sin and sqrt')

# A compiled expression: a function of the values of names.
Value = Callable[[dict[str, np.ndarray]], _Number]


class Condition:
    """
    An equation between numbers and quantities of a system, such as ``angle1 - angle2 = pi / 2``.

    Quantities are the coordinates, each under its name c, their momenta ``p_c``, their velocities
    ``v_c``, which are dH/dp, and the energy ``H``.

    Parameters
    ----------
    text : str
        The equation, at most 200 characters.

    Raises
    ------
    ValueError
        It is none, or too long; the message describes a valid one.

    """

    def __init__(self, text: str):
        self.text = text
        sides = text.split('=')
        if len(text) > _LONGEST or len(sides) != 2:
            raise ValueError(f'{text[:_LONGEST]!r} is no equation of at most {_LONGEST} '
                             f'characters: expected {_GRAMMAR}')
        self._names: set[str] = set()
        left, right = (self._read(side) for side in sides)
        if not self._names:
            raise ValueError(f'{self.text!r} depends on nothing of the system: expected '
                             f'{_GRAMMAR}')
        self._difference: Value = lambda values: left(values) - right(values)

    def check(self, hamiltonian: Hamiltonian) -> None:
        """Raise ValueError, with the valid names, if it names a quantity the system lacks."""
        names, momenta = columns(hamiltonian.coordinates)
        valid = [*names, *(f'{kind}_{name}' for kind in 'pv' for name in momenta), 'H']
        unknown = sorted(self._names - set(valid))
        if unknown:
            raise ValueError(f'{self.text!r}: no quantity {unknown[0]!r}'
                             f'{did_you_mean(unknown[0], valid)}; valid: '
                             f'{listed(valid)}')

    def values(self, hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """
        Return left less right side, of the shape (...).

        Parameters
        ----------
        hamiltonian : Hamiltonian
            Of the system.
        q, p : np.ndarray, shape (..., d)
            States.

        """
        values: dict[str, np.ndarray] = {}
        names, momenta = columns(hamiltonian.coordinates)
        if 'H' in self._names:
            values['H'] = hamiltonian.energy(q, p)
        if any(f'v_{name}' in self._names for name in momenta):
            _, velocity = hamiltonian.gradient(q, p)
            values |= {f'v_{name}': velocity[..., i] for i, name in enumerate(momenta)}
        for i, name in enumerate(momenta):
            values[f'p_{name}'] = p[..., i]
        # Last of all: a coordinate may be named as another's momentum.
        values |= {name: q[..., i] for i, name in enumerate(names)}
        with np.errstate(all='ignore'):
            difference = self._difference(values)
        shape = np.shape(q)[:-1]
        return np.asarray(difference) if np.shape(difference) == shape \
            else np.broadcast_to(difference, shape)

    def _read(self, side: str) -> Value:
        try:
            tree = ast.parse(side.strip(), mode='eval').body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as problem:
            raise ValueError(f'{self.text!r}: {side.strip()!r} cannot be read: expected '
                             f'{_GRAMMAR}') from problem
        value = self._build(tree)
        for part in ast.walk(tree):
            if isinstance(part, ast.BinOp | ast.Call | ast.Constant) and not _names_in(part):
                with np.errstate(all='ignore'):
                    number = self._build(part)({})
                if not np.isfinite(number):
                    raise ValueError(f'{self.text!r}: {ast.unparse(part)} is {number}, so this '
                                     'never comes true')
        return value

    def _build(self, node: ast.AST) -> Value:
        """Return the function of a part of an expression; nothing else than these is taken."""
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                # In float64 no power takes long, as one of integers of any length does.
                number = np.float64(value)
                return lambda values: number
            case ast.Name(id='pi'):
                return lambda values: np.float64(np.pi)
            case ast.Name(id=name):
                self._names.add(name)
                return lambda values: values[name]
            case ast.UnaryOp(op=sign, operand=inner) if type(sign) in _SIGNS:
                change, part = _SIGNS[type(sign)], self._build(inner)
                return lambda values: change(part(values))
            case ast.BinOp(left=first, op=kind, right=last) if type(kind) in _OPERATORS:
                join = _OPERATORS[type(kind)]
                left, right = self._build(first), self._build(last)
                return lambda values: join(left(values), right(values))
            case ast.Call(func=ast.Name(id=name), args=[inner], keywords=[]) \
                    if name in _FUNCTIONS:
                function, part = _FUNCTIONS[name], self._build(inner)
                return lambda values: function(part(values))
        raise ValueError(f'{self.text!r}: {ast.unparse(node)!r} is not allowed: expected '
                         f'{_GRAMMAR}')


def _names_in(node: ast.AST) -> bool:
    """Return whether an expression has quantities of a system in it."""
    return any(isinstance(part, ast.Name) and part.id not in ('pi', *_FUNCTIONS)
               for part in ast.walk(node))
