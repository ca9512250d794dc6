# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Export a torch module as a model file that needs no torch."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import NoReturn

from hnn_vi_ros.errors import listed, ModelError, prefixed
from hnn_vi_ros.files import in_plain_words, one_line
from hnn_vi_ros.hamiltonians import read_arguments
from hnn_vi_ros.learning.graph_of_module import graph_of, PivotWatch, UntranslatedModule
from hnn_vi_ros.models import (
    Box, Builder, Checkpoint, complete_checkpoint, CoordinateCard, graph_data, GraphHamiltonian,
    ModelCard, read_graph, rows_of, save_checkpoint)
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.version import __version__
import numpy as np
from pydantic import ValidationError
import torch

# Number of states at which the graph must agree with the module, also in a batch of some of them,
# and the largest difference relative to the largest value or slope: rounding errors of sums in
# another order; torch's own slopes of CELU and Hardsigmoid have constants in float32.
_STATES, _BATCH, _TOLERANCE, _SLOPE_TOLERANCE = 100, 7, 1e-9, 1e-7
# Relative change of a state, by some units in the last place, that shows the rounding errors of H.
_ROUNDING = 1e-15
Intervals = Sequence[Sequence[float]]


def export(module: torch.nn.Module, path: str | Path, coordinates: Sequence[str | Coordinate],
           domain: Mapping[str, Intervals], name: str = '', overwrite: bool = False
           ) -> list[str]:
    """
    Write a torch module H(q, p) as a model file, which is simulated without torch.

    Its operations are traced and stored as data; see models.graphs.operations for the list. Take
    ``hnn train`` instead for a model that is not trained yet.

    Parameters
    ----------
    module : torch.nn.Module
        A module that maps a tensor of shape (n, 2 d), with rows (q, p), to one number H [J] a row;
        or q and p, of shape (n, d) each, in the order of its arguments, which have such names.
        An argument t is the time, of shape (n, 1) [s].
        A copy of it in float64 and in evaluation mode is exported.
    path : str or Path
        The file to write, which ends in .safetensors.
    coordinates : sequence of str or Coordinate
        Names, or names with units, of the d coordinates.
    domain : mapping
        ``{'q': [(low, high), ...], 'p': [(low, high), ...]}``: the box of states in which the
        module was trained, with d intervals each; with a time also ``'t': [(low, high)]``.
    name : str, optional
        Name of the model; default: the name of the file.
    overwrite : bool, optional
        True to replace an existing file.

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
        card = graph_card(name or path.stem, kind, coordinates, domain)
    except (KeyError, TypeError, ValueError) as problem:
        why = in_plain_words(problem) if isinstance(problem, ValidationError) else \
            f'{problem} is missing' if isinstance(problem, KeyError) else str(problem)
        raise ModelError(f'coordinates {coordinates}, domain {domain}: {why}; expected d names, '
                         'and d intervals (low, high) for each of q and p') from problem
    try:
        checkpoint, remarks = graph_model(module, card, kind)
    except UntranslatedModule as problem:
        raise UntranslatedModule(f'{problem}; it runs as a hnn_vi_ros.models.TorchHamiltonian, '
                                 'some 100 times slower') from problem
    (complete_checkpoint if overwrite and path.is_file() else save_checkpoint)(path, checkpoint)
    return remarks


def graph_model(module: torch.nn.Module, card: ModelCard, kind: str
                ) -> tuple[Checkpoint, list[str]]:
    """
    Return a module as a model with a graph that agrees with it in its box, and remarks.

    Parameters
    ----------
    module : torch.nn.Module
        The module, see ``export``.
    card : ModelCard
        Card of the model.
    kind : str
        Name of the module in messages.

    Raises
    ------
    ModelError
        The module is not a function H(q, p), or has an operation that graphs do not have.

    """
    own = copied(module, kind)
    remarks = _remarks(module)
    # Module.requires_grad_ does not take scripted modules.
    for weight in own.parameters():
        weight.requires_grad_(False)
    low, high = np.array([*card.box.q, *card.box.p, *(card.box.t or ())]).T
    z = torch.tensor(np.random.default_rng(0).uniform(low, high, (_STATES, low.size)))
    with prefixed(kind, ModelError):
        arguments = read_arguments(own.forward)
    if arguments.timed == (card.box.t is None):
        raise ModelError(f'{kind}: ' + (
            "its argument t is the time: export it with a domain that has 't': [(low, high)]; "
            'training does not support it' if arguments.timed else
            'forward has no argument t; remove t from the domain'))
    rows = rows_of(own, arguments)
    function = _function(rows, own)
    try:
        builder, output = graph_of(function, z[:2])
        _check_poses(builder, low.size)
        # Read as from a file, so that no model is written that cannot be read.
        graph = read_graph(*graph_data(builder, output), low.size)
    except ModelError as problem:
        raise type(problem)(f'{kind}: {problem}') from problem
    checkpoint = Checkpoint(card, {}, graph=graph)
    try:
        _check(GraphHamiltonian(checkpoint), function, rows, z, kind)
    except ModelError:
        raise
    except Exception as problem:  # noqa: B902  the user's code may raise any
        raise ModelError(f'{kind}: raises {type(problem).__name__} at other states than the first:'
                         f' {one_line(problem)[:300]}') from problem
    return checkpoint, remarks


def graph_card(name: str, kind: str, coordinates: Sequence[str | Coordinate],
               domain: Mapping[str, Intervals]) -> ModelCard:
    """Return the card of an exported module; see ``export``."""
    cards = [CoordinateCard(name=one, q_unit='1', p_unit='1') if isinstance(one, str) else
             CoordinateCard(name=one.name, q_unit=one.q_unit, p_unit=one.p_unit)
             for one in coordinates]
    return ModelCard(
        name=name, family='graph', coordinates=cards, box=Box(**{
            key: [[float(low), float(high)] for low, high in domain[key]]
            for key in ('q', 'p', *(['t'] if 't' in domain else []))}),
        dataset=f'torch module {kind}', seed=0, losses={}, training_command='export',
        package_version=__version__)


def _remarks(module: torch.nn.Module) -> list[str]:
    found = []
    if module.training and any(
            type(part).__name__.startswith(_MODES) for part in module.modules()):
        found.append('the module was in training mode; its copy was exported after eval()')
    return found + weights_remark([*module.parameters(), *module.buffers()])


def weights_remark(tensors: Sequence[torch.Tensor]) -> list[str]:
    """Return a remark on the precision of weights, none if they are in float64."""
    single = [part.dtype for part in tensors
              if part.dtype.is_floating_point and part.dtype != torch.float64]
    if not single:
        return []
    worst = max(single, key=lambda dtype: torch.finfo(dtype).eps)
    return [f'weights of {str(worst).removeprefix("torch.")} were converted to float64; their '
            f'relative rounding error, up to {0.5 * torch.finfo(worst).eps:.1g}, remains']


# Beginnings of the names of modules that do something else in training.
_MODES = 'AlphaDropout', 'BatchNorm', 'Dropout', 'FeatureAlpha', 'InstanceNorm', 'SyncBatch'


def copied(module: torch.nn.Module, kind: str) -> torch.nn.Module:
    """Return a copy of a module in float64 and in evaluation mode; ModelError if it has none."""
    # The result of torch.compile cannot be traced; the module in it can.
    module = getattr(module, '_orig_mod', module)
    if any(map(torch.nn.parameter.is_lazy, (*module.parameters(), *module.buffers()))):
        _refuse(kind, 'has layers without weights yet (as LazyLinear): load its weights, or call '
                'it once with a row')
    if not hasattr(module, 'training'):
        _refuse(kind, 'is frozen by torch.jit.freeze: give the module before that')
    _check_lists(module, kind)
    try:
        with torch.no_grad():
            own = deepcopy(module).cpu().double().eval()
    except RuntimeError as problem:
        _refuse(kind, f'cannot be copied ({one_line(problem)[:80]}...): its weights must be plain '
                'tensors; call torch.nn.utils.remove_weight_norm or prune.remove')
    # Copies of scripted modules have forgotten it.
    for weight, source in zip(own.parameters(), module.parameters(), strict=True):
        weight.requires_grad_(source.requires_grad)
    return own


def _check_lists(module: torch.nn.Module, kind: str) -> None:
    """Raise ModelError if layers or weights are in a list or dict, where torch sees none."""
    own = {id(part) for part in (*module.modules(), *module.parameters())}
    for name, part in module.named_modules():
        for key, value in vars(part).items():
            inside = value.values() if isinstance(value, dict) else value
            if isinstance(value, dict | list | tuple) and any(
                    isinstance(one, torch.nn.Module | torch.nn.Parameter) and id(one) not in own
                    for one in inside):
                _refuse(kind, f'holds layers or weights in a plain list or dict, '
                        f'{name}{"." * bool(name)}{key}, where torch does not see them: use '
                        'torch.nn.ModuleList, ModuleDict or ParameterList')


def _check_poses(builder: Builder, width: int) -> None:
    """Raise ModelError if a module of 18 columns reads the 9 of a rotation as one block."""
    blocks = [builder.tensors[node.tensor].ravel().tolist() for node in builder.nodes
              if node.op == 'take' and builder.shape(node.inputs[0])[-1:] == (width,)]
    if width == 18 and any(block in ([*range(12)], [*range(3, 12)]) for block in blocks):
        raise ModelError('reads the columns of a pose (position and rotation matrix, 12) and 6 '
                         'momenta, as models on SE(3) do; these are not canonical (q, p): train '
                         'the family lie_group, or export H of canonical coordinates')


def _function(rows: Callable[[torch.Tensor], torch.Tensor], module: torch.nn.Module
              ) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return H of one state, shape (2 d,)."""
    def function(z: torch.Tensor) -> torch.Tensor:
        value = rows(z[None])
        if not isinstance(value, torch.Tensor) or value.numel() != 1:
            shape = f'shape {(*value.shape,)}' if isinstance(value, torch.Tensor) else type(
                value).__name__
            inner = listed(name for name, _ in module.named_children() if not name.isdecimal())
            raise ModelError(
                f'returns {shape} for an input of shape {(1, len(z))}, expected one number H a '
                "row: of a module that returns the vector field (q', p') give the network inside "
                f'whose output is H{f" (one of {inner})" * bool(inner)}; of several outputs '
                'select that of H in forward')
        if value.dtype != torch.float64:
            raise ModelError(f'returns {value.dtype} for an input of float64: cast nothing in it')
        return value.reshape(())
    return function


