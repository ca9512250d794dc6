# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A payload on a link of a robot, which can change while a simulation runs."""

from collections.abc import Mapping
from typing import Annotated, Any

from hnn_vi_ros.errors import listed
from hnn_vi_ros.files import in_plain_words, StrictModel
from hnn_vi_ros.hamiltonians.rigid_body.robot import Inertial, Robot
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import Bodies
from hnn_vi_ros.hamiltonians.rigid_body.tree import inertia_row, links_of
import numpy as np
from pydantic import Field, ValidationError

# Squares of larger numbers may overflow.
_Bounded = Annotated[float, Field(ge=-1e6, le=1e6)]


class Payload(StrictModel):
    """A rigid body that a link carries."""

    link: str = Field(description='the link')
    mass: float = Field(0.0, ge=0.0, le=1e6, description='mass [kg]')
    centre: Annotated[list[_Bounded], Field(min_length=3, max_length=3)] = Field(
        [0.0, 0.0, 0.0], description='centre of mass in the frame of the link [m]')
    inertia: Annotated[list[_Bounded], Field(min_length=6, max_length=6)] = Field(
        [0.0] * 6, description='ixx, ixy, ixz, iyy, iyz, izz about the centre of mass, in the '
        'axes of the link [kg m2]')


def payload_of(values: Mapping[str, Any]) -> Payload:
    """Return the payload with these values, or raise ValueError with one line."""
    try:
        return Payload(**values)
    except ValidationError as problem:
        raise ValueError(f'payload: {in_plain_words(problem)}') from problem


class Carrier:
    """
    The body of a robot that carries a payload.

    Parameters
    ----------
    payload : Payload or mapping
        The payload, with its link.
    robot : Robot
        The robot.
    locked : mapping of str to float
        Joints that do not move, and their values.
    base : str
        The fixed link.

    Attributes
    ----------
    payload : Payload
        Payload of the scene.

    Raises
    ------
    ValueError
        The link does not exist or does not move, or a number is impossible.

    """

    def __init__(self, payload: Payload | Mapping[str, Any], robot: Robot,
                 locked: Mapping[str, float], base: str):
        self.payload = payload if isinstance(payload, Payload) else payload_of(payload)
        links = {name: found for name, found in links_of(robot, locked, base).items() if found[0]}
        if self.payload.link not in links:
            raise ValueError(f'payload names {self.payload.link!r}, which is not a moving link; '
                             f'valid: {listed(links)}')
        self._row, self._rotation, self._origin = links[self.payload.link]
        self._own = self.numbers(self.payload)

    def numbers(self, payload: Payload) -> np.ndarray:
        """
        Return m, h and I of a payload in the frame of the body, shape (10,); see Bodies.

        ValueError for a payload on another link, or an impossible one.
        """
        if payload.link != self.payload.link:
            raise ValueError(f'payload on {payload.link[:80]!r}: expected {self.payload.link!r}, '
                             'the link of the payload of the scene')
        inertial = Inertial.of([payload.mass, *payload.centre, *payload.inertia])
        if inertial.fault:
            raise ValueError(f'payload: {inertial.fault}')
        return inertia_row(inertial, self._rotation, self._origin)

    def mount(self, bodies: Bodies) -> Bodies:
        """Return bodies with the payload of the scene, in their own memory."""
        self._bare, inertia = bodies.inertia[self._row].copy(), bodies.inertia.copy()
        inertia[self._row] += self._own
        return bodies._replace(inertia=inertia)

    def change(self, bodies: Bodies, numbers: np.ndarray | None = None) -> None:
        """Replace the payload of the bodies, by default by that of the scene."""
        bodies.inertia[self._row] = self._bare + (self._own if numbers is None else numbers)
