# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene says to be conserved is found, watched and published, and nothing else is run."""

from pathlib import Path

from ensembles import ensemble
from helpers import alarm_of
from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.errors import AlarmWarning, SceneError
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.models import load_learned
from hnn_vi_ros.models.ensemble import EnsembleHamiltonian
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation.guards.bands import InvariantGuard
from hnn_vi_ros.simulation.guards.samples import GuardState
from messages import refused
import numpy as np
from pydantic import ValidationError
import pytest

SCENE = """\
hamiltonian: {kind: kepler}
integrator: {kind: variational_euler}
step_size: 0.01
initial_state: {q: [0.9, 0.0], p: [0.0, 1.1055415967851332]}
"""
CODE = """\
import math


def areal_velocity(q, p):
    return 0.5 * (q[0] * p[1] - q[1] * p[0])


def distance(q, p):
    q *= q  # which is nobody else's
    return q.sum() ** 0.5 + 1e6


def nonsense(q, p):
    raise RuntimeError('no such thing')


def infinite(q, p):
    return float('inf')


def zero(q, p):
    return 1.0 / float(q[0] - q[0])


def angle(q, p):
    return math.acos(float(q[0]) / 0.9)


def root(q, p):
    return (0.9 - float(q[0]) + 1e-300) ** 0.5


def partial(q, p):
    return 1.0 if q[0] > 0.5 else None
"""


def scene(tmp_path: Path, invariants: str = '', effects: str = '') -> Scene:
    (tmp_path / 'own_invariants.py').write_text(CODE)
    (tmp_path / 'scene.yaml').write_text(f'{SCENE}{effects}{invariants}')
    return load_scene(tmp_path / 'scene.yaml')


def listed(*items: str) -> str:
    return f'invariants: [{", ".join(f"{{{item}}}" for item in items)}]\n'


def test_known_invariants_count_where_nothing_acts_beside_h(tmp_path):
    field = 'effects: [{kind: gravity, coordinate: x}]\n'
    assert [*scene(tmp_path).create_hamiltonian().invariants] == ['angular_momentum']
    assert not scene(tmp_path, effects=field).create_hamiltonian().invariants
    # Unless they are asked for: the user knows of a symmetry that stays.
    assert [*scene(tmp_path, listed('name: angular_momentum'), field
                   ).create_hamiltonian().invariants] == ['angular_momentum']


def test_angular_momentum_of_kepler_is_conserved_along_the_exact_flow():
    """Its derivative along (H_p, -H_q) is zero, up to rounding."""
    kepler = HAMILTONIANS['kepler']()
    rng, (L,) = np.random.default_rng(0), kepler.known_invariants.values()
    for q, p in rng.normal(size=(20, 2, 2)):
        H_q, H_p = kepler.gradient(q, p)
        # L is bilinear.
        assert abs(L(H_p, p) - L(q, H_q)) <= 1e-14 * (1.0 + np.abs(H_q).max())


def test_invariants_of_the_user_are_functions_of_modules_beside_the_scene(tmp_path):
    own = scene(tmp_path, listed('name: A, function: "own_invariants:areal_velocity"'))
    invariants = own.create_hamiltonian().invariants
    assert [*invariants] == ['angular_momentum', 'A']
    q, p = np.array([1.0, 2.0]), np.array([3.0, 5.0])
    assert invariants['A'](q, p) == -0.5 == 0.5 * invariants['angular_momentum'](q, p)


@pytest.mark.parametrize('function', [
    '', 'own_invariants:missing', 'no_such_module:f', 'own_invariants:nonsense',
    'own_invariants:infinite', 'own_invariants:zero'])
def test_invariant_that_cannot_be_used_is_refused_with_its_place(tmp_path, function):
    item = f'name: A, function: "{function}"' if function else 'name: momentum'
    with refused(SceneError):
        scene(tmp_path, listed(item)).create_hamiltonian()


