# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of operations: loops against numpy, derivatives against differences, untrusted files."""

from collections.abc import Callable
import json
import math

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.models import Builder, graph_data, read_graph
from hnn_vi_ros.models.graphs import machine
from hnn_vi_ros.models.graphs.derivatives import dependence, gradient, tangent
from hnn_vi_ros.models.graphs.graph import MAX_PRODUCTS, needed
from hnn_vi_ros.models.graphs.operations import BINARY, SWITCHES, UNARY
from hnn_vi_ros.models.graphs.perceptrons import ACTIVATIONS, fused, whole_perceptron
from hnn_vi_ros.models.graphs.tape import Assembler
import numpy as np
import pytest

EPS = np.finfo(float).eps
# An odd length has a remainder in vectorised loops; arguments that suit every function.
X = np.random.default_rng(0).uniform(0.1, 0.9, 37)


def run(b: Builder, output: int, z: np.ndarray) -> np.ndarray:
    """Return the values of a node for these values of the input."""
    x = next(k for k, node in enumerate(b.nodes) if node.op == 'input')
    assembler = Assembler(b, [x])
    tape = assembler.tape(output)
    graph = machine.assembled(assembler, [tape], 1)
    graph.memory[:z.size] = z
    machine.run(graph, 0)
    shape = b.shape(output)
    return graph.memory[tape.place:tape.place + math.prod(shape)].reshape(shape).copy()


@pytest.mark.parametrize('op', UNARY)
def test_function_of_one_argument_is_that_of_numpy(op):
    b = Builder()
    z = X - 0.5 if op in ('sign', 'abs', 'relu', 'floor', 'ceil', 'rint', 'not', 'tanh', 'sin',
                          'cos', 'exp', 'softplus', 'sigmoid') else X
    found, expected = run(b, b.unary(op, b.input(z.size)), z), UNARY[op].values(z)
    # Two units in the last place of each, for the functions written here.
    assert np.abs(found - expected).max() <= 4.0 * EPS * np.abs(expected).max()


@pytest.mark.parametrize('op', BINARY)
def test_function_of_two_arguments_is_that_of_numpy(op):
    b = Builder()
    x, y = X[:18], X[18:36].copy()
    y[::3] = x[::3]
    input_ = b.input(36)
    parts = [b.take(input_, np.arange(k, k + 18)) for k in (0, 18)]
    found = run(b, b.binary(op, *parts), np.concatenate([x, y]))
    expected = BINARY[op].values(x, y)
    assert np.abs(found - expected).max() <= 2.0 * EPS * np.abs(expected).max()


@pytest.mark.parametrize('t_x', [False, True])
@pytest.mark.parametrize('t_y', [False, True])
@pytest.mark.parametrize('shape', [(1, 3, 32), (1, 32, 1), (5, 9, 17), (2, 4, 11, 3)])
def test_product_of_matrices_is_that_of_numpy(shape, t_x, t_y):
    *stack, rows, inner, columns = shape
    rng, b = np.random.default_rng(1), Builder()
    x, y = rng.normal(size=(*stack, rows, inner)), rng.normal(size=(*stack, inner, columns))
    one, other = (np.swapaxes(x, -1, -2) if t_x else x), (np.swapaxes(y, -1, -2) if t_y else y)
    input_ = b.input(x.size + y.size)
    found = run(b, b.matmul(
        b.take(input_, np.arange(x.size).reshape(one.shape)),
        b.take(input_, np.arange(x.size, x.size + y.size).reshape(other.shape)), t_x, t_y),
        np.concatenate([one.ravel(), other.ravel()]))
    assert np.abs(found - x @ y).max() <= inner * EPS * (np.abs(x) @ np.abs(y)).max()


@pytest.mark.parametrize('axes', [(0,), (1,), (2,), (0, 2), (1, 2), (0, 1, 2)])
def test_sum_and_largest_value_are_those_of_numpy(axes):
    z = np.random.default_rng(2).normal(size=(3, 4, 5))
    for op, values in (('sum', np.sum), ('amax', np.max)):
        b = Builder()
        x = b.reshape(b.input(z.size), z.shape)
        found = run(b, getattr(b, op)(x, axes), z.ravel())
        assert found == pytest.approx(values(z, axis=axes), rel=0.0, abs=z.size * EPS * 4.0)


def mixed(b: Builder, x: int) -> int:
    """Return a number of six values that uses every structural operation."""
    rng = np.random.default_rng(3)
    rows = b.matmul(b.reshape(x, (2, 3)), b.constant(rng.normal(size=(4, 3))), t_y=True)
    square = b.matmul(rows, rows, t_x=True)
    taken = b.take(b.unary('tanh', square), np.array([0, 5, 5, 10, 3]))
    put = b.put(taken, np.array([0, 1, 1, 2, 2]), (3,))
    joined = b.concatenate([put, b.amax(rows, (1,)), b.sum(b.unary('sin', rows), (0,))])
    weighted = b.mul(joined, b.unary('exp', b.unary('neg', joined)))
    return b.sum(weighted, (0,))


