# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles of mechanisms: what their mean is, and what of it is exact."""

from dataclasses import replace
from pathlib import Path

from ensembles import mechanisms, scaled, together
from hnn_vi_ros import simulate_spread
from hnn_vi_ros.effects import EFFECTS, EffectState
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.models import (
    Checkpoint, load_checkpoint, load_learned, load_member, save_checkpoint)
from hnn_vi_ros.run import AccompaniedSimulation, Members
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build
from mechanical_models import (
    assert_agrees_with_torch, PRIOR, random_mechanical, ROUND_OFF)
from messages import refused
import numpy as np
import pytest

SCALES = 0.5, 1.0, 2.0
MAP = [[0.8], [-0.6]]


def saved(folder: Path, model: Checkpoint) -> str:
    path = folder / 'several.safetensors'
    save_checkpoint(path, model)
    return str(path)


def scene_of(folder: Path, model: Checkpoint, friction: bool = True) -> Scene:
    file = saved(folder, model)
    effects = [{'kind': 'learned_friction', 'model': file}] if friction else []
    if model.card.mechanical.input_map is not None:
        effects.append({'kind': 'external_force', 'model': file, 'timeout': 10.0})
    return Scene.build(
        hamiltonian={'kind': 'learned', 'model': file}, effects=effects, integrator='gauss4',
        step_size=0.02, initial_state=([0.5, -0.8], [1.0, -0.6]), name='several')


@pytest.mark.parametrize('shape', ['arm', 'cart and pole', 'joint', 'double pendulum', 'three'])
def test_mean_has_the_mean_mass_and_potential_by_torch_autograd(shape: str):
    model = mechanisms(shape, 3)
    hamiltonian = load_member(model, None)
    z, v = np.random.default_rng(3).uniform(-1.5, 1.5, (2, 4, 2 * hamiltonian.dimension))
    assert_agrees_with_torch(hamiltonian, model, z, v)


@pytest.mark.parametrize('alone', [(True, False, False), (False, True, True), (True, True, True)])
def test_priors_that_stand_alone_add_no_networks_to_a_mean(alone: tuple[bool, ...]):
    model = mechanisms('double pendulum', 3)
    members = [replace(member, card=member.card.model_copy(update={
        'mechanical': member.card.mechanical.model_copy(update={
            'prior': PRIOR.model_copy(update={'alone': own})})}))
        for member, own in zip(model.members, alone, strict=True)]
    mean = together(members)
    z, v = np.random.default_rng(4).uniform(-1.5, 1.5, (2, 4, 4))
    assert_agrees_with_torch(load_member(mean, None), mean, z, v)
    # At rest H is V, whose mean is that of the members' energies.
    q, zero = z[:, :2], np.zeros((4, 2))
    np.testing.assert_allclose(
        load_member(mean, None).energy(q, zero),
        np.mean([load_member(member, None).energy(q, zero) for member in members], axis=0),
        rtol=0.0, atol=ROUND_OFF)


@pytest.mark.parametrize('shape', ['arm', 'worn'])
def test_force_that_the_mean_needs_is_the_mean_of_what_members_need(tmp_path: Path, shape: str):
    model = mechanisms(shape, 3)
    file = saved(tmp_path, model)
    needed = []
    q, v, a = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 2))
    for member in (None, 1, 2, 3):
        hamiltonian = load_learned(Path(file), member=member)
        M = np.linalg.inv(hamiltonian.inverse_mass(q, np.zeros_like(q)))
        p = M @ v
        force, zero = np.zeros((2, 2))
        effect = EFFECTS['learned_friction'](file, member)
        effect.add_force(effect.resolve(hamiltonian.coordinates, None), 0.0, q, p, v, zero, force)
        assert force @ v < 0.0
        # dp/dt = M a + (M v)_q v, by the change of H_p along the motion: a = H_pq v + H_pp p'.
        at_zero = hamiltonian.hessian_vector(q, p, v, np.zeros(2))[1]
        needed.append(M @ (a - at_zero) + hamiltonian.gradient(q, p)[0] - force)
    assert np.abs(needed[0] - np.mean(needed[1:], axis=0)).max() < 10 * ROUND_OFF


def test_input_map_of_the_mean_is_the_mean(tmp_path: Path):
    model = mechanisms('arm', 3, input_map=MAP)
    file, forces = saved(tmp_path, model), []
    for member in (None, 1, 2, 3):
        effect = EFFECTS['external_force'](model=file, member=member)
        state = EffectState.empty(1, 2)
        parameters = effect.resolve(load_learned(Path(file)).coordinates, state)
        effect.prepare([0.7], parameters, np.zeros(2))()
        force, zero = np.zeros((2, 2))
        effect.add_force(parameters, 0.0, zero, zero, zero, np.zeros(2), force)
        forces.append(force)
    assert len({tuple(force) for force in forces}) == 4
    np.testing.assert_allclose(forces[0], np.mean(forces[1:], axis=0), rtol=1e-15)


