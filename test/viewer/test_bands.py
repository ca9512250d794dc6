# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The spread of an ensemble is shown as bands around coordinates and momenta."""

from dataclasses import replace
from pathlib import Path

from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.simulation import Sample
from hnn_vi_ros.viewer.rerun_blueprint import BANDS
from hnn_vi_ros.viewer.rerun_sink import RerunSink
import numpy as np
import pytest
from rerun_reader import read

STATE = Sample(0, 0, np.array([1.0]), np.array([-2.0]), np.array([1.0]), np.array([0.0]), 0.5,
               0.5, 0.0)


@pytest.mark.parametrize('band', [True, False])
def test_bands_are_the_state_less_and_plus_its_spread_where_there_are_members(
        tmp_path: Path, band: bool):
    path = tmp_path / 'recording.rrd'
    sink = RerunSink('test', path, HarmonicOscillator(), STATE.q, STATE.p, interval=0, band=band,
                     box=(np.array([[0.0, 2.0]]), np.array([[-3.0, 0.0]])))
    for step in range(3):
        sink.write(replace(STATE, step=step, stamp=step * 10**7,
                           spread=np.array([0.25, 0.5]) * step))
    sink.close()
    entities = read(path)
    if not band:
        assert not set(BANDS) & set(entities)
        return
    q, p = (entities[path]['Scalars:scalars'] for path in BANDS)
    assert q == [[1.0 - 0.25 * k, 1.0 + 0.25 * k] for k in range(3)]
    assert p == [[-2.0 - 0.5 * k, -2.0 + 0.5 * k] for k in range(3)]
