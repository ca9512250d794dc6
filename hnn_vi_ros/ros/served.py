# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of the node that services act on."""

from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from hnn_vi_ros.ros.control import Control
from hnn_vi_ros.ros.parameters import Settings
from hnn_vi_ros.ros.run import Run
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter


class Simulator(Protocol):
    """Node as the services need it; the refusal says why there is no run."""

    run: Run | None
    control: Control | None
    settings: Settings
    state: int
    stop: Callable[[int, str], None]
    change_state: Callable[[int], Awaitable[bool]]
    in_thread: Callable[[Callable[[], Any]], Awaitable[Any]]
    set_parameters_atomically: Callable[[list[Parameter]], SetParametersResult]
    refusal: str
