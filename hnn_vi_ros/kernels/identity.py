# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Identity of the processor and the libraries, on which the last bits of a run depend."""

from functools import cache
from hashlib import sha256
from importlib.metadata import version
import platform
import sys

from hnn_vi_ros.kernels.sources import sources
from hnn_vi_ros.version import __version__
from llvmlite import binding

# torch counts only where it computes.
_LIBRARIES = ('numpy', 'scipy', 'numba', 'llvmlite')


def identity() -> dict[str, str]:
    """Return what two runs must have in common to agree bit by bit, by name."""
    torch = {'torch': version('torch')} if 'torch' in sys.modules else {}
    return _fixed() | torch


@cache
def _fixed() -> dict[str, str]:
    features = sha256(binding.get_host_cpu_features().flatten().encode()).hexdigest()
    return {
        'hnn_vi_ros': __version__, 'sources': sources(), 'python': platform.python_version(),
        **{name: version(name) for name in _LIBRARIES},
        'machine': platform.machine(), 'processor': binding.get_host_cpu_name(),
        'processor_features': features[:16]}
