# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that fail, or would grow: what each word of on_failure does about them."""

from helpers import effect, EPS, free, long, mostly_long, plain_run, Uncompiled
from hnn_vi_ros.errors import SceneError, StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS, time_transformed
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import (
    assembly, build, look, RescuePending, RunFacts, simulate_many, Simulation, Watch)
from hnn_vi_ros.simulation.guards.steps import CostGuard, RescueGuard
from hnn_vi_ros.simulation.rescue import ON_FAILURE, stability_limit
from messages import refused
import numpy as np
from plain_systems import Plain
import pytest
from scene_files import scene_text

OMEGA = 50.0
SCENE = scene_text('harmonic_oscillator, stiffness: 4.84', '', 'stormer_verlet', 1.0)


def stiff_chain(h_omega: float, on_failure: str, compiled: bool = False) -> Simulation:
    """Return case 8 of the hard cases: springs of h omega, with every mode excited."""
    chain = HAMILTONIANS['fput_chain'](omega=OMEGA)
    d = chain.dimension
    return plain_run(chain if compiled else Uncompiled(chain), 'stormer_verlet', h_omega / OMEGA,
                     [*[0.3] * (d - 1), 0.02], [1.0] * d, on_failure=on_failure)


def bounce(on_failure: str, speed: float, spring: float = 0.0, compiled: bool = False
           ) -> Simulation:
    """Return a mass that meets a wall, where h omega is 2.25; a spring may bring it back."""
    effects = [effect('soft_wall', 'x', 0.0, 'above', 2500.0, 0.5)]
    if spring:
        effects.append(effect('spring', ['x'], anchor=[3.0], stiffness=spring))
    particle = HAMILTONIANS['free_particle'](names=['x']) if compiled else free('x')
    return plain_run(particle, 'stormer_verlet', 0.045, [3.0], [-speed], *effects,
                     on_failure=on_failure)


def band(simulation: Simulation, steps: int) -> float:
    """Return the range of H over some steps, over its size at their start."""
    before = simulation.energy
    energies = simulation.hamiltonian.energy(*simulation.record(steps, 1))
    return float(np.ptp(np.append(energies, before)) / abs(before))


@pytest.mark.parametrize('name, arguments, limit', [
    ('stormer_verlet', (), 2.0),
    ('yoshida4', ('stormer_verlet',), 1.5734),
    # (1 - x^2/2 + x^4/24)^2 + (x - x^3/6)^2 = 1 at x^2 = 8.
    ('rk4', (), np.sqrt(8.0)),
    ('explicit_euler', (), np.inf),
    ('yoshida4', ('generalized_leapfrog',), np.inf),
    ('gauss4', (), np.inf),
    ('dop853', (), np.inf)])
def test_stability_limit_is_that_of_the_literature(name, arguments, limit):
    assert stability_limit(INTEGRATORS[name](*arguments)) == pytest.approx(limit, rel=1e-4)


def test_stop_takes_no_sub_steps():
    arguments = ('tao', 'variational_euler', 3.0, [2.0], [2.0])
    plain_run(*arguments).advance(1)
    with pytest.raises(StepFailure, match=r'eq. \(6\) has no solution connected'):
        plain_run(*arguments, on_failure='stop').advance(1)


def test_stop_still_tries_every_solver_of_the_chain():
    # The first attempt does not converge here within three iterations, Newton's method does.
    simulation = plain_run('tao', INTEGRATORS['variational_euler'](max_iterations=3), 0.05, [0.0],
                           [-3.0], on_failure='stop')
    simulation.advance(100)
    assert simulation.rescued == 0


def test_implicit_takes_explicit_steps_that_would_overflow_and_counts_them():
    arguments = ('harmonic_oscillator', 'rk4', 1e3, [1.0], [0.0])
    for how in set(ON_FAILURE) - {'implicit'}:
        with pytest.raises(StepFailure, match='not finite'):
            plain_run(*arguments, on_failure=how).advance(1000)
    simulation = plain_run(*arguments, on_failure='implicit')
    simulation.advance(1000)
    assert simulation.steps == simulation.rescued == 1000
    # The midpoint rule conserves a quadratic energy, up to the solver's residual.
    assert simulation.energy == pytest.approx(0.5, rel=1e-9)


