# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes: what is valid, what each mistake is answered with, and that nothing gets through."""

from pathlib import Path
import subprocess
import sys

from hnn_vi_ros.errors import HnnViRosError, ModelError, SceneError, UnsupportedSystem
from hnn_vi_ros.files.resources import shipped_file
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation.build import build
from hypothesis import given, HealthCheck, settings, strategies
import pytest

GOOD = """\
hamiltonian: {kind: harmonic_oscillator, mass: 2.0}
integrator: {kind: variational_euler}
step_size: 1e-2
initial_state:
  q: [1.0]
  p: [0]
"""


ACTED_ON = """\
hamiltonian: {kind: free_particle, mass: 2.0, names: [x, y]}
effects:
  - {kind: gravity, coordinate: y}
  - kind: damping
    rate: 0.1
  - {kind: spring, point: [x], anchor: [0]}
integrator: {kind: generalized_leapfrog}
step_size: 0.01
initial_state: {q: [1.0, 0], p: [0, 0]}
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
    with pytest.raises(SceneError, match=r'mine.yaml:2: integrator: auto chose no step size yet'):
        scene.known_step_size  # noqa: B018  refused when it is read


@pytest.mark.parametrize('code', [
    'import hnn_vi_ros; hnn_vi_ros.load_scene({scene!r})',
    "sys.argv[1:] = ['--list']; from hnn_vi_ros import cli; cli.scene()",
    "sys.argv[1:] = ['--schema']; from hnn_vi_ros import cli; cli.scene()"])
def test_scene_is_read_without_a_compiler(write, code):
    code = f"""import sys
try:
    {code.format(scene=str(write(ACTED_ON)))}
except SystemExit as end:
    assert not end.code, end
