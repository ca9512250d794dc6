# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Loads: what the robot of one machine carried in each log, and the gains of its servos."""

from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from pathlib import Path

from hnn_vi_ros.errors import listed, ParameterError
from hnn_vi_ros.files import read_yaml, StrictModel, units_in
from hnn_vi_ros.hamiltonians import Payload
from hnn_vi_ros.scene import numbers_of, Scene, set_value, with_values
from pydantic import Field


class Load(StrictModel):
    """Payload and stiffness of a machine during one log."""

    payload: Payload | None = Field(None, description='payload of the robot, as in a scene')
    free: list[str] = Field([], description=(
        'numbers of the payload to fit from their values, such as mass and centre.2'))
    gain: float = Field(1.0, gt=0.0, le=1e6, description='factor on the stiffness of servos [1]')


class Loads(StrictModel):
    """The loads of logs."""

    logs: dict[str, Load] = Field(description='load by the name of a log, or by a pattern')


def read_loads(path: Path | None) -> dict[str, Load]:
    """Return the loads in a YAML file by names of logs, or by patterns of names."""
    return {} if path is None else read_yaml(path, Loads, ParameterError)[0].logs


def load_of(loads: Mapping[str, Load], motion: str) -> str:
    """Return the name of the load of a motion; '' if no logs have loads."""
    # Pieces of a run have its name and a number.
    run = motion.rsplit('#', 1)[0]
    found = next((key for key in loads if key == run or fnmatchcase(run, key)), None)
    if found is None and loads:
        raise ParameterError(f'--loads: none for the log {run}; it has {listed(loads)}')
    return found or ''


def check_loads(loads: Mapping[str, Load], motions: Iterable[str]) -> None:
    """Raise ParameterError if a motion has no load, or a load no motion."""
    used = {load_of(loads, motion) for motion in motions}
    for key in loads:
        if key not in used:
            raise ParameterError(f'--loads: no log is called {key}; the logs are '
                                 f'{listed(dict.fromkeys(motions))}')


def load_numbers(loads: Mapping[str, Load]) -> dict[str, tuple[float, str]]:
    """Return value and unit of the free numbers of loads by name, such as book.payload.mass."""
    found = {}
    for key, load in loads.items():
        values = {} if load.payload is None else {
            f'{name}.{i}' if isinstance(value, list) else name: float(number)
            for name, value in load.payload.model_dump(exclude={'link'}).items()
            for i, number in enumerate(value if isinstance(value, list) else [value])}
        for name in load.free:
            if name not in values:
                raise ParameterError(f'--loads: {key}: no number {name!r} is in its payload; it '
                                     f'has {listed(values) or "none"}')
            unit, = units_in(Payload.model_fields[name.partition('.')[0]].description)
            found[f'{key}.payload.{name}'] = values[name], unit
    return found


def with_load(scene: Scene, load: Load, numbers: Mapping[str, float]) -> Scene:
    """
    Return a scene with the payload and the gains of a log.

    Parameters
    ----------
    scene : Scene
        Scene without them.
    load : Load
        Load of the log.
    numbers : mapping of str to float
        Other values of numbers of its payload, such as mass.

    """
    changes: dict[tuple[str | int, ...], object] = {}
    if load.payload is not None:
        payload = load.payload.model_dump()
        for name, value in numbers.items():
            set_value(payload, name.split('.'), value)
        changes['hamiltonian', 'payload'] = payload
    servos = tuple(f'effects.{i}.stiffness' for i, effect in enumerate(scene.effects)
                   if effect.kind == 'servo')
    if load.gain != 1.0:
        changes |= {tuple(place.split('.')): load.gain * value
                    for place, value in numbers_of(scene).items() if place.startswith(servos)}
    return with_values(scene, changes)
