# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Plain data of a scene, as its YAML would hold them, from what Python callers give."""

from collections.abc import Mapping
import os
from typing import Any

import numpy as np
from pydantic import BaseModel

# A part of a scene that is chosen by its kind.
Choice = str | Mapping[str, Any] | BaseModel


def of_kind(choice: Choice) -> Any:
    """Return a kind that is named alone as the mapping that YAML has for it."""
    return {'kind': choice} if isinstance(choice, str) else choice


def plain_data(value: Any) -> Any:
    """Return mappings, sequences, arrays, paths and parts of scenes as dicts, lists and values."""
    if isinstance(value, BaseModel):
        return plain_data(value.model_dump())
    if isinstance(value, Mapping):
        return {key: plain_data(part) for key, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, list | tuple | range):
        return [plain_data(part) for part in value]
    return value
