# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Import of networks of bodies that turn, of the public Lie-group Hamiltonian code."""

from pathlib import Path

from helpers import long
from hnn_vi_ros.errors import ModelError, ParameterError
from hnn_vi_ros.learning.families.lie_group import HeldBody, LieGroupNetwork
from hnn_vi_ros.learning.import_model import main
from hnn_vi_ros.models import load_checkpoint
from hnn_vi_ros.models.lie_group import LieGroupHamiltonian
from lie_group_models import random_states
from messages import refused
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import torch
from torch import nn

EPSILON, FLOOR = 0.1, 0.02
# Inputs, hidden layers and outputs of each network of the two layouts.
SHAPES = {'so3': {'M_net': (9, 3, 6), 'Dw_net': (9, 3, 6), 'V_net': (9, 2, 1),
                  'g_net': (9, 2, 3)},
          'se3': {'M_net1': (3, 3, 6), 'M_net2': (9, 3, 6), 'Dv_net': (3, 3, 6),
                  'Dw_net': (9, 3, 6), 'V_net': (12, 2, 1), 'g_net.mlp': (12, 2, 24)}}


def source(layout: str) -> dict[str, nn.Module]:
    """Return random networks of the structure that that code has, in double precision."""
    torch.manual_seed(5)
    networks = {}
    for name, (inputs, hidden, outputs) in SHAPES[layout].items():
        widths, layers = [inputs, *[7] * hidden, outputs], {}
        for k in range(hidden + 1):
            layers[f'linear{k + 1}'] = nn.Linear(widths[k], widths[k + 1], dtype=torch.float64)
        networks[name] = nn.ModuleDict(layers)
    return networks


def save(folder: Path, networks: dict[str, nn.Module]) -> Path:
    path = folder / f'body-{len(networks)}.tar'
    torch.save({f'{name}.{key}': tensor for name, network in networks.items()
                for key, tensor in network.state_dict().items()}, path)
    return path


def values(network: nn.Module, x: torch.Tensor) -> torch.Tensor:
    *hidden, last = network.values()
    for layer in hidden:
        x = torch.tanh(layer(x))
    return last(x)


def matrix(network: nn.Module, x: torch.Tensor, epsilon: float) -> torch.Tensor:
    """Return L L^T, from the diagonal of L first and then what is below it by rows."""
    y, zero = values(network, x), torch.zeros((), dtype=torch.float64)
    a, b, c = y[:3] + epsilon ** 0.5
    L = torch.stack([torch.stack([a, zero, zero]), torch.stack([y[3], b, zero]),
                     torch.stack([y[4], y[5], c])])
    return L @ L.T


def energy(networks: dict[str, nn.Module], x: torch.Tensor, R: torch.Tensor, p: torch.Tensor
           ) -> torch.Tensor:
    """Return H of (x, R, p), p of the position in space."""
    floor, pose = FLOOR * torch.eye(3, dtype=torch.float64), torch.cat([x, R.ravel()])
    if not len(x):
        M = matrix(networks['M_net'], R.ravel(), EPSILON) + floor
        return 0.5 * p @ M @ p + values(networks['V_net'], pose)[0]
    M1 = matrix(networks['M_net1'], x, EPSILON) + floor
    M2 = matrix(networks['M_net2'], R.ravel(), EPSILON) + floor
    v = R.T @ p[:3]
    return 0.5 * (v @ M1 @ v + p[3:] @ M2 @ p[3:]) + values(networks['V_net'], pose)[0]


def imported(tmp_path: Path, layout: str, path: Path, *more: str) -> None:
    main([str(path), '--layout', layout, '--coordinates', 'body',
          '--box=-1:1', f'--epsilon={EPSILON}', f'--floor={FLOOR}',
          '--out', str(tmp_path / 'model.safetensors'), *more])


