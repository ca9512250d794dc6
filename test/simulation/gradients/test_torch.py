# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations that torch differentiates: their states, and their derivatives."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
import re
import tracemalloc

from helpers import difference
import hnn_vi_ros
from hnn_vi_ros.errors import SceneError, StateError, UnsupportedSystem
from hnn_vi_ros.integrators import gauss_tableau
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import BLOCK, StateSequence
from hnn_vi_ros.simulation.gradients.scene_run import model_of, numbers_of_model
from hnn_vi_ros.torch import DifferentiableSimulation, OnWeights, simulate, SimulatedMotion
from mechanical_models import random_mechanical, saved, SHAPES
from messages import refused
import numpy as np
import pytest
from sources import blocks, ROOT
import torch
from torch.autograd import forward_ad, functional
from urdf_robots import SMALL_ARGUMENTS, TREE, TREE_ARGUMENTS

Loss = Callable[[torch.Tensor], torch.Tensor]
# Of the pendulum: q, p, mass, length, gravity and h; the step is complex, the numbers are not.
NAMES = ('q', 'p', 'hamiltonian.mass', 'hamiltonian.length', 'hamiltonian.gravity', 'step_size')
VALUES = (1.3, 0.7, 1.1, 0.9, 9.81, 0.1)
METHODS = ('variational_euler', 'generalized_leapfrog', 'implicit_midpoint', 'gauss8')


@pytest.fixture(scope='module')
def pendulum() -> Scene:
    return load_scene('exact_pendulum')


def number(value: float) -> torch.Tensor:
    """Return a number that is followed."""
    return torch.tensor(value, dtype=torch.float64, requires_grad=True)


def directional(loss: Callable[[list[torch.Tensor]], torch.Tensor], start: list[np.ndarray],
                direction: list[np.ndarray], spacing: float) -> tuple[float, float, float]:
    """Return the derivative of a loss in a direction by differences, backwards and forwards."""
    expected = difference(lambda distance: float(loss([
        torch.from_numpy(np.asarray(value + distance * part))
        for value, part in zip(start, direction, strict=True)])), spacing)
    tensors = [torch.tensor(value, requires_grad=True) for value in start]
    loss(tensors).backward()
    backward = sum(float((tensor.grad.numpy() * part).sum())
                   for tensor, part in zip(tensors, direction, strict=True))
    with forward_ad.dual_level():
        forward = float(forward_ad.unpack_dual(loss([
            forward_ad.make_dual(torch.tensor(value), torch.tensor(part))
            for value, part in zip(start, direction, strict=True)])).tangent)
    return expected, backward, forward


def complex_derivatives(method: str, steps: int) -> np.ndarray:
    """Return d(q, p)/d(VALUES), shape (2, 6), by complex steps through textbook formulas."""
    tiny = 1e-100
    # A column for each step.
    q, p, mass, length, gravity, h = np.array(VALUES)[:, None] + 1j * tiny * np.eye(len(VALUES))
    inertia, torque = mass * length * length, mass * gravity * length
    stages = {'implicit_midpoint': 1, 'gauss8': 4}.get(method, 1)
    matrix, weights, _ = gauss_tableau(stages)
    for _ in range(steps):
        if method == 'variational_euler':
            q = q + h * p / inertia
            p = p - h * torque * np.sin(q)
        elif method == 'generalized_leapfrog':
            half = p - 0.5 * h * torque * np.sin(q)
            q = q + h * half / inertia
            p = half - 0.5 * h * torque * np.sin(q)
        else:
            Q = np.tile(q, (stages, 1))
            # Each time the error shrinks to (h omega)^2 / 4 = 0.03 of what it was, or less.
            for _ in range(14):
                P = p - h * (matrix @ (torque * np.sin(Q)))
                Q = q + h * (matrix @ (P / inertia))
            q, p = q + h * (weights @ (P / inertia)), p - h * (weights @ (torque * np.sin(Q)))
    return np.array([q.imag, p.imag]) / tiny


