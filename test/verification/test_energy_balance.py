# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""That the energy balance H - H0 - W of every effect closes, with every method that takes it."""

from pathlib import Path

from effect_table import COMPILED, EFFECT_ROWS, EffectRow
from helpers import EPS, long, Method, METHODS
from hnn_vi_ros.effects import Effect, EFFECTS
from hnn_vi_ros.effects.thermostat import Thermostat
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest

# Steps of the coarsest run, by order; from here on the leading term of the error dominates.
STEPS = {1: 100, 2: 50, 4: 80, 10: 12, 12: 12, 14: 12, 16: 12}
# The energies are of the order of 1 J; below that, what is left is mostly rounding.
PLATEAU = 1e-11
# Act only when they are commanded; test_observer.py and test_link_wrench.py have their accounts.
HEARD = {'link_wrench', 'observer'}
SOME = 'generalized_leapfrog', 'stormer_verlet', 'implicit_midpoint', 'gauss4'
SMOOTH = [row for row in EFFECT_ROWS if row.name != 'thermostat']


def simulation_of(row: EffectRow, hamiltonian: Hamiltonian, effects: list[Effect], method: Method,
                  steps: int) -> Simulation:
    """Return the simulation of a row; where there is an external force, one of 2 N m."""
    simulation = Simulation(hamiltonian, method.integrator, row.duration / steps, row.q, row.p,
                            effects)
    if simulation.takes_commands:
        simulation.set_command([2.0])
    return simulation


def worst_balance(simulation: Simulation, steps: int) -> float:
    """Return the largest abs(H - H0 - W) after any step [J]."""
    worst = 0.0
    for _ in range(steps):
        simulation.advance(1)
        worst = max(worst, abs(simulation.energy_balance))
    assert simulation.rescued == 0
    return worst


def observed_order(steps: np.ndarray, errors: np.ndarray) -> float:
    """Return the slope over the points above the plateau, infinity if all but one are on it."""
    above = errors > PLATEAU
    if above.sum() < 2:
        return -np.inf if above[-1] else np.inf
    return -np.polyfit(np.log(steps[above]), np.log(errors[above]), 1)[0]


def test_effect_table_covers_every_effect():
    assert {row.effects[0][0] for row in EFFECT_ROWS} == set(EFFECTS) - HEARD


@pytest.mark.parametrize('row', EFFECT_ROWS, ids=lambda row: row.name)
def test_effect_acts_on_the_state_and_on_the_energy(row: EffectRow, tmp_path: Path):
    """Without that, a balance that closes would say nothing."""
    method = next(method for method in METHODS if method.name == 'generalized_leapfrog')
    runs = [simulation_of(row, row.uncompiled, effects, method, 100)
            for effects in (row.create(tmp_path), row.create(tmp_path)[1:])]
    for simulation in runs:
        simulation.advance(100)
    listed, removed = runs
    assert np.abs(np.subtract([*listed.q, *listed.p], [*removed.q, *removed.p])).max() > 0.02
    effect, label = row.create(tmp_path)[0], row.effects[0][0]
    assert (abs(listed.works[label]) > 0.02) == (not effect.conservative)
    assert sum(listed.works.values()) == pytest.approx(listed.work, abs=1e-12)
    assert listed.conservative == all(effect.conservative for effect in row.create(tmp_path))


def shortfall(row: EffectRow, method: Method, effects: list[Effect]) -> float:
    """Return by how much the balance's order falls short of the method's; -infinity if closed."""
    if method.name == 'dop853':
        # rtol 1e-9 in each of its own steps, some 10 of them, and energies below 10 J.
        simulation = simulation_of(row, row.uncompiled, effects, method, 4)
        return -np.inf if worst_balance(simulation, 4) < 1e-7 else np.inf
    steps = np.array([4, 6, 8]) * STEPS.get(method.integrator.order, method.steps) // 4
    errors = np.array([worst_balance(simulation_of(row, row.uncompiled, effects, method, int(n)),
                                     int(n)) for n in steps])
    return min(method.integrator.order, row.order) - observed_order(steps, errors)


@pytest.mark.parametrize('row', SMOOTH, ids=lambda row: row.name)
@pytest.mark.parametrize('methods', ['some', long('all')])
def test_energy_balance_closes_with_the_order_of_every_method_that_takes_the_effect(
        methods: str, row: EffectRow, tmp_path: Path, measured):
    shortfalls = {}
    for method in METHODS:
        if methods == 'some' and method.name not in SOME:
            continue
        try:
            shortfalls[method.name] = shortfall(row, method, row.create(tmp_path))
        except UnsupportedSystem as problem:
            # See test_system.py for what is refused.
            assert 'generalized_leapfrog' in str(problem)
    worst = max(shortfalls, key=shortfalls.get)
    if methods == 'all':
        measured('order of the energy balance less that of the method',
                 f'{row.name}, least of {len(shortfalls)} methods ({worst})',
                 -shortfalls[worst], '>= -0.35')
    assert len(shortfalls) >= (2 if row.create(tmp_path)[0].internal else 3)
    assert {name: value for name, value in shortfalls.items() if not value <= 0.35} == {}


@pytest.mark.parametrize('name', [long('generalized_leapfrog'), 'stormer_verlet'])
def test_energy_balance_of_the_thermostat_closes_with_order_2(name: str, measured):
    """In the mean square over 32 runs: each step size meets noise of its own."""
    row = next(row for row in EFFECT_ROWS if row.name == 'thermostat')
    steps, errors = np.array([16, 32, 64]), []
    for n in steps:
        squares = []
        for seed in range(32):
            effect = Thermostat(**row.effects[0][1] | {'seed': seed})
            simulation = Simulation(row.uncompiled, INTEGRATORS[name](), row.duration / n,
                                    row.q, row.p, [effect])
            squares.append(worst_balance(simulation, int(n)) ** 2)
        errors.append(np.sqrt(np.mean(squares)))
    # The root of a mean of 32 squares is known to an eighth, a slope over a factor 4 to 0.13.
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    measured('order of the energy balance', f'{name}, thermostat', slope, '>= 2 - 0.35')
    assert slope >= 2 - 0.35


def test_every_effect_is_run_compiled():
    assert {kind for *_, effects in COMPILED.values() for kind, _ in effects} == (
        set(EFFECTS) - HEARD)


@pytest.mark.long
@pytest.mark.parametrize('name', COMPILED)
def test_effects_compiled_and_uncompiled_agree(name: str, tmp_path: Path):
    """So that what is shown of the plain functions holds for the compiled ones."""
    integrator, system, arguments, q, p, effects = COMPILED[name]
    row = EffectRow(name, tuple(effects), system, q, p, arguments=arguments)
    method, steps = next(method for method in METHODS if method.name == integrator), 50
    compiled, plain = (
        simulation_of(row, hamiltonian, row.create(tmp_path), method, steps)
        for hamiltonian in (row.hamiltonian, row.uncompiled))
    difference = np.subtract(compiled.record(steps, 1), plain.record(steps, 1))
    # Each step rounds some 10 numbers of the size of one; the flow, and a wall that is met a
    # little earlier, stretch that less than 100 times in a second.
    tolerance = 100 * 10 * EPS * steps
    assert np.abs(difference).max() <= tolerance
    assert compiled.works == pytest.approx(plain.works, abs=tolerance)
    for label, effect in zip(plain.works, row.create(tmp_path), strict=True):
        assert (abs(plain.works[label]) > 1e-4) == (not effect.conservative)
