# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""H as a formula: its derivatives, what cannot be read, and that nothing of it is executed."""

import math
import random
import time

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.hamiltonians import Formula, HAMILTONIANS
from hnn_vi_ros.hamiltonians.expressions import DEEPEST, LONGEST
from hnn_vi_ros.hamiltonians.formula import FormulaCoordinate
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import numbers_of, Scene, with_numbers
from hnn_vi_ros.simulation import Simulation
from messages import refused
from mpmath import mp, mpf
import numpy as np
import pytest

KINETIC = '(p_x^2 + p_y^2) / (2*m)'
TREE = """\
hamiltonian:
  kind: formula
  coordinates: [x, y]
  parameters: {k: 1.5}
  H: "(p_x^2 + p_y^2)/2 + k*(x^2 + y^2)/2 + x^2*y - y^3/3"
integrator: {kind: gauss8}
step_size: 0.1
initial_state: {q: [0.1, 0.2], p: [0.3, 0.1]}
"""


def random_formula(chance: random.Random, depth: int) -> str:
    """Return a formula that is smooth wherever its names are real numbers."""
    if depth == 0:
        return chance.choice(['x', 'y', 'p_x', 'p_y', 'a', 'b', 'x', 'y', '2', '0.7', 'pi'])
    u, w = (random_formula(chance, depth - 1) for _ in range(2))
    return chance.choice([
        f'({u} + {w})', f'({u} - {w})', f'{u}*{w}', f'-({u})', f'({u})^2', f'({u})**3',
        f'{u}/(2 + ({w})^2)', f'sin({u})', f'cos({u})', f'tan(tanh({u}))', f'tanh({u})',
        f'exp(sin({u}))', f'log(2 + ({u})^2)', f'sqrt(1 + ({u})^2)', f'sinh(tanh({u}))',
        f'cosh(atan({u}))', f'asin(tanh({u})/2)', f'acos(sin({u})/2)', f'(1 + ({u})^2)^-1.5',
        f'(2 + sin({u}))^cos({w})', f'(3 + cos({u}))^0.3', f'({u})*(1 - cos({w}))',
        f'abs(2 + sin({u}))', f'log1p(({u})^2)', f'expm1(sin({u}))', f'asinh({u})',
        f'cbrt(2 + sin({u}))', f'atanh(tanh({u})/2)', f'acosh(2 + ({u})^2)', f'max({u}, {w}, 0.4)',
        f'min({u}, {w})', f'atan2(2 + sin({u}), {w})', f'sign({u})*({w})',
        f'piecewise({u} < 0.2, {w}, {w} >= {u}, {u}, sin({w}))'])


MP = {name: getattr(mp, name) for name in (
    'sin', 'cos', 'tan', 'tanh', 'exp', 'log', 'sqrt', 'sinh', 'cosh', 'atan', 'asin', 'acos',
    'log1p', 'expm1', 'asinh', 'cbrt', 'atanh', 'acosh', 'atan2', 'sign')}


def piecewise(condition, value, *others):
    """Return the first value whose condition holds."""
    return value if condition else piecewise(*others) if others[1:] else others[0]


MP |= {'max': max, 'min': min, 'piecewise': piecewise}


