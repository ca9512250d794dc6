# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate a scene without ROS, and draw, show or keep its trajectory."""

from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.commands.outputs import check_outputs, write_outputs
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.trajectory.simulate import simulate
from hnn_vi_ros.trajectory.trajectory import Trajectory
import numpy as np


def main(argv: list[str]) -> int:
    """Simulate, print the result in a line, and write the files that were asked for."""
    options = arguments.run().parse_args(argv)
    paths = {option: getattr(options, option[2:]) for option in _WRITERS}
    check_outputs(paths)
    trajectory = _simulated(options)
    print(trajectory)
    for event in trajectory.events:
        print(f'event {event}')
    write_outputs(paths, {option: partial(write, trajectory)
                          for option, write in _WRITERS.items()})
    return 0


def _simulated(options: Namespace) -> Trajectory:
    try:
        return simulate(
            options.scene, options.duration, step_size=options.step_size,
            integrator=options.integrator, every=options.every)
    except ValueError as problem:
        raise ParameterError(str(problem)) from problem


def _write_csv(trajectory: Trajectory, path: Path) -> None:
    """Write t [s], coordinates, momenta and H [J], each so that it is read back unchanged."""
    q, p = trajectory.names
    table = np.column_stack([trajectory.t, trajectory.q, trajectory.p, trajectory.energy])
    np.savetxt(path, table, delimiter=',', header=','.join(['t', *q, *p, 'H']), comments='',
               fmt='%.17g')


_WRITERS: dict[str, Callable[[Trajectory, Path], object]] = {
    '--csv': _write_csv,
    '--plot': lambda run, path: run.plot().savefig(path, dpi=150),
    '--portrait': lambda run, path: run.phase_portrait().savefig(path, dpi=150),
    '--animate': lambda run, path: run.animate().save(path, writer='pillow'),
    '--rerun': lambda run, path: run.to_rerun(path),
}
