# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a scene that can be changed in its object code."""

from collections.abc import Mapping
import math
from typing import NamedTuple

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

    def numbers(**values: float) -> np.ndarray | None:
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
    before = numbers()
    assert before is not None, 'the numbers of the scene itself'

    def parameter(name: str, value: float) -> Parameter:
        size, powers = abs(value) or 1.0, dict[int, float]()
        trials = {own: numbers(**{name: own}) for own in (
            value * factor or factor for factor in _FACTORS)}
        if simulation.system.constraints is None and numbers(**{name: 1e3 * size}) is not None:
            powers = _powers(before, value, trials, image.order)
        low = -LARGEST if numbers(**{name: -size}) is not None else 0.0 if numbers(
            **{name: 0.0}) is not None else math.ulp(0.0)
        return Parameter(name, value, low, powers)

    found = [parameter(name, value) for name, value in own.items()]
    return sorted(found, key=lambda one: not one.powers)


@np.errstate(all='ignore')
def _powers(numbers: np.ndarray, value: float, trials: Mapping[float, np.ndarray | None],
            order: np.ndarray) -> dict[int, float]:
    """Return the exponents of a value in each word, {} unless all are products of its powers."""
    found = dict[int, float]()
    others = [now.view(np.float64) for now in trials.values()
              if now is not None and now.size == numbers.size]
    if len(others) < len(trials):
        return {}
    first, base = next(iter(trials)), numbers.view(np.float64)
    differ = np.any([now.view(np.int64) != numbers for now in others], axis=0)
    for k in np.flatnonzero(differ).tolist():
        ratio = others[0][k] / base[k] if base[k] else 0.0
        # Roots have exponents of one half.
        power = 0.5 * round(2.0 * math.log(ratio) / math.log(first / value)) if (
            value and 0.0 < ratio < math.inf) else 1.0
        for own, now in zip(trials, others, strict=True):
            made = own if base[k] == value and power == 1.0 else (
                base[k] * np.float64(own / value)**power if value else math.nan)
            if not abs(made - now[k]) <= _ROUNDING * abs(made):
                return {}
        found[int(order[k])] = power
    return found