@pytest.mark.parametrize('number', [100, pytest.param(1000, marks=pytest.mark.long)])
def test_derivatives_of_random_formulas_are_those_of_mpmath(number):
    chance = random.Random(7)
    names, tried = ('x', 'y', 'p_x', 'p_y'), 0
    with mp.workdps(60):
        while tried < number:
            text = f'(p_x^2 + p_y^2)/2 + a*b + {random_formula(chance, 3)}'
            z, v = ([chance.uniform(0.3, 1.0) for _ in names] for _ in range(2))
            parameters = {'a': chance.uniform(0.5, 2.0), 'b': chance.uniform(0.5, 2.0)}
            code = compile(text.replace('^', '**').replace('abs(', 'fabs('), 'formula', 'eval')
            known = {**MP, 'pi': mp.pi, 'fabs': abs, **{n: mpf(x) for n, x in parameters.items()}}

            def energy(state, code=code, known=known):
                return eval(code, {**known, **dict(zip(names, state, strict=True))})

            def moved(i, step, along=0, z=z, v=v):
                return energy([mpf(x) + (step if j == i else 0) + along * mpf(w)
                               for j, (x, w) in enumerate(zip(z, v, strict=True))])
            # Central differences, whose error is 1e-30 of derivatives of order three and five.
            h = mpf('1e-15')
            slopes = [(moved(i, h) - moved(i, -h)) / (2 * h) for i in range(4)]
            products = [(moved(i, h, h) - moved(i, h, -h) - moved(i, -h, h) + moved(i, -h, -h))
                        / (4 * h * h) for i in range(4)]
            kernel = Formula(['x', 'y'], text, parameters).kernel
            out = np.empty((2, 4))
            arrays = np.array(z[:2]), np.array(z[2:])
            kernel.gradient.py_func(kernel.parameters, *arrays, out[0, :2], out[0, 2:])
            kernel.hessian_vector.py_func(kernel.parameters, *arrays, np.array(v[:2]),
                                          np.array(v[2:]), out[1, :2], out[1, 2:])
            value = kernel.energy.py_func(kernel.parameters, *arrays)
            scale = 1.0 + max(map(abs, (energy(z), *slopes, *products)))
            for found, expected in zip([value, *out.ravel()], [energy(z), *slopes, *products],
                                       strict=True):
                assert abs(found - expected) < 1e-13 * scale, text
            tried += 1


HOSTILE = [
    '__import__("os").system("true")', 'x.__class__', 'lambda: 0', 'x[0]', '[x]', 'x if x else y',
    'open(x)', 'x;y', "'x'", 'x\n+y @ 2', 'print(x)', 'x = 2', 'exec(x)', 'x**', '2x', 'x y',
    '(x', 'x)', '', '   ', '+', '1e999', 'log(-1)', '0^-1', 'x/0', 'x/(1-1)', 'nan', 'inf', '1_0',
    'sin', 'sin()', 'sin(x, y)', 'SIN(x)', '\u0661', 'x\u2212y', 'x \u00d7 y', '\x00', 'x#y',
    '\U0001f600', 'p_z', 'xx', '9**9**9**9', '(' * 5000, '-' * 5000 + 'x', 'x^' * 100 + 'x',
    'sin(' * 200 + 'x' + ')' * 200, 'x+' * 3000 + 'x']


def test_500_hostile_texts_are_one_line_each_within_a_second_and_nothing_is_executed():
    chance = random.Random(3)
    texts = list(HOSTILE)
    signs = 'xyp_ab01.e+-*/^()sincolgt \t"\'\\[]{}@!%&|<>=,;:\n\u00e9'
    while len(texts) < 500:
        text = ''.join(chance.choices(signs, k=chance.randrange(1, 60)))
        texts.append(text)
    for text in texts:
        begin = time.process_time()
        try:
            Formula(['x', 'y'], text)
        except ValueError as problem:
            assert '\n' not in str(problem) and len(str(problem)) < 400, text
            # Where it is, unless it is all of it.
            assert any(said in str(problem) for said in (
                ' column ', ' characters, expected', 'H does not depend on')), text
        else:
            pytest.fail(f'{text!r} was taken')
        assert time.process_time() - begin < 1.0, text


