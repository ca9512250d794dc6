# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The table of effects: a new row subjects an effect to every generic test."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from helpers import EPS, random_checkpoint, Uncompiled
from hnn_vi_ros.effects import Effect, EFFECTS, Potential
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.models import save_checkpoint
from mechanical_models import saved
import numpy as np
import pytest


@dataclass(frozen=True)
class EffectRow:
    """
    One row of the table: effects, with a system and a state on which they act.

    Parameters
    ----------
    name : str
        Name of the first effect, or of the combination.
    effects : tuple of (str, dict)
        Kind and arguments of each effect; the row tests the first one.
    system : str
        Hamiltonian, which is nonlinear including the effects.
    q, p : tuple of float
        Initial state.
    duration : float
        Duration of the tests' runs [s].
    arguments : dict, optional
        Arguments of the Hamiltonian.
    order : int
        Maximum order of accuracy of a method with the effects.

    """

    name: str
    effects: tuple[tuple[str, dict[str, Any]], ...]
    system: str = 'pendulum'
    q: tuple[float, ...] = (0.7,)
    p: tuple[float, ...] = (-1.2,)
    duration: float = 1.0
    arguments: tuple = ()
    order: int = 16

    @property
    def hamiltonian(self) -> Hamiltonian:
        """Return the compiled system."""
        return HAMILTONIANS[self.system](*self.arguments)

    @property
    def uncompiled(self) -> Hamiltonian:
        """Return the system as plain Python."""
        return Uncompiled(self.hamiltonian)

    def create(self, folder: Path) -> list[Effect]:
        """Return the effects; networks get random weights and are written to a folder."""
        return [create_effect(kind, arguments, folder) for kind, arguments in self.effects]


def assert_derivatives(potential: type[Potential] | Potential, own: Any, q: np.ndarray,
                       v: np.ndarray, tolerance: float) -> None:
    """Compare slope and curvature of a potential along v with differences of its energy."""
    gradient, ahead, behind, product = np.zeros((4, q.size))
    # A central difference of step d has errors of d^2 and eps / d, for derivatives below 100.
    d = float(np.cbrt(EPS))
    potential.add_gradient(own, q, gradient)
    slope = (potential.energy(own, q + d * v) - potential.energy(own, q - d * v)) / (2 * d)
    assert gradient @ v == pytest.approx(slope, abs=tolerance)
    potential.add_gradient(own, q + d * v, ahead)
    potential.add_gradient(own, q - d * v, behind)
    potential.add_hessian_vector(own, q, v, product)
    assert product == pytest.approx((ahead - behind) / (2 * d), abs=tolerance)
    # The functions add to the given array.
    potential.add_hessian_vector(own, q, v, product)
    assert product == pytest.approx((ahead - behind) / d, abs=2 * tolerance)


def create_effect(kind: str, arguments: dict[str, Any], folder: Path) -> Effect:
    """Return an effect; the network ``model`` of d coordinates is written to a folder."""
    if kind == 'learned_dissipation':
        d = arguments['model']
        path = folder / f'dissipation_{d}.safetensors'
        if not path.exists():
            save_checkpoint(path, random_checkpoint([2 * d, 8, 1], seed=3))
        arguments = {'model': str(path)}
    if kind == 'learned_friction':
        path = folder / f'{arguments["model"]}.safetensors'
        arguments = {'model': str(path) if path.exists() else saved(folder, arguments['model'])}
    return EFFECTS[kind](**arguments)


_DAMPING = ('damping', {'rate': 0.8})
_DRIVE = ('periodic_drive', {'coordinate': 'angle', 'amplitude': 3.0, 'frequency': 0.8,
                             'phase': 0.3})
_SERVO = ('servo', {'coordinates': ['angle'], 'stiffness': 6.0, 'damping': 0.5,
                    'position': [-0.4]})
_SPRING = ('spring', {'point': ['angle'], 'anchor': [0.2], 'stiffness': 5.0, 'rest_length': 0.1})
_IMPACT = ('impact', {'coordinate': 'angle', 'position': 0.3, 'side': 'above',
                      'restitution': 0.7})
_ROD = ('holonomic_constraint', {'point': ['x', 'z'], 'anchor': [0.0, 0.0], 'length': 1.0})
_WEIGHT = ('gravity', {'coordinate': 'z'})
# A bob on a rod, and a pendulum that will hit a wall.
_ON_A_ROD = {'system': 'free_particle', 'arguments': (1.0, ('x', 'z')), 'q': (0.6, 0.8),
             'p': (0.8, -0.6), 'order': 2}
