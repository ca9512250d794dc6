# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a run, with plots and export to other libraries."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
import json
from operator import attrgetter
import os
from pathlib import Path
from typing import Any, BinaryIO, final, NamedTuple, Self, TextIO, TYPE_CHECKING

from hnn_vi_ros.errors import listed, optional, RecordingError
from hnn_vi_ros.files import dump_yaml, no_file, one_line, parse_json, written
from hnn_vi_ros.hamiltonians import Hamiltonian, Mechanism, MECHANISMS, skeleton
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.phase_space import (
    column_units, columns, Coordinate, energy_unit, Event, momentum_name)
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.scene import described_scene, plain_data, Scene
from hnn_vi_ros.simulation.checks import check_numbers
from hnn_vi_ros.simulation.construction import build
from hnn_vi_ros.simulation.dense_step import whole_steps
from hnn_vi_ros.simulation.events import watched
from hnn_vi_ros.simulation.guards.base import Alarm
from hnn_vi_ros.simulation.path_error import OFF, PathError
from hnn_vi_ros.simulation.run_samples import record, Schedule
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np
from numpy.typing import ArrayLike
from safetensors import safe_open, SafetensorError
from safetensors.numpy import save_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    import pandas
    import xarray

_ARRAYS = ('t', 'q', 'p', 'energy', 'work')
# Least number of instants of a picture.
_LEAST_DRAWN = 500


