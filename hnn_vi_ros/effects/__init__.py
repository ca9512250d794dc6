# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Effects that a scene adds to its Hamiltonian: potentials, forces, constraints, impacts.

``registry`` lists them under their names in scenes; each is one file. Effects act within a step;
passive observers of a run are in ``simulation.guards``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.effects.base import (
        Effect, EffectError, EffectState, Force, InternalForce, Joined, per_coordinate, Place,
        Potential, StepLayer)
    from hnn_vi_ros.effects.commands import (
        Command, Commanded, contents, EFFORT, JointCommand, JointPath, LARGEST, LINK_WRENCH,
        LinkWrench, NUMBERS, OBSERVATION, Observation, PATH, PAYLOAD, POSITION, printable, select,
        ServoTarget, VELOCITY, whole_turns, with_arrays)
    from hnn_vi_ros.effects.damping import Damping
    from hnn_vi_ros.effects.elastic_gears import gear_effects
    from hnn_vi_ros.effects.external_force import ExternalForce
    from hnn_vi_ros.effects.input_map import has_map
    from hnn_vi_ros.effects.kernels import add_effect, add_forces
    from hnn_vi_ros.effects.learned_dissipation import LearnedDissipation
    from hnn_vi_ros.effects.learned_friction import LearnedFriction
    from hnn_vi_ros.effects.knots import CutAtKnots
    from hnn_vi_ros.effects.loops import ClosedChains, LoopManifold
    from hnn_vi_ros.effects.manifold import Manifold
    from hnn_vi_ros.effects.payload_changes import PayloadChanges
    from hnn_vi_ros.effects.periodic_drive import PeriodicDrive
    from hnn_vi_ros.effects.registry import effect_name, EFFECTS
    from hnn_vi_ros.effects.servo import OFF, Servo
    from hnn_vi_ros.effects.splitting import largest_gain
    from hnn_vi_ros.effects.time_drive import TimeDrive
    from hnn_vi_ros.effects.wrapped import Account, Wrapped

__getattr__, __dir__ = lazy_exports(__name__)
