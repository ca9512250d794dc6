# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Shared helpers of tests: table of methods, exact motions, derivatives of steps."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.util import find_spec
from math import comb
import os
from pathlib import Path
from typing import Any

from benchmarks import systems
from hnn_vi_ros.effects import Effect, EFFECTS
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import (
    copy_point, Gauss, Integrator, INTEGRATORS, OK, PhasePoint, solvers, Tableau)
from hnn_vi_ros.integrators.gauss import in_fours
from hnn_vi_ros.integrators.lie.equations import LieOptions
from hnn_vi_ros.integrators.lie.lie_gauss import LieGauss
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import (
    Alarm, BlockGuard, InitialValueProblem, judge_block, Observed, SampleBuffer, Simulation)
from mpmath import mp, mpf
import numpy as np
from numpy.typing import ArrayLike
import pytest
from scipy.integrate import solve_ivp
import torch

EPS = np.finfo(np.float64).eps
DIGITS = 60
# A network of given widths with random weights.
random_checkpoint = systems.random_checkpoint


def long(*values: Any) -> Any:
    """Return a test parameter that only `make test-long` runs."""
    return pytest.param(*values, marks=pytest.mark.long)


def mostly_long(values: Iterable[Any], *kept: str) -> list[Any]:
    """Return parameters with their str() as ids; `make test` runs only the kept ones."""
    return [pytest.param(value, id=str(value),
                         marks=() if str(value) in kept else pytest.mark.long)
            for value in values]


def alarm_of(guard: BlockGuard, sample: Observed) -> Alarm | None:
    """Return the alarm of a guard at the next sample, or None."""
    waiting = SampleBuffer(1)
    waiting.add(sample)
    return next(iter(judge_block([guard], waiting.block())), None)


def identity(hamiltonian: Hamiltonian, h: float, z: np.ndarray) -> np.ndarray:
    """Return z: the chart of methods that are symplectic in (q, p) themselves."""
    return z


def staggered(hamiltonian: Hamiltonian, h: float, z: np.ndarray) -> np.ndarray:
    """Map (q, p) to (q, p + h H_q(q, p)); the second half is the momentum one step earlier."""
    d = z.size // 2
    dH_dq, _ = python_gradient(hamiltonian, z)
    return np.concatenate([z[:d], z[d:] + h * dH_dq])


def rectangle_lagrangian(q0: torch.Tensor, q1: torch.Tensor, h: float) -> torch.Tensor:
    """Return the rectangle rule for the action of the pendulum; section 2 of the paper."""
    velocity = (q1 - q0) / h
    return h * (0.5 * velocity.square() - 9.81 * (1.0 - torch.cos(q0))).sum()


def midpoint_lagrangian(q0: torch.Tensor, q1: torch.Tensor, h: float) -> torch.Tensor:
    """Return the midpoint rule for the action of the pendulum."""
    velocity, middle = (q1 - q0) / h, 0.5 * (q0 + q1)
    return h * (0.5 * velocity.square() - 9.81 * (1.0 - torch.cos(middle))).sum()


def difference(function: Callable[[float], Any], spacing: float) -> Any:
    """Return f'(0) by a central difference of order 6."""
    return sum(weight * (function(k * spacing) - function(-k * spacing))
               for k, weight in ((1, 45.0), (2, -9.0), (3, 1.0))) / (60.0 * spacing)


def assert_derivatives_of_energy(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray,
                                 tolerance: float) -> None:
    """Compare gradient and Hessian products at states, shapes (n, k), with differences."""
    rng = np.random.default_rng(8)
    for _ in range(3):
        v_q, v_p = rng.normal(size=q.shape), rng.normal(size=p.shape)
        H_q, H_p = hamiltonian.gradient(q, p)
        slope = difference(lambda s: hamiltonian.energy(q + s * v_q, p + s * v_p), 1e-4)
        assert (H_q * v_q).sum(axis=1) + (H_p * v_p).sum(axis=1) == pytest.approx(
            slope, abs=tolerance)
        slopes = difference(
            lambda s: np.hstack(hamiltonian.gradient(q + s * v_q, p + s * v_p)), 1e-4)
        assert np.hstack(hamiltonian.hessian_vector(q, p, v_q, v_p)) == pytest.approx(
            slopes, abs=tolerance)


