# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Torch modules of users, trained by ``hnn train --module`` and by ``train``, then exported."""

from pathlib import Path
import sys
import types

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.errors import HnnViRosError, Interrupted
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.learning import evaluate, read_motions, source_of
from hnn_vi_ros.learning.fit.loop import TrainingCheckpoint, TrainingRun
from hnn_vi_ros.learning.train import main, train
from hnn_vi_ros.models import load_checkpoint, load_learned
from hnn_vi_ros.phase_space import Coordinate
from messages import refused
import numpy as np
import pytest
import torch

# Modules as users write them, in float32 and without knowledge of this package.
CODE = """\
import torch


class HNN(torch.nn.Module):
    def __init__(self, width=16):
        super().__init__()
        self.first, self.last = torch.nn.Linear(2, width), torch.nn.Linear(width, 1, bias=False)

    def forward(self, x):
        return self.last(torch.tanh(self.first(x)))


class Separable(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.kinetic, self.potential = (torch.nn.Sequential(
            torch.nn.Linear(1, 12), torch.nn.Tanh(), torch.nn.Linear(12, 1)) for _ in range(2))

    def forward(self, q, p):
        return self.kinetic(p) + self.potential(q)


class Wrong(HNN):
    def forward(self, x):
        return WRONG


def three(module, states, predicted, target):
    return 3.0 * (predicted - target).square().mean()


def vector(module, states, predicted, target):
    return (predicted - target).square()


def a_number(module, states, predicted, target):
    return 1.0


def detached(module, states, predicted, target):
    return (predicted - target).detach().square().mean()


def failing(module, states, predicted, target):
    return predicted - target[:, 0]


def frozen():
    return HNN().requires_grad_(False)


def scripted():
    return torch.jit.script(HNN())


def other():
    return [HNN()]


def wide():
    net = HNN()
    net.first = torch.nn.Linear(4, 16)
    return net


def several(argument):
    return HNN()


number = 3.0
"""
# An oscillator of period pi, with amplitudes of 0.5 to 1.5.
T = 0.05 * np.arange(60)
AMPLITUDES = 0.5, 0.9, 1.2, 1.5
CONFIG = {
    'coordinates': [{'name': 'x', 'q_unit': 'm', 'p_unit': 'm/s'}], 'adam_steps': 40,
    'lbfgs_steps': 40, 'data': {'kind': 'log', 'path': 'log.csv', 'trial': 'run', 'time': 't',
                                'q': ['x [m]'], 'v': ['v [m/s]']}}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    """Write a log, a configuration and code; return their folder, in which the test runs."""
    rows = [f'{k},{t},{a * np.cos(2.0 * t)},{-2.0 * a * np.sin(2.0 * t)}'
            for k, a in enumerate(AMPLITUDES) for t in T]
    (tmp_path / 'log.csv').write_text('run,t,x [m],v [m/s]\n' + '\n'.join(rows) + '\n')
    (tmp_path / 'log.yaml').write_text(dump_yaml(CONFIG))
    (tmp_path / 'net.py').write_text(CODE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, 'net', raising=False)
    return tmp_path


def module(name: str = 'HNN') -> torch.nn.Module:
    names: dict[str, type] = {}
    exec(CODE, names)
    torch.manual_seed(1)
    return names[name]()


def field_error(model) -> float:
    """Return the RMS error of (H_p, -H_q) in the annulus of the data, relative to the field."""
    angle, size = np.random.default_rng(0).uniform([[0.0], [0.6]], [[2 * np.pi], [1.4]], (2, 200))
    q, p = (size * np.cos(angle))[:, None], (2.0 * size * np.sin(angle))[:, None]
    exact = np.hstack([4.0 * q, p])
    errors = np.hstack(model.gradient(q, p)) - exact
    return float(np.sqrt(np.mean(errors**2) / np.mean(exact**2)))


