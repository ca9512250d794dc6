# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels in Triton, float64, for networks of tanh; ``fused`` and ``many_steps`` launch them.

All arrays have the trajectories along their last axis, of which each program has a block. Sums
over a layer are in the same order for each trajectory, whatever others there are.

Numbers such as 0.1 stand in arithmetic alone: ``tl.where`` would round them to float32, and so is
each float that is an argument of a launch.
"""

from hnn_vi_ros.integrators.base import IN_DOUBT, NO_CONVERGENCE, NOT_FINITE, OK
from hnn_vi_ros.integrators.equations import LEAST_SCALE
from hnn_vi_ros.integrators.solvers import GO_ON, QUICK
from hnn_vi_ros.lockstep.solvers import EPS, HOPELESS, NOISE, PATIENCE
import triton
import triton.language as tl

# Inside of kernels only such may be read.
_OK, _NO_CONVERGENCE = tl.constexpr(OK), tl.constexpr(NO_CONVERGENCE)
_NOT_FINITE, _IN_DOUBT = tl.constexpr(NOT_FINITE), tl.constexpr(IN_DOUBT)
_GO_ON, _QUICK, _PATIENCE = tl.constexpr(GO_ON), tl.constexpr(QUICK), tl.constexpr(PATIENCE)
_EPS, _LEAST_SCALE = tl.constexpr(EPS), tl.constexpr(LEAST_SCALE)
_HOPELESS, _NOISE = tl.constexpr(HOPELESS), tl.constexpr(NOISE)
_INFINITE = tl.constexpr(float('inf'))


@triton.jit
def tanh(z):
    """
    Compute tanh of z to 4 eps, by exp, or for small z a rational function.

    References
    ----------
    S. Moshier, Cephes Mathematical Library 2.8 (2000), tanh.c.

    """
    size, square = tl.abs(z), z * z
    small = size < 0.625
    top = ((-9.64399179425052238628e-1 * square - 9.92877231001918586564e1) * square
           - 1.61468768441708447952e3) * square
    bottom = (((square + 1.12811678491632931402e2) * square + 2.23548839060100448583e3) * square
              + 4.84406305325125486048e3)
    # One quotient for either.
    ratio = tl.where(small, top, -2.0) / tl.where(small, bottom, tl.exp(2.0 * size) + 1.0)
    large = 1.0 + ratio
    return tl.where(small, z + z * ratio, tl.where(z < 0.0, -large, large))


@triton.jit
def _first_layer(x, weight, bias, units, width, columns, m, INPUTS: tl.constexpr):
    """Return tanh(W_1 x + b_1) of some units, shape (units, columns); zero beyond the width."""
    there = units < width
    z = tl.load(bias + units, mask=there, other=0.0)[:, None] + tl.zeros(
        (1, columns.shape[0]), tl.float64)
    for i in tl.static_range(INPUTS):
        w = tl.load(weight + units * INPUTS + i, mask=there, other=0.0)
        z += w[:, None] * tl.load(x + i * m + columns)[None, :]
    return tanh(z)


@triton.jit
def forward(x, w1, b1, w2, b2, last, value, slope, m, n1, n2, INPUTS: tl.constexpr,
            LAST: tl.constexpr, ROWS: tl.constexpr, COLUMNS: tl.constexpr, DEPTH: tl.constexpr):
    """
    Fill two layers: tanh of the first in the prologue of the product, the second in its epilogue.

    Where the second is the last one, its slope is w f'(Z_2), and its value is not stored.

    Parameters
    ----------
    x : pointer, shape (INPUTS, m)
        Inputs.
    w1, b1, w2, b2, last : pointer, shape (n1, INPUTS), (n1,), (n2, n1), (n2,), (n2,)
        The two layers, and the weights of the output.
    value, slope : pointer, shape (n2, m)
        To fill with f(Z_2) and f'(Z_2).
    m, n1, n2 : int
        Columns, a multiple of COLUMNS; and the widths.
    INPUTS : int
        How many there are.
    LAST : bool
        Whether the output follows.
    ROWS, COLUMNS, DEPTH : int
        Sizes of the blocks of a product.

    """
    columns = tl.program_id(0).to(tl.int64) * COLUMNS + tl.arange(0, COLUMNS)
    for first in range(0, n2, ROWS):
        rows = first + tl.arange(0, ROWS)
        total = tl.zeros((ROWS, COLUMNS), tl.float64)
        for k in range(0, n1, DEPTH):
            units = k + tl.arange(0, DEPTH)
            w = tl.load(w2 + rows[:, None] * n1 + units[None, :],
                        mask=(rows < n2)[:, None] & (units < n1)[None, :], other=0.0)
            a = _first_layer(x, w1, b1, units, n1, columns, m, INPUTS)
            total = tl.dot(w, a, total, out_dtype=tl.float64)
        there = rows < n2
        a = tanh(total + tl.load(b2 + rows, mask=there, other=0.0)[:, None])
        at = rows[:, None] * m + columns[None, :]
        derivative = 1.0 - a * a
        if LAST:
            derivative *= tl.load(last + rows, mask=there, other=0.0)[:, None]
        else:
            tl.store(value + at, a, mask=there[:, None])
        tl.store(slope + at, derivative, mask=there[:, None])


@triton.jit
def backward(x, w1, b1, w2, slope, gradient, m, n1, n2, INPUTS: tl.constexpr, PADDED: tl.constexpr,
             ROWS: tl.constexpr, COLUMNS: tl.constexpr, DEPTH: tl.constexpr):
    """
    Fill W_1^T D_1 with D_1 = (W_2^T D_2) f'(Z_1), of which Z_1 is computed again.

    Parameters
    ----------
    x, w1, b1, w2, m, n1, n2, INPUTS, ROWS, COLUMNS, DEPTH
        See ``forward``.
    slope : pointer, shape (n2, m)
        D_2.
    gradient : pointer, shape (INPUTS, m)
        To fill.
    PADDED : int
        A power of 2, at least INPUTS and 16.

    """
    columns = tl.program_id(0).to(tl.int64) * COLUMNS + tl.arange(0, COLUMNS)
    inputs = tl.arange(0, PADDED)
    found = tl.zeros((PADDED, COLUMNS), tl.float64)
    for first in range(0, n1, ROWS):
        rows = first + tl.arange(0, ROWS)
        total = tl.zeros((ROWS, COLUMNS), tl.float64)
        for k in range(0, n2, DEPTH):
            units = k + tl.arange(0, DEPTH)
            w = tl.load(w2 + units[None, :] * n1 + rows[:, None],
                        mask=(rows < n1)[:, None] & (units < n2)[None, :], other=0.0)
            d = tl.load(slope + units[:, None] * m + columns[None, :],
                        mask=(units < n2)[:, None], other=0.0)
            total = tl.dot(w, d, total, out_dtype=tl.float64)
        a = _first_layer(x, w1, b1, rows, n1, columns, m, INPUTS)
        w = tl.load(w1 + rows[None, :] * INPUTS + inputs[:, None],
                    mask=(rows < n1)[None, :] & (inputs < INPUTS)[:, None], other=0.0)
        found = tl.dot(w, total * (1.0 - a * a), found, out_dtype=tl.float64)
    tl.store(gradient + inputs[:, None] * m + columns[None, :], found,
             mask=(inputs < INPUTS)[:, None])


@triton.jit
def _plus(x, carry, increment):
    """Add an increment by compensated summation; see ``plus`` of steps."""
    addend = increment + carry
    total = x + addend
    virtual = total - x
    return total, (x - (total - virtual)) + (addend - virtual)


@triton.jit
def _gradient(q, p, w_q, w_p, b1, w2, w2_turned, b2, last):
    """Return H_q and H_p, shape (columns,) each, of 2-n-n-1 at q and p."""
    a1 = tanh(w_q[:, None] * q[None, :] + w_p[:, None] * p[None, :] + b1[:, None])
    a2 = tanh(tl.dot(w2, a1, out_dtype=tl.float64) + b2[:, None])
    d1 = tl.dot(w2_turned, last[:, None] * (1.0 - a2 * a2), out_dtype=tl.float64)
    d1 *= 1.0 - a1 * a1
    return tl.sum(w_q[:, None] * d1, axis=0), tl.sum(w_p[:, None] * d1, axis=0)


@triton.jit
def _start(count, first, second, third, base, factor, slope, EXTRAPOLATE: tl.constexpr):
    """Return where an equation starts; see ``extrapolated`` of steps."""
    x = base + factor * slope
    if EXTRAPOLATE:
        x = tl.where(count == 1, base + first, x)
        x = tl.where(count == 2, base + (2.0 * first - second), x)
        x = tl.where(count == 3, base + (3.0 * (first - second) + third), x)
    return x


@triton.jit
def _judge(k, residual, previous, slow, MOST: tl.constexpr, CONNECTED: tl.constexpr):
    """Return the outcome of the k-th iterate, or GO_ON; see ``solve`` and ``System.solve``."""
    bound = 8 * _EPS
    solved = (residual <= _EPS) | (
        (residual <= bound) & ((residual >= previous) | (k == MOST)))
    lost = (k == MOST) | (
        (k > _PATIENCE) & (residual > 0.5 * previous) & (residual > _HOPELESS))
    outcome = tl.where(solved, _OK, tl.where(lost, _NO_CONVERGENCE, _GO_ON))
    if CONNECTED:
        outcome = tl.where(solved & (k >= 3) & ((k > _QUICK) | slow), _IN_DOUBT, outcome)
    return tl.where(residual < _INFINITE, outcome, _NOT_FINITE)


@triton.jit
def _network(w1, b1, w2, b2, last, n, WIDTH: tl.constexpr):
    """Return the weights of 2-n-n-1 as ``_gradient`` takes them, filled up with zeros."""
    units = tl.arange(0, WIDTH)
    known = units < n
    both = known[:, None] & known[None, :]
    return (tl.load(w1 + 2 * units, mask=known, other=0.0),
            tl.load(w1 + 2 * units + 1, mask=known, other=0.0),
            tl.load(b1 + units, mask=known, other=0.0),
            tl.load(w2 + n * units[:, None] + units[None, :], mask=both, other=0.0),
            tl.load(w2 + n * units[None, :] + units[:, None], mask=both, other=0.0),
            tl.load(b2 + units, mask=known, other=0.0),
            tl.load(last + units, mask=known, other=0.0))


@triton.jit
def _load_rows(array, columns, m, there):
    """Return three rows of an array, shape (columns,) each."""
    return (tl.load(array + columns, there, 0.0), tl.load(array + m + columns, there, 0.0),
            tl.load(array + 2 * m + columns, there, 0.0))


@triton.jit
def _store_rows(array, columns, m, there, first, second, third):
    """Store three rows of an array, shape (columns,) each."""
    tl.store(array + columns, first, there)
    tl.store(array + m + columns, second, there)
    tl.store(array + 2 * m + columns, third, there)


@triton.jit
def _defect(value, x, base, change, rounding):
    """Return value - x over the size of the terms of an equation; see ``solve``."""
    scale = tl.maximum(tl.maximum(tl.abs(base), change), rounding)
    scale = tl.where((scale > 0.0) & (scale < _LEAST_SCALE), _LEAST_SCALE, scale)
    size = tl.where(scale > 0.0, scale, tl.maximum(tl.abs(value), tl.abs(x)))
    difference = value - x
    return tl.where(difference == 0.0, difference, difference / tl.where(size > 0.0, size, 1.0))


@triton.jit
def _remember(solved, solution, count, first, second, third):
    """Return how many earlier solutions there are, and these, after one that is solved."""
    return (tl.where(solved, tl.minimum(count + 1, 3), count), tl.where(solved, solution, first),
            tl.where(solved, first, second), tl.where(solved, second, third))


@triton.jit
def take_steps(z, carry, slope, counts, earlier, earlier_too, todo, outcomes, most, at, numbers,
               w1, b1, w2, b2, last, m, n, end, LEAPFROG: tl.constexpr, EXTRAPOLATE: tl.constexpr,
               MOST: tl.constexpr, CONNECTED: tl.constexpr, WIDTH: tl.constexpr,
               COLUMNS: tl.constexpr):
    """
    Take all steps that are to do, of one coordinate, by the secant method for each trajectory.

    Each round evaluates the gradient once, at the iterate of each trajectory. Where that solves
    the step the next one begins: no trajectory waits for its neighbours but at the end. One whose
    step is not solved stays in the state before it.

    Parameters
    ----------
    z, carry, slope, counts, earlier, earlier_too : pointer
        The State, changed in place; earlier solutions of the first and the second equation.
    todo, outcomes, most, at : pointer, shape (m,)
        Steps to do, counted down; OK, or why a step was not taken; the most gradients of a
        step, and its number.
    numbers : pointer, shape (3,)
        Step size [s], and the two of ``Kernel.gradient_scale``.
    w1, b1, w2, b2, last : pointer, shape (n, 2), (n,), (n, n), (n,), (n,)
        Network 2-n-n-1.
    m, n, end : int
        Trajectories; the width; the number of the last step that is to do.
    LEAPFROG, EXTRAPOLATE, CONNECTED : bool
        Whether the method is ``generalized_leapfrog``, and not eq. (6); see SolverOptions.
    MOST : int
        Iterations after which an equation counts as not solved.
    WIDTH, COLUMNS : int
        The width, filled up to a power of 2; and trajectories of a program.

    """
    columns = tl.program_id(0).to(tl.int64) * COLUMNS + tl.arange(0, COLUMNS)
    there = columns < m
    w_q, w_p, bias_1, w_2, w_2_turned, bias_2, w_out = _network(w1, b1, w2, b2, last, n, WIDTH)
    step, rounding_p, rounding_q = tl.load(numbers), tl.load(numbers + 1), tl.load(numbers + 2)
    h = 0.5 * step if LEAPFROG else step

    q, p = tl.load(z + columns, there, 0.0), tl.load(z + m + columns, there, 0.0)
    q_carry = tl.load(carry + columns, there, 0.0)
    p_carry = tl.load(carry + m + columns, there, 0.0)
    H_q, H_p = tl.load(slope + columns, there, 0.0), tl.load(slope + m + columns, there, 0.0)
    count = tl.load(counts + columns, there, 0)
    first, second, third = _load_rows(earlier, columns, m, there)
    # Of the second half of a leapfrog; what eq. (6) leaves as it is.
    count_too = tl.load(counts + m + columns, there, 0) if LEAPFROG else count
    first_too, second_too, third_too = _load_rows(earlier_too, columns, m, there)
    halfway = there & (columns < 0)
    p_half, p_half_carry, H_p_half = p, p_carry, H_p

    left = tl.load(todo + columns, there, 0)
    costliest, costliest_at = tl.load(most + columns, there, 0), tl.load(at + columns, there, 0)
    outcome, gradients = tl.full((COLUMNS,), _OK, tl.int32), tl.full((COLUMNS,), 0, tl.int32)
    k, slow = gradients, halfway
    previous, x, old_value, old_defect = q, q, q, q
    going = left > 0
    while tl.max(going.to(tl.int32), axis=0) > 0:
        # The equation x = base + factor H_x(...), with the other variable held.
        if LEAPFROG:
            q_half, q_half_carry = _plus(q, q_carry, h * H_p_half)
            base = tl.where(halfway, q_half, p)
            base_carry = tl.where(halfway, q_half_carry, p_carry)
            factor, known_slope = tl.where(halfway, h, -h), tl.where(halfway, H_p_half, H_q)
            rounding = tl.where(halfway, rounding_q, rounding_p)
            start = tl.where(
                halfway,
                _start(count_too, first_too, second_too, third_too, base, factor, known_slope,
                       EXTRAPOLATE),
                _start(count, first, second, third, base, factor, known_slope, EXTRAPOLATE))
            x = tl.where(k == 0, start, x)
            at_q, at_p = tl.where(halfway, x, q), tl.where(halfway, p_half, x)
        else:
            q_new, q_new_carry = _plus(q, q_carry, h * H_p)
            base, base_carry, factor, known_slope, rounding = p, p_carry, -h, H_q, rounding_p
            start = _start(count, first, second, third, base, factor, known_slope, EXTRAPOLATE)
            x = tl.where(k == 0, start, x)
            at_q, at_p = q_new, x
        found_q, found_p = _gradient(at_q, at_p, w_q, w_p, bias_1, w_2, w_2_turned, bias_2, w_out)
        found = tl.where(halfway, found_p, found_q) if LEAPFROG else found_q
        value, rest = _plus(base, base_carry, factor * found)

        defect = _defect(value, x, base, tl.abs(h) * tl.abs(known_slope), tl.abs(h) * rounding)
        residual = tl.abs(defect)
        k += 1
        gradients += 1
        previous = tl.where(k == 1, _INFINITE, previous)
        slow = tl.where(k == 2, (residual > 0.5 * previous) & (0.5 * previous > _NOISE),
                        slow & (k > 1))
        verdict = _judge(k, residual, previous, slow, MOST, CONNECTED)
        solved = going & (verdict == _OK)
        x_carry = rest + (value - x)
        if LEAPFROG:
            p_new, p_new_carry = _plus(p_half, p_half_carry, -h * found_q)
            q_new, q_new_carry, stepped = x, x_carry, solved & halfway
        else:
            p_new, p_new_carry, stepped = x, x_carry, solved
        lost = stepped & ~((tl.abs(q_new) < _INFINITE) & (tl.abs(p_new) < _INFINITE)
                           & (tl.abs(found_q) < _INFINITE) & (tl.abs(found_p) < _INFINITE))
        verdict = tl.where(lost, _NOT_FINITE, verdict)
        stepped = stepped & ~lost
        failed = going & (verdict != _OK) & (verdict != _GO_ON)
        outcome = tl.where(failed, verdict, outcome)
        more = (stepped | failed) & (gradients > costliest)
        costliest = tl.where(more, gradients, costliest)
        costliest_at = tl.where(more, end - left + 1, costliest_at)

        if LEAPFROG:
            half = solved & ~halfway
            p_half, p_half_carry = tl.where(half, x, p_half), tl.where(half, x_carry, p_half_carry)
            H_p_half = tl.where(half, found_p, H_p_half)
            count_too, first_too, second_too, third_too = _remember(
                stepped, x - base, count_too, first_too, second_too, third_too)
        else:
            half = stepped
        count, first, second, third = _remember(half, x - base, count, first, second, third)
        q, q_carry = tl.where(stepped, q_new, q), tl.where(stepped, q_new_carry, q_carry)
        p, p_carry = tl.where(stepped, p_new, p), tl.where(stepped, p_new_carry, p_carry)
        H_q, H_p = tl.where(stepped, found_q, H_q), tl.where(stepped, found_p, H_p)
        left = tl.where(stepped, left - 1, left)

        change = defect - old_defect
        moves = (k > 1) & (change != 0.0)
        x = tl.where(moves, value - defect / tl.where(moves, change, 1.0) * (value - old_value),
                     value)
        old_value, old_defect, previous = value, defect, residual
        if LEAPFROG:
            halfway = (halfway | half) & ~stepped
        k = tl.where(solved, 0, k)
        gradients = tl.where(stepped, 0, gradients)
        going = going & ~failed & (left > 0)

    tl.store(z + columns, q, there)
    tl.store(z + m + columns, p, there)
    tl.store(carry + columns, q_carry, there)
    tl.store(carry + m + columns, p_carry, there)
    tl.store(slope + columns, H_q, there)
    tl.store(slope + m + columns, H_p, there)
    tl.store(counts + columns, count, there)
    _store_rows(earlier, columns, m, there, first, second, third)
    if LEAPFROG:
        tl.store(counts + m + columns, count_too, there)
        _store_rows(earlier_too, columns, m, there, first_too, second_too, third_too)
    tl.store(todo + columns, left, there)
    tl.store(outcomes + columns, outcome, there)
    tl.store(most + columns, costliest, there)
    tl.store(at + columns, costliest_at, there)
