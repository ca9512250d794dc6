# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Costs of states and commands, with gradients and Gauss-Newton Hessians.

They can be added and scaled: ``20.0 * Point(...).saturating(0.1) + Quadratic(...)``.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.errors import listed, UnsupportedSystem
from hnn_vi_ros.hamiltonians import (
    Bodies, fill_frames, frame_of, Hamiltonian, Joint, RIGID, SLIDING, TreeWork)
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.phase_space import angle_columns
import numpy as np
from numpy.typing import ArrayLike


class Expansion(NamedTuple):
    """
    Second-order expansion of a cost at n states and commands.

    Parameters
    ----------
    value : np.ndarray, shape (n,)
        Value of the cost.
    by_z, by_u : np.ndarray, shape (n, 2 d) and (n, c)
        Gradient.
    by_zz, by_uu : np.ndarray, shape (n, 2 d, 2 d) and (n, c, c)
        Positive semidefinite Gauss-Newton Hessian.

    """

    value: np.ndarray
    by_z: np.ndarray
    by_u: np.ndarray
    by_zz: np.ndarray
    by_uu: np.ndarray


class Cost(ABC):
    """A cost l(z, u) >= 0 of a state z = (q, p) and a command u."""

    @abstractmethod
    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the cost, shape (...), for z (..., 2 d) and u (..., c)."""

    @abstractmethod
    def expand(self, z: np.ndarray, u: np.ndarray) -> Expansion:
        """Return the expansion for z (n, 2 d) and u (n, c)."""

    def __add__(self, other: 'Cost') -> 'Cost':
        return Sum((self, other))

    def __rmul__(self, weight: float) -> 'Cost':
        if not weight >= 0.0:
            raise ValueError(f'the weight of a cost must be >= 0, not {weight}')
        return Scaled(self, float(weight))

    def saturating(self, half: float) -> 'Cost':
        """Return l / (l + half), which is bounded by 1, so that distant states do not dominate."""
        if not half > 0.0:
            raise ValueError(f'half = {half} must be positive: the cost that saturates to 1/2')
        return Saturating(self, float(half))


class Sum(Cost):
    """The sum of costs."""

    def __init__(self, parts: Sequence[Cost]):
        self._parts = tuple(parts)

    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        first, *others = (part.value(z, u) for part in self._parts)
        return sum(others, first)

    def expand(self, z: np.ndarray, u: np.ndarray) -> Expansion:
        first, *others = (part.expand(z, u) for part in self._parts)
        for other in others:
            first = Expansion(*(a + b for a, b in zip(first, other, strict=True)))
        return first


class Scaled(Cost):
    """A cost times a weight."""

    def __init__(self, cost: Cost, weight: float):
        self._cost, self._weight = cost, weight

    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return self._weight * self._cost.value(z, u)

    def expand(self, z: np.ndarray, u: np.ndarray) -> Expansion:
        return Expansion(*(self._weight * part for part in self._cost.expand(z, u)))


class Saturating(Cost):
    """The bounded cost l / (l + half) of a cost l."""

    def __init__(self, cost: Cost, half: float):
        self._cost, self._half = cost, half

    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        value = self._cost.value(z, u)
        return value / (value + self._half)

    def expand(self, z: np.ndarray, u: np.ndarray) -> Expansion:
        """Return the expansion; its Hessian omits the negative part."""
        value, *others = self._cost.expand(z, u)
        slope = self._half / (value + self._half)**2
        vectors, matrices = slope[:, None], slope[:, None, None]
        return Expansion(value / (value + self._half), vectors * others[0], vectors * others[1],
                         matrices * others[2], matrices * others[3])


def deviation(hamiltonian: Hamiltonian, z: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return z - at, shape (..., 2 d), with angles wrapped to [-pi, pi]."""
    x = z - at
    for k in np.flatnonzero(angle_columns(hamiltonian.coordinates)):
        x[..., k] = (x[..., k] + np.pi) % (2.0 * np.pi) - np.pi
    return x


