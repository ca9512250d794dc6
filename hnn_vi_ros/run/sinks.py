# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Protocol of what takes the samples of a run besides ROS: a bag, a picture and others."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.bags.bag_metadata import Topic
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.run.timing import Figures
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample


class Beginning(NamedTuple):
    """
    Beginning of a sink's recording.

    Parameters
    ----------
    scene : Scene
        With the initial state from which the simulation continues.
    simulation : Simulation
        In its state of now.
    report : dict
        What ``~/scene`` tells.
    sampler : Sampler
        Whose stamps count.

    """

    scene: Scene
    simulation: Simulation
    report: dict[str, Any]
    sampler: Sampler


class Sink(ABC):
    """
    Something that a run is written to or shown by.

    Any method may raise RecordingError, which names the loss: the sink then gets no calls until
    it is opened again. Between ``open`` and ``close`` come samples and whatever
    else a sink cares for.

    Attributes
    ----------
    name : str
        By which /diagnostics tells where it goes.

    """

    name: str

    @property
    @abstractmethod
    def target(self) -> str:
        """Return where an open sink goes: a path, a URL or a port."""

    @property
    def greeting(self) -> str:
        """Return what is logged once all sinks are open; empty for nothing."""
        return ''

    @abstractmethod
    def open(self, begin: Beginning) -> bool:  # noqa: A003
        """Begin, again after ``close`` as well; return whether the sink wants anything."""

    @abstractmethod
    def write(self, sample: Sample, payloads: Sequence[bytes]) -> None:
        """Take a sample, and the messages that were published of it."""

    @abstractmethod
    def close(self) -> None:
        """Complete what was begun; makes no ROS call."""

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        """Take a message that does not come with each sample."""
        return

    def event(self, text: str, level: str, at: tuple[int, int] | None) -> None:
        """Take a line at a stamp [ns] and a step; level is INFO, WARN or ERROR."""
        return

    def timing(self, figures: Figures) -> None:
        """Take what steps cost lately, and the pace, at the newest sample."""
        return

    def flush(self) -> None:
        """Pass on samples that are held back, when no sample follows for a while."""
        return

    def files(self) -> list[str]:
        """Return lines that name the files made since ``open``, and how to open them."""
        return []
