# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Wrenches as commands: forces and torques in the frame of a body."""

from collections.abc import Sequence

from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros.phase_space import Coordinate

WRENCH_TOPIC: tuple[str, type] = ('~/wrench', WrenchStamped)


def body_of(coordinates: Sequence[Coordinate], names: Sequence[str]) -> str | None:
    """
    Return the body along whose axes all numbers of a command act, None if there is no such.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Of the system.
    names : sequence of str
        Meanings of the numbers of a command; see ExternalForce.

    """
    for coordinate in coordinates:
        kinds = {'scalar': '', 'rotation': 'r', 'pose': 'fr'}[coordinate.kind]
        own = {f'{coordinate.name}_{kind}{axis}' for kind in kinds for axis in 'xyz'}
        if names and set(names) <= own:
            return coordinate.name
    return None


def command_of(message: WrenchStamped, body: str, names: Sequence[str]) -> list[float]:
    """
    Return the command of a wrench.

    Parameters
    ----------
    message : WrenchStamped
        In the frame of the body; its stamp is not used.
    body : str
        What ``body_of`` returned.
    names : sequence of str
        Meanings of the numbers of the command.

    Raises
    ------
    ValueError
        The wrench is in another frame, or has a component that no number of a command is for.

    """
    if message.header.frame_id != body:
        raise ValueError(f'frame_id = {message.header.frame_id[:80]!r}: expected {body!r}, along '
                         'whose axes commands act')
    wrench = message.wrench
    components = {f'{body}_{kind}{axis}': getattr(vector, axis)
                  for kind, vector in (('f', wrench.force), ('r', wrench.torque))
                  for axis in 'xyz'}
    idle = [name for name, value in components.items() if name not in names and value != 0.0]
    if idle:
        raise ValueError(f'{idle[0]} = {components[idle[0]]}: nothing drives it; valid: '
                         f'{", ".join(names)}; send 0 for all others')
    return [components[name] for name in names]
