# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Priors of a mechanical network in torch: rigid bodies, planar links, and exact systems."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.learning.families.base import keep
from hnn_vi_ros.models import (
    EACH, exact_system, force_unit, functions_of, Identification, INERTIAL, is_spring, OFFSET,
    parameter_names, parameter_places, pseudo_inertia, Quantity, TreeCard, unit_terms)
import numpy as np
import torch

# Units of inertia for each unit of forces, and true for a link that slides.
_INERTIAS = {('N', True): 'kg', ('N', False): 'kg m', ('N m', True): 'kg m',
             ('N m', False): 'kg m2'}
# Smallest initial inertia of links, relative to that of the data, and largest initial coupling as
# a share of the largest possible one.
_LEAST, _MOST = 1e-3, 0.9
# Lower bound of exact systems' parameters, relative to their defaults.
_LEAST_SHARE = 1e-6


class PriorModule(torch.nn.Module):
    """
    Base class of M and V of a system with fitted parameters.

    ``names`` are its parameters; ``linear`` is True if M and V are linear in them.
    """

    names: list[str]
    linear = False
    # Identification result of a robot, once available.
    identification: Identification | None = None

    def mass(self, q: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        raise NotImplementedError

    def slopes(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (M v)' at constant v, and (v . M v)_q / 2 - V_q, shape (N, d) each."""
        raise NotImplementedError

    def forces(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return (M v)' at constant v - (v . M v)_q / 2 + V_q, shape (N, d)."""
        turned, slope = self.slopes(q, v, values)
        return turned - slope

    def needed(self, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor, values: torch.Tensor
               ) -> torch.Tensor:
        """Return the forces that cause accelerations a, shape (N, d)."""
        return (self.mass(q, values) @ a[:, :, None])[:, :, 0] + self.forces(q, v, values)

    def columns(self, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        """Return the forces per unit of each parameter, shape (N, d, k)."""
        return torch.stack([self.needed(q, v, a, unit) for unit in torch.eye(
            len(self.names), dtype=torch.float64)], dim=-1)


class PlanarChain(PriorModule):
    """
    Parameters of models/planar_chain.py, mapped from unknowns that keep M positive definite.

    The matrix K of inertias and couplings is u L L^T, with exp(x) on the diagonal of the lower
    triangular L; inertias of motors, gravities and springs are u x, with the unit u. M and V are
    linear in all but the offsets of sensors, around which q is measured.

    Parameters
    ----------
    angles : sequence of sequence of float
        Rows of the angles of the links from the vertical.
    inertia : float
        Unit u of the parameters.
    springs : int
        Highest power of the springs, 0 without them.
    offsets : bool
        True if the sensors of joints have offsets.
    knots : sequence of float
        Coordinates at which the stiffness of a spring changes.

    """

    linear = True

    def __init__(self, angles: Sequence[Sequence[float]], inertia: float, springs: int = 0,
                 offsets: bool = False, knots: Sequence[float] = ()):
        super().__init__()
        self._places = parameter_places(angles, springs, offsets, knots)
        self.names = parameter_names(angles, springs, offsets, knots)
        self.angles = [[*row] for row in angles]
        d = len(self.angles)
        # Counts of inertias, couplings, gravities, motor inertias, and all other numbers.
        self._sizes = [sum(name.startswith(kind) for name in self.names)
                       for kind in ('inertia', 'coupling', 'gravity', 'motor_inertia')]
        self._sizes.append(len(self.names) - sum(self._sizes))
        units = unit_terms(angles, springs, offsets, knots)
        zeros = np.zeros((len(self.names), d))
        for row, (kind, place) in zip(zeros, self._places, strict=True):
            row[place[0]] = kind == OFFSET
        matrices, weights, pulls, stiffness, powers, bends = (
            np.stack([getattr(unit, name) for unit in units])
            for name in ('matrices', 'weights', 'pull', 'stiffness', 'powers', 'bends'))
        self._springs = springs
        keep(self, mass_rows=units[0].mass_rows, matrices=matrices, rows=units[0].rows,
             offsets=zeros, weights=weights, pulls=pulls, stiffness=stiffness, powers=powers,
             knots=units[0].knots, bends=bends,
             lower=np.stack(np.triu_indices(d, 1)[::-1]), unit=np.array(inertia))
        self.raw = torch.nn.Parameter(torch.zeros(len(self.names), dtype=torch.float64))

    def values(self) -> torch.Tensor:
        """Return the parameters, shape (k,), in the order of their names."""
        diagonal, below, gravities, motors, springs = self.raw.split(self._sizes)
        L = self._matrix(torch.exp(diagonal), below, 0.0)
        K = L @ L.T
        return self.scale() * torch.cat([
            torch.diagonal(K), K[self.lower[0], self.lower[1]], gravities, motors, springs])

    def _matrix(self, diagonal: torch.Tensor, below: torch.Tensor, mirrored: float
                ) -> torch.Tensor:
        """Return a matrix from its diagonal and lower part; `mirrored` scales the upper part."""
        zero = torch.zeros((len(diagonal), len(diagonal)), dtype=diagonal.dtype)
        lower = zero.index_put((self.lower[0], self.lower[1]), below)
        return torch.diag(diagonal) + lower + mirrored * lower.T

    def scale(self) -> torch.Tensor:
        """Return the usual sizes of the parameters, shape (k,)."""
        return torch.where(self.offsets.any(dim=1), 1.0, self.unit)

    def quantities(self, p_units: Sequence[str]) -> dict[str, Quantity]:
        """Return the parameters with units, for momenta in these units and angles in rad."""
        forces, slides = [*map(force_unit, p_units)], [not any(row) for row in self.angles]
        found = {}
        for name, (kind, place), value in zip(
                self.names, self._places, self.values().tolist(), strict=True):
            # The force on the first link, and the second that moves.
            unit, slide = forces[place[0]], slides[place[-1]]
            if kind == OFFSET:
                unit = 'rad'
            elif unit != '1' and is_spring(kind) and kind != 'spring_force':
                unit += ('/m' if slide else '/rad') + (
                    kind[6:-1] if kind.startswith('spring') else '')
            elif unit != '1' and kind not in ('gravity', 'spring_force'):
                unit = _INERTIAS.get((unit, slide), f'{unit} s2' + ('/m' if slide else ''))
            found[name] = Quantity(value=value, unit=unit)
        return found

    def raw_of(self, values: torch.Tensor) -> torch.Tensor:
        """Return the raw parameters of values; NaN if M would not be positive definite."""
        inertias, couplings, gravities, motors, springs = (
            values / self.scale()).split(self._sizes)
        L, failed = torch.linalg.cholesky_ex(self._matrix(inertias, couplings, 1.0))
        found = torch.cat([torch.log(torch.diagonal(L)), L[self.lower[0], self.lower[1]],
                           gravities, motors, springs])
        return torch.where(failed > 0, torch.nan, found)

    def possible(self, values: torch.Tensor) -> torch.Tensor:
        """Return nearby values for which M is positive definite with a margin."""
        inertias, couplings, gravities, motors, springs = values.split(self._sizes)
        least = _LEAST * float(self.unit)
        inertias = inertias.clamp(min=least)
        root = inertias.sqrt()
        # Shrink the couplings until their correlations belong to a matrix K > 0.
        shares = couplings / (root[self.lower[0]] * root[self.lower[1]])
        depth = -torch.linalg.eigvalsh(self._matrix(torch.zeros_like(root), shares, 1.0))[0]
        couplings = couplings * min(1.0, _MOST / max(float(depth), _MOST))
        return torch.cat([inertias, couplings, gravities, motors.clamp(min=least), springs])

    def mass(self, q: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        d, q = q.shape[1], q - values @ self.offsets
        matrices = (values @ self.matrices.flatten(1)).reshape(-1, d * d)
        return (torch.cos(q @ self.mass_rows.T) @ matrices).reshape(-1, d, d)

    def slopes(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (M v)' at constant v, and (v . M v)_q / 2 - V_q, shape (N, d) each."""
        d, q = q.shape[1], q - values @ self.offsets
        rows = (values @ self.matrices.flatten(1)).reshape(-1, d)
        slope = -torch.sin(q @ self.mass_rows.T)
        products = (v @ rows.T).reshape(len(v), -1, d)
        turned = ((slope * (v @ self.mass_rows.T))[:, None, :] @ products)[:, 0]
        squares = (products @ v[:, :, None])[:, :, 0]
        weights = values @ self.weights
        return turned, (0.5 * (slope * squares) @ self.mass_rows
                        - (weights * torch.sin(q @ self.rows.T)) @ self.rows
                        - values @ self.pulls
                        - q @ (values @ self.stiffness.flatten(1)).reshape(-1, d)
                        - torch.relu(q[:, :1] - self.knots) @ (values @ self.bends)[:, None]
                        - sum((values @ self.powers[:, n] * q**(n + 2)
                               for n in range(self._springs - 1)), torch.zeros_like(q)))


class ExactPrior(PriorModule):
    """
    M and V of an exact system; see models/exact_prior.py.

    The parameters are their defaults times exp(x).

    Parameters
    ----------
    kind : str
        Name of the system in scenes.

    """

    def __init__(self, kind: str):
        super().__init__()
        self.system = exact_system(kind)
        self.names = [*self.system.defaults]
        # Functions of arrays, which take columns of tensors as well.
        functions: tuple[Any, ...] = functions_of(HAMILTONIANS[kind]().kernel)
        _, self._gradient, self._hessian_vector = functions
        keep(self, defaults=np.array([*self.system.defaults.values()], dtype=np.float64),
             identity=np.eye(self.system.dimension))
        self.raw = torch.nn.Parameter(torch.zeros(len(self.names), dtype=torch.float64))

    def values(self) -> torch.Tensor:
        """Return the parameters, shape (k,), in the order of their names."""
        return self.defaults * torch.exp(self.raw)

    def raw_of(self, values: torch.Tensor) -> torch.Tensor:
        """Return the raw parameters of given values."""
        return torch.log(torch.clamp(values / self.defaults, min=_LEAST_SHARE))

    def scale(self) -> torch.Tensor:
        """Return the usual sizes of the parameters, shape (k,)."""
        return self.defaults

    def quantities(self, p_units: Sequence[str]) -> dict[str, Quantity]:
        """Return the parameters in the units of the system."""
        return {name: Quantity(value=value, unit=f'that of {self.system.kind}')
                for name, value in zip(self.names, self.values().tolist(), strict=True)}

    def mass(self, q: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        columns = [self._slopes(q, unit.expand(q.shape), values)[1] for unit in self.identity]
        return torch.linalg.inv(torch.stack(columns, dim=2))

    def slopes(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (M v)' at constant v, and (v . M v)_q / 2 - V_q, shape (N, d) each."""
        mass = self.mass(q, values)
        momentum = (mass @ v[:, :, None])[:, :, 0]
        at_q, at_p = (_Columns([None] * q.shape[1]) for _ in range(2))
        self._hessian_vector(self._parameters_of(values), columns(q), columns(momentum),
                             columns(v), columns(torch.zeros_like(v)), at_q, at_p)
        turned = -(mass @ stacked(at_p, q)[:, :, None])[:, :, 0]
        return turned, -self._slopes(q, momentum, values)[0]

    def _slopes(self, q: torch.Tensor, p: torch.Tensor, values: torch.Tensor
                ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return H_q and H_p, shape (N, d) each."""
        dH_dq, dH_dp = (_Columns([None] * q.shape[1]) for _ in range(2))
        self._gradient(self._parameters_of(values), columns(q), columns(p), dH_dq, dH_dp)
        return stacked(dH_dq, q), stacked(dH_dp, q)

    def _parameters_of(self, values: torch.Tensor) -> tuple[Any, ...]:
        found = [*self.system.others]
        for place, value in zip(self.system.places, values, strict=True):
            found[place] = value.as_subclass(NumpyTensor)
        return tuple(found)


class _Columns(list[Any]):
    """Columns of all states at once, a substitute for the array (d,) of one state."""

    @property
    def size(self) -> int:
        """Return d."""
        return len(self)

    def __getitem__(self, place: Any) -> Any:
        """Return one column, or a slice of columns."""
        found = super().__getitem__(place)
        return _Columns(found) if isinstance(place, slice) else found


class NumpyTensor(torch.Tensor):
    """A tensor as an argument of functions of numbers that are written with numpy (NEP 13)."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any) -> Any:
        """Call the function of the same name in torch."""
        return getattr(torch, ufunc.__name__)(*inputs)


def columns(x: torch.Tensor) -> _Columns:
    """Return the columns of states, shape (N, d), for functions of kernels."""
    return _Columns(x.as_subclass(NumpyTensor).unbind(dim=1))


def stacked(found: Sequence[Any], like: torch.Tensor) -> torch.Tensor:
    """Return columns as one tensor; a column may be a single number."""
    zero = torch.zeros_like(like[:, 0])
    return torch.stack([zero + column for column in found], dim=1).as_subclass(torch.Tensor)


# Smallest initial mass as a share of the total, and smallest initial radius of gyration [m]:
# logarithms need positive values.
_LEAST_MASS, _LEAST_RADIUS = 1e-4, 0.01
# Indices of the moments about the origin: xx, xy, yy, xz, yz, zz.
_ROWS, _COLUMNS = np.tril_indices(3)


class Swept(NamedTuple):
    """
    Motions of a tree in N states, each body i in its own frame, as (angular, linear).

    Parameters
    ----------
    jacobian : torch.Tensor, shape (N, d, 6, d)
        Jacobians J_i of the body velocities V_i = J_i v.
    rate : torch.Tensor, shape (N, d, 6, d)
        Time derivatives dJ_i/dt.
    pull : torch.Tensor, shape (N, d, 6)
        Apparent acceleration of a body at rest: the reversed gravitational acceleration.

    """

    jacobian: torch.Tensor
    rate: torch.Tensor
    pull: torch.Tensor


class RigidTree(PriorModule):
    """
    M and V of a tree of bodies, with unknowns that keep all inertias physically consistent.

    The pseudo-inertia of a body is U0 U(x) U(x)^T U0^T, with U0 U0^T that of the URDF and

        U(x) = exp(x0) [[exp(x1), x4, x6, x7], [0, exp(x2), x5, x8], [0, 0, exp(x3), x9],
                        [0, 0, 0, 1]]

    with the log-Cholesky parameters x; x = 0 is the URDF, and x is independent of axes and units.
    With the velocities V_i = J_i v of the bodies and their inertias I_i,

        M = sum_i J_i^T I_i J_i
        (M v)' - (v . M v)_q / 2 = sum_i J_i^T (I_i J_i' v + V_i x* I_i V_i)

    Parameters
    ----------
    tree : TreeCard
        Bodies of the tree.
    values : np.ndarray, shape (d, 12)
        Parameters of the bodies in the URDF.

    References
    ----------
    C. Rucker, P. Wensing, Smooth Parameterization of Rigid-Body Inertia, IEEE Robotics and
    Automation Letters 7 (2022).
    R. Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 2 and 5.

    """

    def __init__(self, tree: TreeCard, values: np.ndarray):
        super().__init__()
        self.tree, self.names = tree, [*tree.units]
        d = len(tree.bodies)
        least = _LEAST_MASS * max(values[:, 0].sum(), 1e-3)
        roots = [_root(pseudo_inertia(row[:INERTIAL]), least) for row in values]
        axes = np.zeros((d, 6))
        for row, body in zip(axes, tree.bodies, strict=True):
            row[3 * body.prismatic:][:3] = body.axis
        keep(self, root=np.stack(roots), axes=axes, gravity=np.array(tree.gravity),
             turns=np.array([body.rotation for body in tree.bodies]),
             origins=np.array([body.origin for body in tree.bodies]),
             across=np.stack([_across(axis) for axis in axes[:, :3]]),
             motions=np.stack([_cross_motion(axis) for axis in axes]), units=_units())
        self.raw = torch.nn.Parameter(torch.zeros((d, INERTIAL), dtype=torch.float64))
        self.rotor = torch.nn.Parameter(torch.tensor(values[:, INERTIAL]))
        self.offset = torch.nn.Parameter(torch.zeros(d, dtype=torch.float64))

    def values(self) -> torch.Tensor:
        """Return the parameters of all bodies, shape (12 d,), in the order of their names."""
        return torch.cat([self.inertial(self.raw), self.rotor[:, None], self.offset[:, None]],
                         dim=1).flatten()

    def inertial(self, x: torch.Tensor) -> torch.Tensor:
        """Return (m, h, I) of the bodies from log-Cholesky parameters x, shape (d, 10) each."""
        zero, one = torch.zeros_like(x[:, 0]), torch.ones_like(x[:, 0])
        a, b, c = torch.exp(x[:, 1:4]).unbind(dim=1)
        rows = ((a, x[:, 4], x[:, 6], x[:, 7]), (zero, b, x[:, 5], x[:, 8]),
                (zero, zero, c, x[:, 9]), (zero, zero, zero, one))
        U = self.root @ torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
        U = U * torch.exp(x[:, 0])[:, None, None]
        moments = U @ U.transpose(1, 2)
        second = moments[:, :3, :3]
        trace = torch.diagonal(second, dim1=1, dim2=2).sum(dim=1)
        about = trace[:, None, None] * torch.eye(3, dtype=x.dtype) - second
        return torch.cat([moments[:, 3, 3, None], moments[:, :3, 3],
                          about[:, _ROWS, _COLUMNS]], dim=1)

    def quantities(self, p_units: Sequence[str]) -> dict[str, Quantity]:
        """Return the parameters with their SI units."""
        return {name: Quantity(value=value, unit=unit) for (name, unit), value in zip(
            self.tree.units.items(), self.values().tolist(), strict=True)}

    def sweep(self, q: torch.Tensor, v: torch.Tensor) -> Swept:
        """Return the motions of all bodies in states (N, d), from the base outward."""
        n, d = q.shape
        none = torch.zeros((n, 6, d), dtype=q.dtype)
        at_base = none, none, -self.gravity.expand(n, 3)
        reached: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []
        for i, body in enumerate(self.tree.bodies):
            J, J_dot, pull = reached[body.parent - 1] if body.parent else at_base
            value, speed = q[:, body.coordinate], v[:, body.coordinate]
            turn, origin = self._joint(i, value)
            own = torch.zeros((6, d), dtype=q.dtype)
            own[:, body.coordinate] = self.axes[i]
            J = _seen_from(turn, origin, J)
            J_dot = _seen_from(turn, origin, J_dot)
            J_dot = J_dot - speed[:, None, None] * (self.motions[i] @ J)
            reached.append((J + own, J_dot, (turn.transpose(1, 2) @ pull[:, :, None])[:, :, 0]))
        jacobians, rates, pulls = zip(*reached, strict=True)
        pull = torch.stack(pulls, dim=1)
        return Swept(torch.stack(jacobians, dim=1), torch.stack(rates, dim=1),
                     torch.cat([torch.zeros_like(pull), pull], dim=2))

    def _joint(self, i: int, value: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return rotation (N, 3, 3) and origin (N, 3) of a link in its parent's frame."""
        turn, origin = self.turns[i].expand(len(value), 3, 3), self.origins[i]
        if self.tree.bodies[i].prismatic:
            return turn, origin + value[:, None] * (self.turns[i] @ self.axes[i, 3:])
        across, angle = self.across[i], value[:, None, None]
        about = (torch.eye(3, dtype=value.dtype) + torch.sin(angle) * across
                 + (1.0 - torch.cos(angle)) * (across @ across))
        return turn @ about, origin.expand(len(value), 3)

    def _inertias(self, values: torch.Tensor) -> torch.Tensor:
        """Return the inertias I_i of all bodies, shape (d, 6, 6), from all parameters."""
        return (values.reshape(-1, EACH)[:, :INERTIAL] @ self.units.flatten(1)).reshape(-1, 6, 6)

    def _by_joint(self, values: torch.Tensor, column: int) -> torch.Tensor:
        """Return one parameter of the joints, shape (d,), in the order of the coordinates."""
        order = torch.argsort(torch.tensor([body.coordinate for body in self.tree.bodies]))
        return values.reshape(-1, EACH)[order, INERTIAL + column]

    def mass(self, q: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        J = self.sweep(q, torch.zeros_like(q)).jacobian
        return ((J.transpose(2, 3) @ self._inertias(values) @ J).sum(dim=1)
                + torch.diag(self._by_joint(values, 0)))

    def slopes(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (M v)' at constant v, and (v . M v)_q / 2 - V_q, shape (N, d) each."""
        swept, inertias = self.sweep(q, v), self._inertias(values)
        motion = swept.jacobian @ v[:, None, :, None]
        momentum = inertias @ motion
        drift = inertias @ (swept.rate @ v[:, None, :, None])
        turned = (swept.rate.transpose(2, 3) @ momentum
                  + swept.jacobian.transpose(2, 3) @ drift).sum(dim=1)[:, :, 0]
        held = _cross_force(motion[..., 0], momentum[..., 0]) + (
            inertias @ swept.pull[..., None])[..., 0]
        slope = (swept.rate.transpose(2, 3) @ momentum
                 - swept.jacobian.transpose(2, 3) @ held[..., None]).sum(dim=1)[:, :, 0]
        return turned, slope - self._by_joint(values, 1)

    def columns(self, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        """Return the forces per unit of each parameter, shape (N, d, 12 d)."""
        swept = self.sweep(q, v)
        motion = (swept.jacobian @ v[:, None, :, None])[..., 0]
        change = (swept.jacobian @ a[:, None, :, None]
                  + swept.rate @ v[:, None, :, None])[..., 0] + swept.pull
        momenta = torch.einsum('kab,nib->nika', self.units, motion)
        forces = torch.einsum('kab,nib->nika', self.units, change) + _cross_force(
            motion[:, :, None, :].expand_as(momenta), momenta)
        found = torch.einsum('niaj,nika->njik', swept.jacobian, forces)
        n, d = q.shape
        place = torch.zeros((d, d), dtype=q.dtype)
        for i, body in enumerate(self.tree.bodies):
            place[body.coordinate, i] = 1.0
        rotors = (a[:, :, None] * place)[..., None]
        offsets = place.expand(n, d, d)[..., None]
        return torch.cat([found, rotors, offsets], dim=3).flatten(2)


def _root(moments: np.ndarray, least: float) -> np.ndarray:
    """Return the upper triangular U0 with U0 U0^T a pseudo-inertia, bounded from below."""
    scale = np.sqrt(np.array([*3 * (_LEAST_RADIUS**2 * least,), least]))
    values, vectors = np.linalg.eigh(moments / scale / scale[:, None])
    if values[0] < 1.0:
        moments = scale[:, None] * (vectors * np.maximum(values, 1.0)) @ vectors.T * scale
    return np.linalg.cholesky(moments[::-1, ::-1])[::-1, ::-1].copy()


def _units() -> np.ndarray:
    """Return the inertias per unit of each parameter, shape (10, 6, 6)."""
    found = np.zeros((INERTIAL, 6, 6))
    found[0, 3:, 3:] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        found[1 + k, :3, 3:], found[1 + k, 3:, :3] = _across(axis), -_across(axis)
    for k, (i, j) in enumerate(zip(_ROWS, _COLUMNS, strict=True)):
        found[4 + k, i, j] = found[4 + k, j, i] = 1.0
    return found


def _across(a: np.ndarray) -> np.ndarray:
    """Return the matrix of the cross product with a."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _seen_from(turn: torch.Tensor, origin: torch.Tensor, motions: torch.Tensor) -> torch.Tensor:
    """Return motions of the parent, shape (N, 6, d), expressed in the link frame."""
    angular, linear = motions[:, :3], motions[:, 3:]
    moved = linear + torch.linalg.cross(angular, origin[:, :, None].expand_as(angular), dim=1)
    back = turn.transpose(1, 2)
    return torch.cat([back @ angular, back @ moved], dim=1)


def _cross_motion(axis: np.ndarray) -> np.ndarray:
    """Return the 6 x 6 motion cross-product matrix of an axis."""
    angular, linear = _across(axis[:3]), _across(axis[3:])
    return np.block([[angular, np.zeros((3, 3))], [linear, angular]])


def _cross_force(motion: torch.Tensor, force: torch.Tensor) -> torch.Tensor:
    """Return the spatial cross products of motions with forces, shape (..., 6)."""
    turn, slide, moment, push = motion[..., :3], motion[..., 3:], force[..., :3], force[..., 3:]
    return torch.cat([torch.linalg.cross(turn, moment) + torch.linalg.cross(slide, push),
                      torch.linalg.cross(turn, push)], dim=-1)
