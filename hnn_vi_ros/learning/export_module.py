# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Export a torch module as a model file that needs no torch."""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
import inspect
from pathlib import Path
from typing import NoReturn

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import in_plain_words, one_line
from hnn_vi_ros.learning.graph_of_module import graph_of, UntranslatedModule
from hnn_vi_ros.models import (
    Box, Checkpoint, CoordinateCard, graph_data, GraphHamiltonian, ModelCard, read_graph,
    save_checkpoint)
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.version import __version__
import numpy as np
from pydantic import ValidationError
import torch

# Number of states at which the graph must agree with the module, and the largest difference
# relative to the largest value: rounding errors of sums in another order.
_STATES, _TOLERANCE = 100, 1e-9
Intervals = Sequence[Sequence[float]]


def export(module: torch.nn.Module, path: str | Path, coordinates: Sequence[str | Coordinate],
           domain: Mapping[str, Intervals], name: str = '') -> list[str]:
    """
    Write a torch module H(q, p) as a model file, which is simulated without torch.

    Its operations are traced and stored as data; see models.graphs.operations for the list. Take
    ``hnn train`` instead for a model that is not trained yet.

    Parameters
    ----------
    module : torch.nn.Module
        A module that maps a tensor of shape (n, 2 d), with rows (q, p), to one number H [J] a row;
        or q and p, of shape (n, d) each.
        A copy of it in float64 and in evaluation mode is exported.
    path : str or Path
        The file to write, which ends in .safetensors.
    coordinates : sequence of str or Coordinate
        Names, or names with units, of the d coordinates.
    domain : mapping
        ``{'q': [(low, high), ...], 'p': [(low, high), ...]}``: the box of states in which the
        module was trained, with d intervals each.
    name : str, optional
        Name of the model; default: the name of the file.

    Returns
    -------
    list of str
        Remarks: what was changed in the copy, and the accuracy of its weights.

    Raises
    ------
    ModelError
        The module is not such a function, has an operation that graphs do not have, or the file
        exists.

    Examples
    --------
    >>> export(net, 'pendulum.safetensors', ['theta'], {'q': [(-3, 3)], 'p': [(-2, 2)]})

    """
    kind, path = type(module).__name__, Path(path)
    if not isinstance(module, torch.nn.Module):
        _refuse(kind, 'is not a torch.nn.Module: write a class of it, whose forward calls it')
    try:
        card = _card(name or path.stem, kind, coordinates, domain)
    except (KeyError, TypeError, ValueError) as problem:
        why = in_plain_words(problem) if isinstance(problem, ValidationError) else \
            f'{problem} is missing' if isinstance(problem, KeyError) else str(problem)
        raise ModelError(f'coordinates {coordinates}, domain {domain}: {why}; expected d names, '
                         'and d intervals (low, high) for each of q and p') from problem
    remarks = _remarks(module)
    own = _copied(module, kind)
    low, high = np.array([*card.box.q, *card.box.p]).T
    z = torch.tensor(np.random.default_rng(0).uniform(low, high, (_STATES, low.size)))
    function = _function(own)
    try:
        # Read as from a file, so that no model is written that cannot be read.
        graph = read_graph(*graph_data(*graph_of(function, z[:2])), low.size)
    except UntranslatedModule as problem:
        raise UntranslatedModule(f'{kind}: {problem}; it runs as a hnn_vi_ros.models.'
                                 'TorchHamiltonian, some 100 times slower') from problem
    except ModelError as problem:
        raise ModelError(f'{kind}: {problem}') from problem
    checkpoint = Checkpoint(card, {}, graph=graph)
    _check(GraphHamiltonian(checkpoint), function, z, kind)
    save_checkpoint(path, checkpoint)
    return remarks


def _card(name: str, kind: str, coordinates: Sequence[str | Coordinate],
          domain: Mapping[str, Intervals]) -> ModelCard:
    cards = [CoordinateCard(name=one, q_unit='1', p_unit='1') if isinstance(one, str) else
             CoordinateCard(name=one.name, q_unit=one.q_unit, p_unit=one.p_unit)
             for one in coordinates]
    return ModelCard(
        name=name, family='graph', coordinates=cards, box=Box(**{
            key: [[float(low), float(high)] for low, high in domain[key]] for key in ('q', 'p')}),
        dataset=f'torch module {kind}', seed=0, losses={}, training_command='export',
        package_version=__version__)


