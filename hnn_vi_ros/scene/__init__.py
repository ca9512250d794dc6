# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Scenes: the schema of a YAML file, and the objects it describes.

A ``Scene`` is validated data; ``Scene.parts`` creates H, integrator and effects. ``simulation``
simulates them.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.scene.choices import (
        AutoChoice, Condition, JointSensorChoice, LearnedChoice, load_code)
    from hnn_vi_ros.scene.description import described_scene, ONE_RUN, only_scene
    from hnn_vi_ros.scene.key_reference import (
        definitions, describe, example, key_table, keys_of, references, SCENE_KEYS,
        scene_schema)
    from hnn_vi_ros.scene.lists import (
        lacks_a_model, list_effects, list_integrators, list_scenes, LISTS)
    from hnn_vi_ros.scene.named_numbers import (
        check_known, check_names, numbers_in, numbers_of, set_value, with_known_numbers,
        with_numbers, with_values)
    from hnn_vi_ros.scene.scene import Choice, load_scene, Parts, plain_data, Scene

__getattr__, __dir__ = lazy_exports(__name__)