@pytest.mark.parametrize('layout', ['so3', long('se3')])
def test_imported_body_has_the_energy_and_gradient_of_its_source(tmp_path: Path, layout: str):
    networks = source(layout)
    imported(tmp_path, layout, save(tmp_path, networks))
    model = load_checkpoint(tmp_path / 'model.safetensors')
    hamiltonian, places = LieGroupHamiltonian(model), 0 if layout == 'so3' else 3
    states, momenta = random_states(places + 3, 3)
    for q, p in zip(states, momenta, strict=True):
        R0 = Rotation.from_quat(q[places:])
        x, momentum = (torch.tensor(part, requires_grad=True) for part in (q[:places], p))
        turn = torch.zeros(3, dtype=torch.float64, requires_grad=True)
        a, b, c = turn
        zero = torch.zeros((), dtype=torch.float64)
        hat = torch.stack([torch.stack([zero, -c, b]), torch.stack([c, zero, -a]),
                           torch.stack([-b, a, zero])])
        H = energy(networks, x, torch.tensor(R0.as_matrix()) @ (
            torch.eye(3, dtype=torch.float64) + hat), momentum)
        H_x, H_turn, H_p = torch.autograd.grad(H, (x, turn, momentum), allow_unused=True)
        assert abs(hamiltonian.energy(q, p) - H.item()) < 1e-12
        dH_dq, dH_dp = hamiltonian.gradient(q, p)
        np.testing.assert_allclose(dH_dp, H_p, rtol=0.0, atol=1e-12)
        if places:
            np.testing.assert_allclose(dH_dq[:3], H_x, rtol=0.0, atol=1e-12)
        # Along turns in the frame of the body: q' = q (omega, 0) / 2.
        x, y, z, w = q[places:]
        rates = 0.5 * np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]])
        np.testing.assert_allclose(rates.T @ dH_dq[places:], H_turn, rtol=0.0, atol=1e-12)
        # What training takes, and the products that Newton's method does.
        spacing, (v_q, v_p) = 1e-5, random_states(places + 3, 1, 7)
        ahead, behind = (np.concatenate(hamiltonian.gradient(
            q + s * spacing * v_q[0], p + s * spacing * v_p[0])) for s in (1, -1))
        kernel, d = hamiltonian.kernel, places + 4
        product_q, product_p = np.zeros(d), np.zeros(d)
        kernel.hessian_vector(kernel.parameters, q, np.append(p, 0.0), v_q[0],
                              np.append(v_p[0], 0.0), product_q, product_p)
        # Central differences: 1e-10 of truncation and of round-off.
        np.testing.assert_allclose([*product_q, *product_p[:-1]],
                                   (ahead - behind) / (2.0 * spacing), rtol=0.0, atol=1e-7)
    network = LieGroupNetwork.of(model)
    R = torch.tensor(R0.as_matrix())[None]
    at, u = torch.tensor(q[None, :places]), torch.zeros((1, 1), dtype=torch.float64)
    held = HeldBody(network, at, R, u[:, :0])
    np.testing.assert_allclose(held.velocity(torch.tensor(p[None]))[0].detach(), dH_dp,
                               rtol=0.0, atol=1e-12)
    # The map of inputs, and friction, of the networks of their names.
    pose = torch.cat([at[0], R.ravel()])
    name = 'g_net' if layout == 'so3' else 'g_net.mlp'
    ours = network.outputs('input_map', pose[None])[0]
    np.testing.assert_allclose(ours.detach(), values(networks[name], pose).detach(), atol=1e-13)
    root = network.roots('dissipation', pose[None])[1][0]
    np.testing.assert_allclose((root @ root.T)[-3:, -3:].detach(), matrix(
        networks['Dw_net'], R.ravel(), 0.0).detach(), rtol=0.0, atol=1e-12)


def test_import_without_friction_or_of_other_networks(tmp_path: Path):
    networks = source('so3')
    friction = networks.pop('Dw_net')
    imported(tmp_path, 'so3', save(tmp_path, networks))
    model = load_checkpoint(tmp_path / 'model.safetensors')
    assert 'dissipation' not in model.networks and model.card.lie_group.diagonal == 'any'
    path = save(tmp_path, networks | {'Dw_net': friction, 'X_net': friction})
    with refused(ModelError):
        imported(tmp_path, 'so3', path)
    with refused(ModelError):
        imported(tmp_path, 'se3', path)
    networks['V_net'] = friction
    with refused(ModelError):
        imported(tmp_path, 'so3', save(tmp_path, networks))


@pytest.mark.parametrize('option', [
    ('--epsilon=nan',), ('--floor=-1',), ('--activation', 'sine'),
    ('--coordinates', 'a,b')])
def test_option_that_bodies_do_not_take_is_one_line(tmp_path: Path, option: tuple):
    with refused(ParameterError):
        imported(tmp_path, 'so3', save(tmp_path, source('so3')), *option)
