# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian that is a graph of operations, such as an exported torch module."""

from functools import cached_property
from typing import Any, NamedTuple

from hnn_vi_ros.hamiltonians import is_continuous
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.derivatives import dependence, gradient, tangent
from hnn_vi_ros.models.graphs.graph import Builder, varied
from hnn_vi_ros.models.graphs.operations import SWITCHES
from hnn_vi_ros.models.graphs.tape import Assembler, Tape
from hnn_vi_ros.models.learned import LearnedHamiltonian
import numpy as np

# Numbers of switches and of lines in the box on which kinks are sought.
_MAX_SWITCHES, _LINES = 64, 64


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
        self.separable, self.smooth = self._plan.separable, self._is_smooth(*checkpoint.graph)

    def _is_smooth(self, b: Builder, output: int) -> bool:
        """Return whether H and its gradient are continuous where functions in it switch."""
        kinked = [b.nodes[k] for k in varied(b.nodes, output) if b.nodes[k].op in SWITCHES]
        if not kinked:
            return True
        # Imported lazily: it compiles.
        from hnn_vi_ros.models.graphs.machine import run
        n, switches = 2 * self.dimension, b.concatenate([SWITCHES[k.op](b, k) for k in kinked])
        count, = b.shape(switches)
        some = np.arange(0, count, max(1, count // _MAX_SWITCHES))
        assembler = Assembler(b, [b.input(n)])
        tape = assembler.tape(b.concatenate([
            output, gradient(b, output, b.input(n)), b.take(switches, some)]))
        memory, index, end = assembler.memory(), assembler.index(), tape.place + 1 + n + some.size

        def values(z: np.ndarray) -> np.ndarray:
            found = np.empty((len(z), end - tape.place))
            for row, memory[:n] in zip(found, z, strict=True):
                run(tape.code, memory, index)
                row[:] = memory[tape.place:end]
            return found
        return is_continuous(values, n + 1, self._samples(2 * _LINES).reshape(2, -1, n))

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
