# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian that is a graph of operations, such as an exported torch module."""

from hnn_vi_ros.hamiltonians import is_continuous
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.derivatives import dependence, gradient, tangent
from hnn_vi_ros.models.graphs.family_graphs import family_graph
from hnn_vi_ros.models.graphs.graph import Builder, graph_data, GraphNetwork, read_graph, varied
from hnn_vi_ros.models.graphs.operations import SWITCHES
from hnn_vi_ros.models.graphs.perceptrons import fused, whole_perceptron
from hnn_vi_ros.models.graphs.tape import Assembler, program, Tape
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.perceptron_memory import pack
import numpy as np

# Numbers of switches and of lines in the box on which kinks are sought.
_MAX_SWITCHES, _LINES = 64, 64


class GraphHamiltonian(LearnedHamiltonian):
    """
    H(q, p) as a graph of operations; its derivatives are graphs as well.

    It takes any function of tensors: networks of all shapes, sums over bodies, attention. Chains
    of dense layers run as one operation each; if H is one, it runs as a model of the family
    ``hnn``. Weights are not parameters of gradients, and it does not run on a GPU.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model with a graph, or of a family of ``family_graph``.

    """

    def __init__(self, checkpoint: Checkpoint):
        super().__init__(checkpoint)
        self._graph, self._times = family_graph(checkpoint), checkpoint.card.box.t
        if self._times is not None:
            self.time = np.zeros(2)
            self._graph = read_graph(*graph_data(*self._graph), 2 * self.dimension + 1, timed=True)
        self.separable = self._is_separable(*self._graph)
        self.smooth = self.smooth and self._is_smooth(*self._graph)

    def _is_smooth(self, b: Builder, output: int) -> bool:
        """Return whether H and its gradient are continuous where functions in it switch."""
        kinked = [b.nodes[k] for k in varied(b.nodes, output) if b.nodes[k].op in SWITCHES]
        if not kinked:
            return True
        # Imported lazily: it compiles.
        from hnn_vi_ros.models.graphs.machine import assembled, fill
        n, switches = 2 * self.dimension, b.concatenate([SWITCHES[k.op](b, k) for k in kinked])
        count, = b.shape(switches)
        some = np.arange(0, count, max(1, count // _MAX_SWITCHES))
        graph = assembled(*program(b, [b.input(n), *self._time(b)], [b.concatenate([
            output, gradient(b, output, b.input(n)), b.take(switches, some)])]), 0)
        times = [0.5 * (low + high) for low, high in self._times or ()]

        def values(z: np.ndarray) -> np.ndarray:
            found = np.empty((len(z), 1 + n + some.size))
            graph.memory[n:n + len(times)] = times
            for row, graph.memory[:n] in zip(found, z, strict=True):
                fill(graph, 0, row)
            return found
        return is_continuous(values, n + 1, self._samples(2 * _LINES).reshape(2, -1, n))

    def _is_separable(self, b: Builder, output: int) -> bool:
        d, x = self.dimension, b.input(2 * self.dimension)
        slopes = gradient(b, output, x)
        depends = dependence(b, slopes, x)
        return not (depends[:d, d:].any() or depends[d:, :d].any() or any(
            dependence(b, slopes, time)[d:].any() for time in self._time(b)))

    def _time(self, b: Builder) -> list[int]:
        """Return the input of the time, if H depends on it."""
        return [] if self.time is None else [b.input(1, 2)]

    def _kernel(self) -> Kernel:
        if 'program' not in self._shared:
            self._shared['program'] = self._program()
        program = self._shared['program']
        if isinstance(program, GraphNetwork):
            return self._kernel_of(
                perceptron.energy, perceptron.gradient, perceptron.hessian_vector,
                pack(*program.layers, program.activation))
        # Imported lazily: it compiles.
        from hnn_vi_ros.models.graphs import machine
        assembler, tapes = program
        graph = machine.assembled(assembler, tapes, self.dimension)
        if self.time is not None:
            return self._kernel_of(machine.energy_at, machine.gradient_at,
                                   machine.hessian_vector_at, (graph, self.time))
        return self._kernel_of(machine.energy, machine.gradient, machine.hessian_vector, graph)

    def _program(self) -> GraphNetwork | tuple[Assembler, list[Tape]]:
        """Return the network that H is, or the instructions for H and its derivatives."""
        b, output = fused(*self._graph)
        network = whole_perceptron(b, output) if self.time is None else None
        if network is not None:
            return network
        x, v = b.input(2 * self.dimension), b.input(2 * self.dimension, 1)
        slopes = gradient(b, output, x)
        product = tangent(b, slopes, x, v)
        if self.time is not None:
            slopes = b.concatenate([slopes, gradient(b, output, *self._time(b))])
        return program(b, [x, v, *self._time(b)], [output], [slopes], [product])
