# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of trajectories: time series and phase portraits."""

from collections.abc import Sequence
import math
from textwrap import fill
from typing import Any, NamedTuple, TYPE_CHECKING

from hnn_vi_ros.errors import optional
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.phase_space import Coordinate, momentum_name, raised
from hnn_vi_ros.recording import contours as level_sets, Frame
from hnn_vi_ros.simulation.energy_by_cause import ERROR, HEAT, REST, STORED, WORK
from hnn_vi_ros.simulation.path_error import ACCURATE, PathError
from hnn_vi_ros.simulation.trajectory.trajectory import Trajectory
import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# P. Tol, Colour Schemes (2021), "high contrast", and black: distinguishable for colour-blind
# readers and in grey, with lightness L* of 29, 73, 50 and 0. Each has its own dash pattern. Four
# more curves take colours of his scheme "bright".
COLOURS = ('#004488', '#ddaa33', '#bb5566', '#000000')
_MORE_COLOURS = ('#66ccee', '#228833', '#aa3377', '#888888')
DASHES = ('-', (0, (5, 1.5)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1.2)))
EVENT, ALARM, CONTOUR = '0.55', '#bb5566', '0.82'
# More curves than this in one panel are shaded by number instead of named one by one.
MOST_NAMED = 8


def new_figure(width: float, height: float) -> 'Figure':
    """
    Return an empty figure of this size [inch], shown in a window if there is a display.

    Without windows, in a notebook or a script without a display, the figure is closed in pyplot,
    which would otherwise show it twice or never free it.
    """
    with optional('matplotlib', 'drawing a trajectory'):
        from matplotlib import get_backend, pyplot
    figure = pyplot.figure(figsize=(width, height), layout='constrained')
    if 'inline' in get_backend().lower() or get_backend().lower() == 'agg':
        pyplot.close(figure)
    return figure


def label(name: str, unit: str) -> str:
    """Return a name with its unit, with powers as superscripts; the unit '1' is omitted."""
    return name if unit == '1' else f'{name} [{raised(unit)}]'


