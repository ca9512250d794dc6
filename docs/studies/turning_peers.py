# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Integrators of other packages for rotating bodies, each in its fastest form.

Runge-Kutta methods integrate the quaternion as four numbers with the momenta, by our compiled
gradient, or in diffrax with the rates written out; MuJoCo has the body on a ball joint or free,
without contact. jax, diffrax and mujoco are imported when they are asked for.
"""

from collections.abc import Callable
from typing import Any

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.hamiltonians.heavy_top import HeavyTop
from hnn_vi_ros.hamiltonians.quadrotor import Quadrotor
from hnn_vi_ros.integrators.lie.rotations import trivialised
from hnn_vi_ros.kernels import entry_point
import numba
import numpy as np
from studies.measuring import Peer, Solve
from studies.peers import diffrax_integrate, load_jax, scipy_integrate

_TRIVIALISED = numba.njit(trivialised)


def turning_peers(hamiltonian: HeavyTop | Quadrotor) -> list[Peer]:
    """
    Return the peers for a heavy top or a quadrotor.

    Raises
    ------
    ModuleNotFoundError
        jax, diffrax or mujoco is not installed.

    """
    rates, rk4 = _compiled(hamiltonian)
    return [*[Peer(f'scipy {method}', True, scipy_integrate(rates, method))
              for method in ('DOP853', 'RK45')],
            *[Peer(f'diffrax {method}', True, diffrax_integrate(jax_rates(hamiltonian), method))
              for method in ('Dopri8', 'Tsit5')],
            Peer('RK4 on quaternions', False, rk4),
            *[Peer(f'MuJoCo {method}', False, mujoco_solve(hamiltonian, method))
              for method in ('RK4', 'implicitfast')]]


def _compiled(hamiltonian: Hamiltonian) -> tuple[Callable[[np.ndarray], np.ndarray], Solve]:
    """Return the rates of (q, p) of one body, and RK4 by them."""
    kernel, d = hamiltonian.kernel, hamiltonian.dimension
    gradient, parameters, places = kernel.gradient, kernel.parameters, kernel.rotations[0]

    @numba.njit(error_model='numpy')
    def field(z: np.ndarray, parameters: tuple) -> np.ndarray:
        dH_dq, dH_dp, p, result = np.empty(d), np.empty(d), np.zeros(d), np.empty(2 * d - 1)
        p[:d - 1] = z[d:]
        gradient(parameters, z[:d], p, dH_dq, dH_dp)
        for i in range(places):
            result[i], result[d + i] = dH_dp[i], -dH_dq[i]
        x, y, w, s = z[places], z[places + 1], z[places + 2], z[places + 3]
        a, b, c = dH_dp[places], dH_dp[places + 1], dH_dp[places + 2]
        result[places] = 0.5 * (s * a + y * c - w * b)
        result[places + 1] = 0.5 * (s * b + w * a - x * c)
        result[places + 2] = 0.5 * (s * c + x * b - y * a)
        result[places + 3] = -0.5 * (x * a + y * b + w * c)
        p1, p2, p3 = p[places], p[places + 1], p[places + 2]
        turning = _TRIVIALISED(z, dH_dq, places)
        result[d + places] = p2 * c - p3 * b - turning[0]
        result[d + places + 1] = p3 * a - p1 * c - turning[1]
        result[d + places + 2] = p1 * b - p2 * a - turning[2]
        return result

    @numba.njit(error_model='numpy')
    def advance(z: np.ndarray, h: float, steps: int, parameters: tuple) -> np.ndarray:
        for _ in range(steps):
            a = field(z, parameters)
            b = field(z + 0.5 * h * a, parameters)
            c = field(z + 0.5 * h * b, parameters)
            z = z + h / 6.0 * (a + 2.0 * (b + c) + field(z + h * c, parameters))
        return z

    # See scipy_solve.
    z0 = np.zeros(2 * d - 1)
    call, run = entry_point(field, z0, parameters), entry_point(advance, z0, 0.1, 1, parameters)

    def rk4(z0: np.ndarray, duration: float, step: float) -> tuple[np.ndarray, int]:
        steps = round(duration / step)
        return run(z0, step, steps, parameters), 4 * steps
    return lambda z: call(z, parameters), rk4


def jax_rates(hamiltonian: HeavyTop | Quadrotor) -> Callable[[Any], Any]:
    """Return the rates of (q, p), written out in JAX."""
    jax, _ = load_jax()
    numbers = jax.numpy
    I1, I2, I3 = hamiltonian.inertia

    def turning(q: Any, p: Any) -> list:
        x, y, z, w = q
        a, b, c = p[0] / I1, p[1] / I2, p[2] / I3
        return [0.5 * (w * a + y * c - z * b), 0.5 * (w * b + z * a - x * c),
                0.5 * (w * c + x * b - y * a), -0.5 * (x * a + y * b + z * c),
                p[1] * c - p[2] * b, p[2] * a - p[0] * c, p[0] * b - p[1] * a]

    def top(state: Any) -> Any:
        x, y, z, w = state[:4]
        *q, L1, L2, L3 = turning(state[:4], state[4:])
        weight = 2.0 * hamiltonian.moment
        return numbers.stack([*q, L1 + weight * (y * z + w * x), L2 - weight * (x * z - w * y),
                              L3])

    def free(state: Any) -> Any:
        *q, L1, L2, L3 = turning(state[3:7], state[10:])
        velocity = state[7:10] / hamiltonian.mass
        return numbers.stack([*velocity, *q, 0.0 * L1, 0.0 * L1, -hamiltonian.weight + 0.0 * L1,
                              L1, L2, L3])
    return top if isinstance(hamiltonian, HeavyTop) else free


def mujoco_solve(hamiltonian: HeavyTop | Quadrotor, method: str) -> Solve:
    """Return a method of MuJoCo: of a top on a ball joint, or of a free body; no contact."""
    import mujoco
    inertia = np.array(hamiltonian.inertia)
    if isinstance(hamiltonian, HeavyTop):
        mass, length, joint = hamiltonian.mass, hamiltonian.length, 'ball'
        gravity, places = hamiltonian.gravity, 0
        # About the centre of mass.
        own = inertia - mass * length * length * np.array([1.0, 1.0, 0.0])
    else:
        mass, length, joint, own, places = hamiltonian.mass, 0.0, 'free', inertia, 3
        gravity = hamiltonian.weight / mass
    moments = ' '.join(map(repr, own.tolist()))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option integrator="{method}" gravity="0 0 {-gravity!r}">'
        '<flag contact="disable"/></option><worldbody><body>'
        f'<joint type="{joint}"/><inertial pos="0 0 {length!r}" mass="{mass!r}" '
        f'diaginertia="{moments}"/></body></worldbody></mujoco>')
    data, d = mujoco.MjData(model), places + 4

    def solve(z0: np.ndarray, duration: float, step: float) -> tuple[np.ndarray, int]:
        steps, model.opt.timestep = round(duration / step), step
        mujoco.mj_resetData(model, data)
        data.qpos[:places] = z0[:places]
        data.qpos[places:] = z0[[places + 3, places, places + 1, places + 2]]
        data.qvel[:places] = z0[d:d + places] / mass
        data.qvel[places:] = z0[d + places:] / inertia
        mujoco.mj_step(model, data, nstep=steps)
        end, velocity = data.qpos, data.qvel
        return np.array([*end[:places], *end[places + 1:], end[places],
                         *(mass * velocity[:places]), *(inertia * velocity[places:])]
                        ), steps * (4 if method == 'RK4' else 1)
    return solve