def run(scene: Scene, method: str, tensors: list[torch.Tensor], steps: int) -> SimulatedMotion:
    """Simulate with the numbers VALUES, of which some may be followed."""
    q, p, *numbers, h = tensors
    return simulate(scene.with_overrides(integrator=method), q[None], p[None],
                    duration=steps * float(h.detach()), step_size=h, every=steps,
                    parameters=dict(zip(NAMES[2:5], numbers, strict=True)))


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('steps', [10, 1000], ids=['T = 1', 'T = 100'])
def test_derivatives_are_those_of_complex_steps(pendulum, method, steps, measured):
    expected = complex_derivatives(method, steps)
    tensors = [number(value) for value in VALUES]
    last = torch.cat(run(pendulum, method, tensors, steps)[1:], dim=1)[-1]
    backward = np.array([[float(part) for part in torch.autograd.grad(
        row, tensors, retain_graph=True)] for row in last])
    columns = []
    with forward_ad.dual_level():
        for i in range(len(VALUES)):
            duals = [forward_ad.make_dual(
                tensor.detach(), torch.tensor(float(k == i), dtype=torch.float64))
                for k, tensor in enumerate(tensors)]
            motion = run(pendulum, method, duals, steps)
            columns.append([float(forward_ad.unpack_dual(part[-1, 0]).tangent)
                            for part in motion[1:]])
    size = abs(expected).max(axis=0)
    error = max(float((abs(found - expected) / size).max())
                for found in (backward, np.array(columns).T))
    measured('error of the derivatives by state, numbers and h, relative',
             f'{method}, {steps} steps', error, '<= 1e-10')
    # Rounding of each step, which grows with the square of the time, and that of the differences
    # by numbers, 1e-13 each.
    assert error <= 1e-10


@pytest.mark.parametrize('method', METHODS)
def test_states_are_those_of_the_simulation_bit_by_bit(pendulum, method):
    scene = pendulum.with_overrides(integrator=method, step_size=0.05)
    expected = hnn_vi_ros.simulate(scene, 5.0, every=4, initial_state=([1.3], [0.7]))
    q0, p0 = torch.tensor([1.3], dtype=torch.float64), torch.tensor([0.7], dtype=torch.float64)
    motion = simulate(scene, q0.requires_grad_(), p0, duration=5.0, every=4)
    (motion.q[-1] + motion.p[7]).sum().backward()
    assert (motion.q.detach().numpy() == expected.q).all()
    assert (motion.p.detach().numpy() == expected.p).all()
    assert motion.t.detach().numpy() == pytest.approx(expected.t, rel=1e-15)


