# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Closed chains: equations g(q) = 0 between frames of two links of a tree, and their gradients."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from hnn_vi_ros.errors import listed
from hnn_vi_ros.files import in_plain_words, StrictModel
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import Bodies, fill_frames, Following, TreeWork
from hnn_vi_ros.kernels import inlined
import numpy as np
from pydantic import Field, ValidationError

_Point = Annotated[list[float], Field(min_length=3, max_length=3)]
_Frame = Annotated[list[float], Field(min_length=6, max_length=6)]
# Products of axes of both frames that vanish: the axis z of the first frame and two of the second.
_AXES = {'point': (), 'hinge': ((2, 0), (2, 1)), 'weld': ((0, 1), (1, 2), (2, 0))}


class ClosingJoint(StrictModel):
    """A joint that closes a chain."""

    links: list[str] = Field(min_length=2, max_length=2, description='the two links that it joins')
    joint: Literal['point', 'hinge', 'weld'] = Field(description=(
        'point: the points coincide; hinge: the origins and the axes z of the frames do; weld: '
        'the frames do'))
    points: list[_Point] | None = Field(None, min_length=2, max_length=2, description=(
        'for point: a point of each link, in its frame [m]'))
    frames: list[_Frame] | None = Field(None, min_length=2, max_length=2, description=(
        'for hinge and weld: a frame of each link, in its frame: x, y, z [m], roll, pitch, yaw '
        '[rad]'))

    def _check(self) -> None:
        wanted = 'points' if self.joint == 'point' else 'frames'
        for name in ('points', 'frames'):
            if (getattr(self, name) is None) == (name == wanted):
                raise ValueError(f'the joint {self.joint} of {self.links[0]} and {self.links[1]} '
                                 f'requires {wanted}, and only these')


class LoopRows(NamedTuple):
    """
    The R equations of the loops of a tree of d bodies, and workspace; dependent ones included.

    Parameters
    ----------
    bodies : Bodies
        The tree; only its geometry is used.
    work : TreeWork
        Workspace for one state.
    origin : np.ndarray, shape (d + 1, 3)
        Origin of each body [m].
    ends : np.ndarray of int, shape (R, 2)
        The bodies at both ends.
    turns : np.ndarray of int, shape (R,)
        1 if g = u . w of a vector of each body, 0 if g = n . (w - u) of a point of each [m].
    vectors : np.ndarray, shape (R, 2, 3)
        u and w in the frames of their bodies.
    normal : np.ndarray, shape (R, 3)
        n, in the frame of the base.
    arms : np.ndarray, shape (2, 3)
        u and w in the frame of the base.
    leader, multiplier, offset : np.ndarray, shape (d,)
        The values of the joints are ``multiplier * q[leader] + offset``.
    joints : np.ndarray, shape (d,)
        These values.

    """

    bodies: Bodies
    work: TreeWork
    origin: np.ndarray
    ends: np.ndarray
    turns: np.ndarray
    vectors: np.ndarray
    normal: np.ndarray
    arms: np.ndarray
    leader: np.ndarray
    multiplier: np.ndarray
    offset: np.ndarray
    joints: np.ndarray

    def copy(self) -> 'LoopRows':
        """Return the same equations in other memory."""
        own = [part.copy() for part in self[2:]]
        return LoopRows(Bodies(*(part.copy() for part in self.bodies)),
                        TreeWork(*(part.copy() for part in self.work)), *own)


class Loops(NamedTuple):
    """
    Closed chains of a robot.

    Parameters
    ----------
    rows : LoopRows
        Their equations.
    names : tuple of str
        The links of the loop of each equation, as ``coupler-rocker``.
    welds : tuple of int
        The first of the three equations of axes of each weld.
    reach : float
        Largest distance of the ends from the base, and at least 1 if there are angles: the scale
        of rounding errors.
    length : float
        The length that errors of closure are relative to [m].
    assemble : bool
        Move any initial state onto the loops, not only one that is 1e-3 or less away.

    """

    rows: LoopRows
    names: tuple[str, ...]
    welds: tuple[int, ...]
    reach: float
    length: float
    assemble: bool


