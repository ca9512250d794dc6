# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Functions of learning return new values: none changes a network, a model or data given to it."""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import wraps
from hashlib import sha256
from importlib import import_module
import inspect
from pathlib import Path
import pkgutil
import sys
from types import FunctionType

from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.identify import arguments, identify
import hnn_vi_ros.learning as package
from hnn_vi_ros.learning import train
from hnn_vi_ros.learning.families.hnn import HNN
from hnn_vi_ros.scene import load_scene
import numpy as np
from pydantic import BaseModel
import pytest
import torch

T = 0.05 * np.arange(240)
Q, V = 0.8 * np.sin(3.0 * T)[:, None], 2.4 * np.cos(3.0 * T)[:, None]
NOISY = Q + 2e-3 * np.random.default_rng(0).normal(size=Q.shape)
FORCE = (-7.2 * np.sin(3.0 * T)[:, None] + 9.0 * np.sin(Q)) + 0.1 * V
ANGLE = T + 0.3 * np.sin(2.0 * T)
WINDOWS = {'kind': 'trajectory', 'forward_steps': 3, 'forward_lbfgs_steps': 2, 'batch': 4,
           'step_size': 0.05, 'windows': [{'duration': 0.2, 'steps': 2}]}
URDF = Path(__file__).parents[2] / 'config' / 'robots' / 'two_joint_arm.urdf'


def machine(data: dict, **family: object) -> dict:
    return {'coordinates': [{'name': 'a', 'kind': 'continuous'}], 'hidden': [4], 'loss': WINDOWS,
            'data': {'kind': 'arrays', **data},
            'family': {'kind': 'mechanical', 'friction': {'coulomb': 1}, **family}}


# A field, networks alone, and networks on a rigid body; a rigid body of velocities and one of
# positions, an exact system, the bodies of a URDF, and a body that turns.
KINDS = {
    'field': {'coordinates': [{'name': 'a'}], 'hidden': [4], 'adam_steps': 3, 'lbfgs_steps': 2,
              'data': {'kind': 'exact', 'hamiltonian': {'kind': 'pendulum'}, 'samples': 30,
                       'box': {'q': [[-1.0, 1.0]], 'p': [[-1.0, 1.0]]}}},
    'networks': machine({}, prior='none'),
    'networks on a rigid body': machine({}, prior='planar_chain'),
    'rigid body': machine({}, prior='planar_chain', residual=False),
    'rigid body of positions': machine({'v': None, 'tau': None}, prior='planar_chain',
                                       residual=False),
    'exact system': machine({}, prior='pendulum', residual=False),
    'whole motions': machine({}, prior='pendulum', residual=False) | {
        'loss': WINDOWS | {'records': True}},
    'robot': {'data': {'kind': 'excitation', 'runs': 2, 'duration': 4.0, 'interval': 0.02},
              'loss': WINDOWS | {'step_size': 0.02},
              'family': {'kind': 'rigid_body', 'file': str(URDF)}},
    'body': {'coordinates': [{'name': 'attitude', 'kind': 'rotation'}], 'hidden': [4], 'batch': 8,
             'family': {'kind': 'lie_group'}, 'data': {'kind': 'arrays', 'tau': None},
             'windows': [{'intervals': 1, 'adam_steps': 3, 'lbfgs_steps': 2,
                          'lbfgs_windows': 4}]}}
# The state of a run, which its methods advance.
STATES = {'TrainingRun', 'TrainingCheckpoint', 'Generator', 'Solutions', 'LossHistory',
          'ReadingReport'}


def parts(value: object) -> Iterator[bytes]:
    """Yield the bytes of all numbers and names in an argument."""
    if isinstance(value, np.ndarray | torch.Tensor):
        try:
            yield np.ascontiguousarray(np.asarray(
                value.detach().cpu() if isinstance(value, torch.Tensor) else value)).tobytes()
        except RuntimeError:  # a tensor that is traced has no numbers
            yield b''
    elif isinstance(value, torch.nn.Module):
        for name, part in (*value.named_parameters(), *value.named_buffers()):
            yield from (name.encode(), bytes([part.requires_grad]), *parts(part))
        for name, module in value.named_modules():
            identification = getattr(module, 'identification', None)
            yield from (name.encode(), repr(identification).encode())
    elif isinstance(value, BaseModel):
        yield repr(value).encode()
    elif is_dataclass(value) and not isinstance(value, type):
        for one in fields(value):
            yield from parts(getattr(value, one.name))
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from (repr(name).encode(), *parts(part))
    elif isinstance(value, list | tuple):
        for part in value:
            yield from parts(part)
    elif isinstance(value, str | bytes | int | float | Path | None):
        yield repr(value).encode()


