# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Arrows in the rerun viewer for the forces of effects on the bodies of a mechanism."""

from collections.abc import Iterator, Sequence
import math
from typing import Any, final

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.effects.base import Effect, EffectState, Force, Potential
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.mechanisms.parts import Ball, Box, Mechanism
from hnn_vi_ros.simulation.sample import Sample
from hnn_vi_ros.viewer.rerun_layout import PALETTE
import numpy as np
import rerun as rr

# Effects whose force is known at a state, in microseconds of plain Python, and what commands make.
DRAWN = ('gravity', 'spring', 'magnetic_field', 'soft_wall', 'damping', 'dry_friction',
         'quadratic_drag', 'periodic_drive')
MOTORS = 'motors'
# Shares of half the mechanism's extent: the arrow of the largest force of the first samples at
# most, and the radius of an arrow.
_SHARE, _RADIUS = 1.0, 0.03
# What q is varied by, relative to its range, for the derivatives of places.
_STEP = 1e-6
# Those of the palette, from its third on: the first two are taken by mechanisms.
_COLORS = ('green', 'pink', 'turquoise', 'red', 'violet', 'yellow')


@final
class ForceArrows:
    """
    The generalised force of each effect, as forces on the bodies that a mechanism draws.

    Of all forces F on the bodies that make the generalised force f, J^T F = f with the Jacobian J
    of their places, the ones with the least sum of squares are drawn: in Cartesian coordinates the
    force itself, of a pendulum the torque over the drawn length of its rod, across the rod.

    Parameters
    ----------
    effects : sequence of Effect
        All of the scene; those that are not in DRAWN are left out.
    hamiltonian : Hamiltonian
        H, whose coordinates the effects name.
    mechanism : callable
        The mechanism to draw; see :mod:`hnn_vi_ros.mechanisms`.
    step_size : float
        h [s]: effects count the time from step 0 on.
    reach, size : float
        The reach of the mechanism, and half of its extent [m].

    Attributes
    ----------
    scale : float
        Length of the arrow of a force of 1 N [m]; NaN before there was a force.

    """

    def __init__(self, effects: Sequence[Effect], hamiltonian: Hamiltonian, mechanism: Mechanism,
                 step_size: float, reach: float, size: float):
        self._mechanism, self._step_size = mechanism, step_size
        self._reach, self._size = reach, size
        d = hamiltonian.dimension
        state = EffectState.empty(len(effects), d)
        kinds = {EFFECTS[kind]: kind for kind in DRAWN}
        known = [effect for effect in effects if type(effect) in kinds]
        # All are resolved before one acts: friction has to know of magnetic fields.
        resolved = [effect.resolve(hamiltonian.coordinates, state) for effect in known]
        self._effects: list[tuple[str, Effect, Any]] = []
        for effect, own in zip(known, resolved, strict=True):
            kind = kinds[type(effect)]
            count = sum(type(other) is type(effect) for other in known)
            index = sum(name.startswith(kind) for name, _, _ in self._effects)
            self._effects.append((f'{kind}.{index}' if count > 1 else kind, effect, own))
        self._curl = state.gauge.T - state.gauge
        self.scale = math.nan

    def columns(self, samples: Sequence[Sample]
                ) -> Iterator[tuple[str, rr.ComponentColumnList]]:
        """Yield the name of each force and its arrows at n samples, from where the bodies are."""
        q = np.array([sample.q for sample in samples])
        forces = {name: np.array([self._force(effect, own, sample) for sample in samples])
                  for name, effect, own in self._effects}
        if any(sample.motors is not None for sample in samples):
            forces[MOTORS] = np.array([np.zeros(q.shape[1]) if sample.motors is None
                                       else sample.motors for sample in samples])
        if not forces:
            return
        places, jacobian = self._bodies(q)
        inverse = np.linalg.pinv(np.nan_to_num(jacobian)).swapaxes(1, 2)
        arrows = {name: (inverse @ force[..., None]).reshape(places.shape)
                  for name, force in forces.items()}
        if math.isnan(self.scale):
            self.scale = self._scale_of(np.array([*arrows.values()]))
        if not math.isnan(self.scale):
            for name, vectors in arrows.items():
                yield name, _arrows(places, self.scale * vectors)

    def style(self, name: str) -> rr.Arrows3D:
        """Return how the arrows of a force look; labels in the view would hide them."""
        return rr.Arrows3D.from_fields(
            colors=[PALETTE[2 + self._color(name)]], radii=[_RADIUS * self._size])

    def legend(self, names: Sequence[str]) -> str:
        """Return what the arrows of forces show, for those who look at them."""
        colors = ', '.join(f'{name} {_COLORS[self._color(name)]}' for name in names)
        return f'arrows of forces, 1 N is {self.scale:g} m long: {colors}'

    def _color(self, name: str) -> int:
        names = [*(other for other, _, _ in self._effects), MOTORS]
        return names.index(name) % len(_COLORS)

    def _force(self, effect: Effect, own: Any, sample: Sample) -> np.ndarray:
        """Return the generalised force of an effect at a sample, shape (d,)."""
        if isinstance(effect, EFFECTS['magnetic_field']):
            return self._curl @ sample.dH_dp
        f_q, f_p = np.zeros((2, sample.q.size))
        if isinstance(effect, Potential):
            effect.add_gradient(own, sample.q, f_p)
            return -f_p
        assert isinstance(effect, Force), 'DRAWN has no others'
        effect.add_force(own, sample.step * self._step_size, sample.q, sample.p, sample.dH_dp,
                         f_q, f_p)
        return f_p

    def _bodies(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places of the m bodies, shape (n, m, 3), and their derivatives, (n, 3 m, d)."""
        step = _STEP * max(self._reach, 1.0)
        columns = [(self._places(q + shift) - self._places(q - shift)) / (2.0 * step)
                   for shift in step * np.eye(q.shape[1])]
        jacobian = np.stack([column.reshape(len(q), -1) for column in columns], axis=-1)
        return self._places(q), jacobian

    def _places(self, q: np.ndarray) -> np.ndarray:
        parts = self._mechanism(q, self._reach).values()
        return np.stack([part.center for part in parts
                         if isinstance(part, Ball | Box) and part.moves], axis=1)

    def _scale_of(self, arrows: np.ndarray) -> float:
        """Return a length of 1, 2 or 5 times a power of ten for 1 N, to show the largest force."""
        largest = float(np.linalg.norm(arrows, axis=-1).max(initial=0.0, where=np.isfinite(
            arrows).all(axis=-1)))
        if largest == 0.0:
            return math.nan
        longest = _SHARE * self._size / largest
        power = 10.0 ** math.floor(math.log10(longest))
        return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= longest)


def _arrows(places: np.ndarray, vectors: np.ndarray) -> rr.ComponentColumnList:
    """Return a row of arrows, one for each body, for each of n samples."""
    n, bodies, _ = places.shape
    return rr.Arrows3D.columns(origins=places.reshape(-1, 3), vectors=vectors.reshape(-1, 3)
                               ).partition([bodies] * n)
