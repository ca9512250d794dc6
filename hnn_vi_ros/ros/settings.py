# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of the nodes: a class for each node declares, checks and documents them.

Imports nothing of ROS, since the help texts are generated from it too.
"""

from dataclasses import dataclass, field, fields, replace
import math
from typing import Any

from hnn_vi_ros.errors import ParameterError

Value = str | bool | int | float

# Times at which a parameter can be changed.
START, UNCONFIGURED, ALWAYS = 'at the start', 'unconfigured', 'always'
# Maximum length of a string [characters].
_LONGEST = 4096


@dataclass(frozen=True)
class Specification:
    """
    Declaration of one parameter.

    Parameters
    ----------
    name : str
        ROS name.
    default : str, bool, int or float
        Default, whose type is the type of the parameter.
    description : str
        Purpose.
    unit : str
        Unit of a number.
    smallest, largest : float
        Range of a number, both ends included.
    choices : tuple of str
        Valid values of a string; empty if any string is valid.
    changes : str
        When it can be set: at the start of the node, while it is unconfigured, or always.

    """

    name: str
    default: Value
    description: str
    unit: str = ''
    smallest: float = -math.inf
    largest: float = math.inf
    choices: tuple[str, ...] = ()
    changes: str = UNCONFIGURED

    def check(self, value: object) -> Value:
        """Convert a value to the type of the parameter, or raise ParameterError."""
        kind = type(self.default)
        if kind is float and type(value) is int:
            value = float(value)
        good = type(value) is kind
        if kind in (int, float) and isinstance(value, int | float):
            good = good and self.smallest <= value <= self.largest
        elif isinstance(value, str):
            good = good and len(value) <= _LONGEST and (not self.choices or value in self.choices)
        if not (good and isinstance(value, Value)):
            raise ParameterError(f'parameter {self.name} = {repr(value)[:80]}: {self.expected}')
        return value

    @property
    def expected(self) -> str:
        """Return a description of valid values."""
        if type(self.default) in (int, float):
            kind = 'a whole number' if type(self.default) is int else 'a number'
            return (f'expected {kind} from {self.smallest:g} to {self.largest:g}'
                    + (f' [{self.unit}]' if self.unit else ''))
        if self.choices:
            return f'expected one of {", ".join(self.choices)}'
        return 'expected true or false' if isinstance(self.default, bool) else 'expected a string'


def parameter(default: Value, *words: Any, **more: Any) -> Any:
    """Return the field of a parameter, which has the name of the field; see Specification."""
    return field(default=default, metadata={'item': Specification('', default, *words, **more)})


def specifications(settings: type) -> tuple[Specification, ...]:
    """Return the parameters that a class of settings declares."""
    return tuple(replace(item.metadata['item'], name=item.name) for item in fields(settings))


@dataclass(frozen=True)
class Settings:
    """Parameters of the simulator node: defaults, ranges, descriptions."""

    autostart: bool = parameter(
        True, 'configure and activate without being asked to; false leaves that to a lifecycle '
        'manager', changes=START)
    scene: str = parameter(
        'harmonic_oscillator', 'name of a shipped scene, or path of a scene file (.yaml)')
    resume: str = parameter(
        '', 'bag to go on from: its last state, and the scene that it was recorded from in the '
        'place of `scene`; empty begins anew')
    trust_code: bool = parameter(
        False, 'run Python code that the scene in the bag of `resume` names')
    real_time_factor: float = parameter(
        1.0, 'simulated seconds per wall second; 0 runs as fast as possible', '1', 0.0, 1e6,
        changes=ALWAYS)
    publish_rate: float = parameter(
        100.0, 'samples per simulated second; a whole number of steps lies between two samples, '
        'so it is rounded to what the step size allows', 'Hz', 1e-3, 1e6)
    duration: float = parameter(
        0.0, 'simulated time after which the node ends; 0 runs until it is stopped', 's', 0.0, 1e9)
    discovery_time: float = parameter(
        2.0, 'the first step waits at most this long for subscribers that are there already, so '
        'that they miss no sample', 's', 0.0, 60.0)
    start_paused: bool = parameter(False, 'begin in a pause')
    step_count: int = parameter(
        1, 'steps that one call of `~/step` takes', '1', 1, 1e9, changes=ALWAYS)
    reset_time: bool = parameter(
        False, '`~/reset` sets simulated time back to zero as well; else it goes on',
        changes=ALWAYS)
    reset_on_initial_state: bool = parameter(
        False, '`~/initial_state` resets to its state at once; else the next `~/reset` does',
        changes=ALWAYS)
    publish_clock: bool = parameter(False, 'publish `/clock`')
    step_size: float = parameter(0.0, "step size h; 0 takes the scene's", 's', 0.0, 1e6)
    integrator: str = parameter('', "name of the integrator; empty takes the scene's")
    record: bool = parameter(True, 'write an MCAP bag')
    record_path: str = parameter(
        '', 'folder of the bag, which must not exist; empty makes `runs/<scene>-<UTC time>/bag` '
        'under the working directory')
    rerun_sink: str = parameter(
        'file', 'where the picture goes: to a file, to a running viewer, to viewers that connect',
        choices=('file', 'connect', 'serve', 'none'))
    rerun_path: str = parameter(
        '', 'file: the .rrd file, which must not exist; empty makes `runs/<scene>-<UTC '
        'time>/recording.rrd`. connect: URL of the viewer; empty takes the local one')
    publish_accuracy: bool = parameter(False, 'publish and record `~/accuracy`')
    stop_outside_box: bool = parameter(
        False, 'end the run, with status 1, at the first sample outside of the box that the '
        'model was trained in; else it is only reported', changes=ALWAYS)
    energy_band_limit: float = parameter(
        0.05, 'band of the modified energy, over the energies in play, from which on a '
        'conservative run counts as under-resolved', '1', 1e-15, 1e6, changes=ALWAYS)
    energy_change_limit: float = parameter(
        0.02, 'lasting change of the energy, over the energies in play, that no work accounts '
        'for, from which on energy counts as lost or gained', '1', 1e-15, 1e6, changes=ALWAYS)
    explain: bool = parameter(
        False, 'measure what each effect adds before the first step; compiles one kernel for '
        'each effect')
    frame_id: str = parameter('world', 'frame that `~/markers` are drawn in')


@dataclass(frozen=True)
class BridgeSettings:
    """Parameters of the rerun bridge."""

    simulator: str = parameter('hnn_simulator', 'name of the simulator node')
    controller: str = parameter(
        'hnn_controller', 'name of the controller node, whose plans are shown')
    rerun_sink: str = parameter(
        'connect', 'where the picture goes: to a file, to a running viewer, to viewers that '
        'connect', choices=('file', 'connect', 'serve'))
    rerun_path: str = parameter(
        '', 'file: the .rrd file, which must not exist. connect: URL of the viewer; empty takes '
        'the local one. serve: the port; empty takes 9876')
    trust_code: bool = parameter(
        False, 'run Python code that the scene on `~/scene` or in the bag names; `--trust-code` '
        'sets it')


@dataclass(frozen=True)
class ReplaySettings:
    """Parameters of the replay node."""

    rate: float = parameter(1.0, 'seconds of the bag per second of wall time', '1', 1e-3, 1e3)
    loop: bool = parameter(False, 'begin again at the end')
    start_offset: float = parameter(
        0.0, 'time of the bag that is left out at its start', 's', 0.0, 1e9)
    duration: float = parameter(
        0.0, 'time of the bag that is played; 0 plays to its end', 's', 0.0, 1e9)
    topics: str = parameter(
        '', 'names of the topics to publish, separated by commas; empty publishes all but the '
        'commands that a simulator heard')
    publish_clock: bool = parameter(False, "publish the bag's time on `/clock`, each 10 ms of it")
    start_paused: bool = parameter(False, 'begin paused')
    longest_pause: float = parameter(
        0.0, 'of a longer time without any message the rest is skipped; 0 skips nothing', 's',
        0.0, 1e9)
    discovery_time: float = parameter(
        2.0, 'the first message waits at most this long for subscribers that are there already, '
        'so that they miss none', 's', 0.0, 60.0)


@dataclass(frozen=True)
class ControllerSettings:
    """Parameters of the controller node."""

    autostart: bool = parameter(
        True, 'configure and activate without being asked to; false leaves that to a lifecycle '
        'manager')
    task: str = parameter('swing_up', 'name of a shipped task, or path of a task file (.yaml)')
    scene: str = parameter('', "the model, a scene by its name or path; empty takes the task's")
    simulator: str = parameter(
        'hnn_simulator', 'name of the node that takes the commands, a simulator; relative to the '
        'namespace unless it begins with /')
    commands: str = parameter(
        'joint_commands', 'topic of that node: joint_commands, efforts of the driven joints by '
        'name, or commands, the numbers of all of them', choices=('joint_commands', 'commands'))


PARAMETERS = specifications(Settings)
# The parameters of the other nodes can be set only at their start.
BRIDGE_PARAMETERS, CONTROLLER_PARAMETERS, REPLAY_PARAMETERS = (
    tuple(replace(item, changes=START) for item in specifications(settings))
    for settings in (BridgeSettings, ControllerSettings, ReplaySettings))


def shown(value: Value) -> str:
    """Return a value as Markdown."""
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    return f'`{value}`' if value != '' else 'empty'


def help_of(item: Specification) -> str:
    """Return the help text of a parameter: meaning, values, default."""
    limited = item.choices or type(item.default) in (int, float)
    values = f' ({item.expected.removeprefix("expected ")})' if limited else ''
    return f'{item.description}{values}; default: {shown(item.default).strip("`")}'