def test_implicit_step_that_fails_is_taken_by_the_midpoint_rule():
    simulation = plain_run('tao', INTEGRATORS['variational_euler']('fixed_point'), 0.4, [1.0],
                           [-1.0], on_failure='implicit')
    simulation.advance(200)
    assert 0 < simulation.rescued < 200


@pytest.mark.parametrize('h_omega', [1.0, 1.8])
def test_implicit_leaves_explicit_steps_below_the_limit_alone_to_the_last_bit(h_omega):
    watched, plain = stiff_chain(h_omega, 'implicit'), stiff_chain(h_omega, 'stop')
    assert np.array_equal(watched.record(500, 1), plain.record(500, 1))
    assert watched.rescued == 0


@pytest.mark.parametrize('steps', [500, long(20_000)])
def test_implicit_holds_the_energy_of_stiff_springs_beyond_the_explicit_limit(steps):
    with pytest.raises(StepFailure, match='not finite'):
        stiff_chain(2.2, 'stop').advance(10)
    simulation = stiff_chain(2.2, 'implicit', compiled=steps > 1000)
    # Measured: 1.7e-3.
    assert band(simulation, steps) <= 4e-3
    assert simulation.rescued == simulation.steps == steps
    assert simulation.residual <= 1e-14


def test_implicit_takes_the_stiff_stretch_and_gives_back():
    simulation = bounce('implicit', 40.0)
    simulation.record(200, 1)
    # It has left the wall. Measured: with 0.28 of its energy lost, at h omega = 2.25; Störmer-
    # Verlet alone may gain any amount there.
    assert simulation.q[0] > 10.0
    assert simulation.energy == pytest.approx(800.0, rel=0.8)
    # At least one step at the wall, and the 16 calm ones after that.
    assert 16 < simulation.rescued < 40
    rescued = simulation.rescued
    simulation.advance(200)
    assert simulation.rescued == rescued


@pytest.mark.long
def test_implicit_stays_where_stretches_come_again_and_again():
    """Each change of method may change the energy: they become fewer, and it stays bounded."""
    with pytest.raises(StepFailure, match='not finite'):
        bounce('substep', 20.0, 4.0, compiled=True).advance(100_000)
    simulation = bounce('implicit', 20.0, 4.0, compiled=True)
    simulation.advance(10_000)
    # Measured: a factor of 8, at h omega = 2.25 in every bounce; and flat from there on.
    assert simulation.energy < 20.0 * 200.0
    rescued = simulation.rescued
    assert band(simulation, 10_000) < 1.0
    assert simulation.rescued - rescued > 9_500


def test_rescue_in_a_stiff_stretch_is_bit_identical_when_resumed():
    whole, resumed = bounce('implicit', 20.0, 4.0), bounce('implicit', 20.0, 4.0)
    while whole.rescued == 0:
        whole.advance(1)
    snapshot = whole.snapshot()
    resumed.restore(snapshot)
    assert np.array_equal(whole.record(200, 1), resumed.record(200, 1))


def test_rescue_by_the_midpoint_rule_counts_time_and_work_once():
    """What a drive does to stiff springs, against the same run at a hundredth of the step."""
    chain = Uncompiled(HAMILTONIANS['harmonic_oscillator'](stiffness=4.84))
    drive = effect('periodic_drive', chain.coordinates[0].name, 0.1, 0.02)
    coarse = plain_run(chain, 'stormer_verlet', 1.0, [1.0], [0.0], drive, on_failure='implicit')
    coarse.advance(20)
    assert coarse.rescued == 20
    assert coarse.snapshot()['live.clock'].sum() == 20.0
    # Of order 2, at h omega = 2.2: of the energy of 2.42 J it closes to a few hundredths.
    assert abs(coarse.energy_balance) <= 0.2


