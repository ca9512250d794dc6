# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Data that do not fit a schema, in the table of messages."""

from collections.abc import Iterator
from contextlib import contextmanager

from hnn_vi_ros.files.yaml_file import in_plain_words
from messages import assert_message
from pydantic import ValidationError
import pytest


@contextmanager
def misfit() -> Iterator[None]:
    """Expect data that do not fit a schema, for the reason in the table of messages."""
    with pytest.raises(ValidationError) as caught:
        yield
    assert_message(in_plain_words(caught.value))
