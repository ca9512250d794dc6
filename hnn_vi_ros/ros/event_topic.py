# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The events of a scene on ~/events, in the bag, in the picture and in the log."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.ros.diagnostics_publisher import DiagnosticsPublisher, OK, Status
from hnn_vi_ros.ros.log import log
from hnn_vi_ros.ros.recording import Recording
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.events import WatchedSimulation
from rclpy.node import Node
from rclpy.publisher import Publisher

EVENTS_TOPIC: tuple[str, type] = ('~/events', DiagnosticArray)
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
    publisher : callable
        Makes that of the topic, where the scene has events.
    scene : str
        Name of the scene.
    simulation : Simulation or WatchedSimulation
        The latter where the scene has events.

    """

    def __init__(self, node: Node, publisher: Callable[[], Publisher], scene: str,
                 simulation: Simulation | WatchedSimulation):
        self._node, self._simulation = node, simulation
        names, momenta = columns(simulation.hamiltonian.coordinates)
        self._names = [*names, *(f'p_{name}' for name in momenta)]
        self._publisher = DiagnosticsPublisher(node, publisher(), scene) \
            if isinstance(simulation, WatchedSimulation) else None

    def hand_out(self, sampler: Sampler, recording: Recording) -> None:
        """Publish, record, show and log the events since the last call."""
        if self._publisher is None:
            return
        for event in self._simulation.take_events():
            (stamp, step), text = sampler.place_of(event.t), str(event)
            values = dict(zip(self._names, [*event.q.tolist(), *event.p.tolist()], strict=True))
            payload = self._publisher.publish([Status(COMPONENT, OK, text, {
                'when': event.when, 'direction': event.direction, 't [s]': repr(stamp / 1e9)}
                | {name: repr(value) for name, value in values.items()}
                | {'H [J]': repr(event.energy)})], stamp)
            recording.write_other(self._publisher.topic, stamp, payload)
            recording.event(text, 'INFO', (stamp, step))
            log(self._node, text, 'INFO')