def test_implicit_refuses_an_effect_that_the_midpoint_rule_cannot_take():
    with refused(UnsupportedSystem):
        plain_run('pendulum', 'stormer_verlet', 0.01, [1.0], [0.0],
                  effect('thermostat', 0.1, 1.0), on_failure='implicit')


def test_unknown_on_failure_names_the_valid_ones():
    with refused(ValueError):
        plain_run('pendulum', 'rk4', 0.01, [1.0], [0.0], on_failure='hope')


def test_scene_says_what_is_done_about_a_step_that_fails(tmp_path):
    scene = tmp_path / 'scene.yaml'
    scene.write_text(SCENE)
    assert load_scene(scene).on_failure == 'substep'
    # h omega = 2.2: |H| grows by 5.9 a step, and after 500 of them is no number.
    with pytest.raises(StepFailure, match='not finite'):
        build(load_scene(scene)).advance(1000)
    scene.write_text(f'{SCENE}on_failure: implicit\n')
    simulation = build(load_scene(scene))
    simulation.advance(1000)
    # The midpoint rule conserves a quadratic energy.
    assert simulation.energy == pytest.approx(2.42, rel=1e-12)
    many = simulate_many(load_scene(scene), [[1.0], [2.0]], [[0.0], [0.0]], 10.0)
    assert many.energy[-1] == pytest.approx([2.42, 9.68], rel=1e-12)
    scene.write_text(f'{SCENE}on_failure: hope\n')
    with refused(SceneError):
        load_scene(scene)


def tao(h: float, q: float = 0.0, p: float = -1.5, **options) -> Simulation:
    """Return the generalised leapfrog on H = (q^2 + 1)(p^2 + 1) / 2, in plain Python."""
    H = Plain(lambda q, p: 0.5 * (q[0] ** 2 + 1.0) * (p[0] ** 2 + 1.0),
              lambda q, p: (q * (p * p + 1.0), (q * q + 1.0) * p), 1, separable=False)
    return Simulation(H, INTEGRATORS['generalized_leapfrog'](**options), h, [q], [p])


def watch_of_cost(simulation: Simulation) -> Watch:
    """Return the guard of slow steps alone."""
    return Watch(RunFacts(simulation), (CostGuard,))


@pytest.mark.parametrize('h, kinds', [(0.4, []), (5.0, ['slow step'])])
def test_slow_steps_of_generalized_leapfrog_beyond_its_limit_are_an_alarm(h: float, kinds: list):
    simulation = tao(h)
    watch = watch_of_cost(simulation)
    for _ in range(20):
        simulation.advance(1)
        watch.update(look(simulation))
    assert [alarm.kind for alarm in watch.alarms] == kinds
    # Two equations, ten gradients each as a rule.
    assert simulation.usual_gradients == 20
    assert (simulation.costliest[0] > 10 * 20) == bool(kinds)
    for alarm in watch.alarms:
        assert alarm.limit == 10 * 20 < alarm.value <= simulation.costliest[0]
        assert 'use a smaller step_size or another integrator' in alarm.message


def test_rescued_steps_are_an_alarm_that_counts_them():
    """Far below what a slow step is: with sub-steps the costliest takes 80 gradients of 100."""
    simulation = tao(0.8)
    watch = Watch(RunFacts(simulation), (RescueGuard,))
    for _ in range(20):
        simulation.advance(1)
        watch.update(look(simulation))
    assert simulation.rescued > 1
    first, = watch.alarms
    assert (first.kind, first.value) == ('rescued steps', 1)
    assert RescueGuard(simulation).update(look(simulation)).value == simulation.rescued


def test_costliest_step_is_the_same_however_steps_are_asked_for():
    together, one_by_one, costs = tao(0.8), tao(0.8), []
    together.advance(20)
    for _ in range(20):
        before = one_by_one.gradients
        one_by_one.advance(1)
        costs.append(one_by_one.gradients - before)
    assert together.costliest == one_by_one.costliest == (max(costs), 1 + costs.index(max(costs)))


