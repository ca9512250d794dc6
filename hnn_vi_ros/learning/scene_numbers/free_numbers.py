# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a scene that measured motions may tell, by the names that a user gives them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import did_you_mean, HnnViRosError, ParameterError
from hnn_vi_ros.files.yaml_file import units_in
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.learning.scene_numbers.robot import robot_numbers, with_robot_numbers
from hnn_vi_ros.scene import Parts, Scene
from hnn_vi_ros.scene.named_numbers import numbers_of, with_numbers
import numpy as np

# Numbers outside the scene: the states that windows begin in, and how late forces come [s].
STATES, DELAY = 'initial_state', 'input_delay'


@dataclass(frozen=True)
class Number:
    """
    A number to be found.

    Parameters
    ----------
    name : str
        As the user wrote it.
    place : str
        Its place in the scene, as ``numbers_of`` or ``robot_numbers`` have it; or DELAY.
    unit : str
        Empty where it is not known.
    start, low, high : float
        Where the search begins, and its bounds.

    """

    name: str
    place: str
    unit: str
    start: float
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class FreeScene:
    """
    A scene with some numbers free.

    Parameters
    ----------
    scene : Scene
        With all others.
    numbers : tuple of Number
        n of them.
    folder : Path
        Where the URDF of a robot whose numbers are free is written again and again.
    robot : frozenset of str
        The places of numbers that are the robot's.
    held : tuple of Number
        Numbers that keep their start.

    """

    scene: Scene
    numbers: tuple[Number, ...]
    folder: Path
    robot: frozenset[str] = frozenset()
    held: tuple[Number, ...] = ()

    def holding(self, k: int) -> 'FreeScene':
        """Return the scene with one number held where its search begins."""
        return replace(self, numbers=self.numbers[:k] + self.numbers[k + 1:],
                       held=(*self.held, self.numbers[k]))

    def starting_at(self, values: Sequence[float] | np.ndarray) -> 'FreeScene':
        """Return the scene with other values of its numbers to begin the search from."""
        return replace(self, numbers=tuple(replace(number, start=float(value)) for number, value in
                                           zip(self.numbers, values, strict=True)))

    def at(self, values: Sequence[float] | np.ndarray) -> tuple[Scene, float]:
        """Return the scene with values of the free numbers, and the delay of its input [s]."""
        given = dict(zip((number.place for number in self.numbers), map(float, values),
                         strict=True)) | {number.place: number.start for number in self.held}
        delay = given.pop(DELAY, 0.0)
        robot = {place: given.pop(place) for place in [*given] if place in self.robot}
        scene = with_numbers(self.scene, given)
        return (with_robot_numbers(scene, robot, self.folder / 'robot.urdf') if robot else scene
                ), delay


def free_scene(parts: Parts, names: Sequence[str], bounds: Mapping[str, tuple[float, float]],
               folder: Path, driven: bool) -> FreeScene:
    """
    Return a scene in which the numbers of these names are free.

    Parameters
    ----------
    parts : Parts
        Of the scene.
    names : sequence of str
        ``mass`` of H; ``damping.rate`` of the effect of that kind, ``damping.1.rate`` of the
        second one; ``forearm.mass`` of a link of a URDF; input_delay; or places, such as
        ``hamiltonian.mass`` and ``effects.0.rate``.
    bounds : mapping of str to (float, float)
        Of some of these names; others may be whatever the scene takes.
    folder : Path
        See FreeScene.
    driven : bool
        Whether the motions were, without which no delay can be found.

    Raises
    ------
    ParameterError
        An unknown name, or one that stands twice; bounds without the number between them.

    """
    scene = parts.scene
    known, robot = _known(scene), robot_numbers(scene)
    units = _units(scene, parts.hamiltonian)
    valid = {**known, **{name: name for name in robot}, **({DELAY: DELAY} if driven else {})}
    values = {**numbers_of(scene), **{name: value for name, (value, _) in robot.items()},
              DELAY: 0.0}
    numbers: list[Number] = []
    for name in names:
        place = valid.get(name) or (name if name in values and name != DELAY else None)
        if place is None:
            late = '; the data hold no forces that could come late' * (name == DELAY)
            raise ParameterError(f'--free {name}: {scene.name} has no such number'
                                 f'{did_you_mean(name, valid)}{late}; valid: '
                                 f'{", ".join([*valid, STATES])}')
        if place in [number.place for number in numbers]:
            raise ParameterError(f'--free {name}: stands twice; name it once')
        numbers.append(_number(name, place, values[place], units.get(place, ''), bounds))
    unknown = [name for name in bounds if name not in names]
    if unknown:
        raise ParameterError(f'--bounds {unknown[0]}: not among the free numbers '
                             f'({", ".join(names)})')
    free = FreeScene(scene, tuple(numbers), folder, frozenset(robot))
    return replace(free, numbers=tuple(_within(free, k) for k in range(len(numbers))))


