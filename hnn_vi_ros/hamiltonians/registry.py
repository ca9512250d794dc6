# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hamiltonians: analytic ones by name, others by their description."""

from hnn_vi_ros.hamiltonians.ball_joint_pendulum import BallJointPendulum
from hnn_vi_ros.hamiltonians.double_pendulum import DoublePendulum
from hnn_vi_ros.hamiltonians.formula import Formula
from hnn_vi_ros.hamiltonians.fput_chain import FputChain
from hnn_vi_ros.hamiltonians.free_particle import FreeParticle
from hnn_vi_ros.hamiltonians.free_rigid_body import FreeRigidBody
from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.hamiltonians.heavy_top import HeavyTop
from hnn_vi_ros.hamiltonians.henon_heiles import HenonHeiles
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
from hnn_vi_ros.hamiltonians.quadrotor import Quadrotor
from hnn_vi_ros.hamiltonians.rigid_body_tree import RigidBodyTree
from hnn_vi_ros.hamiltonians.tao import Tao

HAMILTONIANS = {
    'ball_joint_pendulum': BallJointPendulum,
    'double_pendulum': DoublePendulum,
    'fput_chain': FputChain,
    'free_particle': FreeParticle,
    'free_rigid_body': FreeRigidBody,
    'harmonic_oscillator': HarmonicOscillator,
    'heavy_top': HeavyTop,
    'henon_heiles': HenonHeiles,
    'kepler': Kepler,
    'pendulum': Pendulum,
    'quadrotor': Quadrotor,
    'tao': Tao,
}
# Systems defined in a scene by a formula or a file, whose path it resolves; see scene.
DESCRIBED = {
    'formula': Formula,
    'urdf': RigidBodyTree,
}
