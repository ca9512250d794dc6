# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories as tables of pandas and xarray, and as recordings of rerun."""

from pathlib import Path
from typing import TYPE_CHECKING

from hnn_vi_ros.files.optional_package import optional
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.simulation.sample import Sample
from hnn_vi_ros.trajectory.data import TrajectoryData
import numpy as np

if TYPE_CHECKING:
    import pandas
    import xarray


def dataframe_of(trajectory: TrajectoryData) -> 'pandas.DataFrame':
    """Return the table of ``Trajectory.to_dataframe``."""
    with optional('pandas', 'to_dataframe'):
        import pandas
    data = _columns(trajectory)
    index: pandas.Index = pandas.Index(trajectory.t, name='t')
    if trajectory.q.ndim == 3:
        count = trajectory.q.shape[1]
        index = pandas.MultiIndex.from_product([range(count), trajectory.t],
                                               names=['trajectory', 't'])
        data = {name: values.T.ravel() for name, values in data.items()}
    frame = pandas.DataFrame(data, index=index)
    frame.attrs |= {'title': trajectory.title, 'units': trajectory.units}
    return frame


def dataset_of(trajectory: TrajectoryData) -> 'xarray.Dataset':
    """Return the dataset of ``Trajectory.to_xarray``."""
    with optional('xarray', 'to_xarray'):
        import xarray
    units, many = trajectory.units, trajectory.q.ndim == 3
    axes = ('t', 'trajectory') if many else ('t',)
    variables = {name: (axes, values, {'units': units[name]})
                 for name, values in _columns(trajectory).items()}
    places = {'t': ('t', trajectory.t, {'units': units['t']})}
    if many:
        places['trajectory'] = ('trajectory', np.arange(trajectory.q.shape[1]), {})
    return xarray.Dataset(variables, places, {'title': trajectory.title})


def _columns(trajectory: TrajectoryData) -> dict[str, np.ndarray]:
    """Return all columns by name, each of shape (N,) or (N, m)."""
    (q_names, p_names), (q, p) = trajectory.names, (trajectory.q, trajectory.p)
    return {**{name: q[..., i] for i, name in enumerate(q_names)},
            **{name: p[..., i] for i, name in enumerate(p_names)}, 'H': trajectory.energy}


def record(trajectory: TrajectoryData, target: str | Path | int) -> None:
    """Send what ``Trajectory.to_rerun`` tells."""
    # Tables need no rerun.
    with optional('rerun', 'to_rerun'):
        from hnn_vi_ros.viewer.rerun_sink import RerunSink
    run, simulation = trajectory.single(), trajectory.simulation()
    scene = run.scene
    hamiltonian = simulation.hamiltonian
    assert scene is not None, 'it has a Hamiltonian'
    if isinstance(target, str) and '://' not in target:
        target = Path(target)
    h, first = scene.known_step_size, float(run.energy[0])
    stamps = [round(t * 1e9) for t in run.t.tolist()]
    dH_dq, dH_dp = hamiltonian.gradient(run.q, run.p)
    # The work of effects is not part of a trajectory: its error is that of H alone.
    sink = RerunSink(
        scene.name, target, hamiltonian, run.q[0], run.p[0], box=hamiltonian.box,
        mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
        effects=simulation.effects, step_size=h, modified=False,
        interval=0, begin=(stamps[0], round(run.t[0] / h)))
    try:
        told = [(event.t, f'event {event}', 'INFO') for event in run.events] + [
            (alarm.step * h, alarm.message, 'WARN') for alarm in run.alarms]
        for t, text, level in sorted(told):
            sink.event(text, level, (round(t * 1e9), round(t / h)))
        for k, stamp in enumerate(stamps):
            energy = float(run.energy[k])
            sink.write(Sample(
                round(run.t[k] / h), stamp, run.q[k], run.p[k], dH_dq[k], dH_dp[k], energy,
                float('nan'), (energy - first) / (abs(first) or 1.0)))
    finally:
        sink.close()
