# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Motions of a simulated arm with friction, as a driver of a robot would publish them."""

from collections.abc import Sequence
from pathlib import Path

from hnn_vi_ros.effects import Effect, ExternalForce
from hnn_vi_ros.effects.joint_friction import JointFriction
from hnn_vi_ros.files import share_folder
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.integrators import ImplicitMidpoint
from hnn_vi_ros.learning import EvenMotion
from hnn_vi_ros.learning.judging.evaluation import variance_of
from hnn_vi_ros.learning.judging.predictors import Predict
from hnn_vi_ros.simulation import Simulation
import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import chirp

# The names of the measures.
MEAN, LEAST = (f'followed for [s], {which} of 4 runs' for which in ('mean', 'least'))

JOINTS = ('shoulder', 'elbow')
_DAMPING = {'shoulder': 0.6, 'elbow': 0.2}     # [N m s/rad]
_FRICTION = {'shoulder': 0.5, 'elbow': 0.2}    # [N m]
_FRICTION_SPEED = 0.05                         # [rad/s]
# Torques of the motors: largest ones of each joint [N m], and from where to where they go [Hz].
_TORQUES = np.array([[3.0, 8.0], [0.8, 2.5]])
_FREQUENCIES = np.array([[0.05, 0.3], [1.0, 2.5]])
_DURATION, _STEP = 40.0, 0.001                 # [s]
# Messages: how often, how far their times are off, how many are lost.
_INTERVAL, _JITTER, _LOST = 0.004, 0.0004, 0.02
# An encoder of 12 bits; the driver's own velocities; torques from currents.
_Q_STEP, _V_NOISE, _V_STEP, _TAU_STEP = 2.0 * np.pi / 4096, 0.03, 0.01, 0.01
_TRAINING, _TEST = 6, 4
# A prediction is valid until its error exceeds this many standard deviations.
_FOLLOWED = 0.4


def write_arm(path: Path) -> None:
    """
    Write motions of config/robots/two_joint_arm.urdf to an .npz file.

    The arm hangs, has viscous and dry friction, and begins anywhere near rest; each motor has a
    chirp for its torque. Messages come at 250 Hz, with jitter; 2 % of them are lost; positions,
    velocities and torques are quantised, velocities are noisy as well.

    Parameters
    ----------
    path : Path
        The file, of runs train_0, ... and test_0, ... with keys t, q, dq, tau.

    """
    arm, effects = the_arm()
    simulation = Simulation(arm, ImplicitMidpoint(), _STEP, np.zeros(2), np.zeros(2), effects)
    names = [f'train_{k}' for k in range(_TRAINING)] + [f'test_{k}' for k in range(_TEST)]
    rng = np.random.default_rng(0)
    np.savez(path, **{f'{name}/{key}': values for name in names
                      for key, values in _run(simulation, rng).items()})


def the_arm() -> tuple[RigidBodyTree, list[Effect]]:
    """Return the arm, and its friction and motors."""
    arm = RigidBodyTree(str(share_folder() / 'config' / 'robots' / 'two_joint_arm.urdf'))
    return arm, [JointFriction(damping=_DAMPING, friction=_FRICTION, speed=_FRICTION_SPEED),
                 ExternalForce([*JOINTS])]


def _run(simulation: Simulation, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the arrays that the driver publishes in one run."""
    size = rng.uniform(*_TORQUES.T)
    begin, end = rng.uniform(*_FREQUENCIES.T, size=(2, 2)).T
    phase = rng.uniform(0.0, 360.0, size=2)

    def torques(t: np.ndarray) -> np.ndarray:
        """Return the torques of the motors, shape (N, 2)."""
        return np.stack([size[i] * chirp(t, begin[i], _DURATION, end[i], phi=phase[i])
                         for i in range(2)], axis=-1)
    n = round(_DURATION / _STEP)
    t = _STEP * np.arange(n + 1)
    q, v = np.empty((2, n + 1, 2))
    simulation.restart(rng.uniform(-0.5, 0.5, size=2), np.zeros(2))
    for k, tau in enumerate(torques(t + 0.5 * _STEP)):
        q[k], v[k] = simulation.q, simulation.dH_dp
        simulation.set_command(tau)
        simulation.advance(1)
    at = _INTERVAL * np.arange(1, round(_DURATION / _INTERVAL))
    at = at + np.clip(_JITTER * rng.normal(size=len(at)), -0.4 * _INTERVAL, 0.4 * _INTERVAL)
    at = at[rng.random(len(at)) >= _LOST]
    motion = CubicHermiteSpline(t, q, v)
    speeds = motion(at, 1) + _V_NOISE * rng.normal(size=(len(at), 2))
    return {'t': at, 'q': _Q_STEP * np.round(motion(at) / _Q_STEP),
            'dq': _V_STEP * np.round(speeds / _V_STEP),
            'tau': _TAU_STEP * np.round(torques(at) / _TAU_STEP)}


def followed_times(predict: Predict, test: Sequence[EvenMotion], folder: Path
                   ) -> dict[str, list[float]]:
    """
    Return the mean and the smallest valid prediction time of runs [s].

    Until the error of a coordinate reaches 0.4 of its standard deviation over all runs; a run
    that is followed to its end counts its full length.
    """
    deviation, times = np.sqrt(variance_of(test)), []
    for motion in test:
        n = len(motion.t)
        error = predict(motion, np.array([0]), n - 1)[0] - motion.q
        # No number is no prediction either.
        beyond = np.flatnonzero(~(np.abs(error) < _FOLLOWED * deviation).all(axis=1))
        times.append(motion.spacing * (beyond[0] if len(beyond) else n))
    return {MEAN: [float(np.mean(times))], LEAST: [float(np.min(times))]}