def test_gradients_of_many_trajectories_are_those_of_each_alone(pendulum):
    m = BLOCK + 2
    q0, p0 = torch.from_numpy(np.random.default_rng(0).uniform(-2.0, 2.0, (2, m, 1)))

    def gradient(q: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        q, p = q.clone().requires_grad_(), p.clone().requires_grad_()
        motion = simulate(pendulum, q, p, duration=2.0, every=50)
        # Every sample counts, the first as well.
        (motion.q.square() + motion.p.sin()).sum().backward()
        return torch.cat([q.grad, p.grad], dim=-1)

    together = gradient(q0, p0)
    for i in (0, BLOCK - 1, BLOCK, m - 1):
        alone = gradient(q0[i], p0[i])
        assert (together[i] - alone).abs().max() <= 1e-11 * alone.abs().max()


def unconfined(scene: Scene) -> Scene:
    """Return a scene whose model is not confined to the box of its data."""
    return scene.changed({'hamiltonian': {**scene.hamiltonian.model_dump(), 'confine': False}})


def learned_run(scene: Scene | str, q0: torch.Tensor, weights: dict[str, torch.Tensor]
                ) -> torch.Tensor:
    """Return q after 1 s of a learned system."""
    free = (load_scene(scene) if isinstance(scene, str) else scene).with_overrides(step_size=0.05)
    return simulate(unconfined(free), q0, torch.full_like(q0, 0.3), duration=1.0, every=20,
                    parameters=weights).q[-1]


def test_gradient_of_a_learned_hamiltonian_is_that_of_differences():
    # Of the differences some 1e-16 is cut off, and 1e-13 rounded.
    expected, backward, _ = directional(lambda start: learned_run('pendulum', start[0], {})[0],
                                        [np.array([1.5])], [np.ones(1)], 1e-3)
    assert backward == pytest.approx(expected, rel=1e-9)


def check_weights(scene: Scene, prefixes: dict[str, str], q0: list[float]) -> None:
    """Compare derivatives by all weights with differences, forward ones with backward ones."""
    checkpoint, rng = scene.create_hamiltonian().checkpoint, np.random.default_rng(0)
    weights = {f'hamiltonian.{prefix}linear{k + 1}.{part}': array
               for prefix, network in prefixes.items()
               for part, arrays in zip(('weight', 'bias'), checkpoint.networks[network],
                                       strict=True)
               for k, array in enumerate(arrays)}
    expected, backward, forward = directional(
        lambda tensors: learned_run(scene, torch.tensor(q0, dtype=torch.float64), dict(
            zip(weights, tensors, strict=True)))[0], [*weights.values()],
        [rng.normal(size=array.shape) * abs(array).mean() for array in weights.values()], 1e-4)
    # Second derivatives of forces are central differences, of a spacing of 6e-6.
    assert backward == pytest.approx(expected, rel=1e-6 if scene.effects else 1e-8)
    assert forward == pytest.approx(backward, rel=1e-10)


@pytest.mark.parametrize('scene, prefixes, drag', [
    ('pendulum', {'': 'energy'}, []), ('pendulum', {'': 'energy'}, [0.3]),
    ('separable_pendulum', {'potential.': 'potential', 'kinetic.': 'kinetic'}, [])])
def test_gradient_by_weights_is_that_of_differences_and_of_tangents(scene, prefixes, drag):
    # Drag feels the velocity, which depends on the weights, too.
    check_weights(load_scene(scene).changed({'effects': [
        {'kind': 'quadratic_drag', 'coordinates': ['angle'], 'coefficient': coefficient}
        for coefficient in drag]}), prefixes, [1.5])


@pytest.mark.parametrize('shape, rubs', [
    ('double pendulum', False), ('three', False), ('worn', True)])
def test_gradient_by_weights_of_a_mechanism_is_that_of_differences(tmp_path, shape, rubs):
    model, d = saved(tmp_path, shape), len(SHAPES[shape]['kinds'])
    scene = Scene.build(
        hamiltonian={'kind': 'learned', 'model': model}, integrator='implicit_midpoint',
        step_size=0.05, initial_state=(d * [0.4], d * [0.3]),
        effects=[{'kind': 'learned_friction', 'model': model}] * rubs)
    check_weights(scene, {f'{network}.': network for network in (
        'mass', 'potential', *['friction'] * rubs)}, d * [0.4])


@pytest.mark.parametrize('shape', ['double pendulum', 'worn'])
def test_changes_and_gradients_by_weights_are_transposed_each_time(shape):
    model, rng = random_mechanical(shape), np.random.default_rng(0)
    names, d = [*model.tensors], len(model.card.coordinates)
    on = OnWeights(model, names)
    q, p, *weights = rng.normal(size=(4, 5 * d))
    change = rng.normal(size=sum(part.size for part in model.tensors.values()))
    for _ in range(2):
        gradient = on.contracted(StateSequence.at(q, p), np.stack(weights))
        changed = on.changed(StateSequence.at(q, p), change)
        # Sums of some hundred products, of the size of their terms.
        assert abs(gradient @ change - np.sum(weights * changed)) <= 1e-13 * np.sum(
            abs(gradient * change))


def machine(folder: Path) -> Scene:
    """Return a machine with a prior, one fading motor on two joints, and friction of all kinds."""
    model = random_mechanical('double pendulum', input_map=[[0.9], [-0.4]], fade=[0.3])
    card = model.card.mechanical
    friction = card.friction.model_copy(update={
        'viscous_back': [0.3, 0.1], 'switch': [0.4, 0.5], 'offset': [0.1, -0.2],
        'load': [0.3, 0.5]})
    path = str(folder / 'machine.safetensors')
    save_checkpoint(path, replace(model, card=model.card.model_copy(update={
        'mechanical': card.model_copy(update={'friction': friction})})))
    return Scene.build(
        hamiltonian={'kind': 'learned', 'model': path, 'confine': False},
        effects=[{'kind': kind, 'model': path} for kind in ('learned_friction', 'external_force')],
        integrator='implicit_midpoint', step_size=0.02,
        initial_state=([0.5, -0.3], [0.1, 0.2]))


def test_derivatives_by_numbers_of_a_machine_and_by_its_commands(tmp_path, measured):
    scene, random = machine(tmp_path), np.random.default_rng(0)
    known = numbers_of_model(model_of(scene.parts()))
    assert {'model.prior.gravity1', 'model.friction.load.1', 'model.friction.coulomb.0.width.0',
            'model.input_map.1.0', 'model.fade.0'} < known.keys()
    weight = 'hamiltonian.potential.linear1.weight'
    start = [np.array([[0.5, -0.3]]), np.array([[0.1, 0.2]]), random.normal(size=(6, 1)),
             scene.create_hamiltonian().checkpoint.networks['potential'].weights[0],
             *map(np.array, known.values())]
    direction = [random.normal(size=part.shape) for part in start]

    def loss(tensors: list[torch.Tensor]) -> torch.Tensor:
        q, p, commands, weights, *numbers = tensors
        motion = simulate(scene, q, p, duration=0.6, every=5, commands=commands, parameters={
            weight: weights, **dict(zip(known, numbers, strict=True))})
        return (motion.q.square() + motion.p.sin()).sum()

    # What is cut off is some (1e-3)^6 of powers of coefficients of 0.1.
    expected, backward, forward = directional(loss, start, direction, 1e-3)
    error = max(abs(backward - expected), abs(forward - expected)) / abs(expected)
    measured('error of a derivative by numbers and commands of a machine', '', error, '<= 1e-7')
    # Second derivatives of forces are differences, of a spacing of 6e-6.
    assert error <= 1e-7


@pytest.mark.parametrize('arguments', [SMALL_ARGUMENTS, TREE_ARGUMENTS], ids=['small', 'large'])
def test_derivatives_by_numbers_of_links_of_a_urdf(tmp_path, arguments, measured):
    (tmp_path / 'tree.urdf').write_text(TREE)
    d, h = len(arguments['joints']), 0.01
    scene = Scene.build(
        hamiltonian={'kind': 'urdf', 'file': str(tmp_path / 'tree.urdf'), **arguments},
        integrator='implicit_midpoint', step_size=h, effects=[{'kind': 'damping', 'rate': 0.1}],
        initial_state=(d * [0.3], d * [0.0]))
    start = {'urdf.trunk.mass': 3.5, 'urdf.end.mass': 1.1, 'urdf.end.centre_z': 0.2,
             'urdf.tool.mass': 0.4, 'urdf.slider.ixx': 0.01, 'hamiltonian.rotor_inertia.rail': 1.5}
    simulation = DifferentiableSimulation(scene, [*start])
    q = torch.full((d,), 0.3, dtype=torch.float64)

    def loss(numbers: list[torch.Tensor]) -> torch.Tensor:
        motion = simulation(q, 0.0 * q, duration=20 * h, every=5, parameters=dict(
            zip(start, numbers, strict=True)))
        return motion.q.square().sum() + motion.p.sin().sum()

    def at(name: str, change: float) -> float:
        return float(loss([torch.tensor(value * (1.0 + change * (key == name)),
                                        dtype=torch.float64) for key, value in start.items()]))
    numbers = [*map(number, start.values())]
    loss(numbers).backward()
    for found, (name, value) in zip(numbers, start.items(), strict=True):
        # What is cut off is (1e-2)^6, what rounding of H leaves some 1e-16 / 1e-2.
        expected = difference(lambda change, name=name: at(name, change), 1e-2) / value
        error = abs(float(found.grad) - expected) / abs(expected)
        measured('error of a derivative by a number of a link', name, error, '<= 1e-9')
        assert error <= 1e-9, name


def test_number_that_no_link_of_a_urdf_has_is_refused_by_name(tmp_path, pendulum):
    with refused(ValueError):
        DifferentiableSimulation(pendulum, ['urdf.bob.mass'])
    arm = DifferentiableSimulation('two_joint_arm', ['urdf.forearm.mass'])
    q = torch.zeros(2, dtype=torch.float64)
    with refused(SceneError):
        arm(q, q, duration=0.1, parameters={'urdf.forearm.mass': -torch.ones(
            (), dtype=torch.float64)})
    with refused(ValueError):
        DifferentiableSimulation('two_joint_arm', ['urdf.forearn.mass'])


@pytest.mark.parametrize('hamiltonian, effect, names', [
    ({'kind': 'free_particle', 'mass': 2.0},
     {'kind': 'spring', 'point': ['x'], 'anchor': [0.0], 'stiffness': 3.0},
     ['hamiltonian.mass', 'effects.0.stiffness']),
    ({'kind': 'formula', 'coordinates': ['x'], 'parameters': {'m': 2.0}, 'H': 'p_x^2/(2*m)'},
     {'kind': 'potential', 'formula': 'k*x^2/2', 'parameters': {'k': 3.0}},
     ['hamiltonian.parameters.m', 'effects.0.parameters.k'])])
def test_number_of_an_effect_that_joins_h_is_followed(hamiltonian, effect, names):
    scene = Scene.build(hamiltonian=hamiltonian, effects=[effect], integrator='implicit_midpoint',
                        step_size=0.1, initial_state=([1.0], [0.0]))
    numbers, one = [number(2.0), number(3.0)], torch.ones(1, dtype=torch.float64)
    motion = simulate(scene, one, 0.0 * one, duration=2.0, every=20,
                      parameters=dict(zip(names, numbers, strict=True)))
    found = torch.autograd.grad(motion.q[-1, 0], numbers)
    # In each step the midpoint rule turns by theta, with tan(theta / 2) = h omega / 2.
    mass, stiffness = numbers
    theta = 2.0 * torch.atan(0.05 * torch.sqrt(stiffness / mass))
    expected = torch.autograd.grad(torch.cos(20.0 * theta), numbers)
    for one, other in zip(found, expected, strict=True):
        assert float(one) == pytest.approx(float(other), rel=1e-11)


def test_memory_grows_with_the_square_root_of_the_steps(pendulum):
    def peak(steps: int) -> int:
        q0 = torch.ones(1, dtype=torch.float64, requires_grad=True)
        tracemalloc.start()
        simulate(pendulum, q0, torch.zeros(1, dtype=torch.float64), duration=0.01 * steps,
                 every=steps).q[-1].backward()
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(1)
    least = peak(1)
    # Four times as much for 16 times the steps.
    assert peak(16 * 2500) - least <= 6 * (peak(2500) - least)


@pytest.mark.parametrize('name, build', [
    ('effects.0.rate', lambda: [{'kind': 'damping', 'rate': 0.0}]),
    ('effects.0.friction.angle', lambda: [
        {'kind': 'joint_friction', 'friction': {'angle': 0.0}, 'damping': {'angle': 0.1},
         'speed': 0.5}])])
def test_number_at_the_end_of_its_range_has_a_derivative(pendulum, name, build):
    scene, one = pendulum.changed({'effects': build()}), torch.ones(1, dtype=torch.float64)

    def last(value: torch.Tensor) -> torch.Tensor:
        return simulate(scene, one, 0.3 * one, duration=1.0, every=100,
                        parameters={name: value}).q[-1, 0]
    start = number(0.0)
    (found,) = torch.autograd.grad(last(start), start)
    # One-sided, of order 2: 1e-8 of the third derivative is cut off, and 1e-12 rounded.
    values = [float(last(torch.tensor(k * 1e-4, dtype=torch.float64))) for k in range(3)]
    assert float(found) == pytest.approx(
        (-1.5 * values[0] + 2.0 * values[1] - 0.5 * values[2]) / 1e-4, rel=1e-6)


@pytest.mark.parametrize('duration', [1.0, 100.0, 1000.0])
def test_frequency_is_followed_however_many_turns_there_were(duration):
    h, frequency = 0.05, number(0.7)
    scene = Scene.build(hamiltonian={'kind': 'free_particle', 'mass': 2.0}, step_size=h,
                        integrator='implicit_midpoint', initial_state=([0.0], [0.0]), effects=[
                            {'kind': 'periodic_drive', 'coordinate': 'x', 'amplitude': 2.0,
                             'frequency': 0.7, 'phase': 0.2}])
    zero, steps = torch.zeros(1, dtype=torch.float64), round(duration / h)
    motion = simulate(scene, zero, zero, duration=duration, every=steps,
                      parameters={'effects.0.frequency': frequency})
    motion.p[-1, 0].backward()
    # The impulse is the sum of forces at the middles of steps.
    t = h * (np.arange(steps) + 0.5)
    parts = -2.0 * h * 2.0 * np.pi * t * np.sin(2.0 * np.pi * 0.7 * t + 0.2)
    # Differences are good to 1e-12 of the largest of a piece; of the sum most cancels.
    assert abs(float(frequency.grad) - parts.sum()) <= 1e-11 * abs(parts).sum()


def test_gradient_is_that_of_the_commands_at_the_time_of_the_run(pendulum):
    scene = pendulum.changed({'effects': [
        {'kind': 'external_force', 'coordinates': ['angle'], 'timeout': 10.0}]})
    q0, one = torch.ones(1, dtype=torch.float64, requires_grad=True), torch.ones(1).double()
    commands = torch.linspace(0.0, 3.0, 10, dtype=torch.float64)[:, None]
    motion = simulate(scene, q0, one, duration=1.0, every=10, commands=commands)
    (expected,) = torch.autograd.grad(motion.q[-1, 0], q0, retain_graph=True)
    commands *= -1.0
    (found,) = torch.autograd.grad(motion.q[-1, 0], q0)
    assert torch.equal(found, expected)


def test_gradient_without_commands_is_that_under_the_initial_command(pendulum):
    force = {'kind': 'external_force', 'coordinates': ['angle'], 'initial': [2.0]}
    drive = {'kind': 'periodic_drive', 'coordinate': 'angle', 'amplitude': 2.0, 'frequency': 1e-12}
    found = []
    for effect in (force, drive):
        q0 = torch.ones(1, dtype=torch.float64, requires_grad=True)
        motion = simulate(pendulum.changed({'effects': [effect]}), q0,
                          torch.ones(1).double(), duration=1.0, every=10)
        found += torch.autograd.grad(motion.q[-1, 0], q0)
    assert torch.allclose(*found, rtol=1e-12)


@pytest.mark.parametrize('changes, error', [
    ({'duration': 1.003}, ValueError), ({'duration': 1e30}, ValueError),
    ({'parameters': ['hamiltonian.mass']}, TypeError), ({'every': 3}, ValueError),
    ({'q0': torch.zeros(1)}, TypeError), ({'q0': [0.0]}, TypeError),
    ({'q0': torch.zeros(2, dtype=torch.float64)}, ValueError),
    ({'q0': torch.zeros(0, 1, dtype=torch.float64),
      'p0': torch.zeros(0, 1, dtype=torch.float64)}, ValueError),
    ({'scene': 'free_rigid_body'}, UnsupportedSystem),
    ({'parameters': {'mass': torch.ones((), dtype=torch.float64)}}, ValueError),
    ({'parameters': {'hamiltonian.mass': torch.ones(1, dtype=torch.float64)}}, ValueError),
    ({'scene': 'pendulum', 'parameters': {
        'hamiltonian.linear9.bias': torch.ones(1, dtype=torch.float64)}}, ValueError),
    ({'parameters': {'hamiltonian.linear1.bias': torch.ones(1, dtype=torch.float64)}},
     ValueError),
    ({'scene': 'bouncing_mass'}, UnsupportedSystem),
    ({'scene': {'events': [{'when': 'angle = 0'}]}}, ValueError),
    ({'scene': {'effects': [{'kind': 'damping', 'rate': 0.4}]}, 'step_size': torch.tensor(
        0.02, dtype=torch.float64)}, UnsupportedSystem)])
def test_what_cannot_be_differentiated_is_refused_by_name(pendulum, changes, error):
    zero = torch.zeros(1, dtype=torch.float64)
    arguments = {'scene': {}, 'q0': zero, 'p0': zero, 'duration': 1.0} | changes
    if isinstance(arguments['scene'], dict):
        arguments['scene'] = pendulum.changed(arguments['scene'])
    with refused(error):
        simulate(**arguments)


def test_examples_of_the_docs_run(capsys):
    names: dict = {}
    for example in blocks(ROOT / 'docs' / 'how-to' / 'gradients.md', 'python'):
        exec(compile(example, 'gradients.md', 'exec'), names)
    assert torch.equal(names['motion'].q, names['simulation'](
        names['q0'], names['p0'], duration=10.0, every=100,
        parameters={'hamiltonian.mass': names['mass']}).q)
    assert len(re.findall('tensor', capsys.readouterr().out)) == 2


FORCED = ('hamiltonian.mass2', 'effects.0.rate', 'effects.1.friction.angle2',
          'effects.2.coefficient', 'effects.3.frequency')


def forced(method: str) -> Scene:
    """Return a scene with forces of every kind, whose damping acts as the method has it."""
    return Scene.build(
        hamiltonian='double_pendulum', integrator=method, step_size=0.02,
        initial_state=([0.5, -0.3], [0.1, 0.2]), effects=[
            {'kind': 'damping', 'rate': 0.4},
            {'kind': 'joint_friction', 'friction': {'angle2': 0.2}, 'speed': 0.5},
            {'kind': 'quadratic_drag', 'coordinates': ['angle1', 'angle2'], 'coefficient': 0.3},
            {'kind': 'periodic_drive', 'coordinate': 'angle1', 'amplitude': 1.0,
             'frequency': 0.7},
            {'kind': 'external_force', 'coordinates': ['angle2']}])


# Around the steps of the first damping is a flow, in those of the second a force.
@pytest.mark.parametrize('method', ['generalized_leapfrog', 'gauss4'])
def test_derivatives_go_through_forces_damping_and_commands(method, measured):
    scene, random = forced(method), np.random.default_rng(0)
    values = [np.array([[0.5, -0.3], [0.2, 0.4]]), np.array([[0.1, 0.2], [-0.3, 0.1]]),
              random.normal(size=(6, 2, 1)), *map(np.array, (1.0, 0.4, 0.2, 0.3, 0.7))]
    direction = [random.normal(size=value.shape) for value in values]
    weights = torch.from_numpy(random.normal(size=(7, 2, 4)))

    def loss(tensors: list[torch.Tensor]) -> torch.Tensor:
        q, p, commands, *numbers = tensors
        motion = simulate(scene, q, p, duration=0.6, every=5, commands=commands,
                          parameters=dict(zip(FORCED, numbers, strict=True)))
        return (torch.cat([motion.q, motion.p], dim=-1) * weights).sum()

    # What is cut off is some (2e-3)^6.
    expected, backward, forward = directional(loss, values, direction, 2e-3)
    error = max(abs(backward - expected), abs(forward - expected)) / abs(expected)
    measured('error of a derivative through forces and commands', method, error, '<= 1e-8')
    # Second derivatives of forces are differences, good to some 1e-10.
    assert error <= 1e-8


def test_states_with_commands_are_those_of_simulate():
    scene, commands = forced('gauss4'), np.random.default_rng(1).normal(size=(6, 1))
    state = scene.initial_state
    motion = simulate(scene, torch.tensor(state.q, dtype=torch.float64),
                      torch.tensor(state.p, dtype=torch.float64), duration=0.6, every=5,
                      commands=torch.from_numpy(commands))
    expected = hnn_vi_ros.simulate(scene, 0.6, every=5, commands=commands)
    assert np.array_equal(motion.q.numpy(), expected.q)


MASS = 'hamiltonian.mass'


def gradients(simulation: DifferentiableSimulation, mass: float, q: float = 1.3,
              **others: float) -> list[torch.Tensor]:
    """Return q at the end, and its derivatives by its start and by the mass."""
    start, followed = number(q), number(mass)
    last = simulation(start[None], torch.ones(1, dtype=torch.float64), duration=1.0, every=100,
                      parameters={MASS: followed, **{
                          name: torch.tensor(value, dtype=torch.float64)
                          for name, value in others.items()}}).q[-1, 0]
    return [last.detach(), *torch.autograd.grad(last, (start, followed))]


def same(one: list[torch.Tensor], other: list[torch.Tensor]) -> bool:
    return all(map(torch.equal, one, other))


@pytest.mark.parametrize('effects', [
    [], [{'kind': 'damping', 'rate': 0.1}],
    [{'kind': 'joint_friction', 'friction': {'angle': 0.2}, 'speed': 0.5}]])
def test_call_of_a_prepared_simulation_finds_nothing_of_earlier_ones(pendulum, effects):
    scene = pendulum.changed({'effects': effects})
    name = {'damping': {'effects.0.rate': 0.2}, 'joint_friction': {
        'effects.0.friction.angle': 0.4}}.get(effects[0]['kind'] if effects else '', {})
    often = DifferentiableSimulation(scene, [MASS, *name])
    other = gradients(often, 2.0, -0.4, **{key: 0.7 * value for key, value in name.items()})
    found = gradients(often, 1.1, **name)
    assert same(found, gradients(DifferentiableSimulation(scene, [MASS, *name]), 1.1, **name))
    assert not any(map(torch.equal, found, other))


def test_earlier_call_is_differentiated_with_its_own_numbers(pendulum):
    simulation, one = DifferentiableSimulation(pendulum, [MASS]), torch.ones(1).double()
    masses, steps = [number(1.1), number(2.0)], [0.01, number(0.02)]
    total = sum(simulation(one, one, duration=1.0, every=50, step_size=h, parameters={MASS: mass}
                           ).q[-1, 0] for mass, h in zip(masses, steps, strict=True))
    together = torch.autograd.grad(total, masses)
    for mass, h, found in zip(masses, steps, together, strict=True):
        alone = simulate(pendulum, one, one, duration=1.0, every=50, step_size=h,
                         parameters={MASS: mass}).q[-1, 0]
        assert torch.equal(found, torch.autograd.grad(alone, mass)[0])


def test_threads_and_prepared_simulations_share_nothing(pendulum):
    shared, alone = (DifferentiableSimulation(pendulum, [MASS]) for _ in range(2))
    masses = [0.5 + 0.1 * k for k in range(12)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda mass: gradients(shared, mass), masses))
    for mass, own in zip(masses, found, strict=True):
        assert same(own, gradients(alone, mass))


