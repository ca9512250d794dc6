# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Torch modules exported as graphs: against torch, and refusals of what is no function H(q, p)."""

from itertools import pairwise
import math
import subprocess
import sys

from hnn_vi_ros import export, load_scene, simulate, simulate_many
from hnn_vi_ros.errors import ModelError, UnsupportedSystem
from hnn_vi_ros.models import load_learned
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.torch import DifferentiableSimulation
from messages import refused
import numpy as np
import pytest
from scene_files import write_scene
import torch
from torch import nn
from torch.nn import functional

BOX = {d: {'q': d * [(-2, 2)], 'p': d * [(-2, 2)]} for d in (1, 2)}


class Written(nn.Module):
    """A module whose forward is a function."""

    def __init__(self, function, *parts):
        super().__init__()
        self.parts, self.function = nn.ModuleList(parts), function

    def forward(self, x):
        return self.function(x, *self.parts)


def residual(x, first, second, last):
    x = functional.softplus(first(x))
    return last(x + functional.softplus(second(x)))


def attention(x, embed, query, key, value, last):
    h = embed(torch.stack(x.chunk(2, -1), -1))
    weights = torch.softmax(query(h) @ key(h).transpose(1, 2) / 2.0, -1)
    return last(torch.tanh(h + weights @ value(h))).sum((1, 2))


def pairs(x, net):
    q, p = x[:, :6].reshape(-1, 3, 2), x[:, 6:]
    i, j = torch.triu_indices(3, 3, 1)
    r = ((q[:, i] - q[:, j])**2).sum(-1, keepdim=True)
    return 0.5 * (p**2).sum(-1) + net(torch.sqrt(r + 0.1)).sum((1, 2))


def mass_matrix(x, net):
    q, p = x[:, :2], x[:, 2:]
    entries, factor = net(q), x.new_zeros(len(x), 2, 2)
    factor[:, 0, 0], factor[:, 1, 1] = entries[:, 0].exp(), entries[:, 1].exp()
    factor[:, 1, 0] = entries[:, 2]
    return 0.5 * ((factor.transpose(1, 2) @ p[..., None])**2).sum((1, 2)) + q.cos().sum(-1)


def experts(x, gate, *nets):
    return (torch.softmax(gate(x), -1) * torch.cat([net(x) for net in nets], -1)).sum(-1)


def net(*widths, activation=nn.Tanh):
    layers = [part for a, b in pairwise(widths)
              for part in (nn.Linear(a, b), activation())]
    return nn.Sequential(*layers[:-1])


MODULES = {
    'residual softplus': (1, lambda: Written(
        residual, nn.Linear(2, 9), nn.Linear(9, 9), nn.Linear(9, 1))),
    'layer norm and gelu': (2, lambda: nn.Sequential(
        nn.Linear(4, 9), nn.LayerNorm(9), nn.GELU(), nn.Linear(9, 1))),
    'dropout and batch norm': (1, lambda: nn.Sequential(
        nn.Linear(2, 9), nn.Dropout(0.3), nn.BatchNorm1d(9), nn.SiLU(), nn.Linear(9, 1))),
    'attention': (3, lambda: Written(
        attention, nn.Linear(2, 4), *(nn.Linear(4, 4) for _ in range(3)), nn.Linear(4, 1))),
    'sum over pairs': (6, lambda: Written(pairs, net(1, 8, 1))),
    'mass matrix': (2, lambda: Written(mass_matrix, net(2, 8, 3))),
    'mixture': (1, lambda: Written(experts, nn.Linear(2, 2), net(2, 8, 1), net(2, 8, 1))),
    'relu': (1, lambda: net(2, 9, 9, 1, activation=nn.ReLU)),
    'mean over bodies': (3, lambda: Written(lambda x, inner, outer: outer(
        inner(torch.stack(x.chunk(2, -1), -1)).mean(1)), net(2, 8, 8), net(8, 8, 1))),
    'norm of order 3': (2, lambda: Written(
        lambda x: torch.linalg.vector_norm(x + 3.0, ord=3, dim=-1))),
    'convex in its input': (1, lambda: Written(lambda x, first, second: functional.linear(
        functional.softplus(first(x)), second.weight.exp()), nn.Linear(2, 9), nn.Linear(9, 1))),
}


