# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Run formulas with too large steps: every qualitatively wrong run must raise an alarm.

The steps are 1/2, 2/3, 4/3 and 2 times the one at which a method's path first errs by 10 %: the
largest distance from DOP853 at rtol 1e-12, over the largest distance from the mean of its path,
each coordinate and momentum in units of its range. A run is wrong if the counts of the events of
its system differ, or its energy errs by more than 10 % of the energy scale; it is right if
neither, and its path errs by less than 1 %. What lies between is not judged.
"""

from collections import Counter
from collections.abc import Callable, Sequence
import json
import math
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.files import Parser
from hnn_vi_ros.hamiltonians import Formula, Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import Condition
from hnn_vi_ros.simulation import record_one, Schedule, Simulation
from hnn_vi_ros.simulation.accuracy.diagnostics import energy_scale
import numpy as np
from scipy.integrate import solve_ivp

METHODS = ('variational_euler', 'generalized_leapfrog', 'implicit_midpoint', 'yoshida4', 'gauss4',
           'discrete_gradient')
SHARES = 1 / 2, 2 / 3, 4 / 3, 2.0
_X, _V = (0.97000436, -0.24308753), (-0.93240737, -0.86473146)


class System(NamedTuple):
    """A formula, its initial state, the horizon [s], and the conditions of its events."""

    formula: str
    coordinates: str
    q: tuple[float, ...]
    p: tuple[float, ...]
    horizon: float
    events: tuple[str, ...]


# About ten turns each. They end midway between two events, so that a small delay of the last one
# changes no count.
SYSTEMS = {
    'Duffing': System('p_x^2 / 2 + x^2 / 2 + x^4 / 4', 'x', (2.0,), (0.0,), 33.4,
                      ('x = 0',)),
    'double well': System('p_x^2 / 2 - x^2 / 2 + x^4 / 4', 'x', (1.0,), (0.7085,), 88.0,
                          ('x = 0',)),
    'pendulum at its separatrix': System(
        'p_q^2 / 2 + 1 - cos(q)', 'q', (3.052142479252326,), (0.0,), 182.0,
        ('p_q = 0', 'sin(q / 2) = 0')),
    'spherical pendulum at its pole': System(
        'p_theta^2 / 2 + p_phi^2 / (2 * sin(theta)^2) - cos(theta)', 'theta phi',
        (1.0, 0.0), (0.0, 0.02), 32.7, ('p_theta = 0', 'cos(phi - 0.8) = 0')),
    'Lennard-Jones': System(
        '(p_x^2 + p_y^2) / 2 + 4 * ((x^2 + y^2)^-6 - (x^2 + y^2)^-3)', 'x y',
        (1.6, 0.0), (0.0, 0.25), 20.4,
        ('x * p_x + y * p_y = 0', 'y = 0')),
    'Kepler 0.9': System('(p_x^2 + p_y^2) / 2 - 1 / sqrt(x^2 + y^2)', 'x y', (1.9, 0.0),
                         (0.0, 0.22941573387056177), 64.4,
                         ('x * p_x + y * p_y = 0', 'y = 0')),
    'three bodies': System(
        '(p_a^2 + p_b^2 + p_c^2 + p_d^2 + p_e^2 + p_f^2) / 2 - 1/sqrt((a - c)^2 + (b - d)^2)'
        ' - 1/sqrt((a - e)^2 + (b - f)^2) - 1/sqrt((c - e)^2 + (d - f)^2)', 'a b c d e f',
        (*_X, -_X[0], -_X[1], 0.0, 0.0), (*(-0.5 * v for v in _V + _V), *_V), 63.8,
        ('(c - a) * (f - b) = (d - b) * (e - a)',)),
    'Toda': System('(p_a^2 + p_b^2 + p_c^2) / 2 + exp(a - b) + exp(b - c) + exp(c - a)', 'a b c',
                   (1.0, -0.5, -0.5), (0.3, 0.5, -0.8), 36.5,
                   ('a = b', 'b = c')),
    'stiff resonance': System(
        '(p_x^2 + p_y^2) / 2 + x^2 / 2 + 100 * y^2 / 2 + 5 * x^2 * y', 'x y', (1.0, 0.05),
        (0.0, 0.3), 62.07, ('x = 0', 'y = 0')),
}


class Run(NamedTuple):
    """
    Judgement of one run.

    Parameters
    ----------
    system, method : str
        Keys of SYSTEMS and METHODS.
    step_size : float
        [s].
    path, energy : float
        Largest errors: of the path over its size, and of H over the energy scale.
    found, expected : list of int
        Sign changes of the events, in the run and of DOP853.
    alarms : list of str
        Kinds of the alarms, or the error that ended the run.

    """

    system: str
    method: str
    step_size: float
    path: float
    energy: float
    found: list[int]
    expected: list[int]
    alarms: list[str]

    @property
    def judgement(self) -> str:
        """Return 'wrong', 'right', or '' if neither."""
        if self.found != self.expected or not self.energy <= 0.1:
            return 'wrong'
        return 'right' if self.path < 0.01 else ''


class Judge:
    """
    Runs of one system, and their reference path.

    Parameters
    ----------
    name : str
        Key of SYSTEMS.

    """

    def __init__(self, name: str):
        self.name, self.system = name, SYSTEMS[name]
        self.hamiltonian = Formula([*self.system.coordinates.split()], self.system.formula)
        self.start = np.array([*self.system.q, *self.system.p])
        d = self._d = self.hamiltonian.dimension
        self._path, self.reference = reference(
            self.hamiltonian, self.start, self.system.horizon)
        # A momentum that is conserved has no range.
        self._ranges = np.ptp(self._path, axis=0)
        self._ranges[self._ranges <= 1e-9] = 1.0
        self._scale = energy_scale(self.hamiltonian, self._path[:, :d], self._path[:, d:])
        spread = (self._path - self._path.mean(axis=0)) / self._ranges
        self._size = float(np.linalg.norm(spread, axis=1).max())

    def run(self, method: str, step_size: float) -> Run:
        """Take all steps of a run with guards, and judge it."""
        simulation, steps = self._simulation(method, step_size)
        expected = self._counts(self._path)
        # Guards report diverging runs.
        with np.errstate(all='ignore'):
            try:
                found = record_one(simulation, Schedule(steps, 1, np.empty(0)))
            except StepFailure as failure:
                return Run(self.name, method, step_size, math.inf, math.inf, [], expected,
                           [type(failure).__name__])
            z = np.hstack([found.q, found.p])
            energy = float(np.abs(found.energy - found.energy[0]).max() / self._scale)
            return Run(self.name, method, step_size, self._error(found.t, z), energy,
                       self._counts(z), expected, [alarm.kind for alarm in found.alarms])

    def step_that_errs(self, method: str) -> float:
        """Return the step at which the path of a method first errs by 10 %, to 2 % of it [s]."""
        h = self.system.horizon / 20_000
        while self._errs_less(method, 1.25 * h):
            h *= 1.25
        low, high = h, 1.25 * h
        while high > 1.02 * low:
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self._errs_less(method, middle) else (low, middle)
        return high

    def _simulation(self, method: str, step_size: float) -> tuple[Simulation, int]:
        d = self._d
        return Simulation(self.hamiltonian, INTEGRATORS[method](), step_size, self.start[:d],
                          self.start[d:]), math.floor(self.system.horizon / step_size)

    def _errs_less(self, method: str, step_size: float) -> bool:
        simulation, steps = self._simulation(method, step_size)
        with np.errstate(all='ignore'):
            try:
                z = np.hstack(simulation.record(steps, 1))
            except StepFailure:
                return False
            return self._error(step_size * np.arange(1, steps + 1), z) < 0.1

    def _error(self, t: np.ndarray, z: np.ndarray) -> float:
        errors = (z - self.reference(t).T) / self._ranges
        return float(np.linalg.norm(errors, axis=1).max() / self._size)

    def _counts(self, z: np.ndarray) -> list[int]:
        return counts(self.hamiltonian, self.system.events, z)


def reference(hamiltonian: Hamiltonian, start: np.ndarray, horizon: float
              ) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return (q, p) by DOP853 at 20 001 instants, shape (n, 2 d), and as a function of time."""
    d = start.size // 2

    def slope(t: float, z: np.ndarray) -> np.ndarray:
        H_q, H_p = hamiltonian.gradient(z[:d], z[d:])
        return np.concatenate([H_p, -H_q])

    times = np.linspace(0.0, horizon, 20_001)
    found = solve_ivp(slope, (0.0, horizon), start, 'DOP853', times, rtol=1e-12, atol=1e-13,
                      dense_output=True)
    return found.y.T, found.sol