@pytest.mark.parametrize('text', [
    KINETIC + ' + k*x*y', KINETIC + ' + p_xx*y', 'p_x^2 + p_x*m', KINETIC + ' + 2x',
    KINETIC + ' + sen(x)', KINETIC + ' + x(1 + x)', KINETIC + ' + (x', KINETIC + ' + log(1 - 2)',
    KINETIC + ' + x/(m - m)', KINETIC.replace('m', '1'), KINETIC + ' + x*cos(2*time)',
    KINETIC + ' + max(x)*m', KINETIC + ' + piecewise(x > 0, y)*m', KINETIC + ' + atan2(x)*m',
    '(' * (DEEPEST + 1) + 'x', KINETIC + ' + x²', KINETIC + ' + ½*x', KINETIC + ' + x₁',
    KINETIC + ' + ٣*x', KINETIC + ' + m*E',
    'x +' * LONGEST])
def test_error_names_the_column_and_what_is_expected(text):
    with refused(ValueError):
        Formula(['x', 'y'], text, {'m': 2.0})


def test_greek_pi_is_pi():
    found = Formula(['θ'], 'p_θ^2/(2*µ) + π*θ', {'µ': 1.0}).kernel
    assert found.energy.py_func(found.parameters, np.ones(1), np.zeros(1)) == math.pi


def test_branch_without_a_value_spoils_no_slope_of_the_other():
    kernel = Formula(['x'], 'p_x^2/2 + piecewise(x > 0, x*sqrt(x), 0)').kernel
    out = np.empty((2, 1))
    with np.errstate(all='ignore'):
        kernel.gradient.py_func((), np.array([-1.0]), np.ones(1), *out)
    assert out.tolist() == [[0.0], [1.0]]


@pytest.mark.parametrize('names, parameters', [
    (['x', 'x'], {}), (['x', 'p_x'], {}), (['sin'], {}), ([], {}), (['x y'], {}), (['x\n'], {}),
    (['x'], {'p_x': 1.0}), (['x'], {'m': math.inf})])
def test_names_that_cannot_be_used_are_refused(names, parameters):
    with refused(ValueError):
        Formula(names, 'p_x^2', parameters)


def test_height_of_a_small_swing_keeps_its_digits():
    hamiltonian = Formula(['q'], 'p^2/2 + 3*(1 - cos(q)) + (cos(2*q) - 1)/4', {})
    found = hamiltonian.kernel.energy.py_func((), np.array([1e-9]), np.zeros(1))
    # 3 q^2 / 2 - q^2 / 2, to a few roundings.
    assert abs(found - 1e-18) < 8 * 2.0**-53 * 1e-18


def test_derivatives_that_outgrow_memory_are_refused():
    wide = '*'.join(f'atan(x^{i}+y)' for i in range(2, 280))
    with refused(ValueError):
        Formula(['x', 'y'], f'p_x^2 + p_y^2 + {wide}').kernel  # noqa: B018