def loops_of(given: Sequence[Mapping[str, Any] | ClosingJoint], bodies: Bodies,
             following: Following | None, links: Mapping[str, tuple[int, np.ndarray, np.ndarray]],
             assemble: bool) -> Loops:
    """
    Return the equations of loops.

    Parameters
    ----------
    given : sequence of mapping or ClosingJoint
        The loops; see ClosingJoint.
    bodies, following : Bodies, Following or None
        The tree, and the joints that follow others.
    links : mapping of str to (int, np.ndarray, np.ndarray)
        Body of each link, and the pose of its frame in that of the body.
    assemble : bool
        See Loops.

    Raises
    ------
    ValueError
        A loop is invalid, or its links do not move against each other.

    """
    # Imported lazily: the import is slow, and scenes without robots do not need it.
    from scipy.spatial.transform import Rotation
    turns: list[int] = []
    welds: list[int] = []
    vectors: list[Sequence[np.ndarray]] = []
    ends, normals, names = [], [], list[str]()
    for index, one in enumerate(given):
        loop = one if isinstance(one, ClosingJoint) else _closing_joint(one, index)
        for name in loop.links:
            if name not in links:
                raise ValueError(f'loops.{index}: {name!r} is not a link behind the base; links: '
                                 f'{listed(links)}')
        rows = [links[name][0] for name in loop.links]
        if rows[0] == rows[1]:
            raise ValueError(f'loops.{index}: no joint moves {loop.links[0]!r} against '
                             f'{loop.links[1]!r}; name two links with moving joints between')
        points, axes = [], []
        for name, frame in zip(loop.links, loop.points or loop.frames or (), strict=True):
            _, rotation, origin = links[name]
            points.append(origin + rotation @ frame[:3])
            axes.append((rotation @ Rotation.from_euler('xyz', [*frame[3:], 0.0, 0.0, 0.0][:3])
                         .as_matrix()).T)
        pairs = [(axes[0][i], axes[1][j]) for i, j in _AXES[loop.joint]]
        welds += [len(turns) + 3] * (loop.joint == 'weld')
        vectors += [*[points] * 3, *pairs]
        normals += [*np.eye(3), *np.zeros((len(pairs), 3))]
        turns += [0] * 3 + [1] * len(pairs)
        ends += [rows] * (3 + len(pairs))
        names += ['-'.join(loop.links)] * (3 + len(pairs))
    offsets = np.linalg.norm(bodies.placement[:, 9:], axis=1)
    length = float(offsets.sum() + np.abs(np.array(vectors)[np.array(turns) == 0]).max())
    d = len(bodies.parent) - 1
    leader, multiplier, offset = following or (np.arange(d), np.ones(d), np.zeros(d))
    angles = bool((bodies.prismatic[1:] == 0).any())
    return Loops(
        LoopRows(bodies, TreeWork.empty(d), np.zeros((d + 1, 3)), np.array(ends), np.array(turns),
                 np.array(vectors), np.array(normals), np.zeros((2, 3)),
                 leader, multiplier, offset, np.zeros(d)),
        tuple(names), tuple(welds), max(length, 1.0) if angles else length, length, assemble)


def _closing_joint(given: Mapping[str, Any], index: int) -> ClosingJoint:
    try:
        return ClosingJoint(**given)
    except ValidationError as problem:
        raise ValueError(f'loops.{index}: {in_plain_words(problem)}') from problem


@inlined
def fill_loops(loops: LoopRows, q: np.ndarray, first: int, defect: np.ndarray,
               gradient: np.ndarray) -> None:
    """
    Fill g(q) and add its gradient, in the rows from ``first`` on.

    A turning joint of axis s at o moves a point x with s x (x - o), and a vector u with s x u.
    """
    bodies, work, origin, arms = loops.bodies, loops.work, loops.origin, loops.arms
    for j in range(loops.joints.size):
        loops.joints[j] = loops.multiplier[j] * q[loops.leader[j]] + loops.offset[j]
    fill_frames(bodies, work, loops.joints, 0)
    rotation, axis = work.rotation, work.axis
    for i in range(1, bodies.parent.size):
        for c in range(3):
            origin[i, c] = origin[bodies.parent[i], c] + work.offset[i, c]
    for r in range(loops.turns.size):
        turns, value = loops.turns[r] == 1, 0.0
        for e in range(2):
            i = loops.ends[r, e]
            for c in range(3):
                arms[e, c] = 0.0 if turns else origin[i, c]
                for k in range(3):
                    arms[e, c] += rotation[i, 3 * c + k] * loops.vectors[r, e, k]
        for c in range(3):
            value += arms[0, c] * arms[1, c] if turns else \
                loops.normal[r, c] * (arms[1, c] - arms[0, c])
        defect[first + r] = value
        for e in range(2):
            i = loops.ends[r, e]
            while i > 0:
                # The change of g by a displacement w of the arm is f . w.
                slope = 0.0
                for c in range(3):
                    a, b = (c + 1) % 3, (c + 2) % 3
                    x, y = arms[e, a], arms[e, b]
                    f = arms[1 - e, c]
                    if not turns:
                        x, y = x - origin[i, a], y - origin[i, b]
                        f = loops.normal[r, c] if e == 1 else -loops.normal[r, c]
                        slope += f * axis[i, 3 + c]
                    slope += f * (axis[i, a] * y - axis[i, b] * x)
                j = bodies.coordinate[i]
                gradient[first + r, loops.leader[j]] += loops.multiplier[j] * slope
                i = bodies.parent[i]
