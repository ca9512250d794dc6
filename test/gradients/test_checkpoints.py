# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Snapshots of a run on the way back: how many are kept, and how often steps are taken again."""

import math

from helpers import Uncompiled
from hnn_vi_ros.gradients.checkpoints import Checkpoints
from hnn_vi_ros.gradients.derivatives import DifferentiableRun
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
import numpy as np
import pytest

pytestmark = pytest.mark.filterwarnings('ignore:Uncompiled is not a tanh network')


def walked(count: int, most: int, times: int = 1) -> Checkpoints:
    """Return what became of a way back, whose order and places are checked."""
    kept, at = Checkpoints(count, most), 0
    for piece in range(count):
        kept.pass_by(piece, lambda piece=piece: {'at': np.array(piece)})

    def restore(snapshot: dict) -> None:
        nonlocal at
        at = int(snapshot['at'])

    def advance(piece: int) -> None:
        nonlocal at
        assert piece == at
        at += 1
    for _ in range(times):
        order = []
        for piece in kept.backwards(restore, advance, lambda: {'at': np.array(at)}):
            assert at == piece
            order.append(piece)
            at += 1
        assert order == [*reversed(range(count))]
    return kept


@pytest.mark.parametrize('count', [1, 2, 3, 7, 20, 21, 84, 100])
@pytest.mark.parametrize('most', [1, 2, 3, 5, 100])
def test_no_more_snapshots_are_kept_and_the_fewest_pieces_taken_again(count, most):
    kept = walked(count, most)
    assert kept.highest == min(count, most)
    # Griewank and Walther: t n - C(s + t, t - 1) in all, of which the first way through takes
    # those up to the last snapshot that it keeps.
    times = next(t for t in range(count + 1) if math.comb(most + t, t) >= count)
    least = times * count - math.comb(most + times, times - 1) if times else 0
    assert kept.repeated == least - max(kept._on_the_way)


def test_the_way_back_can_be_asked_for_again():
    once, twice = walked(40, 3), walked(40, 3, 2)
    assert twice.highest == 3
    # The second time what the first way through kept is to be reached again.
    assert twice.repeated == 2 * once.repeated + max(once._on_the_way)


def test_gradients_are_the_same_bit_by_bit_however_few_snapshots_are_kept():
    run = DifferentiableRun(Uncompiled(HAMILTONIANS['henon_heiles']()),
                            INTEGRATORS['implicit_midpoint'](), 0.05)
    z = np.array([[0.1, -0.4, 0.3, 0.2], [0.2, 0.1, -0.1, 0.3]])
    cotangents = np.random.default_rng(0).normal(size=(33, *z.shape))
    found = []
    for checkpoints in (None, 3, 1):
        run.record(z, 32, 20, checkpoints=checkpoints)
        found.append((*run.pull_back(cotangents, [run.on_step_size]), run.recorded.blocks[0].kept))
    assert [kept.highest for *_, kept in found] == [9, 3, 1]
    for gradient, others, _ in found[1:]:
        assert np.array_equal(gradient, found[0][0])
        assert np.array_equal(others, found[0][1])