class Quadratic(Cost):
    """
    x . Q x + (u - u*) . R (u - u*) with x = z - z*, angles wrapped to [-pi, pi].

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of the states; ``BatchStep.hamiltonian``.
    at : tuple of array_like, shape (2 d,) and (c,)
        z* and u*; see ``find_equilibrium``.
    q, r : array_like, shape (2 d, 2 d) and (c, c)
        Q and R, symmetric and positive semidefinite.

    """

    def __init__(self, hamiltonian: Hamiltonian, at: tuple[ArrayLike, ArrayLike], q: ArrayLike,
                 r: ArrayLike):
        self._hamiltonian = hamiltonian
        self._z, self._u = (np.array(part, dtype=np.float64) for part in at)
        self._q, self._r = (weight_matrix(name, matrix, at.size) for name, matrix, at in (
            ('q', q, self._z), ('r', r, self._u)))
        self._of_state = bool(self._q.any())

    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        x, effort = self._away(z), u - self._u
        return ((x @ self._q) * x).sum(axis=-1) + ((effort @ self._r) * effort).sum(axis=-1)

    def _away(self, z: np.ndarray) -> np.ndarray:
        """Return z - z*, or z if it has no weight."""
        return deviation(self._hamiltonian, z, self._z) if self._of_state else z

    def expand(self, z: np.ndarray, u: np.ndarray) -> Expansion:
        x, effort = self._away(z), u - self._u
        by_x, by_u = x @ self._q, effort @ self._r
        return Expansion((by_x * x).sum(axis=-1) + (by_u * effort).sum(axis=-1), 2.0 * by_x,
                         2.0 * by_u, _per_state(2.0 * self._q, z), _per_state(2.0 * self._r, z))


def weight_matrix(name: str, matrix: ArrayLike, n: int, positive: bool = False) -> np.ndarray:
    """Return a symmetric positive semidefinite matrix of weights, or raise ValueError."""
    found = np.array(matrix, dtype=np.float64)
    rounding = 1e-9 * np.abs(found).max(initial=0.0)
    if found.shape != (n, n) or not np.isfinite(found).all() \
            or np.abs(found - found.T).max(initial=0.0) > rounding \
            or np.linalg.eigvalsh(found).min(initial=np.inf) < -rounding \
            or (positive and np.linalg.eigvalsh(found).min(initial=np.inf) <= 0.0):
        kind = 'with positive' if positive else 'without negative'
        raise ValueError(f'{name} must be a symmetric matrix {kind} eigenvalues, of shape ({n}, '
                         f'{n})')
    return found


def _per_state(matrix: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.broadcast_to(matrix, (len(z), *matrix.shape))


class _OfState(Cost):
    """A cost that depends only on the state."""

    @abstractmethod
    def _expand(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the value, the gradient and the Hessian with respect to z."""

    def expand(self, z: np.ndarray, u: np.ndarray) -> Expansion:
        value, by_z, by_zz = self._expand(*np.split(z, 2, axis=-1))
        n, c = u.shape
        return Expansion(value, by_z, np.zeros((n, c)), by_zz, np.zeros((n, c, c)))


class Energy(_OfState):
    """
    (H - H*)^2.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H; ``BatchStep.hamiltonian``.
    at : array_like, shape (2 d,)
        State with the desired energy H*.

    """

    def __init__(self, hamiltonian: Hamiltonian, at: ArrayLike):
        self._hamiltonian = hamiltonian
        q, p = np.split(np.array(at, dtype=np.float64), 2)
        self._energy = float(hamiltonian.energy(q, p))

    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return (self._hamiltonian.energy(*np.split(z, 2, axis=-1)) - self._energy)**2

    def _expand(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        excess = self._hamiltonian.energy(q, p) - self._energy
        slope = np.concatenate(self._hamiltonian.gradient(q, p), axis=-1)
        return (excess**2, 2.0 * excess[:, None] * slope,
                2.0 * slope[:, :, None] * slope[:, None, :])


class Kinetic(_OfState):
    """
    The kinetic energy H(q, p) - H(q, 0); its Hessian is only H_pp, the inverse mass matrix.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H; ``BatchStep.hamiltonian``.

    """

    def __init__(self, hamiltonian: Hamiltonian):
        self._hamiltonian = hamiltonian

    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        moving, rest = self._hamiltonian.energy(*_with_states_at_rest(*np.split(z, 2, axis=-1)))
        return moving - rest

    def _expand(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        model, (n, d) = self._hamiltonian, q.shape
        both = _with_states_at_rest(q, p)
        by_zz = np.zeros((n, 2 * d, 2 * d))
        by_zz[:, d:, d:] = model.inverse_mass(q, p)
        moving, rest = model.energy(*both)
        slopes = (moved - kept for moved, kept in model.gradient(*both))
        return moving - rest, np.concatenate(list(slopes), axis=-1), by_zz


def _with_states_at_rest(q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return states, followed by the same states at rest."""
    return np.stack([q, q]), np.stack([p, np.zeros_like(p)])


class _Path(NamedTuple):
    """
    Moving joints from the base to a body, and a point of the body.

    Parameters
    ----------
    bodies : Bodies
        A chain of k bodies without inertia, one behind each joint.
    work : TreeWork
        Its workspace; like a kernel, a path is for one thread at a time.
    by_q : np.ndarray, shape (k, d)
        Derivative of each joint's coordinate with respect to the system's.
    fixed : np.ndarray, shape (k,)
        Constant offset of each joint's coordinate.
    end : np.ndarray, shape (3,)
        Point in the frame of the last body [m].

    """

    bodies: Bodies
    work: TreeWork
    by_q: np.ndarray
    fixed: np.ndarray
    end: np.ndarray

    @classmethod
    def of(cls, joints: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, bool]],
           by_q: np.ndarray, fixed: np.ndarray, end: np.ndarray) -> '_Path':
        """Return a path; each joint has a rotation and origin, an axis, and True if it slides."""
        placement = [np.zeros(12)]
        frame = np.eye(3)
        for rotation, origin, axis, _ in joints:
            # The frame of a body has the axis of its joint as z.
            own = frame_of(axis)
            placement.append(np.hstack([(frame.T @ rotation @ own).ravel(), frame.T @ origin]))
            frame = own
        rows = np.maximum(np.arange(len(joints) + 1) - 1, 0)
        slides = np.array([0, *(int(joint[3]) for joint in joints)])
        return cls(Bodies(rows, rows, slides, np.array(placement), np.zeros((rows.size, 10)),
                          np.zeros(rows.size), np.zeros(3), np.zeros(rows.size)),
                   TreeWork.empty(len(joints)), by_q, fixed, frame.T @ end)