# The filter of velocities and accelerations at 40 Hz, twice the rate of the samples, is left out,
# so accelerations are differences, which err by (omega h)^2 / 6 = 0.2 %. What 16 units learn in
# 150 steps of each kind errs by less than 2 %.
@pytest.mark.parametrize('name', ['HNN', 'Separable'])
def test_module_is_trained_from_a_log_and_exported(folder: Path, name: str):
    own = module(name)
    before = {key: value.clone() for key, value in own.state_dict().items()}
    seen = []
    model = train(own, 'log.csv', 'm.safetensors', adam_steps=150, lbfgs_steps=150,
                  callbacks=[seen.append])
    assert field_error(model) <= 0.02
    assert model.separable == (name == 'Separable')
    assert all(torch.equal(value, before[key]) for key, value in own.state_dict().items())
    card = load_checkpoint(Path('m.safetensors')).card
    assert (card.family, card.coordinates[0].name, card.coordinates[0].p_unit) == (
        'graph', 'x', 'm/s')
    assert card.losses['validation_loss'] <= 1e-3
    # H of the file is that of the trained module, and 0 in the centre of the box.
    last, z = seen[-1].module, np.random.default_rng(1).uniform(-1.0, 1.0, (5, 2))
    expected = last.energy(torch.tensor(z)).detach().numpy()
    found = model.energy(z[:, :1], z[:, 1:])
    assert np.abs(np.diff(found - expected)).max() <= 1e-12 * np.abs(expected).max()
    Path('s.yaml').write_text(dump_yaml({
        'hamiltonian': {'kind': 'learned', 'model': 'm.safetensors'}, 'step_size': 0.05,
        'integrator': 'implicit_midpoint', 'initial_state': {'q': [1.0], 'p': [0.0]}}))
    # Within half a period; the frequency errs by half of the error of the field.
    assert simulate(load_scene('s.yaml'), duration=1.5).q[-1, 0] == pytest.approx(
        np.cos(3.0), abs=0.05)


def test_module_of_the_command_line_is_the_same_for_the_same_seed(folder: Path):
    for name, seed in (('a', '1'), ('b', '1'), ('c', '2')):
        main(['--module', 'net.py:HNN', '--config', 'log.yaml', '--out', f'{name}.safetensors',
              '--seed', seed])
    losses = [load_checkpoint(Path(f'{name}.safetensors')).card.losses for name in 'abc']
    assert losses[0] == losses[1] != losses[2]
    assert '--module net.py:HNN' in load_checkpoint(Path('a.safetensors')).card.training_command


def test_module_is_trained_by_the_command_line_from_a_log_alone(folder: Path, capsys):
    rows = Path('log.csv').read_text().splitlines()[:61]
    Path('log.csv').write_text('\n'.join(rows) + '\n')
    main(['--module', 'net.py:Separable', '--data', 'log.csv', '--out', 'm.safetensors'])
    assert load_learned(Path('m.safetensors')).separable
    # The printed configuration is one for --config.
    text = capsys.readouterr().out.split('\n\n')[1]
    Path('printed.yaml').write_text(text + '\nadam_steps: 5\nlbfgs_steps: 0\n')
    main(['--module', 'net.py:HNN', '--config', 'printed.yaml', '--out', 'n.safetensors'])


def test_training_names_the_scene_of_its_model_and_motions_that_lose_energy(folder: Path, capsys):
    config = ['--module', 'net.py:HNN', '--config', 'log.yaml', '--out']
    main([*config, 'free.safetensors'])
    told = capsys.readouterr().out
    assert 'next: hnn run free.scene.yaml --plot free.scene.png' in told
    assert 'H(q, p) conserves energy' not in told
    run = simulate(load_scene('free.scene.yaml'), 0.5)
    assert run.scene.step_size == 0.05
    # The first measured state, of which L_v for unit mass is the velocity, 0.
    assert np.array_equal(run.q[0], [AMPLITUDES[0]])
    rows = [f'0,{t},{a * np.exp(-0.5 * t) * np.cos(2.0 * t)},'
            f'{a * np.exp(-0.5 * t) * (-2.0 * np.sin(2.0 * t) - 0.5 * np.cos(2.0 * t))}'
            for a in AMPLITUDES[-1:] for t in T]
    Path('log.csv').write_text('run,t,x [m],v [m/s]\n' + '\n'.join(rows) + '\n')
    main([*config, 'damped.safetensors'])
    assert 'W on average, but H(q, p) conserves energy' in capsys.readouterr().out


