# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate a scene without ROS, and plot, show or save its trajectory."""

from collections.abc import Callable, Mapping
from functools import partial
from io import BufferedWriter
import os
from pathlib import Path
import sys
from typing import TextIO

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import elapsed, no_file, save_figure, written
from hnn_vi_ros.simulation import is_wrong, simulate, Trajectory
import numpy as np

# Exit status of an unreliable run, if requested.
_UNRELIABLE_STATUS = 3
# Suffixes by option; options without an entry accept any suffix.
_PICTURES = ('.png', '.svg', '.pdf')
SUFFIXES = {'--plot': _PICTURES, '--portrait': _PICTURES, '--plot-energy': _PICTURES,
            '--rerun': ('.rrd',)}


def check_outputs(paths: Mapping[str, Path | None], force: bool) -> None:
    """
    Check that files can be written.

    Parameters
    ----------
    paths : mapping
        Paths by option; None if an option is not given.
    force : bool
        True if existing files may be overwritten.

    Raises
    ------
    ParameterError
        A file has a wrong suffix, exists already or is given twice, or its folder does not exist.

    """
    asked = {option: path for option, path in paths.items() if path is not None}
    for option, path in asked.items():
        others = [other for other in asked if other != option and asked[other] == path]
        if others:
            raise ParameterError(f'{option} {path}: {others[0]} names the same file; name two '
                                 'different files')
        valid = SUFFIXES.get(option, (path.suffix,))
        if path.suffix not in valid:
            raise ParameterError(f'{option} {path}: files of this type cannot be written; valid: '
                                 f'{", ".join(valid)}')
        if os.path.lexists(path) and not (force and path.is_file()):
            raise ParameterError(f'{option} {path}: ' + (
                f'{no_file(path)}; name a file' if force else
                'exists already; name another file, or add --force'))
        if not path.parent.is_dir():
            raise ParameterError(f'{option} {path}: no folder {str(path.parent)!r}; create it '
                                 'first')


def write_outputs(paths: Mapping[str, Path | None],
                  writers: Mapping[str, Callable[[BufferedWriter], object]],
                  force: bool, shown: TextIO | None = None) -> None:
    """
    Write the requested files, and print the path of each.

    Parameters
    ----------
    paths, force
        See ``check_outputs``.
    writers : mapping
        Function that writes to the stream of a file, by option.
    shown : text stream, optional
        Stream for the printed paths, by default standard output.

    Raises
    ------
    ParameterError
        A file cannot be written, or would be empty.

    """
    for option, write in writers.items():
        path = paths[option]
        if path is None:
            continue
        try:
            with written(path, new=not force) as stream:
                write(stream)
        except ValueError as problem:
            raise ParameterError(f'{option} {path}: {problem}') from problem
        print(path, file=shown)


def main(argv: list[str]) -> int:
    """
    Simulate, print the result in a line, and write the requested files.

    Returns
    -------
    int
        3 with ``--strict`` if an alarm says the run may be qualitatively wrong, else 0.

    """
    options = arguments.run().parse_args(argv)
    paths = {option: getattr(options, option[2:].replace('-', '_')) for option in _WRITERS}
    to_output = options.csv == Path('-')
    shown = sys.stderr if to_output else sys.stdout
    check_outputs(paths | {'--csv': None} if to_output else paths, options.force)
    try:
        with elapsed('compiling or simulating'):
            trajectory = simulate(
                options.scene, options.duration, step_size=options.step_size,
                integrator=options.integrator, every=options.every,
                energy_by_cause=options.plot_energy is not None)
    except ValueError as problem:
        raise ParameterError(str(problem)) from problem
    print(trajectory, file=shown)
    for event in trajectory.events:
        print(f'event {event}', file=shown)
    if (causes := trajectory.energy_by_cause) is not None:
        # Between steps no work is known.
        last = causes.values[np.isfinite(causes.values).all(axis=1)][-1]
        print(f'energy [{trajectory.units["H"]}]: ' + ', '.join(
            f'{name} {value:.4g}' for name, value in zip(causes.names, last, strict=True)),
            file=shown)
    if to_output:
        trajectory.to_csv(sys.stdout)
    write_outputs(paths | {'--csv': None} if to_output else paths, {
        option: partial(write, trajectory) for option, write in _WRITERS.items()},
        options.force, shown)
    if not any(paths.values()):
        print(_next_steps(options.scene, trajectory), file=shown)
    wrong = [kind for kind in trajectory.alarm_kinds() if is_wrong(kind)]
    if wrong:
        print(f'the run may be qualitatively wrong: {", ".join(wrong)}'
              + f' (status {_UNRELIABLE_STATUS})' * options.strict, file=shown)
    return _UNRELIABLE_STATUS if wrong and options.strict else 0


def _next_steps(name: str, trajectory: Trajectory) -> str:
    """Return the places of the scene and its models, and the next commands."""
    scene = trajectory.scene
    assert scene is not None, 'a run has a scene'
    models = ''.join(f', {path}' for path in scene.model_files().values())
    return (f'scene: {scene.source}{models}; no files were written\n'
            f'next:  hnn run {name} --plot {scene.name}.png   (or --csv -, --rerun)\n'
            f'       hnn scene --explain {name}')


def _write_rerun(run: Trajectory, stream: BufferedWriter) -> None:
    # The sink creates its file itself.
    os.unlink(stream.name)
    run.to_rerun(Path(stream.name))


_WRITERS: dict[str, Callable[[Trajectory, BufferedWriter], object]] = {
    '--csv': Trajectory.to_csv,
    '--plot': lambda run, stream: save_figure(stream, run.plot(), 150),
    '--portrait': lambda run, stream: save_figure(stream, run.phase_portrait(), 150),
    '--plot-energy': lambda run, stream: save_figure(stream, run.plot_energy(), 150),
    '--rerun': _write_rerun,
}
