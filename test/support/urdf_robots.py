# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Robots for tests as URDF text."""

from pathlib import Path
import re

import numpy as np
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / 'config' / 'robots').glob('*.urdf'))

# All features of a URDF: a branch, revolute and prismatic joints with arbitrary axes, fixed links,
# rotated inertias, a mimic joint, a massless tip.
TREE = """\
<robot name="tree">
  <link name="ground"><inertial><mass value="9"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="stand" type="fixed"><parent link="ground"/><child link="base"/>
    <origin xyz="0.3 -0.2 1.1" rpy="0.2 -0.4 0.9"/></joint>
  <link name="base"/>
  <joint name="hip" type="continuous"><parent link="base"/><child link="trunk"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.3 0.5 -0.7"/><axis xyz="1 2 -2"/></joint>
  <link name="trunk"><inertial><origin xyz="0.1 -0.05 0.4" rpy="0.5 0.1 -0.3"/><mass value="3.5"/>
    <inertia ixx="0.2" ixy="0.01" ixz="-0.02" iyy="0.25" iyz="0.03" izz="0.1"/></inertial></link>
  <joint name="rail" type="prismatic"><parent link="trunk"/><child link="slider"/>
    <origin xyz="0 0.1 0.2" rpy="-0.2 0.4 0.1"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-0.5" upper="0.5" velocity="1" effort="90"/>
    <dynamics damping="2.5" friction="0.5"/></joint>
  <link name="slider"><inertial><origin xyz="0.05 0 0"/><mass value="0.7"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.015"/></inertial></link>
  <joint name="wrist" type="revolute"><parent link="slider"/><child link="hand"/>
    <origin xyz="0.2 0 -0.1"/><axis xyz="0 0 -1"/>
    <limit lower="-2" upper="1.5" velocity="3" effort="4"/></joint>
  <link name="hand"/>
  <joint name="grip" type="fixed"><parent link="hand"/><child link="tool"/>
    <origin xyz="0.05 0.1 0.02" rpy="1 0.2 0.3"/></joint>
  <link name="tool"><inertial><origin xyz="0 0.02 0.03" rpy="0 0.4 0"/><mass value="0.4"/>
    <inertia ixx="0.003" ixy="0.0004" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial></link>
  <joint name="finger" type="prismatic"><parent link="tool"/><child link="tip"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>
  <link name="tip"><inertial><mass value="0.1"/>
    <inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>
  <joint name="follower" type="prismatic"><parent link="tool"/><child link="tip2"/>
    <axis xyz="0 -1 0"/><limit lower="0" upper="0.1" velocity="1" effort="1"/>
    <mimic joint="finger"/></joint>
  <link name="tip2"><inertial><mass value="0.1"/>
    <inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>
  <joint name="tail" type="revolute"><parent link="trunk"/><child link="end"/>
    <origin xyz="-0.2 0 0.1" rpy="0 0 0.8"/>
    <limit lower="-1" upper="1" velocity="3" effort="4"/></joint>
  <link name="end"><inertial><origin xyz="-0.1 0.05 0.2"/><mass value="1.1"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.02"/></inertial></link>
</robot>
"""
# The mimic joint is fixed, and the order of coordinates differs from that of bodies.
TREE_ARGUMENTS = {
    'joints': ['wrist', 'tail', 'rail', 'hip', 'finger'], 'locked': {'follower': 0.03},
    'gravity': [1.0, -2.0, -9.0], 'rotor_inertia': {'hip': 0.3, 'rail': 1.5, 'wrist': 0.02}}
# Two branches with a slide, and joints fixed at nonzero values.
SMALL_ARGUMENTS = {'joints': ['tail', 'rail', 'hip'], 'rotor_inertia': {'rail': 1.5},
                   'locked': {'follower': 0.03, 'wrist': 0.6, 'finger': 0.3}}


def with_quaternions(text: str, version: str = '1.2') -> str:
    """Return a URDF with quaternions of any length and sign in place of angles."""
    def turned(angles: re.Match) -> str:
        turn = Rotation.from_euler('xyz', [float(angle) for angle in angles[1].split()])
        numbers = ' '.join(map(repr, (-3.0 * turn.as_quat()).tolist()))
        return f'quat_xyzw="{numbers}"'

    return re.sub('rpy="([^"]*)"', turned, text).replace(
        '<robot ', f'<robot version="{version}" ', 1)


def mimic_tree(rng: np.random.Generator, count: int, free: int
               ) -> tuple[str, np.ndarray, np.ndarray]:
    """
    Return a random tree of joints j0, j1, ... that follow some of them, and G and c.

    Parameters
    ----------
    rng : np.random.Generator
        Source of the tree.
    count, free : int
        Number of joints, and of those that follow none, which are the first columns of G in the
        order of their names.

    """
    order = rng.permutation(count)
    leaders = sorted(order[:free])
    G, c, mimics = np.zeros((count, free)), np.zeros(count), [''] * count
    G[leaders, range(free)] = 1.0
    for place in range(free, count):
        # Any joint before it in the order: chains, and leaders further from the base.
        joint, leader = order[place], rng.choice(order[:place])
        factor, offset = rng.uniform(0.4, 1.6) * rng.choice([-1.0, 1.0]), rng.uniform(-0.5, 0.5)
        G[joint], c[joint] = factor * G[leader], factor * c[leader] + offset
        mimics[joint] = f'<mimic joint="j{leader}" multiplier="{factor}" offset="{offset}"/>'
    parts = ['<robot name="followers"><link name="l0"/>']

    def words(*values: float) -> str:
        return ' '.join(map(repr, map(float, values)))
    for i in range(count):
        spread = rng.normal(size=(3, 3)) * 0.1
        moments = np.trace(spread @ spread.T) * np.eye(3) - spread @ spread.T
        inertia = ' '.join(f'i{"xyz"[a]}{"xyz"[b]}="{float(moments[a, b])!r}"'
                           for a in range(3) for b in range(a, 3))
        parts.append(
            f'<joint name="j{i}" type="{rng.choice(["revolute", "continuous", "prismatic"])}">'
            f'<parent link="l{rng.integers(max(0, i - 2), i + 1)}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{words(*rng.normal(size=3) * 0.3)}" '
            f'rpy="{words(*rng.normal(size=3))}"/>'
            f'<axis xyz="{words(*rng.normal(size=3))}"/>{mimics[i]}'
            '<limit lower="-9" upper="9" velocity="1" effort="1"/></joint>'
            f'<link name="l{i + 1}"><inertial><origin xyz="{words(*rng.normal(size=3) * 0.2)}"/>'
            f'<mass value="{rng.uniform(0.3, 2.0)!r}"/><inertia {inertia}/></inertial></link>')
    return ''.join([*parts, '</robot>']), G, c


def chain(masses: list[float], lengths: list[float]) -> str:
    """Return bobs on massless rods in a chain that swings about y."""
    parts = ['<robot name="chain"><link name="l0"/>']
    above = 0.0
    for i, (mass, length) in enumerate(zip(masses, lengths, strict=True), 1):
        parts.append(
            f'<joint name="j{i}" type="continuous"><parent link="l{i - 1}"/><child link="l{i}"/>'
            f'<origin xyz="0 0 {-above!r}"/><axis xyz="0 1 0"/></joint>'
            f'<link name="l{i}"><inertial><origin xyz="0 0 {-length!r}"/><mass value="{mass!r}"/>'
            '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>')
        above = length
    return ''.join([*parts, '</robot>'])
