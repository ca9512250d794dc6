# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: their declaration, check and later changes."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, TypeVar

from hnn_vi_ros.errors import did_you_mean, ParameterError
from hnn_vi_ros.files import MAX_YAML_BYTES, parse_mapping
from hnn_vi_ros.ros.plumbing.qos_overrides import Endpoint, expected_form, parameter_names, PREFIX
from hnn_vi_ros.ros.settings import (
    PARAMETERS, Settings, Specification, specifications, START, UNCONFIGURED)
from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.validate_topic_name import validate_topic_name

# Parameters that rclpy declares in every node.
ROS_OWN = ('use_sim_time', 'start_type_description_service')
_SECTION = 'ros__parameters'


def refuse_unknown(node: Node, table: Iterable[Specification], endpoints: Iterable[Endpoint],
                   arguments: Sequence[str]) -> None:
    """
    Refuse unknown parameters that were given to a node, instead of running with the defaults.

    A parameter file may contain a section for several nodes, whose name is a wildcard (``/**``).
    An unknown parameter there belongs to another node: it is only reported if it looks like a
    misspelling. The same holds for a section named nearly like the node, if none matches it.

    Parameters
    ----------
    node : Node
        Node whose own parameters are declared.
    table : iterable of Specification
        Parameters of the node.
    endpoints : iterable of Endpoint
        Topics of the node, whose QoS can be set.
    arguments : sequence of str
        Command line, which names the parameter files.

    Raises
    ------
    ParameterError
        A given parameter or QoS policy does not exist; one line.

    """
    own = [*(item.name for item in table), *ROS_OWN]
    policies = parameter_names(node, endpoints)
    sections = list(_sections(arguments))
    _warn_of_misspelt_node(node, [name for name, _ in sections])
    shared = {name for section, parameters in sections if '*' in section
              for name in _flat(parameters, '')}
    for name in sorted(node.get_parameters_by_prefix('')):
        value = node.get_parameter(name).value
        if name in ROS_OWN and type(value) is not bool:
            raise ParameterError(f'parameter {name} = {value!r}: expected true or false')
        if name in own:
            continue
        # QoS parameters are declared by rclpy together with their topics.
        node.undeclare_parameter(name)
        if name in policies:
            if wanted := expected_form(name, value):
                raise ParameterError(f'parameter {name} = {value!r}: expected {wanted}')
            continue
        hint, valid = _remedy(name, own, policies)
        if name not in shared:
            raise ParameterError(f'parameter {name}: {node.get_name()} has no such '
                                 f'parameter{hint or valid}')
        if hint:
            node.get_logger().warning(
                f'parameter {name}, set for several nodes in a file: this node has no such '
                f'parameter{hint}')


def _remedy(name: str, own: Sequence[str], policies: Sequence[str]) -> tuple[str, str]:
    """Return the hint at a similar known name, if any, and the list of valid names."""
    if not name.startswith(PREFIX):
        return did_you_mean(name, own), f'; it has: {", ".join(own)}'
    # Names of topics contain no dots.
    topic, _, policy = name.removeprefix(PREFIX).partition('.')
    known: dict[str, list[str]] = {}
    for each in policies:
        there, _, rest = each.removeprefix(PREFIX).partition('.')
        known.setdefault(there, []).append(rest)
    if topic in known:
        return did_you_mean(policy, known[topic]), f'; {topic} has: {", ".join(known[topic])}'
    return did_you_mean(topic, known), f'; QoS can be set for: {", ".join(known) or "none"}'


def _warn_of_misspelt_node(node: Node, sections: Sequence[str]) -> None:
    name = node.get_name()
    if not any(section == name or '*' in section for section in sections):
        for section in filter(lambda section: did_you_mean(section, [name]), sections):
            node.get_logger().warning(
                f'the parameter file has a section {section}, which is not this node; did you '
                f'mean {name}?')


def _sections(arguments: Sequence[str]) -> Iterator[tuple[str, object]]:
    """Yield the base name and the parameters of each node in the parameter files."""
    for option, path in pairwise(arguments):
        if option == '--params-file':
            # ROS has already read and checked the file; only the names are used.
            with open(path, 'rb') as stream:
                content, _ = parse_mapping(stream.read(MAX_YAML_BYTES + 1), path, ParameterError)
            yield from _sections_in(content, '')


def _sections_in(content: Mapping[Any, object], node: str) -> Iterator[tuple[str, object]]:
    for key, value in content.items():
        if key == _SECTION:
            yield node.rpartition('/')[2], value
        elif isinstance(value, Mapping):
            yield from _sections_in(value, f'{node}/{key}')


def _flat(parameters: object, prefix: str) -> Iterator[str]:
    """Yield the names of nested parameters; ``a: {b: 1}`` means ``a.b``."""
    for key, value in parameters.items() if isinstance(parameters, Mapping) else ():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}'


_BY_NAME = {item.name: item for item in PARAMETERS}
_Declared = TypeVar('_Declared')
_DOUBLES = {item.name for item in PARAMETERS if isinstance(item.default, float)}