def draw_curves(axes: 'Axes', curves: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> None:
    """
    Draw curves, given as tuples (name, x, y).

    More than MOST_NAMED curves are shaded from dark to light; only the first and last are named.
    """
    from matplotlib import colormaps
    shades = colormaps['cividis']
    for i, (name, x, y) in enumerate(curves):
        style: dict[str, Any]
        if len(curves) > MOST_NAMED:
            style = {'color': shades(0.9 * i / (len(curves) - 1)), 'linewidth': 0.8}
            if i > 0:
                name = f'... {name}' if i == len(curves) - 1 else '_nolegend_'
        else:
            style = {'color': (COLOURS + _MORE_COLOURS)[i], 'linewidth': 1.4,
                     'linestyle': DASHES[(i + i // len(COLOURS)) % len(DASHES)]}
        axes.plot(x, y, label=name, **style)


def name_curves(axes: 'Axes') -> None:
    """Add a legend to the right of a panel; a single curve is named by its axis instead."""
    if len(axes.get_legend_handles_labels()[1]) > 1:
        axes.legend(loc='center left', bbox_to_anchor=(1.01, 0.5), frameon=False,
                    fontsize='small', handlelength=2.6)


# Smallest share of the largest area that is drawn.
_VISIBLE = 1e-3
# Size of a panel, and of the margins around all of them [inch].
_WIDTH, _HEIGHT, _MARGINS = 8.0, 1.7, 0.8


class _Panel(NamedTuple):
    """Label of an axis and its curves, as tuples (name, x, y)."""

    label: str
    curves: list[tuple[str, np.ndarray, np.ndarray]]


def draw_series(trajectory: Trajectory) -> 'Figure':
    """Draw the figure of ``Trajectory.plot``."""
    panels = [*_panels(trajectory, 0), *_panels(trajectory, 1), *_energy_panels(trajectory)]
    figure = new_figure(_WIDTH, _HEIGHT * len(panels) + _MARGINS)
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    coordinates = len(_panels(trajectory, 0))
    for k, (axes, panel) in enumerate(zip(rows, panels, strict=True)):
        draw_curves(axes, panel.curves)
        if k < coordinates:
            _draw_path_error(axes, panel, trajectory.path_error)
        axes.set_ylabel(panel.label)
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    _draw_instants(rows, trajectory)
    for axes in rows:
        name_curves(axes)
    rows[-1].set_xlabel('t [s]')
    figure.align_ylabels(rows)
    begin = '' if trajectory.energy.ndim == 2 else (
        f', H(0) = {trajectory.energy[0]:.6g} {trajectory.units["H"]}')
    _write_title(figure, f'{trajectory.title}{begin}')
    return figure


def _draw_path_error(axes: 'Axes', panel: '_Panel', error: Any) -> None:
    """Draw the path error as bands around coordinates where it is visible, until it is lost."""
    if not isinstance(error, PathError) or not error.largest > ACCURATE:
        return
    for (_, t, q), line in zip(panel.curves, axes.get_lines(), strict=True):
        amplitude = 0.5 * (np.maximum.accumulate(q) - np.minimum.accumulate(q))
        band = np.interp(t, error.t, error.value, right=math.nan) * amplitude
        axes.fill_between(t, q - band, q + band, color=line.get_color(), alpha=0.2, linewidth=0.0)


def draw_energy(trajectory: Trajectory) -> 'Figure':
    """Draw the figure of ``Trajectory.plot_energy``."""
    causes = trajectory.energy_by_cause
    if causes is None:
        raise ValueError('the run has no energy by cause; pass energy_by_cause=True to simulate')
    known = np.isfinite(causes.values).all(axis=1)
    t, kinds = causes.t[known], [{name: own[known] for name, own in causes.of(kind).items()}
                                 for kind in (WORK, STORED, HEAT, ERROR)]
    works, stored, heats, error = kinds
    scene, unit = trajectory.scene, trajectory.units['H']
    named = {} if scene is None or scene.hamiltonian.kind not in HAMILTONIANS else {
        REST.removeprefix(STORED): scene.hamiltonian.kind}
    # Only rises count: the zero of a stored energy is arbitrary, and named.
    stored = {f'{named.get(name, name)} - ({own.min(initial=np.inf):.4g} {unit})':
              own - own.min(initial=np.inf) for name, own in stored.items()}
    works = {name: own for name, own in works.items() if name not in heats}
    figure = new_figure(_WIDTH, 2.5 * _HEIGHT + _HEIGHT + _MARGINS)
    upper, lower = rows = figure.subplots(2, 1, sharex=True, height_ratios=(2.5, 1))
    largest = max((np.abs(own).max(initial=0.0) for kind in (works, stored, heats)
                   for own in kind.values()), default=0.0)
    for parts, sign, what, shades in ((stored, 1.0, 'stored', 'YlGnBu_r'),
                                      (heats, -1.0, 'lost', 'YlOrRd_r')):
        _stack(upper, t, {f'{what}: {name}': sign * own
                          for name, own in parts.items()
                          if np.abs(own).max(initial=0.0) > _VISIBLE * largest}, shades)
    for i, (name, own) in enumerate(works.items()):
        upper.plot(t, own, color=COLOURS[-1], linewidth=1.6, linestyle=DASHES[i % len(DASHES)],
                   label=f'work: {name}')
    upper.axhline(0.0, color=COLOURS[-1], linewidth=0.6)
    lower.plot(t, error[''], color=COLOURS[0], linewidth=1.2, label='unexplained')
    upper.set_ylabel(label('lost   |   stored', unit))
    lower.set_ylabel(label('unexplained', unit))
    for axes in rows:
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    _draw_instants(rows, trajectory)
    for axes in rows:
        name_curves(axes)
    lower.set_xlabel('t [s]')
    figure.align_ylabels(rows)
    _write_title(figure, trajectory.title)
    return figure


def _stack(axes: 'Axes', t: np.ndarray, parts: dict[str, np.ndarray], shades: str) -> None:
    """Draw areas on top of each other, the first one at zero, in shades of a colour map."""
    from matplotlib import colormaps
    base = np.zeros(t.size)
    for i, (name, own) in enumerate(parts.items()):
        axes.fill_between(t, base, base + own, linewidth=0.0, label=name,
                          color=colormaps[shades](0.2 + 0.6 * i / len(parts)))
        base = base + own


def _write_title(figure: 'Figure', text: str) -> None:
    """Write the title of a figure, wrapped to its width."""
    # A letter is about 8 points wide; lines break at commas.
    parts = [part.replace(' ', '\N{NO-BREAK SPACE}') for part in text.split(', ')]
    # The scene's name may hold $, which begins a formula.
    figure.suptitle(fill(', '.join(parts), int(9.0 * figure.get_figwidth())), parse_math=False)


def _panels(trajectory: Trajectory, half: int) -> list[_Panel]:
    """Return a panel per unit of q (half 0) or p (half 1); per column for many trajectories."""
    values, units = (trajectory.q, trajectory.p)[half], trajectory.units
    names = trajectory.names[half]
    if values.ndim == 3:
        return [_Panel(label(name, units[name]), [
            (f'trajectory {k}', trajectory.t, values[:, k, i]) for k in range(values.shape[1])])
            for i, name in enumerate(names)]
    panels = []
    for unit in dict.fromkeys(units[name] for name in names):
        own = [(name, trajectory.t, values[:, i]) for i, name in enumerate(names)
               if units[name] == unit]
        panels.append(_Panel(label(own[0][0] if len(own) == 1 else 'qp'[half], unit), own))
    return panels


def _energy_panels(trajectory: Trajectory) -> list[_Panel]:
    """Return panels of the change of H, and of that change minus the work of effects."""
    t, change, work = trajectory.t, trajectory.energy - trajectory.energy[:1], trajectory.work
    unit = trajectory.units['H']
    if change.ndim == 2:
        return [_Panel(label('H - H(0)', unit), [
            (f'trajectory {k}', t, change[:, k]) for k in range(change.shape[1])])]
    panels = [_Panel(label('H - H(0)', unit), [('H - H(0)', t, change)])]
    if work is not None:
        known = np.isfinite(work)
        panels[0].curves.append(('work W', t[known], work[known]))
        panels.append(_Panel(label('H - H(0) - W', unit), [
            ('error', t[known], (change - work)[known])]))
    return panels


# Dash patterns of the alarms of a run [points]. Their numbers are above the first panel, higher
# where alarms follow within this share of the duration, by a line of text each [points].
_DASHES, _NEAR, _LINE = ((1, 2), (5, 2), (9, 2, 1, 2)), 0.03, 9


def _draw_instants(rows: np.ndarray, trajectory: Trajectory) -> None:
    """Draw vertical lines at events and alarms in every panel; no alarms for many trajectories."""
    for number, axes in enumerate(rows):
        named = set()
        for event in trajectory.events:
            axes.axvline(event.t, color=EVENT, linewidth=0.8, zorder=0, label=(
                f'event {event.when}' if number == 0 and event.when not in named else None))
            named.add(event.when)
    if trajectory.q.ndim == 3 or trajectory.scene is None or not len(trajectory.t):
        return
    near, last, level = _NEAR * float(np.ptp(trajectory.t)), -math.inf, 0
    ordered = sorted(trajectory.alarms, key=lambda alarm: alarm.step)
    for k, alarm in enumerate(ordered, 1):
        t = alarm.step * trajectory.scene.known_step_size
        level = level + 1 if t - last <= near else 0
        last = t
        for axes in rows:
            # In front of the frame: an alarm of the first step is on it.
            axes.axvline(t, color=ALARM, linewidth=1.2, clip_on=False, zorder=3 if level == 0
                         and t <= trajectory.t[0] else 0,
                         linestyle=(0, _DASHES[(k - 1) % len(_DASHES)]),
                         label=f'{k} alarm: {alarm.kind}' if axes is rows[-1] else None)
        rows[0].annotate(str(k), (t, 1.0), (0, 2 + _LINE * level), color=ALARM, fontsize=8,
                         xycoords=('data', 'axes fraction'), textcoords='offset points',
                         ha='center', annotation_clip=False)


# Side of a panel [inch], and maximum number of panels per row.
_SIDE, _MOST_IN_A_ROW = 3.6, 3
# Margin around the path, as a share of its extent.
_MARGIN = 0.08


def portrayed(trajectory: Trajectory) -> list[tuple[Coordinate, int, int]]:
    """
    Return the coordinates that have a phase plane, with their column indices in q and p.

    Raises
    ------
    ValueError
        There is none: all coordinates are rotations or poses.

    """
    q, p = (list(names) for names in trajectory.names)
    found = [(own, q.index(own.name), p.index(momentum_name(own.name)))
             for own in trajectory.coordinates if own.kind == 'scalar']
    if not found:
        raise ValueError('no coordinate has a phase plane, because '
                         f'{", ".join(own.name for own in trajectory.coordinates)} is not scalar; '
                         'use plot(), which draws its columns')
    return found


def draw_portrait(trajectory: Trajectory, contours: bool) -> 'Figure':
    """Draw the figure of ``Trajectory.phase_portrait``; contours adds level sets of H."""
    shown = portrayed(trajectory)
    across = min(len(shown), _MOST_IN_A_ROW)
    down = math.ceil(len(shown) / across)
    figure = new_figure(_SIDE * across + 1.4, _SIDE * down + 0.4)
    grid = figure.subplots(down, across, squeeze=False)
    for axes in grid.flat[len(shown):]:
        axes.remove()
    for axes, (own, i, k) in zip(grid.flat, shown, strict=False):
        q, p = trajectory.q[..., i], trajectory.p[..., k]
        axes.set(xlabel=label(own.name, own.q_unit),
                 ylabel=label(momentum_name(own.name), own.p_unit))
        axes.margins(_MARGIN)
        # Use few ticks with short labels, to avoid overlaps with neighbouring panels.
        axes.ticklabel_format(scilimits=(-2, 4))
        axes.locator_params('x', nbins=7)
        _draw_paths(axes, q, p)
        if contours and trajectory.scene is not None:
            draw_contours(axes, trajectory)
        axes.grid(alpha=0.3)
    # The legend is the same for every panel.
    name_curves(grid[0, across - 1])
    _write_title(figure, trajectory.title)
    return figure


def _draw_paths(axes: 'Axes', q: np.ndarray, p: np.ndarray) -> None:
    """Draw paths of shape (N,) or (N, m), with marks at their starts and ends."""
    paths = [('path', q, p)] if q.ndim == 1 else [
        (f'trajectory {k}', q[:, k], p[:, k]) for k in range(q.shape[1])]
    draw_curves(axes, paths)
    if len(paths) > MOST_NAMED:
        return
    for name, at, inside in (('start', 0, 'white'), ('end', -1, COLOURS[-1])):
        axes.plot(q[at], p[at], 'o', color=COLOURS[-1], markerfacecolor=inside, markersize=6.0,
                  zorder=3, label=name)


def draw_contours(axes: 'Axes', trajectory: Trajectory) -> None:
    """Draw level sets of H behind the path of a single coordinate, within the axes' limits."""
    from matplotlib.collections import LineCollection
    q, p = trajectory.q.reshape(-1, 1), trajectory.p.reshape(-1, 1)
    frame = Frame(0, axes.get_xlim(), axes.get_ylim())
    hamiltonian = trajectory.hamiltonian()
    levels = level_sets(hamiltonian, frame, q[0], p[0])
    name = 'level sets of H' if hamiltonian.time is None else 'level sets of H at t = 0'
    lines = LineCollection([line for _, own in levels for line in own], colors=CONTOUR,
                           linewidths=0.8, zorder=0, label=name)
    axes.add_collection(lines, autolim=False)
    axes.set(xlim=frame.q, ylim=frame.p)
