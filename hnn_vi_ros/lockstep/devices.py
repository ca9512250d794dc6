# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Device that a lockstep ensemble is computed on, and the kernels that it is computed by."""

from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
import os
from typing import Any

from hnn_vi_ros.errors import ParameterError
import torch

VALID = 'cpu, cuda, cuda:N; each may end in /fused or /steps, kernels in Triton'
# What computes the gradients, or takes the steps; see docs/scale.md.
TORCH, FUSED, STEPS = 'torch', 'fused', 'steps'
# The one that torch 2.13 brings; products in float64 of later ones do not fit the tensor cores.
TRITON = '3.7.1'
# Runs of what is to be captured, before it is: libraries allocate in the first.
_WARM_UP = 3


def open_device(name: str) -> torch.device:
    """
    Return a device that is there.

    Parameters
    ----------
    name : str
        ``'cpu'``, ``'cuda'``, or ``'cuda:N'`` for the N-th GPU, counted from 0; and the kernels,
        see ``kernels_of``.

    Raises
    ------
    ValueError
        Another name.
    ParameterError
        There is no such GPU, or Triton does not run its kernels.

    """
    place, kernels = name.partition('/')[0], kernels_of(name)
    kind, _, number = place.partition(':')
    if place != 'cpu' and (kind != 'cuda' or (place != 'cuda' and not number.isdecimal())):
        raise ValueError(f'device = {name!r} is not known; valid: {VALID}')
    if kernels != TORCH:
        _check_triton(name, kind)
    if kind == 'cuda':
        there = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if int(number or 0) >= there:
            raise ParameterError(
                f'device = {name}: torch {torch.__version__} finds {there or "no"} CUDA '
                f'device{"s" * (there != 1)}; take device = cpu, or leave device out for the '
                'compiled loops; a GPU takes its driver and a torch built for CUDA')
    return torch.device(place)


def kernels_of(name: str) -> str:
    """
    Return the kernels that the name of a device asks for.

    TORCH, without an end to it; FUSED for two kernels that take a gradient, of ``/fused``; or
    STEPS for one that takes many steps, of ``/steps``. What cannot be computed by these is
    refused: the same name is always the same arithmetic.

    Raises
    ------
    ValueError
        Other kernels.

    """
    _, cut, kernels = name.partition('/')
    if cut and kernels not in (FUSED, STEPS):
        raise ValueError(f'device = {name!r} is not known; valid: {VALID}')
    return kernels or TORCH


def _check_triton(name: str, kind: str) -> None:
    """Check that the kernels in Triton run."""
    plain = name.partition('/')[0]
    try:
        found = version('triton')
    except PackageNotFoundError:
        found = 'no version'
    if found != TRITON:
        raise ParameterError(
            f'device = {name}: its kernels take triton {TRITON}, which a torch for CUDA brings, '
            f'and {found} is installed; take device = {plain}, or pip install triton=={TRITON}')
    # Triton reads it when it is imported.
    if kind == 'cpu' and os.environ.get('TRITON_INTERPRET') != '1':
        raise ParameterError(
            f'device = {name}: on the processor these kernels run in the interpreter of Triton '
            f'alone, slowly, for tests: set TRITON_INTERPRET=1, or take device = {plain}')
    if kind == 'cuda' and os.environ.get('TRITON_INTERPRET') == '1':
        raise ParameterError(f'device = {name}: TRITON_INTERPRET=1 is for the processor; unset it')


def description(name: str) -> dict[str, str]:
    """Return what the last digits of results on a device depend on, beside the sweep."""
    device = open_device(name)
    found = {'kind': device.type, 'torch': torch.__version__}
    if device.type == 'cuda':
        found |= {'name': torch.cuda.get_device_name(device), 'cuda': str(torch.version.cuda)}
    if (kernels := kernels_of(name)) != TORCH:
        found |= {'kernels': kernels, 'triton': TRITON}
    return found


def captured(run: Callable[[], None], device: torch.device) -> Callable[[], Any]:
    """
    Return what repeats a run on the same arrays: on a GPU a CUDA graph, launched as a whole.

    Parameters
    ----------
    run : callable
        Works on arrays that stay where they are, and waits for nothing.
    device : torch.device
        Of the arrays.

    """
    if device.type != 'cuda':
        return run
    stream = torch.cuda.Stream(device)
    stream.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(stream):
        for _ in range(_WARM_UP):
            run()
    torch.cuda.current_stream(device).wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    # On a stream of this device: the default one is of whichever device captured first.
    with torch.cuda.device(device), torch.cuda.graph(graph, stream=stream):
        run()
    return graph.replay
