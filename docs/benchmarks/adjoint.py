# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gradients through pendulum simulations, compared with adjoints of diffrax and torchdiffeq."""

from collections.abc import Callable, Iterator, Sequence
import math
import tracemalloc

from benchmarks.choosing import GAUSS, loosest
from benchmarks.measurement import race, Row, Settings, summarise
import diffrax
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.torch import DifferentiableSimulation
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import torch
from torchdiffeq import odeint_adjoint

# q(T) of the pendulum of 1 kg and 1 m that starts at rest, by its initial angle [rad] and by g.
_START = (2.0, 9.81)
_WANTED = 1e-8
_HORIZONS = (1.0, 10.0, 100.0, 1000.0)
_STEPS = 0.1 * 2.0 ** np.arange(2.0, -2.1, -0.25)
_TOLERANCES = 10.0 ** np.arange(-9.0, -14.1, -0.5)
_COSTS = ('variational_euler', 'generalized_leapfrog', 'implicit_midpoint', 'gauss8')
_COST_STEPS = 10000

# gradient(duration, setting) returns q(T) and its derivatives by the start, shape (3,).
Gradient = Callable[[float, float], np.ndarray]


def exact(duration: float) -> np.ndarray:
    """Return q(T) and its derivatives by elliptic functions, with 40 digits."""
    def angle(q0: mpmath.mpf, gravity: mpmath.mpf) -> mpmath.mpf:
        k = mpmath.sin(q0 / 2)
        u = mpmath.ellipk(k * k) + mpmath.sqrt(gravity) * mpmath.mpf(duration)
        return 2 * mpmath.asin(k * mpmath.ellipfun('sn', u, m=k * k))
    with mpmath.workdps(40):
        start = [mpmath.mpf(value) for value in _START]
        found = [angle(*start), *(mpmath.diff(angle, tuple(start), order)
                                  for order in ((1, 0), (0, 1)))]
    return np.array([float(value) for value in found])


def ours(method: str) -> Gradient:
    """Return the gradient of a method, compiled as diffrax's is, by its step size."""
    scene = load_scene('exact_pendulum').with_overrides(integrator=method)
    simulation = DifferentiableSimulation(scene, ['hamiltonian.gravity'])
    zero = torch.zeros(1, dtype=torch.float64)

    def gradient(duration: float, h: float) -> np.ndarray:
        q0, gravity = (torch.tensor(value, dtype=torch.float64, requires_grad=True)
                       for value in _START)
        steps = math.ceil(duration / h - 1e-9)
        q = simulation(q0[None], zero, duration=duration, step_size=duration / steps,
                       every=steps, parameters={'hamiltonian.gravity': gravity}).q[-1, 0]
        return np.array([float(part.detach()) for part in (
            q, *torch.autograd.grad(q, (q0, gravity)))])
    return gradient


def by_diffrax() -> Gradient:
    """Return the gradient of Dopri8 with its recursive checkpoints, by the tolerance."""
    jax.config.update('jax_enable_x64', True)

    def angle(start: jax.Array, duration: float, tolerance: float) -> jax.Array:
        term = diffrax.ODETerm(lambda t, z, gravity: jnp.stack([z[1], -gravity * jnp.sin(z[0])]))
        return diffrax.diffeqsolve(
            term, diffrax.Dopri8(), 0.0, duration, None,
            jnp.stack([start[0], 0.0]), args=start[1], max_steps=1 << 16,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            adjoint=diffrax.RecursiveCheckpointAdjoint()).ys[-1, 0]
    both = jax.jit(jax.value_and_grad(angle))

    def gradient(duration: float, tolerance: float) -> np.ndarray:
        value, parts = jax.block_until_ready(both(jnp.array(_START), duration, tolerance))
        return np.array([value, *parts])
    return gradient