print(sorted(sys.modules.keys() & {{'numba', 'llvmlite', 'scipy', 'torch'}}), file=sys.stderr)"""
    result = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                            timeout=120, check=False)
    assert (result.returncode, result.stderr) == (0, '[]\n')


@pytest.mark.parametrize('old, new, expected', [
    ('step_size', 'stepsize', r'mine.yaml:3: stepsize: unknown key; did you mean step_size\?; '),
    ('1e-2', '-0.1', r'mine.yaml:3: step_size: must be greater than 0 \[s\], not -0.1'),
    ('1e-2', '1 ms', r"mine.yaml:3: step_size: '1 ms' is no number of seconds, e.g. 0.001"),
    ('1e-2', '0', r'mine.yaml:3: step_size'),
    ('p: [0]', 'p: [0]\neffects: [{kind: servo, coordinates: [x], stiffness: high}]',
     r'mine.yaml:7: effects.0.stiffness: must be a number or a list.* \[N/m\] or \[N m/rad\]'),
    ('p: [0]', 'p: [0]\neffects: [{kind: joint_limits, lower: {x: low}}]',
     r"mine.yaml:7: effects.0.lower.x: 'low' is no number \[rad\] or \[m\]"),
    ('q: [1.0]', 'q: []', r'initial_state.q: must have 1 or more entries, not \[\]$'),
    ('p: [0]', 'p: [0]\ninvariants: [{name: "2x"}]',
     r"mine.yaml:7: invariants.0.name: must match the pattern .*, not '2x'"),
    ('1e-2', '.nan', r'mine.yaml:3: step_size: .*finite'),
    ('1e-2', '.inf', r'mine.yaml:3: step_size'),
    ('1e-2', '"0.1"', r'mine.yaml:3: step_size: .*number'),
    ('variational_euler', 'rk5', r"mine.yaml:2: integrator.kind: unknown kind 'rk5'; .*rk4"),
    ('harmonic_oscillator', 'x', 'mine.yaml:1: hamiltonian.kind: unknown kind .*, hnn, kepler'),
    ('kind: harmonic_oscillator, ', '', 'mine.yaml:1: hamiltonian.kind: required; valid kinds'),
    ('{kind: variational_euler}', 'rk4',
     "mine.yaml:2: integrator: expected {kind: rk4}, and further keys, not 'rk4'"),
    ('mass', 'maß', r'mine.yaml:1: hamiltonian.maß: unknown key; valid keys: .*mass'),
    ('q: [1.0]', 'q: [1.0, two]', r'mine.yaml:5: initial_state.q.1'),
    ('  p: [0]', '', r'mine.yaml:4: initial_state.p: .*required'),
    ('step_size: 1e-2\n', '', r'mine.yaml:1: step_size: .*required'),
    ('p: [0]', 'p: [0]\n  p: [1]', r"mine.yaml:7: 'p': the second of this key; remove one"),
    ('q: [1.0]', 'q: &a [1.0]\n  r: *a', r'mine.yaml:6: initial_state.r: unknown key'),
    ('p: [0]', 'p: ' + '[' * 33 + ']' * 33, r'mine.yaml:6: nested'),
    ('p: [0]', 'p: !!python/object/apply:os.system [exit]', r'mine.yaml:6: a tag'),
    ('1e-2', '1' + ':1' * 300_000, r'mine.yaml:3: step_size: .*number'),
    ('1e-2', '2020-13-45', r'mine.yaml:3: step_size: .*number'),
    ('1e-2', '9' * 5000, r'mine.yaml:3: a number of more than 300 characters'),
    ('1e-2', '010', r'mine.yaml:3: step_size: .*number'),
    ('step_size', '"step\\x1b_size"', r'mine.yaml:3: a key .* printable'),
    ('variational_euler', '"' + 'x' * 5000 + '\\n"', r'mine.yaml:2: integrator.kind: unknown'),
])
def test_scene_mistake_is_answered_with_file_line_key_and_remedy(write, old, new, expected):
    with pytest.raises(SceneError, match=expected) as caught:
        load_scene(write(GOOD.replace(old, new, 1)))
    assert '\n' not in str(caught.value)


def test_scene_aliases_stand_for_what_they_repeat(write):
    scene = load_scene(write(GOOD.replace('q: [1.0]', 'q: &a [1.5]').replace('p: [0]', 'p: *a')))
    assert scene.initial_state.q == scene.initial_state.p == [1.5]


def test_scene_effects_are_built_in_their_order_from_whole_numbers_as_well(write):
    effects = load_scene(write(ACTED_ON)).create_effects()
    assert [type(effect).__name__ for effect in effects] == ['Gravity', 'Damping', 'Spring']
    assert load_scene(write(GOOD)).create_effects() == []


@pytest.mark.parametrize('old, new, expected', [
    ('kind: gravity, ', '', 'mine.yaml:3: effects.0.kind: required; valid kinds: .*gravity'),
    ('gravity', 'gravy', "mine.yaml:3: effects.0.kind: unknown kind 'gravy'; did you mean gravity"
     '.* more'),
    ('coordinate', 'coordinat', r'mine.yaml:3: effects.0.coordinat: unknown key; did you mean '
     r'coordinate\?; valid keys: acceleration, coordinate, kind, mass$'),
    ('coordinate: y', 'coordinate: z',
     "mine.yaml:3: effects.0: gravity: no coordinate 'z'; valid coordinates: x, y"),
    ('{kind: gravity, coordinate: y}', 'gravity',
     'mine.yaml:3: effects.0: expected {kind: gravity}, and further keys'),
    ('    rate: 0.1\n', '', 'mine.yaml:4: effects.1.rate: .*required'),
    ('0.1', 'fast', 'mine.yaml:5: effects.1.rate: .*number .*list'),
    ('0.1', '.nan', 'mine.yaml:5: effects.1.rate: .*finite'),
    ('0.1', '[0.1, .inf]', 'mine.yaml:5: effects.1.rate.1: .*finite'),
    ('0.1', '[0.1, "2"]', 'mine.yaml:5: effects.1.rate.1: .*number'),
    ('0.1', '[1, 2, 3]', 'mine.yaml:5: effects.1.rate: damping: rate has 3 values, .* x, y'),
    ('0.1', '-1', 'mine.yaml:5: effects.1.rate: damping: rate = -1.0 must be'),
    ('[x]', '[x, z]', 'mine.yaml:6: effects.2.anchor: spring: anchor has 1 entries'),
    ('{kind: spring, point: [x], anchor: [0]}', '{kind: learned_dissipation, model: nothing}',
     "mine.yaml:6: effects.2.model: no model 'nothing', .*pendulum"),
    ('{kind: spring, point: [x], anchor: [0]}', '{kind: learned_dissipation, model: pendulum}',
     'mine.yaml:6: effects.2: learned_dissipation: the model has 1 coordinates'),
    ('damping\n    rate: 0.1', 'thermostat\n    temperature: 1\n    rate: [1]',
     'mine.yaml:6: effects.1.rate: thermostat: rate has 1 values, .* x, y'),
    ('damping\n    rate: 0.1', 'impact\n    coordinate: x\n    position: 2',
     'mine.yaml:10: initial_state'),
    ('{kind: spring, point: [x], anchor: [0]}', '{kind: holonomic_constraint, point: [x, y], '
     'anchor: [0, 0], length: 2}', 'mine.yaml:9: initial_state'),
    ('{kind: generalized_leapfrog}', '{kind: generalized_leapfrog, solver: no_such}',
     "mine.yaml:7: integrator.solver: generalized_leapfrog: solver = 'no_such'; valid: chain"),
    ('kind: damping\n    rate: 0.1\n', 'kind: damping\n    rate: 0.1\n  - '
     '{kind: thermostat, temperature: 1, rate: 1}\n  - {kind: thermostat, temperature: 1, rate: 1}'
     '\n', 'mine.yaml:7: effects.3: thermostat: a scene takes one'),
    ('[x, y]', '[x, x]', 'mine.yaml:1: hamiltonian.names: free_particle: names = .*each once'),
    ('p: [0, 0]', 'p: [0]', 'mine.yaml:9: initial_state.p: 1 values, expected 2, .*: x, y'),
])
def test_scene_effect_mistake_is_answered_with_file_line_key_and_remedy(
        write, old, new, expected):
    with pytest.raises(HnnViRosError, match=expected) as caught:
        build(load_scene(write(ACTED_ON.replace(old, new, 1))))
    assert '\n' not in str(caught.value)


def test_scene_method_that_cannot_take_an_effect_is_refused_where_it_stands(write):
    scene = load_scene(write(ACTED_ON.replace('damping', 'thermostat\n    temperature: 1')))
    with pytest.raises(UnsupportedSystem, match='thermostat.*: generalized_leapfrog') as caught:
        build(load_scene(write(
            ACTED_ON.replace('damping', 'thermostat\n    temperature: 1')
            .replace('generalized_leapfrog', 'rk4'))))
    assert 'mine.yaml:8: integrator: ' in str(caught.value)
    with pytest.raises(UnsupportedSystem, match='mine.yaml: integrator: rk4 cannot'):
        build(scene.with_overrides(integrator='rk4'))


def test_scene_override_is_not_placed_in_the_file(write):
    scene = load_scene(write(ACTED_ON)).with_overrides(step_size=0.1)
    assert scene.place('step_size').endswith('mine.yaml: step_size')
    assert scene.place('effects', 1, 'rate').endswith('mine.yaml:5: effects.1.rate')
    assert Scene.model_validate(scene.model_dump()).place('step_size') == 'scene: step_size'


@pytest.mark.parametrize('content', [
    b'', b'\xff\xfe', b'- 1', b'a: [', b'\x00', b'5', b'#' * 2**21])
def test_scene_file_that_is_no_mapping_is_refused(write, content):
    with pytest.raises(SceneError, match=r'mine\.yaml'):
        load_scene(write(content))


@pytest.mark.parametrize('given, says', [
    ('nothing.yaml', 'nothing.yaml: no such file; give the path of a scene, or the name of a '
     'shipped one; `hnn scene --list` lists them'),
    ('mine.yml', 'mine.yml: no such file; did you mean mine.yaml?; give the path'),
    ('mime.yaml', 'mime.yaml: no such file; did you mean mine.yaml?; give the path'),
    ('doube_pendulum.yaml', 'no such file; did you mean double_pendulum?; give the path'),
    # A suffix that all have is no likeness.
    ('nope.yaml', 'nope.yaml: no such file; give the path'),
    ('none/mine.yaml', 'none/mine.yaml: no such file; '),
    ('\0.yaml', 'no such file; '),
    ('folder', 'folder: is a folder; give the path of a scene (.yaml)'),
    ('folder/', 'folder/: is a folder; give the path of a scene (.yaml)'),
    ('bare', "no scene 'bare'; for the file bare give ./bare; shipped: ")])
def test_scene_that_is_not_there_is_told_with_what_there_is(tmp_path, monkeypatch, given, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'folder').mkdir()
    for name in ('mine.yaml', 'bare'):
        (tmp_path / name).write_text('')
    with pytest.raises(SceneError) as caught:
        load_scene(given)
    assert says in str(caught.value)


@pytest.mark.parametrize('old, new, error, expected', [
    ('step_size', 'mechanism: double_pendulum\nstep_size', SceneError,
     'draws 2 coordinates, but H has 1'),
    ('step_size', 'mechanism: turning_body\nstep_size', SceneError,
     'turning_body draws a body that turns, but H has x'),
    ('mass: 2.0', 'mass: -1.0', SceneError,
     'mine.yaml:1: hamiltonian.mass: harmonic_oscillator: mass = -1.0 must be a positive'),
    ('q: [1.0]', 'q: [1.0, 2.0]', SceneError,
     'mine.yaml:5: initial_state.q: 2 values, expected 1, .*: x'),
    ('{kind: harmonic_oscillator, mass: 2.0}', '{kind: hnn, model: nothing}', ModelError,
     'shipped: .*harmonic_oscillator'),
    ('{kind: harmonic_oscillator, mass: 2.0}', '{kind: hnn, model: ./nothing.safetensors}',
     ModelError, 'nothing.safetensors'),
    ('{kind: harmonic_oscillator, mass: 2.0}', "{kind: python, factory: 'no_such:thing'}",
     SceneError, 'No module named'),
    ('{kind: harmonic_oscillator, mass: 2.0}', "{kind: python, factory: 'os:getcwd'}",
     SceneError, 'returned a str, expected a Hamiltonian'),
])
def test_scene_that_cannot_be_built_says_why(write, old, new, error, expected):
    scene = load_scene(write(GOOD.replace(old, new, 1)))
    with pytest.raises(error, match=expected) as caught:
        build(scene)
    assert '\n' not in str(caught.value)


def test_mechanism_of_scalar_coordinates_draws_no_body_that_turns(write):
    scene = load_scene(write("""\
