# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Servos: their answers to steps, their limits, and the paths that they follow."""

from helpers import EPS, long, plain_run, Uncompiled
from hnn_vi_ros.effects import ExternalForce, JointCommand, JointPath
from hnn_vi_ros.effects.drives import find_drive
from hnn_vi_ros.effects.joint_limits import JointLimits
from hnn_vi_ros.effects.servo import MOST_KNOTS, OFF, Servo
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Change, DifferentiableRun, Simulation
from messages import refused
import numpy as np
from numpy.polynomial import Polynomial
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

NAN, INF = float('nan'), float('inf')
MASS, STIFFNESS, DAMPING = 2.0, 18.0, 3.0


def servo(*names: str, h: float = 0.02, integrator: str = 'gauss8', q=0.0, p=0.0,
          system: str = 'free_particle', more=(), **arguments) -> Simulation:
    """Return a servo for each of some free masses, or for a pendulum."""
    hamiltonian = HAMILTONIANS[system](*[MASS, names] if system == 'free_particle' else [])
    arguments = {'stiffness': STIFFNESS, 'damping': DAMPING} | arguments
    return plain_run(Uncompiled(hamiltonian), integrator, h, np.full(len(names), q),
                     np.full(len(names), p), Servo(list(names), **arguments), *more)


def command(names: str | list[str], position=NAN, velocity=NAN, effort=NAN) -> JointCommand:
    """Return a command of joints whose names are letters."""
    return JointCommand(tuple(names), position, velocity, effort)


def path(t: list[float], *columns, names: str = 'x', delay: float = 0.0) -> JointPath:
    """Return a path of one joint, or of several that do the same."""
    return JointPath(tuple(names), delay, np.array(t), *(
        np.tile(np.array(column, dtype=float)[:, None], len(names)) for column in columns))


@pytest.mark.parametrize('integrator, tolerance', [
    # The rounding of 100 steps, and their error: of order 2 at w h = 0.06.
    ('gauss8', 1e-11), ('generalized_leapfrog', 2e-3)])
def test_servo_answers_a_step_as_a_damped_oscillator(integrator, tolerance):
    simulation = servo('x', integrator=integrator)
    simulation.set_command(command('x', position=0.5))
    q, p = (part[:, 0] for part in simulation.record(100, 1))
    rate, t = DAMPING / (2.0 * MASS), 0.02 * np.arange(1, 101)
    omega = np.sqrt(STIFFNESS / MASS - rate**2)
    decay = 0.5 * np.exp(-rate * t)
    exact = 0.5 - decay * (np.cos(omega * t) + rate / omega * np.sin(omega * t))
    assert np.abs(q - exact).max() < tolerance
    assert np.abs(p / MASS - decay * (omega + rate**2 / omega) * np.sin(omega * t)).max() \
        < 5.0 * tolerance
    # All energy is its work; the rest of the method's error is of its order as well.
    assert simulation.works == {'servo': pytest.approx(simulation.energy, abs=tolerance)}


def test_servo_without_a_position_brings_the_velocity_to_what_is_commanded():
    simulation = servo('x')
    simulation.set_command(command('x', velocity=-0.4))
    simulation.advance(100)
    # m v' = c (v_r - v).
    assert simulation.p[0] / MASS == pytest.approx(-0.4 * -np.expm1(-DAMPING * 2.0 / MASS),
                                                   abs=1e-12)


@pytest.mark.parametrize('integrator', ['variational_euler', 'generalized_leapfrog', 'rk4'])
def test_servo_applies_no_more_than_its_limit(integrator):
    simulation = servo('x', 'y', integrator=integrator, effort_limit=[0.25, INF],
                       position=[100.0, 0.0])
    simulation.set_command(command('y', effort=NAN, position=0.0))
    simulation.advance(10)
    # A constant force, and none.
    assert simulation.p == pytest.approx([0.25 * 0.2, 0.0], abs=1e-15)
    assert simulation.motors.forces(0.2, simulation.q, simulation.p, simulation.dH_dp).tolist() \
        == [0.25, 0.0]
    simulation.set_command(command('x', position=-100.0))
    simulation.advance(10)
    assert simulation.p[0] == pytest.approx(0.0, abs=1e-15)


