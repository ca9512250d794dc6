# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Dense output: states between the steps of a simulation."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple, TYPE_CHECKING

from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.integrators import (
    collocation_output, DenseOutput, Dop853, Gauss, hermite_output, WHOLE)
from hnn_vi_ros.phase_space import coordinate_rates, momentum_rates
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.simulation.simulation import Simulation

# Minimum number of stages for the collocation polynomial to be as good as quintic Hermite.
_MIN_STAGES = 5
# Fractions of each part of a step at which its polynomial is evaluated.
_FRACTIONS = np.linspace(0.0, 1.0, 9)
# Tolerance, as a share of a step and in roundings of the number of steps, for a time to count as
# the end of a step, such as 0.3 / 0.1.
_STEP_TOLERANCE, _COUNT_TOLERANCE = 1e-9, 4.0 * float(np.finfo(np.float64).eps)


class StepEnd(NamedTuple):
    """State and gradient of H at it, each of shape (d,) or (m, d)."""

    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray


class DenseStep:
    """
    Step of a simulation, taken by the constructor, with dense output.

    There are two continuous extensions of the step. ``polynomial`` is cheap: cubic Hermite for
    methods of order up to 3, for rotations and if forces or effects act, quintic Hermite
    otherwise, and the collocation polynomial for Gauss methods of 5 or more stages (with fewer,
    its order s is below 5). It interpolates both ends of the step; if ``time_transformed`` takes
    several internal steps per step of the clock, there is one polynomial for each of them. Paths
    of ``taylor`` and ``dop853`` are as accurate as these methods, ``dop853`` to order 7.
    ``state`` is as accurate as the method: it uses the polynomial if that has the method's order
    and nothing but H acts, otherwise a step of the method from the same start with a fraction of
    h, with all effects and the same random numbers; so rods keep their lengths, quaternions their
    norms, and walls are respected. Internal steps of a method keep their lengths, and are
    evaluated at another time of the clock.

    Parameters
    ----------
    simulation : Simulation
        Simulation that takes the step.
    plain : bool
        True if steps involve only the method and H, in scalar coordinates.
    cuts : callable
        Returns the number of cuts of steps so far, for example at walls.

    Attributes
    ----------
    step : int
        Number of steps of the simulation before this one.

    Raises
    ------
    StepFailure
        The step did not converge, or its result is not finite.

    """

    def __init__(self, simulation: 'Simulation', plain: bool, cuts: Callable[[], int]):
        self._simulation, self._plain, self.step = simulation, plain, simulation.steps
        rescued, uncut = simulation.rescued, cuts()
        self._before, self._start = simulation.row, _look(simulation)
        simulation.advance(1)
        self._end, self._slopes, self._smooth = _look(simulation), None, cuts() == uncut
        stages = getattr(simulation.integrator, 'stages', 0)
        # The paths of adaptive methods can be evaluated anywhere in the step; that of a pair
        # contains forces as well.
        self._pair = (isinstance(simulation.integrator, Dop853) and not simulation.system.layered
                      and simulation.rescued == rescued)
        self._series = (bool(simulation.integrator.tolerances) and (plain or self._pair)
                        and simulation.rescued == rescued and self._start.q.ndim == 1)
        if (plain and isinstance(simulation.integrator, Gauss) and stages >= _MIN_STAGES
                and simulation.rescued == rescued):
            # H_q and H_p at the stages, stored by the step for the next initial guess.
            H_q, H_p = np.split(simulation.state.named['memory0.0.slopes'], 2)
            self._slopes = np.hstack([H_p.reshape(stages, -1), -H_q.reshape(stages, -1)])

    def undo(self) -> None:
        """Restore the simulation to its state before the step."""
        self._simulation.put(self._before)

    @cached_property
    def _knots(self) -> tuple[np.ndarray, list[StepEnd]]:
        """Return the ends of the parts of the step, as fractions of it, and the states there."""
        if self._takes_state:
            return WHOLE, [self._start, self._end]
        simulation, found = self._simulation, {0.0: self._start}
        for time, q, p in simulation.probe.own_states(self._before):
            # States at the ends of the step are added separately.
            if (share := time / simulation.step_size) < 1.0:
                found[share] = StepEnd(q, p, *simulation.hamiltonian.gradient(q, p))
        return np.array([*found, 1.0]), [*found.values(), self._end]

    @property
    def _takes_state(self) -> bool:
        """Return whether the step continues from the state at its start."""
        return self._simulation.integrator.requirements.from_state

    @property
    def places(self) -> np.ndarray:
        """Return fractions of the step, shape (k,), between which the path bends little."""
        ends = self.polynomial.ends if self._series else self._knots[0]
        if ends is WHOLE:
            return _FRACTIONS
        inside = ends[:-1, None] + np.diff(ends)[:, None] * _FRACTIONS[:-1]
        return np.append(inside.ravel(), 1.0)

    @cached_property
    def polynomial(self) -> DenseOutput:
        """Return the interpolating polynomial of q and p, of shape (d,) or (m d,)."""
        if self._series:
            return self._simulation.probe.series(self._before)
        h, (ends, looks) = self._simulation.step_size, self._knots
        z, v = (np.array(rows) for rows in zip(*map(self._line, looks), strict=True))
        if self._slopes is not None:
            return collocation_output(h, z[0], self._slopes)
        bends = None
        if self._simulation.integrator.order > 3 and self._plain:
            bends = np.array([self._bend(*line) for line in zip(z, v, strict=True)])
        return hermite_output(h, self._start.q.size, z, v, bends, ends)

    def _line(self, look: StepEnd) -> tuple[np.ndarray, np.ndarray]:
        """Return (q, p) and (q', p') at a state, each of shape (n,)."""
        turning, (q, p, dH_dq, dH_dp) = self._simulation.hamiltonian.rotations, look
        return (np.concatenate([q.ravel(), p.ravel()]),
                np.concatenate([coordinate_rates(turning, q, dH_dp).ravel(),
                                momentum_rates(turning, q, p, dH_dq, dH_dp).ravel()]))

    def _bend(self, z: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return (q'', p'') = J H''(z) z'."""
        hamiltonian = self._simulation.hamiltonian
        (q, p), (v_q, v_p) = (pair.reshape(2, -1, hamiltonian.dimension) for pair in (z, v))
        product_q, product_p = hamiltonian.hessian_vector(q, p, v_q, v_p)
        return np.concatenate([product_p.ravel(), -product_q.ravel()])

    def state(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return q and p, of shape (d,) or (m, d), inside the step, to the method's order.

        Parameters
        ----------
        theta : float
            Fraction of the step, from 0 to 1.

        Raises
        ------
        StepFailure
            A step of this length did not converge.

        """
        for share, look in ((0.0, self._start), (1.0, self._end)):
            if theta == share:
                return look.q.copy(), look.p.copy()
        simulation = self._simulation
        time = theta * simulation.step_size
        if not self._takes_state or (self._pair and not self._series):
            return simulation.probe.clock_trial(self._before, time)
        if self._series or (self._plain and self.polynomial.order >= simulation.integrator.order):
            q, p = self.polynomial(theta)
            return q.reshape(simulation.q.shape), p.reshape(simulation.p.shape)
        q, p = simulation.probe.trial(self._before, time)
        return q[0], p[0]

    def outline(self, theta: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return approximate q and p inside the step.

        They are evaluated by the polynomial, which is cheap, or by ``state`` if the step was cut:
        the path then has kinks, which the polynomial does not show.

        Parameters
        ----------
        theta : float or np.ndarray, shape (k,)
            Fractions of the step.

        Returns
        -------
        tuple of np.ndarray, shape (d,) or (k, d)
            q and p, for a simulation of one trajectory.

        Raises
        ------
        StepFailure
            See ``state``.

        """
        if self._smooth:
            return self.polynomial(theta)
        if np.ndim(theta) == 0:
            return self.state(float(theta))
        q, p = zip(*(self.state(float(one)) for one in np.asarray(theta)), strict=True)
        return np.array(q), np.array(p)


def _look(simulation: 'Simulation') -> StepEnd:
    """Return a copy of the current state of a simulation and the gradient of H."""
    return StepEnd(simulation.q.copy(), simulation.p.copy(), simulation.dH_dq.copy(),
                   simulation.dH_dp.copy())


def whole_steps(time: float, step_size: float) -> tuple[int, float]:
    """
    Return the number of whole steps in a time, and the remaining fraction of a step.

    Parameters
    ----------
    time : float
        Time t >= 0 [s].
    step_size : float
        Step size h [s].

    Returns
    -------
    tuple of (int, float)
        Steps and fraction; the fraction is 0 if the time differs from whole steps by rounding.

    """
    steps = time / step_size
    nearest = round(steps)
    if abs(steps - nearest) <= _STEP_TOLERANCE + _COUNT_TOLERANCE * nearest:
        return nearest, 0.0
    return int(steps), steps - int(steps)


def record_at(simulation: 'Simulation', times: Sequence[float] | np.ndarray,
              on_sample: Callable[[], None] = lambda: None) -> tuple[np.ndarray, np.ndarray]:
    """
    Advance a simulation to the last of the given times, and return its states at all of them.

    Parameters
    ----------
    simulation : Simulation
        Simulation that has not yet passed any of the times.
    times : sequence of float, shape (k,)
        Times since the initial state, in increasing order [s].
    on_sample : callable, optional
        Called at the first whole step at or after each time.

    Returns
    -------
    tuple of np.ndarray, shape (k, d) or (k, m, d)
        q and p. The simulation ends at the first whole step at or after the last time, or before
        that step if an event in it, after the last time, ends the run.

    Raises
    ------
    StoppedByEvent
        An event ended the run before the last of the times.
    StepFailure
        A step did not converge, or its result is not finite.

    """
    q, p = (np.empty((len(times), *part.shape)) for part in (simulation.q, simulation.p))
    dense = None
    for k, time in enumerate(times):
        step, share = whole_steps(time, simulation.step_size)
        try:
            if dense is None or dense.step != step:
                simulation.advance(step - simulation.steps)
                dense = simulation.dense_step() if share else None
        except StoppedByEvent as stop:
            last = int(np.searchsorted(times, stop.event.t, side='right'))
            for i in range(k, last):
                q[i], p[i] = stop.state(times[i] / simulation.step_size - simulation.steps)
            if last == len(times):
                # The event is after the last of the times.
                return q, p
            raise stop.after(q[:last], p[:last]) from None
        if dense is None:
            q[k], p[k] = simulation.q, simulation.p
        else:
            q[k], p[k] = dense.state(share)
        on_sample()
    return q, p
