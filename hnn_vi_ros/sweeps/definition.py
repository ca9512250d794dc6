# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The schema of a sweep's YAML: a scene, its axes, and the results that are kept."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files import find_yaml, KeyPlaces, NAMES_CODE, read_yaml, StrictModel, validate
from pydantic import Field

# Maximum size of an axis and of a sweep: the length of a Sobol sequence without repeated points.
# Maximum number of values of an axis, and of trajectories.
MAX_COUNT = 2**30

Key = Annotated[str, Field(min_length=1, max_length=256, description=(
    'key of the scene, with dots: hamiltonian.length, effects.0.rate, initial_state.q.angle'))]
Keys = Annotated[list[Key], Field(min_length=1, max_length=1000)]
Numbers = Annotated[list[float], Field(min_length=1, max_length=1000)]


class ValuesChoice(StrictModel):
    """Values of one key in the order given."""

    kind: Literal['values'] = Field(description='values of one key')
    key: Key
    values: list[bool | int | float | str | list[float]] = Field(
        min_length=1, max_length=10_000, description='values of the key')


class _Ranges(StrictModel):
    """Ranges of several keys."""

    keys: Keys
    low: Numbers = Field(description='lower bound of each key')
    high: Numbers = Field(description='upper bound of each key')

    def _check(self) -> None:
        for name in ('low', 'high', 'counts'):
            if (count := len(getattr(self, name, self.keys))) != len(self.keys):
                raise ValueError(f'{name} has {count} values, expected '
                                 f'{len(self.keys)}, one for each of keys')
        for key, low, high in zip(self.keys, self.low, self.high, strict=True):
            if not low <= high:
                raise ValueError(f'{key}: low = {low:g} is above high = {high:g}')


class GridChoice(_Ranges):
    """All combinations of evenly spaced values including the bounds."""

    kind: Literal['grid'] = Field(description='evenly spaced values in all combinations')
    counts: list[Annotated[int, Field(ge=1, le=MAX_COUNT)]] = Field(
        min_length=1, max_length=1000, description='number of values of each key')


class BoxChoice(_Ranges):
    """Points drawn uniformly from a box."""

    kind: Literal['box'] = Field(description='points drawn uniformly from a box')
    count: int = Field(ge=1, le=MAX_COUNT, description='number of points')


class SobolChoice(_Ranges):
    """Points of a scrambled Sobol sequence, which fill a box more evenly than random ones."""

    kind: Literal['sobol'] = Field(description='points of a scrambled Sobol sequence in a box')
    count: int = Field(ge=1, le=MAX_COUNT, description=(
        'number of points, preferably a power of two'))


class FileChoice(StrictModel):
    """The rows of a table of numbers."""

    kind: Literal['file'] = Field(description='rows of a CSV file whose first line names keys')
    path: str = Field(min_length=1, max_length=4096, description=(
        'path relative to the folder of this file'))


class PosteriorChoice(StrictModel):
    """Parameters of an identified model, drawn from their normal distribution."""

    kind: Literal['posterior'] = Field(description=(
        'parameters of an identified model, drawn from their normal distribution'))
    path: str = Field(min_length=1, max_length=4096, description=(
        'JSON file of the identification, relative to the folder of this file'))
    count: int = Field(ge=1, le=MAX_COUNT, description='number of draws')
    keys: dict[Annotated[str, Field(min_length=1, max_length=256)], Key] | None = Field(
        None, min_length=1, max_length=1000, description=(
            'key of the scene for each drawn parameter, by its name in the file; by default the '
            'place of each in the file, or its name'))


class RepeatsChoice(StrictModel):
    """Repetitions with independent noise; if a key is given, it is set to a seed as well."""

    kind: Literal['repeats'] = Field(description='repetitions with independent noise')
    count: int = Field(ge=1, le=MAX_COUNT, description='number of repetitions')
    key: Key | None = Field(None, description=(
        'key that each repetition sets to its own seed, such as that of a user function; effects '
        'need none'))