def test_scene_of_a_formula_runs_and_its_numbers_have_names(tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text(TREE)
    scene = load_scene(file)
    assert numbers_of(scene) == {'hamiltonian.parameters.k': 1.5}
    trajectory = simulate(scene, 10.0)
    assert np.ptp(trajectory.energy) < 1e-8
    other = simulate(with_numbers(scene, {'hamiltonian.parameters.k': 2.0}), 10.0)
    assert abs(other.energy[0] - trajectory.energy[0] - 0.25 * (0.1**2 + 0.2**2)) < 1e-16


def test_scene_says_where_its_formula_has_no_value(tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text(TREE.replace('- y^3/3', '- 1/(x - 0.1)'))
    with refused(SceneError):
        load_scene(file).create_hamiltonian()


def test_units_and_angles_come_from_the_coordinates():
    hamiltonian = Formula([{'name': 'a', 'q_unit': 'rad', 'p_unit': 'N m s'}], 'p_a^2/2 - cos(a)')
    assert hamiltonian.coordinates[0].q_unit == 'rad'
    with pytest.raises(ValueError, match='deg: angles must be in rad'):
        FormulaCoordinate(name='a', q_unit='deg')
    with refused(ValueError):
        Formula([{'name': 'a', 'q_unit': r'$\frac{a$'}], 'p_a^2/2 + a^2')
    with pytest.raises(ValueError, match='unit'):
        Formula([{'name': 'a', 'unit': 'rad'}], 'p_a^2/2')


@pytest.mark.parametrize('integrator', ['gauss8', 'stormer_verlet'])
def test_potential_of_a_formula_is_the_part_of_h_that_it_says(integrator):
    alone = Formula(['x', 'y'], f'{KINETIC} + k*(x - y)^2/2 + cos(x*y)', {'m': 2.0, 'k': 3.0})
    free = HAMILTONIANS['free_particle'](2.0, ['x', 'y'])
    effect = EFFECTS['potential']('k*(x - y)^2/2 + cos(x*y)', {'k': 3.0})
    one, two = (Simulation(h, INTEGRATORS[integrator](), 0.01, [0.3, 0.5], [0.1, 0.2], effects)
                for h, effects in ((alone, []), (free, [effect])))
    for simulation in (one, two):
        simulation.advance(200)
    # 200 steps of some ten roundings.
    assert np.abs(np.append(one.q - two.q, one.p - two.p)).max() < 2000 * 2.0**-53
    assert abs(one.energy - two.energy) < 2000 * 2.0**-53


@pytest.mark.parametrize('formula, parameters', [
    ('k*z', {'k': 1.0}), ('k', {'k': 1.0}), ('x', {'x': 1.0}), ('p_x*x', {})])
def test_potential_that_fits_no_system_is_refused(formula, parameters):
    with refused(ValueError):
        Simulation(HAMILTONIANS['free_particle'](), INTEGRATORS['gauss8'](), 0.1, [1.0], [0.0],
                   [EFFECTS['potential'](formula, parameters)])


def test_formula_needs_no_trust_in_code():
    """A description that comes from a topic or a bag may hold one."""
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x'], 'H': 'p_x^2/2 + x^4/4'},
        integrator='gauss8', step_size=0.1, initial_state=([1.0], [0.0]))
    again = Scene.model_validate(scene.model_dump())
    assert again.create_hamiltonian().energy(np.array([1.0]), np.array([0.0])) == 0.25


@pytest.mark.parametrize('exponent', ['1.3', '1.5', '2.3', '2.5'])
def test_slope_of_a_power_at_zero_is_its_limit(exponent):
    H = Formula(['x'], f'p_x^2 / 2 + x^{exponent}')
    assert H.gradient(np.zeros(1), np.zeros(1))[0] == 0.0


def test_contact_with_the_force_of_hertz_opens_and_closes():
    """The motion is one of constant speed while it is open, by which it returns with -p."""
    run = simulate(Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x'],
                     'H': 'p_x^2 / 2 + ((abs(x) + x) / 2)^2.5'},
        integrator='gauss8', step_size=0.005, initial_state=([-0.5], [1.0])), 4.0)
    assert run.p[-1, 0] == pytest.approx(-1.0, rel=1e-6) and run.q[-1, 0] < 0.0


@pytest.mark.parametrize('V, smooth', [
    ('abs(x)', False), ('abs(x)^3', True), ('((abs(x) + x) / 2)^2.5', True), ('x^4', True),
    ('max(x, 0)', False), ('max(x, 0)^2', True), ('sqrt(x^2)', False), ('abs(2 + sin(x))', True),
    ('piecewise(x > 0, x^3, 0)', True), ('piecewise(x > 0, 1, 0)', False), ('sign(x)*x^2', True),
    ('acos(cos(x))', False), ('asin(sin(x))', False), ('acos(cos(x) / 2)', True),
    ('atan2(x, p_x)', False), ('atan2(x, 1 + p_x^2)', True), ('cos(atan2(x, p_x))', True)])
def test_formula_is_smooth_if_its_gradient_is_continuous(V, smooth):
    assert Formula(['x'], f'p_x^2 / 2 + {V}').smooth == smooth
