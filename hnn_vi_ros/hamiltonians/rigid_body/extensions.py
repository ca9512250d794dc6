# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Text of other tools in a URDF that means something for the motion.

The rotor inertias of Drake are read. Of the others, such as springs of Gazebo and joints that
follow through plugins, only the remark is given that they are left out.
"""

from collections import defaultdict
from collections.abc import Iterator
import math

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import Element
from hnn_vi_ros.hamiltonians.rigid_body.elements import number_of, place_of

EXTENSION = 'extensions of other tools, ignored'
_FRICTION = 'not of URDF, ignored; for friction write damping="..." and friction="..."'
_SPRING = ('a spring of other tools, left out; add it to the scene as the effect {kind: '
           'potential, formula: stiffness*(JOINT - reference)^2/2}')
_GEAR = ('a gear without the inertia of its rotor; give rotor_inertia: {JOINT: that inertia times '
         'the ratio squared} in the scene')
_FOLLOWER = ('a plugin lets this joint follow another, but here it moves freely; write <mimic '
             'joint="..." multiplier="..."/> into the joint')
# Remarks by the name of an attribute, an element, or a parameter of ros2_control.
MEANINGS = {
    'mu_viscous': _FRICTION, 'mu_coulomb': _FRICTION, 'D': EXTENSION, 'K': EXTENSION,
    'spring_stiffness': _SPRING, 'springStiffness': _SPRING, 'mechanicalReduction': _GEAR,
    'mechanical_reduction': _GEAR, 'mimicJoint': _FOLLOWER, 'mimic': _FOLLOWER,
    'turnGravityOff': 'ignored: gravity acts on all links'}


def below(element: Element) -> Iterator[Element]:
    """Yield an element and all elements in it."""
    yield element
    for child in element.children:
        yield from below(child)


def has_meaning(name: str, text: str) -> bool:
    """Return True if an extension changes the motion with this text as its value."""
    try:
        return name in MEANINGS and float(text) != float(MEANINGS[name] is _GEAR)
    except ValueError:
        return text.strip().lower() not in ('', 'false')


def extensions_in(root: Element, where: str) -> Iterator[tuple[str, str]]:
    """Yield elements for simulators and drivers that mean something, each with its remark."""
    for element in root.children:
        if element.tag in ('gazebo', 'transmission', 'ros2_control'):
            for one in below(element):
                name = one.attributes.get('name', '') if one.tag == 'param' else one.tag
                if has_meaning(name, one.text) and not (
                        MEANINGS[name] is _GEAR and _rotor(element)):
                    yield f'{place_of(element, where)}: <{one.tag}> {one.text[:40]}', \
                        MEANINGS[name]


def rotors_in(root: Element, where: str) -> dict[str, float]:
    """
    Return rotor inertia times gear ratio squared, by joint.

    They are those of ``drake:rotor_inertia`` and ``drake:gear_ratio`` in transmissions and joints.

    Raises
    ------
    ModelError
        A number is missing, negative or not finite.

    """
    found: dict[str, float] = defaultdict(float)
    for element in (*root.named('transmission'), *root.named('joint')):
        joints = [element] if element.tag == 'joint' else element.named('joint')
        if (rotor := _rotor(element)) and joints:
            place = place_of(element, where)
            ratio = next((one for one in below(element) if one.tag == 'drake:gear_ratio'), None)
            inertia = number_of(rotor, 'value', place) * number_of(
                ratio, 'value', place, default=1.0)**2
            if not 0.0 <= inertia < math.inf:
                raise ModelError(f'{place}: drake:rotor_inertia times drake:gear_ratio squared = '
                                 f'{inertia:g} must not be negative, and must be finite')
            found[joints[0].attributes.get('name', '')] += inertia
    return found


def _rotor(element: Element) -> Element | None:
    return next((one for one in below(element) if one.tag == 'drake:rotor_inertia'), None)