def by_torchdiffeq() -> Gradient:
    """Return the gradient of dopri8 by the adjoint equation, by the tolerance."""
    class Field(torch.nn.Module):

        def __init__(self) -> None:
            super().__init__()
            self.gravity = torch.nn.Parameter(torch.tensor(_START[1], dtype=torch.float64))

        def forward(self, t: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
            return torch.stack([z[1], -self.gravity * torch.sin(z[0])])

    def gradient(duration: float, tolerance: float) -> np.ndarray:
        field = Field()
        q0 = torch.tensor(_START[0], dtype=torch.float64, requires_grad=True)
        times = torch.tensor([0.0, duration], dtype=torch.float64)
        q = odeint_adjoint(field, torch.stack([q0, 0.0 * q0.detach()]), times, rtol=tolerance,
                           atol=tolerance, method='dopri8')[-1, 0]
        return np.array([float(part.detach()) for part in (
            q, *torch.autograd.grad(q, (q0, field.gravity)))])
    return gradient


def error(found: np.ndarray, true: np.ndarray) -> float:
    """Return the largest relative error of the derivatives."""
    return float((np.abs(found - true) / np.abs(true))[1:].max())


def rows(settings: Settings) -> Iterator[Row]:
    """Measure the cost and the errors of gradients, relative to values and to peers."""
    yield from _costs(settings)
    diffrax_, torchdiffeq_ = 'diffrax Dopri8, recursive checkpoints', 'torchdiffeq dopri8, adjoint'
    peers = {diffrax_: by_diffrax(), torchdiffeq_: by_torchdiffeq()}
    yield from _times(10.0, peers, settings)
    # In eager steps of torch this one takes 11 s to T = 100: it is left out from here on.
    del peers[torchdiffeq_]
    for duration in _HORIZONS[2:3] if settings.quick else _HORIZONS[2:]:
        yield from _times(duration, peers, settings)
    settings.say('errors')
    (tolerance,) = (_loosest(peer, 100.0, _TOLERANCES) for peer in peers.values())
    own, step = ours('gauss16'), _loosest(ours('gauss16'), 100.0, _STEPS)
    for duration in _HORIZONS[:3] if settings.quick else _HORIZONS:
        true = exact(duration)
        mine, theirs = error(own(duration, step), true), error(
            peers[diffrax_](duration, tolerance), true)
        yield summarise(
            f'gradient of the pendulum at T = {duration:g}: relative error', f'{mine:.2g}',
            f'{diffrax_} {theirs:.2g}', mine / theirs, None, note=f'gauss16, h = {step:.3g}, and '
            f'tolerance {tolerance:.2g}: those that are enough for {_WANTED:g} at T = 100')


def _times(duration: float, peers: dict[str, Gradient], settings: Settings) -> Iterator[Row]:
    """Measure the time of gradients that are as good at the end, each by its cheapest setting."""
    settings.say(f'choosing steps and tolerances at T = {duration:g}, and timing')
    chosen: dict[str, tuple[Gradient, float]] = {}
    for name, gradient, choices in (
            *((method, ours(method), _STEPS) for method in GAUSS),
            *((name, peer, _TOLERANCES) for name, peer in peers.items())):
        chosen[name] = gradient, _loosest(gradient, duration, choices)
    contestants = {name: lambda gradient=gradient, setting=setting: lambda: gradient(
        duration, setting) for name, (gradient, setting) in chosen.items()}
    yield race(
        f'gradient of the pendulum to {_WANTED:g} at T = {duration:g}: time',
        {name: contestants[name] for name in GAUSS}, {name: contestants[name] for name in peers},
        settings, target=0.5, scale=1e3, unit='ms', note='; '.join(
            f'{name}: {"h" if name in GAUSS else "tolerance"} = {setting:.2g}'
            for name, (_, setting) in chosen.items()))


def _costs(settings: Settings) -> Iterator[Row]:
    """Measure value and gradient over the value, and memory over the number of steps."""
    scene, zero = load_scene('exact_pendulum'), torch.zeros(1, dtype=torch.float64)
    simulations = {method: DifferentiableSimulation(scene.with_overrides(0.01, method))
                   for method in _COSTS}

    def run(method: str, steps: int, follow: bool) -> None:
        q0 = torch.ones(1, dtype=torch.float64, requires_grad=follow)
        q = simulations[method](q0, zero, duration=0.01 * steps, every=steps).q[-1].sum()
        if follow:
            q.backward()
    for method in _COSTS:
        settings.say(method)
        both, value = (lambda follow=follow, method=method: lambda: run(
            method, _COST_STEPS, follow) for follow in (True, False))
        yield race(f'{method}, 10000 steps: value and gradient over the value', {'both': both},
                   {'value': value}, settings, target=6.0, scale=1e3, unit='ms')
    most = []
    for steps in (_COST_STEPS, 100 * _COST_STEPS // (10 if settings.quick else 1)):
        tracemalloc.start()
        run('generalized_leapfrog', steps, True)
        most.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    yield summarise('memory of a gradient, 1000000 steps over 10000', f'{most[1]:.3g} MB',
                    f'10000 steps {most[0]:.3g} MB', most[1] / most[0], 10.0)


def _loosest(gradient: Gradient, duration: float, settings: Sequence[float]) -> float:
    """Return the first of some settings that is accurate enough."""
    true = exact(duration)
    return loosest(settings, lambda setting: error(gradient(duration, setting), true), _WANTED)
