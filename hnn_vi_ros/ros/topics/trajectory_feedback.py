# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Feedback on how well joints follow the path that they were given."""

from array import array

from hnn_vi_ros.run.serialization import Template
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample
import numpy as np
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint


class TrajectoryFeedback:
    """
    Serialise ~/joint_trajectory_state: three points, the reference, what is, and their difference.

    Parameters
    ----------
    simulation : Simulation
        With a servo, whose joints are always the same.

    """

    def __init__(self, simulation: Simulation):
        self._simulation, names = simulation, simulation.motors.aim.names
        zeros = array('d', [0.0] * len(names))
        self._template = Template(JointTrajectory(joint_names=list(names), points=[
            JointTrajectoryPoint(positions=zeros, velocities=zeros, accelerations=zeros),
            JointTrajectoryPoint(positions=zeros, velocities=zeros, effort=zeros),
            JointTrajectoryPoint(positions=zeros, velocities=zeros)]))

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the message of a sample, the newest one, if the servo follows a path there."""
        aim = self._simulation.motors.aim
        if not aim.on_path:
            return []
        position, velocity = sample.q[aim.columns], sample.dH_dp[aim.columns]
        effort = np.zeros(len(aim.names)) if sample.motors is None else sample.motors[aim.columns]
        for numbers, values in zip(self._template.numbers, (
                *aim.targets, position, velocity, effort, aim.targets[0] - position,
                aim.targets[1] - velocity), strict=True):
            numbers[:] = values
        self._template.set_stamp(sample.stamp)
        return [self._template.serialized()]
