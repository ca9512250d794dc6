# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects that a scene can add to its Hamiltonian, by their kind in YAML."""

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.effects.damping import Damping
from hnn_vi_ros.effects.dry_friction import DryFriction
from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.effects.gravity import Gravity
from hnn_vi_ros.effects.holonomic_constraint import HolonomicConstraint
from hnn_vi_ros.effects.impact import Impact
from hnn_vi_ros.effects.joint_friction import JointFriction
from hnn_vi_ros.effects.joint_limits import JointLimits
from hnn_vi_ros.effects.learned_dissipation import LearnedDissipation
from hnn_vi_ros.effects.learned_friction import LearnedFriction
from hnn_vi_ros.effects.lugre_friction import LugreFriction
from hnn_vi_ros.effects.link_wrench import WrenchOnLinks
from hnn_vi_ros.effects.magnetic_field import MagneticField
from hnn_vi_ros.effects.motor import Motor
from hnn_vi_ros.effects.observer import Observer
from hnn_vi_ros.effects.periodic_drive import PeriodicDrive
from hnn_vi_ros.effects.potential import FormulaPotential
from hnn_vi_ros.effects.quadratic_drag import QuadraticDrag
from hnn_vi_ros.effects.servo import Servo
from hnn_vi_ros.effects.soft_wall import SoftWall
from hnn_vi_ros.effects.spring import Spring
from hnn_vi_ros.effects.thermostat import Thermostat

EFFECTS: dict[str, type[Effect]] = {
    'gravity': Gravity,
    'spring': Spring,
    'magnetic_field': MagneticField,
    'soft_wall': SoftWall,
    'potential': FormulaPotential,
    'damping': Damping,
    'dry_friction': DryFriction,
    'quadratic_drag': QuadraticDrag,
    'periodic_drive': PeriodicDrive,
    'external_force': ExternalForce,
    'link_wrench': WrenchOnLinks,
    'servo': Servo,
    'observer': Observer,
    'learned_dissipation': LearnedDissipation,
    'learned_friction': LearnedFriction,
    'thermostat': Thermostat,
    'holonomic_constraint': HolonomicConstraint,
    'impact': Impact,
    'joint_friction': JointFriction,
    'joint_limits': JointLimits,
    'lugre_friction': LugreFriction,
    'motor': Motor,
}


def effect_name(effect: Effect) -> str:
    """Return the name of an effect in a scene; for user-defined effects the name of the class."""
    return next((name for name, kind in EFFECTS.items() if type(effect) is kind),
                getattr(effect, 'label', type(effect).__name__))
