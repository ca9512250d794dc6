# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiler's part of workspaces; apart, since a scene is read without one."""

from collections.abc import Callable
from typing import Any

from hnn_vi_ros.integrators.workspaces import forget, MemoryByAddress
from hnn_vi_ros.kernels.blocks import clear
from hnn_vi_ros.kernels.linking import LINK_ONLY
from numba.core import types
from numba.extending import overload


def compile_forget(memory: Any) -> Callable[[Any], None]:
    """Return forget for one type of memory, whose workspaces are each of a type of its own."""
    def forget_first(memory: Any) -> None:
        memory[0].kept.count[0] = 0
        forget(memory[1:])

    def forget_by_address(memory: Any) -> None:
        counts = memory[0].counts
        for k in range(counts.size):
            clear(counts[k])
        forget(memory[1:])

    def forget_rest(memory: Any) -> None:
        forget(memory[1:])

    def forget_none(memory: Any) -> None:
        pass

    if not len(memory):
        return forget_none
    if getattr(memory[0], 'instance_class', None) is MemoryByAddress:
        return forget_by_address
    return forget_first if _counts(memory[0]) else forget_rest


def _counts(workspace: types.Type) -> bool:
    fields = getattr(workspace, 'fields', ())
    return 'kept' in fields and 'count' in getattr(
        workspace[fields.index('kept')], 'fields', ())


overload(forget, jit_options={'forceinline': True, **LINK_ONLY})(compile_forget)
