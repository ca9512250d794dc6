# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report what the integrator auto selects, and whether that can hold the pace."""

from typing import NamedTuple

from hnn_vi_ros.accuracy.automatic_choice import Chosen, resolve, tolerance_of
from hnn_vi_ros.accuracy.calibration import Choice
from hnn_vi_ros.accuracy.trials import Tolerance
from hnn_vi_ros.ros.plumbing.rclpy_internals import Logger
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.scene.choices import AutoChoice


class LogLine(NamedTuple):
    """A line to log and to show with the samples; level is INFO, WARN or ERROR."""

    text: str
    level: str


def select(scene: Scene, largest_step: float, real_time_factor: float, logger: Logger
           ) -> tuple[Scene, Chosen | None, list[LogLine]]:
    """
    Return a scene that names its method and step size, the choice, and what to report of it.

    Parameters
    ----------
    scene : Scene
        With the integrator auto or any other.
    largest_step : float
        A time that the step must divide where the scene names none [s].
    real_time_factor : float
        The pace that is asked for; 0 for as fast as possible.
    logger : Logger
        Told before, since trying methods takes a while.

    Raises
    ------
    HnnViRosError
        No method holds the tolerance, or the scene cannot be built.

    """
    if isinstance(scene.integrator, AutoChoice):
        tolerance = tolerance_of(scene.integrator)
        logger.info(
            f'scene {scene.source}: calibrating for {tolerance.kind} {tolerance.error:g} up to '
            f'{tolerance.horizon:g} s; some seconds once, longer where methods are to be compiled')
    scene, chosen = resolve(scene, largest_step)
    return scene, chosen, report(*chosen, real_time_factor) if chosen else []


def report(tolerance: Tolerance, choice: Choice, real_time_factor: float) -> list[LogLine]:
    """Return what to report of a choice at a pace."""
    lines = [LogLine(choice.explain(tolerance), 'INFO')]
    cost = choice.seconds_per_simulated_second
    if cost * real_time_factor > 1.0:
        lines.append(LogLine(
            f'no method holds {tolerance.kind} {tolerance.error:g} up to {tolerance.horizon:g} s '
            f'at real_time_factor {real_time_factor:g} on this machine: the cheapest takes '
            f'{cost:.3g} s for each simulated second; use a real_time_factor of at most about '
            f'{1.0 / cost:.2g}, or allow a larger error', 'WARN'))
    return lines
