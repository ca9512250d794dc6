# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run a sweep from the command line or from Python."""

from collections.abc import Iterator, Mapping
import os
from pathlib import Path
import sys
import time
from typing import Any
import warnings

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import is_path, json_schema, ProgressLine
from hnn_vi_ros.simulation import check_count, usable_processors
from hnn_vi_ros.sweeps import arguments
from hnn_vi_ros.sweeps.definition import Sweep
from hnn_vi_ros.sweeps.folder import ShardSurvey, SweepFolder
from hnn_vi_ros.sweeps.plan import make_plan, SweepPlan
from hnn_vi_ros.sweeps.trajectories import Runner
from hnn_vi_ros.sweeps.workers import make_here, make_in_processes, ShardJob


def main(argv: list[str]) -> int:
    """Make the shards requested by the command line, and report the outcome."""
    options = arguments.sweep().parse_args(argv)
    if options.schema:
        print(json_schema(Sweep, 'A sweep of hnn_vi_ros'))
        return 0
    out = options.out or Path('sweeps') / Path(options.sweep).stem
    begin = time.monotonic()
    jobs = _processes(options.device) if options.jobs is None else options.jobs
    try:
        plan, folder = _make(options.sweep, out, jobs, options.ray, options.device, True)
    except (ValueError, TypeError) as problem:
        raise ParameterError(str(problem)) from problem
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f'stopped; complete shards are in {out}: the same command continues') from None
    found = folder.survey(plan)
    print(_summary(plan, folder, found, time.monotonic() - begin))
    return int(bool(found.missing))


def _processes(device: str | None) -> int:
    """Return the default number of processes."""
    return 1 if device is not None and device.startswith('cuda') else usable_processors()


def sweep(definition: str | Path | Mapping[str, Any], out: str | Path, *, jobs: int = 1,
          ray: str | None = None, device: str | None = None, progress: bool = False) -> Path:
    """
    Simulate a scene for many parameters and initial states, and write a Parquet dataset.

    Shards already in the folder are not made again. A failed trajectory is a row with the reason
    in the column ``failure``.

    Parameters
    ----------
    definition : str, Path or mapping
        Name of a shipped sweep, path of a YAML file, or its content.
    out : str or Path
        Output folder: ``sweep.json`` and ``part-*.parquet``.
    jobs : int, optional
        Number of processes. More than one are spawned and import the caller's main module, so its
        work must be under ``if __name__ == '__main__'``.
    ray : str, optional
        Address of a Ray cluster that replaces the processes, ``'auto'`` or ``'local'``.
    device : str, optional
        Step in torch on ``'cuda'``, ``'cuda:N'`` or ``'cpu'`` instead of in compiled loops; see
        ``simulate_many``. The device is recorded, and the folder accepts no other device.
    progress : bool, optional
        True to show the progress in a line on standard error.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    HnnViRosError
        The sweep, its scene or the folder cannot be used, or the folder holds another sweep.
    ValueError, TypeError
        An argument is invalid.

    Examples
    --------
    >>> lengths = {'kind': 'values', 'key': 'hamiltonian.length', 'values': [0.5, 1.0]}
    >>> folder = sweep({'scene': 'exact_pendulum', 'duration': 1.0, 'vary': [lengths]}, 'lengths')
    >>> sorted(path.suffix for path in folder.iterdir())
    ['.json', '.parquet']

    """
    return _make(definition, Path(out), jobs, ray, device, progress)[1].path


def _make(definition: str | Path | Mapping[str, Any], out: Path, jobs: int, ray: str | None,
          device: str | None, progress: bool) -> tuple[SweepPlan, SweepFolder]:
    """Make the shards that are missing; see ``sweep``."""
    if ray is not None:
        # Imported here because it is an optional extra, and first because it may be missing.
        from hnn_vi_ros.sweeps.ray_cluster import make_on_ray
    check_count('jobs', jobs)
    folder = SweepFolder(out)
    if not isinstance(definition, Mapping) and is_path('sweep', str(definition)):
        # Make the path absolute: workers may start in another folder.
        definition = os.path.abspath(definition)
    plan = make_plan(definition, (folder.record() or {}).get('scene'), device)
    Runner(plan).check()
    folder.begin(plan)
    shards, damaged = folder.survey(plan)[:2]
    for text in damaged:
        text += '; it is computed again'
        if progress:
            print(f'sweep: {text}', file=sys.stderr)
        else:
            warnings.warn(text, stacklevel=3)
    line = _Progress(plan, shards) if progress else None
    job = ShardJob(definition if isinstance(definition, Mapping) else str(definition),
                   plan.record['scene'], plan.record['digest'], device)
    made: Iterator[int]
    if ray is not None:
        made = make_on_ray(job, folder, shards, ray)
    elif min(jobs, len(shards)) > 1:
        made = make_in_processes(job, folder, shards, jobs)
    else:
        made = make_here(plan, folder, shards)
    try:
        for shard_made in made:
            if line:
                line.shard(len(plan.indices(shard_made)))
    finally:
        if line:
            line.close()
    return plan, folder


def _summary(plan: SweepPlan, folder: SweepFolder, found: ShardSurvey, seconds: float) -> str:
    parts = [f'{plan.shards - len(found.missing)} of {plan.shards} shards of {plan.count} '
             'trajectories',
             f'{found.failures} failed (see the column failure)' if found.failures
             else 'none failed',
             *(f'{count} with alarm: {kind}' for kind, count in found.alarms.most_common()),
             *found.damaged]
    return f'{folder.path}: {", ".join(parts)}; {seconds:.1f} s'


class _Progress:
    """Progress line: number of finished trajectories, and the remaining time."""

    def __init__(self, plan: SweepPlan, shards: list[int]):
        self._left, self._total = sum(len(plan.indices(shard)) for shard in shards), plan.count
        self._line, self._made, self._start = ProgressLine(), 0, time.monotonic()

    def shard(self, count: int) -> None:
        """Count the trajectories of a finished shard."""
        self._made += count
        pace, done = self._made / (time.monotonic() - self._start), (
            self._total - self._left + self._made)
        self._line.show(done / self._total, (
            f'{done} of {self._total} trajectories, {pace:.3g} per second, '
            f'{(self._left - self._made) / pace:.0f} s left'))

    def close(self) -> None:
        """Clear the line."""
        self._line.close()
