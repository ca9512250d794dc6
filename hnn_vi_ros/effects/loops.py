# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Closed chains of a robot, kept closed with RATTLE; the scene lists them under hamiltonian."""

from collections.abc import Sequence
from types import MappingProxyType

from hnn_vi_ros.effects.base import Effect, EffectError, EffectState, Place
from hnn_vi_ros.effects.rattle import Constraints, RattleOfLoops, suits_rattle
from hnn_vi_ros.hamiltonians import fill_loops, LoopRows, Loops
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.kernels import kept, Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Most iterations to close loops, and the error of closure that is round-off, in units of eps.
_MAX_ITERATIONS, _ROUNDINGS, _EPS = 50, 64, float(np.finfo(np.float64).eps)
# Distance of a gradient from the span of others below which it depends on them; and correction of
# an initial state above which it is refused: of a coordinate, or of the velocity relative to the
# largest one.
_MIN_SINE, _MAX_CORRECTION = 1e-8, 1e-3


class ClosedChains(Effect):
    """
    The loops of a robot, which a system adds to the effects of the scene.

    Parameters
    ----------
    loops : Loops
        The loops.

    """

    acts, conservative, batched, label = Place.MANIFOLD, True, False, 'loops'
    excludes = MappingProxyType({
        Place.MANIFOLD: 'because loops and other constraints are not solved together'})

    def __init__(self, loops: Loops):
        self.loops = loops

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method is symmetric, symplectic and of order 2, like RATTLE."""
        return suits_rattle(integrator)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> LoopRows:
        """Return the equations, with their own workspace."""
        return self.loops.rows.copy()


class LoopManifold:
    """
    The states at which the loops of a robot are closed and stay closed.

    Parameters
    ----------
    loops : Loops
        The loops.
    rows : LoopRows
        Their equations, with the workspace of a system.
    kernel : Kernel
        H with the forces, for d coordinates and their channels.
    effects : int
        Number of effects; the loops are the last one.

    Attributes
    ----------
    constraints : Constraints
        Parameters and workspace of steps.
    kind : type
        The layer that Wrapped puts around a step.
    report : str
        The equations that were dropped, and the correction of the last initial state.

    """

    kind = RattleOfLoops

    def __init__(self, loops: Loops, rows: LoopRows, kernel: Kernel, effects: int):
        self._loops, self._rows, self._kernel, self._index = loops, rows, kernel, effects - 1
        self._d = kernel.dimension - kernel.channels
        self.constraints = Constraints.of((), loops._replace(rows=rows), kernel.dimension, effects)
        self.report = ''

    @property
    def dependent(self) -> str:
        """Return the name of the loop that made a step fail as REDUNDANT."""
        return f'loop {self._loops.names[self.constraints.dependent[0]]}'

    @property
    def _kept(self) -> np.ndarray:
        return ~self.constraints.dropped

    def errors(self, q: np.ndarray) -> np.ndarray:
        """Return g at q, shape (d,): positions relative to the length of the chains, (R,)."""
        return self._at(q)[0] / np.where(self._rows.turns, 1.0, self._loops.length)

    def gradients(self, q: np.ndarray) -> np.ndarray:
        """Return the gradients of the independent equations at q, (N, d), shape (N, K, d)."""
        found = np.array([self._at(one)[1] for one in q])
        return found[:, self._kept]

    @property
    def force_names(self) -> list[str]:
        """Return the names of the entries of ``forces``, such as coupler-rocker.force.x."""
        first = np.flatnonzero(self._rows.normal[:, 0])
        return [f'{self._loops.names[r]}.{kind}.{axis}' for r in first
                for kind in ('force', 'moment') for axis in 'xyz']

    def forces(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """
        Return the force [N] and the moment [N m] of the second link of each loop on the first.

        Parameters
        ----------
        q : np.ndarray, shape (d,)
            Coordinates.
        multipliers : np.ndarray, shape (R,)
            Those of g, whose force is -G^T multipliers; 0 for equations that were dropped.

        Returns
        -------
        np.ndarray, shape (L, 6)
            At the joint, along the axes of the base.

        """
        self._at(q)
        rows, turned = self._rows, self._rows.work.rotation.reshape(-1, 3, 3)
        first, second = (np.einsum('rij,rj->ri', turned[rows.ends[:, e]], rows.vectors[:, e])
                         for e in range(2))
        parts = np.hstack([rows.normal, np.cross(second, first) * rows.turns[:, None]])
        found = np.zeros((np.count_nonzero(rows.normal[:, 0]), 6))
        # Each loop begins with the equation along x.
        np.add.at(found, np.cumsum(rows.normal[:, 0]).astype(int) - 1,
                  multipliers[:, None] * parts)
        return found

    def check_state(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the nearest state, of shape (d,) each, at which the loops are and stay closed.

        In the metric of M: q by the method of Gauss and Newton, p in one step.

        Raises
        ------
        EffectError
            The loops leave no degree of freedom.
        ValueError
            The loops cannot be closed near q, or the correction is too large to be silent.

        """
        closed = self._close(q, p)
        gradient = self._at(closed)[1]
        root, scaled, _ = self._scaled(closed, p, gradient)
        kept = _independent(scaled)
        # A check of another state, in the middle of a run, changes nothing unless it has to.
        before = self._kept
        if self.report and before.sum() == kept.sum() == _independent(scaled[before]).sum():
            kept = before
        if kept.sum() >= self._d:
            raise EffectError(self._index, f'loops leave no degree of freedom: {kept.sum()} '
                                           f'independent equations for {self._d} joints; remove '
                                           'some')
        self.constraints.dropped[:] = ~kept
        normal = gradient[kept]
        metric = normal @ root @ root.T @ normal.T
        moving = p.copy()
        for _ in range(2):  # the second one removes the rounding error of the first
            moving -= normal.T @ np.linalg.solve(metric, normal @ self._velocity(closed, moving))
        old, new = self._velocity(closed, p), self._velocity(closed, moving)
        corrections = (np.abs(closed - q).max(),
                       np.abs(new - old).max() / (np.abs(old).max() or 1.0))
        if max(corrections) > _MAX_CORRECTION and not self._loops.assemble:
            key, state = ('q', closed) if corrections[0] > _MAX_CORRECTION else ('p', moving)
            what = 'the loops are not closed' if key == 'q' else 'the loops do not stay closed'
            raise ValueError(
                f'{what} at the initial {key}: the nearest one differs by {max(corrections):.3g}, '
                f'more than {_MAX_CORRECTION:g}; give {key}: {np.round(state, 9).tolist()}, or '
                'assemble: true in hamiltonian')
        self.report = (f'{kept.sum()} independent equations of {kept.size}; initial q corrected '
                       f'by {corrections[0]:.1e}, velocity by {corrections[1]:.1e}')
        return closed, moving

    def _at(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return g, shape (R,), and its gradient, shape (R, d)."""
        defect, gradient = np.zeros(self._rows.turns.size), np.zeros(
            (self._rows.turns.size, self._d))
        _fill(self._rows, np.ascontiguousarray(q), defect, gradient)
        return defect, gradient

    def _close(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        previous = np.inf
        for _ in range(_MAX_ITERATIONS):
            defect, gradient = self._at(q)
            error = float(np.abs(self.errors(q)).max())
            if error <= _EPS or (error >= previous and error <= _ROUNDINGS * _EPS):
                self._check_welds(q)
                return q
            root, scaled, sizes = self._scaled(q, p, gradient)
            q, previous = q - root @ np.linalg.lstsq(
                scaled, defect / sizes, rcond=_MIN_SINE)[0], error
        raise ValueError('the loops cannot be closed near the initial q; check their points and '
                         'frames, or start elsewhere')

    def _check_welds(self, q: np.ndarray) -> None:
        """Raise ValueError if the axes of welded frames are parallel, but not the same."""
        turned = self._rows.work.rotation.reshape(-1, 3, 3)
        for r in self._loops.welds:
            ends, vectors = self._rows.ends[r], self._rows.vectors[r:r + 3]
            first, second = (vectors[:, e] @ turned[ends[e]].T for e in range(2))
            # The rows are x, y, z of the first frame and y, z, x of the second.
            if not (np.sum(first * np.roll(second, 1, axis=0), axis=1) > 0.0).all():
                raise ValueError(f'loop {self._loops.names[r]}: the frames are turned against '
                                 'each other by 180 degrees at the initial q; correct roll, pitch '
                                 'and yaw, or start elsewhere')

    def _scaled(self, q: np.ndarray, p: np.ndarray, gradient: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return C of M^-1 = C C^T, the gradient G C over scales of its rows, and these."""
        n, d = self._kernel.dimension, self._d
        state, rest = self._extended(q, p), np.zeros(n)
        root = np.linalg.cholesky([self._kernel.products(state[0], state[1], rest, unit)[1][:d]
                                   for unit in np.eye(n)[:d]])
        # Not their own sizes: a gradient that vanishes is dependent.
        sizes = np.where(self._rows.turns, 1.0, self._loops.length) * np.linalg.norm(root, 2)
        return root, gradient @ root / sizes[:, None], sizes

    def _velocity(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        state = self._extended(q, p)
        return self._kernel.slopes(state[0], state[1])[1][:self._d]

    def _extended(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the state with the channels of forces, shape (2, D)."""
        state = np.zeros((2, self._kernel.dimension))
        state[:, :self._d] = q, p
        return state


def _independent(scaled: np.ndarray) -> np.ndarray:
    """Return a mask of independent rows on which the others depend, by QR with pivoting."""
    # Imported lazily: the import is slow, and scenes without loops do not need it.
    from scipy.linalg import qr
    triangle, order = qr(scaled.T, mode='r', pivoting=True)
    kept = np.zeros(len(scaled), bool)
    kept[order[:len(triangle)][np.abs(np.diag(triangle)) > _MIN_SINE]] = True
    return kept


@kept(error_model='numpy')
def _fill(rows: LoopRows, q: np.ndarray, defect: np.ndarray, gradient: np.ndarray) -> None:
    fill_loops(rows, q, 0, defect, gradient)
