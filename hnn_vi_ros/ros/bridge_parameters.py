# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the rerun bridge."""

from dataclasses import replace

from hnn_vi_ros.ros.parameters import Specification, START

PARAMETERS = tuple(replace(item, changes=START) for item in (
    Specification('simulator', '/hnn_simulator', 'full name of the simulator node'),
    Specification('rerun_sink', 'connect', 'where the picture goes: to a file, to a running '
                  'viewer, to viewers that connect', choices=('file', 'connect', 'serve')),
    Specification('rerun_path', '', 'file: the .rrd file, which must not exist. connect: URL of '
                  'the viewer; empty takes the local one. serve: the port; empty takes 9876'),
    Specification('trust_code', False, 'run Python code that the scene on `~/scene` or in the bag '
                  'names; `--trust-code` sets it'),
))
