# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Forces with internal variables: bristles and motors, against DOP853 and closed forms."""

from collections.abc import Callable
import math

from helpers import difference, effect, EPS, free, plain_run, Uncompiled
from hnn_vi_ros import load_scene
from hnn_vi_ros.control import BatchStep
from hnn_vi_ros.effects import EffectError
from hnn_vi_ros.effects.drives import DRIVES
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Formula, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import numbers_of
from hnn_vi_ros.simulation import (
    Change, DifferentiableRun, look, RunFacts, Simulation, System, Watch)
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp

SECOND_ORDER = 'implicit_midpoint', 'generalized_leapfrog'
# Methods that start from the gradient that the step before evaluated.
KEEPING = 'explicit_euler', 'variational_euler'
# sigma_0 [N/m], F_C and F_S - F_C [N], v_S [m/s]; sigma_2 and sigma_1 [N s/m], and v_d [m/s].
BRISTLES = {'stiffness': 1000.0, 'friction': 1.0, 'stribeck': 0.5, 'speed': 0.01,
            'damping': 0.5, 'bristle_damping': 20.0, 'bristle_damping_speed': 0.1}


def bristles(coordinate: str = 'x', **other: float):
    return effect('lugre_friction', coordinate, **BRISTLES | other)


def reference(load: Callable, t: np.ndarray, start: tuple = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return q, v and z of 1 kg under load(t, q), shape (3, len(t)), by DOP853."""
    def slope(time: float, y: np.ndarray) -> list[float]:
        q, v, z = y
        g = 1.0 + 0.5 * math.exp(-(v / 0.01)**2)
        rate = v - 1000.0 * abs(v) * z / g
        friction = 1000.0 * z + 20.0 * math.exp(-(v / 0.1)**2) * rate + 0.5 * v
        return [v, load(time, q) - friction, rate]
    # The kink at v = 0 is met within the steps, which a bound on them resolves.
    return solve_ivp(slope, (0.0, t[-1]), start, 'DOP853', t, rtol=1e-9, atol=1e-12,
                     max_step=2e-3).y


@pytest.mark.parametrize('command', [4.0, -4.0])  # beyond the limit of the motor, both ways
@pytest.mark.parametrize('effects', [
    [bristles('angle', stiffness=6.0, speed=1.0, bristle_damping=0.2)],
    *([effect('motor', 'angle', 0.3, 1.0, 6.0, braking=braking),
       effect('external_force', ['angle'], 100.0)] for braking in ('limited', 'full'))])
def test_hessian_vector_of_an_internal_force_is_the_derivative_of_its_gradient(effects, command):
    system = System(Uncompiled(HAMILTONIANS['pendulum']()), effects,
                    INTEGRATORS['implicit_midpoint']())
    if len(effects) > 1:
        system.motors.command([command], np.zeros(1))
    kernel, system.effect_state.step[0] = system.kernel, 0.3
    D, rng = kernel.dimension, np.random.default_rng(2)
    q, p, v_q, v_p = rng.normal(size=(4, D))
    # The first channel holds the internal variable; times and integrals do not act.
    v_q[2:], v_p[1:], q[2:] = 0.0, 0.0, 0.1
    sides = [kernel.slopes(q + sign * v_q, p + sign * v_p) for sign in (1e-5, -1e-5)]
    found = kernel.products(q, p, v_q, v_p)
    assert kernel.internal == 1
    # The power of a force has no tangent, nor has the time.
    assert found[:, :2] == pytest.approx((sides[0] - sides[1])[:, :2] / 2e-5, abs=1e-7)


@pytest.mark.long
def test_bristles_hold_a_load_below_the_coulomb_friction_for_1000_seconds():
    """Smoothed friction would creep by 1000 s x 0.01 m/s x atanh(0.9), some 15 m."""
    hamiltonian = HAMILTONIANS['free_particle'](1.0, ('x',))
    simulation = Simulation(hamiltonian, INTEGRATORS['implicit_midpoint'](), 0.002, [0.0], [0.0], [
        bristles(), effect('external_force', ['x'], initial=[0.9])])
    q = simulation.record(1000, 500)[0].ravel()
    t = np.linspace(0.0, 20.0, 21)
    exact = reference(lambda time, q: 0.9, t)[0]
    # The sudden load slides by 5 mm; h omega = 0.06, whose square bounds the error: 7e-5 measured.
    assert q[:20] == pytest.approx(exact[1:], rel=4e-3)
    assert abs(q[-1] - q[19]) <= 1e-12


@pytest.mark.parametrize('method', SECOND_ORDER)
def test_hysteresis_of_bristles_is_that_of_dop853(method):
    load, t = effect('periodic_drive', 'x', 1.2, 0.5, 0.5 * np.pi), np.linspace(0.0, 6.0, 61)
    exact = reference(lambda time, q: 1.2 * math.cos(math.pi * time + 0.5 * math.pi), t)
    simulation = plain_run(free('x'), method, 0.004, [0.0], [0.0], bristles(), load)
    found = np.array([[0.0, 0.0]] + [
        [simulation.record(1, 25)[0].item(), simulation.system.effect_state.resting[0]]
        for _ in t[1:]])
    # Order 2 with h omega = 0.13, at swings of 1 mm: 0.03 % measured.
    assert np.abs(found[:, 0] - exact[0]).max() <= 1e-3 * np.abs(exact[0]).max()
    assert np.abs(found[:, 1] - exact[2]).max() <= 1e-3 * np.abs(exact[2]).max()
    loops = [np.trapezoid(np.sin(-np.pi * t[20:]), q[20:]) for q in (found[:, 0], exact[0])]
    assert loops[0] == pytest.approx(loops[1], rel=2e-3)
    assert loops[1] > 0.0


@pytest.mark.long
@pytest.mark.parametrize('method', SECOND_ORDER)
def test_stick_slip_has_the_period_of_dop853(method, measured):
    """A mass on a belt spring that is pulled at 0.1 m/s: y' = 0.1 by H."""
    hamiltonian = Formula(['x', 'y'], 'p_x^2/2 + (x - y)^2 + 0.1*p_y')
    simulation = Simulation(hamiltonian, INTEGRATORS[method](), 0.002, [0.0, 0.0], [0.0, 0.0],
                            [bristles()])
    t = np.linspace(0.0, 60.0, 6001)
    q = np.append(0.0, simulation.record(6000, 5)[0][:, 0])
    exact = reference(lambda time, q: 2.0 * (0.1 * time - q), t)[0]
    periods = [np.diff(slips(t, path)) for path in (q, exact)]
    assert len(periods[0]) == len(periods[1]) >= 3
    measured('stick-slip period', method, periods[0].mean() / periods[1].mean() - 1.0,
             'within 1e-3')
    assert periods[0] == pytest.approx(periods[1], rel=1e-3)


def slips(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the times at which a speed of 0.1 m/s is exceeded."""
    v = np.gradient(q, t)
    above = np.flatnonzero((v[1:] > 0.1) & (v[:-1] <= 0.1))
    return t[above] + (0.1 - v[above]) / (v[above + 1] - v[above]) * (t[1] - t[0])


@pytest.mark.parametrize('method', ['variational_euler', *SECOND_ORDER])
def test_bristles_stay_in_their_bound_at_steps_far_beyond_their_rate(method):
    """Of 1e5 relaxations a step; a mass that slides stops as under Coulomb friction."""
    simulation = plain_run(free('x'), method, 0.01, [0.0], [10.0], effect(
        'lugre_friction', 'x', 1e6, 1.0))
    bound, speeds = 1e-6 * (1.0 + 4 * EPS), []
    for _ in range(500):
        simulation.advance(1)
        assert abs(simulation.system.effect_state.resting[0]) <= bound
        speeds.append(simulation.p[0])
    # The first step bends the bristles.
    assert speeds == pytest.approx(10.0 - 0.01 * np.arange(1, 501), abs=0.011)


def test_bristles_act_beside_all_kinds_of_effects():
    """Of a bath, a rod and stops, each has arrays for the channels of forces."""
    two = [bristles('x'), bristles('z')]
    for others, q in (([effect('thermostat', 0.1, 1.0)], [0.6, 0.8]),
                      ([effect('holonomic_constraint', ['x', 'z'], anchor=[0.0, 0.0])],
                       [0.6, 0.8]),
                      ([effect('joint_limits', lower={'x': 0.5}, restitution=0.5)], [0.6, 0.8])):
        simulation = plain_run(free('x', 'z'), 'generalized_leapfrog', 0.01, q, [-0.8, 0.6],
                               *two, *others)
        simulation.advance(50)
        assert np.isfinite(simulation.row).all()
        assert abs(simulation.energy_balance) < 5e-3
        assert (np.abs(simulation.system.effect_state.resting[:2]) <= 1.5e-3).all()
        assert (simulation.system.effect_state.resting[:2] != 0.0).all()


def test_bristles_store_or_lose_energy_but_add_none():
    simulation = plain_run(free('x'), 'implicit_midpoint', 0.001, [0.0], [0.3], bristles())
    last = np.inf
    for _ in range(800):
        simulation.advance(1)
        stored = 500.0 * simulation.system.effect_state.resting[0]**2
        assert simulation.energy + stored <= last + 1e-12
        last = simulation.energy + stored
        assert simulation.energy_balance == pytest.approx(0.0, abs=1e-12)
    assert last < 1e-3


def both(h: float = 0.05, method: str = 'implicit_midpoint') -> Simulation:
    """Return a driven pendulum with bristles and a motor."""
    simulation = plain_run('pendulum', method, h, [0.7], [0.0],
                           bristles('angle', stiffness=50.0, speed=0.5),
                           effect('motor', 'angle', 0.2, 4.0, 6.0),
                           effect('external_force', ['angle'], 100.0))
    simulation.set_command([3.0])
    return simulation


@pytest.mark.parametrize('method', ['implicit_midpoint', *KEEPING])
def test_internal_variables_belong_to_snapshots_and_to_restarts(method):
    whole, resumed = both(method=method), both(method=method)
    whole.advance(20)
    snapshot = whole.snapshot()
    assert (snapshot['live.resting'][:2] != 0.0).all()
    whole.advance(20)
    resumed.advance(3)
    resumed.probe.trial(resumed.row, 0.02)
    resumed.restore(snapshot)
    resumed.advance(20)
    assert np.array_equal(resumed.row, whole.row)
    whole.restart([0.7], [0.0])
    assert (whole.system.effect_state.resting == 0.0).all()


@pytest.mark.parametrize('method', KEEPING)
def test_first_step_of_another_size_has_its_own_mean_rates(method):
    """Start as a trial, after steps of another size, and as a new run with a command: one path."""
    coarse, fine = both(method=method), both(0.01, method)
    paths = [fine.record(5, 1), coarse.probe.trial(coarse.row, 0.01, 5)]
    start = coarse.row
    coarse.advance(3)
    for path in (*paths, coarse.probe.trial(start, 0.01, 5)):
        assert np.array_equal(path, paths[0])


@pytest.mark.parametrize('method', [*KEEPING, *SECOND_ORDER])
@pytest.mark.parametrize('h', [0.001, 0.4])
def test_motor_follows_a_held_command_exactly_at_any_step(method, h):
    simulation = plain_run(free('x'), method, h, [0.0], [0.0], effect('motor', 'x', 0.1),
                           effect('external_force', ['x'], 100.0))
    for command, start in ((2.0, 0.0), (-1.0, 2.0 * -math.expm1(-5 * h / 0.1))):
        simulation.set_command([command])
        simulation.advance(5)
        exact = command + (start - command) * math.exp(-5 * h / 0.1)
        assert simulation.system.effect_state.resting[0] == pytest.approx(exact, abs=1e-14)
    if method == 'implicit_midpoint':
        assert simulation.work == pytest.approx(simulation.energy, rel=1e-12)


def test_motor_at_its_torque_limit_nears_its_no_load_speed():
    """Take v' = tau (1 - v / w), of which v = w (1 - exp(-tau t / w)) is the solution."""
    simulation = plain_run(free('x'), 'implicit_midpoint', 0.01, [0.0], [0.0], effect(
        'motor', 'x', torque_limit=2.0, no_load_speed=3.0), effect('external_force', ['x'], 100.0))
    simulation.set_command([9.0])
    v = simulation.record(200, 1)[1].ravel()
    # The midpoint rule for a rate of 2/3 errs by (2/3 h)^2 / 12 of v.
    assert v == pytest.approx(-3.0 * np.expm1(-2.0 / 3.0 * 0.01 * np.arange(1, 201)), abs=1e-5)
    simulation.set_command([0.0])
    simulation.advance(1)
    assert simulation.p[0] == v[-1]


@pytest.mark.parametrize(('braking', 'speed', 'force'), [
    ('full', 4.0, -2.0), ('full', -4.0, 2.0), ('limited', 1.0, -2.0 * (1.0 - 1.0 / 3.0)),
    ('full', 1.0, -2.0), ('full', -1.0, -2.0 * (1.0 - 1.0 / 3.0)), ('full', 3.5, -2.0)])
def test_full_braking_is_that_of_a_dc_motor_with_a_current_limit(braking, speed, force):
    """Take tau_max against v at any speed, and the line along v."""
    simulation = plain_run(free('x'), 'implicit_midpoint', 1e-6, [0.0], [speed], effect(
        'motor', 'x', torque_limit=2.0, no_load_speed=3.0, braking=braking),
        effect('external_force', ['x'], 100.0))
    simulation.set_command([math.copysign(9.0, force)])
    simulation.advance(1)
    # The torque over a step of 1 us, with the round-off of the speed; the line falls by 1e-6.
    assert (simulation.p[0] - speed) / 1e-6 == pytest.approx(force, rel=1e-5)


@pytest.mark.parametrize('method', [*KEEPING, 'symplectic_euler_adjoint', *SECOND_ORDER])
def test_derivatives_are_differences_of_order_6_with_internal_forces(method):
    """By initial states and commands, over two segments, through reversals of the motion."""
    run = DifferentiableRun(Uncompiled(HAMILTONIANS['pendulum']()), INTEGRATORS[method](), 0.02, [
        bristles('angle', stiffness=60.0, speed=0.5, bristle_damping=0.1),
        effect('periodic_drive', 'angle', 1.0, 0.5), effect('motor', 'angle', 0.15, 4.0, 6.0),
        effect('external_force', ['angle'], 100.0)])
    z, dz, t = np.array([[0.8, -0.3], [0.3, 1.0]]), np.array([[0.6, -0.4], [0.2, 0.9]]), \
        0.2 * np.arange(80)[:, None]
    commands, d_commands = 2.5 * np.sin(t), np.cos(0.5 * t)

    def at(distance: float) -> np.ndarray:
        return run.record(z + distance * dz, len(t), 1, commands + distance * d_commands)
    expected = difference(at, 1e-4)
    at(0.0)
    found, = run.push_forward([Change(dz, commands=d_commands)])
    # Rounding of some 1e-15 over the spacing.
    assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    cotangents, by_commands = np.random.default_rng(1).normal(size=found.shape), \
        np.empty_like(commands)
    by_start, _ = run.pull_back(cotangents, by_commands=by_commands)
    assert (by_start * dz).sum() + (by_commands * d_commands).sum() == pytest.approx(
        (cotangents * found).sum(), rel=1e-12)


@pytest.mark.long
def test_derivatives_by_numbers_are_differences_of_order_6_with_internal_forces():
    torch = pytest.importorskip('torch', reason='torch is not installed')
    from hnn_vi_ros.torch import simulate
    scene = load_scene('exact_pendulum').with_overrides(0.02, 'implicit_midpoint', effects=[
        {'kind': 'lugre_friction', 'coordinate': 'angle', **BRISTLES | {
            'stiffness': 60.0, 'speed': 0.5, 'bristle_damping': 0.1}},
        {'kind': 'motor', 'coordinate': 'angle', 'time_constant': 0.15, 'torque_limit': 4.0,
         'no_load_speed': 6.0, 'braking': 'full'},
        {'kind': 'external_force', 'coordinates': ['angle']}])
    commands = 2.5 * np.sin(0.2 * np.arange(80))[:, None]
    names = [*(f'effects.0.{name}' for name in BRISTLES), 'effects.1.time_constant',
             'effects.1.torque_limit', 'effects.1.no_load_speed']
    numbers = numbers_of(scene)
    values = [numbers[name] for name in names]

    def last(numbers: list) -> object:
        motion = simulate(scene, torch.tensor([[0.8]]).double(),
                          torch.tensor([[-0.3]]).double(), duration=1.6,
                          commands=torch.tensor(commands), every=1,
                          parameters=dict(zip(names, numbers, strict=True)))
        return motion.q[-1].sum() + 0.3 * motion.p[-1].sum()
    tensors = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in values]
    found = torch.autograd.grad(last(tensors), tensors)
    for i, value in enumerate(values):
        def at(share: float, i: int = i, value: float = value) -> float:
            return float(last([torch.tensor(one + (one * share if k == i else 0.0),
                                            dtype=torch.float64)
                               for k, one in enumerate(values)]))
        expected = difference(at, 1e-3) / value
        # A change of a number moves the instants at which the motion reverses, where g has a kink.
        assert float(found[i]) == pytest.approx(expected, rel=1e-6, abs=1e-8), names[i]


def test_guard_names_bristles_that_steps_do_not_resolve_once():
    alarms = []
    for h in (0.03, 0.05):
        simulation = plain_run(free('x'), 'implicit_midpoint', h, [0.0], [0.0],
                               bristles(bristle_damping=1.0))
        watch = Watch(RunFacts(simulation))
        for _ in range(2):
            watch.update(look(simulation))
        alarms.append(watch.alarms)
    assert alarms[0] == []
    assert [alarm.value for alarm in alarms[1]] == [pytest.approx(0.05 * math.sqrt(1000.0))]


@pytest.mark.parametrize('others', [
    [], [effect('external_force', ['z'])], [effect('external_force', ['x'], gain=2.0)]])
def test_motor_without_a_plain_command_is_refused(others):
    with refused(EffectError):
        System(free('x', 'z'), [effect('motor', 'x', 0.1), *others],
               INTEGRATORS['implicit_midpoint']())


def test_controllers_refuse_internal_variables():
    scene = load_scene('exact_pendulum').with_overrides(0.01, 'implicit_midpoint', effects=[
        {'kind': 'lugre_friction', 'coordinate': 'angle', 'stiffness': 50.0, 'drive': 'mx64'}])
    with refused(UnsupportedSystem):
        BatchStep(scene, 5)


def test_drives_have_positive_numbers_and_the_limits_of_their_voltage():
    for name, drive in DRIVES.items():
        own = effect('lugre_friction', 'x', 100.0, drive=name).numbers
        assert (own.friction, own.stribeck, own.damping) == (
            drive.friction, drive.stribeck, drive.damping)
        if drive.volts is not None:
            motor = effect('motor', 'x', drive=name)
            assert motor.torque_limit / motor.no_load_speed == pytest.approx(
                drive.torque_constant**2 / drive.resistance)
