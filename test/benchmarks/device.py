# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Gradients and steps on a device, by products of torch and by the kernels in Triton.

    python -m benchmarks.device [DEVICE] [--quick]

Prints tables in Markdown, with the device and the versions: as docs/scale.md is to hold.
On the processor (``cpu``) the kernels run in Triton's interpreter, and times mean nothing.
"""

import argparse
from collections.abc import Callable, Iterator
from itertools import pairwise
import json
import time

from helpers import random_checkpoint
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.lockstep.devices import description, FUSED, open_device, STEPS, TORCH
from hnn_vi_ros.lockstep.ensemble import LockstepEnsemble
from hnn_vi_ros.lockstep.gradient import make_gradient
from hnn_vi_ros.models.neural import NeuralHamiltonian
import numpy as np
import torch

SEED = 5
# Peak of the FP64 tensor cores of one H100 or H200 (SXM) [flop/s], as NVIDIA states it.
PEAK = 66.9e12
_WIDTHS, _BATCHES, _REPETITIONS = (32, 64, 128, 200, 256), (1024, 8192, 131072), 11
_H, _STEPS, _METHODS = 0.05, 100, ('variational_euler', 'generalized_leapfrog')
# Of the interpreter: one block and a part of one.
_QUICK_WIDTHS, _QUICK_BATCH, _QUICK_STEPS = (32,), 12, 1


def flops(widths: list[int]) -> int:
    """Return the useful operations of a gradient: of its products, forward and back."""
    inner = sum(a * b for a, b in pairwise(widths[:-1]))
    return 2 * 2 * inner


def gradients(device: str, widths: tuple[int, ...], batches: tuple[int, ...], repetitions: int
              ) -> Iterator[str]:
    """Yield the rows of gradients of 2-n-n-1."""
    yield ('| network | states | torch | fused | fused over torch | useful flop/s of the faster | '
           'of the FP64 tensor peak | largest difference |')
    yield '|---|---|---|---|---|---|---|---|'
    place = open_device(device)
    for width in widths:
        layers = [2, width, width, 1]
        hamiltonian = NeuralHamiltonian(random_checkpoint(layers, SEED))
        paths = {kernels: make_gradient(hamiltonian, place, kernels) for kernels in (TORCH, FUSED)}
        for m in batches:
            z = torch.from_numpy(np.random.default_rng(SEED).uniform(-1.0, 1.0, (2, m))).to(place)
            plain, fused = (paths[kernels](z) for kernels in (TORCH, FUSED))
            difference = float((fused - plain).abs().max() / plain.abs().max())
            first, second = _medians(
                place, [lambda path=path: path(z) for path in paths.values()], repetitions)
            rate = flops(layers) * m / min(first, second)
            yield (f'| 2-{width}-{width}-1 | {m} | {1e6 * first:.4g} us | {1e6 * second:.4g} us | '
                   f'{second / first:.2f} | {rate / 1e12:.3g} T | {rate / PEAK:.2g} | '
                   f'{difference:.1e} |')


def steps(device: str, widths: tuple[int, ...], batches: tuple[int, ...], count: int,
          repetitions: int) -> Iterator[str]:
    """Yield the rows of steps of 2-n-n-1, by each of the kernels that take it."""
    yield ('| network, method, trajectories | torch | fused | many steps a launch | '
           'largest difference from torch, a step |')
    yield '|---|---|---|---|---|'
    for width in widths:
        hamiltonian = NeuralHamiltonian(random_checkpoint([2, width, width, 1], SEED))
        for method in _METHODS:
            for m in batches:
                q, p = np.random.default_rng(SEED).uniform(-1.0, 1.0, (2, m, 1))
                ends, texts = {}, {}
                for kernels in (TORCH, FUSED, STEPS):
                    name = device if kernels == TORCH else f'{device}/{kernels}'
                    try:
                        ensemble = LockstepEnsemble(hamiltonian, INTEGRATORS[method](), _H, [],
                                                    'stop', name)
                    except HnnViRosError:
                        texts[kernels] = 'not for this network'
                        continue
                    found = ensemble.record(q, p, [count])
                    ends[kernels] = np.hstack([found.q[0], found.p[0]])
                    seconds, = _medians(open_device(device), [
                        lambda ensemble=ensemble: ensemble.record(q, p, [count])], repetitions)
                    texts[kernels] = f'{m * count / seconds / 1e6:.3g} M steps/s'
                difference = max(np.nanmax(np.abs(end - ends[TORCH])) for end in ends.values())
                yield (f'| 2-{width}-{width}-1, `{method}`, {m} | '
                       + ' | '.join(texts.values()) + f' | {difference / count:.1e} |')


def _medians(device: torch.device, runs: list[Callable[[], object]], repetitions: int
             ) -> list[float]:
    """Return the median time of each run [s], by turns."""
    def wait() -> None:
        if device.type == 'cuda':
            torch.cuda.synchronize(device)
    times = np.empty((repetitions, len(runs)))
    for turn in times:
        for i, run in enumerate(runs):
            wait()
            start = time.perf_counter()
            run()
            wait()
            turn[i] = time.perf_counter() - start
    return np.median(times, axis=0).tolist()


def main(argv: list[str] | None = None) -> None:
    """Print the tables of a device."""
    parser = argparse.ArgumentParser(prog='benchmarks.device', description=__doc__)
    parser.add_argument('device', nargs='?', default='cuda', help='cuda, cuda:N or cpu')
    parser.add_argument('--quick', action='store_true', help='little of all, to see that it works')
    arguments = parser.parse_args(argv)
    device, quick = arguments.device, arguments.quick
    widths, batches, repetitions = ((_QUICK_WIDTHS, (_QUICK_BATCH,), 1) if quick else
                                    (_WIDTHS, _BATCHES, _REPETITIONS))
    try:
        print(json.dumps(description(f'{device}/{STEPS}')), end='\n\n')
    except HnnViRosError as problem:
        raise SystemExit(str(problem)) from problem
    for line in gradients(device, widths, batches, repetitions):
        print(line, flush=True)
    print()
    for line in steps(device, widths, batches[-1:], _QUICK_STEPS if quick else _STEPS,
                      min(repetitions, 3)):
        print(line, flush=True)


if __name__ == '__main__':
    main()