def test_joints_that_are_not_named_do_what_they_did_and_no_command_is_no_force():
    simulation = servo('x', 'y', 'z')
    simulation.advance(5)
    assert (simulation.p == 0.0).all()
    simulation.set_command(command('yx', position=[0.1, NAN], velocity=[0.3, 0.2]))
    aim = simulation.motors.servo_target
    assert aim.names == ['x', 'y', 'z'] and not aim.on_path
    np.testing.assert_array_equal(aim.targets, [[NAN, 0.1, NAN], [0.2, 0.3, NAN], [0.0] * 3])
    simulation.set_command(command('z', position=1.0))
    np.testing.assert_array_equal(simulation.motors.servo_target.targets[0], [NAN, 0.1, 1.0])
    simulation.restart(simulation.q, simulation.p)
    assert np.isnan(simulation.motors.servo_target.targets[:2]).all()


def test_effort_beside_a_position_is_that_of_the_external_force():
    simulation = servo('x', 'y', more=[ExternalForce(['y', 'x'], 0.1)])
    simulation.set_command(command('xy', position=[0.0, NAN], effort=[1.5, -2.0]))
    forces = simulation.motors.forces(0.0, simulation.q, simulation.p, simulation.dH_dp)
    assert forces.tolist() == [1.5, -2.0] == (-simulation.dH_dq).tolist()
    # One that is named alone leaves the other until they end, and does not renew what has ended.
    simulation.set_command(command('x', effort=0.5))
    assert simulation.dH_dq.tolist() == [-0.5, 2.0]
    simulation.advance(10)
    simulation.set_command(command('x', effort=0.5, position=simulation.q[0]))
    assert simulation.dH_dq[1] == 0.0


LIMITS = JointLimits(lower={'x': -1.0}, upper={'x': 0.5, 'y': 2.0})


@pytest.mark.parametrize('given', [
    command('xw', position=1.0), command('xx', position=1.0), command('x', position=INF),
    command('yx', velocity=[1.0, -1e13]), command('x'), command('x', effort=1.0), [1.0, 2.0],
    path([1.0], [0.0]), path([], [], names='x'),
    path(range(MOST_KNOTS), [0.0] * MOST_KNOTS, names='xy'),
    path([1.0, 1.0], [0.0] * 2, names='xy'), path([NAN], [0.0], names='xy'),
    path([-1.0, 1.0], [0.0] * 2, names='xy'), path([-1.0, 1.0], [0.0] * 2, names='xy', delay=5.0),
    path([1.0], [INF], names='xy'), path([1.0], [1.0], [0.0], [NAN], names='xy'),
    path([1.0], [1.0], names='xy')._replace(accelerations=np.zeros((1, 2))),
    path([1.0], [1.0], [0.5], names='xy'), path([0.0], [1.0], names='xy'),
    path([1.0], [1.0], names='xy', delay=-3.0), path([1.0], [1.0], names='xy', delay=1.7e9),
    path([1.0, 2.0], [1e13, 0.0], names='xy'),
    # Beyond a limit.
    command('yx', position=[0.0, 0.6]), command('x', position=-1.5),
    command('xy', position=[NAN, 3.0], velocity=0.0),
    path([1.0, 2.0, 3.0], [0.0, -1.25, 0.5], names='xy'),
    # Other shapes.
    command('xy', position=[0.1]), JointPath(['x', 'y'], 0.0, [1.0], [0.1, 0.2])])
def test_command_that_cannot_be_used_is_refused_whole_and_the_last_one_stays(given):
    simulation = servo('x', 'y', more=[LIMITS], integrator='generalized_leapfrog')
    simulation.set_command(command('xy', position=0.3))
    before = simulation.motors.servo_target.targets
    with refused(ValueError):
        simulation.set_command(given)
    assert np.array_equal(simulation.motors.servo_target.targets, before)


@pytest.mark.parametrize('columns', [1, 2, 3])
def test_points_that_are_one_to_the_clock_are_refused(columns):
    """After three years numbers of time are 15 ns apart."""
    simulation = servo('x')
    simulation.restart([0.0], [0.0], step=round(1e8 / 0.02))
    with refused(ValueError):
        simulation.set_command(path([1.0, 1.0 + 1e-9, 2.0], *[[0.0, 1.0, 0.0]] * columns))
    assert not simulation.motors.servo_target.on_path