def assigned(x):
    y = x.new_zeros(len(x), 3)
    y[:, 0], y[:, 1], y[:, 2] = torch.tensor(5), x[:, 0], 3
    return (y**2).sum(-1) + x[:, 1]**2


# Of the twelve that a user may bring; see also those above.
MODULES |= {
    'Fourier features': (1, lambda: Written(lambda x, net: net(torch.cat(
        [f(x * 2.0**k) for k in range(4) for f in (torch.sin, torch.cos)], -1)), net(16, 8, 1))),
    'sine network': (1, lambda: Written(lambda x, first, second, last: last(
        torch.sin(30.0 * second(torch.sin(30.0 * first(x))))), nn.Linear(2, 9),
        nn.Linear(9, 9), nn.Linear(9, 1))),
    'invariant to rotations': (3, lambda: Written(lambda x, net: net(torch.stack(
        [(x[:, :3]**2).sum(-1), (x[:, 3:]**2).sum(-1), (x[:, :3] * x[:, 3:]).sum(-1)], -1)),
        net(3, 8, 1))),
}
MODULES |= {name: (1, lambda f=f: Written(f)) for name, f in {
    'scattered numbers': lambda x: (x.scatter(
        1, torch.zeros(len(x), 1, dtype=int), 1.5)**2 * x**2).sum(-1),
    'integers joined': lambda x: torch.cat([x, torch.tensor([[3, 7]]).expand(len(x), 2)], 1
                                           ).prod(-1),
    'assigned numbers': assigned,
    'filled by a mask': lambda x: (x.masked_fill(x > 0.3, 0.5)**2 + x).sum(-1),
    'clamped': lambda x: torch.clamp(x, -0.5, 0.5).sum(-1) + functional.relu6(x).prod(-1),
    'truth values': lambda x: torch.logical_and(x[:, 0], x[:, 1]).to(x.dtype) * x.prod(-1),
    'exponential units': lambda x: functional.elu(600.0 * x).prod(-1),
    'logarithm of sigmoid': lambda x: functional.logsigmoid(x).sum(-1),
    'soft plus with a threshold': lambda x: functional.softplus(x, 3.0, 5.0).sum(-1),
    'in place': lambda x: x.mul(2.0).sigmoid_().sum(-1),
    'lower triangle': lambda x: torch.tril(x[:, :, None] * x[:, None]).sum((1, 2)),
    'thresholds': lambda x: functional.hardshrink(x).prod(-1),
    'zeros like constants': lambda x: x.prod(-1) + torch.zeros_like(torch.ones(2)).sum(),
    'loss to nothing': lambda x: functional.huber_loss(
        x, torch.zeros_like(x), reduction='none').sum(-1),
}.items()}
KERNEL = torch.linspace(-1.0, 1.0, 6, dtype=torch.float64).reshape(2, 1, 3)


def changed_in_place(x):
    x += 1.0
    x[:, 0] = 2.0 * x[:, 1]
    y = torch.empty(len(x), 4, dtype=x.dtype)
    y[:, :2].copy_(x[:, 2:])
    y[:, 2:] = x[:, :2]
    y.clamp_(-1.5, 1.5).sub_(0.5)
    y[:, 1:].mul_(2.0)
    first = y[:, 0]
    y[:, 1] += x[:, 3]
    first.add_(1.0)
    return (y**3).sum(-1)


def derivative_inside(x):
    q = x[:, :2].clone().requires_grad_(True) if not x.requires_grad else x[:, :2]
    force, = torch.autograd.grad((q**4).sum(), q, create_graph=True)
    return (force * x[:, 2:]).sum(-1)


