# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Texts of Python that run in a process of their own."""

import subprocess
import sys
from typing import Any


def run_code(code: str, *words: object, **options: Any) -> subprocess.CompletedProcess:
    """Run a text with arguments; return its status and what it printed, as text."""
    return subprocess.run([sys.executable, '-c', code, *map(str, words)], **{
        'capture_output': True, 'text': True, 'timeout': 300.0, 'check': False} | options)
