# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Workspaces of steps: what is forgotten, what outlives a step, and what is not allocated."""

from typing import NamedTuple

from hnn_vi_ros.integrators import (
    arrays_of, discard_history, INTEGRATORS, memory_by_address, PhasePoint, PointWork)
from hnn_vi_ros.simulation.assembly import compile_discard
import numba
import pytest


class Keeping(NamedTuple):
    """A workspace that keeps what no count goes with."""

    kept: PhasePoint


def plain(memory: tuple) -> None:
    discard_history(memory)


_forget = numba.njit(plain)


def by_address(memory: tuple) -> None:
    # As a step by address finds it, and one of those around it.
    _forget((memory_by_address((memory_by_address(memory[:1]), *memory[1:])),))


@pytest.mark.parametrize('run', [plain, _forget, by_address],
                         ids=['plain', 'compiled', 'by address'])
def test_forget_takes_every_count_to_zero_and_nothing_else(run):
    assert compile_discard
    for name in ('generalized_leapfrog', 'time_transformed'):
        # As wrappers leave it: with a point of their own, one that they keep, or nothing.
        point = PhasePoint.empty(2)
        memory = (*INTEGRATORS[name]().memory(2), PointWork(point), Keeping(point), ())
        for workspace in memory:
            for _, array in arrays_of('', workspace) if workspace else ():
                array[...] = 3
        run(memory)
        left = {label: array for k, workspace in enumerate(memory) if workspace
                for label, array in arrays_of(str(k), workspace)}
        counts = {label for label in left if label.endswith('.count')}
        assert len(counts) == {'generalized_leapfrog': 2, 'time_transformed': 3}[name]
        assert all((array == (0 if label in counts else 3)).all()
                   for label, array in left.items())


@pytest.mark.parametrize('name', [
    # Adaptive methods keep the path ahead of the clock.
    name for name, method in INTEGRATORS.items() if method.explicit and not method.tolerances])
def test_explicit_method_allocates_nothing_for_equations(name):
    """At most four numbers a coordinate: a stage and a sum."""
    method, n = INTEGRATORS[name](), 100
    assert sum(array.size for workspace in method.memory(n) for array in workspace) <= 4 * n
    assert method.unknowns(n) == ()
