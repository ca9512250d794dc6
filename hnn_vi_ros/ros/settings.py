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
_MAX_LENGTH = 4096


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
            good = good and len(value) <= _MAX_LENGTH and (
                not self.choices or value in self.choices)
        if not (good and isinstance(value, Value)):
            raise ParameterError(f'parameter {self.name} = {repr(value)[:80]}: {self.expected}')
        return value

    @property
    def expected(self) -> str:
        """Return a description of valid values."""
        if type(self.default) in (int, float):
            kind = 'an integer' if type(self.default) is int else 'a number'
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
        True, 'configure and activate at the start; false leaves this to a lifecycle '
        'manager', changes=START)
    scene: str = parameter(
        'harmonic_oscillator', 'name of a shipped scene, or path of a scene file (.yaml)')
    resume: str = parameter(
        '', 'bag from which to resume, with its last state and its recorded scene, or with '
        '`scene`, if it is given: other effects on the same coordinates; empty: start a new run')
    trust_code: bool = parameter(
        False, 'run the Python code named in the scene of a bag (`resume`), or in a scene file '
        'that is set while the node runs; that of the scene given at the start is run in any case',
        changes=START)
    real_time_factor: float = parameter(
        1.0, 'simulated seconds per second of wall time; 0: as fast as possible', '1', 0.0, 1e6,
        changes=ALWAYS)
    publish_rate: float = parameter(
        100.0, 'samples per simulated second; rounded so that the sampling interval is a whole '
        'number of steps', 'Hz', 1e-3, 1e6)
    duration: float = parameter(
        0.0, 'simulated time after which the node ends; 0: run until stopped', 's', 0.0, 1e9)
    discovery_time: float = parameter(
        2.0, 'maximum wait of the first step for the discovery of existing subscribers, so that '
        'they miss no sample', 's', 0.0, 60.0)
    start_paused: bool = parameter(False, 'start paused')
    step_count: int = parameter(
        1, 'number of steps per call of `~/step`', '1', 1, 1e9, changes=ALWAYS)
    reset_time: bool = parameter(
        False, 'let `~/reset` also set simulated time to zero; otherwise time continues',
        changes=ALWAYS)
    reset_on_initial_state: bool = parameter(
        False, 'let `~/initial_state` reset to its state at once; otherwise the next `~/reset` '
        'does',
        changes=ALWAYS)
    publish_clock: bool = parameter(False, 'publish `/clock`')
    step_size: float = parameter(0.0, 'step size h; 0: that of the scene', 's', 0.0, 1e6)
    integrator: str = parameter('', 'name of the integrator; empty: that of the scene')
    record: bool = parameter(True, 'write an MCAP bag')
    record_path: str = parameter(
        '', 'folder of the bag, which must not exist; empty: `runs/<scene>-<UTC time>/bag` in the '
        'working directory')
    rerun_sink: str = parameter(
        'file', 'visualisation with rerun: write a file, connect to a running viewer, or serve '
        'viewers',
        choices=('file', 'connect', 'serve', 'none'))
    rerun_path: str = parameter(
        '', 'file: the .rrd file, which must not exist; empty: `runs/<scene>-<UTC '
        'time>/recording.rrd`. connect: URL of the viewer; empty: the local viewer')
    lockstep: bool = parameter(
        False, 'wait after the samples of each control period for the command on '
        '`~/joint_commands` that carries their stamp')
    lockstep_period: float = parameter(
        0.0, 'control period in lockstep, a whole number of samples; 0: every sample', 's', 0.0,
        1e6)
    lockstep_timeout: float = parameter(
        60.0, 'longest wait for such a command after the first', 's', 1e-3, 1e9)
    on_lockstep_timeout: str = parameter(
        'stop', 'after that wait, end the run, or go on with the last command and warn',
        choices=('stop', 'hold'))
    publish_accuracy: bool = parameter(False, 'publish and record `~/accuracy`')
    publish_loop_forces: bool = parameter(
        False, 'publish and record `~/loop_forces`, in a scene with loops')
    energy_by_cause: bool = parameter(
        False, 'account for the energy by cause, and publish and record `~/energy_by_cause`, as '
        '`energy_by_cause: true` of the scene does')
    stop_outside_box: bool = parameter(
        False, 'end the run with status 1 at the first sample outside the training box of the '
        'model; otherwise it is only reported', changes=ALWAYS)
    energy_band_limit: float = parameter(
        0.05, 'minimum band of the modified energy, relative to the energy scale, at which a '
        'conservative run counts as under-resolved', '1', 1e-15, 1e6, changes=ALWAYS)
    energy_change_limit: float = parameter(
        0.02, 'minimum lasting change of the energy minus work, relative to the energy scale, at '
        'which energy counts as lost or gained', '1', 1e-15, 1e6, changes=ALWAYS)
    payload: str = parameter(
        '', 'payload of a robot whose scene has one, such as {mass: 1.2, centre: [0, 0, 0.1]}, '
        'with `inertia` as in the scene; velocities stay; empty: that of the scene',
        changes=ALWAYS)
    frame_id: str = parameter('world', 'frame of `~/markers`')


@dataclass(frozen=True)
class ReplaySettings:
    """Parameters of the replay node."""

    rate: float = parameter(1.0, 'seconds of the bag per second of wall time', '1', 1e-3, 1e3)
    loop: bool = parameter(False, 'restart at the end')
    start_offset: float = parameter(
        0.0, 'time of the bag that is skipped at its start', 's', 0.0, 1e9)
    duration: float = parameter(
        0.0, 'time of the bag that is played; 0: until its end', 's', 0.0, 1e9)
    topics: str = parameter(
        '', 'names of the topics to publish, separated by commas; empty: all except the commands '
        'that a simulator received')
    publish_clock: bool = parameter(False, 'publish the time of the bag on `/clock`, every 10 ms')
    start_paused: bool = parameter(False, 'start paused')
    discovery_time: float = parameter(
        2.0, 'maximum wait of the first message for the discovery of existing subscribers, so '
        'that they miss none', 's', 0.0, 60.0)


@dataclass(frozen=True)
class ControllerSettings:
    """Parameters of the controller node."""

    autostart: bool = parameter(
        True, 'configure and activate at the start; false leaves this to a lifecycle manager')
    task: str = parameter('swing_up', 'name of a shipped task, or path of a task file (.yaml)')
    scene: str = parameter('', 'name or path of the scene used as model; empty: that of the task')
    simulator: str = parameter(
        'hnn_simulator', 'name of the node that receives the commands, such as a simulator; '
        'relative to the namespace unless it begins with /')
    commands: str = parameter(
        'joint_commands', 'topic of that node: joint_commands (efforts of the driven joints by '
        'name) or commands (an array of all of them)', choices=('joint_commands', 'commands'))
    lockstep: bool = parameter(
        False, 'for a simulator in lockstep: answer every state, and limit plans by iterations '
        'instead of time')


PARAMETERS = specifications(Settings)
# The parameters of the other nodes can be set only at their start.
CONTROLLER_PARAMETERS, REPLAY_PARAMETERS = (
    tuple(replace(item, changes=START) for item in specifications(settings))
    for settings in (ControllerSettings, ReplaySettings))


def as_markdown(value: Value) -> str:
    """Return a value as Markdown."""
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    return f'`{value}`' if value != '' else 'empty'


def help_of(item: Specification) -> str:
    """Return the help text of a parameter: meaning, values, default."""
    limited = item.choices or type(item.default) in (int, float)
    values = f' ({item.expected.removeprefix("expected ")})' if limited else ''
    return f'{item.description}{values}; default: {as_markdown(item.default).strip("`")}'
