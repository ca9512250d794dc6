# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Warnings about measured motions from which a fit would learn little or something wrong."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hnn_vi_ros.effects import LARGEST
from hnn_vi_ros.errors import counted
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.data.sampling import noise_of, resolution, ROUNDED
import numpy as np
from scipy.signal import periodogram

# Shortest log [samples]; largest share of samples at an extreme value, and of different values in
# a channel that is not held; coarsest resolution relative to the range; most steps of the
# resolution in which a joint stands still.
_SHORT, _AT_END, _DISTINCT, _COARSE, _STILL = 200, 0.02, 0.05, 0.02, 3.0
# Widest motion of a joint on the way of its commands: two turns [rad].
_WIDEST = 4.0 * np.pi
# Largest plausible turn between samples [rad].
_TURNED = 0.5 * np.pi
# Highest frequency of a motion, relative to the sampling rate, and share of its power that is near
# it; longest interval of samples [s].
_FASTEST, _POWER, _LONGEST = 0.35, 1e-5, 1.0
# Least correlation of a position with its command, and that which another joint has; slopes
# between which both have the same unit; longest delay of a command [s].
_FOLLOWS, _OTHER, _UNITS, _LATEST = 0.5, 0.9, (0.2, 5.0), 0.3


class LogWarning(NamedTuple):
    """A warning, and whether the log is useless because of it."""

    text: str
    useless: bool = False


def warnings_of(motions: Sequence[EvenMotion], names: Sequence[str], units: Sequence[str],
                even: bool = True) -> list[LogWarning]:
    """
    Return the warnings about motions.

    Parameters
    ----------
    motions : sequence of EvenMotion
        Motions at even times.
    names, units : sequence of str
        Names and units of the coordinates.
    even : bool, optional
        True if the samples of the log are at even times: between others, noise looks fast.

    """
    found, samples = list[LogWarning](), sum(len(motion.t) for motion in motions)
    spacing = motions[0].spacing
    if samples < _SHORT:
        found.append(LogWarning(f'{counted(samples, "sample")}: record at least {_SHORT}', True))
    if len({(one.q.tobytes(), one.tau.tobytes()) for one in motions}) < len(motions):
        found.append(LogWarning('a run has the samples of another: give each log once'))
    if spacing > _LONGEST:
        found.append(LogWarning(f'a sample every {spacing:.4g} s: check the unit of the times'))
    fastest = max(0.5 * (motion.cutoff_alone or motion.cutoff) for motion in motions)
    if fastest * spacing > _FASTEST and any(_is_fast(motion) for motion in motions):
        found.append(LogWarning(
            f'the motion has parts of up to {fastest:.3g} Hz, but {1.0 / spacing:.3g} samples per '
            f'second: record more of them', even))
    moves = []
    for k, name in enumerate(names):
        q = np.concatenate([motion.q[:, k] for motion in motions])
        moves.append(_moves(q))
        if not moves[-1]:
            found.append(LogWarning(f'{name} does not move'))
        else:
            found += _of_channel(q, f'position of {name}')
            if motions[0].commanded and np.ptp(q) > _WIDEST:
                found.append(LogWarning(f'{name} moves by {np.ptp(q):.3g}, more than two turns in '
                                        'rad: check the units of positions and commands'))
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        step = max(float(np.abs(np.diff(motion.q[:, k])).max()) for motion in motions)
        if unit == 'rad' and step > _TURNED:
            found.append(LogWarning(f'{name} turns by up to {step:.3g} rad between samples: '
                                    'check its unit, rad or deg, or record more of them'))
    if not any(moves):
        found.append(LogWarning('no joint moves: move them', True))
    tau = np.concatenate([motion.tau for motion in motions])
    if motions[0].commanded:
        found += _of_commands(motions, tau, names, moves)
    elif not motions[0].held:
        for k in range(tau.shape[1] if tau.any() else 0):
            found += _of_channel(tau[:, k], f'force {k + 1}')
    return found


