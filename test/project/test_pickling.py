# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What the public functions take, return and raise goes to other processes; errors are short."""

from collections.abc import Iterator
from copy import copy, deepcopy
from importlib import import_module
import inspect
from multiprocessing import get_context
import pickle
from pkgutil import walk_packages
from typing import Any

from ensembles import ensemble
import hnn_vi_ros
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import (
    HnnViRosError, listed, ModelError, SceneError, StepFailure, StoppedByEvent)
from hnn_vi_ros.files import shipped_names
from hnn_vi_ros.hamiltonians import DESCRIBED, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.phase_space import Event
from hnn_vi_ros.run import simulate_spread
from hnn_vi_ros.scene import load_code, load_scene, Scene
from hnn_vi_ros.scene.choices import schema_of
from hnn_vi_ros.simulation import simulate, simulate_many
import numpy as np
import pytest

OF_OTHERS = ('rclpy', 'torch', 'gymnasium', 'ray', 'rerun', 'plotly', 'tqdm', 'launch')


def again(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


def test_choices_of_every_class_are_pickled():
    for classes in (EFFECTS, HAMILTONIANS, INTEGRATORS, DESCRIBED):
        for kind, cls in classes.items():
            choice = schema_of(kind, cls).model_construct(kind=kind)
            assert again(choice) == choice and type(again(choice)) is type(choice)


def test_every_shipped_scene_is_pickled_and_copied():
    for scene in map(load_scene, shipped_names('scene')):
        for other in (again(scene), deepcopy(scene), copy(scene)):
            assert other == scene and other.source == scene.source
            assert other.place('integrator') == scene.place('integrator')
        assert again(scene.hamiltonian) == scene.hamiltonian


@pytest.mark.parametrize('method', ['spawn', 'fork'])
@pytest.mark.filterwarnings('ignore::DeprecationWarning')
def test_scenes_and_trajectories_go_through_pools_of_processes(method):
    scene = Scene.build(hamiltonian={'kind': 'pendulum', 'length': 2.0}, name='mine',
                        integrator='stormer_verlet', initial_state=([1.0], [0.0]),
                        step_size=0.01, events=[{'when': 'angle = 0'}])
    with get_context(method).Pool(1) as pool:
        found = pool.apply_async(simulate, (scene, 1.5)).get(120.0)
        own = simulate(scene, 1.5)
        assert found.scene == scene and found.scene.name == 'mine'
        assert np.array_equal(found.q, own.q) and found.title == own.title
        assert [event.t for event in found.events] == [event.t for event in own.events]
        with pytest.raises(ValueError, match='duration'):
            pool.apply_async(simulate, (scene, -1.0)).get(120.0)
        # One that could not be taken apart here would be waited for without end.
        with pytest.raises(StepFailure, match='step failed at'):
            pool.apply_async(simulate, ('kepler', 1.0), {
                'initial_state': ([1e-300, 0.0], [0.0, 0.0])}).get(120.0)


def test_results_of_public_functions_are_pickled(tmp_path):
    many = simulate_many('exact_pendulum', [[0.5], [1.0]], [[0.0], [0.0]], 0.1)
    assert np.array_equal(again(many).energy, many.energy)
    save_checkpoint(tmp_path / 'several.safetensors', ensemble(2))
    spread = simulate_spread(Scene.build(
        hamiltonian={'kind': 'learned', 'model': str(tmp_path / 'several.safetensors')},
        integrator='implicit_midpoint', step_size=0.05, initial_state=([0.5], [-0.3]),
        uncertainty={}), 0.2)
    other = again(spread)
    assert np.array_equal(other.spread_q, spread.spread_q)
    assert other.mean.scene == spread.mean.scene
    assert other.mean.scene.model_digests == spread.mean.scene.model_digests


def errors() -> Iterator[type]:
    for module in walk_packages(hnn_vi_ros.__path__, 'hnn_vi_ros.'):
        if '__main__' in module.name:
            continue
        try:
            found = import_module(module.name)
        except ImportError as problem:
            assert (problem.name or '').partition('.')[0] in OF_OTHERS or (
                'takes the Python' in str(problem))
            continue
        yield from (cls for cls in vars(found).values() if inspect.isclass(cls) and issubclass(
            cls, BaseException) and cls.__module__ == module.name)


def test_every_error_is_pickled_with_its_message_and_what_it_holds():
    event = Event('a = 0', 'up', True, 1.0, np.zeros(1), np.zeros(1), 0.5)
    found = list(dict.fromkeys(errors()))
    assert {HnnViRosError, StepFailure, StoppedByEvent} < set(found)
    for cls in found:
        given: tuple[Any, ...] = {
            StepFailure: ('no convergence', 1.0, 0.1, 1e-3, 7),
            StoppedByEvent: (event, np.ones(2), np.zeros(2), load_code)}.get(cls, ('a line',))
        if '__init__' in vars(cls) and len(given) == 1:
            given *= len(inspect.signature(cls).parameters)
        problem = cls(*given)
        other = again(problem)
        assert type(other) is cls and str(other) == str(problem)
        assert vars(other).keys() == vars(problem).keys()
    stopped = again(StoppedByEvent(event, np.ones(2), np.zeros(2), load_code))
    assert stopped.event.t == 1.0 and stopped.q.tolist() == [1.0, 1.0]


# Messages of errors: one short line, whatever they quote.

def test_list_of_many_names_ends_with_how_many_more_there_are():
    numbers = ', '.join(map(str, range(20)))
    for names, text in (
            ([], ''), (['a'], 'a'), (range(3), '0, 1, 2'), ({'x': 1.0, 'y': 2.0}, 'x, y'),
            ((f'{i}' for i in range(20)), numbers),
            (range(14_000), f'{numbers}, ... (13980 more)')):
        assert listed(names) == text


def test_message_keeps_its_begin_and_its_end_whatever_it_quotes():
    error = ModelError(f'robot.urdf:7: no link {"x" * 10**6!r}; give one that there is')
    text = str(error)
    assert len(text) < 2010
    assert text.startswith("robot.urdf:7: no link 'xxx") and ' ... x' in text
    assert text.endswith("x'; give one that there is")
    assert str(again(error)) == text
    assert str(SceneError('x' * 2000)) == 'x' * 2000