def dop853_path(hamiltonian: Hamiltonian, q: ArrayLike, p: ArrayLike, times: np.ndarray,
                rtol: float = 1e-8, atol: float = 1e-8) -> np.ndarray:
    """Return (q, p) at times from 0 on, shape (n, 2 d), of a solution by scipy."""
    def field(t: float, z: np.ndarray) -> np.ndarray:
        dH_dq, dH_dp = hamiltonian.gradient(*np.split(z, 2))
        return np.concatenate([dH_dp, -dH_dq])

    found = solve_ivp(field, (0.0, times[-1]), [*np.ravel(q), *np.ravel(p)], 'DOP853', times,
                      rtol=rtol, atol=atol)
    assert found.success
    return found.y.T


def kepler_lagrangian(q0: torch.Tensor, q1: torch.Tensor, h: float) -> torch.Tensor:
    """Return the midpoint rule for the action of a Kepler orbit."""
    velocity, middle = (q1 - q0) / h, 0.5 * (q0 + q1)
    return h * (0.5 * velocity.square().sum() + 1.0 / middle.square().sum().sqrt())


def kepler_orbit(t: np.ndarray, e: float) -> tuple[np.ndarray, np.ndarray]:
    """Return q and p, shape (k, 2), on the orbit with a = mu = 1 at times since pericentre."""
    # Solve Kepler's equation E - e sin E = t with Newton's method, started above the root: all
    # steps then have the same sign, up to rounding at the end.
    turns = np.round(t / (2.0 * np.pi))
    time = t - 2.0 * np.pi * turns
    anomaly = np.sign(time) * np.minimum(np.abs(time) + e, np.pi)
    for _ in range(60):
        anomaly -= (anomaly - e * np.sin(anomaly) - time) / (1.0 - e * np.cos(anomaly))
    c, s, minor = np.cos(anomaly), np.sin(anomaly), np.sqrt(1.0 - e * e)
    r = (1.0 - e * c)[:, None]
    return np.stack([c - e, minor * s], axis=1), np.stack([-s, minor * c], axis=1) / r


def exact_pendulum(q0: float, p0: float, t: float) -> tuple[float, float]:
    """Return (q, p) of the pendulum (1 kg, 1 m, 9.81 m/s2) from theta functions with 40 digits."""
    mp.dps = 40
    omega = mp.sqrt(mpf(9.81))
    m = mp.sin(mpf(q0) / 2) ** 2 + (mpf(p0) / (2 * omega)) ** 2
    if m < 1:
        k = mp.sqrt(m)
        phi = mp.atan2(mp.sin(mpf(q0) / 2), mpf(p0) / (2 * omega))
        u = omega * t + mp.ellipf(phi, m)
        q = 2 * mp.asin(k * mp.ellipfun('sn', u, m=m))
        return float(q), float(2 * omega * k * mp.ellipfun('cn', u, m=m))
    # Rotation: the angle follows from its sine and cosine and the number of turns.
    k, n = mp.sqrt(m), 1 / m
    u = k * omega * t + mp.ellipf(mpf(q0) / 2, n)
    turns = mp.floor((u + mp.ellipk(n)) / (2 * mp.ellipk(n)))
    rest = u - 2 * turns * mp.ellipk(n)
    q = 2 * (mp.asin(mp.ellipfun('sn', rest, m=n)) + turns * mp.pi)
    return float(q), float(2 * omega * k * mp.ellipfun('dn', rest, m=n))


def exact_orbit(e: float, t: float) -> np.ndarray:
    """Return (x, y, p_x, p_y) on the ellipse with a = 1, mu = 1, from its apocentre on -x."""
    mp.dps = 40
    mean = mpf(t) + mp.pi
    anomaly = mp.findroot(lambda E: E - e * mp.sin(E) - mean, mean)
    r, side = 1 - e * mp.cos(anomaly), mp.sqrt(1 - mpf(e) ** 2)
    return np.array([mp.cos(anomaly) - e, side * mp.sin(anomaly),
                     -mp.sin(anomaly) / r, side * mp.cos(anomaly) / r], dtype=float)


@dataclass(frozen=True)
class Method:
    """
    One row of the table: a method, with the information that the tests need.

    Parameters
    ----------
    name : str
        Name in INTEGRATORS.
    chart : callable or None
        Map of (q, p) under which the method becomes symplectic; None if it is not.
    system : str
        A nonlinear Hamiltonian that the method accepts.
    arguments : tuple
        Arguments of the Hamiltonian.
    steps : int
        Number of steps of the coarsest run in the test of its order.

    """

    name: str
    chart: Callable | None
    system: str = 'tao'
    arguments: tuple = ()
    steps: int = 100

    def __str__(self) -> str:
        """Return the name."""
        return self.name

    @property
    def integrator(self) -> Integrator:
        """Return the integrator."""
        return INTEGRATORS[self.name](*self.arguments)

    @property
    def hamiltonian(self) -> Hamiltonian:
        """Return a Hamiltonian that the method accepts."""
        return HAMILTONIANS[self.system]()