def test_module_is_trained_through_steps_of_an_integrator(folder: Path):
    model = train(module('Separable'), 'log.csv', 'm.safetensors', adam_steps=200, lbfgs_steps=60,
                  windows={'integrator': 'implicit_midpoint', 'step_size': 0.05, 'count': 3})
    assert model.checkpoint.card.scheme.integrator == 'implicit_midpoint'
    assert field_error(model) <= 0.05


def test_motions_in_memory_train_the_same_model_as_their_file(folder: Path):
    motions, _ = read_motions(Path(), source_of('log.csv'), ['x'], ['log.csv'], ['m'])
    found = [train(module(), data, f'{k}.safetensors', adam_steps=20, lbfgs_steps=20,
                   coordinates=[Coordinate('x', 'm', 'm/s')])
             for k, data in enumerate((motions, 'log.csv'))]
    assert found[0].checkpoint.card.losses == found[1].checkpoint.card.losses
    assert found[0].checkpoint.card.coordinates == found[1].checkpoint.card.coordinates


def losses_of(path: str) -> np.ndarray:
    return np.genfromtxt(path, delimiter=',', names=True)


def test_own_loss_is_minimised_and_losses_are_written_as_a_table(folder: Path):
    for name, more in (('a', []), ('b', ['--loss', 'net.py:three'])):
        main(['--module', 'net.py:HNN', *more, '--config', 'log.yaml', '--out',
              f'{name}.safetensors'])
    one, three = losses_of('a.loss.csv'), losses_of('b.loss.csv')
    # A product with 3 in place of one with 1, rounded once.
    assert three['training'][0] == pytest.approx(3.0 * one['training'][0], rel=1e-12)
    assert three['validation'][0] == pytest.approx(3.0 * one['validation'][0], rel=1e-12)
    # Each step of Adam and the first of L-BFGS, then every 20th.
    assert one['step'].tolist() == [*range(41), 60, 80]
    # The card has the mean square for every loss, so that models can be compared.
    assert load_checkpoint(Path('b.safetensors')).card.losses['train_loss'] == pytest.approx(
        three['training'][-1] / 3.0, rel=1e-9)


def test_callbacks_see_each_epoch_and_end_a_stage(folder: Path):
    seen = []

    def each(epoch):
        seen.append((epoch.stage, epoch.step, epoch.held_out is not None))
        return epoch.stage == 'Adam' and epoch.step == 25
    train(module(), 'log.csv', 'm.safetensors', adam_steps=40, lbfgs_steps=20, callbacks=[each])
    assert seen[:26] == [('Adam', k, k % 20 == 0) for k in range(26)]
    assert [stage for stage, *_ in seen[26:]] == ['L-BFGS', 'L-BFGS']


def test_tensorboard_gets_the_losses_if_it_is_installed(folder: Path, monkeypatch):
    class Writer:
        scalars: list[tuple[str, float, int]] = []
        closed = False

        def __init__(self, folder: str):
            assert folder == 'm.tensorboard'

        def __enter__(self):
            return self

        def __exit__(self, *_):
            Writer.closed = True

        def add_scalar(self, *scalar):
            Writer.scalars.append(scalar)
    fake = types.ModuleType('torch.utils.tensorboard')
    fake.SummaryWriter = Writer
    monkeypatch.setitem(sys.modules, 'torch.utils.tensorboard', fake)
    train(module(), 'log.csv', 'm.safetensors', adam_steps=3, lbfgs_steps=0)
    table = losses_of('m.loss.csv')
    for name in ('training', 'validation'):
        found = {step: value for of, value, step in Writer.scalars if of == f'loss/{name}'}
        assert found == {row['step']: row[name] for row in table if not np.isnan(row[name])}
    assert Writer.closed


