# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Remapped topics of the simulator."""

from collections.abc import Iterable

from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node


def remapped_names(node: Node, topics: Iterable[str]) -> dict[str, str]:
    """
    Return the new names of the remapped topics of a node, by their original full names.

    Parameters
    ----------
    node : Node
        Node, with or without remapping rules.
    topics : iterable of str
        Names in the code of the node, such as ``'~/state'``.

    """
    names = {expand_topic_name(topic, node.get_name(), node.get_namespace()):
             node.resolve_topic_name(topic) for topic in topics}
    return {own: called for own, called in names.items() if own != called}