def _is_fast(motion: EvenMotion) -> bool:
    """Return whether much of the power of a motion is near the highest frequencies."""
    f, power = periodogram(motion.q, 1.0 / motion.spacing, 'hann', detrend='linear', axis=0)
    near = power[f * motion.spacing > 0.5 * _FASTEST].sum(axis=0)
    return bool((near > _POWER * power.sum(axis=0)).any())


def _moves(q: np.ndarray) -> bool:
    """Return whether a coordinate moves by more than a few steps of its resolution, or noise."""
    # Third differences of a smooth motion are small, also of few samples a period.
    noise = float(noise_of(q[:, None])[0])
    slow = np.ptp(np.convolve(q, np.ones(5) / 5.0, 'valid'))
    return bool(slow > _STILL * max(resolution(q), 3.0 * noise))


def _of_channel(x: np.ndarray, what: str) -> Iterator[LogWarning]:
    """Yield warnings about the values of a channel that changes steadily."""
    values = np.unique(x)
    if resolution(x) > _COARSE * np.ptp(x):
        yield LogWarning(f'{what} has a coarse resolution of {resolution(x):.3g}')
        return
    if len(values) < _DISTINCT * len(x):
        return
    for limit, end in ((values[0], 'smallest'), (values[-1], 'largest')):
        # Interpolation to even times rounds.
        share = float(np.mean(np.abs(x - limit) < ROUNDED * np.ptp(x)))
        if share > _AT_END:
            yield LogWarning(f'{what} is at its {end} value, {limit:.4g}, in {share:.0%} of '
                             'the samples: it is saturated there', share > 10.0 * _AT_END)


def _of_commands(motions: Sequence[EvenMotion], tau: np.ndarray, names: Sequence[str],
                 moves: Sequence[bool]) -> Iterator[LogWarning]:
    """Yield warnings about commands that stay, or that positions do not follow."""
    if tau.shape[1] != len(names):
        yield LogWarning(f'{counted(tau.shape[1], "command")} for '
                         f'{counted(len(names), "joint")}: give one for each', True)
        return
    on = (np.abs(tau) <= LARGEST).all(axis=1)
    if not on.any():
        yield LogWarning('the motors are off in all samples', True)
        return
    changing = np.ptp(tau[on], axis=0) > 0.0
    for name, changes in zip(names, changing, strict=True):
        if not changes:
            yield LogWarning(f'{name} is commanded to one position: its stiffness is not told')
    if not changing.any():
        yield LogWarning('no command changes: command steps and slow ramps', True)
        return
    table = np.array([[_follows(motions, i, j) if moves[i] and changing[j] else (0.0, 1.0)
                       for j in range(len(names))] for i in range(len(names))])
    for k, name in enumerate(names):
        if not (moves[k] and changing[k]):
            continue
        (own, slope), best = table[k, k], int(np.argmax(table[k, :, 0]))
        if own < _FOLLOWS:
            like = f', but that of {names[best]}: check the order of the columns' \
                if table[k, best, 0] > _OTHER else ': check its column, sign and unit'
            yield LogWarning(f'{name} does not follow its command (correlation {own:.2f}){like}',
                             True)
        elif not _UNITS[0] < slope < _UNITS[1]:
            yield LogWarning(f'{name} moves {slope:.3g} times as far as its command: check the '
                             'units, rad or deg', True)


def _follows(motions: Sequence[EvenMotion], i: int, j: int) -> tuple[float, float]:
    """Return the best correlation of coordinate i with command j by delays, and the slope."""
    best = 0.0, 1.0
    for delay in range(1 + round(_LATEST / motions[0].spacing)):
        pairs = [(motion.tau[:len(motion.t) - delay, j], motion.q[delay:, i])
                 for motion in motions if len(motion.t) > delay + 2]
        r, q = map(np.concatenate, zip(*pairs, strict=True))
        on = np.abs(r) <= LARGEST
        r, q = r[on] - r[on].mean(), q[on] - q[on].mean()
        product = float(r @ q)
        if product > best[0] * (size := float(np.sqrt((r @ r) * (q @ q)))):
            best = product / size, product / float(r @ r)
    return best
