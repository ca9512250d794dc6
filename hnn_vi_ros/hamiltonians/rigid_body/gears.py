# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rotors of motors behind elastic gears: bodies of their own, with a coordinate each."""

from collections.abc import Mapping, Sequence
import math
from typing import Any

from hnn_vi_ros.errors import listed
from hnn_vi_ros.files import in_plain_words, StrictModel
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import Bodies, Following
from hnn_vi_ros.phase_space import rotor_name
import numpy as np
from pydantic import Field, ValidationError


class ElasticDrive(StrictModel):
    """A motor that moves a joint through an elastic gear."""

    stiffness: float = Field(gt=0.0, description=(
        'k of the torque k (theta - q) between the rotor and the joint [N m/rad], [N/m]'))
    rotor_inertia: float = Field(gt=0.0, description=(
        'inertia J of the rotor about its own axis [kg m2], [kg]'))
    gear: float = Field(1.0, gt=0.0, description=(
        'turns N of the rotor for one of theta, its angle on the side of the joint [1]'))
    damping: float = Field(0.0, ge=0.0, description=(
        "c of the torque c (theta' - q') [N m s/rad], [N s/m]"))
    backlash: float = Field(0.0, ge=0.0, description=(
        'width of the gap in which no torque acts [rad], [m]'))
    smoothing: float = Field(0.0, ge=0.0, description=(
        'width w in which the torque sets in, as w log(1 + exp(x / w)); 0: a sharp edge, at which '
        'methods of high order lose their order [rad], [m]'))

    @property
    def inertia(self) -> float:
        """Return N^2 J, the inertia of the rotor on the side of the joint."""
        return self.gear * self.gear * self.rotor_inertia


def drives_of(given: Mapping[str, Any], joints: Sequence[str]) -> dict[str, ElasticDrive]:
    """Return the drives of joints; ValueError for unknown joints and invalid numbers."""
    drives = {}
    for name, one in given.items():
        if name not in joints:
            raise ValueError(f'drives names {name!r}, which is not a joint with a coordinate; '
                             f'valid: {listed(joints)}')
        if rotor_name(name) in joints:
            raise ValueError(f'drives names {name!r}, whose rotor would have the name of the '
                             f'joint {rotor_name(name)!r}; rename that joint')
        try:
            drives[name] = one if isinstance(one, ElasticDrive) else ElasticDrive(**one)
        except ValidationError as problem:
            raise ValueError(f'drives of {name}: {in_plain_words(problem)}') from problem
        if not 0.0 < drives[name].inertia < math.inf:
            raise ValueError(f'drives of {name}: gear^2 rotor_inertia = '
                             f'{drives[name].inertia:g} must be positive and finite; check units')
    return drives


def with_rotors(bodies: Bodies, following: Following | None, drives: Sequence[ElasticDrive], d: int
                ) -> tuple[Bodies, Following | None]:
    """Return the bodies of d coordinates, and rotors that turn about fixed axes after them."""
    n, count = len(drives), len(bodies.parent) - 1
    still = [*np.eye(3).ravel(), 0.0, 0.0, 0.0]
    first = d if following is None else count
    bodies = Bodies(
        np.append(bodies.parent, np.zeros(n, bodies.parent.dtype)),
        np.append(bodies.coordinate, first + np.arange(n)),
        np.append(bodies.prismatic, np.zeros(n, bodies.prismatic.dtype)),
        np.vstack([bodies.placement, [still] * n]),
        np.vstack([bodies.inertia, np.zeros((n, bodies.inertia.shape[1]))]),
        np.append(bodies.armature, [one.inertia for one in drives]),
        bodies.gravity, np.append(bodies.load, np.zeros(n)))
    return bodies, following and Following(
        np.append(following.leader, d + np.arange(n)), np.append(following.multiplier, np.ones(n)),
        np.append(following.offset, np.zeros(n)))