def slow_derivative_inside(x):
    return torch.func.vmap(torch.func.grad(lambda z: (z**3).prod()))(x).sum(-1)


MODULES |= {name: (2, lambda f=f: Written(f)) for name, f in {
    'convolutions': lambda x: functional.conv2d(
        functional.conv1d(x[:, None], KERNEL, KERNEL[:, 0, 0], padding=1)[:, None],
        KERNEL.reshape(1, 1, 2, 3), stride=(1, 2), padding=(0, 2),
        dilation=(1, 2)).square().sum((1, 2, 3)),
    'convolution of groups': lambda x: functional.conv1d(
        x.reshape(-1, 2, 2), KERNEL.repeat(2, 1, 1)[:, :, :2], groups=2).prod(1).sum(-1),
    'ring': lambda x: functional.pad(x[:, None], (1, 2), mode='circular').prod(-1).sum(-1),
    'padded': lambda x: functional.pad(x, (1, -1), value=2.0).prod(-1),
    'pools': lambda x: functional.avg_pool1d(x[:, None], 2).prod(-1).sum(
        -1) + functional.max_pool1d(x[:, None], 3, 1, 1).square().sum((1, 2)),
    'scattered sums': lambda x: x.new_zeros(len(x), 2).scatter_add(
        1, torch.tensor([[0, 1, 0, 1]]).expand(len(x), 4), x).prod(-1),
    'largest and smallest': lambda x: x.max(1).values * x.min(1, keepdim=True)[0][:, 0],
    'sorted': lambda x: x.sort(1).values @ torch.arange(4.0, dtype=x.dtype)
    + x.topk(2).values.prod(-1),
    'running products': lambda x: x.cumprod(1).sum(-1),
    'inverse hyperbolic functions': lambda x: (x**2 + 1.01).acosh().prod(-1)
    + (0.4 * x).atanh().prod(-1) + x.erfc().prod(-1),
    'rounded': lambda x: (x.trunc() * x).sum(-1) + torch.fmod(x, 0.7).prod(-1)
    + (torch.div(x, 0.3, rounding_mode='floor') * x).sum(-1),
    'entropy': lambda x: torch.xlogy(x.relu(), x.exp() + 1.0).prod(-1),
    'norms of other orders': lambda x: torch.linalg.vector_norm(x, -math.inf, -1)
    * torch.linalg.vector_norm(x, 0, -1) * torch.linalg.vector_norm(x[:, :1], 2, -1),
    'changed in place': changed_in_place,
    'derivative inside': derivative_inside,
    'derivative of a function inside': slow_derivative_inside,
}.items()}


def masses(x, n=2):
    """Return positive definite matrices M(q), and p as columns."""
    a = torch.outer(torch.arange(1.0, n + 1.0), torch.arange(2.0, n + 2.0)).to(x) * x[:, :1, None]
    return torch.sin(a) @ torch.sin(a).mT + torch.eye(n, dtype=x.dtype), x[:, 2:, None]


MODULES |= {name: (2, lambda f=f: Written(lambda x: f(*masses(x)))) for name, f in {
    'linear systems': lambda m, p: (p.mT @ torch.linalg.solve(m, p)).sum((1, 2))
    + torch.linalg.solve(m, p[..., 0]).sum(-1)
    + torch.linalg.solve(m, p.mT, left=False).sum((1, 2)),
    'inverses': lambda m, p: (p.mT @ torch.linalg.inv(m) @ p).sum((1, 2)),
    'Cholesky factors': lambda m, p: torch.cholesky_solve(p, torch.linalg.cholesky(m)).sum((1, 2))
    + torch.cholesky_solve(p, torch.linalg.cholesky(m, upper=True), upper=True).prod(1)[:, 0],
    'triangular systems': lambda m, p: torch.linalg.solve_triangular(m, p, upper=True).sum((1, 2))
    + torch.linalg.solve_triangular(m, p, upper=False, unitriangular=True).prod(1)[:, 0],
    'determinants': lambda m, p: torch.linalg.det(m) * torch.logdet(m) + p.prod(1)[:, 0],
    'products of three': lambda m, p: functional.bilinear(
        m[:, 0], p[..., 0], torch.arange(4.0).reshape(1, 2, 2).to(p))[:, 0] + p.prod(1)[:, 0],
    'slopes of linear systems': lambda m, p: (torch.func.grad(lambda v: (
        v.mT @ torch.linalg.solve(m, v)).sum())(p)**2).sum((1, 2)),
}.items()}
MODULES['scripted'] = (1, lambda: torch.jit.script(net(2, 8, 1)))