def test_interrupted_training_of_a_module_resumes_to_the_same_bits(folder: Path, monkeypatch):
    words = ['--module', 'net.py:HNN', '--loss', 'net.py:three', '--config', 'log.yaml', '--out']
    main([*words, 'whole.safetensors'])
    save = TrainingCheckpoint.__call__

    def pause(keeper: TrainingCheckpoint, run: TrainingRun) -> None:
        keeper._stopping = run.step >= 20
        save(keeper, run)
    with monkeypatch.context() as context:
        context.setattr(TrainingCheckpoint, '__call__', pause)
        with pytest.raises(Interrupted):
            main([*words, 'm.safetensors'])
    # Another code is another training.
    Path('net.py').write_text(f'{CODE}\n# changed\n')
    with refused(HnnViRosError):
        main([*words, 'm.safetensors', '--resume'])
    Path('net.py').write_text(CODE)
    main([*words, 'm.safetensors', '--resume'])
    assert Path('m.loss.csv').read_text() == Path('whole.loss.csv').read_text()
    one, other = (load_learned(Path(name)) for name in ('m.safetensors', 'whole.safetensors'))
    z = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 1))
    assert np.array_equal(one.energy(z, -z), other.energy(z, -z))


def test_folds_are_judged_on_runs_that_they_were_not_trained_on(folder: Path, capsys):
    # The last run has three times the frequency: without it, no model knows of that.
    rows = Path('log.csv').read_text().splitlines()[:181]
    rows += [f'3,{t},{1.5 * np.cos(6.0 * t)},{-9.0 * np.sin(6.0 * t)}' for t in T]
    Path('log.csv').write_text('\n'.join(rows) + '\n')
    main(['--module', 'net.py:HNN', '--config', 'log.yaml', '--folds', '4', '--out',
          'm.safetensors'])
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith('fold ')]
    losses = {line.partition('runs ')[2].partition(':')[0]: float(
        line.partition('loss ')[2].partition(',')[0]) for line in lines}
    assert sorted(losses) == ['0', '1', '2', '3']
    assert losses['3'] > 3.0 * max(losses[run] for run in '012')
    card = load_checkpoint(Path('m.safetensors')).card
    # Printed with three digits.
    assert card.losses['folds_loss'] == pytest.approx(np.mean([*losses.values()]), rel=5e-3)
    assert card.losses['folds_deviation'] == pytest.approx(
        np.std([*losses.values()], ddof=1), rel=2e-2)


@pytest.mark.parametrize('words', [
    ['net.py:nothing'], ['net.py:number'], ['net.py:other'], ['net.py:frozen'], ['net.py:wide'],
    ['net.py:several'], ['net.py:scripted'], ['none.py:HNN'], ['net.py'], ['net:HNN'],
    ['net.py:HNN', '--loss', 'net.py:vector'], ['net.py:HNN', '--loss', 'net.py:a_number'],
    ['net.py:HNN', '--loss', 'net.py:detached'], ['net.py:HNN', '--loss', 'net.py:failing'],
    ['net.py:HNN', '--loss', 'net.py:nothing'], ['net.py:HNN', '--ensemble', '3'],
    ['net.py:HNN', '--folds', '1'], ['net.py:HNN', '--folds', '1000']])
def test_module_or_loss_of_no_use_is_refused_in_one_line(folder: Path, words):
    with refused(HnnViRosError):
        main(['--config', 'log.yaml', '--out', 'm.safetensors', '--module', *words])
    assert not Path('m.safetensors').exists()


# Two outputs, one number for all rows, a decision by values, other precision, an unknown function.
@pytest.mark.parametrize('wrong', [
    'x', 'self.first(x).sum()', 'self.last(x.abs().repeat(1, 8)) if x[0, 0] > 0 else x[:, 0]',
    'super().forward(x).float()', 'torch.special.bessel_j0(super().forward(x))',
    'super().forward(x).detach()', 'super().forward(x)\n    def forward(self, x, t): return t'])