hamiltonian: {kind: heavy_top}
integrator: {kind: lie_leapfrog}
step_size: 0.01
initial_state: {q: [0, 0, 0, 1], p: [0, 0, 1]}
mechanism: pendulum
"""))
    with pytest.raises(SceneError, match='pendulum draws scalar coordinates, but H has attitude'):
        build(scene)


def test_scene_python_factory_gives_a_hamiltonian(write):
    scene = load_scene(write(GOOD.replace(
        '{kind: harmonic_oscillator, mass: 2.0}',
        "{kind: python, factory: 'hnn_vi_ros.hamiltonians.tao:Tao'}")))
    assert type(scene.create_hamiltonian()).__name__ == 'Tao'


def test_model_path_is_found_beside_its_scene(write, tmp_path):
    (tmp_path / 'm.safetensors').write_bytes(
        shipped_file('model', 'harmonic_oscillator').read_bytes())
    scene = load_scene(write(GOOD.replace(
        '{kind: harmonic_oscillator, mass: 2.0}', '{kind: hnn, model: m.safetensors}')))
    assert scene.create_hamiltonian().dimension == 1


FUZZ = settings(max_examples=150,
                suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


def load_and_build(path: Path) -> None:
    """Accept a scene that works and a typed error of one line; nothing else."""
    try:
        scene = load_scene(path)
        scene.create_hamiltonian()
        scene.create_effects()
    except HnnViRosError as problem:
        assert '\n' not in str(problem)


@FUZZ
@given(content=strategies.binary(max_size=300))
def test_scene_of_random_bytes_gives_a_typed_error(write, content):
    with pytest.raises(SceneError):
        load_scene(write(content))


@FUZZ
@given(good=strategies.sampled_from([GOOD, ACTED_ON]),
       position=strategies.integers(0, len(ACTED_ON)), removed=strategies.integers(0, 20),
       inserted=strategies.one_of(
           strategies.text(max_size=10), strategies.floats().map(str),
           strategies.sampled_from(['{', '[', '*a', '&a', '!!float', '? ', '- ', '1e999', '~'])))
def test_scene_mutated_gives_a_typed_error_or_works(
        write, good, position, removed, inserted):
    mutated = good[:position] + inserted + good[position + removed:]
    load_and_build(write(mutated.encode('utf-8', 'surrogatepass')))
