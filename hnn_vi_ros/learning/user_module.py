# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Torch modules of users as families without a name: trained, then exported as graphs."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import ClassVar, Literal

from hnn_vi_ros.errors import HnnViRosError, ModelError, ParameterError
from hnn_vi_ros.files import one_line
from hnn_vi_ros.hamiltonians import read_arguments
from hnn_vi_ros.learning.export_module import copied, graph_card, graph_model
from hnn_vi_ros.learning.families.base import EnergyFamily, Scales
from hnn_vi_ros.learning.families.choices import FamilyChoice
from hnn_vi_ros.learning.fit.config import FieldConfig
from hnn_vi_ros.learning.graph_of_module import UntranslatedModule
from hnn_vi_ros.learning.import_model import function_of, made
from hnn_vi_ros.models import rows_of
import numpy as np
from pydantic import PrivateAttr
import torch

# loss(module, states, predicted, target), with predictions and data in units of the latter.
Loss = Callable[[torch.nn.Module, torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]


class ModuleChoice(FamilyChoice):
    """
    A module H(q, p) and a loss; they come from code of the user alone, not from a configuration.

    ``code`` is a digest of the module and of its file, which identifies an interrupted run.
    """

    kind: Literal['graph'] = 'graph'
    module: str
    loss: str = ''
    code: str
    refuses: ClassVar[Mapping[str, str]] = {'ensemble': 'has one module in a model file'}
    _module: torch.nn.Module = PrivateAttr()
    _loss: Loss | None = PrivateAttr()

    @classmethod
    def of(cls, module: torch.nn.Module, loss: Loss | None = None, name: str = '',
           of_loss: str = '', content: bytes = b'') -> 'ModuleChoice':
        """Return the choice of a module, with the content of its file if it came from one."""
        shapes = {key: (*part.shape,) for key, part in module.state_dict().items()}
        choice = cls(
            module=name or type(module).__name__, loss=of_loss or getattr(loss, '__name__', ''),
            code=sha256(f'{module}{shapes}'.encode() + content).hexdigest())
        choice._module, choice._loss = module, loss
        return choice

    @classmethod
    def loaded(cls, module: str, loss: str | None, seed: int) -> 'ModuleChoice':
        """Return the choice of ``FILE.py:FUNCTION`` and of a loss named likewise."""
        # Initial weights follow from the seed.
        torch.manual_seed(seed)
        return cls.of(made(*_named('--module', module)),
                      function_of(*_named('--loss', loss)) if loss else None, module, loss or '',
                      _named('--module', module)[0].read_bytes())

    def network(self, hidden: list[int], scales: Scales, seed: int) -> 'UserModule':
        """Return the module with its first weights; raise ModelError if it cannot be exported."""
        return UserModule(self._module, self._loss, scales)


class ModuleConfig(FieldConfig):
    """Configuration of a user's module, with the data, loss and steps of another one."""

    family: ModuleChoice

    @classmethod
    def of(cls, config: FieldConfig, family: ModuleChoice) -> 'ModuleConfig':
        """Return a configuration with a module in place of its family; or ValidationError."""
        return cls(**{key: getattr(config, key) for key in config.model_fields_set}
                   | {'family': family})


def _named(option: str, text: str) -> tuple[Path, str]:
    """Return the file and the function of FILE.py:FUNCTION."""
    code, _, function = text.partition('.py:')
    if not function.isidentifier():
        raise ParameterError(f'{option} {text}: expected FILE.py:FUNCTION, as net.py:make')
    return Path(f'{code}.py'), function


class UserModule(EnergyFamily):
    """
    A module of a user, in float64 and in evaluation mode.

    Parameters
    ----------
    module : torch.nn.Module
        Module H(q, p) as for ``export``, with one number a row.
    loss : callable, optional
        The user's loss, see ``misfit``.
    scales : Scales
        Scales of the data.

    Raises
    ------
    ModelError
        The module has nothing to train, is not such a function, or cannot be exported.

    """

    def __init__(self, module: torch.nn.Module, loss: Loss | None, scales: Scales):
        super().__init__()
        # The result of torch.compile cannot be traced; the module in it can.
        own, d = getattr(module, '_orig_mod', module), len(scales.q_centre)
        low, high = scales.centre - scales.half, scales.centre + scales.half
        box = np.stack([low, high], axis=1).tolist()
        if isinstance(own, torch.jit.ScriptModule):
            raise ModelError(f'{type(own).__name__}: a module of TorchScript is exported, not '
                             'trained: give the module before torch.jit.script')
        # Refused before the training, not after it.
        try:
            graph_model(own, graph_card('first', '', [f'q{k}' for k in range(d)], {
                'q': box[:d], 'p': box[d:]}), type(own).__name__)
        except UntranslatedModule as problem:
            raise UntranslatedModule(f'{problem}: write that part with other operations') \
                from problem
        self.module, self._loss = copied(own, type(own).__name__), loss
        self._arguments = read_arguments(self.module.forward)
        if not any(part.requires_grad for part in self.module.parameters()):
            raise ModelError(f'{self.name}: no weights that require a gradient, so nothing is '
                             'trained; take export for a module as it is')
        count = self.energy(torch.tensor(np.stack([low, high]))).numel()
        if count != 2:
            raise ModelError(f'{self.name}: returns {count} numbers for 2 states, expected one '
                             'number H a row')

    @property
    def name(self) -> str:
        """Return the name of the user's class."""
        return type(self.module).__name__

    @contextmanager
    def _blamed(self, what: str) -> Iterator[None]:
        """Raise ModelError in place of errors of the user's code, which may be any."""
        try:
            yield
        except HnnViRosError:
            raise
        except Exception as problem:
            raise ModelError(f'{self.name}: {what}: {type(problem).__name__}: '
                             f'{one_line(problem)[:500]}') from problem

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), at states z = (q, p), shape (N, 2 d)."""
        # On a GPU, tensors that are no buffers of the module are elsewhere.
        with self._blamed(f'{len(z)} states on {z.device}'):
            return rows_of(self.module, self._arguments)(z).reshape(-1)

    def misfit(self, states: torch.Tensor, predicted: torch.Tensor, target: torch.Tensor,
               unit: torch.Tensor) -> torch.Tensor:
        """Return the user's loss of predictions in units of the target, or the mean square."""
        if self._loss is None:
            return super().misfit(states, predicted, target, unit)
        with self._blamed('the loss'):
            value = self._loss(self.module, states, predicted / unit, target / unit)
        if not isinstance(value, torch.Tensor) or value.numel() != 1:
            found = f'shape {(*value.shape,)}' if isinstance(value, torch.Tensor) else type(
                value).__name__
            raise ModelError(f'{self.name}: the loss returned {found}, expected a tensor of one '
                             'number: end it with .mean()')
        if not value.requires_grad:
            raise ModelError(f'{self.name}: the loss does not depend on the weights: detach '
                             'nothing in it')
        return value.reshape(())
