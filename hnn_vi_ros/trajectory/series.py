# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Coordinates, momenta and the energy of a trajectory over time, as a figure."""

from typing import NamedTuple, TYPE_CHECKING

from hnn_vi_ros.trajectory.data import TrajectoryData
from hnn_vi_ros.trajectory.style import ALARM, draw_curves, EVENT, label, name_curves, new_figure
import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Size of a panel, and of the margins around all of them [inch].
_WIDTH, _HEIGHT, _AROUND = 8.0, 1.7, 0.8


class _Panel(NamedTuple):
    """Curves that share an axis, by name, and its label."""

    label: str
    curves: list[tuple[str, np.ndarray]]


def draw_series(trajectory: TrajectoryData) -> 'Figure':
    """Draw the figure of ``Trajectory.plot``."""
    panels = [*_panels(trajectory, 0), *_panels(trajectory, 1), _energy_panel(trajectory)]
    figure = new_figure(_WIDTH, _HEIGHT * len(panels) + _AROUND)
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, panels, strict=True):
        draw_curves(axes, [(name, trajectory.t, values) for name, values in panel.curves])
        axes.set_ylabel(panel.label)
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    _draw_instants(rows, trajectory)
    for axes in rows:
        name_curves(axes)
    rows[-1].set_xlabel('t [s]')
    figure.align_ylabels(rows)
    begin = '' if trajectory.energy.ndim == 2 else f', H(0) = {trajectory.energy[0]:.6g} J'
    figure.suptitle(f'{trajectory.title}{begin}')
    return figure


def _panels(trajectory: TrajectoryData, half: int) -> list[_Panel]:
    """Return a panel for each unit of q (half 0) or p (half 1), of many for each column."""
    values, units = (trajectory.q, trajectory.p)[half], trajectory.units
    names = trajectory.names[half]
    if values.ndim == 3:
        return [_Panel(label(name, units[name]), [
            (f'trajectory {k}', values[:, k, i]) for k in range(values.shape[1])])
            for i, name in enumerate(names)]
    panels = []
    for unit in dict.fromkeys(units[name] for name in names):
        own = [(name, values[:, i]) for i, name in enumerate(names) if units[name] == unit]
        panels.append(_Panel(label(own[0][0] if len(own) == 1 else 'qp'[half], unit), own))
    return panels


def _energy_panel(trajectory: TrajectoryData) -> _Panel:
    """Return the change of H, whose digits H itself would hide."""
    change = trajectory.energy - trajectory.energy[:1]
    if change.ndim == 2:
        return _Panel('H - H(0) [J]', [
            (f'trajectory {k}', change[:, k]) for k in range(change.shape[1])])
    return _Panel('H - H(0) [J]', [('H', change)])


def _draw_instants(rows: np.ndarray, trajectory: TrajectoryData) -> None:
    """Draw a line at each event, in every panel, and at each alarm that tells its step."""
    for number, axes in enumerate(rows):
        named = set()
        for event in trajectory.events:
            axes.axvline(event.t, color=EVENT, linewidth=0.8, zorder=0, label=(
                f'event {event.when}' if number == 0 and event.when not in named else None))
            named.add(event.when)
        if trajectory.q.ndim == 3 or trajectory.scene is None:
            continue
        for alarm in trajectory.alarms:
            axes.axvline(alarm.step * trajectory.scene.known_step_size, color=ALARM,
                         linewidth=1.2, linestyle=':', zorder=0,
                         label=f'alarm: {alarm.kind}' if number == len(rows) - 1 else None)
