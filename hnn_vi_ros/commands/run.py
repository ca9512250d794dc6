# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate a scene without ROS, and draw, show or keep its trajectory."""

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.run.ensemble import simulate
from hnn_vi_ros.run.trajectory import Trajectory
import numpy as np

# What files are written, by their suffix; known before anything is simulated.
_PICTURES = ('.png', '.svg', '.pdf')
_SUFFIXES = {'--plot': _PICTURES, '--portrait': _PICTURES, '--animate': ('.gif',),
             '--rerun': ('.rrd',)}


def main(argv: list[str]) -> int:
    """Simulate, print the result in a line, and write the files that were asked for."""
    options = arguments.run().parse_args(argv)
    writers = _writers(options)
    for option, path in ((option, path) for option, path, _ in writers):
        if path.suffix not in _SUFFIXES.get(option, (path.suffix,)):
            raise ParameterError(f'{option} {path}: no file of this kind can be written; valid: '
                                 f'{", ".join(_SUFFIXES[option])}')
        if path.exists():
            raise ParameterError(f'{option} {path}: exists already; name another file')
        if not path.parent.is_dir():
            raise ParameterError(f'{option} {path}: no folder {str(path.parent)!r}; make it first')
    trajectory = _simulated(options)
    print(trajectory)
    for event in trajectory.events:
        print(f'event {event}')
    for option, path, write in writers:
        try:
            write(trajectory, path)
        except OSError as problem:
            raise ParameterError(f'{option} {path}: cannot be written '
                                 f'({problem.strerror or problem})') from problem
        except ValueError as problem:
            raise ParameterError(f'{option} {path}: {problem}') from problem
        print(path)
    return 0


def _simulated(options: Namespace) -> Trajectory:
    try:
        return simulate(
            options.scene, options.duration, step_size=options.step_size,
            integrator=options.integrator, every=options.every)
    except ValueError as problem:
        raise ParameterError(str(problem)) from problem


def _writers(options: Namespace) -> list[tuple[str, Path, Callable[[Trajectory, Path], object]]]:
    """Return what was asked for: option, file, and what writes it."""
    offered: dict[str, Callable[[Trajectory, Path], object]] = {
        'csv': _write_csv,
        'plot': lambda run, path: run.plot().savefig(path, dpi=150),
        'portrait': lambda run, path: run.phase_portrait().savefig(path, dpi=150),
        'animate': lambda run, path: run.animate().save(path, writer='pillow'),
        'rerun': lambda run, path: run.to_rerun(path)}
    return [(f'--{name}', path, write) for name, write in offered.items()
            if (path := getattr(options, name)) is not None]


def _write_csv(trajectory: Trajectory, path: Path) -> None:
    """Write t [s], coordinates, momenta and H [J], each so that it is read back unchanged."""
    q, p = trajectory.names
    table = np.column_stack([trajectory.t, trajectory.q, trajectory.p, trajectory.energy])
    np.savetxt(path, table, delimiter=',', header=','.join(['t', *q, *p, 'H']), comments='',
               fmt='%.17g')