LARGE = 'a million weights'
MODULES[LARGE] = (2, lambda: net(4, 1000, 1000, 1))


@pytest.mark.parametrize('name', [
    pytest.param(name, marks=[pytest.mark.long] * (name == LARGE)) for name in MODULES])
def test_exported_module_is_that_of_torch(name, tmp_path):
    d, make = MODULES[name]
    torch.manual_seed(0)
    module = make()
    path = tmp_path / 'model.safetensors'
    box = d * [(-2.0, 2.0)]
    export(module, path, [f'q{k}' for k in range(d)], {'q': box, 'p': box})
    own, module = load_learned(path), module.double().eval()
    rng = np.random.default_rng(1)
    (q, p), v = rng.uniform(-2.0, 2.0, (2, 7, d)), rng.normal(size=(7, 2 * d))
    x = torch.tensor(np.hstack([q, p]), requires_grad=True)
    values = module(x.clone()).reshape(-1)
    (slopes,) = torch.autograd.grad(values.sum(), x, create_graph=True)
    (product,) = torch.autograd.grad((slopes * torch.tensor(v)).sum(), x)
    for found, expected in (
            (own.energy(q, p), values), (np.hstack(own.gradient(q, p)), slopes),
            (np.hstack(own.hessian_vector(q, p, v[:, :d], v[:, d:])), product)):
        expected = expected.detach().numpy()
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


class Apart(nn.Module):
    """A module that takes q and p, with an option."""

    def forward(self, q, p, scale=1.0):
        return scale * (0.5 * (p**2).sum(-1) - q.cos().prod(-1))


def test_module_of_q_and_p_is_exported_like_one_of_rows(tmp_path):
    export(Apart(), tmp_path / 'apart.safetensors', ['a', 'b'], BOX[2])
    q, p = np.random.default_rng(0).uniform(-2.0, 2.0, (2, 7, 2))
    assert load_learned(tmp_path / 'apart.safetensors').energy(q, p) == pytest.approx(
        0.5 * (p**2).sum(-1) - np.cos(q).prod(-1), rel=1e-12, abs=1e-12)


def test_exported_module_is_loaded_without_torch(tmp_path):
    path = tmp_path / 'model.safetensors'
    export(net(2, 8, 1), path, ['x'], BOX[1])
    code = ('import sys; from hnn_vi_ros.models import load_learned; import numpy as np; '
            f'h = load_learned({str(path)!r}); h.gradient(np.zeros((1, 1)), np.ones((1, 1))); '
            'print("torch" in sys.modules)')
    found = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                           check=True)
    assert found.stdout == 'False\n'


def test_separable_module_is_found_to_be_separable(tmp_path):
    kinetic, potential = net(1, 8, 1), net(1, 8, 1)
    for name, function in (('sum', lambda x, t, v: t(x[:, 1:]) + v(x[:, :1])),
                           ('product', lambda x, t, v: t(x[:, 1:]) * v(x[:, :1]))):
        path = tmp_path / f'{name}.safetensors'
        export(Written(function, kinetic, potential), path, ['x'], BOX[1])
        assert load_learned(path).separable == (name == 'sum')