_FALLING = {'q': (1.0,), 'p': (0.0,)}

EFFECT_ROWS = [
    EffectRow('gravity', (('gravity', {'coordinate': 'angle', 'acceleration': 2.0}),)),
    EffectRow('spring', (_SPRING,)),
    EffectRow('spring in a plane', (('spring', {
        'point': ['x', 'z'], 'anchor': [0.2, 0.1], 'stiffness': 5.0, 'rest_length': 0.5}),),
        'free_particle', (1.0, 0.3), (-0.4, 1.0), arguments=(1.0, ('x', 'z'))),
    EffectRow('magnetic_field', (('magnetic_field', {'plane': ['x', 'y'], 'field': 2.0}),),
              'henon_heiles', (0.3, -0.2), (0.2, 0.3), 2.0),
    EffectRow('soft_wall', (('soft_wall', {
        'coordinate': 'angle', 'position': 0.1, 'stiffness': 40.0, 'width': 0.3}),)),
    EffectRow('potential', (('potential', {
        'formula': 'k*cos(2*angle) / (2 + sin(angle))', 'parameters': {'k': 3.0}}),)),
    EffectRow('damping', (_DAMPING,)),
    EffectRow('dry_friction', (('dry_friction', {
        'coordinate': 'angle', 'force': 2.0, 'speed': 1.0}),)),
    # The motion avoids rest, where the second derivative jumps.
    EffectRow('quadratic_drag', (('quadratic_drag', {
        'coordinates': ['angle'], 'coefficient': 0.5}),), p=(-2.0,), duration=0.5),
    EffectRow('periodic_drive', (_DRIVE,)),
    EffectRow('external_force', (('external_force', {
        'coordinates': ['angle'], 'timeout': 100.0}),)),
    EffectRow('servo', (_SERVO,)),
    EffectRow('learned_dissipation', (('learned_dissipation', {'model': 1}),)),
    EffectRow('learned_friction', (('learned_friction', {'model': 'joint'}),)),
    EffectRow('learned_friction of a network', (('learned_friction', {'model': 'eccentric'}),)),
    EffectRow('thermostat', (('thermostat', {'temperature': 0.5, 'rate': 2.0, 'seed': 1}),),
              order=2),
    EffectRow('holonomic_constraint', (_ROD, _WEIGHT), **_ON_A_ROD),
    EffectRow('joint_friction', (('joint_friction', {
        'damping': {'angle': 0.3}, 'friction': {'angle': 1.0}, 'speed': 1.0}),)),
    EffectRow('joint_friction under load', (
        ('joint_friction', {'load': {'angle': 0.5}, 'speed': 1.0}),
        ('external_force', {'coordinates': ['angle'], 'timeout': 100.0}))),
    # As above, the motion avoids rest.
    EffectRow('lugre_friction', (('lugre_friction', {
        'coordinate': 'angle', 'stiffness': 6.0, 'friction': 1.0, 'stribeck': 0.5, 'speed': 1.0,
        'damping': 0.3, 'bristle_damping': 0.2, 'bristle_damping_speed': 3.0}),),
        p=(-2.0,), duration=0.5, order=2),
    EffectRow('motor', (('motor', {
        'coordinate': 'angle', 'time_constant': 0.4, 'torque_limit': 9.0, 'no_load_speed': 7.0}),
        ('external_force', {'coordinates': ['angle'], 'timeout': 100.0})), order=2),
    EffectRow('impact', (_IMPACT,), **_FALLING),
    EffectRow('joint_limits', (('joint_limits', {
        'lower': {'angle': 0.3}, 'restitution': 0.7}),), **_FALLING),
    EffectRow('impact with forces', (_IMPACT, _DAMPING, _DRIVE, _SPRING), **_FALLING),
    EffectRow('rod with forces', (_ROD, _WEIGHT, ('damping', {'rate': [0.5, 1.0]}), (
        'periodic_drive', {'coordinate': 'x', 'amplitude': 3.0, 'frequency': 0.8})),
        **_ON_A_ROD),
]

