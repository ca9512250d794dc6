# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of a simulation: at a stretch by compiled code, and by fallbacks where one fails."""

import math
from operator import itemgetter
import time
from typing import Any

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.integrators.base import BEYOND, IN_DOUBT, NO_SOLUTION, OK, Point, step_failure
from hnn_vi_ros.integrators.workspaces import arrays_of, forget
from hnn_vi_ros.processors import heed
from hnn_vi_ros.simulation.assembly import advance, Loop
from hnn_vi_ros.simulation.rescue import Rescue
from hnn_vi_ros.simulation.system import System
import numpy as np

# Relative to a state: solutions that are further apart are not the same one, to round-off.
_SAME, _FIRST = 1e-8, itemgetter(0)
# Wall time that compiled code runs at a stretch [s]: signals are handled between two stretches,
# whose calls cost some microseconds. One has at most so many times the steps of that before.
_STRETCH, _GROWTH = 0.02, 16.0


class RescuePending(Exception):
    """Refusal of a step that fails while what takes such steps is still being compiled."""


class Stepping:
    """
    Steps of a state by the method of a system, and what they cost; see Simulation.

    Parameters
    ----------
    system : System
        Its kernel, method and effects.
    step_size : float
        h [s].
    on_failure : str
        See Rescue.

    Attributes
    ----------
    rescue_ready : bool
        Whether a step that fails compiles what it needs where that is not there yet. Set to False
        by who has ``compile_rescue`` run in another thread, which sets it to True at its end: such
        a step raises RescuePending meanwhile, and all is as before the step.

    """

    def __init__(self, system: System, step_size: float, on_failure: str):
        self._system, self._kernel, self.step_size = system, system.kernel, step_size
        self._rescue, self.rescue_ready = Rescue(system, on_failure), True
        # Keyed by the active method: a loop that may never be needed is compiled on first use.
        self._loops = {0: Loop(advance, self._kernel, self._rescue.methods[0])}
        # Steps at a stretch.
        self._most = 1

    def _begin(self, n: int, step: int) -> None:
        """Make room for a state of n unknowns, and count from a step on."""
        self.steps, self.gradients, self.residual = step, 0, 0.0
        self.rescued, self.several_solutions, self.costliest = 0, 0, (0, step)
        self._z, self._z1 = Point.empty(n), Point.empty(n)
        self._active, self._memories = 0, self._rescue.memories(n)
        self._own = [*self._arrays().values()]
        # The same memory in numbers of 64 bits, whatever they are; and as it is before a step.
        self._flat = tuple(array.reshape(-1).view(np.float64) for array in self._own)
        self._fresh = [array.copy() for array in self._flat]
        # Not the point's own: what a step finds there must not depend on when it was looked at.
        self._dH_dq, self._dH_dp = np.empty((2, n))

    @property
    def time(self) -> float:
        """Return the simulated time since the initial state [s]."""
        return self.steps * self.step_size

    def compile(self, whole: bool | None = None) -> float:  # noqa: A003
        """
        Compile the kernel now, not in the first step; return the wall time it took [s].

        Parameters
        ----------
        whole : bool, optional
            Compile effects and method into one loop, which takes longer, and which later
            simulations of them find: their steps are the same, and take less time. False for a
            loop that calls them by address, the default; see assembly.

        """
        start = time.perf_counter()
        self._loop(self._active, whole)
        self._take(0, *np.empty((2, 0, self._z.q.size)))
        return time.perf_counter() - start

    def compile_rescue(self) -> None:
        """Compile all that may take a step that fails, now; another thread may take steps."""
        try:
            n = self._z.q.size
            for active, memory in enumerate(self._rescue.memories(n)):
                self._loop(active).compile(
                    self.step_size, 0, 1, Point.empty(n), Point.empty(n), memory,
                    *np.empty((2, 1, n)), 1)
            self._rescue.compile(self.step_size, n)
        finally:
            self.rescue_ready = True

    def _loop(self, active: int, whole: bool | None = None) -> Loop:
        """Return the loop over a method, the same each time unless its way is asked for."""
        if active not in self._loops or whole is not None:
            method = self._rescue.methods[active]
            self._loops[active] = Loop(advance, self._kernel, method, whole=whole)
        return self._loops[active]

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return, by name, all arrays that the next steps depend on."""
        groups: dict[str, Any] = {'point': self._z, 'live': self._system.effect_state} | {
            f'memory{active}.{k}': workspace.kept for active, memory in enumerate(self._memories)
            for k, workspace in enumerate(memory) if hasattr(workspace, 'kept')}
        return {name: array for place, group in groups.items()
                for name, array in arrays_of(place, group)}

    def _evaluate_gradient(self) -> None:
        self._kernel.gradient(
            self._kernel.parameters, self._z.q, self._z.p, self._z.dH_dq, self._z.dH_dp)

    def _update_gradient(self) -> None:
        """Make the public gradient that of the state."""
        if self._rescue.methods[self._active].keeps_gradient:
            self._dH_dq[:], self._dH_dp[:] = self._z.dH_dq, self._z.dH_dp
        else:
            self._kernel.gradient(
                self._kernel.parameters, self._z.q, self._z.p, self._dH_dq, self._dH_dp)

    def _take(self, every: int, q_out: np.ndarray, p_out: np.ndarray, until: float = math.inf
              ) -> None:
        """Take the steps to the last sample, or to that in which the time comes, or raise."""
        done, changed, last = 0, -1, len(q_out) * every
        begun, before, costs = done, self._kept(), self._costs()
        while True:
            outcome, done, residual, spent = self._run(done, last, every, q_out, p_out)
            if outcome != OK and not self.rescue_ready:
                self._go_back(before, costs, done - begun)
                raise RescuePending
            if outcome == BEYOND and (self._active == 0 or done > changed):
                self._change_method()
                changed = done
                continue
            if outcome != OK:
                failure = self._take_failed_step(outcome, residual, spent)
                if failure is not None:
                    # A replay knows only the steps that were taken: one that was not must leave
                    # no trace in what the next ones start from.
                    costs = self._costs()
                    self._go_back(before, costs, done - begun)
                    vars(self).update(costs)
                    raise failure
                done += 1
                if done % every == 0:
                    q_out[done // every - 1], p_out[done // every - 1] = self._z.q, self._z.p
            if done >= last or time.perf_counter() >= until:
                break
            heed()
            begun, before, costs = done, self._kept(), self._costs()
        self._update_gradient()

    def _run(self, done: int, last: int, every: int, q_out: np.ndarray, p_out: np.ndarray
             ) -> tuple[int, int, float, int]:
        """Take a stretch; return outcome, steps done, residual and gradients of the last step."""
        begin, loop = time.perf_counter(), self._loop(self._active)
        outcome, now, gradients, self.residual, spent, most, costliest = loop(
            self.step_size, done, every, self._z, self._z1, self._memories[self._active],
            q_out, p_out, min(last, done + self._most))
        if now - done == self._most:
            seconds = time.perf_counter() - begin
            self._most = max(1, int(self._most * min(_GROWTH, _STRETCH / seconds)))
        self.costliest = max(self.costliest, (most, self.steps + costliest + 1 - done), key=_FIRST)
        self.steps, self.gradients = self.steps + now - done, self.gradients + gradients
        self.rescued += (now - done) * (self._active != 0)
        return outcome, now, self.residual, spent

    def _costs(self) -> dict[str, Any]:
        """Return what steps have cost, by its attribute."""
        return {name: getattr(self, name) for name in (
            'gradients', 'rescued', 'several_solutions', 'residual', 'costliest')}

    def _kept(self) -> tuple[int, int, list[np.ndarray]]:
        """Return what a stretch begins with: a snapshot without names, in microseconds."""
        return self.steps, self._active, [array.copy() for array in self._own]

    def _go_back(self, kept: tuple[int, int, list[np.ndarray]], costs: dict[str, Any], done: int
                 ) -> None:
        """Go to where the steps that were done end: what one that failed has left is gone."""
        self.steps, self._active, arrays = kept
        for array, value in zip(self._own, arrays, strict=True):
            array[...] = value
        vars(self).update(costs)
        self._take(done, *np.empty((2, 1, self._z.q.size)))

    def _change_method(self) -> None:
        """Go on by the other method, from a state like an initial one."""
        self._active = 1 - self._active
        forget(self._memories[self._active])
        self._evaluate_gradient()
        self.gradients += 1

    def _take_failed_step(self, outcome: int, residual: float, spent: int) -> StepFailure | None:
        """Take one step by a fallback; return what came of the first one if none will do."""
        z, z1 = self._z, self._z1
        doubtful = np.append(z1.q, z1.p)
        taken = self._rescue.take_step(
            self._active, self.step_size, z, z1, self._memories[self._active])
        if outcome == IN_DOUBT:
            outcome, residual = taken.outcome, taken.residual
            self.several_solutions += taken.ok and not (taken.rescued or np.allclose(
                doubtful, np.append(z.q, z.p), _SAME, _SAME * abs(doubtful).max()))
        self.gradients += taken.gradients
        self.rescued += taken.rescued or (taken.ok and self._active != 0)
        self.residual = self.residual if np.isnan(taken.residual) else taken.residual
        spent += taken.gradients
        if not taken.ok:
            outcome = taken.outcome if taken.outcome == NO_SOLUTION else outcome
            reason = self._system.reason(outcome)
            if taken.given_up:
                reason += f', given up after {taken.given_up} gradients in sub-steps'
            return step_failure(outcome, self.time, self.step_size, residual, spent, reason)
        self.steps += 1
        self.costliest = max(self.costliest, (spent, self.steps), key=_FIRST)
        return None