def test_failed_call_of_a_prepared_simulation_leaves_nothing_behind(pendulum):
    simulation = DifferentiableSimulation(pendulum, [MASS])
    expected = gradients(simulation, 1.1)
    with refused(SceneError):
        gradients(simulation, -1.0)
    with pytest.raises(StateError):
        gradients(simulation, 2.0, float('nan'))
    assert same(gradients(simulation, 1.1), expected)


def test_prepared_simulation_takes_the_names_that_it_was_made_for(pendulum):
    simulation, one = DifferentiableSimulation(pendulum, [MASS]), torch.ones(1).double()
    for given in ({}, {'hamiltonian.length': one[0]}):
        with refused(ValueError):
            simulation(one, one, duration=1.0, parameters=given)
    with refused(ValueError):
        DifferentiableSimulation(pendulum, ['mass'])


# Ways to a second derivative of f at x, or to a derivative of a derivative that is linear in it.
def penalty(f: Loss, x: torch.Tensor) -> object:
    x = x.clone().requires_grad_()
    (first,) = torch.autograd.grad(f(x), x, create_graph=True)
    return torch.autograd.grad(first.square() + x, x)


def forward_over_reverse(f: Loss, x: torch.Tensor) -> object:
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(x.clone().requires_grad_(), torch.ones_like(x))
        return torch.autograd.grad(f(dual), dual)


