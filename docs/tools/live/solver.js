// Copyright 2026 The hnn_vi_ros Authors. SPDX-License-Identifier: Apache-2.0
'use strict';

function doubles(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  return new Float64Array(bytes.buffer);
}

// Fill y with the products of the rows of a matrix with x: four rows at a time, as x is read once.
function multiply(matrix, x, y) {
  const n = x.length, m = y.length;
  let i = 0;
  for (; i + 3 < m; i += 4) {
    const at = i * n, at1 = at + n, at2 = at1 + n, at3 = at2 + n;
    let a = 0, b = 0, c = 0, d = 0;
    for (let j = 0; j < n; j++) {
      const value = x[j];
      a += matrix[at + j] * value;
      b += matrix[at1 + j] * value;
      c += matrix[at2 + j] * value;
      d += matrix[at3 + j] * value;
    }
    y[i] = a;
    y[i + 1] = b;
    y[i + 2] = c;
    y[i + 3] = d;
  }
  for (; i < m; i++) {
    let sum = 0;
    for (let j = 0; j < n; j++) sum += matrix[i * n + j] * x[j];
    y[i] = sum;
  }
}

// H(z) of a perceptron with tanh, z = (q, p), and its gradient by reverse accumulation.
class Model {
  constructor({widths, weights}) {
    const values = doubles(weights);
    this.size = widths[0];
    this.gradients = 0;
    this.layers = [];
    for (let k = 1, at = 0; k < widths.length; k++) {
      const inputs = widths[k - 1], outputs = widths[k], bias = at + inputs * outputs;
      const weight = values.slice(at, bias), transposed = new Float64Array(inputs * outputs);
      for (let i = 0; i < outputs; i++)
        for (let j = 0; j < inputs; j++) transposed[j * outputs + i] = weight[i * inputs + j];
      this.layers.push({weight, transposed,
        bias: values.slice(bias, bias + outputs),
        value: new Float64Array(outputs), slope: new Float64Array(inputs)});
      at = bias + outputs;
    }
    this.one = Float64Array.of(1);
  }

  energy(z) {
    const {layers} = this;
    let input = z;
    for (let k = 0; k < layers.length; k++) {
      const {weight, bias, value} = layers[k];
      multiply(weight, input, value);
      for (let i = 0; i < value.length; i++)
        value[i] = k + 1 < layers.length ? Math.tanh(value[i] + bias[i]) : value[i] + bias[i];
      input = value;
    }
    return input[0];
  }

  // Fill (q', p') = (H_p, -H_q).
  rates(z, rates) {
    const {layers} = this;
    this.energy(z);
    this.gradients++;
    let factor = this.one;
    for (let k = layers.length - 1; k >= 0; k--) {
      const {transposed, slope} = layers[k];
      multiply(transposed, factor, slope);
      if (k > 0) {
        const {value} = layers[k - 1];
        for (let j = 0; j < slope.length; j++) slope[j] *= 1 - value[j] * value[j];
      }
      factor = slope;
    }
    const d = this.size / 2;
    for (let i = 0; i < d; i++) {
      rates[i] = factor[d + i];
      rates[d + i] = -factor[i];
    }
  }
}

const ROOT = Math.sqrt(3) / 6;
// Stage matrices of the explicit methods (rows up to the diagonal) and of the Gauss methods.
const METHODS = {
  variational_euler: {label: 'eq. (6) of the paper, order 1', colour: '#1b6ac9'},
  explicit_euler: {label: 'explicit Euler, order 1', colour: '#c9341b', A: [[]], b: [1]},
  rk4: {label: 'RK4, order 4', colour: '#8a5a00', A: [[], [0.5], [0, 0.5], [0, 0, 1]],
    b: [1 / 6, 1 / 3, 1 / 3, 1 / 6]},
  implicit_midpoint: {label: 'implicit midpoint, order 2', colour: '#0a8a5f', A: [[0.5]], b: [1]},
  gauss4: {label: 'Gauss, order 4', colour: '#7a3fb0',
    A: [[0.25, 0.25 - ROOT], [0.25 + ROOT, 0.25]], b: [0.5, 0.5]},
};
const MOST_ITERATIONS = 100;

