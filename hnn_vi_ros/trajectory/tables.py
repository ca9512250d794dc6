# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories as the tables of other libraries."""

from typing import TYPE_CHECKING

from hnn_vi_ros.files.optional_package import optional
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