@pytest.mark.parametrize('given', [
    path([1.0], [0.0], names=['\x1b[31mred', 'a\nb']),
    command(['\x1b[31mred', '\x1b[31mred'], position=0.0),
    command(['\x1b[31mred'], position=0.0)])
def test_names_of_joints_are_told_in_characters_that_print(given):
    with pytest.raises(ValueError) as refused:
        servo('x', 'y').set_command(given)
    assert str(refused.value).isprintable() and 'red' in str(refused.value)


def test_path_takes_lists():
    simulation = servo('x')
    simulation.set_command(JointPath(['x'], 0.0, [0.0, 1.0], [[0.0], [0.5]]))
    simulation.advance(25)
    assert simulation.motors.servo_target.targets[0] == pytest.approx([0.25])


def test_half_of_a_command_that_cannot_be_used_leaves_the_other_half():
    simulation = servo('x', more=[ExternalForce(['x'])])
    with refused(ValueError):
        simulation.set_command(command('x', position=1.0, effort=INF))
    assert np.isnan(simulation.motors.servo_target.targets[0, 0]) and simulation.dH_dq[0] == 0.0


def aims(simulation: Simulation, steps: int) -> np.ndarray:
    """Return the targets of the first joint after each step, shape (steps, 3)."""
    found = []
    for _ in range(steps):
        simulation.advance(1)
        found.append(simulation.motors.servo_target.targets[:, 0])
    return np.array(found)


