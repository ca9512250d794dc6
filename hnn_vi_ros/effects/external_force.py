# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A force commanded while the simulation runs."""

from collections.abc import Callable, Sequence
from typing import Self, TYPE_CHECKING

from hnn_vi_ros.effects.base import EffectState, Force
from hnn_vi_ros.effects.commands import (
    Command, Commanded, EFFORT, indices_of, JointCommand, LARGEST, NUMBERS)
from hnn_vi_ros.effects.gravity_compensation import Compensated, GravityModelKind
from hnn_vi_ros.hamiltonians import check_finite, check_names_once, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.effects.input_map import InputParameters
    from hnn_vi_ros.models import Checkpoint


class ExternalForce(Compensated, Force, Commanded):
    """
    The last commanded force on some coordinates, until the next command or its time-out.

    The time-out is in simulated time, in whole steps: a command acts in all steps that start
    before it, so that a crashed controller does not push forever (watchdog). For position or
    velocity targets use `servo`. With a learned input map, the command u of a model's motors
    drives all coordinates: g(q) u, A u, or B u in the frame of a body. For a body named body,
    body_x to body_z are forces along the axes of space, body_fx to body_fz along its own axes, and
    body_rx to body_rz torques. The force is gain * command + offset while a command acts: for
    commands in volts, gain is the force constant of the motor. Energy account: f . H_p.

    Parameters
    ----------
    coordinates : list of str, optional
        The coordinates of the numbers of a command, in this order.
    timeout : float
        Duration of a command, > 0 [s]; afterwards no force acts.
    initial : list of float, optional
        Command that acts from the start of a run until the first one, in the units of the
        coordinates' forces [N, N m] or of the model's inputs; by default no force.
    model : str, optional
        A model with an input map (family control_affine, or mechanical or lie_group with
        ``input_map: learned``), instead of the coordinates; an ensemble acts by its mean.
    member : int, optional
        Number of the single member of an ensemble that acts, from 1.
    gain : float or list of float, optional
        Force per unit of the command, for all coordinates or for each; by default 1, for commands
        that are forces.
    offset : float or list of float, optional
        Force at a command of zero, for all coordinates or for each [N], [N m].
    gravity_compensation : str, optional
        Add V' of a model to the commanded forces, also without a command: model for that of H,
        with its payload; unloaded for that without a payload; urdf for that of a robot in
        ``file``, with the joints and the gravity of H; default: none.
    file : str, optional
        The URDF of ``gravity_compensation: urdf``: a path, or package://PACKAGE/PATH.

    Raises
    ------
    ModelError, ValueError
        The model has no input map or no such member, the time-out is not positive, ``initial`` is
        not a command, or coordinates, model, member, gain and offset are inconsistent.

    References
    ----------
    J. Marsden, M. West, Discrete mechanics and variational integrators, 2001, part 3.
    Y. D. Zhong, B. Dey, A. Chakraborty, Symplectic ODE-Net, ICLR 2020.

    """

    depends_on_momentum, single, turns = False, True, True

    def __init__(self, coordinates: list[str] | None = None, timeout: float = 0.5,
                 model: str | None = None, member: int | None = None,
                 initial: list[float] | None = None, gain: float | list[float] = 1.0,
                 offset: float | list[float] = 0.0,
                 gravity_compensation: GravityModelKind | None = None,
                 file: str | None = None):
        super().__init__(gravity_compensation, file)
        if gravity_compensation and coordinates is None:
            raise ValueError('gravity_compensation needs coordinates; a model has its own motors')
        check_positive(timeout=timeout)
        check_finite(gain=gain, offset=offset)
        if (coordinates is None) == (model is None):
            raise ValueError('give either coordinates or model')
        if member is not None and not model:
            raise ValueError('member needs a model; give model instead of coordinates')
        if coordinates is None and ((np.ravel(gain) != 1.0).any() or np.any(offset)):
            raise ValueError('gain and offset need coordinates; a model has its own')
        if coordinates is not None:
            check_names_once(coordinates=coordinates)
        self.names, self.timeout = tuple(coordinates or ()), float(timeout)
        self.initial = initial
        self.gain, self.offset = gain, offset
        if model is not None:
            from hnn_vi_ros.effects.input_map import load_map
            self.model = load_map(model, member)
        self._describe()

    @classmethod
    def of(cls, checkpoint: 'Checkpoint', timeout: float) -> Self:
        """Return the force of a model with an input map that is in no file."""
        own = cls.__new__(cls)
        own.names, own.timeout, own.initial, own.model = (), timeout, None, checkpoint
        own.gain, own.offset, own.gravity_compensation = 1.0, 0.0, None
        own._describe()
        return own

    def _describe(self) -> None:
        mapped = self.model is not None
        scaled = bool((np.ravel(self.gain) != 1.0).any() or np.any(self.offset))
        # The input map of a model, and gravity, depend on q.
        self.depends_on_state = mapped or self.gravity_compensation is not None
        self.feels_command, self.by_motors = mapped or scaled, mapped
        self.held = not self.depends_on_state
        self.takes = frozenset({NUMBERS} if mapped else {NUMBERS, EFFORT})

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> 'InputParameters':
        """Return the command, the clock, the columns, and the function that adds forces."""
        from hnn_vi_ros.effects.input_map import by_map, by_name
        parameters = by_map(state, self.model, coordinates) if self.model is not None else \
            by_name(state, coordinates, self.names, self.gain, self.offset)
        if self.initial is not None:
            self._checked('initial', np.array(self.initial, dtype=np.float64), parameters.columns)
        return parameters

    def on(self, names: Sequence[str], timeout: float) -> 'ExternalForce':
        """Return this effect on other coordinates; new ones have the gain 1 and no offset."""
        gain, offset = (dict(zip(self.names, np.broadcast_to(values, len(self.names)).tolist(),
                                 strict=True)) for values in (self.gain, self.offset))
        return ExternalForce([*names], timeout, gain=[gain.get(name, 1.0) for name in names],
                             offset=[offset.get(name, 0.0) for name in names])

    def begin(self, parameters: 'InputParameters') -> None:
        """Apply the initial command until the first one arrives."""
        if self.initial is not None:
            parameters.hold(parameters.columns, np.array(self.initial), np.inf)

    def prepare(self, command: Command, parameters: 'InputParameters', q: np.ndarray
                ) -> Callable[[], None]:
        """Return a function that sets forces [N], [N m], of all or of named joints."""
        columns = parameters.columns
        values = np.array(getattr(command, EFFORT, command), dtype=np.float64)
        if isinstance(command, JointCommand):
            given = ~np.isnan(values)
            columns, values = columns[indices_of(command.names, self.names, given)], values[given]
        self._checked('command', values, columns)
        return lambda: parameters.hold(columns, values, self.timeout)

    def _checked(self, what: str, values: np.ndarray, columns: np.ndarray) -> None:
        if values.shape != columns.shape or not (np.abs(values) <= LARGEST).all():
            raise ValueError(
                f'{what} {values.tolist()!s:.80}: expected {columns.size} finite '
                f'number{"s" * (columns.size > 1)}{", for " * bool(self.names)}'
                f'{", ".join(self.names)}, at most {LARGEST:g}')

    def joints(self, parameters: 'InputParameters') -> np.ndarray | None:
        """Return the columns of the joints; None for a map, and for forces on a body."""
        from hnn_vi_ros.effects.input_map import Columns
        return parameters.columns if isinstance(parameters.own, Columns) else None

    @staticmethod
    @inlined
    def add_force(parameters: 'InputParameters', t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the command if it is active at the start of the step, and what bears gravity."""
        command, gravity = parameters.command, parameters.gravity
        gravity.fill(gravity.model, q, gravity.forces)
        for k in range(gravity.forces.size):
            f_p[parameters.columns[k]] += gravity.forces[k]
        if parameters.clock[0] < command[command.size - 1]:
            parameters.add(parameters.own, command, q, p, f_p)
