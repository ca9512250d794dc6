# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Integrators of other packages on the same H, each in its fastest form.

scipy gets our compiled gradient; torchdiffeq the gradient of a network written out, which is
several times faster than its automatic differentiation; diffrax one jitted function. All of them
compute in float64 on one thread. torch, torchdiffeq, jax and diffrax are imported when they are
asked for.
"""

from collections.abc import Callable
import os
from types import FunctionType, ModuleType
from typing import Any

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import entry_point
from hnn_vi_ros.models import Checkpoint, NeuralHamiltonian
import numba
import numpy as np
from scipy.integrate import solve_ivp
from studies.measuring import Peer, Solve

_MOST_STEPS = 100_000_000
_SMALLEST_RTOL = 100.0 * float(np.finfo(np.float64).eps)
# XLA reads these flags when it is loaded: one thread.
_XLA_FLAGS = '--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1'


def create_peers(hamiltonian: Hamiltonian) -> list[Peer]:
    """
    Return the peers that can integrate a Hamiltonian.

    Raises
    ------
    ModuleNotFoundError
        torch, torchdiffeq, jax or diffrax is not installed.
    ParameterError
        It is a network of another activation than tanh.

    """
    if isinstance(hamiltonian, NeuralHamiltonian):
        activation = hamiltonian.checkpoint.card.activation
        if activation != 'tanh':
            raise ParameterError('--peers: the peers are written out for tanh, and this network '
                                 f'has {activation} between its layers; leave --peers')
    return [*scipy_peers(hamiltonian), *_torchdiffeq_peers(hamiltonian),
            *_diffrax_peers(hamiltonian)]


def scipy_peers(hamiltonian: Hamiltonian) -> list[Peer]:
    """Return the peers that need only packages installed with this one."""
    return [Peer(f'scipy {method}', True, scipy_solve(hamiltonian, method))
            for method in ('DOP853', 'RK45')]


def scipy_solve(hamiltonian: Hamiltonian, method: str) -> Solve:
    """Return an adaptive method of scipy, with our compiled gradient."""
    gradient, parameters = hamiltonian.kernel.gradient, hamiltonian.kernel.parameters
    d = hamiltonian.dimension

    @numba.njit
    def field(z: np.ndarray, parameters: tuple) -> np.ndarray:
        dH_dq, result = np.empty(d), np.empty(2 * d)
        gradient(parameters, z[:d], z[d:], dH_dq, result[:d])
        for i in range(d):
            result[d + i] = -dH_dq[i]
        return result

    # Without numba's look-up of types, which takes longer for named tuples: scipy passes nothing
    # but contiguous arrays of float64.
    call = entry_point(field, np.zeros(2 * d), parameters)

    return scipy_integrate(lambda z: call(z, parameters), method)


def scipy_integrate(rates: Callable[[np.ndarray], np.ndarray], method: str) -> Solve:
    """Return an adaptive method of scipy for z' = rates(z)."""
    def solve(z0: np.ndarray, duration: float, tolerance: float) -> tuple[np.ndarray, int]:
        solution = solve_ivp(
            lambda t, z: rates(z), (0.0, duration), z0, method=method,
            t_eval=[duration], rtol=max(tolerance, _SMALLEST_RTOL), atol=max(tolerance, 1e-15))
        if not solution.success:
            raise RuntimeError(solution.message)
        return solution.y[:, -1], solution.nfev

    return solve


def _torchdiffeq_peers(hamiltonian: Hamiltonian) -> list[Peer]:
    if not isinstance(hamiltonian, NeuralHamiltonian):
        return []
    return [*[Peer(f'torchdiffeq {method}', True, torch_solve(hamiltonian, method, True))
              for method in ('dopri5', 'dopri8')],
            Peer('torchdiffeq rk4', False, torch_solve(hamiltonian, 'rk4', False))]


