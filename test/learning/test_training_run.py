# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training runs: stopped and gone on with, ended early, judged, reported, on other devices."""

import math
from pathlib import Path
import signal

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.fit.config import FieldConfig, load_config
from hnn_vi_ros.learning.fit.loop import (
    Fit, Interrupted, INTERVAL, Keeper, LossHistory, Problem, Stage)
from hnn_vi_ros.learning.tasks.field import FieldProblem
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.models.neural import NeuralHamiltonian
import numpy as np
import pytest
import torch

TINY = """
coordinates: [{name: x, q_unit: m, p_unit: kg m/s}]
data:
  kind: exact
  hamiltonian: {kind: pendulum}
  box: {q: [[-2.0, 2.0]], p: [[-4.0, 4.0]]}
  samples: 60
  noise: 0.0
hidden: [8, 5]
adam_steps: 60
lbfgs_steps: 80
"""


def tiny(folder: Path, text: str = TINY) -> Path:
    path = folder / 'tiny.yaml'
    path.write_text(text)
    return path


def prepared(path: Path) -> tuple[FieldConfig, Dataset]:
    config = load_config(path)
    return config, make_dataset(config.data, config.seed, path)


def keeper_of(path: Path, config: FieldConfig, dataset: Dataset) -> Keeper:
    arrays = [part for part in vars(dataset).values() if isinstance(part, np.ndarray)]
    return Keeper(path, config, arrays, 'cpu')


def trained(problem: FieldProblem) -> LossHistory:
    fit = Fit(problem)
    fit.run()
    return fit.history


def weights_of(problem: FieldProblem) -> bytes:
    return b''.join(part.detach().numpy().tobytes() for part in problem.module.parameters())


# In the first steps of Adam and of L-BFGS, and when L-BFGS has a history.
@pytest.mark.parametrize('stop', [0, INTERVAL, 60, 60 + 2 * INTERVAL])
@pytest.mark.parametrize('patience', ['', 'patience: 3\n'])
def test_training_resumed_from_its_file_is_bit_identical(tmp_path, stop, patience):
    config, dataset = prepared(tiny(tmp_path, TINY + patience))
    whole = FieldProblem(config, dataset)
    history = trained(whole)
    keeper = keeper_of(tmp_path / 'm.training', config, dataset)

    def pause(fit: Fit) -> None:
        if fit.step == stop:
            keeper._stopping = True
        keeper(fit)

    with pytest.raises(Interrupted, match=f'stopped at step {stop}, .*--resume'):
        Fit(FieldProblem(config, dataset)).run(pause)
    resumed = FieldProblem(config, dataset)
    fit = Fit(resumed)
    keeper_of(tmp_path / 'm.training', config, dataset).load(fit)
    assert fit.step == stop
    fit.run()
    assert fit.history == history
    assert weights_of(resumed) == weights_of(whole)


def test_ctrl_c_keeps_the_run_and_resume_ends_it_as_if_nothing_had_been(
        tmp_path, monkeypatch, capsys):
    arguments = ['--config', str(tiny(tmp_path)), '--out']
    main([*arguments, str(tmp_path / 'whole.safetensors')])
    look, looks = FieldProblem.validation_loss, []

    def interrupted(problem: FieldProblem) -> float:
        looks.append(problem)
        if len(looks) == 5:
            signal.raise_signal(signal.SIGINT)
        return look(problem)

    out = str(tmp_path / 'm.safetensors')
    with monkeypatch.context() as context:
        context.setattr(FieldProblem, 'validation_loss', interrupted)
        with pytest.raises(Interrupted, match='stopped at step .*m.training.*--resume'):
            main([*arguments, out])
    assert not (tmp_path / 'm.safetensors').exists()
    with pytest.raises(ParameterError, match='m.training is a run that was interrupted'):
        main([*arguments, out])
    main([*arguments, out, '--resume'])
    assert not (tmp_path / 'm.training').exists()
    one, other = (load_checkpoint(tmp_path / f'{name}.safetensors') for name in ('whole', 'm'))
    for a, b in zip(*(sum(part.networks['energy'], ()) for part in (one, other)), strict=True):
        assert np.array_equal(a, b)
    assert '--resume' not in other.card.training_command


def test_resume_refuses_what_it_cannot_go_on_with_in_one_line(tmp_path):
    path = tiny(tmp_path)
    arguments = ['--config', str(path), '--out', str(tmp_path / 'm.safetensors'), '--resume']
    with pytest.raises(ParameterError, match='no interrupted run at .*m.training'):
        main(arguments)
    (tmp_path / 'm.training').write_bytes(b'PK\x03\x04 no archive')
    with pytest.raises(ParameterError, match='m.training cannot be read; remove it'):
        main(arguments)
    config, dataset = prepared(path)
    keeper = keeper_of(tmp_path / 'm.training', config, dataset)
    keeper._stopping = True
    with pytest.raises(Interrupted):
        keeper(Fit(FieldProblem(config, dataset)))
    with pytest.raises(ParameterError, match='of another configuration, other data'):
        main([*arguments, '--seed', '7'])


