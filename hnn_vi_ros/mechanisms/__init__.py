# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Bodies to draw: a scene's coordinates as lines, boxes and balls in metres.

A mechanism is a function ``(q, reach) -> {part name: Line | Box | Ball | Trail}``. It knows no
viewer and no message type, so that one description serves every display. Axes follow REP 103:
z points up.
A part that moves carries the leading axes of q; a part that stands still has none.
"""

from collections.abc import Sequence

from hnn_vi_ros.mechanisms.drawings import (
    bouncing_mass, cartesian_pendulum, charged_particle, double_pendulum, henon_heiles, kepler,
    mass_spring, MOST_PAIRS, pendulum, spring_chain, turning_body)
from hnn_vi_ros.mechanisms.parts import Mechanism

MECHANISMS: dict[str, Mechanism] = {
    'bouncing_mass': bouncing_mass,
    'cartesian_pendulum': cartesian_pendulum,
    'charged_particle': charged_particle,
    'double_pendulum': double_pendulum,
    'henon_heiles': henon_heiles,
    'kepler': kepler,
    'mass_spring': mass_spring,
    'pendulum': pendulum,
    'spring_chain': spring_chain,
    'turning_body': turning_body,
}
# Those of bodies that turn.
TURNING = frozenset(('turning_body',))
# The numbers of columns of q that each of them draws.
COORDINATES: dict[str, Sequence[int]] = {
    'bouncing_mass': (1,),
    'cartesian_pendulum': (2, 3),
    'charged_particle': (2,),
    'double_pendulum': (2,),
    'henon_heiles': (2,),
    'kepler': (2,),
    'mass_spring': (1,),
    'pendulum': (1,),
    'spring_chain': range(2, 2 * MOST_PAIRS + 1, 2),
    'turning_body': (4, 7),
}