def declare_parameters(node: Node, settings: type[_Declared]) -> _Declared:
    """
    Declare all parameters of a class of settings; return their checked values.

    Parameters
    ----------
    node : Node
        Node that owns the parameters; given values have been declared automatically.
    settings : type
        Class such as Settings, whose fields are declared with ``parameter``.

    Raises
    ------
    ParameterError
        A value of the wrong type or out of its range; one line.

    """
    values = {}
    for specification in specifications(settings):
        name, given = specification.name, specification.default
        if node.has_parameter(name):
            # Checked before it is declared with a descriptor: errors of rclpy take several lines.
            given = node.get_parameter(name).value
            node.undeclare_parameter(name)
        values[name] = specification.check(given)
        node.declare_parameter(name, specification.default, _descriptor(specification))
    return settings(**values)


def node_name(node: Node, role: str, name: str) -> str:
    """Return the full name of another node, which may be relative; ParameterError if invalid."""
    try:
        validate_topic_name(name)
        return expand_topic_name(name, node.get_name(), node.get_namespace())
    except (InvalidTopicNameException, ValueError) as problem:
        raise ParameterError(f'parameter {role} = {name!r}: expected the name of a node, such as '
                             f'hnn_{role}, in this namespace, or /left/hnn_{role}') from problem


class Parameters:
    """
    The parameters of a node: declared, checked, and changed only when permitted.

    Changes that are requested together are checked together: either all or none are made.

    Parameters
    ----------
    node : Node
        Node that owns the parameters.
    check : callable
        Raises ParameterError if changed settings do not fit the current run, if any.
    apply : callable
        Applies changed settings to the current run, if any.

    Attributes
    ----------
    settings : Settings
        Values of the parameters.
    started : Settings
        Values at the start, which are of the user and not of another node.
    configured : bool
        True if a configured run uses them.

    Raises
    ------
    ParameterError
        A value of the wrong type or out of its range; one line.

    """

    def __init__(self, node: Node, check: Callable[[Settings], None],
                 apply: Callable[[Settings], None]):
        self.settings, self._node = declare_parameters(node, Settings), node
        self.configured, self.started = False, self.settings
        _check_clock(self.settings, self._follows)
        self._check_run, self._apply_to_run = check, apply
        node.add_pre_set_parameters_callback(_with_doubles)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            self._check_run(self._changed(parameters))
        except ParameterError as problem:
            return SetParametersResult(successful=False, reason=str(problem))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Parameter]) -> None:
        self.settings = self._changed(parameters)
        self._apply_to_run(self.settings)

    def _changed(self, parameters: Sequence[Parameter]) -> Settings:
        """Return the changed settings, or raise ParameterError; ignore parameters of ROS."""
        changes: dict[str, Any] = {}
        for parameter in parameters:
            specification = _BY_NAME.get(parameter.name)
            if specification is not None:
                if self.configured and specification.changes == UNCONFIGURED:
                    raise ParameterError(
                        f'parameter {parameter.name}: can only be set while the node is '
                        'unconfigured; use the transition cleanup first')
                changes[parameter.name] = specification.check(parameter.value)
        settings = replace(self.settings, **changes)
        _check_clock(settings, next((parameter.value for parameter in parameters
                                     if parameter.name == ROS_OWN[0]), self._follows))
        return settings

    @property
    def _follows(self) -> bool:
        return bool(self._node.get_parameter(ROS_OWN[0]).value)


def _check_clock(settings: Settings, follows: bool) -> None:
    """Raise ParameterError if the settings do not allow the simulator to follow /clock."""
    if follows and settings.publish_clock:
        raise ParameterError('parameter use_sim_time = true: the simulator cannot follow the '
                             '/clock that it publishes; set it, or publish_clock, to false')
    if follows and not settings.real_time_factor:
        raise ParameterError('parameter use_sim_time = true: real_time_factor = 0 ignores the '
                             'clock; set it to the simulated seconds per second of /clock')


def _with_doubles(parameters: list[Parameter]) -> list[Parameter]:
    """Convert integers that were given for double parameters to doubles."""
    return [Parameter(item.name, Parameter.Type.DOUBLE, float(item.value))
            if item.type_ == Parameter.Type.INTEGER and item.name in _DOUBLES else item
            for item in parameters]


def _descriptor(item: Specification) -> ParameterDescriptor:
    """Return the ROS descriptor, which ``ros2 param describe`` shows."""
    unit = f' [{item.unit}]' if item.unit else ''
    constraints = [f'one of: {", ".join(item.choices)}'] if item.choices else []
    if item.changes == UNCONFIGURED:
        constraints.append('can only be set while the node is unconfigured')
    descriptor = ParameterDescriptor(
        description=f'{item.description}{unit}', read_only=item.changes == START,
        additional_constraints='; '.join(constraints))
    if type(item.default) is int:
        descriptor.integer_range = [
            IntegerRange(from_value=int(item.smallest), to_value=int(item.largest))]
    elif isinstance(item.default, float):
        # Dynamic typing accepts an integer for a double; the range is checked separately.
        descriptor.dynamic_typing = True
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=item.smallest, to_value=item.largest)]
    return descriptor
