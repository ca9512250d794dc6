# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian that is a graph of operations, such as an exported torch module."""

from functools import cached_property
from typing import Any, NamedTuple

from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.derivatives import dependence, gradient, tangent
from hnn_vi_ros.models.graphs.graph import varied
from hnn_vi_ros.models.graphs.operations import KINKED
from hnn_vi_ros.models.graphs.tape import Assembler, Tape
from hnn_vi_ros.models.learned import LearnedHamiltonian
import numpy as np


class _Plan(NamedTuple):
    """Tapes of H, its gradient and Hessian-vector product, with the memory that they share."""

    assembler: Assembler
    tapes: tuple[Tape, Tape, Tape]
    separable: bool


class GraphHamiltonian(LearnedHamiltonian):
    """
    H(q, p) as a graph of operations; its derivatives are graphs as well.

    It takes any function of tensors: networks of all shapes, sums over bodies, attention. For a
    multilayer perceptron the family ``hnn`` takes less time a step. Weights are not parameters of
    gradients, and it does not run on a GPU.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family ``graph``.

    """

    def __init__(self, checkpoint: Checkpoint):
        super().__init__(checkpoint)
        assert checkpoint.graph is not None, 'checked when it was loaded'
        b, output = checkpoint.graph
        self.smooth = not KINKED.intersection(b.nodes[k].op for k in varied(b.nodes, output))
        self.separable = self._plan.separable

    @cached_property
    def _plan(self) -> _Plan:
        assert self.checkpoint.graph is not None, 'checked when it was loaded'
        b, output = self.checkpoint.graph
        d = self.dimension
        x, v = b.input(2 * d), b.input(2 * d, 1)
        slopes = gradient(b, output, x)
        product = tangent(b, slopes, x, v)
        assembler = Assembler(b, [x, v])
        first, second, third = (assembler.tape(k) for k in (output, slopes, product))
        depends = dependence(b, slopes, x)
        return _Plan(assembler, (first, second, third), not (
            depends[:d, d:].any() or depends[d:, :d].any()))

    def _kernel(self) -> Kernel:
        # Imported lazily: it compiles.
        from hnn_vi_ros.models.graphs import machine
        assembler, tapes, _ = self._plan
        places: Any = np.array([*(tape.place for tape in tapes), self.dimension], dtype=np.uint64)
        return self._kernel_of(
            machine.energy, machine.gradient, machine.hessian_vector, machine.GraphParameters(
                assembler.memory(), assembler.index(), tapes[0].code, tapes[1].code,
                tapes[2].code, places))
