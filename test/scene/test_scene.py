# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes: what is valid, and what each mistake is answered with."""

from pathlib import Path

from hnn_vi_ros.errors import HnnViRosError, ModelError, SceneError, UnsupportedSystem
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build
from messages import assert_message, refused
import pytest
from python_process import run_code
from scene_files import ACTED_ON

GOOD = """\
hamiltonian: {kind: harmonic_oscillator, mass: 2.0}
integrator: {kind: variational_euler}
step_size: 1e-2
initial_state:
  q: [1.0]
  p: [0]
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a scene file and returns its path."""
    def write_file(content: str | bytes, name: str = 'mine.yaml') -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path
    return write_file


def test_scene_file_is_read(write):
    scene = load_scene(write(GOOD))
    assert (scene.name, scene.step_size, scene.initial_state.p) == ('mine', 0.01, [0.0])
    assert scene.create_hamiltonian().mass == 2.0
    assert load_scene(str(scene.source)) == scene


def test_step_size_that_auto_is_to_choose_is_refused_where_one_is_needed(write):
    scene = load_scene(write(GOOD.replace('step_size: 1e-2\n', '').replace(
        '{kind: variational_euler}', '{kind: auto, energy_error: 1e-3, horizon: 10.0}')))
    assert scene.step_size is None
    with refused(SceneError):
        scene.known_step_size  # noqa: B018  refused when it is read


@pytest.mark.parametrize('code', [
    'import hnn_vi_ros; hnn_vi_ros.load_scene({scene!r})',
    "sys.argv[1:] = ['list', 'scenes']; from hnn_vi_ros import cli; cli.main()",
    "sys.argv[1:] = ['--schema']; from hnn_vi_ros import cli; cli.scene()"])
def test_scene_is_read_without_a_compiler(write, code):
    code = f"""import sys
try:
    {code.format(scene=str(write(ACTED_ON)))}
except SystemExit as end:
    assert not end.code, end
print(sorted(sys.modules.keys() & {{'numba', 'llvmlite', 'scipy', 'torch'}}), file=sys.stderr)"""
    result = run_code(code)
    assert (result.returncode, result.stderr) == (0, '[]\n')


@pytest.mark.parametrize('given, threads', [({}, '1'), ({'OPENBLAS_NUM_THREADS': '3'}, '3')])
def test_linear_algebra_has_one_thread_unless_the_environment_says_more(given, threads):
    # The library reads it when numpy is imported.
    code = f"""import os, sys
os.environ.pop('OPENBLAS_NUM_THREADS')
os.environ |= {given}
from hnn_vi_ros import cli
assert 'numpy' not in sys.modules
sys.argv[1:] = ['list', 'scenes']
try:
    cli.main()
except SystemExit:
    print(os.environ['OPENBLAS_NUM_THREADS'], file=sys.stderr)"""
    assert run_code(code).stderr == f'{threads}\n'


@pytest.mark.parametrize('old, new', [
    ('step_size', 'stepsize'), ('1e-2', '-0.1'), ('1e-2', '1 ms'), ('1e-2', '0'),
    ('p: [0]', 'p: [0]\neffects: [{kind: servo, coordinates: [x], stiffness: high}]'),
    ('p: [0]', 'p: [0]\neffects: [{kind: joint_limits, lower: {x: low}}]'), ('q: [1.0]', 'q: []'),
    ('p: [0]', 'p: [0]\ninvariants: [{name: "2x"}]'), ('1e-2', '.nan'), ('1e-2', '.inf'),
    ('1e-2', '"0.1"'), ('variational_euler', 'rk5'), ('harmonic_oscillator', 'x'),
    ('kind: harmonic_oscillator, ', ''), ('{kind: variational_euler}', 'RK4'), ('mass', 'maß'),
    ('q: [1.0]', 'q: [1.0, two]'), ('  p: [0]', ''), ('step_size: 1e-2\n', ''),
    ('p: [0]', 'p: [0]\n  p: [1]'), ('q: [1.0]', 'q: &a [1.0]\n  r: *a'),
    ('p: [0]', 'p: ' + '[' * 33 + ']' * 33),
    ('p: [0]', 'p: !!python/object/apply:os.system [exit]'), ('1e-2', '1' + ':1' * 300_000),
    ('1e-2', '2020-13-45'), ('1e-2', '9' * 5000), ('1e-2', '010'),
    ('step_size', '"step\\x1b_size"'), ('variational_euler', '"' + 'x' * 5000 + '\\n"')])
