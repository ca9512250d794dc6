# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The picture of a run in rerun, as the node's parameters ask for it."""

from collections.abc import Sequence
from pathlib import Path
from typing import final

from hnn_vi_ros.files.optional_package import optional
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.ros.parameters.settings import Settings
from hnn_vi_ros.run.run_folder import picture_lines, RunFiles
from hnn_vi_ros.run.sinks import Beginning, Sink
from hnn_vi_ros.run.timing import Figures
from hnn_vi_ros.simulation.sample import Sample
import numpy as np

VIEWER_URL = 'rerun+http://127.0.0.1:9876/proxy'
SERVER_PORT = 9876
# Samples that the picture shows, per second of wall time.
_FRAME_RATE = 30.0


@final
class PictureOutput(Sink):
    """
    A rerun recording: to a file, to a viewer, or to those that connect.

    Parameters
    ----------
    settings : Settings
        The node's parameters.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that the picture leaves room for.
    files : RunFiles
        Which gives it a name.

    """

    name = 'rerun'

    def __init__(self, settings: Settings, box: tuple[np.ndarray, np.ndarray], files: RunFiles):
        self._settings, self._box, self._files = settings, box, files
        self._path: Path | None = None
        self._target: Path | str | int
        if settings.rerun_sink != 'none':
            # Imported here: a run without a picture starts without the viewer's libraries. One
            # that lacks them ends before anything is recorded.
            with optional('rerun', f'rerun_sink = {settings.rerun_sink} (none does without)'):
                from hnn_vi_ros.viewer.rerun_sink import RerunSink
            self._make = RerunSink

    @property
    def target(self) -> str:
        """See Sink."""
        return str(self._target)

    @property
    def greeting(self) -> str:
        """See Sink."""
        serves = self._settings.rerun_sink == 'serve'
        return f'rerun viewers can connect to {VIEWER_URL}' if serves else ''

    def open(self, begin: Beginning) -> bool:  # noqa: A003
        """See Sink."""
        settings, (scene, simulation, _, sampler) = self._settings, begin
        if settings.rerun_sink == 'none':
            return False
        if settings.rerun_sink == 'file':
            self._path = self._files.free(settings.rerun_path, 'recording.rrd', scene.name)
            self._target = self._path
        else:
            self._target = SERVER_PORT if settings.rerun_sink == 'serve' else (
                settings.rerun_path or VIEWER_URL)
        pace = settings.real_time_factor
        self._sink = self._make(
            scene.name, self._target, simulation.hamiltonian, simulation.q.copy(),
            simulation.p.copy(), box=self._box,
            mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
            effects=simulation.effects, step_size=simulation.step_size,
            conservative=simulation.conservative,
            modified=simulation.modified_energy is not None, pace=pace or None,
            band=scene.uncertainty is not None,
            begin=(sampler.stamp, simulation.steps),
            interval=round((pace or 1.0) / _FRAME_RATE * 1e9))
        return True

    def write(self, sample: Sample, payloads: Sequence[bytes]) -> None:
        """See Sink."""
        self._sink.write(sample)

    def event(self, text: str, level: str, at: tuple[int, int] | None) -> None:
        """See Sink."""
        self._sink.event(text, level, at)

    def timing(self, figures: Figures) -> None:
        """See Sink."""
        self._sink.timing((figures.microseconds_per_step_median,
                           figures.microseconds_per_step_p99), figures.real_time_factor)

    def close(self) -> None:
        """See Sink."""
        self._sink.close()

    def files(self) -> list[str]:
        """See Sink."""
        return picture_lines(self._path) if self._path is not None else []
