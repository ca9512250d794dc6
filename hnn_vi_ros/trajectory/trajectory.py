# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The samples of a run, which can be drawn, shown, and handed to other libraries."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import final, TYPE_CHECKING

from hnn_vi_ros.trajectory.data import TrajectoryData

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure
    import pandas
    import xarray


@final
@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(TrajectoryData):
    """
    The samples of one run, or of m trajectories that were simulated together.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Simulated time [s].
    q, p : np.ndarray, shape (N, d) or (N, m, d)
        Generalised coordinates and conjugate momenta; of p one column less for each rotation.
    energy : np.ndarray, shape (N,) or (N, m)
        H(q, p) [J].
    coordinates : tuple of Coordinate
        Names, units and kinds of the coordinates; see ``names`` and ``units``.
    alarms : tuple
        What guards found, the first Alarm of each kind; see guards. Of m trajectories, m tuples.
    events : tuple of Event
        Occurrences of the scene's ``events``, in the order of time.
    scene : Scene or None
        The simulated scene, with the method and the step size that were taken.

    """

    def plot(self, coordinates: Sequence[str] | None = None) -> 'Figure':
        """
        Draw coordinates, momenta and the change of H over time; a panel for each unit.

        Events and alarms are vertical lines. Of m trajectories each column has a panel.

        Parameters
        ----------
        coordinates : sequence of str, optional
            Names of those to draw, with their momenta; by default all.

        Returns
        -------
        matplotlib.figure.Figure
            ``.savefig('plot.png')`` writes it; ``matplotlib.pyplot.show()`` opens a window.

        Raises
        ------
        MissingPackage
            matplotlib is not installed.
        ValueError
            No such coordinate.

        """
        from hnn_vi_ros.trajectory.figures import draw_series
        return draw_series(self.of(coordinates))

    def phase_portrait(self, coordinates: Sequence[str] | None = None) -> 'Figure':
        """
        Draw each momentum over its coordinate, with level sets of H for a single coordinate.

        Parameters
        ----------
        coordinates : sequence of str, optional
            Names of those to draw; by default all but rotations, which have no such plane.

        Returns
        -------
        matplotlib.figure.Figure
            See ``plot``.

        Raises
        ------
        MissingPackage
            matplotlib is not installed.
        ValueError
            No such coordinate, or none that has a plane with its momentum.

        """
        from hnn_vi_ros.trajectory.figures import draw_portrait
        return draw_portrait(self.of(coordinates), contours=len(self.coordinates) == 1)

    def animate(self, speed: float = 1.0, rate: float = 25.0) -> 'FuncAnimation':
        """
        Move the mechanism of the scene, or without one the states in their phase portraits.

        Parameters
        ----------
        speed : float, optional
            Simulated seconds for each second of the picture.
        rate : float, optional
            Pictures a second [Hz].

        Returns
        -------
        matplotlib.animation.FuncAnimation
            ``.save('run.gif', writer='pillow')`` writes it; ``.to_jshtml()`` is for notebooks.

        Raises
        ------
        MissingPackage
            matplotlib is not installed.
        ValueError
            Several trajectories (see ``select``), or speed or rate not above 0.

        """
        from hnn_vi_ros.trajectory.figures import animate
        return animate(self, speed, rate)

    def to_dataframe(self) -> 'pandas.DataFrame':
        """
        Return the samples as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            The index is t [s], of m trajectories their number and t; a column for each coordinate
            and momentum, and H; ``attrs`` holds the units by column, and the title.

        Raises
        ------
        MissingPackage
            pandas is not installed.

        """
        from hnn_vi_ros.trajectory.exports import dataframe_of
        return dataframe_of(self)

    def to_xarray(self) -> 'xarray.Dataset':
        """
        Return the samples as an xarray Dataset.

        Returns
        -------
        xarray.Dataset
            A variable for each coordinate and momentum, and H, over ``t``, of m trajectories over
            ``trajectory`` too; each carries its unit in ``attrs['units']``.

        Raises
        ------
        MissingPackage
            xarray is not installed.

        """
        from hnn_vi_ros.trajectory.exports import dataset_of
        return dataset_of(self)

    def to_rerun(self, target: str | Path | int) -> None:
        """
        Show the run in the rerun viewer: series, phase portraits, mechanism, events and alarms.

        Parameters
        ----------
        target : str, Path or int
            A file to write, such as ``'run.rrd'``, which must not exist; the URL of a viewer to
            connect to (``rerun+http://127.0.0.1:9876/proxy``); or the port to serve viewers on.

        Raises
        ------
        MissingPackage
            rerun is not installed.
        RecordingError
            The file exists or cannot be written, no viewer listens, or the port is taken.
        ValueError
            Several trajectories (see ``select``), or one that knows no scene.

        """
        from hnn_vi_ros.trajectory.exports import record
        record(self, target)

    def __repr__(self) -> str:
        alarms = [f'alarms: {", ".join(self.alarm_kinds())}'] if self.alarm_kinds() else []
        return f'Trajectory({"; ".join([self.title, ", ".join(self.facts()), *alarms])})'

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        (q, p), units = self.names, self.units
        shown = [f'{name} [{units[name]}]' for name in (*q[:8], *p[:8])]
        rows = {'scene': self.title, 'samples': ', '.join(self.facts()),
                'coordinates and momenta': ', '.join(shown) + ' ...' * (len(q) > 8),
                'events': ', '.join(map(str, self.events[:5])) + ' ...' * (len(self.events) > 5),
                'alarms': ', '.join(self.alarm_kinds()) or 'none'}
        cells = ''.join(f'<tr><th style="text-align:left">{escape(name)}</th>'
                        f'<td style="text-align:left">{escape(text)}</td></tr>'
                        for name, text in rows.items() if text)
        return f'<table>{cells}</table>'
