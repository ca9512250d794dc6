# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Exact Hamiltonians, by name, formula or robot description, and mechanisms for display.

``registry`` lists them. A Hamiltonian provides H, its gradient and Hessian-vector products.
Learned Hamiltonians are in ``models``; terms that a scene adds to H are in ``effects``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.hamiltonians.arguments import Arguments, read_arguments, TIMES
    from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian, slopes_differ
    from hnn_vi_ros.hamiltonians.expressions import GRAMMAR, Graph, Reader, SWITCHES
    from hnn_vi_ros.hamiltonians.formula import Formula
    from hnn_vi_ros.hamiltonians.kinks import is_continuous
    from hnn_vi_ros.hamiltonians.mechanisms.parts import (
        AMBER, Ball, bounds_of, Cuboid, Line, Mechanism, Part, SILVER, Trail)
    from hnn_vi_ros.hamiltonians.mechanisms.registry import COORDINATES, MECHANISMS, ROTATING
    from hnn_vi_ros.hamiltonians.mechanisms.skeleton import (
        bones, joint_pose, shapes_of, skeleton, tip_of)
    from hnn_vi_ros.hamiltonians.momenta import momentum
    from hnn_vi_ros.hamiltonians.parameters import (
        check_between, check_finite, check_names_once, check_not_negative, check_positive)
    from hnn_vi_ros.hamiltonians.registry import DESCRIBED, HAMILTONIANS
    from hnn_vi_ros.hamiltonians.rigid_body.gears import ElasticDrive
    from hnn_vi_ros.hamiltonians.rigid_body.loops import (
        ClosingJoint, fill_loops, LoopRows, Loops)
    from hnn_vi_ros.hamiltonians.rigid_body.payload import Payload, payload_of
    from hnn_vi_ros.hamiltonians.rigid_body.robot import (
        Joint, JointCoordinate, JointUnits, RIGID, Robot, SLIDING, TURNING)
    from hnn_vi_ros.hamiltonians.rigid_body.small_tree import mass_kernels
    from hnn_vi_ros.hamiltonians.rigid_body.sweeps import (
        Bodies, fill_frames, Following, TreeWork)
    from hnn_vi_ros.hamiltonians.rigid_body.tree import frame_of, MOST_JOINTS
    from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import tree_kernel
    from hnn_vi_ros.hamiltonians.rigid_body.urdf import parse_urdf, read_urdf
    from hnn_vi_ros.hamiltonians.rigid_body_tree import RigidBodyTree
    from hnn_vi_ros.hamiltonians.straight_code import (
        check_names, Code, CONSTANTS, constants_of, read_formula)
    from hnn_vi_ros.hamiltonians.tracing import Symbol, trace

__getattr__, __dir__ = lazy_exports(__name__)