AxisChoice = Annotated[
    ValuesChoice | GridChoice | BoxChoice | SobolChoice | FileChoice | PosteriorChoice
    | RepeatsChoice,
    Field(discriminator='kind')]


class Reduction(StrictModel):
    """A user's Python function that reduces a trajectory to some numbers."""

    function: Annotated[str, NAMES_CODE] = Field(pattern=r'^[\w.]+:\w+$', description=(
        'package.module:function of a Trajectory that returns a mapping of columns to numbers'))
    columns: list[Annotated[str, Field(min_length=1, max_length=256)]] = Field(
        min_length=1, max_length=1000, description='names of the returned columns')


class Sweep(StrictModel):
    """Sweep of a scene: one simulation per combination of values of the axes."""

    description: str = Field('', max_length=1000, description='one line for lists and titles')
    scene: str = Field(min_length=1, max_length=4096, description=(
        'name of a shipped scene, or a YAML file, first searched in the folder of this file'))
    duration: float = Field(gt=0.0, le=1e12, description='simulated time [s]')
    vary: list[AxisChoice] = Field(min_length=1, max_length=20, description=(
        'axes, in all combinations; the last one varies fastest'))
    every: int | None = Field(None, ge=1, le=2**53, description=(
        'number of steps between samples, which statistics, guards and the reduction use; by '
        'default only the first and the last state'))
    keep: Literal['final', 'samples'] = Field('final', description=(
        'the last state of each trajectory, or all samples'))
    statistics: list[Literal[
        'energy_band', 'out_of_box_time', 'event_times', 'lyapunov_time', 'path_error']] = Field(
            [], max_length=5, description=(
                'of each trajectory: max - min of H over the samples [J]; time of the samples '
                'outside the training domain of the model [s]; times of the events of the scene '
                '[s]; Lyapunov time [s]; error of the path relative to its amplitude [1], NaN '
                'where it is not measured'))
    reduction: Reduction | None = Field(None, description='numbers computed by a user function')
    seed: int = Field(0, ge=0, lt=2**63, description=(
        'seed of all random numbers; each depends on the seed and on its index'))
    shard_size: int | None = Field(None, ge=1, le=2**20, description=(
        'trajectories per file, rounded up to whole blocks; by default about 10^7 steps'))

    def _check(self) -> None:
        seen = [name for name in self.statistics if name in ('energy_band', 'out_of_box_time')]
        needing = ['keep: samples'] * (self.keep == 'samples') + seen
        if needing and self.every is None:
            raise ValueError(f'every: required by {", ".join(needing)}: number of steps between '
                             'samples')
        if len(set(self.statistics)) < len(self.statistics):
            raise ValueError('statistics: each may occur once')


def load_sweep(sweep: str | Path | Mapping[str, Any]) -> tuple[Sweep, KeyPlaces, Path]:
    """
    Read and validate a sweep.

    Parameters
    ----------
    sweep : str, Path or mapping
        Name of a shipped sweep, path of a YAML file, or its content.

    Returns
    -------
    tuple of (Sweep, KeyPlaces, Path)
        The sweep, the places of its keys, and the folder its paths are relative to.

    Raises
    ------
    DataError
        The sweep does not exist or is not valid; the message names file, line and key.

    """
    if isinstance(sweep, Mapping):
        places = KeyPlaces.of_data(sweep, 'sweep')
        return validate(sweep, places, Sweep, DataError, trust_code=True), places, Path()
    if not isinstance(sweep, str | Path):
        raise TypeError(f'sweep is a {type(sweep).__name__}: give the name of a shipped sweep, '
                        'the path of a YAML file, or a mapping')
    path = find_yaml('sweep', str(sweep), DataError)
    loaded, places = read_yaml(path, Sweep, DataError)
    return loaded, places, path.parent