def reverse_over_forward(f: Loss, x: torch.Tensor) -> object:
    x = x.clone().requires_grad_()
    with forward_ad.dual_level():
        tangent = forward_ad.unpack_dual(f(forward_ad.make_dual(x, torch.ones_like(x)))).tangent
        return torch.autograd.grad(tangent + x, x)


TWICE = (
    penalty, forward_over_reverse, reverse_over_forward, functional.hessian,
    lambda f, x: functional.hessian(f, x, vectorize=True),
    *(lambda f, x, product=product: product(f, x, torch.ones_like(x))
      for product in (functional.hvp, functional.vhp, functional.jvp)),
    lambda f, x: torch.func.grad(torch.func.grad(f))(x),
    lambda f, x: torch.func.jvp(torch.func.grad(f), (x,), (torch.ones_like(x),)),
    lambda f, x: torch.func.grad(lambda x: torch.func.jvp(f, (x,), (torch.ones_like(x),))[1])(x))
BATCHED = (
    lambda f, x: torch.func.hessian(f)(x), lambda f, x: torch.func.jacrev(f)(x),
    lambda f, x: torch.func.jacfwd(f)(x), lambda f, x: torch.func.vmap(f)(x.repeat(2)),
    lambda f, x: functional.jacobian(f, x, vectorize=True),
    lambda f, x: functional.jacobian(f, x, vectorize=True, strategy='forward-mode'))