def test_training_mode_and_single_precision_are_said(tmp_path):
    remarks = export(nn.Sequential(nn.Linear(2, 8), nn.Dropout(0.5), nn.Linear(8, 1)),
                     tmp_path / 'model.safetensors', ['x'], BOX[1])
    assert ['eval()' in remark for remark in remarks] == [True, False]
    assert 'float32' in remarks[1]


def test_norms_have_the_slope_0_at_0(tmp_path):
    path = tmp_path / 'model.safetensors'
    export(Written(lambda x: x.norm(dim=-1)), path, ['x'], BOX[1])
    assert np.hstack(load_learned(path).gradient(*np.zeros((2, 1, 1)))).tolist() == [[0.0, 0.0]]


def test_norm_of_several_values_is_smooth_and_of_one_is_not(tmp_path):
    for columns in (1, 2):
        path = tmp_path / f'{columns}.safetensors'
        export(Written(lambda x, n=columns: x[:, :n].norm(dim=-1)), path, ['x'], BOX[1])
        assert load_learned(path).smooth == (columns == 2)


def test_distances_are_norms_of_differences(tmp_path):
    # torch has no second derivatives of cdist and pdist, so that they are compared with norms.
    ways = [lambda x: torch.cdist(x.reshape(-1, 2, 2), KERNEL[:, 0, :2][None]).sum((1, 2))
            + functional.pdist(x.reshape(4, 1)).sum(),
            lambda x: (x.reshape(-1, 2, 1, 2) - KERNEL[:, 0, :2]).norm(dim=-1).sum((1, 2))
            + (x[:, [0, 0, 0, 1, 1, 2]] - x[:, [1, 2, 3, 2, 3, 3]]).abs().sum(-1)]
    found = []
    for k, way in enumerate(ways):
        path = tmp_path / f'{k}.safetensors'
        export(Written(way), path, ['x', 'y'], BOX[2])
        q, p, v, w = np.random.default_rng(2).uniform(-2.0, 2.0, (4, 5, 2))
        own = load_learned(path)
        found.append([own.energy(q, p)[:, None], *own.gradient(q, p),
                      *own.hessian_vector(q, p, v, w)])
    assert np.abs(np.hstack(found[0]) - np.hstack(found[1])).max() < 1e-12


def without(x):
    y = x.clone()
    y[y > 0.3] = 0.5
    return y.sum()


def halved(x):
    while x.norm() > 0.5:
        x = x / 2.0
    return x.sum()


def normalised():
    layer = torch.nn.utils.weight_norm(nn.Linear(2, 1))
    layer(torch.ones(1, 2))
    return layer


class Signed(nn.Module):
    """A module of two arguments with other names."""

    def __init__(self, forward):
        super().__init__()
        self.forward = forward


class Running(nn.Module):
    """A module that changes its buffer."""

    def __init__(self):
        super().__init__()
        self.register_buffer('mean', torch.zeros(2))

    def forward(self, x):
        self.mean.mul_(0.99).add_(0.01 * x.detach().mean(0))
        return ((x - self.mean)**2).sum(-1)


def listed_layers():
    module = Written(lambda x: module.others[0](x)[:, 0])
    module.others = [nn.Linear(2, 1)]
    return module


def field(x, inner):
    with torch.enable_grad():
        z = x.requires_grad_(True)
        slopes, = torch.autograd.grad(inner(z).sum(), z, create_graph=True)
    return torch.cat([slopes[:, 1:], -slopes[:, :1]], 1)


