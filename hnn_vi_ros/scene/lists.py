# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Names with one-line descriptions: kinds of a scene, and shipped scenes, models, tasks."""

from collections.abc import Callable

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import DataError, ModelError
from hnn_vi_ros.files import parse_mapping, shipped_file, shipped_names
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import load_checkpoint
from hnn_vi_ros.scene.choices import summary
from hnn_vi_ros.scene.key_reference import definitions
from hnn_vi_ros.scene.scene import load_scene, Scene


def lacks_a_model(scene: Scene) -> bool:
    """Return True if a model file of a scene does not exist."""
    try:
        scene.model_files()
    except ModelError:
        return True
    return False


def list_scenes() -> dict[str, str]:
    """
    Return the description of each shipped scene.

    Examples
    --------
    >>> list_scenes()['pendulum']
    'learned pendulum of 1 kg on a rod of 1 m'

    """
    scenes = {name: load_scene(name) for name in shipped_names('scene')}
    return {name: scene.description + ' (model absent)' * lacks_a_model(scene)
            for name, scene in scenes.items()}


def list_integrators() -> dict[str, str]:
    """
    Return the description of each integrator.

    Examples
    --------
    >>> 'gauss8' in list_integrators()
    True

    """
    return {name: summary(kind) for name, kind in INTEGRATORS.items()}


def list_effects() -> dict[str, str]:
    """
    Return the description of each effect.

    Examples
    --------
    >>> 'damping' in list_effects()
    True

    """
    return {name: summary(kind) for name, kind in EFFECTS.items()}


def _models() -> dict[str, str]:
    cards = {name: load_checkpoint(shipped_file('model', name), ensembles=True).card
             for name in shipped_names('model')}
    return {name: f'{card.family} of {", ".join(own.name for own in card.coordinates)}'
            for name, card in cards.items()}


def _tasks() -> dict[str, str]:
    files = {name: shipped_file('task', name) for name in shipped_names('task')}
    return {name: parse_mapping(file.read_bytes(), file, DataError)[0]['description']
            for name, file in files.items()}


def _hamiltonians() -> dict[str, str]:
    return {name: one['description'] for name, one in definitions('hamiltonians').items()}


# The lists of `hnn list`, except that of families, which needs torch.
LISTS: dict[str, Callable[[], dict[str, str]]] = {
    'scenes': list_scenes, 'integrators': list_integrators, 'effects': list_effects,
    'hamiltonians': _hamiltonians, 'models': _models, 'tasks': _tasks}
