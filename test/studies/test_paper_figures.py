# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's figures: regenerated, and equal to the committed data."""

from pathlib import Path

import numpy as np
from PIL import Image
from studies import paper_figures

COMMITTED = Path(__file__).parents[2] / 'docs' / 'paper_figures.csv'


def read(path: Path) -> np.ndarray:
    """Return the table of a CSV file."""
    return np.genfromtxt(path, delimiter=',', names=True)


def test_paper_figures_are_regenerated_as_committed(tmp_path):
    assert paper_figures.main(['--out', str(tmp_path)]) == 0
    new, committed = read(tmp_path / 'paper_figures.csv'), read(COMMITTED)
    assert new.dtype.names == committed.dtype.names
    for name in new.dtype.names:
        # Written with 9 digits; another CPU rounds the network's sums in another order, and the
        # growth of a difference over 10^4 steps of an oscillator is at most linear.
        assert np.abs(new[name] - committed[name]).max() < 1e-8
    for figure in ('paper_figure_1.png', 'paper_figure_2.png'):
        with Image.open(tmp_path / figure) as image:
            assert image.width >= 900
            assert len(image.convert('L').getcolors(256)) > 20


def test_paper_figures_show_growth_for_explicit_euler_only():
    table = read(COMMITTED)
    euler, variational = table['explicit_euler_energy'], table['variational_euler_energy']
    assert euler[-1] > 2.5 * euler[0]
    assert np.abs(variational / variational[0] - 1.0).max() < 0.01
