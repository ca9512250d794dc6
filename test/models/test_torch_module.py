# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Torch modules as users bring them: functions of each row, or refused in one line."""

from collections.abc import Callable

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.models import TorchHamiltonian
from hnn_vi_ros.phase_space import Coordinate
from messages import refused
import numpy as np
import pytest
import torch

X = Coordinate('x', 'm', 'kg m/s')


class Written(torch.nn.Module):
    """A module as a formula of its input."""

    def __init__(self, formula: Callable):
        super().__init__()
        self.forward = formula


@pytest.mark.parametrize('formula', [
    lambda x: (x.float() ** 2).sum(-1), lambda x: x, lambda x: (x[:, :1], x[:, 1:]),
    lambda x: float(x.sum()), lambda x: x[0, 0] ** 2 + x[0, 1] ** 2,
    lambda x: ((x - x.mean(0)) ** 2).sum(-1), lambda x: torch.rand(()) * x.sum(-1),
    lambda x: (x.detach() ** 2).sum(-1), lambda x: (x ** 2).sum(-1) + (x.detach() ** 2).sum(-1),
    lambda x: x @ torch.ones(2), lambda x: x.no_such,
    lambda x: (x.float() ** 2).sum(-1).double()])
def test_module_that_is_no_function_of_rows_is_refused(formula):
    module = TorchHamiltonian(Written(formula), [X])
    with refused(ModelError):
        module.check_state(np.array([1.0]), np.array([0.5]))


def test_module_of_the_time_is_refused_by_name():
    with refused(ModelError):
        TorchHamiltonian(Written(lambda x, t: x.sum(-1) * t), [X])


def test_module_of_momenta_and_coordinates_is_called_so():
    own = TorchHamiltonian(Written(lambda p, q: (p**2 / 2 - q.cos()).sum(-1)), [X])
    # Some roundings.
    assert np.abs(np.ravel(own.gradient([1.0], [0.5])) - [np.sin(1.0), 0.5]).max() < 1e-15


def test_module_in_training_is_evaluated():
    """Neither does dropout change it, nor does a batch of one state stop its normalisation."""
    torch.manual_seed(2)
    net = torch.nn.Sequential(torch.nn.Linear(2, 8), torch.nn.BatchNorm1d(8), torch.nn.Tanh(),
                              torch.nn.Dropout(0.5), torch.nn.Linear(8, 1)).double()
    own = TorchHamiltonian(net, [X])
    own.check_state(np.array([1.0]), np.array([0.5]))
    assert net.training
    x = torch.tensor([[1.0, 0.5]], dtype=torch.float64, requires_grad=True)
    (slopes,) = torch.autograd.grad(net.eval()(x).sum(), x)
    assert np.array_equal(np.concatenate(own.gradient([1.0], [0.5])), slopes[0].numpy())


def test_module_whose_gradient_is_constant_has_second_derivatives_of_zero():
    module = TorchHamiltonian(Written(lambda x: torch.relu(x).sum(-1)), [X])
    one = np.ones(1)
    assert module.hessian_vector(one, one, one, one) == (0.0, 0.0)