def test_scene_mistake_is_answered_with_file_line_key_and_remedy(write, old, new):
    with refused(SceneError):
        load_scene(write(GOOD.replace(old, new, 1)))


def test_all_problems_of_a_scene_are_told_at_once_one_a_line(write):
    with pytest.raises(SceneError) as caught:
        load_scene(write(GOOD.replace('variational_euler', 'Gauss9').replace('1e-2', '1 ms')
                         .replace('mass', 'mas').replace('q: [1.0]', 'q: [1.0, two]')))
    for line in caught.value.lines:
        assert_message(line)
    assert len(caught.value.lines) == 4 and str(caught.value) == '; '.join(caught.value.lines)


def test_scene_effects_are_built_in_their_order_from_whole_numbers_as_well(write):
    effects = load_scene(write(ACTED_ON)).create_effects()
    assert [type(effect).__name__ for effect in effects] == ['Gravity', 'Damping', 'Spring']
    assert load_scene(write(GOOD)).create_effects() == []


@pytest.mark.parametrize('old, new', [
    ('kind: gravity, ', ''), ('gravity', 'gravy'), ('coordinate', 'coordinat'),
    ('coordinate: y', 'coordinate: z'), ('{kind: gravity, coordinate: y}', 'gravity'),
    ('    rate: 0.1\n', ''), ('0.1', 'fast'), ('0.1', '.nan'), ('0.1', '[0.1, .inf]'),
    ('0.1', '[0.1, "2"]'), ('0.1', '[1, 2, 3]'), ('0.1', '-1'), ('[x]', '[x, z]'),
    ('{kind: spring, point: [x], anchor: [0]}', '{kind: learned_dissipation, model: nothing}'),
    ('{kind: spring, point: [x], anchor: [0]}', '{kind: learned_dissipation, model: pendulum}'),
    ('damping\n    rate: 0.1', 'thermostat\n    temperature: 1\n    rate: [1]'),
    ('damping\n    rate: 0.1', 'impact\n    coordinate: x\n    position: 2'),
    ('{kind: spring, point: [x], anchor: [0]}',
     '{kind: holonomic_constraint, point: [x, y], anchor: [0, 0], length: 2}'),
    ('{kind: generalized_leapfrog}', '{kind: generalized_leapfrog, solver: no_such}'),
    ('kind: damping\n    rate: 0.1\n', 'kind: damping\n    rate: 0.1\n'
     + 2 * '  - {kind: thermostat, temperature: 1, rate: 1}\n'),
    ('[x, y]', '[x, x]'), ('p: [0, 0]', 'p: [0]')])
def test_scene_effect_mistake_is_answered_with_file_line_key_and_remedy(write, old, new):
    with refused(HnnViRosError):
        build(load_scene(write(ACTED_ON.replace(old, new, 1))))


def test_scene_method_that_cannot_take_an_effect_is_refused_where_it_stands(write):
    scene = load_scene(write(ACTED_ON.replace('damping', 'thermostat\n    temperature: 1')))
    with refused(UnsupportedSystem):
        build(load_scene(write(
            ACTED_ON.replace('damping', 'thermostat\n    temperature: 1')
            .replace('generalized_leapfrog', 'rk4'))))
    with refused(UnsupportedSystem):
        build(scene.with_overrides(integrator='rk4'))


def test_scene_override_is_not_placed_in_the_file(write):
    scene = load_scene(write(ACTED_ON)).with_overrides(step_size=0.1)
    assert scene.place('step_size').endswith('mine.yaml with overrides: step_size')
    assert scene.place('effects', 1, 'rate').endswith('mine.yaml:5: effects.1.rate')
    assert Scene.model_validate(scene.model_dump()).place('step_size') == 'scene: step_size'


