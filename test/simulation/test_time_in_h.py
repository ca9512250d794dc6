# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""H(q, p, t): paths and the work of the drive against DOP853, gradients, events, refusals."""

import math
from types import SimpleNamespace

from hnn_vi_ros import torch as hnn_torch
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.run.monitor import EnergyRecord
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build, RunFacts, simulate, simulate_many, Trajectory, Watch
from hnn_vi_ros.simulation.accuracy.trials import InitialValueProblem, survey
from hnn_vi_ros.simulation.guards.steps import StiffnessGuard
from hnn_vi_ros.simulation.guards.watch import energies_of, look_at_rows
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch

DURATION = 2.0


def mathieu(t, y):
    x, p, _ = y
    return p, -(1.0 - 0.2 * math.cos(2.0 * t)) * x, 0.2 * math.sin(2.0 * t) * x**2


def driven_duffing(t, y):
    x, p, *_ = y
    drive, heat = 0.37 * 1.2 * math.sin(1.2 * t) * x, -0.3 * p**2
    return p, x - x**3 + 0.37 * math.cos(1.2 * t) - 0.3 * p, drive, heat


def pulsating_primary(t, y):
    x, y, p_x, p_y, _ = y
    r, mu = math.hypot(x, y), 1.0 + 0.1 * math.cos(0.8 * t)
    return (p_x + 0.5 * y, p_y - 0.5 * x, 0.5 * p_y - mu * x / r**3, -0.5 * p_x - mu * y / r**3,
            0.08 * math.sin(0.8 * t) / r)


def pulsating_mass(t, y):
    x, p, _ = y
    m = 1.0 + 0.3 * math.sin(t)
    return p / m, -x**3, -0.15 * math.cos(t) * (p / m)**2


MASS = Scene.build(
    hamiltonian={'kind': 'formula', 'coordinates': ['x'],
                 'H': 'p_x^2/2/(1 + c*sin(t)) + x^4/4', 'parameters': {'c': 0.3}},
    integrator='implicit_midpoint', step_size=0.02, name='mass',
    initial_state={'q': [0.7], 'p': [0.1]})
SYSTEMS = {rates.__name__: rates for rates in (
    mathieu, driven_duffing, pulsating_primary, pulsating_mass)}
EXPLICIT = {'mathieu', 'driven_duffing'}


def scene_of(name: str, method: str, h: float) -> Scene:
    scene = MASS if name == 'pulsating_mass' else load_scene(name)
    return scene.with_overrides(h, method)


