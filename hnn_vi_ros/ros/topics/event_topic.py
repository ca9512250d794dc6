# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The events of a scene on ~/events, in the bag, in the picture and in the log."""

from collections.abc import Callable

from hnn_vi_ros.ros.plumbing.rclpy_internals import log
from hnn_vi_ros.ros.sinks.recording import Recording
from hnn_vi_ros.ros.topics.diagnostics_publisher import (
    DiagnosticsPublisher, OK, state_values, Status)
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.events import WatchedSimulation
from rclpy.node import Node

COMPONENT = 'event'


class EventTopic:
    """
    Topic of events: each is one message with one status, stamped with its own time.

    The status' message describes the event; its values are the condition, the direction, the
    time, the named q and p, and H, with all their digits.

    Parameters
    ----------
    node : Node
        The simulator.
    send : callable
        Publishes and records a message: the bytes, and its stamp in the bag [ns].
    scene : str
        Name of the scene.
    simulation : Simulation or WatchedSimulation
        The latter where the scene has events.

    """

    def __init__(self, node: Node, send: Callable[[bytes, int | None], None], scene: str,
                 simulation: Simulation | WatchedSimulation):
        self._node, self._simulation = node, simulation
        self._publisher = DiagnosticsPublisher(node, send, scene)

    def hand_out(self, sampler: Sampler, recording: Recording) -> None:
        """Publish, record, show and log the events since the last call."""
        if not isinstance(self._simulation, WatchedSimulation):
            return
        for event in self._simulation.take_events():
            (stamp, step), text = sampler.place_of(event.t), str(event)
            self._publisher.publish([Status(COMPONENT, OK, text, {
                'when': event.when, 'direction': event.direction, 't [s]': repr(stamp / 1e9)}
                | state_values(self._simulation.hamiltonian.coordinates, event.q, event.p)
                | {'H [J]': repr(event.energy)})], stamp)
            recording.event(text, 'INFO', (stamp, step))
            log(self._node, text, 'INFO')