@pytest.mark.parametrize('content', [
    b'', b'\xff\xfe', b'- 1', b'a: [', b'\x00', b'5', b'#' * 2**21])
def test_scene_file_that_is_no_mapping_is_refused(write, content):
    with refused(SceneError):
        load_scene(write(content))


@pytest.mark.parametrize('given', [
    'nothing.yaml', 'mine.yml', 'mime.yaml', 'doube_pendulum.yaml', 'nope.yaml', 'none/mine.yaml',
    '\0.yaml', 'folder', 'folder/', 'bare'])
def test_scene_that_is_not_there_is_told_with_what_there_is(tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'folder').mkdir()
    for name in ('mine.yaml', 'bare'):
        (tmp_path / name).write_text('')
    with refused(SceneError):
        load_scene(given)


@pytest.mark.parametrize('old, new, error', [
    ('step_size', 'mechanism: double_pendulum\nstep_size', SceneError),
    ('step_size', 'mechanism: turning_body\nstep_size', SceneError),
    ('mass: 2.0', 'mass: -1.0', SceneError), ('q: [1.0]', 'q: [1.0, 2.0]', SceneError),
    ('harmonic_oscillator, mass: 2.0', 'hnn, model: nothing', ModelError),
    ('harmonic_oscillator, mass: 2.0', 'hnn, model: ./nothing.safetensors', ModelError),
    ('harmonic_oscillator, mass: 2.0', "python, factory: 'no_such:thing'", SceneError),
    ('harmonic_oscillator, mass: 2.0', "python, factory: 'os:getcwd'", SceneError)])
def test_scene_that_cannot_be_built_says_why(write, old, new, error):
    scene = load_scene(write(GOOD.replace(old, new, 1)))
    with refused(error):
        build(scene)


def test_mechanism_of_scalar_coordinates_draws_no_body_that_turns(write):
    scene = load_scene(write("""\
hamiltonian: {kind: heavy_top}
integrator: {kind: lie_leapfrog}
step_size: 0.01
initial_state: {q: [0, 0, 0, 1], p: [0, 0, 1]}
mechanism: pendulum
"""))
    with refused(SceneError):
        build(scene)


def test_scene_python_factory_gives_a_hamiltonian(write):
    scene = load_scene(write(GOOD.replace(
        '{kind: harmonic_oscillator, mass: 2.0}',
        "{kind: python, factory: 'hnn_vi_ros.hamiltonians.tao:Tao'}")))
    assert type(scene.create_hamiltonian()).__name__ == 'Tao'


ERRING = """\
from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


def energy(parameters, q, p):
    return float(np.sum(p**2) / 2.0 - np.sum(np.cos(q)))


def gradient(parameters, q, p, dH_dq, dH_dp):
    dH_dq[:], dH_dp[:] = np.sin(q), FACTOR * p


def products(parameters, q, p, v_q, v_p, product_q, product_p):
    product_q[:], product_p[:] = np.cos(q) * v_q, v_p


class Pendulum(Hamiltonian):
    coordinates, separable = (Coordinate('a', 'rad', 'kg m2/s'),), True
    kernel = compiled_kernel((energy, gradient, products), (), 1)
"""


def test_gradient_of_code_that_errs_by_a_per_cent_is_refused_also_from_rest(write):
    for name, factor in (('exact', '1.0'), ('erring', '1.01')):
        write(ERRING.replace('FACTOR', factor), f'{name}.py')
        scene = load_scene(write(GOOD.replace(
            'harmonic_oscillator, mass: 2.0', f"python, factory: '{name}:Pendulum'")))
        if name == 'exact':
            assert scene.create_hamiltonian().separable
        else:
            with refused(SceneError):
                scene.create_hamiltonian()


def test_model_path_is_found_beside_its_scene(write, tmp_path):
    (tmp_path / 'm.safetensors').write_bytes(
        shipped_file('model', 'harmonic_oscillator').read_bytes())
    scene = load_scene(write(GOOD.replace(
        '{kind: harmonic_oscillator, mass: 2.0}', '{kind: hnn, model: m.safetensors}')))
    assert scene.create_hamiltonian().dimension == 1
