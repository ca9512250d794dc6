# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a tick for systems that turn, whose q has other columns than p."""

from array import array
from collections.abc import Sequence
from typing import final

from hnn_vi_ros.bags.state_message import state_names
from hnn_vi_ros.phase_space import columns, Coordinate, momentum_rates, rotations
from hnn_vi_ros.ros.messages import array_message, MessageEncoder
from hnn_vi_ros.run.serialization import Template
from hnn_vi_ros.simulation.sample import Sample
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64


@final
class TurningEncoder:
    """
    Serialise the messages of a tick of rotations and poses; see MessageEncoder.

    A quaternion has four columns, its momentum and the rate of that three. Joint states are those
    of scalar coordinates alone: no joint turns by a quaternion.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Some of which turn.

    """

    def __init__(self, coordinates: Sequence[Coordinate]):
        names, momenta = columns(coordinates)
        self._turning = rotations(coordinates)
        joints = [c.name for c in coordinates if c.kind == 'scalar']
        self._joint_q = [names.index(name) for name in joints]
        self._joint_p = [momenta.index(name) for name in joints]
        labels = state_names(names, momenta)
        self._state = Template(JointState(
            name=labels, position=array('d', [0.0] * len(labels))))
        self._q, self._p = Template(array_message(names)), Template(array_message(momenta))
        self._energy = Template(Float64())
        zeros = array('d', [0.0] * len(joints))
        self._joints = Template(JointState(
            name=joints, position=zeros, velocity=zeros, effort=zeros))

    def encode(self, sample: Sample) -> tuple[bytes, ...]:
        """Return the serialised messages of a sample, in the order of `TICK_TOPICS`."""
        rates = momentum_rates(self._turning, sample.q, sample.p, sample.dH_dq, sample.dH_dp)
        self._state.numbers[0][:] = (
            *sample.q, *sample.p, *rates, sample.energy, sample.work)
        self._q.numbers[0][:], self._p.numbers[0][:] = sample.q, sample.p
        self._energy.numbers[0][0] = sample.energy
        if self._joint_q:
            position, velocity, effort = self._joints.numbers
            position[:], velocity[:] = sample.q[self._joint_q], sample.dH_dp[self._joint_p]
            effort[:] = rates[self._joint_p]
        self._state.set_stamp(sample.stamp)
        self._joints.set_stamp(sample.stamp)
        return (self._state.serialized(), self._q.serialized(), self._p.serialized(),
                self._energy.serialized(), self._joints.serialized())


def encoder_of(coordinates: Sequence[Coordinate]) -> MessageEncoder | TurningEncoder:
    """Return what serialises the messages of a system's samples."""
    return TurningEncoder(coordinates) if rotations(coordinates) else \
        MessageEncoder([coordinate.name for coordinate in coordinates])