@kept(error_model='numpy')
def _fill_positions(path: _Path, angles: np.ndarray, places: np.ndarray, slopes: np.ndarray
                    ) -> None:
    """
    Fill the position of the point, (n, 3), for joint coordinates (n, k).

    Also fill its derivatives with respect to them, (n, 3, k), unless that array is empty.
    """
    work, end, count = path.work, path.end, path.bodies.parent.size
    axis, rotation, origin = work.axis, work.rotation, np.zeros((count, 3))
    for m in range(len(angles)):
        fill_frames(path.bodies, work, angles[m], 0)
        for i in range(1, count):
            for k in range(3):
                origin[i, k] = origin[i - 1, k] + work.offset[i, k]
        for k in range(3):
            places[m, k] = origin[-1, k] + rotation[-1, 3 * k] * end[0] \
                + rotation[-1, 3 * k + 1] * end[1] + rotation[-1, 3 * k + 2] * end[2]
        for i in range(1, count if slopes.size else 0):
            a, b, c = axis[i, 0], axis[i, 1], axis[i, 2]
            x, y, z = (places[m, 0] - origin[i, 0], places[m, 1] - origin[i, 1],
                       places[m, 2] - origin[i, 2])
            slopes[m, 0, i - 1] = axis[i, 3] + b * z - c * y
            slopes[m, 1, i - 1] = axis[i, 4] + c * x - a * z
            slopes[m, 2, i - 1] = axis[i, 5] + a * y - b * x


