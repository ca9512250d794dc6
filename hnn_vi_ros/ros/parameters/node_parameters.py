# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of a table in a node: declared, checked, and changed where they may."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros.parameters.settings import (
    PARAMETERS, Settings, Specification, specifications, START, UNCONFIGURED)
from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

_BY_NAME = {item.name: item for item in PARAMETERS}
_Declared = TypeVar('_Declared')
_DOUBLES = {item.name for item in PARAMETERS if isinstance(item.default, float)}


def declare_parameters(node: Node, settings: type[_Declared]) -> _Declared:
    """
    Declare every parameter of a class of settings and return the values, checked.

    Parameters
    ----------
    node : Node
        Whose parameters they are.
    settings : type
        Such as Settings: its fields are declared by ``parameter``.

    Raises
    ------
    ParameterError
        A value of the wrong type or out of its range; one line.

    """
    values = {}
    for specification in specifications(settings):
        name = specification.name
        if node.has_parameter(name):
            # As it was given; see given_parameters.py.
            node.undeclare_parameter(name)
        try:
            parameter = node.declare_parameter(
                name, specification.default, _descriptor(specification))
        except (InvalidParameterTypeException, InvalidParameterValueException) as problem:
            raise ParameterError(f'parameter {name}: {specification.expected}; '
                                 f'{" ".join(str(problem).split())}') from problem
        values[name] = specification.check(parameter.value)
    return settings(**values)


class Parameters:
    """
    The parameters of a node: declared, checked, and changed only where they may.

    Changes that are asked for together are checked together: all of them or none are made.

    Parameters
    ----------
    node : Node
        Whose parameters they are.

    Attributes
    ----------
    settings : Settings
        What they are worth.
    configured : bool
        Whether a configured run uses them.
    run : object or None
        It receives changes while it runs: ``check(settings)``, which may raise ParameterError,
        and then ``apply(settings)``.

    Raises
    ------
    ParameterError
        A value of the wrong type or out of its range; one line.

    """

    def __init__(self, node: Node):
        self.settings = declare_parameters(node, Settings)
        self.configured, self.run = False, None
        node.add_pre_set_parameters_callback(_with_doubles)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            settings = self._changed(parameters)
            if self.run is not None:
                self.run.check(settings)
        except ParameterError as problem:
            return SetParametersResult(successful=False, reason=str(problem))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Parameter]) -> None:
        self.settings = self._changed(parameters)
        if self.run is not None:
            self.run.apply(self.settings)

    def _changed(self, parameters: Sequence[Parameter]) -> Settings:
        """Return all with changes, or raise ParameterError; other parameters are ROS's."""
        changes = {}
        for parameter in parameters:
            specification = _BY_NAME.get(parameter.name)
            if specification is not None:
                if self.configured and specification.changes == UNCONFIGURED:
                    raise ParameterError(
                        f'parameter {parameter.name}: can only be set while the node is '
                        'unconfigured; use the transition cleanup first')
                changes[parameter.name] = specification.check(parameter.value)
        return replace(self.settings, **changes)


def _with_doubles(parameters: list[Parameter]) -> list[Parameter]:
    """Return them with doubles where integers were given for them."""
    return [Parameter(item.name, Parameter.Type.DOUBLE, float(item.value))
            if item.type_ == Parameter.Type.INTEGER and item.name in _DOUBLES else item
            for item in parameters]


def _descriptor(item: Specification) -> ParameterDescriptor:
    """Return the ROS descriptor, which ``ros2 param describe`` shows."""
    unit = f' [{item.unit}]' if item.unit else ''
    constraints = [f'one of: {", ".join(item.choices)}'] if item.choices else []
    if item.changes == UNCONFIGURED:
        constraints.append('can be set while the node is unconfigured')
    descriptor = ParameterDescriptor(
        description=f'{item.description}{unit}', read_only=item.changes == START,
        additional_constraints='; '.join(constraints))
    if type(item.default) is int:
        descriptor.integer_range = [
            IntegerRange(from_value=int(item.smallest), to_value=int(item.largest))]
    elif isinstance(item.default, float):
        # An integer given for a double must work; the range is checked separately.
        descriptor.dynamic_typing = True
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=item.smallest, to_value=item.largest)]
    return descriptor