@pytest.mark.parametrize('degree', [3, 5])
def test_path_through_points_of_a_polynomial_is_that_polynomial(degree):
    """By knots that are no whole steps, from a rest at x = 0 to one at t = 1."""
    exact = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0] if degree == 5 else [0.0, 0.0, 3.0, -2.0])
    derivatives = [exact, exact.deriv(), exact.deriv(2)]
    t, simulation = np.array([0.217, 0.5, 0.831, 1.0]), servo('x', h=0.025)
    simulation.set_command(path(t, *(one(t) for one in derivatives[:(degree + 1) // 2])))
    found, times = aims(simulation, 44), 0.025 * np.arange(1, 45)
    inside = times < 1.0 - 1e-9
    for one, column in zip(derivatives, found.T, strict=True):
        # Differences of positions, over the square of a segment of 0.17 s.
        assert np.abs(column - one(times))[inside].max() < 1e5 * EPS
    # It stays at its end.
    assert found[~inside, 0] == pytest.approx(1.0, abs=1e-14)
    assert found[~inside][1:, 1:] == pytest.approx(0.0)


def test_path_of_positions_alone_is_the_cubic_spline_that_rests_at_its_ends():
    t, q = np.array([0.2, 0.5, 0.6, 1.0]), np.array([0.3, -0.1, 0.2, 0.4])
    simulation = servo('x', h=0.025)
    simulation.set_command(path(t, q))
    spline = CubicSpline([0.0, *t], [0.0, *q], bc_type='clamped')
    found, times = aims(simulation, 39), 0.025 * np.arange(1, 40)
    for n, column in enumerate(found.T):
        assert column == pytest.approx(spline(times, n), abs=1e-10)


def test_path_begins_where_the_joints_are_to_be_then():
    simulation = servo('x', h=0.01)
    simulation.set_command(path([1.0], [1.0], [0.0], [0.0]))
    simulation.advance(30)
    before = simulation.motors.servo_target.targets
    # Points that are past do not count.
    simulation.set_command(path([0.1, 1.0], [7.0, -1.0], [0.0] * 2, [0.0] * 2, delay=-0.15))
    assert simulation.motors.servo_target.targets == pytest.approx(before, abs=1e-12)
    assert aims(simulation, 85)[-1] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)
    # And so does one that is commanded while nothing was: from where the joint is.
    other = servo('x', q=0.25)
    other.set_command(path([1.0], [1.0], delay=0.5))
    assert other.motors.servo_target.targets[:2, 0] == pytest.approx([0.25, 0.0], abs=1e-15)
    other.set_command(command('x', position=0.5))
    assert not other.motors.servo_target.on_path


@pytest.mark.parametrize('count', [5, long(40)])
def test_servo_follows_paths_with_the_analytic_tracking_error(count: int, measured):
    """Solve m e'' + c e' + k e = m r'' for quintics r from rest to rest: 25 joints, 40 paths."""
    names, rng, h, worst = [f'x{i}' for i in range(25)], np.random.default_rng(7), 0.02, 0.0
    for _ in range(count):
        simulation = servo(*names, h=h, integrator='rk4')
        ends, steps = rng.uniform(-2.0, 2.0, 25), int(rng.integers(25, 60))
        duration = steps * h * rng.uniform(1.0, 1.2)
        still = np.zeros((1, 25))
        simulation.set_command(
            JointPath(names, 0.0, np.array([duration]), ends[None], still, still))
        simulation.advance(steps)
        shape = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0], [0.0, duration], [0.0, 1.0])
        forcing = [shape.deriv(n)(0.0) for n in range(2, 6)]
        # (e, e') with r'' and its three derivatives, of which the last is constant.
        chain = np.eye(6, k=1)
        chain[1] = [-STIFFNESS / MASS, -DAMPING / MASS, 1.0, 0.0, 0.0, 0.0]
        lag = (expm(chain * steps * h) @ [0.0, 0.0, *forcing])[0]
        worst = max(worst, np.abs(simulation.q - ends * (shape(steps * h) - lag)).max())
    # Order 4 at w h = 0.06: (w h)^5 / 120 of paths up to 2, in each of 60 steps.
    if count == 40:
        measured('tracking error of a servo against its exact one', '1000 paths, rk4', worst,
                 '<= 1e-6')
    assert worst <= 1e-6


@pytest.mark.parametrize('integrator, lengths', [
    ('generalized_leapfrog', (40, 80)), ('gauss4', (10, 20)), ('rk4', (40, 80))])
def test_method_keeps_its_order_and_the_balance_along_a_path(integrator, lengths):
    def run(n: int, method: str = integrator) -> Simulation:
        simulation = servo('angle', h=1.0 / n, integrator=method, system='pendulum', q=0.7)
        simulation.set_command(path([1.2], [-0.4], [0.0], [0.0], names=['angle']))
        simulation.advance(n)
        return simulation

    exact = run(40, 'gauss8')
    assert abs(exact.energy_balance) < 1e-11
    errors, balances = np.transpose([
        (np.abs(simulation.q - exact.q).max(), abs(simulation.energy_balance))
        for simulation in map(run, lengths)])
    order = INTEGRATORS[integrator]().order
    for values in (errors, balances):
        assert np.log2(values[0] / values[1]) > order - 0.35


def test_position_on_a_limit_to_the_digits_of_a_file_is_taken():
    simulation = servo('x', 'y', more=[LIMITS], integrator='generalized_leapfrog')
    simulation.set_command(command('x', position=0.5 + 1e-12))
    simulation.set_command(path([1.0], [0.5 * (1.0 + EPS)], names='xy'))
    assert simulation.motors.servo_target.on_path


@pytest.mark.parametrize('names', ['', 'xy'])
def test_path_without_points_ends_the_one_before_where_it_is(names):
    simulation = servo('x', 'y', q=0.2)
    simulation.set_command(path([1.0], [1.0], names='xy'))
    simulation.advance(20)
    now = simulation.motors.servo_target.targets
    assert (now[:2] > 0.1).all()
    simulation.set_command(path([], [], names=names))
    simulation.advance(5)
    aim = simulation.motors.servo_target
    assert not aim.on_path
    np.testing.assert_array_equal(aim.targets, [now[0], [0.0, 0.0], [0.0, 0.0]])


def test_path_without_points_holds_joints_that_nothing_drives_where_they_are():
    simulation = servo('x', 'y', q=0.2, p=1.0)
    simulation.advance(10)
    q = simulation.q.copy()
    simulation.set_command(path([], [], names='xy'))
    np.testing.assert_array_equal(
        simulation.motors.servo_target.targets, [q, [0.0] * 2, [0.0] * 2])


def test_back_emf_takes_its_part_of_the_limit_of_the_voltage():
    simulation = servo('x', effort_limit=0.5, back_emf=0.8, position=[1e6])
    simulation.advance(100)
    # m v' = F - b v: a motor at full voltage, up to its no-load speed.
    assert simulation.p[0] / MASS == pytest.approx(
        0.5 / 0.8 * -np.expm1(-0.8 * 2.0 / MASS), abs=1e-12)
    # Without a target it is off.
    off = servo('x', back_emf=0.8, p=1.0)
    off.advance(100)
    assert off.p[0] == 1.0


@pytest.mark.parametrize('integrator', ['implicit_midpoint', 'rk4'])
def test_punch_adds_the_torque_of_the_least_voltage_within_the_limit(integrator):
    simulation = servo('x', 'y', 'z', integrator=integrator, punch=[0.5, 0.5, 0.0],
                       effort_limit=20.0, damping=0.0, position=[-0.1, 100.0, -0.1])
    forces = simulation.motors.forces(0.0, simulation.q, simulation.p, simulation.dH_dp)
    force = -0.1 * STIFFNESS
    assert forces == pytest.approx([force + 0.5 * np.tanh(force / 0.25), 20.0, force], abs=1e-14)
    # Full force but for 2 exp(-14.4); near the target it has three times the stiffness.
    assert forces[0] == pytest.approx(force - 0.5, abs=1e-6)
    near = simulation.motors.forces(0.0, np.array([-0.1 + 1e-5, 0.0, 0.0]), simulation.p,
                                    simulation.dH_dp)[0]
    assert near == pytest.approx(-3e-5 * STIFFNESS, rel=1e-6)


def test_friction_of_the_gear_takes_a_part_of_the_torque_that_drives_or_brakes():
    simulation = servo('x', 'y', 'z', load=[0.3, 0.3, 0.0], speed=0.5, back_emf=0.2, damping=0.0,
                       effort_limit=2.0, position=[100.0, -100.0, 100.0])
    v = np.array([0.8, 0.8, 0.8])
    forces = simulation.motors.forces(0.0, simulation.q, MASS * v, v)
    torque = np.array([2.0, -2.0, 2.0]) - 0.16
    lost = np.array([0.3, 0.3, 0.0]) * np.abs(torque) * np.tanh(1.6)
    assert forces == pytest.approx(torque - lost, abs=1e-14)
    # Without a target, no torque passes through the gear.
    off = servo('x', load=0.3, p=1.0)
    off.advance(10)
    assert off.p[0] == 1.0


def test_commands_are_in_readings_of_the_encoder():
    simulation = servo('x', offset=0.3, q=0.2, position=[0.5])
    simulation.advance(10)
    assert (simulation.q, simulation.p) == (pytest.approx([0.2], abs=1e-15), pytest.approx([0.0]))


def test_commands_act_after_their_delay():
    # Steps whose times are not rounded.
    late, other = (servo('x', 'y', h=1.0 / 64, delay=delay, position=[0.1, -0.1])
                   for delay in (3.0 / 64, 0.0))
    waiting: list[tuple[int, JointCommand]] = []
    rng = np.random.default_rng(3)
    for step in range(60):
        if step % 4 != 3:
            one = command('xy'[step % 2], *([rng.normal(), NAN] if step % 3 else
                                            [NAN, rng.normal()]))
            late.set_command(one)
            waiting.append((step + 3, one))
        for due, one in waiting:
            if due == step:
                other.set_command(one)
        np.testing.assert_array_equal(late.motors.servo_target.targets[:2],
                                      other.motors.servo_target.targets[:2])
        np.testing.assert_array_equal(late.q, other.q)
        for simulation in (late, other):
            simulation.advance(1)
    saved = late.snapshot()
    late.advance(5)
    after = late.q.copy()
    late.restore(saved)
    late.advance(5)
    np.testing.assert_array_equal(late.q, after)


@pytest.mark.parametrize('delay', [0.0, 5.0 / 64])
def test_reference_follows_positions_at_its_largest_rate(delay):
    """Positions of two joints at random times, as r' = w sign(position - r) would follow them."""
    h, rates, rng = 1.0 / 64, 1.3, np.random.default_rng(4)
    simulation = servo('x', 'y', h=h, delay=delay, position=[0.1, -0.1], rate_limit=rates)
    r, goals, waiting = np.array([0.1, -0.1]), np.array([0.1, -0.1]), dict[int, np.ndarray]()
    for step in range(150):
        if rng.integers(4) == 0:
            own = np.where(rng.integers(2, size=2), rng.normal(size=2), NAN)
            waiting[step + round(delay / h)] = own
            if not np.isnan(own).all():
                simulation.set_command(command('xy', position=own))
        if step in waiting:
            goals = np.where(np.isnan(waiting[step]), goals, waiting[step])
        target = simulation.motors.servo_target
        # Rounding of differences of times.
        assert target.targets[0] == pytest.approx(r, abs=1e-12)
        assert not target.targets[1:].any() and not target.on_path
        simulation.advance(1)
        r = r + np.clip(goals - r, -rates * h, rates * h)
    simulation.set_command(path([0.3, 0.5], [1.0, 0.7], names='xy'))
    simulation.advance(64)
    assert simulation.motors.servo_target.targets[0] == pytest.approx([0.7, 0.7], abs=1e-12)


def test_joint_that_follows_nothing_yet_starts_its_ramp_where_it_is():
    simulation = servo('x', h=0.01, q=0.2, offset=0.05, rate_limit=1.0)
    simulation.set_command(command('x', position=1.0))
    assert aims(simulation, 3)[:, 0] == pytest.approx([0.26, 0.27, 0.28], abs=1e-12)


def random_command(rng: np.random.Generator) -> JointCommand | JointPath:
    """Return positions, a path of degree 3 or 5, one of positions, or none, with whole steps."""
    kind, t = rng.integers(6), np.cumsum(rng.integers(2, 13, 3)) / 64.0
    if kind < 3:
        return command(('x', 'y', 'xy')[rng.integers(3)], *rng.normal(size=2))
    points = [rng.normal(size=3), np.array([*rng.normal(size=2), 0.0]), rng.normal(size=3)]
    return path(t, *points[:kind - 2], names='yx', delay=rng.integers(-1, 7) / 64.0) \
        if rng.integers(5) else path([], [], names='xy')


@pytest.mark.parametrize('seed', range(4))
def test_paths_and_commands_act_after_their_delay_in_any_order(seed):
    # Steps whose times are not rounded.
    late, other = (servo('x', 'y', h=1.0 / 64, delay=delay, position=[0.1, -0.1])
                   for delay in (5.0 / 64, 0.0))
    waiting, rng = dict[int, JointCommand | JointPath](), np.random.default_rng(seed)
    for step in range(120):
        if rng.integers(3) == 0:
            waiting[step + 5] = random_command(rng)
            late.set_command(waiting[step + 5])
        if step in waiting:
            other.set_command(waiting[step])
        one, rest = late.motors.servo_target, other.motors.servo_target
        # Segments are split when the next command comes: rounding of their polynomials, over the
        # square of a part of a segment.
        np.testing.assert_allclose(one.targets, rest.targets, rtol=1e-6, atol=1e-6)
        assert one.on_path == rest.on_path
        for simulation in (late, other):
            simulation.advance(1)
        assert late.q == pytest.approx(other.q, abs=1e-9)


def after_steps(integrator: str, n: int, delay: float) -> tuple[np.ndarray, float]:
    """Return q and p of a pendulum each tenth of a second, with n steps in it, and the balance."""
    simulation = servo('angle', h=0.1 / n, integrator=integrator, system='pendulum', q=0.2,
                       position=[0.2], delay=delay)
    found = []
    for target in (1.2, -0.8):
        simulation.set_command(command(['angle'], position=target, velocity=0.5))
        found.append(np.hstack(simulation.record(10, n)))
    return np.vstack(found), abs(simulation.energy_balance)


@pytest.mark.parametrize('delay', [0.25, 0.263, 0.007])
@pytest.mark.parametrize('integrator, n', [
    ('variational_euler', 16), ('symplectic_euler', 16), ('implicit_midpoint', 4),
    ('generalized_leapfrog', 4), ('rk4', 4), ('gauss4', 4), ('yoshida4', 4), ('kahan_li8', 2)])
def test_method_keeps_its_order_with_any_delay(integrator, n, delay):
    """Delays of whole steps, with a fraction of a step, and of less than a step."""
    exact, balance = after_steps('gauss16', 2, delay)
    # Steps of any size end at the times when commands act.
    again, _ = after_steps('gauss16', 1, delay)
    assert again == pytest.approx(exact, abs=1e-11)
    assert balance < 1e-12
    errors = [np.abs(after_steps(integrator, k * n, delay)[0] - exact).max() for k in (1, 2)]
    assert np.log2(errors[0] / errors[1]) > INTEGRATORS[integrator]().order - 0.35


@pytest.mark.parametrize('integrator', ['generalized_leapfrog', 'rk4', 'variational_euler'])
def test_delay_of_whole_steps_gives_the_bits_of_later_commands(integrator):
    """Steps of .1 s are rounded, so that commands act a rounding before or after a step ends."""
    late, other = (servo('x', h=0.1, integrator=integrator, delay=delay, position=[0.1])
                   for delay in (0.3, 0.0))
    for step in range(40):
        late.set_command(command('x', position=np.sin(step)))
        if step >= 3:
            other.set_command(command('x', position=np.sin(step - 3)))
        assert late.motors.servo_target.targets.tolist() \
            == other.motors.servo_target.targets.tolist()
        late.advance(1)
        other.advance(1)
        assert (late.q.tolist(), late.p.tolist()) == (other.q.tolist(), other.p.tolist())


def test_more_commands_than_wait_for_a_delay_are_refused():
    simulation = servo('x', delay=1.0)
    for _ in range(MOST_KNOTS - 1):
        simulation.set_command(command('x', position=0.1))
    with refused(ValueError):
        simulation.set_command(command('x', position=0.1))


@pytest.mark.parametrize('given', [{'back_emf': -1.0}, {'delay': -0.1}, {'offset': NAN},
                                   {'punch': [-0.1]}, {'load': 1.1}, {'load': [0.1, -0.1]},
                                   {'speed': 0.0}])
def test_number_out_of_its_range_is_refused(given):
    with refused(ValueError):
        Servo(['x'], 1.0, **given)


@pytest.mark.parametrize('integrator', ['implicit_midpoint', 'gauss4', 'rk4'])
def test_references_of_a_servo_have_exact_tangents(integrator):
    """Two masses; one is switched off for two of four commands."""
    own = Servo(['x', 'y'], [18.0, 5.0], [3.0, 0.4], back_emf=0.2, offset=[0.1, 0.0])
    run = DifferentiableRun(Uncompiled(HAMILTONIANS['free_particle'](MASS, ['x', 'y'])),
                            INTEGRATORS[integrator](), 0.05, [own])
    z, rng = np.array([[0.2, -0.1, 0.3, 0.5]]), np.random.default_rng(5)
    commands, change = rng.normal(size=(2, 4, 2))
    commands[1:3, 1], change[1:3, 1] = OFF, 0.0
    ends = [run.record(z, 4, 3, commands + sign * 1e-3 * change)[-1] for sign in (1.0, -1.0)]
    run.record(z, 4, 3, commands)
    tangent = run.push_forward([Change(np.zeros_like(z), commands=change)])[0, -1]
    # Without limits the motion is linear in the commands, and differences have only round-off;
    # forces are differentiated by differences to eps^(2/3) = 4e-11.
    assert tangent == pytest.approx((ends[0] - ends[1]) / 2e-3, abs=1e-9)
    slopes, unit = np.empty_like(commands), np.array([[[0.0, 1.0, 0.0, 0.0]]])
    run.pull_back(np.concatenate([np.zeros((4, 1, 4)), unit]), by_commands=slopes)
    assert (slopes * change).sum() == pytest.approx(tangent[0, 1], abs=1e-9)
    assert (slopes[1:3, 1] == 0.0).all()


def test_drive_gives_the_limit_the_back_emf_and_the_friction_of_its_gear():
    simulation = servo('x', drive='sts3215_so101', position=[1e6])
    row, v = find_drive('sts3215_so101'), np.ones(1)
    torque = row.torque_limit - row.back_emf
    assert simulation.motors.forces(0.0, simulation.q, MASS * v, v) == pytest.approx(
        (1.0 - row.load) * torque)
    near = servo('x', drive='sts3215_so101', position=[0.05], damping=0.0)
    assert near.motors.forces(0.0, near.q, near.p, near.dH_dp) == pytest.approx(
        0.9 + row.punch * np.tanh(1.8 / row.punch))
    own = servo('x', drive='sts3215_so101', position=[1e6], load=0.1, back_emf=0.5)
    assert own.motors.forces(0.0, own.q, MASS * v, v) == pytest.approx(
        0.9 * (row.torque_limit - 0.5))
    simulation.advance(1000)
    # Full voltage: the no-load speed of the row, V / k_t, after many time constants.
    assert simulation.p[0] / MASS == pytest.approx(row.no_load_speed, rel=1e-3)
