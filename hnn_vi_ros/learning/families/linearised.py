# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Momenta and forces of a machine with their derivatives by q and v, for many states at once.

Those of the networks are written out: with a = tanh(z) in each layer, the second derivatives of
a network f(x) by the features i and j of its inputs x are

    f_ij = sum over the layers of f_a tanh''(z) z_i z_j + f_x x_ij

so that one pass forward, with the derivatives z_i, and one backward, for f_a, find them all.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from hnn_vi_ros.learning.families.joint_friction import JointFriction
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.learning.families.structure import Features
import torch


class Linearised(NamedTuple):
    """
    p = M(q) v and F = dp/dt where tau is zero, with their derivatives.

    Parameters
    ----------
    p, rate : torch.Tensor, shape (N, d)
        p and F.
    p_v, p_q, rate_q, rate_v : torch.Tensor, shape (N, d, d)
        M, p_q, F_q and F_v.

    """

    p: torch.Tensor
    rate: torch.Tensor
    p_v: torch.Tensor
    p_q: torch.Tensor
    rate_q: torch.Tensor
    rate_v: torch.Tensor


class Layer(NamedTuple):
    """Activations a of a layer, (N, n), 1 - a^2, and the derivatives of its z, (m, N, n)."""

    a: torch.Tensor
    slope: torch.Tensor
    rates: torch.Tensor


def linearised(network: Any, q: torch.Tensor, v: torch.Tensor) -> Linearised:
    """Return p and F of a mechanical network with their derivatives, at q and v, both (N, d)."""
    found = []
    if network.prior is None or network.structure.residual:
        found.append(_of_networks(network, q, v))
    if network.prior is not None:
        values = network.prior.values().detach()
        rate, rate_q, rate_v = _differentiated(
            lambda q, v: network.prior.slopes(q, v, values)[1], q, v)
        M = network.prior.mass(q, values)
        # p = T_v and F = T_q - V_q of the same energy.
        found.append(Linearised((M @ v[:, :, None])[:, :, 0], rate, M, rate_v.transpose(1, 2),
                                rate_q, rate_v))
    both = found[0] if len(found) == 1 else Linearised(*map(torch.add, *found))
    rubbing, by_q, by_v = _friction(network.friction, q, v)
    return both._replace(rate=both.rate - rubbing, rate_q=both.rate_q - by_q,
                         rate_v=both.rate_v - by_v)


def _friction(friction: JointFriction, q: torch.Tensor, v: torch.Tensor
              ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return friction, (N, d), and its derivatives by q and v, (N, d, d)."""
    if friction.structure.friction_features is not None:
        return _differentiated(friction, q, v)
    with torch.enable_grad():
        at = v.detach().requires_grad_()
        value = friction(q, at)
        # That of a joint depends on its own velocity alone.
        (slope,) = torch.autograd.grad(value.sum(), at)
    found = torch.diag_embed(slope)
    return value.detach(), torch.zeros_like(found), found


def _differentiated(function: Callable[..., torch.Tensor], q: torch.Tensor, v: torch.Tensor
                    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return a function, (N, d), and its derivatives by q and v, by one backward pass."""
    with torch.enable_grad():
        at = q.detach().requires_grad_(), v.detach().requires_grad_()
        value = function(*at)
        units = torch.eye(q.shape[1], dtype=q.dtype)[:, None, :].expand(-1, len(q), -1)
        rows = torch.autograd.grad(value, at, units, is_grads_batched=True, allow_unused=True)
    none = torch.zeros_like(units)
    by_q, by_v = ((none if part is None else part).transpose(0, 1) for part in rows)
    return value.detach(), by_q, by_v


def _of_networks(network: Any, q: torch.Tensor, v: torch.Tensor) -> Linearised:
    """
    Return p and F of the networks' M and V, without friction.

    The kinetic energy T(q, v) = |L^T S v|^2 / 2 has p = T_v and F = T_q - V_q, so that F_v is
    the transpose of p_q.
    """
    S, on_diagonal = network.root_inertia, network.on_diagonal
    inputs, layers = _layers(network.mass, network.mass_features, q)
    last, scale = network.mass.linears[-1], network.mass.output_scale
    y = scale * last(layers[-1].a)
    y_rates = scale * ((layers[-1].slope * layers[-1].rates) @ last.weight.T)
    share = torch.sigmoid(y)
    rise = torch.where(on_diagonal, share, 1.0)
    L, u = network.matrix(network.positive(y)), (S * v)[:, :, None]
    w = L.transpose(1, 2) @ u
    # The derivatives of T by the entries of L.
    by_entries = (u * w.transpose(1, 2)).flatten(1) @ network.place.T
    T_f, T_ff = _curvature(network.mass, network.mass_features, inputs, layers, by_entries * rise)
    L_rates = ((rise * y_rates) @ network.place).unflatten(2, L.shape[1:])
    w_rates = L_rates.transpose(2, 3) @ u
    bend = torch.where(on_diagonal, share * (1.0 - share), 0.0) * by_entries
    T_ff = (T_ff + _products(bend * y_rates, y_rates)
            + _products(w_rates[..., 0], w_rates[..., 0]))
    G, at = network.mass_features.features, network.potential_features.features
    p_q = S[:, None] * ((L @ w_rates + L_rates @ w)[..., 0].permute(1, 2, 0) @ G)
    V_f, V_ff = _curvature(network.potential, network.potential_features, *_layers(
        network.potential, network.potential_features, q), torch.ones_like(q[:1, :1]))
    M = S[:, None] * (L @ L.transpose(1, 2) + network.floor * network.identity) * S
    return Linearised((M @ v[:, :, None])[:, :, 0], T_f @ G - V_f @ at, M, p_q,
                      G.T @ T_ff @ G - at.T @ V_ff @ at, p_q.transpose(1, 2))


def _layers(network: Perceptron, features: Features, q: torch.Tensor
            ) -> tuple[tuple[torch.Tensor, torch.Tensor], list[Layer]]:
    """Return the inputs with their derivatives by their rows, and the hidden layers."""
    inputs = features(q)
    a = (inputs[0] - network.centre) / network.scale
    tangents = inputs[1] / network.scale * features.of_feature[:, None, :]
    layers: list[Layer] = []
    for linear in network.linears[:-1]:
        if layers:
            a, tangents = layers[-1].a, layers[-1].slope * layers[-1].rates
        a = torch.tanh(linear(a))
        layers.append(Layer(a, 1.0 - a.square(), tangents @ linear.weight.T))
    return inputs, layers


def _curvature(network: Perceptron, features: Features, inputs: tuple[torch.Tensor, torch.Tensor],
               layers: list[Layer], weights: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the derivatives by features, (N, m) and (N, m, m), of weighted outputs (N, k)."""
    *hidden, last = network.linears
    back, curved = (weights * network.output_scale) @ last.weight, torch.zeros(())
    for linear, (a, slope, rates) in zip(hidden[::-1], layers[::-1], strict=True):
        back = slope * back
        curved = curved + _products(-2.0 * a * back * rates, rates)
        back = back @ linear.weight
    back, (x, slope) = back / network.scale, inputs
    own = features.of_feature.T.to(x.dtype)
    # The second derivative of a sine is its negative.
    return (back * slope) @ own, curved + torch.diag_embed(
        (torch.where(features.periodic, -x, 0.0) * back) @ own)


def _products(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the products, shape (N, m, m), of m vectors of shape (N, n) each with m others."""
    return (a[:, None] * b).sum(dim=-1).permute(2, 0, 1)
