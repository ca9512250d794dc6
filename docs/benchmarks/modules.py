# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 14: one gradient of an exported torch module, compared with torch and JAX."""

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
import tempfile
from typing import Any, NamedTuple

from benchmarks.gradient import jax_loop, our_loop, RATE, UNROLL
from benchmarks.measurement import assert_close, race, Row, Settings
from hnn_vi_ros import export
from hnn_vi_ros.models import load_learned
import jax
import jax.numpy as jnp
import numpy as np
import torch

SEED = 1
# Gradients in a run.
_COUNT = 2000
_START = (0.3, 0.1, -0.2, 0.2, 0.5, -0.4)


class _Library(NamedTuple):
    """Functions of torch or JAX, so that both compute the same formula."""

    tanh: Callable
    softplus: Callable
    softmax: Callable
    stack: Callable


_TORCH = _Library(torch.tanh, torch.nn.functional.softplus,
                  lambda x: torch.softmax(x, -1), lambda parts: torch.stack(parts, -1))
_JAX = _Library(jnp.tanh, jax.nn.softplus, jax.nn.softmax,
                lambda parts: jnp.stack(parts, -1))
Weights = Mapping[str, Any]


def _linear(x: Any, w: Weights, k: int) -> Any:
    return x @ w[f'w{k}'].T + w[f'b{k}']


def _residual(f: _Library, z: Any, w: Weights) -> Any:
    z = f.softplus(_linear(z, w, 0))
    for k in (1, 2):
        z = z + f.softplus(_linear(z, w, k))
    return _linear(z, w, 3)[..., 0]


def _tanh(f: _Library, z: Any, w: Weights) -> Any:
    return _linear(f.tanh(_linear(f.tanh(_linear(z, w, 0)), w, 1)), w, 2)[..., 0]


def _attention(f: _Library, z: Any, w: Weights) -> Any:
    bodies = _linear(f.stack([z[..., :3], z[..., 3:]]), w, 0)
    query, key, value = (_linear(bodies, w, k) for k in (1, 2, 3))
    seen = f.softmax(query @ key.mT / 4.0) @ value
    return _linear(f.tanh(bodies + seen), w, 4).sum((-2, -1))


class _Case(NamedTuple):
    """A formula, the widths of its layers, in sequence or from 16 to 16, and its d."""

    energy: Callable
    widths: list[tuple[int, int]]
    d: int


_CASES = {
    'residual softplus 2-32-32-32-1': _Case(_residual, [*pairwise([2, 32, 32, 32, 1])], 1),
    'exported tanh 2-64-64-1': _Case(_tanh, [*pairwise([2, 64, 64, 1])], 1),
    'attention over 3 bodies, width 16': _Case(
        _attention, [(2, 16), (16, 16), (16, 16), (16, 16), (16, 1)], 3)}


class _Module(torch.nn.Module):
    """A formula as a user would have it in torch."""

    def __init__(self, case: _Case):
        super().__init__()
        rng = np.random.default_rng(SEED)
        self.energy, self.w = case.energy, torch.nn.ParameterDict()
        for k, (inputs, outputs) in enumerate(case.widths):
            self.w[f'w{k}'] = torch.tensor(rng.normal(size=(outputs, inputs)) / inputs**0.5)
            self.w[f'b{k}'] = torch.tensor(0.1 * rng.normal(size=outputs))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return H of each row, shape (n,)."""
        return self.energy(_TORCH, x, self.w)


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row a module."""
    torch.set_num_threads(1)
    n = _COUNT // 10 if settings.quick else _COUNT
    for name, case in _CASES.items():
        settings.say(name)
        module = _Module(case).requires_grad_(False)
        start = [*_START[:case.d], *_START[-case.d:]]
        box = case.d * [(-1.0, 1.0)]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / 'module.safetensors'
            export(module, path, [f'q{k}' for k in range(case.d)], {'q': box, 'p': box})
            ours = our_loop(load_learned(path).kernel, start, n)
        weights = {key: jnp.asarray(value.detach().numpy()) for key, value in module.w.items()}
        slopes = jax.grad(lambda z, case=case, weights=weights: case.energy(_JAX, z, weights))
        peers = {f'jax.lax.scan, unroll={unroll}': jax_loop(slopes, start, n, unroll)
                 for unroll in UNROLL}
        peers |= {'torch': _torch_loop(_eager(module), start, n),
                  'torch.compile': _torch_loop(_compiled(module), start, n)}
        for run in peers.values():
            assert_close('descent', ours(), run(), 1e-12 * max(1.0, n * RATE))
        yield race(f'gradient of {name}', {'ours': lambda run=ours: run},
                   {key: lambda run=run: run for key, run in peers.items()}, settings,
                   target=1.0, scale=1e6 / n)


def _eager(module: _Module) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return a step of the descent with autograd."""
    def step(z: torch.Tensor) -> torch.Tensor:
        z.requires_grad_()
        (slope,) = torch.autograd.grad(module(z[None]).sum(), z)
        return z.detach() - RATE * slope
    return step


def _compiled(module: _Module) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return a step of the descent, compiled as a whole."""
    slope = torch.func.grad(lambda z: module(z[None]).sum())

    @torch.compile
    def step(z: torch.Tensor) -> torch.Tensor:
        return z - RATE * slope(z)
    return step


def _torch_loop(step: Callable[[torch.Tensor], torch.Tensor], start: list[float], n: int
                ) -> Callable[[], np.ndarray]:
    def run() -> np.ndarray:
        z = torch.tensor(start, dtype=torch.float64)
        for _ in range(n):
            z = step(z)
        return z.numpy()
    return run