def _remarks(module: torch.nn.Module) -> list[str]:
    found = []
    if module.training and any(
            type(part).__name__.startswith(_MODES) for part in module.modules()):
        found.append('the module was in training mode; its copy was exported after eval()')
    single = [part.dtype for part in (*module.parameters(), *module.buffers())
              if part.dtype.is_floating_point and part.dtype != torch.float64]
    if single:
        eps = max(torch.finfo(dtype).eps for dtype in single)
        found.append(f'weights of {str(single[0]).removeprefix("torch.")} were converted to '
                     f'float64; their relative rounding error, up to {0.5 * eps:.1g}, remains')
    return found


# Beginnings of the names of modules that do something else in training.
_MODES = 'AlphaDropout', 'BatchNorm', 'Dropout', 'FeatureAlpha', 'InstanceNorm', 'SyncBatch'


def _copied(module: torch.nn.Module, kind: str) -> torch.nn.Module:
    """Return a copy of a module in float64 and in evaluation mode, whose weights are fixed."""
    # What torch.compile returns cannot be traced; the module in it can.
    module = getattr(module, '_orig_mod', module)
    try:
        with torch.no_grad():
            own = deepcopy(module).cpu().double().eval()
    except RuntimeError as problem:
        _refuse(kind, f'cannot be copied ({one_line(problem)[:80]}...): its weights must be plain '
                'tensors; after weight_norm, call torch.nn.utils.remove_weight_norm')
    # Module.requires_grad_ does not take scripted modules.
    for weight in own.parameters():
        weight.requires_grad_(False)
    return own


def _function(module: torch.nn.Module) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return H of one state, shape (2 d,)."""
    halves = _takes_halves(module)

    def function(z: torch.Tensor) -> torch.Tensor:
        value = module(*z[None].chunk(2, -1)) if halves else module(z[None])
        if not isinstance(value, torch.Tensor):
            raise ModelError(f'returns {type(value).__name__}, expected one tensor')
        if value.numel() != 1:
            raise ModelError(f'returns shape {(*value.shape,)} for an input of shape '
                             f'{(1, len(z))}, expected one number a row: select the column of H')
        if value.dtype != torch.float64:
            raise ModelError(f'returns {value.dtype} for an input of float64: cast nothing in it')
        return value.reshape(())
    return function


def _takes_halves(module: torch.nn.Module) -> bool:
    """Return whether a module is called with q and p, not with both in a row."""
    try:
        given = inspect.signature(module.forward).parameters.values()
    except (TypeError, ValueError):
        # Scripted modules have no signature.
        return False
    return sum(one.default is one.empty and one.kind in (
        one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD) for one in given) == 2


def _refuse(kind: str, why: str) -> NoReturn:
    raise ModelError(f'{kind} {why}')


def _check(graph: GraphHamiltonian, function: Callable[[torch.Tensor], torch.Tensor],
           z: torch.Tensor, kind: str) -> None:
    """Raise ModelError unless a graph has the values and slopes of a function at states."""
    q, p = np.split(z.numpy(), 2, axis=1)
    own = graph.energy(q, p), np.hstack(graph.gradient(q, p))
    values, slopes = [], []
    for state in z:
        x = state.clone().requires_grad_(True)
        # A module may change its argument in place.
        value = function(x.clone())
        try:
            (slope,) = torch.autograd.grad(value, x)
        except RuntimeError as problem:
            _refuse(kind, f'cannot be differentiated: {" ".join(str(problem).split())}')
        values.append(float(value.detach()))
        slopes.append(slope.numpy())
        if not np.isfinite([values[-1], *slopes[-1]]).all():
            _refuse(kind, f'returns H = {values[-1]:g} with slopes {slopes[-1]} at (q, p) = '
                    f'{state.numpy()}: reduce the domain to where both are finite')
    for what, one, other in zip(
            ('values', 'slopes'), own, (np.array(values), np.array(slopes)), strict=True):
        apart = np.abs(one - other).max()
        if not apart <= _TOLERANCE * max(np.abs(other).max(), 1e-300):
            _refuse(kind, f'has other {what} than its graph, by {apart:.3g}: ' + (
                'its operations change from state to state, or it detaches a part of its input'
                if np.isfinite(one).all() else 'solve linear systems with positive definite '
                'matrices, because rows are not exchanged'))
