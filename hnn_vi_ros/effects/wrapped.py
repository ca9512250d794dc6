# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An integrator with an effect around its step, and the energy account of effects."""

from collections.abc import Sequence
from copy import copy
from functools import cache
from typing import Any, final

from hnn_vi_ros.effects.base import StepLayer
from hnn_vi_ros.integrators import (
    Integrator, is_finite, NOT_FINITE, OK, PhasePoint, plus, Requirements, Step)
from hnn_vi_ros.kernels import inlined, is_own, Kernel, Parameters
import numpy as np


@final
class Wrapped(Integrator):
    """
    A method with a layer, such as an effect, around its step.

    Parameters
    ----------
    inner : Integrator
        The method.
    kind : type of Layer
        The layer.
    settings : tuple
        The options of the layer's step, which follow the options of the method.

    Attributes
    ----------
    inner : Integrator
        The method.

    """

    explicit, requirements = False, Requirements(symmetric=False, symplectic=False)

    def __init__(self, inner: Integrator, kind: type[StepLayer], settings: Parameters):
        # An effect may solve the step several times and discard results, so a solution that is not
        # connected to h = 0 does not make the step fail.
        self.inner, self._kind, self._settings = copy(inner), kind, settings
        self.inner.no_solution = ''
        self.order, self.compiled, self.equations = inner.order, inner.compiled, inner.equations
        self.step = kind.wrap(kind.inner_step(inner), inner.keeps_gradient)

    @property
    def kernel_name(self) -> str:
        """Return the names of the layer and of the method."""
        return f'{self._kind.__name__}({self.inner.kernel_name})'

    @property
    def own(self) -> bool:
        """Return True if the layer belongs to this package; the method is compiled separately."""
        return is_own(self._kind.__module__)

    @property
    def inner_steps(self) -> tuple[Step, ...]:
        """Return the part of the method that the layer takes: its step, or the two halves."""
        return tuple(part for part in self._taken if callable(part))

    def around(self, steps: Sequence[Step]) -> Step:
        """Return the layer around other steps."""
        rest = iter(steps)
        taken = tuple(next(rest) if callable(part) else part for part in self._taken)
        return self._kind.wrap(taken if len(taken) > 1 else taken[0], self.inner.keeps_gradient)

    @property
    def layer_name(self) -> str:
        """Return a unique name for the result of ``around``, without the names of the steps."""
        flags = [part for part in self._taken if not callable(part)]
        return (f'{self._kind.__module__}.{self._kind.__qualname__}'
                f'({self.inner.keeps_gradient}, {flags})')

    @property
    def _taken(self) -> tuple[Any, ...]:
        taken = self._kind.inner_step(self.inner)
        return taken if isinstance(taken, tuple) else (taken,)

    def attempts(self, n: int) -> tuple[int, ...]:
        """Return the attempts of the method."""
        return self.inner.attempts(n)

    @property
    def usual_gradients(self) -> int:
        """Return the gradients of the method; 0 if the layer repeats its step."""
        return 0 if self._kind.repeats else self.inner.usual_gradients

    def options(self, attempt: int = 0, dimension: int = 1) -> Parameters:
        """Return the options of the method, then the settings of the layer."""
        return (self.inner.options(attempt, dimension), *self._settings)

    def memory(self, n: int, dtype: type = np.float64) -> tuple[Any, ...]:
        """Return the workspaces of the method and of the layer."""
        return (*self.inner.memory(n, dtype), self._kind.workspace(n, self._settings))

    def with_method(self, inner: Integrator) -> 'Wrapped':
        """Return another method with the layer around its step."""
        return Wrapped(inner, self._kind, self._settings)


class Account(StepLayer):
    """Layer that commits the account of effects after each successful step; see EffectState."""

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return (): the account is part of EffectState."""
        return ()

    @staticmethod
    @cache
    def wrap(step: Step, keeps_gradient: bool) -> Step:
        """Return the step with its account."""
        @inlined
        def accounted(kernel: Kernel, h: float, options: Parameters, z: PhasePoint, z1: PhasePoint,
                      memory: tuple[Any, ...]) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, state, channel_effects, internal = options
            state.pending[:] = 0.0
            if keeps_gradient and internal > 0 and state.step[0] != h:
                # The gradient at the start contains mean rates over a step of another size.
                state.step[0] = h
                kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
            state.step[0] = h
            state.draws[1] = 0
            outcome, residual, gradients = step(kernel, h, inner, z, z1, memory[:-1])
            if outcome != OK or not is_finite(z1):
                return outcome if outcome != OK else NOT_FINITE, residual, gradients
            d = kernel.dimension - kernel.channels
            for a in range(0, z1.q.size, kernel.dimension):
                for k in range(kernel.channels):
                    i = a + d + k
                    if k < internal:
                        state.resting[channel_effects[k]] += z1.p[i] + z1.p_carry[i]
                    else:
                        state.pending[channel_effects[k]] += z1.p[i] + z1.p_carry[i]
                    z1.q[i], z1.p[i], z1.q_carry[i], z1.p_carry[i] = 0.0, 0.0, 0.0, 0.0
            for k in range(state.pending.size):
                state.work[k, 0], state.work[k, 1] = plus(
                    state.work[k, 0], state.work[k, 1], state.pending[k])
            start, until = state.clock[0], state.command[state.command.size - 1]
            state.clock[0], state.clock[1] = plus(state.clock[0], state.clock[1], h)
            state.draws[0] += state.draws[1]
            if internal > 0 or start < until <= state.clock[0] \
                    or start < state.expiry[0] <= state.clock[0]:
                # The gradient for the next step contains internal variables from before the step,
                # or a command that has expired.
                kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
                gradients += 1
            return OK, residual, gradients
        return accounted


@inlined
def energy_of(kernel: Kernel, z: PhasePoint) -> float:
    """Return the sum of H over the states of a point [J]."""
    total = 0.0
    for a in range(0, z.q.size, kernel.dimension):
        end = a + kernel.dimension
        total += kernel.energy(kernel.parameters, z.q[a:end], z.p[a:end])
    return total
