# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trainings without their pictures, which would take longer than a small training."""

from matplotlib.figure import Figure
import pytest
from trainings import empty_picture


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave pictures empty, unless a test asks for ``drawn``."""
    if 'drawn' not in request.fixturenames:
        monkeypatch.setattr(Figure, 'savefig', empty_picture)


@pytest.fixture
def drawn() -> None:
    """Have pictures drawn."""