METHODS = [
    Method('variational_euler', staggered, steps=400),
    Method('symplectic_euler', identity, steps=400),
    Method('symplectic_euler_adjoint', identity, steps=400),
    Method('generalized_leapfrog', identity),
    Method('stormer_verlet', identity, 'pendulum'),
    Method('implicit_midpoint', identity),
    Method('gauss4', identity, steps=40),
    Method('gauss6', identity, steps=20),
    Method('gauss8', identity, steps=14),
    *[Method(f'gauss{order}', identity, steps=8) for order in range(10, 18, 2)],
    Method('yoshida4', identity, steps=60),
    Method('suzuki4', identity, steps=40),
    Method('kahan_li8', identity, steps=20),
    Method('discrete_euler_lagrange', identity, 'pendulum',
           ('helpers:midpoint_lagrangian', 2), steps=100),
    Method('time_transformed', None, steps=40),
    Method('discrete_gradient', None),
    Method('explicit_euler', None, steps=400),
    Method('rk4', None, steps=40),
    Method('dop853', None),
    *([Method('taylor', None)] if find_spec('heyoka') else ()),
]
# Methods whose steps run in any arithmetic: the compiled ones, whose step sizes are given.
GENERIC = [method for method in METHODS
           if method.integrator.compiled and not method.integrator.tolerances]
# One method of each kind, for `make test`; `make test-long` runs all of them.
KINDS = ('variational_euler', 'symplectic_euler_adjoint', 'generalized_leapfrog', 'stormer_verlet',
         'implicit_midpoint', 'gauss4', 'yoshida4', 'rk4')


class Uncompiled(Hamiltonian):
    """
    The same Hamiltonian as plain Python, so that a test need not wait for the compiler.

    Parameters
    ----------
    base : Hamiltonian
        Compiled Hamiltonian.

    """

    def __init__(self, base: Hamiltonian):
        self._base = base
        self.coordinates, self.separable = base.coordinates, base.separable

    @cached_property
    def kernel(self) -> Kernel:
        """Return the uncompiled functions."""
        return python_kernel(self._base)


def free(*names: str) -> Uncompiled:
    """Return a free system with 1 kg per coordinate."""
    return Uncompiled(HAMILTONIANS['free_particle'](1.0, names))


def effect(kind: str, *arguments: object, **more: object) -> Effect:
    """Return an effect."""
    return EFFECTS[kind](*arguments, **more)


def plain_run(system: str | Hamiltonian, method: str | Integrator, h: float, q: ArrayLike,
              p: ArrayLike, *effects: Effect, **options: Any) -> Simulation:
    """Return a simulation in plain Python; systems and methods by name have default arguments."""
    if isinstance(system, str):
        system = Uncompiled(HAMILTONIANS[system]())
    if isinstance(method, str):
        method = INTEGRATORS[method]()
    return Simulation(system, method, h, q, p, effects, **options)


@cache
def problem_of(name: str) -> InitialValueProblem:
    """Return the initial value problem of a shipped scene."""
    scene = load_scene(name)
    return InitialValueProblem(scene.create_hamiltonian(), tuple(scene.create_effects()),
                               np.array(scene.initial_state.q), np.array(scene.initial_state.p))


class Malicious:
    """Object whose unpickling creates a folder."""

    def __init__(self, marker: Path):
        self.marker = marker

    def __reduce__(self):
        """Make pickle call os.mkdir."""
        return os.mkdir, (str(self.marker),)