REFUSED = {name: function if isinstance(function, nn.Module) else Written(function)
           for name, function in {
    'indices by values': without,
    'indices of the largest': lambda x: x[:, x.argmax()].sum(),
    'places of sorted values': lambda x: (x.sort(1).indices * x).sum(),
    'a class by values': lambda x: functional.one_hot((x[:, 0] > 0).long(), 2).sum() * x.sum(),
    'embedding by values': lambda x: functional.embedding(
        (x[:, 0] > 0).long(), KERNEL[:, 0]).sum(),
    'two outputs': net(2, 8, 2),
    'no sum over coordinates': lambda x: x**2,
    'a tuple': lambda x: (x.sum(), x),
    'nothing': lambda x: None,
    'single precision inside': lambda x: x.float().sum().double(),
    'single precision returned': lambda x: x.sum().float(),
    'a sum in single precision': lambda x: x.sum(dtype=torch.float32).double(),
    'random numbers': lambda x: (x * torch.rand_like(x)).sum(),
    'a counter': lambda x, state=[0]: state.append(0) or x.sum() * len(state),
    'a branch': lambda x: x.sum() if x[0, 0] > 0 else -x.sum(),
    'a loop to convergence': halved,
    'a number': lambda x: torch.tensor(float(x.detach().sum())),
    'numpy': lambda x: torch.tensor(x.detach().numpy().sum()),
    'a constant': lambda x: torch.ones(1, dtype=x.dtype),
    'a detached part': lambda x: (x * x.detach()).sum(),
    'eigenvalues': lambda x: torch.linalg.eigvalsh(torch.eye(2, dtype=x.dtype) + x.T @ x)[:1],
    'rows to exchange': lambda x: torch.linalg.solve(
        torch.eye(2, dtype=x.dtype).flip(0), x[0]).prod(),
    'a pivot that changes its sign': lambda x: torch.linalg.solve(torch.stack([torch.stack(
        [x[:, 0], 1 + 0 * x[:, 0]], -1), torch.stack([1 + 0 * x[:, 0], -x[:, 0]], -1)], -2),
        x).prod(-1),
    'a determinant without pivot': lambda x: torch.linalg.det(torch.stack([torch.stack(
        [x[:, 0], x[:, 1]], -1), torch.stack([x[:, 1], 1 + x[:, 0]], -1)], -2)),
    'a mean of the batch': lambda x: ((x - x.mean(0) + 1)**2).sum(-1),
    'rows in another order': lambda x: (x.flip(0)**2).sum(-1),
    'columns beside rows': lambda x: (x[:, :1]**2 + x[:, 1]**2).mean(1),
    'rows beside rows': lambda x: x[:, :1]**2 + x[:, 1]**2,
    'a function of requires_grad': lambda x: (x**2).sum(-1) * (2.0 if x.requires_grad else 1.0),
    'complex numbers': lambda x: torch.exp(1j * x).real.sum(-1),
    'rounding errors': lambda x: functional.layer_norm(
        x @ torch.arange(10.0, dtype=x.dtype).reshape(2, 5)**0.5, (5,)).sum(-1),
    'the first row': lambda x: x[0, 0]**2 + x[0, 1]**2,
    'attention over the batch': nn.Sequential(
        nn.Linear(2, 8), nn.TransformerEncoderLayer(8, 2, 16, activation='gelu'), nn.Linear(8, 1)),
    'layers not made yet': nn.Sequential(nn.LazyLinear(8), nn.Tanh(), nn.LazyLinear(1)),
    'layers in a list': listed_layers(),
    'a vector field': Written(field, net(2, 8, 1)),
    'state and time': Signed(lambda x, t=None: (x**2).sum(-1) * t),
    'unknown names': Signed(lambda x, y: y**2 / 2 + x**4),
    'momenta first': Signed(lambda pq: (pq**2).sum(-1)),
    'velocities': Signed(lambda q, q_dot: (q**2 + q_dot**2).sum(-1)),
    'rounding to decimals': lambda x: (x.round(decimals=1) * x).sum(),
    'a transform': lambda x: torch.fft.rfft(x).abs().sum(),
    'a transposed convolution': lambda x: functional.conv_transpose1d(
        x[:, None], KERNEL[:1]).sum(),
    'another width': net(3, 8, 1),
    'two arguments': Written(lambda q, p: 0.5 * p**2),
    'an error': lambda x: x.no_such_method(),
    'no energy in the domain': lambda x: x.log().sum(),
    'weights without values': nn.Linear(2, 1, device='meta'),
    'weights of another time': normalised(),
    'a function': nn.Identity(),
    'a branch of torch': lambda x: torch.cond(
        x.sum() > 9, lambda y: (y**4).sum(-1), lambda y: (y**2).sum(-1), (x,)),
    'a running mean': Running(),
}.items()}
# Compiling takes time: only for its test.
REFUSED['frozen'] = None