class Point(_OfState):
    """
    The squared distance of a point of a mechanism from its goal, divided by a length squared.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of a robot from a URDF; ``BatchStep.hamiltonian``.
    link : str
        Link to which the point is fixed.
    goal : array_like, shape (3,)
        Goal in the frame of the URDF's root [m].
    offset : array_like, shape (3,), optional
        Point in the frame of the link [m].
    length : float, optional
        Distance at which the cost is 1 [m].

    Raises
    ------
    ValueError
        The robot has no link of this name; the message lists its links.
    UnsupportedSystem
        The mechanism has no URDF; see ``chain``.

    """

    def __init__(self, hamiltonian: Hamiltonian, link: str, goal: ArrayLike,
                 offset: ArrayLike = (0.0, 0.0, 0.0), length: float = 1.0):
        self._prepare(_path_to(hamiltonian, link, offset), goal, length)

    @classmethod
    def chain(cls, lengths: Sequence[float], goal: ArrayLike, length: float | None = None,
              relative: bool = False) -> 'Point':
        """
        Return the cost of the tip of a chain of rods that hangs from the origin and turns about y.

        Parameters
        ----------
        lengths : sequence of float
            Lengths of the rods [m]; the first coordinates are their angles.
        goal : array_like, shape (3,)
            Goal of the tip [m]; (0, 0, sum of the lengths) is upright.
        length : float, optional
            See Point; by default the sum of the lengths.
        relative : bool, optional
            True if each angle is relative to the previous rod, False if relative to the vertical.

        """
        k, point = len(lengths), cls.__new__(cls)
        by_q = np.eye(k) if relative else np.eye(k) - np.eye(k, k=-1)
        origins = np.zeros((k, 3))
        origins[1:, 2] = -np.asarray(lengths)[:-1]
        # Positive angles move a hanging rod towards x.
        axis, end = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -lengths[-1]])
        point._prepare(_Path.of([(np.eye(3), origin, axis, False) for origin in origins],
                                by_q, np.zeros(k), end), goal, length or float(sum(lengths)))
        return point

    def _prepare(self, path: _Path, goal: ArrayLike, length: float) -> None:
        self._path, self._goal = path, np.array(goal, dtype=np.float64)
        if self._goal.shape != (3,) or not length > 0.0:
            raise ValueError(f'goal = {self._goal.tolist()} must be three numbers [m], and '
                             f'length = {length} positive')
        self._length = float(length)

    def place(self, q: np.ndarray) -> np.ndarray:
        """Return the position of the point [m], shape (..., 3), for q (..., d)."""
        return self._placed(np.asarray(q, dtype=np.float64), 0)[0]

    def _placed(self, q: np.ndarray, derivatives: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions, and for derivatives=1 their joint derivatives, (n, 3, k)."""
        joints, moves = self._path.by_q.shape
        angles = (q[..., :moves] @ self._path.by_q.T + self._path.fixed).reshape(-1, joints)
        places = np.empty((len(angles), 3))
        slopes = np.empty((derivatives * len(angles), 3, joints))
        _fill_positions(self._path, angles, places, slopes)
        return places.reshape(*q.shape[:-1], 3), slopes

    def value(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        away = (self.place(z[..., :z.shape[-1] // 2]) - self._goal) / self._length
        return (away**2).sum(axis=-1)

    def _expand(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        places, slopes = self._placed(q, 1)
        away = (places - self._goal) / self._length
        jacobian = slopes @ self._path.by_q / self._length
        n, d = q.shape
        moves = jacobian.shape[2]
        by_z, by_zz = np.zeros((n, 2 * d)), np.zeros((n, 2 * d, 2 * d))
        by_z[:, :moves] = 2.0 * (away[:, None] @ jacobian)[:, 0]
        by_zz[:, :moves, :moves] = 2.0 * jacobian.swapaxes(1, 2) @ jacobian
        return (away**2).sum(axis=-1), by_z, by_zz


def _path_to(hamiltonian: Hamiltonian, link: str, offset: ArrayLike) -> _Path:
    """Return the joints of a robot from its root to a link; raise if they cannot be found."""
    robot = hamiltonian.robot
    if robot is None:
        raise UnsupportedSystem('this mechanism has no URDF, so its points are unknown; use '
                                'Point.chain for rods')
    if link not in robot.links:
        raise ValueError(f'the robot has no link {link!r}; it has {listed(robot.links)}')
    carried = {joint.child: joint for joint in robot.joints.values()}
    joints: list[Joint] = []
    at = link
    while at != robot.root:
        joints.insert(0, carried[at])
        at = carried[at].parent
    rotation, origin = np.eye(3), np.zeros(3)
    moving, names = [], []
    for joint in joints:
        origin, rotation = origin + rotation @ joint.origin, rotation @ joint.rotation
        if joint.kind != RIGID:
            moving.append((rotation, origin, joint.axis, joint.kind == SLIDING))
            names.append(joint.name)
            rotation, origin = np.eye(3), np.zeros(3)
    by_q, fixed = robot.driven(names, [one.name for one in hamiltonian.coordinates])
    return _Path.of(moving, by_q, fixed, origin + rotation @ np.array(offset, dtype=np.float64))
