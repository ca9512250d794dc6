# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Losses by which a network of a machine is fitted, at samples of motions."""

from collections.abc import Callable, Iterator, Sequence
import math
from typing import Any, NamedTuple, Protocol

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import Motion
from hnn_vi_ros.learning.families.structure import MotionScales
from hnn_vi_ros.learning.fit.window_steps import MethodName, simulated, Solutions
import numpy as np
import torch

# Errors beyond this share of the usual size count by their size, no longer by their square.
_USUAL_ERROR = 0.25
# Step size of windows, unless it is given, and samples come as often [s].
_STEP = 0.01


class Network(Protocol):
    """Network that is fitted."""

    scales: MotionScales
    has_masses: bool

    def parameters(self) -> Iterator[torch.nn.Parameter]:
        """Return what is changed."""

    def accelerations(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        """Return dv/dt, shape (N, d), at q and v of that shape and commands of shape (N, m)."""


class Mechanics(Network, Protocol):
    """Network that is fitted where it has masses."""

    def joint_forces(self, tau: torch.Tensor) -> torch.Tensor:
        """Return the forces on the joints, shape (N, d), of commands of shape (N, m)."""

    def forces(self, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        """Return the forces on the joints that give accelerations a, all of shape (N, d)."""

    def momenta(self, q: torch.Tensor, v: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return p = M v and dp/dt where tau is zero, all of shape (N, d)."""

    def velocities(self, q: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        """Return M^-1 p, all of shape (N, d)."""


class Samples(NamedTuple):
    """
    All motions, one after another, as tensors.

    Parameters
    ----------
    measured : torch.Tensor, shape (N, d)
        Coordinates as measured.
    q, v, a : torch.Tensor, shape (N, d)
        Smoothed states and accelerations.
    tau, mean_tau : torch.Tensor, shape (N, m)
        Commands of the motors as measured, and averaged over the step that begins at each sample.
    left : torch.Tensor of int, shape (N,)
        How many samples follow in the same motion.
    every : int
        Samples in one step.
    step_size : float
        How long it is [s].

    """

    measured: torch.Tensor
    q: torch.Tensor
    v: torch.Tensor
    a: torch.Tensor
    tau: torch.Tensor
    mean_tau: torch.Tensor
    left: torch.Tensor
    every: int
    step_size: float


def samples_of(motions: Sequence[Motion], step_size: float | None) -> Samples:
    """Return the samples of motions, for windows of this step size [s], or DataError."""
    if step_size is None:
        step_size = max(1, round(_STEP / motions[0].spacing)) * motions[0].spacing
    every = round(step_size / motions[0].spacing)
    for motion in motions:
        if every < 1 or abs(every * motion.spacing - step_size) > 0.05 * step_size:
            raise DataError(f'{motion.name}: sampled every {motion.spacing:.4g} s; step_size must '
                            f'be a multiple of that, such as {max(every, 1) * motion.spacing:.4g}')
    parts = [np.concatenate([getattr(motion, name) for motion in motions])
             for name in ('q', 'q_smooth', 'v_smooth', 'a_smooth', 'tau')]
    means = np.concatenate([mean_forces(motion, every) for motion in motions])
    left = np.concatenate([np.arange(len(motion.t))[::-1] for motion in motions])
    return Samples(*map(torch.tensor, (*parts, means, left)), every,
                   every * motions[0].spacing)


def mean_forces(motion: Motion, every: int) -> np.ndarray:
    """Return forces, shape (N, m), averaged over ``every`` intervals from each sample on."""
    n, tau = len(motion.t), motion.tau
    total = np.vstack([np.zeros((1, tau.shape[1])), np.cumsum(motion.forces, axis=0)])
    starts = np.arange(n)
    ends = np.minimum(starts + every, n - 1)
    means = (total[ends] - total) / np.maximum(ends - starts, 1)[:, None]
    return np.where(ends[:, None] > starts[:, None], means, tau)


def acceleration_loss(network: Network, samples: Samples, rows: torch.Tensor
                      ) -> torch.Tensor:
    """Return the soft size of the errors of the accelerations, in units of their usual size."""
    return _soft(acceleration_errors(network, samples, rows))


def acceleration_errors(network: Network, samples: Samples, rows: torch.Tensor) -> torch.Tensor:
    """Return the errors of the accelerations, shape (N, d), in units of their usual size."""
    predicted = network.accelerations(samples.q[rows], samples.v[rows], samples.tau[rows])
    return (predicted - samples.a[rows]) / torch.tensor(network.scales.a)


def force_loss(network: Mechanics, samples: Samples, rows: torch.Tensor) -> torch.Tensor:
    """Return the soft size of the errors of the forces, in units of what usual motions take."""
    predicted = network.forces(samples.q[rows], samples.v[rows], samples.a[rows])
    unit = torch.tensor(network.scales.inertia * network.scales.a)
    return _soft((predicted - network.joint_forces(samples.tau[rows])) / unit)


def discrete_loss(network: Mechanics, samples: Samples, rows: torch.Tensor) -> torch.Tensor:
    """
    Return the soft size of the residuals of the forced discrete Euler-Lagrange equations.

    D2 L_d(q0, q1) + D1 L_d(q1, q2) + h (f01 + f12) / 2 = 0 for L_d(q0, q1) = h L((q0 + q1) / 2,
    (q1 - q0) / h) and forces f at the same midpoint (J. Marsden, M. West, Acta Numerica 10,
    2001, part 3.2), as an acceleration: a residual of momentum could be made small by small
    masses.
    """
    h, every = samples.step_size, samples.every
    q0, q1, q2 = (samples.measured[rows + k * every] for k in range(3))
    (p01, rate01), (p12, rate12) = (
        network.momenta(0.5 * (start + end), (end - start) / h)
        for start, end in ((q0, q1), (q1, q2)))
    given = network.joint_forces(samples.mean_tau[rows] + samples.mean_tau[rows + every])
    residual = p01 - p12 + 0.5 * h * (rate01 + rate12 + given)
    return _soft(network.velocities(q1, residual) / h / torch.tensor(network.scales.a))


def balanced_step(motions: Sequence[Motion]) -> float:
    """
    Return the multiple of the samples' interval [s] for discrete_loss.

    Noise sigma of q makes an error of sqrt(6) sigma / h^2 in a second difference, the midpoint
    rule one of about h^2 / 12 times the fourth derivative of q: where they are the same.
    """
    errors, speeds, accelerations = (np.concatenate(parts) for parts in zip(*(
        (motion.q - motion.q_smooth, motion.v_smooth, motion.a_smooth) for motion in motions),
        strict=True))
    # The median, for the filter is wrong at the ends; of normal noise it is 0.6745 sigma.
    noise = float(np.median(np.abs(errors))) / 0.6745
    speed, acceleration = (float(np.sqrt(np.mean(part**2))) for part in (speeds, accelerations))
    # As if all were one oscillation: estimated fourth derivatives are nothing but noise.
    fourth = acceleration * (acceleration / speed)**2
    spacing = motions[0].spacing
    step = (12.0 * math.sqrt(6.0) * noise / fourth)**0.25
    return max(1, round(step / spacing)) * spacing


class Windows(NamedTuple):
    """
    Windows of motions that are simulated.

    Parameters
    ----------
    count : int
        Steps in each.
    method : str
        Of their steps.
    time_scale : float
        An error of q counts as one of v does that makes it in this time [s].

    """

    count: int
    method: MethodName
    time_scale: float


def window_loss(network: Network, samples: Samples, starts: torch.Tensor, windows: Windows,
                solutions: Solutions | None = None) -> torch.Tensor:
    """Return the soft size of the errors of windows from these samples; see window_errors."""
    return _soft(window_errors(network, samples, starts, windows, solutions))


def window_errors(network: Network, samples: Samples, starts: torch.Tensor, windows: Windows,
                  solutions: Solutions | None = None) -> torch.Tensor:
    """
    Return the errors of q and v after each step of windows, shape (2 count, N, d).

    ``solutions`` are those of the equations, if they are to be used again.
    """
    # What has no masses has no momenta, which a variational method steps.
    method = windows.method if network.has_masses else 'rk4'
    at = starts + samples.every * torch.arange(windows.count + 1)[:, None]
    measured_q, measured_v = samples.q[at], samples.v[at]
    q, v = _simulated(network, method, measured_q, measured_v[0], samples.mean_tau[at[:-1]],
                      samples.step_size, solutions)
    unit = _USUAL_ERROR * torch.tensor(network.scales.v)
    return torch.stack([(q - measured_q[1:]) / (windows.time_scale * unit),
                        (v - measured_v[1:]) / unit], dim=1).flatten(0, 1)


def _simulated(network: Any, method: MethodName, measured: torch.Tensor, v: torch.Tensor,
               tau: torch.Tensor, h: float, solutions: Solutions | None
               ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return q and v after each step, from the first that was measured, at held commands."""
    if method != 'rk4':
        forces = network.joint_forces(tau.flatten(0, 1)).unflatten(0, tau.shape[:2])
        q, v, _ = simulated(network, method, measured[0], v, forces, h, measured.diff(dim=0) / h,
                            solutions)
        return q, v
    q, found = measured[0], []
    for held in tau:
        q, v = runge_kutta(network.accelerations, q, v, held, h)
        found.append(torch.stack([q, v]))
    q, v = torch.stack(found, dim=1)
    return q, v


def _soft(z: torch.Tensor) -> torch.Tensor:
    return 2.0 * ((1.0 + z.square()).sqrt() - 1.0).mean()


def runge_kutta(accelerations: Callable[..., torch.Tensor], q: torch.Tensor, v: torch.Tensor,
                tau: torch.Tensor, h: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (q, v) after a step h [s] of the classical method of order 4, at a held force."""
    a1 = accelerations(q, v, tau)
    v2 = v + 0.5 * h * a1
    a2 = accelerations(q + 0.5 * h * v, v2, tau)
    v3 = v + 0.5 * h * a2
    a3 = accelerations(q + 0.5 * h * v2, v3, tau)
    v4 = v + h * a3
    a4 = accelerations(q + h * v3, v4, tau)
    return q + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
