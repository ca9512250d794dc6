# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""States between the steps of a simulation."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple, TYPE_CHECKING

from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.integrators import (
    collocation_output, DenseOutput, Gauss, hermite_output, Taylor, WHOLE)
from hnn_vi_ros.phase_space import coordinate_rates, momentum_rates
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.simulation.simulation import Simulation

# From this many stages on the collocation polynomial is no worse than quintic Hermite's.
_STAGES = 5
# Where in a part of a step its polynomial is looked at, in shares of it.
_PLACES = np.linspace(0.0, 1.0, 9)
# Share of a step, and roundings of a count of steps: a time nearer to a step's end is at its end,
# such as 0.3 / 0.1.
_SHARE, _ROUNDINGS = 1e-9, 4.0 * float(np.finfo(np.float64).eps)


class _Look(NamedTuple):
    """A state and the gradient of H there, each of shape (d,) or (m, d)."""

    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray


class DenseStep:
    """
    One step of a simulation, which it takes, and the states inside of it.

    Two continuous extensions of the step are at hand. ``polynomial`` costs next to nothing:
    cubic Hermite for methods of order up to 3, for rotations and wherever forces or effects act,
    quintic Hermite for the others, and the collocation polynomial for Gauss methods of 5 stages
    and more (with fewer its order, s, is below 5). It meets both ends of the step; a step of the
    clock that ``time_transformed`` fills with steps of its own has one polynomial for each of
    these. ``state`` is as accurate as the method: by the polynomial where that is of the
    method's order and nothing else acts on the state, else by a step of the method from the same
    start, of a share of h, with all effects and the same random numbers; so rods keep their
    lengths, quaternions their norms, and walls are met. Where steps are a method's own, they are
    the same ones, up to another time of the clock.

    Parameters
    ----------
    simulation : Simulation
        Which takes the step.
    plain : bool
        Whether its steps involve the method and H alone, in scalar coordinates.
    cuts : callable
        Returns how often steps have been cut so far, for example at walls.

    Attributes
    ----------
    step : int
        Steps that the simulation had taken before.

    Raises
    ------
    StepFailure
        The step did not converge or is not finite.

    """

    def __init__(self, simulation: 'Simulation', plain: bool, cuts: Callable[[], int]):
        self._simulation, self._plain, self.step = simulation, plain, simulation.steps
        rescued, uncut = simulation.rescued, cuts()
        self._before, self._start = simulation.row, _look(simulation)
        simulation.advance(1)
        self._end, self._slopes, self._smooth = _look(simulation), None, cuts() == uncut
        stages = getattr(simulation.integrator, 'stages', 0)
        # The series themselves are known anywhere in the step.
        self._series = (plain and isinstance(simulation.integrator, Taylor)
                        and self._start.q.ndim == 1)
        if (plain and isinstance(simulation.integrator, Gauss) and stages >= _STAGES
                and simulation.rescued == rescued):
            # H_q and H_p at the stages, which the step leaves for the start of the next solve.
            H_q, H_p = np.split(simulation.state.named['memory0.0.slopes'], 2)
            self._slopes = np.hstack([H_p.reshape(stages, -1), -H_q.reshape(stages, -1)])

    def undo(self) -> None:
        """Put the simulation back to where it was before the step."""
        self._simulation.put(self._before)

    @cached_property
    def _knots(self) -> tuple[np.ndarray, list[_Look]]:
        """Return the shares of the step at which its parts begin and end, and the states there."""
        if self._takes_state:
            return WHOLE, [self._start, self._end]
        simulation, found = self._simulation, {0.0: self._start}
        for time, q, p in simulation.own_states(self._before):
            # Those at the clock stand at the ends.
            if (share := time / simulation.step_size) < 1.0:
                found[share] = _Look(q, p, *simulation.hamiltonian.gradient(q, p))
        return np.array([*found, 1.0]), [*found.values(), self._end]

    @property
    def _takes_state(self) -> bool:
        """Return whether the step continues from the state at its start."""
        return self._simulation.integrator.requirements.from_state

    @property
    def places(self) -> np.ndarray:
        """Return shares of the step, shape (k,), between which the path bends little."""
        ends = self.polynomial.ends if self._series else self._knots[0]
        if ends is WHOLE:
            return _PLACES
        inside = ends[:-1, None] + np.diff(ends)[:, None] * _PLACES[:-1]
        return np.append(inside.ravel(), 1.0)

    @cached_property
    def polynomial(self) -> DenseOutput:
        """Return the polynomial through the step, of q and p of shape (d,) or (m d,)."""
        if self._series:
            return self._simulation.series(np.append(self._start.q, self._start.p))
        h, (ends, looks) = self._simulation.step_size, self._knots
        z, v = (np.array(rows) for rows in zip(*map(self._line, looks), strict=True))
        if self._slopes is not None:
            return collocation_output(h, z[0], self._slopes)
        bends = None
        if self._simulation.integrator.order > 3 and self._plain:
            bends = np.array([self._bend(*line) for line in zip(z, v, strict=True)])
        return hermite_output(h, self._start.q.size, z, v, bends, ends)

    def _line(self, look: _Look) -> tuple[np.ndarray, np.ndarray]:
        """Return (q, p) and (q', p') of a state, each of shape (n,)."""
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
        Return q and p, of shape (d,) or (m, d), at a time in the step, to the method's order.

        Parameters
        ----------
        theta : float
            Share of the step, from 0 to 1.

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
        if not self._takes_state:
            return simulation.clock_trial(self._before, time)
        if self._plain and self.polynomial.order >= simulation.integrator.order:
            q, p = self.polynomial(theta)
            return q.reshape(simulation.q.shape), p.reshape(simulation.p.shape)
        q, p = simulation.trial(self._before, time)
        return q[0], p[0]

    def outline(self, theta: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return q and p near to where the path is, at places in the step.

        By the polynomial, which costs next to nothing; in a step that was cut, where the path
        has kinks, which it does not show, by ``state``.

        Parameters
        ----------
        theta : float or np.ndarray, shape (k,)
            Shares of the step.

        Returns
        -------
        tuple of np.ndarray, shape (d,) or (k, d)
            q and p, of a simulation of one trajectory.

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


def _look(simulation: 'Simulation') -> _Look:
    """Return copies of where a simulation stands."""
    return _Look(simulation.q.copy(), simulation.p.copy(), simulation.dH_dq.copy(),
                 simulation.dH_dp.copy())


def whole_steps(time: float, step_size: float) -> tuple[int, float]:
    """
    Return how many whole steps a time is, and what share of a step is left over.

    Parameters
    ----------
    time : float
        t >= 0 [s].
    step_size : float
        h [s].

    Returns
    -------
    tuple of (int, float)
        The share is 0 where it differs from a whole step by rounding only.

    """
    steps = time / step_size
    nearest = round(steps)
    if abs(steps - nearest) <= _SHARE + _ROUNDINGS * nearest:
        return nearest, 0.0
    return int(steps), steps - int(steps)


def record_at(simulation: 'Simulation', times: Sequence[float] | np.ndarray,
              on_sample: Callable[[], None] = lambda: None) -> tuple[np.ndarray, np.ndarray]:
    """
    Advance a simulation to the last of some times, and return its states at all of them.

    Parameters
    ----------
    simulation : Simulation
        At a time that is none of the times in a step that it has taken already.
    times : sequence of float, shape (k,)
        Since the initial state, in rising order [s].
    on_sample : callable, optional
        Called at the first whole step that is not before each time.

    Returns
    -------
    tuple of np.ndarray, shape (k, d) or (k, m, d)
        q and p. The simulation ends at the first whole step that is not before the last time,
        or before the step in which an event ends the run after that.

    Raises
    ------
    StoppedByEvent
        One that ends the run came before the last of the times.
    StepFailure
        A step did not converge or is not finite.

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
                # The event comes after the last of the times.
                return q, p
            raise stop.after(q[:last], p[:last]) from None
        if dense is None:
            q[k], p[k] = simulation.q, simulation.p
        else:
            q[k], p[k] = dense.state(share)
        on_sample()
    return q, p
