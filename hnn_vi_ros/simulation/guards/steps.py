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
# Number of internal steps that stability may limit.
_MAX_STIFF_STEPS = 10
# Checks of the time in H: least number of intervals between stages, random times in each, time
# from check to check relative to that of the run, and least range of H' relative to its size.
_MIN_INTERVALS, _PER_INTERVAL, _CHECKS_APART, _MIN_VARIATION = 32, 10, 0.25, 1e-3


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
    method takes tiny steps at any tolerance. A few such steps are allowed, as where a servo
    reaches its limit: they cost little.

    Parameters
    ----------
    simulation : Simulation
        Simulation to watch.

    """

    kind, limit = 'stiff', _MAX_STIFF_STEPS
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


class TimeGuard(LimitGuard):
    """
    Time in H: the stages of steps see its changes, also at periods that steps are multiples of.

    H' at one state is sampled at random times between the stages of some steps, now and then; its
    variation there is compared with that from stage to stage. A drive of h nu = 1, 2, ... is a
    constant force for the stages, and for those of any step that is a multiple.

    Parameters
    ----------
    simulation : Simulation
        Simulation to watch.

    """

    kind, limit = 'drive not resolved', 0.6
    remedy = 'use a step_size below half of the shortest period in H'
    message = f'the stages of steps do not see {{:.0%}} of the changes of H in time; {remedy}'

    def __init__(self, simulation: Simulation):
        self._simulation, self._unseen, self._next = simulation, 0.0, 0.0
        tableau = simulation.integrator.partitioned
        # The time advances as a coordinate.
        nodes = np.arange(2.0) if tableau is None else tableau.q_matrix.sum(axis=1)
        steps = np.arange(max(2, _MIN_INTERVALS // nodes.size))
        self._stages = np.unique(np.add.outer(steps, nodes))
        self._between = np.sort(np.random.default_rng(0).uniform(
            self._stages[0], self._stages[-1], _PER_INTERVAL * self._stages.size))

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        if run.hamiltonian.time is not None and not run.simulation.integrator.tolerances:
            yield cls(run.simulation)

    def value(self, sample: Observed) -> float:
        """Return the share of the variation of H' in time that stages do not see."""
        if sample.step >= self._next:
            self._next = sample.step + max(self._stages[-1], _CHECKS_APART * sample.step)
            q, p = (np.atleast_2d(part)[:1] for part in (sample.q, sample.p))
            seen, all_of_it = (self._variation(q, p, sample.step + times)
                               for times in (self._stages, self._between))
            counts = all_of_it[1] > _MIN_VARIATION * all_of_it[2]
            unseen = 1.0 - seen[0][counts] / all_of_it[0][counts]
            self._unseen = float(unseen.max(initial=self._unseen))
        return self._unseen

    def _variation(self, q: np.ndarray, p: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return total variation, range and largest size of H' at times, shape (3, d + k)."""
        q, p = (np.repeat(part, steps.size, axis=0) for part in (q, p))
        slopes = np.hstack(self._simulation.hamiltonian.gradient(
            q, p, steps * self._simulation.step_size))
        return np.array([np.abs(np.diff(slopes, axis=0)).sum(axis=0), np.ptp(slopes, axis=0),
                         np.abs(slopes).max(axis=0)])


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