# What a loss is differentiated by, at which number.
ARGUMENTS = {'q0': 1.3, 'p0': 0.7, 'commands': 0.4, 'step_size': 0.02, 'hamiltonian.mass': 1.1,
             'effects.0.rate': 0.4, 'hamiltonian.linear1.bias': 0.1}


def loss_of(argument: str, linear: bool) -> Loss:
    """Return a loss of the last state as a function of one number that the run depends on."""
    learned, h, weight = 'linear1' in argument, 0.02, 0.0
    scene = load_scene('pendulum' if learned else 'exact_pendulum').with_overrides(step_size=h)
    scene = scene.changed({'effects': {
        'commands': [{'kind': 'external_force', 'coordinates': ['angle'], 'timeout': 10.0}],
        'effects.0.rate': [{'kind': 'damping', 'rate': 0.3}]}.get(argument, [])})
    if learned:
        scene = unconfined(scene)
        weight = torch.from_numpy(scene.create_hamiltonian().checkpoint.networks['energy'][1][0])
    names = [argument] if '.' in argument else []

    def loss(x: torch.Tensor) -> torch.Tensor:
        given = {'q0': torch.ones(1).double(), 'p0': torch.ones(1).double()}
        if names:
            given['parameters'] = {argument: weight + x}
        else:
            given[argument] = {'commands': x.expand(5, 1), 'step_size': x}.get(
                argument, x.reshape(1))
        # simulate() calls the same.
        motion = DifferentiableSimulation(scene, names)(**given, duration=5 * 2 * h, every=2)
        last = motion.q[-1, 0] + 0.3 * motion.p[-1, 0]
        return last if linear else last.square()
    return loss