// A simulation; steps are added with the rounding error of the sum carried on.
class Simulation {
  constructor(model, method, h, start) {
    Object.assign(this, {model, h, ...METHODS[method]});
    const n = model.size;
    [this.z, this.carry, this.stage, this.next, this.rates] =
      Array.from({length: 5}, () => new Float64Array(n));
    this.z.set(start);
    this.steps = 0;
    this.energy0 = model.energy(this.z);
    if (this.b) {
      this.slopes = this.b.map(() => new Float64Array(n));
      this.before = this.b.map(() => new Float64Array(n));
    }
    model.rates(this.z, this.rates);
    if (this.b) for (const own of [...this.slopes, ...this.before]) own.set(this.rates);
  }

  get t() { return this.steps * this.h; }

  add(i, change) {
    const y = change + this.carry[i], before = this.z[i], sum = before + y;
    const part = sum - before;
    this.carry[i] = (before - (sum - part)) + (y - part);
    this.z[i] = sum;
  }

  // Take a step; false if its equation could not be solved.
  step() {
    const solved = this.b ? this.rungeKutta() : this.variationalEuler();
    if (solved) this.steps++;
    return solved && this.z.every(Number.isFinite);
  }

  // q1 = q + h H_p(q, p), then p1 = p - h H_q(q1, p1) by fixed-point iteration.
  variationalEuler() {
    const {z, stage, next, rates, carry, h} = this, d = z.length / 2;
    for (let i = 0; i < d; i++) this.add(i, h * rates[i]);
    stage.set(z);
    for (let i = d; i < 2 * d; i++) stage[i] = z[i] + h * rates[i];
    const solved = this.iterate(() => {
      this.model.rates(stage, rates);
      let change = 0;
      for (let i = d; i < 2 * d; i++) {
        next[i] = z[i] + (h * rates[i] + carry[i]);
        change = Math.max(change, Math.abs(next[i] - stage[i]));
        stage[i] = next[i];
      }
      return change;
    });
    // The last gradient, at the solution to round-off, also serves the next step.
    for (let i = d; i < 2 * d; i++) this.add(i, h * rates[i]);
    return solved;
  }

  rungeKutta() {
    const {z, stage, slopes, before, rates, A, b, h} = this, n = z.length;
    const explicit = A[0].length === 0;
    const sweep = () => {
      let change = 0;
      for (let s = 0; s < b.length; s++) {
        for (let i = 0; i < n; i++) {
          let sum = 0;
          for (let r = 0; r < A[s].length; r++) sum += A[s][r] * slopes[r][i];
          stage[i] = z[i] + (h * sum + this.carry[i]);
        }
        this.model.rates(stage, rates);
        for (let i = 0; i < n; i++) {
          change = Math.max(change, h * Math.abs(rates[i] - slopes[s][i]));
          slopes[s][i] = rates[i];
        }
      }
      return change;
    };
    let solved = true;
    if (explicit) sweep();
    else {
      // Slopes of the next step, extrapolated from those of the last two.
      for (let s = 0; s < b.length; s++) {
        for (let i = 0; i < n; i++) {
          const last = slopes[s][i];
          slopes[s][i] += last - before[s][i];
          before[s][i] = last;
        }
      }
      solved = this.iterate(sweep);
    }
    for (let i = 0; i < n; i++) {
      let sum = 0;
      for (let s = 0; s < b.length; s++) sum += b[s] * slopes[s][i];
      this.add(i, h * sum);
    }
    return solved;
  }

  // Repeat until the change is round-off: zero, or small and no longer falling.
  iterate(sweep) {
    const small = 1e-13 * Math.max(1, ...this.z.map(Math.abs));
    let last = Infinity;
    for (let k = 0; k < MOST_ITERATIONS; k++) {
      const change = sweep();
      if (change === 0 || (change < small && change >= last)) return true;
      if (!(change < 1e9)) return false;
      last = change;
    }
    return false;
  }
}