def test_members_that_differ_by_a_factor_move_alike_from_their_own_momenta(tmp_path: Path):
    base = random_mechanical('worn', input_map=MAP)
    scene = scene_of(tmp_path, together([scaled(base, s) for s in SCALES]))
    members = Members(scene.parts())
    simulation = AccompaniedSimulation(build(scene), [members])
    simulation.set_command([0.4])
    simulation.advance(50)
    # Members have the mean's motion: M_k = s_k M, so p_k = s_k / mean(s) times its momentum. What
    # rounding and the solver leave in 50 steps is far below the spread without those momenta.
    for s, own in zip(SCALES, members._simulations, strict=True):
        np.testing.assert_allclose(own.q, simulation.q, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(own.p, s / np.mean(SCALES) * simulation.p, rtol=0.0,
                                   atol=1e-10)
    assert members.spread.max() < 1e-9 and np.abs(simulation.q - [0.5, -0.8]).max() > 0.1


def test_members_start_at_the_velocity_of_the_mean_in_a_magnetic_field(tmp_path: Path):
    whole = scene_of(tmp_path, mechanisms('arm', 2), friction=False).changed({'effects': [
        {'kind': 'magnetic_field', 'plane': ['x0', 'x1'], 'field': 0.7}]})
    simulation, members = build(whole), Members(whole.parts())
    members.begin(simulation)
    v = simulation.hamiltonian.gradient(simulation.q, simulation.p)[1]
    for own in members._simulations:
        found = own.hamiltonian.gradient(own.q, own.p)[1]
        # Newton's method ends at 1e-12 of the velocity.
        np.testing.assert_allclose(found, v, rtol=0.0, atol=1e-11)
        assert np.abs(own.p - simulation.p).max() > 1e-3


def test_spread_in_python_is_that_beside_a_run(tmp_path: Path):
    scene = scene_of(tmp_path, mechanisms('arm', 3))
    found = simulate_spread(scene, 1.0, every=50)
    members = Members(scene.parts())
    simulation = AccompaniedSimulation(build(scene), [members])
    assert members.spread.max() < 1e-11  # p through q' and back
    simulation.advance(50)
    expected = np.concatenate([found.spread_q[-1], found.spread_p[-1]])
    np.testing.assert_allclose(members.spread, expected, rtol=1e-9)
    # Momenta of the mean for each member's q and q', times the factor of the card.
    mean = load_member(load_checkpoint(scene.hamiltonian.model, ensembles=True), None)
    momenta = []
    for k, one in enumerate(found.members, start=1):
        own = load_learned(Path(scene.hamiltonian.model), member=k)
        v = own.gradient(one.q[-1], one.p[-1])[1]
        momenta.append(np.linalg.solve(mean.inverse_mass(one.q[-1], np.zeros_like(v)), v))
    np.testing.assert_allclose(found.spread_p[-1], 2.0 * np.std(momenta, axis=0, ddof=1),
                               rtol=1e-9)
    # The mean of equal numbers is rounded.
    assert found.spread_q[0].max() < 1e-15 and (found.spread_q[-1] > 1e-4).all()


def test_parts_in_place_of_those_of_the_scene_are_the_members_as_well(tmp_path: Path):
    scene = scene_of(tmp_path, mechanisms('arm', 3))
    parts = {'initial_state': ([0.2, 0.1], [0.4, -0.3]), 'step_size': 0.01,
             'effects': [scene.effects[0].model_dump()]}
    found = simulate_spread(scene, 0.1, every=10, **parts)
    (q, p) = parts['initial_state']
    changed = scene.changed({**parts, 'initial_state': {'q': q, 'p': p}})
    expected = simulate_spread(changed, 0.1, every=10)
    assert found.mean.q[0].tolist() == q and found.mean.p[0].tolist() == p
    assert found.spread_p.tobytes() == expected.spread_p.tobytes()
    # At the velocity of the mean, to the round-off of Newton's method.
    assert found.spread_p[0].max() < 1e-11


def test_scene_of_an_ensemble_of_mechanisms_keeps_its_balance(tmp_path: Path):
    simulation = build(scene_of(tmp_path, mechanisms('arm', 3, input_map=MAP)))
    simulation.set_command([0.5])
    initial = simulation.energy
    simulation.advance(100)
    friction, command = simulation.works.values()
    # Of order 4 in h = 0.02, with derivatives of the order of ten.
    assert abs(simulation.energy - initial - friction - command) < 1e-4
    assert friction < -0.05 and abs(command) > 0.01


def test_member_that_is_not_there_is_refused(tmp_path: Path):
    file = saved(tmp_path, mechanisms('arm', 2, input_map=MAP))
    for make in (EFFECTS['learned_friction'], lambda model, member: EFFECTS['external_force'](
            model=model, member=member)):
        with refused(ModelError):
            make(file, 3)
    with refused(ValueError):
        EFFECTS['external_force'](['x0'], member=1)


def test_member_in_a_scene_is_the_scene_of_that_model_alone(tmp_path: Path):
    model = mechanisms('arm', 2)
    scene = scene_of(tmp_path, model)
    one, other = build(scene_of(tmp_path / 'alone', model.members[1])), build(scene.changed({
        'hamiltonian': {**scene.hamiltonian.model_dump(), 'member': 2},
        'effects': [{**scene.effects[0].model_dump(), 'member': 2}]}))
    one.advance(10)
    other.advance(10)
    assert one.q.tobytes() == other.q.tobytes() and one.p.tobytes() == other.p.tobytes()