def reference(name: str, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return (q, p, work of the drive, others) at the end."""
    works = 1 + (name == 'driven_duffing')
    return solve_ivp(SYSTEMS[name], (0.0, DURATION), [*q, *p, *np.zeros(works)], 'DOP853',
                     rtol=1e-13, atol=1e-14).y[:, -1]


def end(run: Trajectory) -> np.ndarray:
    """Return (q, p, work of the drive, error) at the end."""
    names = run.energy_by_cause.names
    drive, error = (run.energy_by_cause.values[-1, names.index(name)]
                    for name in ('work/drive', 'error'))
    return np.array([*run.q[-1], *run.p[-1], drive, error])


@pytest.mark.parametrize('name, method', [
    (name, method) for name in SYSTEMS for method in (
        'variational_euler', 'stormer_verlet', 'generalized_leapfrog', 'gauss4', 'dop853')
    if method != 'stormer_verlet' or name in EXPLICIT])
def test_methods_keep_their_order_in_path_and_work_if_h_depends_on_the_time(name, method):
    found = []
    for h in (0.04, 0.02):
        run = simulate(scene_of(name, method, h), DURATION, energy_by_cause=True)
        exact = reference(name, run.q[0], run.p[0])
        found.append(np.abs(end(run) - [*exact[:2 * run.q.shape[1] + 1], 0.0]))
        # H - H0 is the sum of all works and the error, by which the guards judge.
        works = run.energy_by_cause.of('work/')
        assert run.energy[-1] - run.energy[0] == pytest.approx(
            sum(own[-1] for own in works.values()) + end(run)[-1], abs=1e-14)
    coarse, fine = found
    if method == 'dop853':
        # Its tolerance, 1e-10, does not depend on the step size.
        assert fine.max() < 1e-8
        return
    # Errors of half the step divide by 2^order, up to the next term, of the relative size h.
    order = INTEGRATORS[method].order
    assert (fine <= coarse / 2.0**(order - 0.5) + 1e-10).all()
    assert fine.max() > 1e-12, 'the errors are above round-off'


def test_many_trajectories_and_samples_between_steps_see_the_time():
    scene = load_scene('mathieu').with_overrides(0.02, 'gauss4')
    one = simulate(scene, DURATION)
    many = simulate_many(scene, one.q[:1], one.p[:1], DURATION, samples=100)
    assert np.array_equal(many.q[:, 0], one.q) and np.array_equal(many.energy[:, 0], one.energy)
    times = [0.0, 0.513, 1.9]
    between = simulate(scene, DURATION, times=times)
    q, p = between.q[:, 0], between.p[:, 0]
    assert between.energy == pytest.approx(
        p**2 / 2.0 + (1.0 - 0.2 * np.cos(2.0 * np.array(times))) * q**2 / 2.0, rel=1e-14)


def test_events_of_energies_and_velocities_are_at_their_times():
    scene = MASS.changed({'events': [{'when': 'v_x = -0.05'}, {'when': 'H = 0.064'}]})
    for event in simulate(scene, DURATION).events:
        (x,), (p,), t = event.q, event.p, event.t
        mass = 1.0 + 0.3 * math.sin(t)
        assert event.energy == pytest.approx(p**2 / 2.0 / mass + x**4 / 4.0, rel=1e-14)
        # The root is found to round-off of the step.
        assert (p / mass if 'v_x' in event.when else event.energy) == pytest.approx(
            float(event.when.split('=')[1]), abs=1e-12)
    assert {event.when for event in simulate(scene, DURATION).events} == {
        'v_x = -0.05', 'H = 0.064'}


@pytest.mark.parametrize('method, effects', [
    ('gauss4', []), ('implicit_midpoint', [{'kind': 'damping', 'rate': 0.1}])])
def test_gradients_are_those_of_the_steps_if_h_depends_on_the_time(method, effects):
    scene = MASS.changed({'effects': effects}).with_overrides(0.02, method)

    def last(q, p, c):
        own = scene.changed({'hamiltonian': {**scene.hamiltonian.model_dump(),
                                             'parameters': {'c': c}}})
        return float(simulate(own, DURATION, initial_state=([q], [p])).q[-1, 0])

    at = [torch.tensor([0.7], dtype=torch.float64), torch.tensor([0.1], dtype=torch.float64),
          torch.tensor(0.3, dtype=torch.float64)]
    for tensor in at:
        tensor.requires_grad_(True)
    run = hnn_torch.simulate(scene, *at[:2], duration=DURATION,
                             parameters={'hamiltonian.parameters.c': at[2]})
    found = torch.autograd.grad(run.q[-1].sum(), at)
    values, h = np.array([0.7, 0.1, 0.3]), 1e-5
    for k, unit in enumerate(np.eye(3)):
        # The error of the difference is h^2 of a third derivative of order 1.
        assert float(found[k]) == pytest.approx(
            (last(*(values + h * unit)) - last(*(values - h * unit))) / (2.0 * h), abs=1e-8)


def test_auto_chooses_among_methods_that_support_the_time():
    scene = load_scene('mathieu').changed({'integrator': {
        'kind': 'auto', 'path_error': 1e-6, 'horizon': DURATION}, 'step_size': None})
    run = simulate(scene, DURATION)
    exact = reference('mathieu', run.q[0], run.p[0])
    assert np.abs([*run.q[-1], *run.p[-1]] - exact[:2]).max() < 1e-6


STIFFENING = Scene.build(
    hamiltonian={'kind': 'formula', 'coordinates': ['x'], 'H': 'p_x^2/2 + (1 + 99*t/T)*x^2/2',
                 'parameters': {'T': 40.0}}, name='stiffening', integrator='implicit_midpoint',
    step_size=0.04, initial_state={'q': [1.0], 'p': [0.0]})


@pytest.mark.filterwarnings('ignore::UserWarning')
def test_stiffness_that_grows_in_a_run_is_seen_at_its_time():
    """The frequency grows tenfold, and the steps are too long for it at the end."""
    (alarm,) = simulate(STIFFENING, 40.0).alarms
    assert alarm.kind == 'path not resolved' and alarm.step > 100
    assert not simulate(STIFFENING.with_overrides(0.01, 'gauss4'), 40.0).alarms
    problem = InitialValueProblem(STIFFENING.create_hamiltonian(), (), *np.array([[1.0], [0.0]]))
    # H / omega is kept where k grows slowly, not at the start, so that k x grows as k^(3/4); with
    # k at t = 0 it is below 1.
    assert survey(problem, 40.0, 4.0).strongest == pytest.approx(100.0**0.75, rel=0.2)


def test_auto_resolves_a_stiffness_that_grows_in_the_run():
    scene = STIFFENING.changed({'integrator': {
        'kind': 'auto', 'path_error': 1e-4, 'horizon': 40.0}, 'step_size': None})
    run = simulate(scene, 40.0)
    exact = solve_ivp(lambda t, y: (y[1], -(1.0 + 99.0 * t / 40.0) * y[0]), (0.0, 40.0),
                      [1.0, 0.0], 'DOP853', rtol=1e-12, atol=1e-13).y[:, -1]
    assert np.abs([*run.q[-1], *run.p[-1]] - exact).max() < 1e-4


def test_masses_are_those_of_the_time():
    x, p = np.full((2, 3, 1), 0.7)
    t = np.array([0.0, 0.5, 1.5])
    assert MASS.create_hamiltonian().inverse_mass(x, p, t).ravel() == pytest.approx(
        1.0 / (1.0 + 0.3 * np.sin(t)), rel=1e-14)


@pytest.mark.parametrize('method', ['taylor', 'time_transformed', 'discrete_gradient'])
def test_methods_that_do_not_support_the_time_say_so(method):
    with refused(UnsupportedSystem):
        simulate(load_scene('pulsating_primary').with_overrides(0.02, method), 1.0)


def test_guards_of_many_trajectories_evaluate_h_at_their_times():
    scene = MASS.with_overrides(0.02, 'gauss4')
    simulation, t = build(scene), np.array([0.0, 0.5, 1.5])
    watch, seen = Watch(RunFacts(simulation)), []
    watch.update = seen.append
    q, p = np.full((3, 1), 0.7), np.full((3, 1), 0.1)
    watch.show(t / 0.02, (q, p), energies_of(simulation, q, p, t))
    rows = simulation.rows(np.array([[0.7, 0.1]]), step=75)
    seen.append(look_at_rows(simulation, rows, q[:1], p[:1]))
    velocities = [float(np.ravel(look.dH_dp)[0]) for look in seen]
    assert velocities == pytest.approx(0.1 / (1.0 + 0.3 * np.sin([*t, 1.5])), rel=1e-14)


def test_restored_runs_are_judged_at_their_time():
    simulation = build(STIFFENING)
    simulation.restart([1.0], [0.0], step=1000)
    record = EnergyRecord(simulation, 0.01)
    for _ in range(200):
        record.add(SimpleNamespace(energy_error=0.0, modified_energy=math.nan))
    record.evaluate()
    # 20 / 100 s in place of 20 s.
    assert record.drift_per_hour == 0.0
    bristles = build(MASS.changed({'effects': [
        {'kind': 'lugre_friction', 'coordinate': 'x', 'stiffness': 1e4, 'friction': 1.0}]}))
    reaches = []
    for step in (0, 75):
        bristles.restart([0.7], [0.1], step=step)
        (guard,) = StiffnessGuard.of_run(RunFacts(bristles))
        reaches.append(guard.value(None))
    mass = 1.0 + 0.3 * math.sin(1.5)
    assert reaches == pytest.approx([2.0, 2.0 / math.sqrt(mass)], rel=1e-14)


def test_initial_state_beside_numbers_without_names_is_refused():
    with refused(TypeError):
        simulate(lambda q, p, t: p**2 / 2 + (2 + np.sin(t)) * q**2, 3.0, step_size=0.01,
                 initial_state=(0.7, 0.1))


def test_step_size_is_not_differentiable_with_a_time_in_h():
    h = torch.tensor(0.02, dtype=torch.float64, requires_grad=True)
    q, p = torch.tensor([[0.7]]).double(), torch.tensor([[0.1]]).double()
    with refused(UnsupportedSystem):
        hnn_torch.simulate(MASS, q, p, duration=1.0, step_size=h).q.sum().backward()
