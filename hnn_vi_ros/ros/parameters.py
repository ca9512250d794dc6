# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the simulator node: one table that declares, checks and documents them."""

from dataclasses import dataclass
import math

from hnn_vi_ros.errors import ParameterError
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node


@dataclass(frozen=True)
class Specification:
    """
    One parameter.

    Parameters
    ----------
    name : str
        Its ROS name.
    default : str, bool or float
        Its default, whose type is the parameter's.
    description : str
        What it does.
    unit : str
        Unit of a number.
    smallest, largest : float
        Range of a number, both ends included.
    choices : tuple of str
        Valid values of a string; empty if any will do.

    """

    name: str
    default: str | bool | float
    description: str
    unit: str = ''
    smallest: float = -math.inf
    largest: float = math.inf
    choices: tuple[str, ...] = ()

    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor, which ``ros2 param describe`` shows."""
        unit = f' [{self.unit}]' if self.unit else ''
        descriptor = ParameterDescriptor(
            description=f'{self.description}{unit}', read_only=True,
            additional_constraints=f'one of: {", ".join(self.choices)}' if self.choices else '')
        if isinstance(self.default, float):
            # An integer given for a double must work; the range is checked below.
            descriptor.dynamic_typing = True
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.smallest, to_value=self.largest)]
        return descriptor

    def check(self, value: object) -> str | bool | float:
        """Return the value in the parameter's type, or raise ParameterError."""
        if isinstance(self.default, float):
            numeric = isinstance(value, int | float) and not isinstance(value, bool)
            if not (numeric and self.smallest <= value <= self.largest):
                raise ParameterError(f'parameter {self.name} = {value!r}: {self.expected}')
            return float(value)
        right_type = type(value) is type(self.default)
        if not right_type or (self.choices and value not in self.choices):
            raise ParameterError(f'parameter {self.name} = {value!r}: {self.expected}')
        return value

    @property
    def expected(self) -> str:
        """Say what a valid value is."""
        if isinstance(self.default, float):
            return (f'expected a number from {self.smallest:g} to {self.largest:g}'
                    + (f' [{self.unit}]' if self.unit else ''))
        if self.choices:
            return f'expected one of {", ".join(self.choices)}'
        return 'expected true or false' if isinstance(self.default, bool) else 'expected a string'


PARAMETERS = (
    Specification('scene', 'harmonic_oscillator',
                  'name of a shipped scene, or path of a scene file (.yaml)'),
    Specification('real_time_factor', 1.0,
                  'simulated seconds per wall second; 0 runs as fast as possible', '1',
                  0.0, 1e6),
    Specification('publish_rate', 100.0,
                  'samples per simulated second; a whole number of steps lies between two '
                  'samples, so it is rounded to what the step size allows', 'Hz', 1e-3, 1e6),
    Specification('duration', 0.0,
                  'simulated time after which the node ends; 0 runs until it is stopped', 's',
                  0.0, 1e9),
    Specification('discovery_time', 2.0,
                  'the first step waits at most this long for subscribers that are there already, '
                  'so that they miss no sample', 's', 0.0, 60.0),
    Specification('step_size', 0.0, "step size h; 0 takes the scene's", 's', 0.0, 1e6),
    Specification('integrator', '', "name of the integrator; empty takes the scene's"),
    Specification('record', True, 'write an MCAP bag'),
    Specification('record_path', '', 'folder of the bag, which must not exist; empty makes '
                  '`runs/<scene>-<UTC time>/bag` under the working directory'),
    Specification('rerun_sink', 'file', 'where the picture goes: to a file, to a running viewer, '
                  'to viewers that connect', choices=('file', 'connect', 'serve', 'none')),
    Specification('rerun_path', '', 'file: the .rrd file, which must not exist; empty makes '
                  '`runs/<scene>-<UTC time>/recording.rrd`. connect: URL of the viewer; '
                  'empty takes the local one'),
    Specification('publish_accuracy', False, 'publish and record `~/accuracy`'),
    Specification('stop_outside_box', False, 'end the run, with status 1, at the first sample '
                  'outside of the box that the model was trained in; else it is only told'),
    Specification('energy_band_limit', 0.05, 'band of the modified energy, over the energies in '
                  'play, from which on a conservative run counts as under-resolved', '1',
                  1e-15, 1e6),
    Specification('energy_change_limit', 0.02, 'lasting change of the energy, over the energies '
                  'in play, that no work accounts for, from which on energy counts as lost or '
                  'gained', '1', 1e-15, 1e6),
    Specification('explain', False, 'measure what each effect adds before the first step; '
                  'compiles one kernel for each effect'),
    Specification('frame_id', 'world', 'frame that `~/markers` are drawn in'),
)


def declare_parameters(node: Node) -> dict[str, str | bool | float]:
    """
    Declare every parameter of the table and return the values, checked.

    Raises
    ------
    ParameterError
        A value of the wrong type or out of its range; one line.

    """
    values = {}
    for specification in PARAMETERS:
        name = specification.name
        try:
            parameter = node.declare_parameter(
                name, specification.default, specification.descriptor())
        except (InvalidParameterTypeException, InvalidParameterValueException) as problem:
            raise ParameterError(f'parameter {name}: {specification.expected}; '
                                 f'{" ".join(str(problem).split())}') from problem
        values[name] = specification.check(parameter.value)
    return values


def markdown_table() -> str:
    """Return the parameters as the rows of the README's table."""
    rows = []
    for item in PARAMETERS:
        choices = f' ({", ".join(item.choices)})' if item.choices else ''
        rows.append(f'| `{item.name}` | {_shown(item.default)} | {item.unit} '
                    f'| {item.description}{choices} |')
    return '\n'.join(rows)


def _shown(value: str | bool | float) -> str:
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    return f'`{value}`' if value != '' else 'empty'
