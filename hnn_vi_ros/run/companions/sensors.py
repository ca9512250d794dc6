# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors of joints, which add noise, delay and losses to the published states."""

from collections import deque
from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.phase_space import columns, Coordinate, motor_names
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.scene import JointSensorChoice, Scene
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Rates that differ by less than this relative error are equal.
_RATE_TOLERANCE = 1e-9


class JointReading(NamedTuple):
    """Positions, velocities and efforts of the joints, shape (n,) each."""

    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


def joints_of(coordinates: Sequence[Coordinate]
              ) -> tuple[list[str], Callable[[Sample], JointReading]]:
    """
    Return the names of the joints, and a function that returns their values in a sample.

    Joints that follow others come last, without effort: the motor is that of their leader.
    """
    scalar = [c.name for c in coordinates if c.kind == 'scalar' and not c.rotor_of]
    # A slice is faster than a list of columns.
    of_q, of_p = (slice(None) if len(scalar) == len(coordinates) else [
        own.index(name) for name in scalar] for own in columns(coordinates))
    momenta, motors, still = columns(coordinates)[1], motor_names(coordinates), np.zeros(
        len(scalar))
    of_effort = of_p if scalar == momenta else [momenta.index(motors[name]) for name in scalar]

    def read(sample: Sample) -> JointReading:
        return JointReading(
            sample.q[of_q], sample.dH_dp[of_p],
            still if sample.motors is None else sample.motors[of_effort])
    following = [(scalar.index(c.name), follower) for c in coordinates for follower in c.followers]
    if not following:
        return scalar, read
    leader = [column for column, _ in following]
    multiplier, offset = np.array([follower[1:] for _, follower in following]).T

    def read_all(sample: Sample) -> JointReading:
        q, v, effort = read(sample)
        return JointReading(
            np.append(q, multiplier * q[leader] + offset),
            np.append(v, multiplier * v[leader]), np.append(effort, np.zeros(len(leader))))
    return [*scalar, *(follower.name for _, follower in following)], read_all


def joint_sensor(scene: Scene, simulation: Simulation, every: int) -> 'JointSensor | None':
    """Return the sensor of a scene's joints, with `every` steps between samples, or None."""
    if scene.measurements is None:
        return None
    joints, _ = joints_of(simulation.hamiltonian.coordinates)
    with scene.placed('measurements', 'joint_states'):
        return JointSensor(
            scene.measurements.joint_states, len(joints), every, simulation.step_size)


class JointSensor:
    """
    Sensor of the joints of a scene.

    Its reading at step k is ``y = r * round((q(t_k - delay) + bias + noise * xi_k) / r)`` with the
    resolution r; between samples q is interpolated by a cubic polynomial. The random numbers
    depend on the seed and on k alone, so a repeated run has the same readings.

    Parameters
    ----------
    choice : JointSensorChoice
        Parameters of the sensor.
    joints : int
        Number of joints n.
    every : int
        Number of steps between two samples.
    step_size : float
        Step size [s].

    Raises
    ------
    ValueError
        The rate is not that of the samples divided by a whole number, or a list does not have
        n entries.

    """

    def __init__(self, choice: JointSensorChoice, joints: int, every: int, step_size: float):
        if not joints:
            raise ValueError('the scene has no joints, which joint_states would report')
        choice.check(joints)
        self._choice, self._joints = choice, joints
        self._noise, self._bias, self._resolution, self._velocity_noise, self._effort_noise = (
            np.broadcast_to(np.asarray(value, dtype=np.float64), joints) for value in (
                choice.noise, choice.bias, choice.quantisation, choice.velocity_noise,
                choice.effort_noise))
        samples = 1.0 if choice.rate is None else 1.0 / (choice.rate * every * step_size)
        whole = max(1, round(samples))
        if abs(samples - whole) > _RATE_TOLERANCE * samples:
            raise ValueError(
                f'rate = {choice.rate:g} Hz: expected the rate of the samples, '
                f'{1.0 / (every * step_size):g} Hz, divided by a whole number')
        self._every, self._step_size = every, step_size
        self._interval, self._delay = every * whole, choice.delay / step_size
        # Steps and readings of samples, as far back as the delay.
        self._past: deque[tuple[int, JointReading]] = deque(
            maxlen=math.ceil(self._delay / every) + 2)
        self._first, self._before = 0, np.full(joints, np.nan)

    @property
    def has_velocities(self) -> bool:
        """Return True if readings have velocities."""
        return self._choice.velocity != 'none'

    def measure(self, step: int, true: JointReading) -> JointReading | None:
        """
        Return the reading at a sample, or None if the sensor gives none there.

        Parameters
        ----------
        step : int
            Number of the sample's step. One that is not beyond the last starts a new run, unless
            the position is still the same, which gives no second reading.
        true : JointReading
            True values.

        """
        last, before = self._past[-1] if self._past else (step, true)
        if step % self._every or (self._past and step == last and np.array_equal(
                true.position, before.position)):
            return None
        if not self._past or step <= last:
            self._past.clear()
            self._first, self._before = step, np.full(self._joints, np.nan)
        self._past.append((step, true))
        if step % self._interval:
            return None
        choice = self._choice
        draw = np.random.Generator(np.random.Philox(key=choice.seed, counter=step))
        lost = draw.random() < choice.dropout
        noise = draw.standard_normal((3, self._joints))
        found = self._at(step - self._delay)
        position = found.position + self._bias + self._noise * noise[0]
        coarse = self._resolution > 0.0
        position[coarse] = self._resolution[coarse] * np.round(
            position[coarse] / self._resolution[coarse])
        velocity = found.velocity + self._velocity_noise * noise[1]
        if choice.velocity == 'encoder':
            velocity = np.nan_to_num(
                (position - self._before) / (self._interval * self._step_size), nan=0.0)
        elif not self.has_velocities:
            velocity = np.empty(0)
        self._before = position
        return None if lost else JointReading(
            position, velocity, found.effort + self._effort_noise * noise[2])

    @property
    def settled(self) -> bool:
        """Return True if the last reading does not depend on when the sensor was started."""
        # Runs have their first sample one interval after their start.
        return self._first <= self._every or (
            self._past[-1][0] - self._first >= self._delay + self._every + self._interval)

    def _at(self, step: float) -> JointReading:
        """Return the values at a step: the first known sample before it."""
        later = next((i for i, (k, _) in enumerate(self._past) if k >= step), 0)
        if later == 0 or self._past[later][0] == step:
            return self._past[later][1]
        (k, a), (_, b) = self._past[later - 1], self._past[later]
        # Cubic Hermite polynomial of the positions and velocities of both samples.
        s, h = (step - k) / self._every, self._every * self._step_size
        position = a.position + s * (h * a.velocity + s * (
            3.0 * (b.position - a.position) - h * (2.0 * a.velocity + b.velocity)
            + s * (h * (a.velocity + b.velocity) - 2.0 * (b.position - a.position))))
        velocity = a.velocity + s * (
            6.0 * (1.0 - s) * ((b.position - a.position) / h - a.velocity)
            + (3.0 * s - 2.0) * (b.velocity - a.velocity))
        return JointReading(position, velocity, a.effort)
