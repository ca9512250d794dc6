# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The bag of a run, as the node's parameters ask for it."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import final

from hnn_vi_ros.bags.bag_metadata import BagTopics, Topic
from hnn_vi_ros.bags.mcap_sink import McapSink
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.ros.parameters.settings import Settings
from hnn_vi_ros.run.held_state import STATE_FILE, state_file
from hnn_vi_ros.run.run_folder import bag_lines, RunFiles
from hnn_vi_ros.run.serialization import serialize
from hnn_vi_ros.run.sinks import Beginning, Sink
from hnn_vi_ros.simulation.sample import Sample
from std_msgs.msg import String


@final
class BagOutput(Sink):
    """
    MCAP bags: one from the beginning on, if it is asked for, and others when they are.

    Parameters
    ----------
    settings : Settings
        The node's parameters.
    topics : BagTopics
        Topics in the bag.
    files : RunFiles
        Which gives them names.

    """

    name = 'bag'

    def __init__(self, settings: Settings, topics: BagTopics, files: RunFiles):
        self._settings, self._topics, self._files = settings, topics, files
        # From the next beginning on.
        self.wanted = settings.record
        self._bags: list[Path] = []
        self._begin: Beginning
        self._begun_at: bytes
        self._sink: McapSink

    @property
    def target(self) -> str:
        """See Sink."""
        return str(self._bags[-1])

    @property
    def greeting(self) -> str:
        """See Sink."""
        return f'recording to {self.target}'

    def open(self, begin: Beginning) -> bool:  # noqa: A003
        """See Sink."""
        self._begin, self._bags = begin, []
        self._begun_at = state_file(begin.simulation)
        if self.wanted:
            self._bags.append(self._free())
            self._open_bag()
        return self.wanted

    def start(self) -> None:
        """Begin one more bag, in the state of now."""
        self._bags.append(self._free())
        try:
            self._open_bag()
        except RecordingError:
            self._bags.pop()
            raise
        self.wanted = True

    def write(self, sample: Sample, payloads: Sequence[bytes]) -> None:
        """See Sink."""
        self._sink.write(sample.stamp, payloads)

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        """See Sink."""
        self._sink.write_other(topic, stamp, payload)

    def flush(self) -> None:
        """See Sink."""
        self._sink.flush()

    def close(self) -> None:
        """See Sink."""
        self._sink.close()

    def files(self) -> list[str]:
        """See Sink."""
        return [line for bag in self._bags for line in bag_lines(bag)]

    def _free(self) -> Path:
        return self._files.free(self._settings.record_path, 'bag', self._begin.scene.name)

    def _open_bag(self) -> None:
        _, simulation, report, sampler = self._begin
        scene = dump_yaml(report)
        attachments = {
            'scene.yaml': scene.encode(),
            'parameters.yaml': dump_yaml(asdict(self._settings)).encode()}
        # Steps that were taken, a command that is held already: what the scene does not tell.
        if (state := state_file(simulation)) != self._begun_at:
            attachments[STATE_FILE] = state
        sink = McapSink(self._bags[-1], self._topics.tick, attachments)
        # Stamped with the state that the bag begins at, from which on it acts.
        sink.write_other(self._topics.scene, sampler.stamp, serialize(String(data=scene)))
        sink.flush()
        self._sink = sink