def digest(value: object) -> str:
    found = sha256()
    for part in parts(value):
        found.update(part)
    return found.hexdigest()


def checked(function: Callable, changed: set[str], called: set[str]) -> Callable:
    """Return a function that notes if it changed one of its arguments."""
    signature, name = inspect.signature(function), f'{function.__module__}.{function.__name__}'

    @wraps(function)
    def call(*positional: object, **named: object) -> object:
        given = {key: value for key, value in signature.bind(
            *positional, **named).arguments.items() if type(value).__name__ not in STATES}
        called.add(name)
        before = {key: digest(value) for key, value in given.items()}
        try:
            return function(*positional, **named)
        finally:
            changed.update(f'{name}: {key}' for key, value in given.items()
                           if digest(value) != before[key])
    return call


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> tuple[set[str], set[str]]:
    """Check all functions of fit, judging and tasks; return the arguments that were changed."""
    changed, called, own = set[str](), set[str](), {}
    for room in ('fit', 'judging', 'tasks'):
        folder = import_module(f'{package.__name__}.{room}')
        for file in pkgutil.iter_modules(folder.__path__, f'{folder.__name__}.'):
            module = import_module(file.name)
            own |= {id(part): checked(part, changed, called) for part in vars(module).values()
                    if isinstance(part, FunctionType) and part.__module__ == file.name
                    and not inspect.isgeneratorfunction(inspect.unwrap(part))}
    for module in [part for name, part in sys.modules.items()
                   if name.startswith(('hnn_vi_ros.learning', 'hnn_vi_ros.identify'))]:
        for name, part in [*vars(module).items()]:
            if id(part) in own:
                monkeypatch.setattr(module, name, own[id(part)])
            elif isinstance(part, tuple) and any(id(one) in own for one in part):
                monkeypatch.setattr(module, name, type(part)(*(
                    own.get(id(one), one) for one in part)))
    monkeypatch.setattr(train, '_TASKS', {key: task._replace(**{
        name: own.get(id(part), part) for name, part in task._asdict().items()})
        for key, task in train._TASKS.items()})
    return changed, called


@pytest.mark.parametrize('kind', KINDS)
def test_no_function_of_learning_changes_an_argument(tmp_path: Path, watched, kind: str):
    changed, called = watched
    config, data = tmp_path / 'm.yaml', tmp_path / 'm.npz'
    config.write_text(dump_yaml(KINDS[kind]))
    given = [] if KINDS[kind]['data']['kind'] in ('exact', 'excitation') else [
        '--data', str(data)]
    if kind == 'body':
        zero = 0.0 * T
        np.savez(data, t=T, dq=np.stack([zero, zero, 1.0 + 0.6 * np.cos(2.0 * T)], axis=1),
                 q=np.stack([zero, zero, np.sin(ANGLE / 2), np.cos(ANGLE / 2)], axis=1))
    else:
        np.savez(data, t=T, q=NOISY if 'positions' in kind else Q, dq=V, tau=FORCE)
    train.main(['--config', str(config), *given, '--out', str(tmp_path / 'm.safetensors')])
    assert not changed
    assert len(called) > 10


def test_no_fit_of_a_scene_changes_an_argument(tmp_path: Path, watched):
    changed, called = watched
    np.savez(tmp_path / 'm.npz', t=T, q=NOISY)
    options = arguments.identify().parse_args([
        'exact_pendulum', '--data', str(tmp_path / 'm.npz'), '--free', 'length'])
    identify.identify(load_scene(options.scene), options, tmp_path)
    assert not changed
    assert any(name.endswith('fit_numbers') for name in called)


def test_digest_sees_changes_of_weights_and_of_data():
    """Otherwise the tests above could not fail."""
    network = HNN.__new__(HNN)
    torch.nn.Module.__init__(network)
    network.weight = torch.nn.Parameter(torch.zeros(2))
    changed, data = set[str](), {'q': np.zeros(3)}

    def damage(network: torch.nn.Module, data: dict) -> None:
        with torch.no_grad():
            network.weight[0] = 1.0
        data['q'][0] = 1.0
    checked(damage, changed, set())(network, data)
    assert {name.rpartition(': ')[2] for name in changed} == {'network', 'data'}
