# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes that tests of ensembles in torch share."""

from pathlib import Path

from hnn_vi_ros.models import Checkpoint, Layers, load_checkpoint, save_checkpoint
from hnn_vi_ros.scene import load_scene, Scene
import numpy as np
from scene_files import write_scene


def random_network(tmp_path: Path, size: float) -> Scene:
    """Return a scene of a network with large second derivatives, so that steps are hard."""
    checkpoint = load_checkpoint(Path('resource/models/stepwise_pendulum.safetensors'))
    rng = np.random.default_rng(4)
    layers = checkpoint.networks['energy']
    scaled = Layers(tuple(size * rng.normal(size=w.shape) / np.sqrt(w.shape[1])
                          for w in layers.weights), layers.biases)
    save_checkpoint(tmp_path / 'network.safetensors',
                    Checkpoint(checkpoint.card, {'energy': scaled}))
    return load_scene(write_scene(
        tmp_path / 'scene.yaml', 'hnn, model: ./network.safetensors', '', 'variational_euler',
        0.1, [0.1], [0.2]))