# Arguments whose first entry is a name that no coordinate has.
UNKNOWN = {
    'gravity': {'coordinate': 'w'}, 'spring': {'point': ['w'], 'anchor': [0.0]},
    'magnetic_field': {'plane': ['x', 'w']}, 'soft_wall': {'coordinate': 'w'},
    'potential': {'formula': 'x*w'},
    'dry_friction': {'coordinate': 'w', 'force': 1.0},
    'quadratic_drag': {'coordinates': ['x', 'w'], 'coefficient': 1.0},
    'periodic_drive': {'coordinate': 'w', 'amplitude': 1.0, 'frequency': 1.0},
    'external_force': {'coordinates': ['w']},
    'servo': {'coordinates': ['w'], 'stiffness': 1.0},
    'observer': {'coordinates': ['w']},
    'holonomic_constraint': {'point': ['x', 'w'], 'anchor': [0.0, 0.0]},
    'impact': {'coordinate': 'w'}, 'joint_friction': {'damping': {'x': 1.0, 'w': 1.0}},
    'joint_limits': {'upper': {'w': 1.0}},
    'lugre_friction': {'coordinate': 'w', 'stiffness': 1.0, 'friction': 1.0},
}
# Arguments with one number too many for two coordinates.
TOO_LONG = {
    'damping': {'rate': [1.0, 2.0, 3.0]}, 'thermostat': {'temperature': 1.0, 'rate': [1.0] * 3},
    'learned_dissipation': {'model': 3}, 'learned_friction': {'model': 'three'},
}
# Refused with reference to the other effects of a scene, or to H.
BESIDE = {'link_wrench', 'motor'}

# Each effect once in compiled code, with as few compilations as possible.
COMPILED = {
    'potentials and forces': ('rk4', 'henon_heiles', (), (0.3, -0.2), (0.4, 0.3), [
        ('gravity', {'coordinate': 'y', 'acceleration': 0.3}),
        ('magnetic_field', {'plane': ['x', 'y']}),
        ('spring', {'point': ['x', 'y'], 'anchor': [0.1, 0.1], 'rest_length': 0.3}),
        ('soft_wall', {'coordinate': 'x', 'position': -0.1, 'stiffness': 2.0, 'width': 0.2}),
        ('potential', {'formula': '0.1*x*y^3 - cos(x)/5'}),
        ('damping', {'rate': [0.3, 0.1]}),
        ('dry_friction', {'coordinate': 'x', 'force': 0.1, 'speed': 0.2}),
        ('quadratic_drag', {'coordinates': ['x', 'y'], 'coefficient': 0.2}),
        ('periodic_drive', {'coordinate': 'y', 'amplitude': 0.5, 'frequency': 0.7}),
        ('external_force', {'coordinates': ['y'], 'timeout': 0.25}),
        ('servo', {'coordinates': ['y', 'x'], 'stiffness': 2.0, 'damping': [0.5, 0.0],
                   'effort_limit': [0.3, 1.0], 'position': [0.1, 0.2]}),
        ('learned_dissipation', {'model': 2}),
        ('learned_friction', {'model': 'worn'}),
        ('joint_friction', {'damping': {'x': 0.2}, 'friction': {'y': 0.1}, 'speed': 0.3})]),
    'bath and wall': ('stormer_verlet', 'pendulum', (), (1.0,), (0.0,), [
        ('thermostat', {'temperature': 0.5, 'rate': 2.0, 'seed': 1}),
        ('impact', {'coordinate': 'angle', 'position': 0.3, 'restitution': 0.7}),
        ('joint_limits', {'upper': {'angle': 1.2}, 'restitution': 1.0})]),
    'internal variables': ('implicit_midpoint', 'henon_heiles', (), (0.3, -0.2), (0.4, 0.3), [
        ('lugre_friction', {'coordinate': 'x', 'stiffness': 6.0, 'friction': 0.1}),
        ('periodic_drive', {'coordinate': 'y', 'amplitude': 0.5, 'frequency': 0.7}),
        ('motor', {'coordinate': 'y', 'time_constant': 0.3}),
        ('external_force', {'coordinates': ['y'], 'timeout': 0.25})]),
    'rods': ('stormer_verlet', 'free_particle', (1.0, ('x', 'z', 'x2', 'z2')),
             (0.6, 0.8, 0.6, 1.8), (0.8, -0.6, 0.8, -0.6), [
                 ('gravity', {'coordinate': 'z2'}),
                 ('holonomic_constraint', {'point': ['x', 'z'], 'anchor': [0.0, 0.0]}),
                 ('holonomic_constraint', {'point': ['x2', 'z2'], 'other': ['x', 'z']})]),
}