def test_module_that_does_not_export_is_refused_before_it_is_trained(
        folder: Path, monkeypatch, wrong: str):
    def run(*_):
        raise AssertionError('the training began')
    monkeypatch.setattr(TrainingRun, 'to_end', run)
    (folder / 'net.py').write_text(CODE.replace('WRONG', wrong))
    with refused(HnnViRosError):
        main(['--config', 'log.yaml', '--out', 'm.safetensors', '--module', 'net.py:Wrong'])


def test_code_of_a_configuration_or_model_is_not_run(folder: Path, monkeypatch):
    (folder / 'net.py').write_text('raise AssertionError("it runs")\n')
    for family in ({'kind': 'graph', 'module': 'net.py:HNN'},
                   {'kind': 'hnn', 'module': 'net.py:HNN'}):
        Path('log.yaml').write_text(dump_yaml(CONFIG | {'family': family}))
        with refused(HnnViRosError):
            main(['--config', 'log.yaml', '--out', 'm.safetensors'])


@pytest.mark.parametrize('config, more', [
    ({'family': {'kind': 'mechanical'}, 'coordinates': [
        {'name': 'x', 'q_unit': 'm', 'kind': 'prismatic'}], 'adam_steps': None,
      'lbfgs_steps': None}, []),
    ({'loss': {'kind': 'discrete_gradient', 'step_size': 0.05}, 'family': {'kind': 'dgnet'}}, []),
    ({}, ['--loss', 'net.py:three'])])
def test_configuration_that_does_not_fit_a_module_is_refused(folder: Path, config, more):
    merged = {key: value for key, value in (CONFIG | config).items() if value is not None}
    Path('log.yaml').write_text(dump_yaml(merged))
    words = more or ['--module', 'net.py:HNN']
    with refused(HnnViRosError):
        main(['--config', 'log.yaml', '--out', 'm.safetensors', *words])


@pytest.mark.parametrize('settings', [
    {'width': 3}, {'windows': {'integrator': 'euler', 'step_size': 0.1}}, {'adam_steps': 0}])
def test_wrong_setting_is_refused(folder: Path, settings):
    with refused(HnnViRosError):
        train(module(), 'log.csv', 'm.safetensors', **settings)


# A family takes the same data; its forces are not left out in silence.
@pytest.mark.parametrize('kind, forces, taken', [
    ('hnn', False, True), ('hnn', True, False), ('control_affine', True, True)])
def test_family_of_states_is_trained_from_the_data_of_machines(
        folder: Path, kind: str, forces: bool, taken: bool):
    t = np.linspace(0.0, 6.0, 120)
    arrays = {'t': t, 'q': np.sin(2.0 * t)[:, None], 'dq': 2.0 * np.cos(2.0 * t)[:, None]}
    np.savez('a.npz', **arrays, **({'tau': np.cos(t)[:, None]} if forces else {}))
    Path('a.yaml').write_text(dump_yaml(
        {key: CONFIG[key] for key in ('coordinates', 'adam_steps', 'lbfgs_steps')} | {
            'hidden': [4], 'family': {'kind': kind}, 'data': {'kind': 'arrays'} | (
                {} if forces else {'tau': None})}))
    words = ['--config', 'a.yaml', '--data', 'a.npz', '--out', 'm.safetensors']
    if taken:
        main(words)
        assert load_checkpoint(Path('m.safetensors')).card.family == kind
        if not forces:
            # Options that do not hold for these data are not left out either.
            np.savez('b.npz', time=t, q=arrays['q'], dq=arrays['dq'])
            words = ['m.safetensors', '--config', 'a.yaml', '--data', 'b.npz']
            evaluate.main([*words, '--keys', 'time,q,dq'])
            with refused(HnnViRosError):
                evaluate.main([*words, '--held-out'])
        return
    with refused(HnnViRosError):
        main(words)


def test_option_of_machines_that_states_do_not_have_is_refused(folder: Path):
    Path('log.yaml').write_text(dump_yaml(CONFIG | {
        'data': CONFIG['data'] | {'test_runs': ['1']}}))
    with refused(HnnViRosError):
        main(['--config', 'log.yaml', '--out', 'm.safetensors'])
