# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a run, with plots, animations and export to other libraries."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any, final, Self, TYPE_CHECKING

from hnn_vi_ros.errors import listed, optional
from hnn_vi_ros.hamiltonians import Hamiltonian, Mechanism, MECHANISMS, skeleton
from hnn_vi_ros.phase_space import column_units, columns, Coordinate, Event, momentum_name
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation.construction import build
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure
    import pandas
    import xarray


@final
@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """
    Samples of one run, or of m trajectories simulated together.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Simulated time [s].
    q, p : np.ndarray, shape (N, d) or (N, m, d)
        Generalised coordinates and conjugate momenta; p has one column less for each rotation.
    energy : np.ndarray, shape (N,) or (N, m)
        H(q, p) [J].
    coordinates : tuple of Coordinate
        Names, units and kinds of the coordinates; see ``names`` and ``units``.
    alarms : tuple
        First Alarm of each kind raised by guards; for m trajectories a tuple of m tuples.
    events : tuple of Event
        Occurrences of the scene's ``events``, in chronological order.
    scene : Scene or None
        The simulated scene, with the method and the step size used.
    work : np.ndarray, shape (N,), or None
        Work W done on the system by effects since the start [J]: NaN at times between steps, and
        at some samples of runs with more than 10 000. None if no effect does work.

    """

    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    energy: np.ndarray
    coordinates: tuple[Coordinate, ...]
    alarms: tuple[Any, ...] = ()
    events: tuple[Event, ...] = ()
    scene: Scene | None = None
    work: np.ndarray | None = None

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """Return the names of the columns of q and of p."""
        q, p = columns(self.coordinates)
        return q, [momentum_name(name) for name in p]

    @property
    def units(self) -> dict[str, str]:
        """Return the units by column name, including ``t`` and ``H``."""
        pairs = zip((*self.names[0], *self.names[1]),
                    (unit for own in column_units(self.coordinates) for unit in own), strict=True)
        return {'t': 's', **dict(pairs), 'H': 'J'}

    @property
    def title(self) -> str:
        """Return the name of the scene, the method and the step size, if known."""
        if self.scene is None:
            return 'trajectory'
        return (f'{self.scene.name}, {self.scene.integrator.kind}, '
                f'h = {self.scene.known_step_size:g} s')

    def select(self, index: int) -> Self:
        """
        Return one of m trajectories.

        Parameters
        ----------
        index : int
            Zero-based index; -1 is the last.

        Raises
        ------
        IndexError
            Index out of range.

        """
        count = self.q.shape[1] if self.q.ndim == 3 else 1
        if not -count <= index < count:
            raise IndexError(f'trajectory {index}: expected 0 to {count - 1}, or -{count} to -1 '
                             'counted from the last')
        if self.q.ndim == 2:
            return self
        return replace(self, q=self.q[:, index], p=self.p[:, index],
                       energy=self.energy[:, index], alarms=self.alarms[index])

    def of(self, names: Sequence[str] | None) -> Self:
        """Return the trajectory restricted to some coordinates; ValueError for unknown names."""
        if names is None:
            return self
        known = [coordinate.name for coordinate in self.coordinates]
        wanted = [names] if isinstance(names, str) else list(names)
        for name in wanted:
            if name not in known:
                raise ValueError(f'no coordinate {name!r}; valid: {listed(known)}')
        kept = [known.index(name) for name in wanted]
        # Number of the coordinate that each column of q and of p belongs to.
        q, p = (np.repeat(np.arange(len(known)), [
            len(columns([own])[half]) for own in self.coordinates]) for half in (0, 1))
        return replace(
            self, coordinates=tuple(self.coordinates[k] for k in kept),
            q=self.q[..., np.concatenate([np.flatnonzero(q == k) for k in kept])],
            p=self.p[..., np.concatenate([np.flatnonzero(p == k) for k in kept])])

    def single(self) -> Self:
        """Return the trajectory itself, or raise ValueError if there are several."""
        if self.q.ndim == 3:
            raise ValueError(f'{self.q.shape[1]} trajectories cannot be shown as one: choose one, '
                             'as in trajectory.select(0)')
        return self

    def hamiltonian(self) -> Hamiltonian:
        """Return the scene's H including the potentials among its effects."""
        return self.simulation().hamiltonian

    def mechanism(self) -> Mechanism | None:
        """Return the mechanism of the scene, or the skeleton of its robot; None if neither."""
        if self.scene is None:
            return None
        if self.scene.mechanism is not None:
            return MECHANISMS[self.scene.mechanism]
        robot = self.hamiltonian().robot
        return None if robot is None else skeleton(robot, self.names[0])

    def simulation(self) -> Simulation:
        """Return a simulation of the scene in its initial state."""
        if self.scene is None:
            raise ValueError('this trajectory knows no scene, by whose H it could be shown: take '
                             'one of simulate or simulate_many')
        return build(self.scene)

    def facts(self) -> list[str]:
        """Return a short summary: samples, time span, energy."""
        many = f' of {self.q.shape[1]} trajectories' if self.q.ndim == 3 else ''
        change = float(np.abs(self.energy - self.energy[:1]).max(initial=0.0))
        first = np.ravel(self.energy[:1])
        balance = self.balance()
        by_effects = '' if balance is None else (
            f', the work of effects accounts for it to {np.abs(balance).max(initial=0.0):.2g} J')
        return [f'{len(self.t)} samples{many}',
                f't = {self.t[0]:g} to {self.t[-1]:g} s' if len(self.t) else 'no time',
                'H = ' + (f'{first[0]:.6g}' if first.size == 1 else
                          f'{first.min(initial=np.inf):.6g} to {first.max(initial=-np.inf):.6g}')
                + f' J, changed by {change:.2g} J at most{by_effects}']

    def balance(self) -> np.ndarray | None:
        """Return H - H(0) - W [J], shape (n,), where W is known; None if no effect does work."""
        if self.work is None or self.energy.ndim == 2:
            return None
        return (self.energy - self.energy[:1] - self.work)[np.isfinite(self.work)]

    def alarm_kinds(self) -> list[str]:
        """Return the kinds of the alarms, without duplicates."""
        own = self.alarms if self.q.ndim == 2 else [one for each in self.alarms for one in each]
        return list(dict.fromkeys(getattr(alarm, 'kind', str(alarm)) for alarm in own))

    def plot(self, coordinates: Sequence[str] | None = None) -> 'Figure':
        """
        Draw coordinates, momenta and the change of H over time, with one panel per unit.

        If effects do work W, the last panel shows the energy error H - H(0) - W.

        Events and alarms are vertical lines. For m trajectories there is one panel per column.

        Parameters
        ----------
        coordinates : sequence of str, optional
            Names of the coordinates to draw, with their momenta; by default all.

        Returns
        -------
        matplotlib.figure.Figure
            ``.savefig('plot.png')`` writes a file; ``matplotlib.pyplot.show()`` opens a window.

        Raises
        ------
        MissingPackage
            matplotlib is not installed.
        ValueError
            Unknown coordinate.

        """
        from hnn_vi_ros.simulation.trajectory.figures import draw_series
        return draw_series(self.of(coordinates))

    def phase_portrait(self, coordinates: Sequence[str] | None = None) -> 'Figure':
        """
        Draw each momentum over its coordinate, with level sets of H for a single coordinate.

        Parameters
        ----------
        coordinates : sequence of str, optional
            Names of coordinates to draw; by default all except rotations, which have no plane.

        Returns
        -------
        matplotlib.figure.Figure
            See ``plot``.

        Raises
        ------
        MissingPackage
            matplotlib is not installed.
        ValueError
            Unknown coordinate, or no coordinate with a phase plane.

        """
        from hnn_vi_ros.simulation.trajectory.figures import draw_portrait
        return draw_portrait(self.of(coordinates), contours=len(self.coordinates) == 1)

    def animate(self, speed: float = 1.0, rate: float = 25.0) -> 'FuncAnimation':
        """
        Animate the mechanism of the scene, or the states in phase portraits if there is none.

        Parameters
        ----------
        speed : float, optional
            Simulated seconds per second of the animation.
        rate : float, optional
            Frame rate [Hz].

        Returns
        -------
        matplotlib.animation.FuncAnimation
            ``.save('run.gif', writer='pillow')`` writes a file; ``.to_jshtml()`` is for notebooks.

        Raises
        ------
        MissingPackage
            matplotlib is not installed.
        ValueError
            There are several trajectories (see ``select``), or speed or rate is not positive.

        """
        from hnn_vi_ros.simulation.trajectory.figures import animate
        return animate(self, speed, rate)

    def to_dataframe(self) -> 'pandas.DataFrame':
        """
        Return the samples as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            Columns are the coordinates, the momenta and H. The index is t [s], or (trajectory, t)
            for m trajectories; ``attrs`` contains the units by column, and the title.

        Raises
        ------
        MissingPackage
            pandas is not installed.

        """
        with optional('pandas', 'to_dataframe'):
            import pandas
        data = self._columns()
        index: pandas.Index = pandas.Index(self.t, name='t')
        if self.q.ndim == 3:
            count = self.q.shape[1]
            index = pandas.MultiIndex.from_product([range(count), self.t],
                                                   names=['trajectory', 't'])
            data = {name: values.T.ravel() for name, values in data.items()}
        frame = pandas.DataFrame(data, index=index)
        frame.attrs |= {'title': self.title, 'units': self.units}
        return frame

    def to_xarray(self) -> 'xarray.Dataset':
        """
        Return the samples as an xarray Dataset.

        Returns
        -------
        xarray.Dataset
            Variables are the coordinates, the momenta and H, with dimension ``t`` and, for m
            trajectories, ``trajectory``; ``attrs['units']`` of each is its unit.

        Raises
        ------
        MissingPackage
            xarray is not installed.

        """
        with optional('xarray', 'to_xarray'):
            import xarray
        units, many = self.units, self.q.ndim == 3
        axes = ('t', 'trajectory') if many else ('t',)
        variables = {name: (axes, values, {'units': units[name]})
                     for name, values in self._columns().items()}
        places = {'t': ('t', self.t, {'units': units['t']})}
        if many:
            places['trajectory'] = ('trajectory', np.arange(self.q.shape[1]), {})
        return xarray.Dataset(variables, places, {'title': self.title})

    def to_rerun(self, target: str | Path | int) -> None:
        """
        Show the run in the rerun viewer: series, phase portraits, mechanism, events and alarms.

        Parameters
        ----------
        target : str, Path or int
            Path of a new file, such as ``'run.rrd'``; URL of a viewer to connect to
            (``rerun+http://127.0.0.1:9876/proxy``); or port on which to serve viewers.

        Raises
        ------
        MissingPackage
            rerun is not installed.
        RecordingError
            The file exists or cannot be written, no viewer listens, or the port is in use.
        ValueError
            There are several trajectories (see ``select``), or no scene is known.

        """
        # Imported here, since the other exports do not need rerun.
        with optional('rerun', 'to_rerun'):
            from hnn_vi_ros.recording import box_of, RerunSink
        run, simulation = self.single(), self.simulation()
        scene = run.scene
        hamiltonian = simulation.hamiltonian
        assert scene is not None, 'it has a Hamiltonian'
        if isinstance(target, str) and '://' not in target:
            target = Path(target)
        h, first = scene.known_step_size, float(run.energy[0])
        stamps = [round(t * 1e9) for t in run.t.tolist()]
        dH_dq, dH_dp = hamiltonian.gradient(run.q, run.p)
        sink = RerunSink(
            scene.name, target, hamiltonian, run.q[0], run.p[0],
            box=hamiltonian.box or box_of(run.q, run.p),
            mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
            effects=simulation.effects, step_size=h, modified=False,
            conservative=run.work is None, interval=0, begin=(stamps[0], round(run.t[0] / h)))
        try:
            told = [(event.t, f'event {event}', 'INFO') for event in run.events] + [
                (alarm.step * h, alarm.message, 'WARN') for alarm in run.alarms]
            for t, text, level in sorted(told):
                sink.event(text, level, (round(t * 1e9), round(t / h)))
            for k, stamp in enumerate(stamps):
                energy = float(run.energy[k])
                work = 0.0 if run.work is None else float(run.work[k])
                sink.write(Sample(
                    round(run.t[k] / h), stamp, run.q[k], run.p[k], dH_dq[k], dH_dp[k], energy,
                    float('nan'), (energy - first - work) / (abs(first) or 1.0), work))
        finally:
            sink.close()

    def _columns(self) -> dict[str, np.ndarray]:
        """Return the columns of q, p and H by name, each of shape (N,) or (N, m)."""
        (q_names, p_names), (q, p) = self.names, (self.q, self.p)
        return {**{name: q[..., i] for i, name in enumerate(q_names)},
                **{name: p[..., i] for i, name in enumerate(p_names)}, 'H': self.energy}

    def __repr__(self) -> str:
        alarms = [f'alarms: {", ".join(self.alarm_kinds())}'] if self.alarm_kinds() else []
        return f'Trajectory({"; ".join([self.title, ", ".join(self.facts()), *alarms])})'

    def _repr_html_(self) -> str:
        """Return an HTML table for notebooks."""
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