def test_slow_step_that_no_rescue_took_is_an_alarm():
    """At q = 1.02 the plain fixed point contracts by some 0.9 a round: two hundred rounds."""
    simulation = tao(0.4, 1.02, -1.0, solver='fixed_point', max_iterations=1000)
    watch = watch_of_cost(simulation)
    simulation.advance(1)
    watch.update(look(simulation))
    assert simulation.rescued == 0
    assert [(alarm.kind, alarm.step, alarm.value) for alarm in watch.alarms] == [
        ('slow step', 1, simulation.gradients)]


def test_sub_steps_are_given_up_at_a_limit_that_the_failure_names():
    """A force that jumps where p is: p = 1 - h f(p) has no solution; residuals are small."""
    H = Plain(lambda q, p: 0.5 * p[0] ** 2,
              lambda q, p: (np.where(p >= 1.0, 1e-9, -1e-9), p), 1, separable=False)
    most = 3000
    simulation = Simulation(H, INTEGRATORS['generalized_leapfrog'](max_iterations=most), 0.1,
                            [0.0], [1.0])
    with pytest.raises(StepFailure, match='abandoned after 2560 gradients in sub-steps') as caught:
        simulation.advance(1)
    # The secant method once, Newton's, which takes some tens, and the sub-step that goes beyond.
    assert 2 * most < caught.value.evaluations < 2 * most + 100
    assert caught.value.evaluations == simulation.gradients
    assert 'use a smaller step_size or another integrator' in str(caught.value)


@pytest.mark.parametrize('make', [
    lambda: plain_run('tao', INTEGRATORS['variational_euler'](max_iterations=3), 0.05, [0.0],
                      [-3.0]),
    lambda: plain_run('tao', 'generalized_leapfrog', 0.5, [1.6], [0.0]),
    lambda: bounce('implicit', 40.0)], ids=['chain of solvers', 'sub-steps', 'two methods'])
def test_step_that_waits_for_its_rescue_leaves_no_trace(make):
    whole, waiting = make(), make()
    whole.advance(60)
    waiting.rescue_ready = False
    for _ in range(2):
        with pytest.raises(RescuePending):
            waiting.advance(60)
    # All steps before it are taken, and nothing tells that it was tried.
    before = make()
    before.advance(waiting.steps)
    assert waiting.steps < 60 and before.rescued == 0
    assert (waiting.gradients, waiting.costliest) == (before.gradients, before.costliest)
    now, expected = waiting.snapshot(), before.snapshot()
    assert all(np.array_equal(now[name], expected[name]) for name in expected)
    waiting.compile_rescue()
    assert waiting.rescue_ready
    waiting.advance(60 - waiting.steps)
    end, expected = waiting.snapshot(), whole.snapshot()
    assert all(np.array_equal(end[name], expected[name]) for name in expected)
    assert (waiting.rescued, waiting.gradients) == (whole.rescued, whole.gradients)


@pytest.mark.parametrize('name', mostly_long((
    'symplectic_euler', 'implicit_midpoint', 'gauss4', 'kahan_li8', 'lie_leapfrog', 'lie_gauss4'),
    'implicit_midpoint', 'lie_leapfrog'))
def test_step_that_nothing_can_take_leaves_no_trace(name):
    """No replay knows of it: a log holds the steps that were taken, and the commands."""
    system = Uncompiled(HAMILTONIANS[
        'quadrotor' if name.startswith('lie') else 'double_pendulum']())
    names = ['body_rx', 'body_ry'] if name.startswith('lie') else ['angle1', 'angle2']
    n = 6 if name.startswith('lie') else 2

    def make():
        simulation = plain_run(
            system, name, 0.01, [0.1] * n if n == 2 else [0.0] * 6 + [1.0], [0.2] * n,
            effect('external_force', names, timeout=1e3))
        simulation.advance(5)
        return simulation
    tried, spared = make(), make()
    for size in (1e10, 1e12):
        for simulation in (tried, spared):
            simulation.set_command([size, -size])
        with pytest.raises(StepFailure):
            # Some of them may be taken before one fails.
            tried.advance(1000)
        spared.advance(tried.steps - spared.steps)
        now, expected = tried.snapshot(), spared.snapshot()
        assert [key for key in expected if not np.array_equal(now[key], expected[key])] == []
    assert tried.gradients > spared.gradients


