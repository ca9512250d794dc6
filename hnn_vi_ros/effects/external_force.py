# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A force that is commanded from outside while the simulation runs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hnn_vi_ros.effects.base import Commanded, EffectState, Force
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.effects.input_map import InputParameters
    from hnn_vi_ros.models.checkpoint import Checkpoint


class ExternalForce(Force, Commanded):
    """
    The last command, a force on some coordinates, held until the next command or its time-out.

    The node takes commands from ``~/commands``. A command that is not renewed ends after the
    time-out, in simulated time, so that a controller that died does not push on (watchdog). With
    a model that has learned an input map the command u of its motors drives all coordinates: the
    force g(q) u of a control-affine network, or A u of a mechanical one. On a body of the name
    body, body_x to body_z are forces along axes of space, body_fx to body_fz along its own, such
    as thrust, and body_rx to body_rz torques about its own. Energy account: the power f . H_p.

    Parameters
    ----------
    coordinates : list of str, optional
        The coordinates that a command has one number for, in this order.
    timeout : float
        How long a command holds, > 0 [s].
    model : str, optional
        A model with an input map (family control_affine, or mechanical with ``input_map:
        learned``), in place of the coordinates.

    Raises
    ------
    ModelError
        The model does not exist, is damaged, or has no input map.
    ValueError
        The time-out is not positive, no coordinate is named, or one twice; both, or none, of
        coordinates and model.

    References
    ----------
    J. Marsden, M. West, Discrete mechanics and variational integrators, Acta Numerica 2001,
    part 3.
    Y. D. Zhong, B. Dey, A. Chakraborty, Symplectic ODE-Net: Learning Hamiltonian Dynamics with
    Control, ICLR 2020.

    """

    depends_on_momentum, single, turns = False, True, True

    def __init__(self, coordinates: list[str] | None = None, timeout: float = 0.5,
                 model: str | None = None):
        check_positive(timeout=timeout)
        if (coordinates is None) == (model is None):
            raise ValueError('coordinates is required, or a model in its place')
        if coordinates is not None and (
                not coordinates or len(set(coordinates)) < len(coordinates)):
            raise ValueError(f'coordinates = {coordinates} must name at least one, each once')
        self.names, self.timeout = tuple(coordinates or ()), float(timeout)
        self._model: Checkpoint | None = None
        if model is not None:
            from hnn_vi_ros.effects.input_map import load_map
            self._model = load_map(model)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> 'InputParameters':
        """Return the command, the clock, the numbers' places, and what adds their forces."""
        # Imported here: it is compiled, which who only reads a scene has no use for.
        from hnn_vi_ros.effects.input_map import by_map, by_name
        if self._model is not None:
            return by_map(state, self._model, coordinates)
        return by_name(state, coordinates, self.names)

    def take(self, values: Sequence[float], parameters: 'InputParameters') -> None:
        """Take a command [N] or [N m] whole, or raise ValueError and leave the last one."""
        command, places = parameters.command, parameters.places
        array = np.array(values, dtype=np.float64)
        if array.shape != places.shape or not np.isfinite(array).all():
            names = f', for {", ".join(self.names)}' if self.names else ''
            raise ValueError(f'command {array.tolist()}: expected {places.size} finite numbers'
                             f'{names}')
        command[places], command[-1] = array, parameters.clock[0] + self.timeout

    @staticmethod
    @inlined
    def add_force(parameters: 'InputParameters', t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the command while it holds."""
        command = parameters.command
        # By the time at the start of the step: the force is constant over each step.
        if parameters.clock[0] < command[command.size - 1]:
            parameters.add(parameters.own, command, q, p, f_p)
