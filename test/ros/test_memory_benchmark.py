# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of memory drives the files as the node does; it is run here to see that it can."""

import os
from pathlib import Path
import subprocess
import sys

DOCS = Path(__file__).parents[2] / 'docs'


def test_benchmark_of_memory_runs_and_tells_a_growth():
    paths = os.pathsep.join([str(DOCS), *filter(None, [os.environ.get('PYTHONPATH')])])
    told = subprocess.run([sys.executable, '-m', 'benchmarks.memory', 'samples', '2000'],
                          env={**os.environ, 'PYTHONPATH': paths},
                          capture_output=True, text=True, timeout=300)
    assert told.returncode == 0, told.stderr
    # Of two seconds of samples: some MB at most, where an hour is allowed 5.
    assert -20.0 < float(told.stdout) < 20.0