@pytest.mark.parametrize('name', REFUSED)
@pytest.mark.filterwarnings('ignore')  # torch tells of what is old
def test_module_that_is_no_energy_is_refused_in_a_line(name, tmp_path):
    path = tmp_path / 'model.safetensors'
    module = torch.sum if name == 'a function' else REFUSED[name] or torch.jit.freeze(
        torch.jit.script(net(2, 8, 1).eval()))
    with refused(ModelError):
        export(module, path, ['x'], BOX[1])
    assert not path.exists()


def test_columns_of_a_pose_are_refused_as_canonical_coordinates(tmp_path):
    module, box = Written(lambda x: x[:, 3:12].prod(-1) + (x[:, 12:]**2).sum(-1)), 9 * [(-1, 1)]
    with refused(ModelError):
        export(module, tmp_path / 'model.safetensors', [f'q{k}' for k in range(9)],
               {'q': box, 'p': box})


class MomentaFirst(nn.Module):
    """A module of (p, q) for TorchScript, which needs its source."""

    def forward(self, p, q):
        return p**2 / 2 + q**4


@pytest.mark.parametrize('make', [
    MomentaFirst, lambda: Signed(lambda x, p_x: p_x**2 / 2 + x**4),
    lambda: torch.jit.script(MomentaFirst())])
def test_names_of_arguments_tell_coordinates_from_momenta(make, tmp_path):
    path = tmp_path / 'model.safetensors'
    export(make(), path, ['x'], BOX[1])
    # Exact up to the rounding of two products.
    assert abs(load_learned(path).energy([0.5], [2.0]) - (2.0 + 0.5**4)) < 1e-15


@pytest.mark.parametrize('forward', [
    lambda q, p, k=2.0, t=0.0: p**2 / k + q**4 * torch.cos(t), lambda t, x: (
        x[:, 1:]**2 / 2 + x[:, :1]**4 * torch.cos(t))])
def test_argument_of_a_module_may_be_the_time(forward, tmp_path):
    """Its slope by the time drives the energy; the kinetic part stays separable."""
    path = tmp_path / 'model.safetensors'
    export(Signed(forward), path, ['x'], {**BOX[1], 't': [(0, 3)]})
    own = load_learned(path)
    q, p, t = np.random.default_rng(0).uniform(0.5, 2.0, (3, 5))
    # Exact up to some roundings.
    assert own.separable and np.abs(own.energy(q[:, None], p[:, None], t) - (
        p**2 / 2 + q**4 * np.cos(t))).max() < 1e-13
    run = simulate(Scene.build(
        hamiltonian={'kind': 'hnn', 'model': str(path)}, integrator='gauss8', step_size=0.02,
        initial_state=([0.7], [0.1])), 1.0)
    same = simulate(lambda q, p, t: p**2 / 2 + q**4 * np.cos(t), 0.7, 0.1, 1.0, 0.02)
    # The same steps up to rounding; the error of the account is that of order 8.
    assert np.abs(run.q - same.q).max() < 1e-13 and np.abs(run.work - same.work).max() < 1e-13
    assert abs(run.energy[-1] - run.energy[0] - run.work[-1]) < 1e-13


@pytest.mark.parametrize('function, slopes', [
    (lambda x: functional.hardsigmoid(3.0 * x), [0.5 * 0.7, 0.5 * 0.25]),
    (lambda x: functional.celu(x, 0.7),
     [math.exp(-0.5 / 0.7) * 0.4, 0.7 * math.expm1(-0.5 / 0.7)])])