def test_invariant_that_stands_twice_is_refused(tmp_path):
    with refused(SceneError):
        scene(tmp_path, listed(*['name: angular_momentum'] * 2)).create_hamiltonian()


def test_invariant_of_data_that_nobody_trusts_runs_no_code(tmp_path):
    own = scene(tmp_path, listed('name: A, function: "own_invariants:areal_velocity"'))
    # As the scene of a bag or a topic is read.
    with pytest.raises(ValidationError, match='is code, which is run only for scene files'):
        Scene.model_validate(own.model_dump())


def test_invariant_that_is_none_raises_an_alarm_and_the_true_one_does_not(tmp_path):
    """The distance varies from 0.9 to 1.1 m, whatever constant is added to it."""
    own = scene(tmp_path, listed('name: r, function: "own_invariants:distance"'))
    with pytest.warns(AlarmWarning, match='r is not conserved'):
        (alarm,) = simulate(own, 6.28).alarms
    assert (alarm.kind, alarm.unit) == ('r not conserved', '1')
    # 5 % of abs(dr/dq) times abs(q), which is r or twice r off the axes.
    assert 0.04 < alarm.limit < 0.12


@pytest.mark.parametrize('make', [
    lambda: EnsembleHamiltonian(ensemble(2)), lambda: load_learned(
        shipped_file('model', 'pendulum'), confine=True), HAMILTONIANS['kepler']],
    ids=['mean', 'confined', 'exact'])
def test_copy_knows_the_invariants_of_its_original(make):
    original = make()
    original.invariants = {'A': lambda q, p: 1.0}
    assert original.copy().invariants == original.invariants


@pytest.mark.parametrize('constant', [0.0, 1e3])
def test_invariant_guard_does_not_depend_on_constants_nor_on_zeros(constant):
    """A radial path has no angular momentum; rounding of 1e-13 is no alarm, 0.2 is."""
    guard = InvariantGuard('L', lambda q, p: q[0] * p[1] - q[1] * p[0] + constant, 0.05,
                           HAMILTONIANS['kepler']())

    def at(step: int, p_y: float) -> GuardState:
        nothing = np.empty(0)
        return GuardState(step, np.array([1.0, 0.0]), np.array([0.5, p_y]), nothing, nothing,
                          0.0, 0.0)

    assert [alarm_of(guard, at(k, 1e-13 * (k % 3))) for k in range(10)] == [None] * 10
    assert alarm_of(guard, at(11, 0.2)).value == pytest.approx(0.2)


def test_invariant_that_is_no_number_is_an_alarm():
    guard = InvariantGuard('L', lambda q, p: q[0], 0.05, HAMILTONIANS['kepler']())
    states = np.array([[1.0, 0.0], [np.nan, 0.0]])
    looks = [GuardState(k, q, q, q, q, 0.0, 0.0) for k, q in enumerate(states)]
    assert alarm_of(guard, looks[0]) is None
    assert alarm_of(guard, looks[1]) is not None


@pytest.mark.parametrize('name', ['angle', 'root'])
def test_invariant_whose_arithmetic_fails_on_the_way_is_an_alarm(tmp_path, name):
    """Differences leave their domain beside the start: acos(1 + 1e-4), the root of -1e-4."""
    own = scene(tmp_path, listed(f'name: A, function: "own_invariants:{name}"'))
    with pytest.warns(AlarmWarning, match='A is not conserved: it varies by'):
        simulate(own, 1.0)


def test_invariant_that_fails_on_the_way_is_named_with_the_state(tmp_path):
    own = scene(tmp_path, listed('name: A, function: "own_invariants:partial"'))
    with pytest.raises(SceneError, match=r'scene.yaml:5: invariants.*own_invariants:partial: '
                                         r'TypeError: .*, at q = \[') as problem:
        simulate(own, 3.0)
    assert '\n' not in str(problem.value)
