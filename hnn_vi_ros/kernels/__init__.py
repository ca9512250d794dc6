# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compile numerical functions with numba, and cache them on disk by content.

A ``Kernel`` contains the compiled functions of a Hamiltonian; ``addresses`` and ``linking`` let
compiled functions call each other without being compiled as a whole. No formulas are here.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.kernels.addresses import (
        by_address, energy, gradient, hessian_vector, original, provide, provide_all,
        provide_for, Target)
    from hnn_vi_ros.kernels.blocks import (
        address_of, array_at, bare, Block, block, check_words, clear, entry_caller, flat, kind_of,
        load, row_multiplier, type_of)
    from hnn_vi_ros.kernels.compilation import (
        announced, compiled, compiled_loop, compiled_options, composed, dispatcher, entry_point,
        functions_of, kept, kept_only, name_stably, NotKept)
    from hnn_vi_ros.kernels.kernel import (
        Energy, Functions, Gradient, HessianVector, Kernel, Parameters)
    from hnn_vi_ros.kernels.linear_algebra import (
        DEPENDENT, factorise, factorise_rows, invert, solve_cholesky, solve_factorised,
        solve_in_order, solve_linear, solve_lower, solve_upper)
    from hnn_vi_ros.kernels.linking import LINK_ONLY, Part, part, Whole
    from hnn_vi_ros.kernels.marks import called, inlined, is_own
    from hnn_vi_ros.kernels.object_files import (
        entry_address, object_code, processor, symbol_at, symbol_of)
    from hnn_vi_ros.kernels.sources import digest_of, identity, reached

__getattr__, __dir__ = lazy_exports(__name__)
