# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An arm of a scene in MuJoCo, from the same URDF: free swing without contact."""

from collections.abc import Callable
from contextlib import chdir
from tempfile import TemporaryDirectory

from hnn_vi_ros.hamiltonians import RigidBodyTree
import mujoco
import numpy as np

INTEGRATORS = {
    'Euler': mujoco.mjtIntegrator.mjINT_EULER,
    'implicitfast': mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    'implicit': mujoco.mjtIntegrator.mjINT_IMPLICIT,
    'RK4': mujoco.mjtIntegrator.mjINT_RK4,
}
_UNSTABLE = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL,
             mujoco.mjtWarning.mjWARN_BADQACC)


class MujocoArm:
    """
    MuJoCo's model of a robot, without the limits, damping and friction of the URDF.

    Parameters
    ----------
    robot : RigidBodyTree
        All of whose joints move, in the order of the bodies.
    q0 : np.ndarray, shape (d,)
        Initial state, at rest [rad].

    Raises
    ------
    RuntimeError
        MuJoCo reads the joints in another order.

    """

    def __init__(self, robot: RigidBodyTree, q0: np.ndarray):
        self._q0 = q0
        self.model = mujoco.MjModel.from_xml_string(robot.robot.text)
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        if names != [joint.name for joint in robot.joints]:
            raise RuntimeError(f'MuJoCo has the joints {names}')
        for of_joints in (self.model.jnt_limited, self.model.dof_damping,
                          self.model.dof_frictionloss):
            of_joints[:] = 0
        self.model.dof_armature[:] = robot.bodies.armature[1:]
        # Nothing touches: it need not look.
        self.model.opt.disableflags |= (mujoco.mjtDisableBit.mjDSBL_CONTACT
                                        | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data = mujoco.MjData(self.model)

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return q'' of one state, shape (d,)."""
        self._data.qpos, self._data.qvel = q, v
        mujoco.mj_forward(self.model, self._data)
        return self._data.qacc.copy()

    def prepare(self, integrator: str, h: float, samples: int, every: int
                ) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
        """
        Return a run from the start that returns q and v, of shape (samples, d).

        They end at the time at which MuJoCo would reset because of too large accelerations.
        """
        self.model.opt.integrator, self.model.opt.timestep = INTEGRATORS[integrator], h
        mujoco.mj_resetData(self.model, self._data)
        self._data.qpos = self._q0
        q, v = np.empty((2, samples, self._q0.size))

        def run() -> tuple[np.ndarray, np.ndarray]:
            # Its warnings go to a file in the working directory.
            with TemporaryDirectory() as folder, chdir(folder):
                for sample in range(samples):
                    # The loop over the steps is MuJoCo's own.
                    mujoco.mj_step(self.model, self._data, nstep=every)
                    if any(self._data.warning[kind].number for kind in _UNSTABLE):
                        return q[:sample], v[:sample]
                    q[sample], v[sample] = self._data.qpos, self._data.qvel
            return q, v
        return run
