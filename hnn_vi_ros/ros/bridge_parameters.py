# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the rerun bridge."""

from dataclasses import dataclass, replace

from hnn_vi_ros.ros.parameters import parameter, specifications, START


@dataclass(frozen=True)
class BridgeSettings:
    """The parameters of the rerun bridge."""

    simulator: str = parameter('/hnn_simulator', 'full name of the simulator node')
    rerun_sink: str = parameter(
        'connect', 'where the picture goes: to a file, to a running viewer, to viewers that '
        'connect', choices=('file', 'connect', 'serve'))
    rerun_path: str = parameter(
        '', 'file: the .rrd file, which must not exist. connect: URL of the viewer; empty takes '
        'the local one. serve: the port; empty takes 9876')
    trust_code: bool = parameter(
        False, 'run Python code that the scene on `~/scene` or in the bag names; `--trust-code` '
        'sets it')


PARAMETERS = tuple(replace(item, changes=START) for item in specifications(BridgeSettings))