@pytest.mark.long
@pytest.mark.parametrize('make', [
    lambda: Simulation(HAMILTONIANS['tao'](), INTEGRATORS['generalized_leapfrog'](), 0.5, [1.6],
                       [0.0]),
    lambda: Simulation(
        HAMILTONIANS['tao'](), INTEGRATORS['generalized_leapfrog'](), 0.5, [1.6], [0.0],
        [effect('external_force', ['x']), effect('damping', 0.01)]),
    lambda: bounce('implicit', 40.0, compiled=True)], ids=['plain', 'effects', 'two methods'])
def test_step_that_fails_finds_all_that_takes_it_compiled(make, monkeypatch):
    simulation = make()
    simulation.compile()
    simulation.compile_rescue()

    def refuse(*arguments, **options):
        raise AssertionError('compiled in a step')
    monkeypatch.setattr(assembly, 'entry_point', refuse)
    monkeypatch.setattr(assembly, 'provide_for', refuse)
    simulation.advance(60)
    assert simulation.rescued > 0


# What a failure says.

def beyond(system: str, method: str, h: float, q: list, p: list, **options) -> Simulation:
    """Return a simulation whose steps fail, with nothing else to try."""
    return plain_run(system, INTEGRATORS[method](**options), h, q, p, on_failure='stop')


def plumb_line(h: float) -> Simulation:
    """Return a rod that turns so fast that an explicit step leads beyond its length."""
    return plain_run(free('x', 'z'), 'stormer_verlet', h, [1.0, 0.0], [0.0, -3.0], effect(
        'holonomic_constraint', ['x', 'z'], anchor=[0.0, 0.0], length=1.0), on_failure='stop')


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
@pytest.mark.parametrize('make, reason, advice', [
    (lambda: beyond('tao', 'variational_euler', 0.05, [1.0], [-1.0], solver='fixed_point',
                    max_iterations=3), 'no convergence', 'use a smaller step_size or another'),
    (lambda: beyond('tao', 'variational_euler', 3.0, [2.0], [2.0]), 'has no solution connected',
     'use a smaller step_size or another'),
    (lambda: beyond('kepler', 'stormer_verlet', 1e200, [1.0, 0.0], [0.0, 1.0]), 'not finite',
     'use a smaller step_size or another'),
    (lambda: beyond('kepler', 'stormer_verlet', 0.1, [0.0, 0.0], [0.0, 1.0]), 'not finite',
     'H has no finite gradient at the initial state; start elsewhere'),
    (lambda: plumb_line(1.0), 'no impulses satisfy the constraints', 'use a smaller step_size or'),
    (lambda: beyond('kepler', 'time_transformed', 0.5, [0.01, 0.0], [0.0, 14.0],
                    base='stormer_verlet', control='integrating', force=1e-3, exponent=2.0),
     'internal steps became', 'start elsewhere, or .* larger force'),
    (lambda: beyond('heavy_top', 'lie_leapfrog', 1.0, [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 60.0]),
     'would rotate by almost pi', 'use a smaller step_size or another')])
def test_failure_gives_a_residual_only_of_an_equation_that_was_not_solved(
        make, reason, advice, monkeypatch):
    """And advice that can help: of what no shorter step cures it speaks of none."""
    monkeypatch.setattr(time_transformed, '_MAX_STEPS', 100)
    with pytest.raises(StepFailure, match=f'{reason}.*; {advice}') as failed:
        make().advance(20)
    message, residual = str(failed.value), failed.value.relative_residual
    assert ('relative residual' in message) == (reason == 'no convergence')
    # As solvers accept it, of so few unknowns.
    assert np.isnan(residual) or residual > 8 * EPS
    assert ('smaller step_size' in message) == ('smaller step_size' in advice)
