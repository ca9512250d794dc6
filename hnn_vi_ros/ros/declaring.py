# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Declare the parameters of nodes that take them once, and document them."""

from collections.abc import Sequence

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros.parameters import Specification
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

Value = str | bool | float


def declare_read_only(node: Node, table: Sequence[Specification]) -> dict[str, Value]:
    """Declare parameters and return their values, checked; ParameterError in one line."""
    values = {}
    for item in table:
        descriptor = item.descriptor()
        descriptor.read_only = True
        try:
            parameter = node.declare_parameter(item.name, item.default, descriptor)
        except (InvalidParameterTypeException, InvalidParameterValueException) as problem:
            raise ParameterError(f'parameter {item.name}: {item.expected}; '
                                 f'{" ".join(str(problem).split())}') from problem
        values[item.name] = item.check(parameter.value)
    return values


def rows(table: Sequence[Specification]) -> str:
    """Return parameters as the rows of a table of the README."""
    lines = []
    for item in table:
        default = str(item.default).lower() if isinstance(item.default, bool) else item.default
        shown = f'`{default}`' if default != '' else 'empty'
        choices = f' ({", ".join(item.choices)})' if item.choices else ''
        lines.append(f'| `{item.name}` | {shown} | {item.unit} | {item.description}{choices} |')
    return '\n'.join(lines)