class EnergyByCause(NamedTuple):
    """
    Energy of a run by cause.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Simulated time [s].
    names : tuple of str
        Names of the columns: ``work/CAUSE`` on the system and ``heat/CAUSE`` since the start,
        ``stored/CAUSE`` at present, and ``error``, H - H(0) - W, which no cause explains.
    values : np.ndarray, shape (N, C) or (N, m, C)
        Columns in this order; NaN at times between steps.
    unit : str
        Unit of H, and of all columns.

    """

    t: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray
    unit: str

    @property
    def units(self) -> dict[str, str]:
        """Return the units by column name, including ``t``."""
        return {'t': 's', **dict.fromkeys(self.names, self.unit)}

    def of(self, kind: str) -> dict[str, np.ndarray]:
        """Return the columns of ``work/``, ``stored/`` or ``heat/`` by cause."""
        return {name.removeprefix(kind): self.values[..., k] for k, name in enumerate(self.names)
                if name.startswith(kind)}

    def to_dataframe(self) -> 'pandas.DataFrame':
        """Return the columns as a DataFrame; see ``Trajectory.to_dataframe``."""
        return _data_frame(self.t, self.of(''), {'units': self.units})


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
    work : np.ndarray, shape (N,) or (N, m), or None
        Work W done on the system by effects since the start [J]: NaN at times between steps, and
        without energy_by_cause at some samples of runs with more than 10 000. None if no effect
        does work, and for m trajectories without energy_by_cause.
    energy_by_cause : EnergyByCause or None
        Work, stored energy and heat of each effect, if requested.
    path_error : PathError, or tuple of PathError
        Error of the path; for m trajectories a tuple of m. None if unknown.

    Examples
    --------
    >>> run = simulate('exact_pendulum', 1.0)
    >>> len(run), len(run[::10]), run.names
    (101, 11, (['angle'], ['p_angle']))

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
    energy_by_cause: EnergyByCause | None = None
    path_error: Any = None

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    def __getitem__(self, part: slice) -> Self:
        """Return a part of the samples, with their events."""
        if not isinstance(part, slice):
            raise TypeError(f'[{part!r:.40}] is no slice of the samples, as in trajectory[10:20]; '
                            'select(0) returns one of m trajectories')
        t, causes = self.t[part], self.energy_by_cause
        return replace(
            self, t=t, q=self.q[part], p=self.p[part], energy=self.energy[part],
            energy_by_cause=causes and causes._replace(t=t, values=causes.values[part]),
            work=None if self.work is None else self.work[part],
            events=tuple(event for event in self.events if len(t) and t[0] <= event.t <= t[-1]))

    def __call__(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """
        Return q and p, each of shape (d,) or (..., d), at any times of the run.

        The scene is simulated again with these samples, which are as accurate as the method.

        Parameters
        ----------
        t : float or array, shape (...)
            Times from 0 to the last sample [s].

        Raises
        ------
        ValueError
            A time is outside the run; there are several trajectories (see ``select``); or the run
            cannot be repeated, because it had commands.

        Examples
        --------
        >>> q, p = simulate('exact_pendulum', 1.0)([0.123, 0.456])
        >>> q.shape
        (2, 1)

        """
        run, times = self.single(), check_numbers('t', t)
        if not (len(run) and times.size and (times >= 0.0).all() and (times <= run.t[-1]).all()):
            raise ValueError('t must lie between 0 s and the last sample'
                             + f', {run.t[-1]:g} s' * bool(len(run)))
        simulation, scene = run.simulation(), run.scene
        assert scene is not None, 'a trajectory with a simulation has a scene'
        at = max(0, int(np.searchsorted(run.t, times.max(), side='right')) - 1)
        wanted, where = np.unique(np.append(times, run.t[at]), return_inverse=True)
        found = record(watched(simulation, scene), Schedule.at(wanted, float(wanted[-1])))
        run._check_repeated(found.q[where[-1]], at, 'pass times to simulate instead')
        q, p = found.q[where[:-1]], found.p[where[:-1]]
        return q.reshape(*times.shape, -1), p.reshape(*times.shape, -1)

    def _check_repeated(self, q: np.ndarray, at: int, instead: str) -> None:
        """Raise ValueError if q is not that of a sample."""
        if not np.allclose(q, self.q[at], rtol=1e-9, atol=1e-9):
            raise ValueError('this run cannot be repeated from its scene, for example because it '
                             f'had commands; {instead}')

    def loop_forces(self) -> np.ndarray:
        """
        Return the forces in the loops of a robot, shape (N, L, 6); the scene is simulated again.

        The force [N] and the moment [N m] of the second link of each loop on the first, at the
        joint, along the axes of the base: means over the step before a sample, NaN at t = 0 and
        between steps. Raise ValueError as a call does, or if there are no loops.
        """
        run = self.single()
        simulation, found, at = run.simulation(), [], 0
        nothing = np.full_like(simulation.loop_forces, np.nan)
        for k, time in enumerate(run.t.tolist()):
            step, share = whole_steps(time, simulation.step_size)
            simulation.advance(step - simulation.steps)
            at = at if share else k
            found.append(nothing if share or not step else simulation.loop_forces)
        run._check_repeated(simulation.q, at, 'read `loop_forces` of a Simulation instead')
        return np.array(found)

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
        return {'t': 's', **dict(pairs), 'H': energy_unit(self.coordinates)}

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
            raise IndexError(f'index {index} out of range: expected 0 to {count - 1}, or '
                             f'-{count} to -1 to count from the last')
        if self.q.ndim == 2:
            return self
        scene, (q, p) = self.scene, (self.q[:, index], self.p[:, index])
        causes = self.energy_by_cause
        if scene is not None and self.t[:1] == 0.0:
            scene = scene.with_overrides(initial_state={'q': q[0], 'p': p[0]})
        return replace(
            self, q=q, p=p, energy=self.energy[:, index], alarms=self.alarms[index], scene=scene,
            path_error=self.path_error and self.path_error[index],
            work=None if self.work is None else self.work[:, index],
            energy_by_cause=causes and causes._replace(values=causes.values[:, index]))

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
            raise ValueError(f'{self.q.shape[1]} trajectories cannot be shown as one; select one, '
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
            raise ValueError('this trajectory has no scene, whose H is needed; use one from '
                             'simulate or simulate_many')
        return build(self.scene)

    def facts(self) -> list[str]:
        """Return a short summary: samples, time span, energy."""
        many = f' of {self.q.shape[1]} trajectories' if self.q.ndim == 3 else ''
        change = float(np.abs(self.energy - self.energy[:1]).max(initial=0.0))
        first, unit = np.ravel(self.energy[:1]), energy_unit(self.coordinates)
        balance = self.balance()
        by_effects = ''
        # Smaller changes are rounding errors.
        if balance is not None and len(balance) > 1 and change > 1e-12 * abs(self.energy[0]):
            share = float(np.abs(balance).max(initial=0.0)) / change
            remedy = '; halve step_size' if share > 0.01 else ''
            by_effects = (', of which the work of effects leaves '
                          f'{100.0 * share:.2g} % unexplained{remedy}')
        return [f'{len(self.t)} samples{many}',
                f't = {self.t[0]:g} to {self.t[-1]:g} s' if len(self.t) else 'no samples',
                'H = ' + (f'{first[0]:.6g}' if first.size == 1 else
                          f'{first.min(initial=np.inf):.6g} to {first.max(initial=-np.inf):.6g}')
                + f' {unit}, largest change {change:.2g} {unit}{by_effects}']

    def balance(self) -> np.ndarray | None:
        """Return H - H(0) - W [J], shape (n,), where W is known; None if no effect does work."""
        if self.work is None or self.energy.ndim == 2:
            return None
        known = np.isfinite(self.work)
        energy, work = self.energy[known], self.work[known]
        return energy - energy[:1] - work + work[:1]

    def alarm_kinds(self) -> list[str]:
        """Return the kinds of the alarms, without duplicates."""
        own = self.alarms if self.q.ndim == 2 else [one for each in self.alarms for one in each]
        return list(dict.fromkeys(getattr(alarm, 'kind', str(alarm)) for alarm in own))

    def _drawn(self) -> Self:
        """Return a run of internal steps, between which samples may be far apart, as drawn."""
        if self.scene is None or self.q.ndim == 3 or not 1 < len(self) < _LEAST_DRAWN or not (
                INTEGRATORS[self.scene.integrator.kind].tolerances):
            return self
        t = np.union1d(self.t, np.linspace(self.t[0], self.t[-1], _LEAST_DRAWN))
        try:
            q, p = self(t)
        except ValueError:
            # With commands there are only the samples.
            return self
        work = None if self.work is None else np.full(t.size, np.nan)
        if work is not None:
            work[np.searchsorted(t, self.t)] = self.work
        return replace(self, t=t, q=q, p=p, energy=self.hamiltonian().energy(q, p, t), work=work)

    def plot(self, coordinates: Sequence[str] | None = None) -> 'Figure':
        """
        Draw coordinates, momenta and the change of H over time, with one panel per unit.

        If effects do work W, the last panel shows the energy error H - H(0) - W.

        Events and alarms are vertical lines. Methods with internal steps are drawn between their
        samples as well. For m trajectories there is one panel per column.

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
        return draw_series(self._drawn().of(coordinates))

    def plot_energy(self) -> 'Figure':
        """
        Draw the energy that each cause stored, took and gave, and the error.

        Stored energies are drawn above zero, each from its lowest value in the run; heat and other
        energy taken by effects below. Lines are the works of causes that also give energy.

        Returns
        -------
        matplotlib.figure.Figure
            See ``plot``.

        Raises
        ------
        MissingPackage
            matplotlib is not installed.
        ValueError
            The run has no ``energy_by_cause``, or several trajectories (see ``select``).

        """
        from hnn_vi_ros.simulation.trajectory.figures import draw_energy
        return draw_energy(self.single())

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
        return draw_portrait(self._drawn().of(coordinates), contours=len(self.coordinates) == 1)

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
        return _data_frame(self.t, self._columns(), {'title': self.title, 'units': self.units})

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

    def to_csv(self, target: str | Path | TextIO | BinaryIO) -> None:
        """
        Write t [s], coordinates, momenta and H [J] as CSV, from which they are read exactly.

        Parameters
        ----------
        target : str, Path or stream
            File to write; an existing one is replaced.

        Raises
        ------
        ValueError
            There are several trajectories (see ``select``).

        """
        run = self.single()
        if isinstance(target, str | Path):
            with written(Path(target)) as stream:
                return run.to_csv(stream)
        np.savetxt(target, np.column_stack([run.t, run.q, run.p, run.energy]), delimiter=',',
                   header=','.join(['t', *run._columns()]), comments='', fmt='%.17g')

    def save(self, path: str | Path) -> None:
        """
        Write everything to a safetensors file, which ``load`` reads.

        Parameters
        ----------
        path : str or Path
            File to write; an existing one is replaced.

        Examples
        --------
        >>> run.save('run.safetensors')
        >>> len(Trajectory.load('run.safetensors')) == len(run)
        True

        """
        arrays = {name: np.ascontiguousarray(getattr(self, name)) for name in _ARRAYS
                  if getattr(self, name) is not None}
        causes = self.energy_by_cause
        if causes is not None:
            arrays['causes'] = np.ascontiguousarray(causes.values)
        errors = self._path_errors()
        if errors:
            arrays['path_errors'] = np.concatenate([
                np.column_stack([error.t, error.value]) for error in errors])
        rest = {'coordinates': [asdict(own) for own in self.coordinates], 'alarms': self.alarms,
                'causes': causes and causes.names,
                'path_errors': [(len(error.t), *error.numbers) for error in errors],
                'events': [plain_data(asdict(event)) for event in self.events]}
        scene = '' if self.scene is None else dump_yaml(self.scene.model_dump() | {
            'source': str(self.scene.source), 'model_files': self.scene.model_digests})
        with written(Path(path)) as stream:
            save_file(arrays, stream.name, {'trajectory': json.dumps(rest), 'scene': scene})

    @classmethod
    def load(cls, path: str | Path, trust_code: bool = False) -> Self:
        """
        Return a trajectory that ``save`` wrote.

        Parameters
        ----------
        path : str or Path
            File to read.
        trust_code : bool, optional
            True to allow Python code named in its scene.

        Raises
        ------
        RecordingError
            The file cannot be read, or its scene names code; one line.

        """
        try:
            with safe_open(path, 'np') as file:
                arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
                texts = file.metadata()
            rest, text = parse_json(texts['trajectory'].encode()), texts['scene']
            many, causes = arrays['q'].ndim == 3, arrays.pop('causes', None)
            paths, errors = arrays.pop('path_errors', np.empty((0, 2))), list[PathError]()
            for count, *numbers in rest['path_errors']:
                errors.append(PathError(*paths[:count].T, *numbers))
                paths = paths[count:]
            coordinates = tuple(Coordinate(**own) for own in rest['coordinates'])
            return cls(
                path_error=(tuple(errors) if many else errors[0]) if errors else None,
                energy_by_cause=None if causes is None else EnergyByCause(
                    arrays['t'], tuple(rest['causes']), causes, energy_unit(coordinates)),
                **arrays, coordinates=coordinates,
                alarms=tuple(tuple(Alarm(*own) for own in each) if many else Alarm(*each)
                             for each in rest['alarms']),
                events=tuple(Event(**own | {half: np.array(own[half]) for half in 'qp'})
                             for own in rest['events']),
                scene=described_scene(text, str(path), trust_code)[0] if text else None)
        except (OSError, SafetensorError, KeyError, TypeError, ValueError) as problem:
            what = one_line(problem) if os.path.isfile(path) else no_file(Path(path))
            raise RecordingError(f'{path}: {what}; give a file that Trajectory.save wrote'
                                 ) from problem

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
        scene, causes = run.scene, run.energy_by_cause
        hamiltonian = simulation.hamiltonian
        assert scene is not None, 'a trajectory with a Hamiltonian has a scene'
        if isinstance(target, str) and '://' not in target:
            target = Path(target)
        h, first = scene.known_step_size, float(run.energy[0])
        stamps = [round(t * 1e9) for t in run.t.tolist()]
        dH_dq, dH_dp = hamiltonian.gradient(run.q, run.p, run.t)
        sink = RerunSink(
            scene.name, target, hamiltonian, run.q[0], run.p[0],
            box=hamiltonian.box or box_of(run.q, run.p),
            mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
            effects=simulation.effects, step_size=h, modified=False,
            causes=causes.names if causes else (), conservative=run.work is None, interval=0,
            begin=(stamps[0], round(run.t[0] / h)))
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
                    float('nan'), (energy - first - work) / (abs(first) or 1.0), work,
                    causes=causes and causes.values[k]))
        finally:
            sink.close()

    def _columns(self) -> dict[str, np.ndarray]:
        """Return the columns of q, p and H by name, each of shape (N,) or (N, m)."""
        (q_names, p_names), (q, p) = self.names, (self.q, self.p)
        return {**{name: q[..., i] for i, name in enumerate(q_names)},
                **{name: p[..., i] for i, name in enumerate(p_names)}, 'H': self.energy}

    def __repr__(self) -> str:
        alarms = [f'alarms: {", ".join(self.alarm_kinds())}'] if self.alarm_kinds() else []
        parts = [self.title, ', '.join(self.facts()), *self._path_facts(), *alarms]
        return f'Trajectory({"; ".join(parts)})'

    def _path_errors(self) -> list[PathError]:
        """Return the path errors of all trajectories, [] if there are none."""
        if self.path_error is None:
            return []
        return [self.path_error] if self.q.ndim == 2 else list(self.path_error)

    def _path_facts(self) -> list[str]:
        """Return the path error in a line, for m trajectories the largest; [] if it is off."""
        errors = [error for error in self._path_errors() if error.reason != OFF]
        measured = [error for error in errors if len(error.value)]
        if not measured or self.q.ndim == 2:
            return list(map(str, errors[:1]))
        worst = max(measured, key=attrgetter('largest'))
        return [f'{worst}, in the worst of {len(measured)} trajectories that were measured']


def _data_frame(t: np.ndarray, data: dict[str, np.ndarray], attributes: dict[str, Any]
                ) -> 'pandas.DataFrame':
    """Return columns, of shape (N,) or (N, m), as a DataFrame; see Trajectory."""
    with optional('pandas', 'to_dataframe'):
        import pandas
    index: pandas.Index = pandas.Index(t, name='t')
    first = next(iter(data.values()))
    if first.ndim == 2:
        index = pandas.MultiIndex.from_product([range(first.shape[1]), t],
                                               names=['trajectory', 't'])
        data = {name: values.T.ravel() for name, values in data.items()}
    frame = pandas.DataFrame(data, index=index)
    frame.attrs |= attributes
    return frame
