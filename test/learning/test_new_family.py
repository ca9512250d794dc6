# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A family that is a torch module and a row of models.families: trained, saved, simulated."""

from pathlib import Path
import subprocess
import sys

# In a process of its own, since schemas are built from the rows when they are imported. The energy
# has a constant mass and a network of the sine and cosine of q.
FAMILY = """\
import sys, types
from hnn_vi_ros.models.families import FAMILIES, Family

FAMILIES['turning'] = Family(trained='learning.families.turning:Turning')
from typing import Literal
from hnn_vi_ros.learning.families.base import EnergyFamily, Perceptron
from hnn_vi_ros.learning.families.choices import FamilyChoice
import numpy as np
import torch


class TurningChoice(FamilyChoice):
    kind: Literal['turning']


class Turning(EnergyFamily):
    schema = TurningChoice

    def __init__(self, choice, hidden, scales, seed):
        super().__init__()
        self.potential = Perceptron(hidden, np.zeros(2), np.ones(2), np.array([scales.energy]),
                                    seed)
        self.mass = torch.nn.Parameter(torch.ones(1, dtype=torch.float64))

    def energy(self, z):
        q, p = z.chunk(2, dim=1)
        Turning.last = self
        return 0.5 * (p / self.mass * p).sum(1) + self.potential(
            torch.cat([q.sin(), q.cos()], 1))[:, 0]


sys.modules['hnn_vi_ros.learning.families.turning'] = types.ModuleType('turning')
sys.modules['hnn_vi_ros.learning.families.turning'].Turning = Turning
from hnn_vi_ros.learning import train
from hnn_vi_ros.models import load_learned

train.main(['--config', 'turning.yaml', '--out', 'turning.safetensors'])
model = load_learned('turning.safetensors')
assert model.checkpoint.card.family == 'turning'
assert model.separable
z = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
expected = Turning.last.energy(torch.tensor(z)).detach().numpy()
found = model.energy(z[:, :1], z[:, 1:])
# H is 0 at the centre of the box, to some rounding errors of its terms.
centre = [np.mean(part, axis=1) for part in model.box]
size = 100.0 * np.finfo(float).eps * np.abs(expected).max()
assert np.abs((found - found[0]) - (expected - expected[0])).max() <= size, found - expected
assert abs(model.energy(*centre)) <= size
"""
CONFIGURATION = """\
coordinates: [{name: angle}]
family: {kind: turning}
data:
  kind: exact
  hamiltonian: {kind: pendulum}
  samples: 100
  box: {q: [[-1.0, 1.0]], p: [[-1.0, 1.0]]}
hidden: [8]
adam_steps: 20
lbfgs_steps: 20
"""


def test_family_of_a_torch_module_and_a_row_is_trained_saved_and_simulated(tmp_path: Path):
    (tmp_path / 'turning.yaml').write_text(CONFIGURATION)
    done = subprocess.run([sys.executable, '-c', FAMILY], cwd=tmp_path, capture_output=True,
                          text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
