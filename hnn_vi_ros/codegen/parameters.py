# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a scene that can be changed in its object code."""

from collections.abc import Mapping
import math
from typing import Any, NamedTuple

from hnn_vi_ros.codegen.image import Image, numbers_at
from hnn_vi_ros.effects import LARGEST
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.kernels import Block
from hnn_vi_ros.scene import numbers_of, Parts, with_known_numbers
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Factors of a number that show how words depend on it, and the relative rounding of these.
_FACTORS, _ROUNDING = (1.0625, 0.8125), 1e-12


class Parameter(NamedTuple):
    """
    Number of a scene, and the words of its image that depend on it.

    Parameters
    ----------
    name : str
        Name; see numbers_of.
    value, low : float
        Value in the scene, and the least one.
    powers : dict of int to float
        Exponent of the number in each of these words, a product of powers; empty if the number
        cannot be changed.

    """

    name: str
    value: float
    low: float
    powers: dict[int, float]


def parameters_of(parts: Parts, simulation: Simulation, memory: Block, image: Image
                  ) -> list[Parameter]:
    """
    Return the numbers of a scene, those that can be changed first.

    Parameters
    ----------
    parts : Parts
        Parts of the scene.
    simulation : Simulation
        Simulation of it, whose numbers are changed.
    memory, image : Block, Image
        Its memory, and the image of this memory.

    """
    own = numbers_of(parts.scene)
    of_effects = all(name.startswith('effects.') for name in own)

    def numbers(values: Mapping[str, float]) -> np.ndarray | None:
        """Return the memory with other values; None if they are not allowed or need other code."""
        try:
            scene = with_known_numbers(parts.scene, values)
            taken = simulation.take_numbers(
                parts.hamiltonian if of_effects else scene.create_hamiltonian(),
                scene.create_effects())
        except HnnViRosError:
            return None
        return numbers_at(memory) if taken else None

    # New workspaces, as after all other changes.
    before = numbers({})

    def words(values: Mapping[str, float]) -> np.ndarray | None:
        """Return the image with other values; see ``numbers``."""
        now = numbers(values)
        if now is None or before is None or now.size != before.size:
            return None
        found, differ = image.words.copy(), now != before
        found[image.order[differ]] = now[differ]
        return found

    def parameter(name: str, value: float) -> Parameter:
        size, powers = abs(value) or 1.0, dict[int, float]()
        trials = [(own, words({name: own})) for own in (value * factor or factor
                                                        for factor in _FACTORS)]
        bounded = simulation.system.constraints is not None or words({name: 1e3 * size}) is None
        if not bounded and all(found is not None for _, found in trials):
            powers = _powers(image.words, value, trials)
        negative, zero = words({name: -size}) is not None, words({name: 0.0}) is not None
        low = -LARGEST if negative else 0.0 if zero else math.ulp(0.0)
        words({name: value})
        return Parameter(name, value, low, powers)

    found = [parameter(name, value) for name, value in own.items()]
    changes = {one.name: (one.value or 1.0) * (1.0 + 0.01 * k)
               for k, one in enumerate(found, 1) if one.powers}
    together = words(changes) if changes else None
    if together is None or not np.allclose(
            tuned(image.words, found, changes).view(np.float64), together.view(np.float64),
            _ROUNDING, 0.0, equal_nan=True):
        found = [one._replace(powers={}) for one in found]
    return sorted(found, key=lambda one: not one.powers)


def _powers(words: np.ndarray, value: float, trials: list[tuple[float, Any]]) -> dict[int, float]:
    """Return the exponents of a number in words, {} unless all are products of powers of it."""
    found = dict[int, float]()
    for k in np.flatnonzero(np.any([words != other for _, other in trials], axis=0)).tolist():
        base, *others = (float(own.view(np.float64)[k]) for own in (
            words, *(other for _, other in trials)))
        powers = [1.0] * len(trials) if base == value == 0.0 else [
            math.log(other / base) / math.log(own / value) if value and base * other > 0.0
            and own / value > 0.0 else math.nan
            for other, (own, _) in zip(others, trials, strict=True)]
        # Roots have exponents of one half.
        power = 0.5 * round(2.0 * powers[0]) if math.isfinite(powers[0]) else math.nan
        made = [_changed(base, value, own, power) for own, _ in trials]
        if not np.allclose(made, others, _ROUNDING, 0.0):
            return {}
        found[k] = power
    return found


def _changed(word: float, before: float, now: float, power: float) -> float:
    """Return a word after a change of one of its factors; see entries."""
    if word == before and power == 1.0:
        return now
    return word * (now / before)**power if before else math.nan


def tuned(words: np.ndarray, parameters: list[Parameter], values: Mapping[str, float]
          ) -> np.ndarray:
    """Return the words with other values of parameters."""
    found = words.copy()
    for one in parameters:
        for k, power in one.powers.items():
            found.view(np.float64)[k] = _changed(
                float(found.view(np.float64)[k]), one.value, values[one.name], power)
    return found
