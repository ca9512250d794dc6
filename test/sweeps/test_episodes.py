# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Episodes of sweeps: which are written."""

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.sweeps.episodes import selected
from hnn_vi_ros.sweeps.running import main
from messages import refused
import pytest

# The third one is no pendulum; the fourth ends by its event.
SCENE = """\
hamiltonian: {kind: pendulum, mass: 1.0, length: 1.0, gravity: 9.81}
integrator: {kind: variational_euler}
step_size: 0.01
initial_state: {q: [1.0], p: [0.0]}
events: [{when: angle = -1.2, then: stop}]
"""
SWEEP = """\
description: pendulums that swing
scene: scene.yaml
duration: 1.0
every: 2
vary:
- {kind: values, key: hamiltonian.length, values: [1.0, -1.0]}
- {kind: values, key: initial_state.q.angle, values: [0.5, 1.5]}
"""


@pytest.fixture(scope='module')
def sweep_file(tmp_path_factory):
    """Return a sweep of four trajectories."""
    folder = tmp_path_factory.mktemp('episodes')
    (folder / 'scene.yaml').write_text(SCENE)
    (folder / 'sweep.yaml').write_text(SWEEP)
    return folder / 'sweep.yaml'


def test_selections_are_numbers_and_slices():
    assert selected('', 3) == [0, 1, 2]
    assert selected('7, 2,2:9:3', 10) == [2, 5, 7, 8]
    assert selected('8:', 10) == [8, 9] and selected('::5', 10) == [0, 5]
    for text in ('x', '1:2:3:4', '-1', '10', '1,', '5:5', '0:9:0'):
        with refused(HnnViRosError):
            selected(text, 10)


@pytest.mark.parametrize('arguments', [
    ['--select', '0'], ['--episodes', 'mcap', '--jobs', '2'],
    ['--episodes', 'mcap', '--select', '4'],
    ['--episodes', 'mcap', '--select', '0']], ids=' '.join)
def test_episodes_that_cannot_be_written_are_one_line(sweep_file, tmp_path, arguments):
    with refused(HnnViRosError):
        main([str(sweep_file), '--out', str(tmp_path / 'out'), *arguments])
    assert not (tmp_path / 'out').exists()