@pytest.mark.parametrize('linear', [False, True], ids=['square', 'linear'])
@pytest.mark.parametrize('argument', ARGUMENTS)
def test_second_derivatives_are_refused_however_they_are_asked_for(argument, linear):
    f = loss_of(argument, linear)
    x = torch.tensor(ARGUMENTS[argument], dtype=torch.float64)
    for way in TWICE:
        with pytest.raises(UnsupportedSystem, match='only once|weights in torch.func'):
            way(f, x)
    for way in BATCHED:
        # Of a batch torch itself takes no single number.
        with pytest.raises((UnsupportedSystem, RuntimeError), match='vmap'):
            way(f, x)


@pytest.mark.parametrize('argument', [name for name in ARGUMENTS if 'linear1' not in name])
def test_first_derivatives_are_the_same_however_they_are_asked_for(argument):
    f = loss_of(argument, False)
    x = torch.tensor(ARGUMENTS[argument], dtype=torch.float64)
    own = x.clone().requires_grad_()
    (expected,) = torch.autograd.grad(f(own), own)
    one = torch.ones_like(x)
    for found in (torch.func.grad(f)(x), torch.func.vjp(f, x)[1](one)[0],
                  functional.jacobian(f, x), functional.vjp(f, x)[1]):
        assert torch.equal(found, expected)
    # Forwards and backwards the same sums are rounded in another order.
    assert float(torch.func.jvp(f, (x,), (one,))[1]) == pytest.approx(float(expected), rel=1e-10)


def test_gradient_that_is_kept_for_a_second_one_may_be_used_as_it_is(pendulum):
    q = torch.ones(1, dtype=torch.float64, requires_grad=True)
    last = simulate(pendulum, q, 0.0 * q.detach(), duration=1.0).q[-1, 0]
    (first,) = torch.autograd.grad(last, q, create_graph=True)
    (q.square() * first.detach()).sum().backward()
    assert torch.equal(q.grad, 2.0 * first.detach())