def counts(hamiltonian: Hamiltonian, events: Sequence[str], z: np.ndarray) -> list[int]:
    """Return the number of sign changes of each condition, without times, on a path (n, 2 d)."""
    q, p = np.split(z, 2, axis=1)
    signs = [np.sign(Condition(text).values(hamiltonian, q, p, 0.0)) for text in events]
    return [int(np.count_nonzero(np.diff(one[one != 0.0]))) for one in signs]


def table(runs: Sequence[Run]) -> str:
    """Return a line for each system: alarmed of the wrong runs, silent of the right ones."""
    lines = ['| system | wrong, with an alarm | right, without one | not judged |',
             '|---|---|---|---|']
    found = Counter((run.system, run.judgement, bool(run.alarms)) for run in runs)
    for name in dict.fromkeys(run.system for run in runs):
        alarmed, silent = ({word: found[name, word, kind] for word in ('wrong', 'right', '')}
                           for kind in (True, False))
        lines.append(f'| {name} | {alarmed["wrong"]}/{alarmed["wrong"] + silent["wrong"]} | '
                     f'{silent["right"]}/{alarmed["right"] + silent["right"]} | '
                     f'{alarmed[""] + silent[""]} |')
    return '\n'.join(lines)


def write_runs(path: Path, runs: Sequence[Run]) -> None:
    """Write a line of JSON for each run."""
    path.write_text(''.join(json.dumps(run._asdict()) + '\n' for run in runs), encoding='utf-8')