def python_gradient(hamiltonian: Hamiltonian, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient computed without compilation in the arithmetic of z, shape (2 d,)."""
    d = z.size // 2
    kernel = python_kernel(hamiltonian)
    dH_dq, dH_dp = np.zeros_like(z[:d]), np.zeros_like(z[d:])
    kernel.gradient(kernel.parameters, z[:d], z[d:], dH_dq, dH_dp)
    return dH_dq, dH_dp


def python_kernel(hamiltonian: Hamiltonian) -> Kernel:
    """Return the uncompiled kernel of a Hamiltonian."""
    kernel = hamiltonian.kernel
    if not kernel.compiled:
        return kernel
    return kernel._replace(energy=kernel.energy.py_func, gradient=kernel.gradient.py_func,
                           hessian_vector=kernel.hessian_vector.py_func, compiled=False)


def exact_options(integrator: Integrator) -> tuple:
    """Return the options of a method with its coefficients to DIGITS digits."""
    options = integrator.options()
    if isinstance(options, solvers.SolverOptions):
        # This precision takes many iterations, so any solution is accepted.
        return options._replace(connected=False)
    if isinstance(options, LieOptions):
        return options._replace(solver=options.solver._replace(connected=False))
    if not isinstance(integrator, (Gauss, LieGauss)):
        return options
    # Use a solver without eigenvectors, which are known only in double precision.
    solver = options.solver._replace(solve=solvers.anderson)
    matrix, weights, start = exact_tableau(integrator.stages)
    if isinstance(integrator, Gauss):
        matrix, start = in_fours(matrix), in_fours(start)
    return Tableau(matrix, weights, start, solver, options.modes)


def exact_tableau(stages: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coefficients of a Gauss method from the roots of the Legendre polynomial."""
    mp.dps = DIGITS
    # 2^s P_s(x) has integer coefficients.
    coefficients = [0] * (stages + 1)
    for k in range(stages // 2 + 1):
        coefficients[2 * k] = (-1) ** k * comb(stages, k) * comb(2 * stages - 2 * k, stages)
    roots = sorted(mp.polyroots(coefficients, maxsteps=500, extraprec=500))
    nodes = [(mp.re(root) + 1) / 2 for root in roots]
    powers = mp.matrix([[node ** k for node in nodes] for k in range(stages)])

    def integrals(low: mpf, high: mpf) -> list:
        moments = mp.matrix([(high ** (k + 1) - low ** (k + 1)) / (k + 1)
                             for k in range(stages)])
        return list(mp.lu_solve(powers, moments))

    return (np.array([integrals(0, node) for node in nodes]), np.array(integrals(mpf(0), mpf(1))),
            np.array([integrals(1, 1 + node) for node in nodes]))


@contextmanager
def exact_solver() -> Iterator[None]:
    """Make the uncompiled solvers iterate to DIGITS digits instead of double precision."""
    eps, solvers._EPS = solvers._EPS, mpf(10) ** (5 - DIGITS)
    try:
        yield
    finally:
        solvers._EPS = eps


def python_step(integrator: Integrator, hamiltonian: Hamiltonian, h: float, z: np.ndarray
                ) -> np.ndarray:
    """Take one uncompiled step in the arithmetic of z, shape (2 d,)."""
    d = z.size // 2

    def point() -> PhasePoint:
        return PhasePoint(*[z[:d] * 0 for _ in range(6)])

    start, end = point(), point()
    start.q[:], start.p[:] = z[:d], z[d:]
    start.dH_dq[:], start.dH_dp[:] = python_gradient(hamiltonian, z)
    memory = integrator.memory(d, dtype=object)
    with exact_solver():
        outcome, _, _ = integrator.step(
            python_kernel(hamiltonian), h, exact_options(integrator), start, end, memory)
    assert outcome == OK
    return np.concatenate([end.q, end.p])


def plain_steps(integrator: Integrator, kernel: Kernel, h: float, q: Sequence[float],
                p: Sequence[float], steps: int = 1) -> PhasePoint:
    """Return the state after steps of a Python kernel; a short p is zero-padded."""
    z, z1 = PhasePoint.empty(len(q)), PhasePoint.empty(len(q))
    z.q[:], z.p[:len(p)] = q, p
    memory = integrator.memory(len(q))
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    for _ in range(steps):
        outcome, _, _ = integrator.step(
            kernel, h, integrator.options(dimension=len(q)), z, z1, memory)
        assert outcome == OK
        copy_point(z1, z)
    return z


def exact(values: list[float]) -> np.ndarray:
    """Return the values as numbers of DIGITS decimal digits."""
    mp.dps = DIGITS
    return np.array([mpf(value) for value in values], dtype=object)


def jacobian(function: Callable, z: np.ndarray) -> np.ndarray:
    """
    Return the derivative of a map of phase space by central differences in mpmath.

    With 60 digits and a step of 1e-20 the truncation and rounding errors are 1e-40: the result is
    exact in double precision.
    """
    spacing = mpf(10) ** -20
    columns = []
    for i in range(z.size):
        ahead, behind = z.copy(), z.copy()
        ahead[i] += spacing
        behind[i] -= spacing
        columns.append((function(ahead) - function(behind)) / (2 * spacing))
    return np.array(columns).T


def symplectic_defect(derivative: np.ndarray) -> float:
    """Return the largest entry of M^T J M - J for a derivative M of shape (2 d, 2 d)."""
    d = len(derivative) // 2
    unit = np.eye(d, dtype=int)
    zero = np.zeros((d, d), dtype=int)
    J = np.block([[zero, unit], [-unit, zero]])
    return float(abs(derivative.T.dot(J).dot(derivative) - J).max())
