# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""First steps of every shipped scene are those that were recorded; see test/fixtures."""

from fixtures.digests import offences, other_rows, own_rows, recorded
import pytest


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Work where no models are that were trained."""
    monkeypatch.chdir(tmp_path)


def test_every_scene_and_every_method_is_recorded():
    _, rows = recorded()
    assert [row[:2] for row in rows] == own_rows() + other_rows()
    assert all(row.outcome == 'done' for row in rows[:len(own_rows())])


def test_every_scene_by_its_own_method_has_the_recorded_digest():
    assert offences(own_rows()) == []


@pytest.mark.long
def test_scene_of_each_kind_by_every_method_has_the_recorded_digest():
    assert offences(other_rows()) == []