def _number(name: str, place: str, start: float, unit: str,
            bounds: Mapping[str, tuple[float, float]]) -> Number:
    low, high = bounds.get(name, (-math.inf, math.inf))
    if not low < high:
        raise ParameterError(f'--bounds {name} {low:g} {high:g}: expected two numbers, '
                             'the lower one first')
    if not low <= start <= high:
        if name not in bounds or not (math.isfinite(low) and math.isfinite(high)):
            raise ParameterError(f'--bounds {name} {low:g} {high:g}: its value in the scene, '
                                 f'{start:g}, is not between them; change one or the other')
        start = 0.5 * (low + high)
    return Number(name, place, unit, start, low, high)


def _within(free: FreeScene, k: int) -> Number:
    """Return a number with the bounds beyond which the scene does not take it."""
    number = free.numbers[k]
    if number.place == DELAY:
        return _bounded(number, max(number.low, 0.0))
    if number.start < 0.0 or number.low >= 0.0:
        return number
    values = [float(other.start) for other in free.numbers]
    values[k] = -(number.start or 1e-3)
    try:
        free.at(values)[0].parts()
    except HnnViRosError:
        return _bounded(number, 0.0)
    return number


def _bounded(number: Number, low: float) -> Number:
    return replace(number, low=low)


def _known(scene: Scene) -> dict[str, str]:
    """Return the place of each number by short name, which counts effects of a repeated kind."""
    kinds = [effect.kind for effect in scene.effects]
    named: dict[str, str] = {}
    for place in numbers_of(scene):
        key, _, rest = place.partition('.')
        if key == 'hamiltonian':
            named[rest] = place
            continue
        index, _, rest = rest.partition('.')
        kind, number = kinds[int(index)], kinds[:int(index)].count(kinds[int(index)])
        own = kind if kinds.count(kind) == 1 else f'{kind}.{number}'
        named[f'{own}.{rest}'] = place
    return named


def _units(scene: Scene, hamiltonian: Hamiltonian) -> dict[str, str]:
    """Return the unit of each number whose description tells one."""
    parts: dict[str, Any] = {'hamiltonian': scene.hamiltonian} | {
        f'effects.{i}': effect for i, effect in enumerate(scene.effects)}
    own = {coordinate.name: coordinate.q_unit for coordinate in hamiltonian.coordinates}
    if hamiltonian.robot is not None:
        own |= {joint.name: joint.units.q for link in hamiltonian.robot.links.values()
                for joint in link.joints if joint.moves}
    units = {name: unit for name, (_, unit) in robot_numbers(scene).items()}
    units[DELAY] = 's'
    for place in numbers_of(scene):
        owner = next(key for key in sorted(parts, key=len, reverse=True)
                     if place.startswith(f'{key}.'))
        name, _, item = place.removeprefix(f'{owner}.').partition('.')
        described = type(parts[owner]).model_fields.get(name)
        named = _named(parts[owner], item)
        units[place] = _unit(units_in(described.description) if described else (), {
            own[one] for one in (own if named is None else named) if one in own})
    return units


def _named(part: Any, item: str) -> list[str] | None:
    """Return the coordinates that an item of H or of an effect is of; None for any."""
    given = getattr(part, 'coordinates', None)
    if item.isdecimal() and isinstance(given, list):
        return given[int(item):int(item) + 1]
    if item:
        return [item]
    one = getattr(part, 'coordinate', None)
    return [one] if isinstance(one, str) else given if isinstance(given, list) else None


def _unit(among: Sequence[str], kinds: set[str]) -> str:
    """Return the unit, of those of angles and of lengths, that belongs to coordinates in these."""
    if len(among) > 1 and kinds in ({'rad'}, {'m'}):
        turning = [one for one in among if 'rad' in one or one in ('N m', 'kg m2', 'kg m^2')]
        among = turning if 'rad' in kinds else [one for one in among if one not in turning]
    return ' or '.join(among)