def differences(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """Return derivatives by central differences, of error about h^2 and EPS / h."""
    h = EPS**(1 / 3)
    return np.array([(function(z + h * e) - function(z - h * e)) / (2.0 * h)
                     for e in np.eye(z.size)])


def test_gradient_is_the_derivative_of_a_graph():
    b = Builder()
    x, z = b.input(6), np.random.default_rng(4).normal(size=6)
    output = mixed(b, x)
    slopes = gradient(b, output, x)
    expected = differences(lambda z: run(b, output, z), z).ravel()
    # Truncation and rounding of the differences, both of size EPS^(2/3).
    assert run(b, slopes, z) == pytest.approx(expected, abs=1e3 * EPS**(2 / 3))


def test_tangent_of_the_gradient_is_the_hessian_times_a_vector():
    b = Builder()
    x, z, v = b.input(6), *np.random.default_rng(5).normal(size=(2, 6))
    slopes = gradient(b, mixed(b, x), x)
    along = tangent(b, slopes, x, b.constant(v))
    expected = v @ differences(lambda z: run(b, slopes, z), z)
    assert run(b, along, z) == pytest.approx(expected, abs=1e4 * EPS**(2 / 3))


@pytest.mark.parametrize(
    'op', [op for op in UNARY if op not in SWITCHES.keys() | {'not', 'fixed'}])
def test_slope_of_every_smooth_function_is_its_derivative(op):
    b = Builder()
    x, z = b.input(5), X[:5]
    slope = UNARY[op].slope(b, x, b.unary(op, x))
    expected = np.diag(differences(UNARY[op].values, z))
    assert run(b, slope, z) == pytest.approx(expected, rel=1e4 * EPS**(2 / 3))


@pytest.mark.parametrize('op', ['maximum', 'minimum'])
def test_slopes_of_the_larger_and_smaller_value_are_derivatives(op):
    b, z = Builder(), np.array([1.0, 3.0])
    x = b.input(2)
    found = b.binary(op, *(b.take(x, np.array([k])) for k in (0, 1)))
    assert run(b, gradient(b, found, x), z).tolist() == [op == 'minimum', op == 'maximum']


def test_slopes_of_powers_at_zero_are_finite():
    b = Builder()
    x = b.input(4)
    powers = b.binary('pow', x, b.constant(np.arange(4.0)))
    slopes = gradient(b, b.sum(powers, (0,)), x)
    assert run(b, slopes, np.zeros(4)).tolist() == [0.0, 1.0, 0.0, 0.0]
    along = tangent(b, slopes, x, b.constant(np.ones(4)))
    assert run(b, along, np.zeros(4)).tolist() == [0.0, 0.0, 2.0, 0.0]


def dense(b: Builder, x: int, outputs: int, seed: int) -> int:
    """Return a dense layer of a row, with weights and biases of the usual size."""
    (_, inputs), rng = b.shape(x), np.random.default_rng(seed)
    y = b.matmul(x, b.constant(rng.normal(size=(outputs, inputs)) / inputs**0.5), t_y=True)
    return b.add(y, b.constant(rng.normal(size=(1, outputs))))


def network(b: Builder, x: int, activation: str, outputs: int) -> int:
    """Return a network of two hidden layers, with scaled inputs and outputs, of a row."""
    inputs = b.shape(x)[1]
    y = b.div(b.sub(x, b.constant(np.full((1, inputs), 0.3))), b.constant(
        np.full((1, inputs), 1.7)))
    for k, width in enumerate((9, 12)):
        y = b.unary(activation, dense(b, y, width, k))
    y = dense(b, y, outputs, 2)
    return b.mul(y, b.full(y, 2.5))


def count(b: Builder, output: int) -> int:
    """Return the number of perceptrons that a node depends on."""
    return sum(b.nodes[k].op == 'perceptron' for k in needed(b.nodes, [output]))


def product_of_networks(b: Builder, x: int, activation: str) -> int:
    """Return a function of four values by two networks whose outputs and inputs are used twice."""
    row = b.reshape(x, (1, 4))
    y = network(b, b.take(row, np.array([[0, 1, 3]])), activation, 3)
    z = network(b, b.mul(row, row), activation, 4)
    weighted = b.mul(b.take(y, np.array([[0, 1, 2, 0]])), b.unary('sin', b.mul(z, row)))
    return b.sum(b.mul(weighted, b.take(y, np.array([[2, 0, 1, 1]]))), (0, 1))


@pytest.mark.parametrize('activation', ACTIVATIONS)
def test_fused_perceptrons_have_the_values_and_derivatives_of_their_layers(activation):
    b, rng = Builder(), np.random.default_rng(6)
    z, v = rng.normal(size=(2, 4))
    output = product_of_networks(b, b.input(4), activation)
    both = [(b, output), fused(b, output)]
    assert [count(*graph) for graph in both] == [0, 2]
    for one, other in zip(*(evaluations(*graph, z, v) for graph in both), strict=True):
        # Sums of up to 12 products in another order, in some ten operations one after another.
        assert one == pytest.approx(other, rel=0.0, abs=100.0 * EPS * np.abs(one).max())


def evaluations(b: Builder, output: int, z: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    """Return the value, the gradient, and the Hessian times v."""
    x = b.input(z.size)
    slopes = gradient(b, output, x)
    return [run(b, k, z) for k in (output, slopes, tangent(b, slopes, x, b.constant(v)))]


def test_only_chains_of_layers_that_nothing_else_uses_are_fused():
    b = Builder()
    row = b.reshape(b.input(4), (1, 4))
    residual = b.add(row, b.unary('tanh', dense(b, row, 4, 0)))
    mixed_up = dense(b, b.unary('tanh', dense(b, b.unary('sin', dense(b, row, 4, 1)), 4, 2)), 1, 3)
    shared = b.unary('tanh', dense(b, row, 4, 4))
    for output, expected in ((b.sum(b.mul(residual, residual), (0, 1)), 0),
                             (b.add(dense(b, shared, 4, 5), b.mul(shared, shared)), 0),
                             # The last layer of the first network is the first of another one.
                             (mixed_up, 1)):
        assert count(*fused(b, output)) == expected


def test_layers_of_several_rows_are_not_one_larger_matrix():
    b = Builder()
    rows = b.reshape(b.input(6), (3, 2))
    weights = b.constant(np.ones((16, 2)))
    hidden = b.unary('tanh', b.matmul(rows, weights, t_y=True))
    output = b.sum(b.matmul(hidden, b.constant(np.ones((16, 1)))), (0, 1))
    assert count(*fused(b, output)) == 0


def test_graph_that_is_one_perceptron_is_recognised():
    b = Builder()
    x = b.input(4)
    output = b.reshape(network(b, b.reshape(x, (1, 4)), 'tanh', 1), ())
    found = whole_perceptron(*fused(b, output))
    assert found is not None
    assert found.layers.widths == [4, 9, 12, 1]
    assert whole_perceptron(*fused(b, b.mul(output, output))) is None


def test_constant_number_keeps_its_shape():
    b = Builder()
    assert b.shape(b.constant(np.array(2.0))) == ()


def test_dependence_shows_that_a_sum_of_kinetic_and_potential_energy_is_separable():
    b = Builder()
    x = b.input(4)
    q, p = b.take(x, np.arange(2)), b.take(x, np.arange(2, 4))
    kinetic, potential = b.sum(b.mul(p, p), (0,)), b.sum(b.unary('cos', q), (0,))
    together = dependence(b, gradient(b, b.add(kinetic, potential), x), x)
    product = dependence(b, gradient(b, b.mul(kinetic, potential), x), x)
    assert not together[:2, 2:].any() and not together[2:, :2].any()
    assert product[:2, 2:].all() and product[2:, :2].all()


def test_graph_is_the_same_after_it_was_written_and_read():
    b = Builder()
    output, z = mixed(b, b.input(6)), np.random.default_rng(6).normal(size=6)
    data, tensors = graph_data(b, output)
    other, other_output = read_graph(json.loads(json.dumps(data)), tensors, 6)
    assert run(other, other_output, z) == run(b, output, z)


@pytest.mark.parametrize('count', [300, pytest.param(10_000, marks=pytest.mark.long)])
def test_mutated_graph_is_refused_or_runs_within_its_memory(count):
    b = Builder()
    data, tensors = graph_data(b, mixed(b, b.input(6)))
    text, rng, refused = json.dumps(data), np.random.default_rng(7), 0
    for _ in range(count):
        other, own = json.loads(text), {name: part.copy() for name, part in tensors.items()}
        for _ in range(rng.integers(1, 3)):
            mutate(other['nodes'], own, rng)
        try:
            graph, output = read_graph(other, own, 6)
        except ModelError as problem:
            refused += 1
            assert '\n' not in str(problem)
            continue
        x = next((k for k, node in enumerate(graph.nodes) if node.op == 'input'), None)
        if x is not None:
            check_places(graph, gradient(graph, output, x), x)
    assert 0.2 * count < refused < count


def test_long_chain_of_views_is_no_deep_recursion():
    b = Builder()
    output = b.sum(b.unary('sin', b.input(2)), (0,))
    for _ in range(5000):
        output = b.unary('fixed', output)
    z = np.array([0.5, 1.0])
    data, tensors = graph_data(b, output)
    graph, last = read_graph(data, tensors, 2)
    assert run(graph, last, z) == pytest.approx(np.sin(z).sum(), rel=4.0 * EPS)
    slopes = gradient(graph, last, next(
        k for k, node in enumerate(graph.nodes) if node.op == 'input'))
    assert not run(graph, slopes, z).any()


def test_node_of_very_many_inputs_is_refused():
    rows = [['input', [2]], ['concatenate', *200_000 * [0]], ['sum', 1, [0]]]
    with pytest.raises(ModelError, match='entries'):
        read_graph({'version': 1, 'nodes': rows}, {}, 2)


def test_small_file_that_multiplies_for_hours_is_refused_with_the_limit():
    rows = [['constant', 'c'], ['put', 0, 'i', [1 << 22]], ['reshape', 1, [2048, 2048]],
            ['matmul', 2, 2, [0, 0]], ['sum', 3, [0, 1]]]
    with pytest.raises(ModelError, match=f'over {MAX_PRODUCTS} multiplications'):
        read_graph({'version': 1, 'nodes': rows}, {
            'c': np.ones(1), 'i': np.zeros(1, dtype=np.int64)}, 2)


def test_parts_of_parts_are_no_deep_recursion():
    rows = [['input', [2]], *(['concatenate', k, 0] for k in range(3000)), ['take', 3000, 'i'],
            ['sum', 3001, [0]]]
    b, output = read_graph({'version': 1, 'nodes': rows}, {'i': np.array([0, 1])}, 2)
    assert run(b, output, np.array([0.5, 1.0])) == 1.5


def test_long_chain_of_powers_is_planned_in_few_places():
    b = Builder()
    output = b.sum(b.input(2), (0,))
    for _ in range(1000):
        output = b.binary('pow', b.unary('cosh', output), output)
    x = 0
    along = tangent(b, gradient(b, output, x), x, b.input(2, 1))
    assembler = Assembler(b, [x, b.input(2, 1)])
    assembler.tape(along)
    # The gradient goes back, so that each value is kept until it is used again.
    assert assembler.memory().size < 8 * len(b.nodes)


def test_tape_uses_what_the_one_before_it_has_computed():
    b, z = Builder(), np.random.default_rng(5).normal(size=6)
    x, factor = b.input(6), b.input(1, 1)
    value = mixed(b, x)
    slopes = gradient(b, value, x)
    scaled = b.mul(slopes, b.broadcast(factor, (6,)))
    assembler = Assembler(b, [x, factor])
    first, second = assembler.tapes([value, scaled])
    graph = machine.assembled(assembler, [first, second], 6)
    memory = graph.memory
    memory[:6] = z
    machine.run(graph, 0)
    # An input of the second tape only, which is known after the first.
    memory[6] = memory[first.place]
    machine.run(graph, 1)
    assert len(second.code) < len(Assembler(b, [x, factor]).tape(scaled).code)
    # The same instructions in other places.
    assert np.array_equal(memory[second.place:second.place + 6], run(b, slopes, z) * run(
        b, value, z))


def mutate(nodes: list, tensors: dict, rng: np.random.Generator) -> None:
    """Change one entry of a graph or one value of a tensor."""
    if rng.random() < 0.3:
        part = tensors[[*tensors][rng.integers(len(tensors))]]
        part.flat[rng.integers(part.size)] = rng.choice([-1, 0, 3, 2**31, 2**62])
        return
    row = nodes[rng.integers(len(nodes))]
    k = int(rng.integers(len(row)))
    ops = [*UNARY, *BINARY, 'take', 'put', 'sum', 'matmul', 'reshape', 'input', 'constant']
    row[k] = [str(rng.choice(ops)), int(rng.integers(-2, 30)), [int(rng.integers(5))], [1, 2, 3],
              None, 1.5, [2**40], 'tensor1'][rng.integers(8)]


def check_places(b: Builder, output: int, x: int) -> None:
    """Assert that no instruction reads or writes outside of memory, and run them."""
    assembler = Assembler(b, [x])
    tape = assembler.tape(output)
    graph = machine.assembled(assembler, [tape], 1)
    for code in tape.code.astype(int):
        assert (code >= 0).all() and code[1] < graph.memory.size
    machine.run(graph, 0)
    assert tape.place + math.prod(b.shape(output)) <= graph.memory.size
