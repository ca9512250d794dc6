# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The picture of a run, drawn by the real viewer on a virtual screen."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.simulation import Sample, Simulation
from hnn_vi_ros.viewer.rerun_sink import RerunSink
import numpy as np
from PIL import Image
import pytest


@pytest.mark.skipif(shutil.which('xvfb-run') is None,
                    reason='needs xvfb-run and a software Vulkan driver (see .ci/run)')
def test_picture_is_drawn_by_the_viewer(tmp_path):
    simulation = Simulation(HAMILTONIANS['harmonic_oscillator'](),
                            INTEGRATORS['variational_euler'](), 0.01, [1.0], [0.0])
    recording, picture = tmp_path / 'run.rrd', tmp_path / 'picture.png'
    sink = RerunSink('test', recording, simulation.hamiltonian, simulation.q.copy(),
                     simulation.p.copy(), mechanism=MECHANISMS['mass_spring'],
                     box=(np.array([[-1.0, 1.0]]), np.array([[-1.0, 1.0]])))
    for _ in range(500):
        simulation.advance(1)
        sink.write(Sample(
            simulation.steps, simulation.steps * 10_000_000, simulation.q.copy(),
            simulation.p.copy(), simulation.dH_dq.copy(), simulation.dH_dp.copy(),
            simulation.energy, simulation.modified_energy, simulation.energy / 0.5 - 1.0))
    sink.close()
    subprocess.run(
        ['xvfb-run', '-a', '-s', '-screen 0 2800x1800x24', Path(sys.prefix) / 'bin' / 'rerun',
         recording, '--window-size', '1400x900', '--screenshot-to', picture],
        env=os.environ | {'XDG_DATA_HOME': str(tmp_path), 'WGPU_BACKEND': 'vulkan'},
        capture_output=True, timeout=240, check=True)
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert('RGB')).reshape(-1, 3).astype(int)
    # Orange marks the trail and the mass, green the modified energy: both are drawn.
    red, green, blue = pixels.T
    assert ((red > 200) & (abs(green - 150) < 40) & (blue < 100)).sum() > 500
    assert ((green > 180) & (red < 120) & (blue < 140)).sum() > 100
