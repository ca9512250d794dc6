# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Device that a lockstep ensemble is computed on."""

from collections.abc import Callable
from typing import Any

from hnn_vi_ros.errors import ParameterError
import torch

VALID = 'cpu, cuda, cuda:N'
# Runs before the capture: libraries allocate in the first ones.
_WARM_UP = 3


def open_device(name: str) -> torch.device:
    """
    Return a device that is there.

    Parameters
    ----------
    name : str
        ``'cpu'``, ``'cuda'``, or ``'cuda:N'`` for the N-th GPU, counted from 0.

    Raises
    ------
    ValueError
        Another name.
    ParameterError
        There is no such GPU.

    """
    kind, _, number = name.partition(':')
    if name != 'cpu' and (kind != 'cuda' or (name != 'cuda' and not number.isdecimal())):
        raise ValueError(f'device = {name!r} is not known; valid: {VALID}')
    if kind == 'cuda':
        there = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if int(number or 0) >= there:
            raise ParameterError(
                f'device = {name}: torch {torch.__version__} finds {there or "no"} CUDA '
                f'device{"s" * (there != 1)}; take device = cpu, or leave device out for the '
                'compiled loops; a GPU takes its driver and a torch built for CUDA')
    return torch.device(name)


def description(name: str) -> dict[str, str]:
    """Return what the last digits of results depend on: the device and the libraries."""
    device = open_device(name)
    found = {'kind': device.type, 'torch': torch.__version__}
    if device.type == 'cuda':
        found |= {'name': torch.cuda.get_device_name(device), 'cuda': str(torch.version.cuda)}
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
