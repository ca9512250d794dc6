# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Random numbers that depend only on a seed and a count, so that any step can be repeated.

The state of a usual generator would have to be saved and restored for every attempt at a step.
"""

import math

from hnn_vi_ros.kernels import kept, part
import numpy as np

# The odd number nearest to 2^64 / golden ratio, the increment of SplitMix64.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@part()
def _mix(x: np.uint64) -> np.uint64:
    """Return the output function of SplitMix64, a bijection of 64-bit numbers."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@part()
def _uniform(key: np.uint64, count: np.uint64) -> float:
    """Return number ``count`` of the sequence of a key, in (0, 1]."""
    bits = _mix(key + (count + np.uint64(1)) * _GOLDEN) >> np.uint64(11)
    return (float(bits) + 1.0) * 2.0 ** -53


@part()
def _key(seed: int, draws: np.ndarray) -> np.uint64:
    """Return the key of a stream of numbers."""
    return _mix(_mix(np.uint64(seed) + _GOLDEN) ^ _mix(np.uint64(draws[2])))


@kept()
def draw_uniform(seed: int, draws: np.ndarray) -> float:
    """Return one number that is uniform in (0, 1]; see ``fill_normals``."""
    draws[1] += 1
    return _uniform(_key(seed, draws), np.uint64(draws[0] + draws[1] - 1))


@kept()
def fill_normals(seed: int, draws: np.ndarray, normals: np.ndarray) -> None:
    """
    Fill an array with standard normal numbers, by the Box-Muller method.

    Parameters
    ----------
    seed : int
        Seed of the random numbers.
    draws : np.ndarray, shape (3,)
        Counts of numbers drawn in completed steps and in the present one, which is increased, and
        the number of the stream. See EffectState.
    normals : np.ndarray, shape (n,)
        The array to fill.

    References
    ----------
    G. Steele, D. Lea, C. Flood, Fast splittable pseudorandom number generators, OOPSLA 2014.

    """
    key = _key(seed, draws)
    for i in range(normals.size):
        count = np.uint64(draws[0] + draws[1])
        radius = math.sqrt(-2.0 * math.log(_uniform(key, count)))
        normals[i] = radius * math.cos(2.0 * math.pi * _uniform(key, count + np.uint64(1)))
        draws[1] += 2
