# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the rerun bridge."""

from dataclasses import replace
from pathlib import Path

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros.parameters import Specification, START, Value
from hnn_vi_ros.ros.recording import SERVER_PORT, VIEWER_URL
from hnn_vi_ros.sinks.rerun_stream import Target

PARAMETERS = tuple(replace(item, changes=START) for item in (
    Specification('simulator', '/hnn_simulator', 'full name of the simulator node'),
    Specification('rerun_sink', 'connect', 'where the picture goes: to a file, to a running '
                  'viewer, to viewers that connect', choices=('file', 'connect', 'serve')),
    Specification('rerun_path', '', 'file: the .rrd file, which must not exist. connect: URL of '
                  'the viewer; empty takes the local one. serve: the port; empty takes 9876'),
))


def target_of(values: dict[str, Value]) -> Target:
    """Return where the picture goes, or raise ParameterError."""
    path = str(values['rerun_path'])
    if values['rerun_sink'] == 'connect':
        return path or VIEWER_URL
    if values['rerun_sink'] == 'serve':
        port = path or str(SERVER_PORT)
        if not (port.isdecimal() and 0 < int(port) < 65536):
            raise ParameterError(f'parameter rerun_path = {path!r}: expected a port, 1 to 65535')
        return int(port)
    if not path:
        raise ParameterError('parameter rerun_path: expected the .rrd file to write')
    return Path(path).expanduser()
