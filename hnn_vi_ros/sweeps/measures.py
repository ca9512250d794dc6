# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measures of a trajectory, in place of its samples."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hnn_vi_ros.accuracy.lyapunov import time_between_motions
from hnn_vi_ros.errors import HnnViRosError, listed
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.scene import Parts
from hnn_vi_ros.scene.choices import load_code
from hnn_vi_ros.sweeps.definition import Reduction
from hnn_vi_ros.trajectory.trajectory import Trajectory
import numpy as np


def measure(statistics: Sequence[str], trajectory: Trajectory, parts: Parts,
            joined: Hamiltonian, duration: float) -> dict[str, Any]:
    """
    Return statistics of a trajectory, by the columns that hold them.

    Parameters
    ----------
    statistics : sequence of str
        Which.
    trajectory : Trajectory
        With the initial state first.
    parts : Parts
        Of its scene.
    joined : Hamiltonian
        H with the potentials and fields among the effects.
    duration : float
        Within which chaos is looked for [s].

    Raises
    ------
    HnnViRosError, ValueError
        A statistic that cannot be had of this trajectory.

    """
    found: dict[str, Any] = {}
    for name in statistics:
        match name:
            case 'energy_band':
                found[name] = float(np.ptp(trajectory.energy))
            case 'out_of_box_time':
                found[name] = out_of_box_time(trajectory, joined)
            case 'event_times':
                found[name] = [event.t for event in trajectory.events]
                found['events'] = [event.when for event in trajectory.events]
            case 'lyapunov_time':
                h = parts.scene.known_step_size
                found[name] = time_between_motions(
                    parts.hamiltonian, parts.effects, parts.integrator, h, trajectory.q[0],
                    trajectory.p[0], max(1024, duration / h), parts.scene.on_failure)
    return found


def out_of_box_time(trajectory: Trajectory, hamiltonian: Hamiltonian) -> float:
    """
    Return for how long the samples of a path are outside of the training box [s].

    An interval counts if the sample at its end is outside.
    """
    assert hamiltonian.box is not None, 'it is asked for only where there is one'
    low, high = np.concatenate(hamiltonian.box).T
    gauge = hamiltonian.gauge
    x = trajectory.p if gauge is None else trajectory.p - trajectory.q @ gauge.T
    z = np.hstack([trajectory.q, x])
    outside = ~((low <= z) & (z <= high)).all(axis=1)
    return float(np.diff(trajectory.t)[outside[1:]].sum())


def _read_only(array: np.ndarray) -> np.ndarray:
    """Return a view that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


class Reducer:
    """
    A function of the user's, made ready.

    Parameters
    ----------
    reduction : Reduction
        Which.
    folder : str
        Where its module may be, apart from the installed ones.

    Raises
    ------
    SceneError
        It cannot be imported.

    """

    def __init__(self, reduction: Reduction, folder: str):
        self._name, self._columns = reduction.function, reduction.columns
        self._function = load_code(reduction.function, 'reduction', folder)

    def __call__(self, trajectory: Trajectory) -> dict[str, float]:
        """
        Return its numbers, by column; it may read the kept arrays, and not write them.

        Raises
        ------
        HnnViRosError
            It fails, or returns something else.

        """
        try:
            t, q, p, energy = map(_read_only, (
                trajectory.t, trajectory.q, trajectory.p, trajectory.energy))
            found = self._function(replace(trajectory, t=t, q=q, p=p, energy=energy))
            numbers = {name: float(found[name]) for name in self._columns}
            more = set(found) - set(self._columns)
        except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
            raise HnnViRosError(f'{self._name}: {type(problem).__name__}: {one_line(problem)}'
                                ) from problem
        if more:
            raise HnnViRosError(f'{self._name}: returned {listed(sorted(more))} '
                                'beside its columns; name them in columns')
        return numbers
