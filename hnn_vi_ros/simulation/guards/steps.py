# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of the steps: cost, ambiguous equations, and steps taken by another method."""

from collections.abc import Iterator
from typing import ClassVar

from hnn_vi_ros.integrators import Dop853
from hnn_vi_ros.simulation.guards.base import Guard, LimitGuard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.samples import Observed
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Limit of the gradients of a step, as a multiple of the usual maximum.
_MAX_GRADIENT_RATIO = 10


class CostGuard(LimitGuard):
    """
    Cost of steps: at most ten times the usual maximum of gradients of the method.

    Newton's method, which takes over from the method's own solver in steps of a radian and more,
    stays below. More are needed if it finds no solution either, and sub-steps take over. Gradients
    are counted instead of time, so that the same run raises the same alarm on every machine. For
    trajectories that step together, the limit is the sum of the limits of the single trajectories.

    Parameters
    ----------
    simulation : Simulation
        Simulation to watch.

    """

    kind = 'slow step'
    remedy = 'use a smaller step_size, or `time_transformed` for close encounters'

    def __init__(self, simulation: Simulation):
        self._simulation = simulation
        usual = simulation.usual_gradients * np.atleast_2d(simulation.q).shape[0]
        self.limit = _MAX_GRADIENT_RATIO * usual
        self.message = ('a step took {} evaluations of the gradient; the usual number is '
                        f'{usual}; use a smaller step_size or another integrator')

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        if run.simulation.usual_gradients:
            yield cls(run.simulation)

    def value(self, sample: Observed) -> float:
        """Return the gradients of the costliest step."""
        return self._simulation.costliest[0]

    def step(self, sample: Observed) -> int:
        """Return the costliest step."""
        return self._simulation.costliest[1]


class _ReachGuard(LimitGuard):
    """Base class of guards of h times a rate that is known at the start."""

    def __init__(self, reach: float, limit: float = 1.0):
        self._reach, self.limit = reach, limit

    def value(self, sample: Observed) -> float:
        """Return h times the rate."""
        return self._reach


class StiffnessGuard(_ReachGuard):
    """
    Bristles of friction and elastic gears: h omega at most 1, with their fastest rate omega.

    Beyond, small motions on them are not resolved: presliding, and contacts of teeth.

    Parameters
    ----------
    reach : float
        h omega.

    """

    kind = 'stiffness not resolved'
    remedy = 'use a smaller step_size, or a lower stiffness'
    message = f'h omega = {{:.3g}} of small motions on bristles or gears, limit 1; {remedy}'

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        simulation = run.simulation
        fastest = simulation.system.fastest_rate(np.atleast_2d(simulation.q)[0], simulation.time)
        # Adaptive methods resolve what moves.
        if fastest and not simulation.integrator.tolerances:
            yield cls(simulation.step_size * fastest)


class CountGuard(LimitGuard):
    """
    Base class of guards of a counter of the simulation that must stay zero.

    Parameters
    ----------
    simulation : Simulation
        Simulation to watch.

    Attributes
    ----------
    counted : str
        Attribute of the simulation that holds the counter.

    """

    limit = 0.0
    counted: ClassVar[str]

    def __init__(self, simulation: Simulation):
        self._simulation = simulation

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        yield cls(run.simulation)

    def value(self, sample: Observed) -> float:
        """Return the count."""
        return getattr(self._simulation, self.counted)

    def step(self, sample: Observed) -> int:
        """Return the newest step: the alarms of a finished path report the counts at its end."""
        return self._simulation.steps


class StabilityGuard(CountGuard):
    """
    Internal steps of `dop853`: their size is limited by the tolerance, not by stability.

    In a stiff motion, with fast oscillation or damping at rest and slow motion, an explicit
    method takes tiny steps at any tolerance.

    Parameters
    ----------
    simulation : Simulation
        Simulation to watch.

    """

    kind = 'stiff'
    remedy = 'use an implicit method, such as `gauss4` or `implicit_midpoint`'
    message = ('stability, not the tolerance, limited {:.0f} internal steps so far: the motion is '
               f'stiff; {remedy}')

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        if isinstance(run.simulation.integrator, Dop853):
            yield cls(run.simulation)

    def value(self, sample: Observed) -> float:
        """Return the number of internal steps that stability limits."""
        return int(self._simulation.internal_steps[2])


class DriveGuard(_ReachGuard):
    """
    Periodic drives: h nu at most a quarter of the order of the method, at least one half.

    Beyond, the nodes of the method see fewer than two phases of a period: a drive of h nu = 1 is
    a constant force, with which no repetition in smaller steps need disagree.

    Parameters
    ----------
    reach : float
        h nu.
    limit : float
        The limit.

    """

    kind = 'drive not resolved'
    remedy = 'use a step_size below half of the period of the drive'
    message = f'h nu = {{:.3g}} of a periodic drive of nu [Hz]; {remedy}'

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        frequency = max((effect.frequency for effect in run.simulation.effects), default=0.0)
        if frequency and not run.simulation.integrator.tolerances:
            yield cls(run.simulation.step_size * frequency, 0.25 * max(run.order, 2))


class SolutionGuard(CountGuard):
    """Solutions of steps: solvers find only the solution that is connected to h = 0."""

    kind = 'several solutions'
    remedy = 'use a smaller step_size: below the fold the equation has one solution'
    counted = 'several_solutions'
    message = ('the equation of a step had several solutions in {} steps so far; the solution '
               'connected to h = 0 was used; use a smaller step_size')

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        if run.simulation.connected:
            yield cls(run.simulation)


class RescueGuard(CountGuard):
    """
    Rescued steps: the scene's method takes all steps, without sub-steps or the midpoint rule.

    Each change of method leaves H unchanged, but changes the value of the modified energy.
    """

    kind = 'rescued steps'
    remedy = ('use a smaller step_size, or a method whose equations can be solved at this '
              'step_size')
    counted = 'rescued'
    message = ('on_failure replaced the integrator in {} steps so far; use a smaller step_size '
               'or another integrator')