def read_runs(path: Path) -> list[Run]:
    """Read the file of ``write_runs``."""
    return [Run(**json.loads(line)) for line in path.read_text('utf-8').splitlines()]


def committed() -> Path:
    """Return the file with the runs that the page on hard cases reports."""
    return Path(__file__).with_suffix('.jsonl')


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('coarse_steps', __doc__, [
        "make study NAME=coarse_steps ARGS='--out docs/studies/coarse_steps.jsonl'"])
    found.add_argument('--systems', nargs='+', default=[*SYSTEMS], choices=[*SYSTEMS],
                       help='systems to run (default: all)')
    found.add_argument('--methods', nargs='+', default=METHODS, choices=METHODS,
                       help='methods to run (default: all)')
    found.add_argument('--out', type=Path, metavar='FILE', help='write one JSON line per run')
    return found


def main(argv: Sequence[str]) -> int:
    """Run all, and print the table; fail where a run is wrong in silence."""
    given, runs = parser().parse_args(argv), []
    for name in given.systems:
        judge = Judge(name)
        for method in given.methods:
            step = judge.step_that_errs(method)
            runs += [judge.run(method, share * step) for share in SHARES]
    if given.out is not None:
        write_runs(given.out, runs)
    print(table(runs))
    silent = [run for run in runs if run.judgement == 'wrong' and not run.alarms]
    for run in silent:
        print(f'silent: {run}')
    return 1 if silent else 0
