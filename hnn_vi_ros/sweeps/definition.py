# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The schema of a sweep's YAML: a scene, its axes, and the results that are kept."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files import find_yaml, KeyPlaces, NAMES_CODE, read_yaml, StrictModel, validate
from pydantic import Field, model_validator

# Maximum size of an axis and of a sweep: the length of a Sobol sequence without repeated points.
MOST = 2**30

Key = Annotated[str, Field(min_length=1, max_length=256, description=(
    'a key of the scene, with dots: hamiltonian.length, effects.0.rate, initial_state.q.angle'))]
Keys = Annotated[list[Key], Field(min_length=1, max_length=1000)]
Numbers = Annotated[list[float], Field(min_length=1, max_length=1000)]


class ValuesChoice(StrictModel):
    """Values of one key in the order given."""

    kind: Literal['values'] = Field(description='values of one key')
    key: Key
    values: list[bool | int | float | str | list[float]] = Field(
        min_length=1, max_length=10_000, description='what it takes')


class _Ranges(StrictModel):
    """Ranges of several keys."""

    keys: Keys
    low: Numbers = Field(description='the lower bound of each key')
    high: Numbers = Field(description='the upper bound of each key')

    @model_validator(mode='after')
    def _check_bounds(self) -> Self:
        for name in ('low', 'high', 'counts'):
            if (count := len(getattr(self, name, self.keys))) != len(self.keys):
                raise ValueError(f'{name} has {count} values, expected '
                                 f'{len(self.keys)}, one for each of keys')
        for key, low, high in zip(self.keys, self.low, self.high, strict=True):
            if not low <= high:
                raise ValueError(f'{key}: low = {low:g} lies above high = {high:g}')
        return self


class GridChoice(_Ranges):
    """All combinations of evenly spaced values including the bounds."""

    kind: Literal['grid'] = Field(description='evenly spaced values in all combinations')
    counts: list[Annotated[int, Field(ge=1, le=MOST)]] = Field(
        min_length=1, max_length=1000, description='how many values of each key')


class BoxChoice(_Ranges):
    """Points drawn uniformly from a box."""

    kind: Literal['box'] = Field(description='points drawn evenly from a box')
    count: int = Field(ge=1, le=MOST, description='how many points')


class SobolChoice(_Ranges):
    """Points of a scrambled Sobol sequence, which fill a box more evenly than random ones."""

    kind: Literal['sobol'] = Field(description="points of Sobol's sequence in a box, scrambled")
    count: int = Field(ge=1, le=MOST, description='how many points; best a power of two')


class FileChoice(StrictModel):
    """The rows of a table of numbers."""

    kind: Literal['file'] = Field(description='rows of a CSV file, whose first line names keys')
    path: str = Field(min_length=1, max_length=4096, description='from the folder of this file')


class PosteriorChoice(StrictModel):
    """Parameters of an identified model, drawn from their normal distribution."""

    kind: Literal['posterior'] = Field(description=(
        'numbers of an identified model, drawn from what was found of them'))
    path: str = Field(min_length=1, max_length=4096, description=(
        'the JSON file of the identification, from the folder of this file'))
    count: int = Field(ge=1, le=MOST, description='how many draws')
    keys: dict[Annotated[str, Field(min_length=1, max_length=256)], Key] | None = Field(
        None, min_length=1, max_length=1000, description=(
            'the key of the scene for each number that is drawn, by its name in the file; without '
            'it the names there are keys'))


class RepeatsChoice(StrictModel):
    """Repetitions with independent noise; if a key is given, it is set to a seed as well."""

    kind: Literal['repeats'] = Field(description='the same again, each with noise of its own')
    count: int = Field(ge=1, le=MOST, description='how often')
    key: Key | None = Field(None, description=(
        'where a seed of its own goes, such as that of a function of yours; effects need none'))


AxisChoice = Annotated[
    ValuesChoice | GridChoice | BoxChoice | SobolChoice | FileChoice | PosteriorChoice
    | RepeatsChoice,
    Field(discriminator='kind')]


class Reduction(StrictModel):
    """A user's Python function that reduces a trajectory to some numbers."""

    function: Annotated[str, NAMES_CODE] = Field(pattern=r'^[\w.]+:\w+$', description=(
        'package.module:function; takes a Trajectory, returns a mapping of columns to numbers'))
    columns: list[Annotated[str, Field(min_length=1, max_length=256)]] = Field(
        min_length=1, max_length=1000, description='names of what it returns')


class Sweep(StrictModel):
    """Sweep of a scene: one simulation per combination of values of the axes."""

    description: str = Field('', max_length=1000, description='one line for lists and titles')
    scene: str = Field(min_length=1, max_length=4096, description=(
        'the name of a shipped scene, or a YAML file, looked for beside this one first'))
    duration: float = Field(gt=0.0, le=1e12, description='simulated time [s]')
    vary: list[AxisChoice] = Field(min_length=1, max_length=20, description=(
        'what varies, in all combinations; the last one fastest'))
    every: int | None = Field(None, ge=1, le=2**53, description=(
        'steps from one sample to the next, which statistics, guards and the reduction see; '
        'without it only the first state and the last'))
    keep: Literal['final', 'samples'] = Field('final', description=(
        'the last state of each trajectory, or all samples'))
    statistics: list[Literal[
        'energy_band', 'out_of_box_time', 'event_times', 'lyapunov_time']] = Field(
            [], max_length=4, description=(
                'of each trajectory: max - min of H over the samples [J]; time in which samples '
                'are outside of the box that the model was trained in [s]; times of the events '
                'of the scene [s]; the Lyapunov time [s]'))
    reduction: Reduction | None = Field(None, description='numbers by a function of yours')
    seed: int = Field(0, ge=0, lt=2**63, description='of all that is drawn, by index')
    shard_size: int | None = Field(None, ge=1, le=2**20, description=(
        'trajectories in a file, rounded up to whole blocks; by default some 10^7 steps'))

    @model_validator(mode='after')
    def _check_samples(self) -> Self:
        seen = [name for name in self.statistics if name in ('energy_band', 'out_of_box_time')]
        needing = ['keep: samples'] * (self.keep == 'samples') + seen
        if needing and self.every is None:
            raise ValueError(f'every: required by {", ".join(needing)}: steps from one sample to '
                             'the next')
        if len(set(self.statistics)) < len(self.statistics):
            raise ValueError('statistics: each can be asked for once')
        return self


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
