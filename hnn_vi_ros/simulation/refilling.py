# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels by address that are given other numbers where they stand."""

from typing import Any

from hnn_vi_ros.kernels.addresses import original, provide, Target
from hnn_vi_ros.kernels.blocks import Block, flat
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.value_types import kind_of


def refill(kernel: Kernel, other: Kernel) -> bool:
    """
    Let a kernel by address have the parameters of another one, where it stands.

    Parameters
    ----------
    kernel : Kernel
        From ``by_address``; what runs it finds the other numbers.
    other : Kernel
        Of a Hamiltonian that differs in numbers alone, by address or not.

    Returns
    -------
    bool
        False, and nothing has changed, where more than that differs or nothing is by address.

    """
    if not isinstance(kernel.parameters, Target):
        return False
    memory: Any = Block.of(kernel.parameters.words)
    own, other = memory.kernel, original(other)
    if own[:3] != other[:3] or own[4:] != other[4:] \
            or kind_of(own.parameters) != kind_of(other.parameters):
        return False
    kernel.parameters.words[3:] = flat(other.parameters)
    memory.kernel = other
    # And what it calls by address in its turn.
    provide(kernel, *memory.entries)
    return True
