# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of the guards that apply to a run."""

from collections.abc import Iterator

from hnn_vi_ros.simulation.guards.bands import (
    BarrierGuard, EnergyGuard, InvariantGuard, ResolutionGuard)
from hnn_vi_ros.simulation.guards.base import Guard
from hnn_vi_ros.simulation.guards.bounds import BoxGuard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.loops import ClosureGuard, SingularGuard
from hnn_vi_ros.simulation.guards.paths import ForcedPathGuard, PathGuard, PhaseGuard
from hnn_vi_ros.simulation.guards.poles import PoleGuard
from hnn_vi_ros.simulation.guards.steps import (
    CostGuard, DriveGuard, RescueGuard, SolutionGuard, StabilityGuard, StiffnessGuard)

# Alarms of the same step are reported in this order.
GUARDS: tuple[type[Guard], ...] = (
    BoxGuard, ResolutionGuard, EnergyGuard, CostGuard, StiffnessGuard, StabilityGuard, DriveGuard,
    InvariantGuard, BarrierGuard, ForcedPathGuard, PathGuard, PhaseGuard, PoleGuard, ClosureGuard,
    SingularGuard, SolutionGuard, RescueGuard)


def make_guards(run: RunFacts, kinds: tuple[type[Guard], ...] = (Guard,)) -> Iterator[Guard]:
    """
    Yield the guards that apply to a run, in a study and in the node alike.

    Parameters
    ----------
    run : RunFacts
        Facts of the run.
    kinds : tuple of type, optional
        Classes of the guards to make; by default all that apply.

    """
    for kind in GUARDS:
        if issubclass(kind, kinds):
            for guard in kind.of_run(run):
                if run.simulation.integrator.tolerances:
                    guard.smaller = 'smaller tolerances'
                yield guard
