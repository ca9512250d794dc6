# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run Python code in a separate process."""

import subprocess
import sys
from typing import Any


def run_code(code: str, *words: object, **options: Any) -> subprocess.CompletedProcess:
    """Run a code string with arguments; return its status and its output as text."""
    return subprocess.run([sys.executable, '-c', code, *map(str, words)], **{
        'capture_output': True, 'text': True, 'timeout': 300.0, 'check': False} | options)