def test_early_stopping_ends_with_the_weights_of_the_least_validation_loss(tmp_path):
    # Far more weights than data, whose noise a long training would learn.
    text = TINY.replace('noise: 0.0', 'noise: 0.3').replace('[8, 5]', '[40]').replace(
        'lbfgs_steps: 80', 'lbfgs_steps: 800')
    config, dataset = prepared(tiny(tmp_path, text + 'patience: 3\n'))
    problem = FieldProblem(config, dataset)
    history = trained(problem)
    assert history.train_step[-1] < 860
    assert problem.validation_loss() == min(history.validation)
    assert history.validation[history.validation_step.index(history.best_step)] \
        == min(history.validation)
    config, _ = prepared(tiny(tmp_path, text))
    through = FieldProblem(config, dataset)
    trained(through)
    assert problem.validation_loss() < through.validation_loss()


def test_run_leaves_a_report_with_pictures_and_curves_beside_its_model(tmp_path):
    main(['--config', str(tiny(tmp_path)), '--out', str(tmp_path / 'm.safetensors')])
    for name in ('m.loss.png', 'm.field.png'):
        assert (tmp_path / name).read_bytes().startswith(b'\x89PNG')
    assert (tmp_path / 'm.loss.rrd').read_bytes().startswith(b'RRF')
    page, card = (tmp_path / 'm.report.md').read_text(), load_checkpoint(
        tmp_path / 'm.safetensors').card
    for words in ('# m\n', '| seed | 0 |', 'm.loss.png', 'm.field.png', 'hidden:', 's on cpu',
                  f'| validation_loss | {card.losses["validation_loss"]:.4g} |',
                  f'{card.energy_error.rms:.3g} (95 %: '):
        assert words in page
    assert len(card.units.centre) == len(card.units.scale) == len(card.units.target) == 2


def test_card_tells_the_energy_error_in_the_box(tmp_path):
    main(['--config', str(tiny(tmp_path)), '--out', str(tmp_path / 'm.safetensors')])
    checkpoint = load_checkpoint(tmp_path / 'm.safetensors')
    error = checkpoint.card.energy_error
    z = np.random.default_rng(9).uniform([-2.0, -4.0], [2.0, 4.0], (4000, 2))
    true = 0.5 * z[:, 1]**2 + 9.81 * (1.0 - np.cos(z[:, 0]))
    errors = NeuralHamiltonian(checkpoint).energy(z[:, :1], z[:, 1:]) - true
    errors -= errors.mean()
    # Of 2000 other states: a statistical error of some per cent of the RMS.
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(error.rms, rel=0.15)
    assert error.against == 'true energy' and error.states == 2000
    assert error.rms_interval[0] < error.rms < error.rms_interval[1]
    assert error.rms < error.sup_interval[0] <= error.sup


@pytest.mark.skipif(torch.cuda.is_available(), reason='there is a CUDA device')
def test_cuda_is_refused_in_one_line_where_there_is_none(tmp_path):
    with pytest.raises(ParameterError, match='^--device cuda: .* use --device cpu$'):
        main(['--config', str(tiny(tmp_path)), '--out', str(tmp_path / 'm.safetensors'),
              '--device', 'cuda'])


@pytest.mark.skipif(not torch.cuda.is_available(), reason='there is no CUDA device')
@pytest.mark.parametrize('family', ['hnn', 'symplectic_form', 'separable_hnn'])
def test_training_on_cuda_gives_a_model_as_good(tmp_path, family):
    path = tiny(tmp_path, TINY + f'family: {{kind: {family}}}\n')
    losses = []
    for device in ('cpu', 'cuda'):
        out = tmp_path / f'{device}.safetensors'
        main(['--config', str(path), '--out', str(out), '--device', device])
        losses.append(load_checkpoint(out).card.losses['train_loss'])
    # The same steps, summed in another order: apart by no more than that has grown to.
    assert losses[1] < 3.0 * losses[0]


class Valley(torch.nn.Module):
    """One number x, whose loss x^2 has its least at zero; it is not finite beyond a limit."""

    def __init__(self, start: float, limit: float = math.inf):
        super().__init__()
        self.x = torch.nn.Parameter(torch.tensor(start, dtype=torch.float64))
        self.limit = limit

    def loss(self) -> torch.Tensor:
        return torch.where(self.x.abs() < self.limit, self.x.square(), math.inf)

    def stage(self, rate: float, retries: int) -> Stage:
        return Stage('fall', self.loss, 40, rate, lambda: float(self.loss().detach()), 40,
                     retries=retries)


def test_stage_that_gains_nothing_begins_again_at_lower_rates(capsys):
    """Adam moves by its rate at first: at 1 and .25 it only leaves the valley's ground."""
    module = Valley(0.01)
    losses = Problem(module, [module.stage(1.0, 3)]).fit()
    told = capsys.readouterr().out.splitlines()
    assert told[:1] == ['fall: no better at a rate of 1']
    assert abs(module.x.item()) < 0.01 and losses['fall'] <= 1e-4


@pytest.mark.parametrize('limit', [math.inf, 0.05])
def test_stage_never_ends_worse_than_it_began(limit, capsys):
    module = Valley(1e-9, limit)
    Problem(module, [module.stage(1.0, 1)]).fit()
    assert module.x.item() == 1e-9
    assert capsys.readouterr().out.splitlines() == [
        'fall: no better at a rate of 1', 'fall: no better at a rate of 0.25']


def test_stages_that_are_judged_in_another_way_begin_with_their_own_best():
    """The second stage is judged by the distance from one, of which the first knows nothing."""
    module = Valley(0.3)
    other = Stage('rise', lambda: (module.x - 1.0).square(), 200, 0.1,
                  lambda: float((module.x - 1.0).square().detach()), 200)
    Problem(module, [module.stage(0.1, 0), other]).fit()
    assert module.x.item() == pytest.approx(1.0, abs=1e-2)