def torch_solve(hamiltonian: NeuralHamiltonian, method: str, adaptive: bool) -> Solve:
    """Return a method of torchdiffeq, adaptive or of a fixed step."""
    import torch
    from torchdiffeq import odeint
    torch.set_num_threads(1)
    field = torch_field(hamiltonian.checkpoint)

    @torch.inference_mode()
    def solve(z0: np.ndarray, duration: float, setting: float) -> tuple[np.ndarray, int]:
        calls = 0

        def counted(t: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
            nonlocal calls
            calls += 1
            return field(t, z)

        how: dict[str, Any] = {'rtol': setting, 'atol': setting} if adaptive else {
            'options': {'step_size': setting}}
        times = torch.tensor([0.0, duration], dtype=torch.float64)
        end = odeint(counted, torch.tensor(z0), times, method=method, **how)[-1]
        return end.numpy(), calls

    return solve


def torch_field(checkpoint: Checkpoint) -> Callable:
    """
    Return (q', p') = (H_p, -H_q) as a torch function of t and (q, p), shape (2 d,).

    The gradient is written out, because torch's automatic differentiation is several times slower.
    """
    import torch
    weights, biases = ([torch.tensor(part) for part in parts]
                       for parts in checkpoint.networks['energy'])
    transposed = [weight.T.contiguous() for weight in weights[:-1]]
    d = checkpoint.card.widths[0] // 2

    def field(t: float, z: torch.Tensor) -> torch.Tensor:
        activations = []
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            z = torch.tanh(torch.addmv(bias, weight, z))
            activations.append(z)
        g = weights[-1][0]
        for weight, a in zip(reversed(transposed), reversed(activations), strict=True):
            g = torch.mv(weight, g - g * a * a)
        return torch.cat((g[d:], -g[:d]))

    return field


def _diffrax_peers(hamiltonian: Hamiltonian) -> list[Peer]:
    peers = [Peer(f'diffrax {method}', True, diffrax_solve(hamiltonian, method))
             for method in ('Tsit5', 'Dopri8')]
    if hamiltonian.separable:
        peers.append(Peer('diffrax SemiImplicitEuler', False, _semi_implicit(hamiltonian)))
    return peers


def diffrax_solve(hamiltonian: Hamiltonian, method: str) -> Solve:
    """Return an adaptive method of diffrax, jitted."""
    return diffrax_integrate(jax_rates(hamiltonian), method)


def jax_rates(hamiltonian: Hamiltonian) -> Callable:
    """Return z' of a state as a function of JAX."""
    jax, _ = load_jax()
    gradient, d = jax.grad(jax_energy(hamiltonian)), hamiltonian.dimension

    def rates(z: Any) -> Any:
        g = gradient(z)
        return jax.numpy.concatenate([g[d:], -g[:d]])

    return rates


def diffrax_integrate(rates: Callable, method: str) -> Solve:
    """Return an adaptive method of diffrax for z' = rates(z), a function of JAX, jitted."""
    jax, diffrax = load_jax()
    tableau = getattr(diffrax, method)().tableau
    stages = len(tableau.b_sol) - (tableau.fsal or tableau.ssal)
    return _counted(jax.jit(diffrax_run(rates, method)), stages)


def diffrax_run(rates: Callable, method: str) -> Callable:
    """Return a function of z, a duration and a tolerance: the end, steps, and whether it is it."""
    _, diffrax = load_jax()
    solver = getattr(diffrax, method)()

    def run(z: Any, duration: float, tolerance: float) -> tuple:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, z, _: rates(z)), solver, 0.0, duration, None, z,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            saveat=diffrax.SaveAt(t1=True), max_steps=_MOST_STEPS, throw=False,
            # The fastest of its ways to go forward.
            adjoint=diffrax.ForwardMode())
        return (solution.ys[0], solution.stats['num_steps'],
                diffrax.is_successful(solution.result))

    return run


def _semi_implicit(hamiltonian: Hamiltonian) -> Solve:
    jax, diffrax = load_jax()
    gradient, d = jax.grad(jax_energy(hamiltonian)), hamiltonian.dimension

    def at(q: Any, p: Any) -> Any:
        return gradient(jax.numpy.concatenate([q, p]))

    # H separates: the rate of q is the same at any q, the rate of p at any p.
    anywhere = np.ones(d)
    terms = (diffrax.ODETerm(lambda t, p, _: at(anywhere, p)[d:]),
             diffrax.ODETerm(lambda t, q, _: -at(q, anywhere)[:d]))

    @jax.jit
    def run(z: Any, duration: float, step: float) -> tuple:
        solution = diffrax.diffeqsolve(
            terms, diffrax.SemiImplicitEuler(), 0.0, duration, step, (z[:d], z[d:]),
            stepsize_controller=diffrax.ConstantStepSize(),
            saveat=diffrax.SaveAt(t1=True), max_steps=_MOST_STEPS, throw=False,
            adjoint=diffrax.ForwardMode())
        return (jax.numpy.concatenate([solution.ys[0][0], solution.ys[1][0]]),
                solution.stats['num_steps'], diffrax.is_successful(solution.result))

    # One gradient a step: half of it for q, half for p.
    return _counted(run, 1)


def _counted(run: Callable, gradients_per_step: int) -> Solve:
    def solve(z0: np.ndarray, duration: float, setting: float) -> tuple[np.ndarray, int]:
        end, steps, good = run(z0, duration, setting)
        if not bool(good):
            raise RuntimeError('gave up')
        return np.asarray(end), int(steps) * gradients_per_step
    return solve


def jax_energy(hamiltonian: Hamiltonian) -> Callable:
    """Return H as a JAX function of (q, p), shape (2 d,)."""
    jax, _ = load_jax()
    if isinstance(hamiltonian, NeuralHamiltonian):
        return _jax_network(hamiltonian.checkpoint, jax.numpy)
    energy = _with_module(hamiltonian.kernel.energy.py_func, jax.numpy)
    d, parameters = hamiltonian.dimension, hamiltonian.kernel.parameters
    return lambda z: energy(parameters, z[:d], z[d:])


def _jax_network(checkpoint: Checkpoint, jnp: ModuleType) -> Callable:
    layers = [(jnp.asarray(weight), jnp.asarray(bias)) for weight, bias in zip(
        *checkpoint.networks['energy'], strict=True)]

    def energy(z: Any) -> Any:
        for weight, bias in layers[:-1]:
            z = jnp.tanh(weight @ z + bias)
        weight, bias = layers[-1]
        return (weight @ z + bias)[0]

    return energy


def _with_module(function: FunctionType, module: ModuleType) -> FunctionType:
    """Return a formula of ours computed by another array module in numpy's place."""
    names = {**function.__globals__, 'np': module}
    for name, value in function.__globals__.items():
        if isinstance(value, FunctionType) and value.__module__ == function.__module__:
            names[name] = FunctionType(value.__code__, names)
    return FunctionType(function.__code__, names)


def load_jax() -> tuple[ModuleType, ModuleType]:
    """Return jax and diffrax, on one thread, in double precision."""
    os.environ.setdefault('XLA_FLAGS', _XLA_FLAGS)
    os.environ.setdefault('JAX_PLATFORMS', 'cpu')
    import jax
    jax.config.update('jax_enable_x64', True)
    import diffrax
    return jax, diffrax
