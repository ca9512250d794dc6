# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The examples in docstrings of the public API run and show what they say."""

import doctest

import hnn_vi_ros
import numpy as np


def test_examples_in_public_docstrings_are_right(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    public = {name: getattr(hnn_vi_ros, name) for name in hnn_vi_ros.__all__}
    known = public | {'np': np, 'run': hnn_vi_ros.simulate('exact_pendulum', 0.1)}
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    finder = doctest.DocTestFinder(exclude_empty=True)
    for name, item in public.items():
        # The example of `export` needs a network.
        if name not in ('__version__', 'export'):
            for test in finder.find(item, name, globs=known):
                runner.run(test)
    found = runner.summarize()
    assert found.failed == 0 and found.attempted >= 17