def _refuse(kind: str, why: str) -> NoReturn:
    raise ModelError(f'{kind} {why}')


def _check(graph: GraphHamiltonian, function: Callable[[torch.Tensor], torch.Tensor],
           rows: Callable[[torch.Tensor], torch.Tensor], z: torch.Tensor, kind: str) -> None:
    """Raise ModelError unless a graph has the values and slopes of a function at states."""
    q, p, t = np.split(z.numpy(), graph.dimension * np.arange(1, 3), axis=1)
    t = t.sum(axis=1)
    own = graph.energy(q, p, t), np.hstack(graph.gradient(q, p, t))
    values, slopes, pivots = [], [], PivotWatch()
    for state in z:
        x = state.clone().requires_grad_(True)
        # A module may change its argument in place.
        with pivots:
            value = function(x.clone())
        try:
            (slope,) = torch.autograd.grad(value, x)
        except RuntimeError as problem:
            _refuse(kind, f'cannot be differentiated: {" ".join(str(problem).split())}')
        values.append(float(value.detach()))
        slopes.append(slope.numpy()[:2 * graph.dimension])
        if not np.isfinite([values[-1], *slopes[-1]]).all():
            _refuse(kind, f'returns H = {values[-1]:g} with slopes {slopes[-1]} at (q, p) = '
                    f'{state.numpy()}: reduce the domain to where both are finite')
    if not pivots.safe:
        _refuse(kind, 'solves linear systems whose pivots vanish or change sign in the domain, '
                'and rows are not exchanged: use positive definite matrices, or write the '
                'solution out')
    noise = [(function(state * (1.0 + _ROUNDING)) - function(state.clone())).item()
             for state in z[:_BATCH]]
    if np.abs(values).max() <= 10.0 * np.abs(noise).max():
        _refuse(kind, 'is 0 up to rounding errors: it may sum the output of a normalisation')
    for what, one, other, tolerance in zip(
            ('values', 'slopes'), own, (np.array(values), np.array(slopes)),
            (_TOLERANCE, _SLOPE_TOLERANCE), strict=True):
        apart = np.abs(one - other).max()
        if not apart <= tolerance * max(np.abs(other).max(), 1e-300):
            _refuse(kind, f'has other {what} than its graph, by {apart:.3g}: its operations '
                    'change from state to state, or it detaches a part of its input')
    # Products of one row and of several have different rounding errors.
    error, steepest = _SLOPE_TOLERANCE * max(np.abs(values).max(), 1e-300), max(
        np.abs(slopes).max(), 1e-300)
    plain = values[0]
    # A module may differentiate inside, which needs gradients.
    with suppress(Exception), torch.no_grad():
        plain = float(function(z[0].clone()))
    if not abs(plain - values[0]) <= error:
        _refuse(kind, f'has other values without gradients, by {abs(plain - values[0]):.3g}: it '
                'depends on requires_grad or on torch.is_grad_enabled()')
    x = z[:_BATCH].clone().requires_grad_(True)
    try:
        together = rows(x.clone()).reshape(-1)
        # Different weights of the rows: their sum would not show which value is whose.
        weights = torch.linspace(1.0, 2.0, len(together), dtype=x.dtype)
        (moved,) = torch.autograd.grad((weights * together).sum(), x)
    except Exception:  # noqa: B902  a module may support single rows only
        return
    # One number is the sum over the rows.
    known = np.array(values[:_BATCH]) if len(together) > 1 else np.sum(values[:_BATCH])
    if len(together) not in (1, _BATCH) or not (
            np.abs(together.detach().numpy() - known).max() <= _BATCH * error
            and np.abs(moved.numpy()[:, :2 * graph.dimension]
                       - weights.numpy()[:, None] * slopes[:_BATCH]).max()
            <= 2.0 * _SLOPE_TOLERANCE * steepest):
        _refuse(kind, f'has other values in a batch of {_BATCH} rows: it mixes the rows of its '
                'input, or uses only the first; index columns as in x[:, 0], and avoid layers '
                'that depend on the batch')