def test_units_whose_slopes_in_torch_have_constants_in_float32_are_exported(
        function, slopes, tmp_path):
    path = tmp_path / 'model.safetensors'
    export(Written(lambda x: function(x).prod(-1)), path, ['x'], BOX[1])
    # Some roundings.
    assert np.abs(np.ravel(load_learned(path).gradient([-0.5], [0.4])) - slopes).max() < 1e-15


def test_existing_model_is_replaced_only_on_request(tmp_path):
    path = tmp_path / 'model.safetensors'
    for value in (1.0, 2.0):
        export(Written(lambda x, value=value: value * x.prod(-1)), path, ['x'], BOX[1],
               overwrite=value == 2.0)
    assert load_learned(path).energy([1.0], [1.0]) == 2.0
    with refused(ModelError):
        export(net(2, 8, 1), path, ['x'], BOX[1])


@pytest.mark.parametrize('coordinates, domain', [
    (['x', 'y'], BOX[1]), (['x', 'x'], BOX[2]), (['x'], {'q': [(-1, 1)]}), ([], BOX[1]),
    (['x'], {'q': [(1, -1)], 'p': [(-1, 1)]}), (['x'], {'q': [1], 'p': [(-1, 1)]}),
    (['x'], {**BOX[1], 't': [(0, 1)]}), (['x'], {**BOX[1], 't': [(1, 0)]})])
def test_domain_that_does_not_fit_is_refused_in_a_line(coordinates, domain, tmp_path):
    with refused(ModelError):
        export(net(2, 8, 1), tmp_path / 'model.safetensors', coordinates, domain)


@pytest.fixture
def scene(tmp_path):
    """Return the scene of an exported pendulum."""
    path = tmp_path / 'model.safetensors'
    export(Written(lambda x: 0.5 * x[:, 1]**2 - torch.cos(x[:, 0])), path, ['theta'],
           {'q': [(-math.pi, math.pi)], 'p': [(-3, 3)]})
    return load_scene(write_scene(
        tmp_path / 'scene.yaml', f'hnn, model: {path}', '', 'gauss4', 0.1))


def test_exported_pendulum_keeps_its_energy(scene):
    trajectory = simulate(scene, 100.0)
    # gauss4 keeps a modified energy, which differs by O(h^4).
    assert np.ptp(trajectory.energy) < 0.1**4


@pytest.mark.parametrize('name', ['0.weight', 'tensor1', 'linear1.weight'])
def test_gradients_by_weights_of_an_exported_model_are_refused_by_name(scene, name):
    with refused(UnsupportedSystem):
        DifferentiableSimulation(scene, [f'hamiltonian.{name}'])


def test_device_refuses_an_exported_model_by_name(scene):
    with refused(UnsupportedSystem):
        simulate_many(scene, np.ones((2, 1)), np.zeros((2, 1)), duration=1.0, device='cpu')


@pytest.mark.parametrize('activation, smooth', [
    (nn.Softplus(), True), (nn.CELU(), True), (nn.ELU(), True), (nn.GELU(), True),
    (nn.SiLU(), True), (nn.Softmax(-1), True), (nn.LogSigmoid(), True), (nn.Tanh(), True),
    (nn.LayerNorm(8), True), (nn.ReLU(), False), (nn.LeakyReLU(), False), (nn.SELU(), False),
    (nn.Hardtanh(), False)], ids=lambda case: type(case).__name__)
def test_smoothness_of_a_module_is_that_of_its_gradient(activation, smooth, tmp_path):
    torch.manual_seed(0)
    module = nn.Sequential(nn.Linear(2, 8), activation, nn.Linear(8, 1)).double()
    path = tmp_path / 'model.safetensors'
    export(module, path, ['x'], {'q': [(-2.0, 2.0)], 'p': [(-2.0, 2.0)]})
    assert load_learned(path).smooth == smooth
