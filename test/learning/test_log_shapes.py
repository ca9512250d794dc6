# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""One log in many shapes: each is read without a configuration as it is meant, or refused."""

from collections.abc import Callable, Sequence

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning import read_motions
from hnn_vi_ros.learning.data.header import read_header
from hnn_vi_ros.learning.data.text import LogMotions
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

NOISE = 2e-3
T = 0.05 * np.arange(401)
SWING = solve_ivp(lambda _, y: [y[1], -14.0 * np.sin(y[0]) - 0.05 * y[1]], (0.0, T[-1]),
                  [0.95, 0.0], 'DOP853', T, rtol=1e-10, atol=1e-12).y
Q = SWING[0] + NOISE * np.random.default_rng(0).normal(size=len(T))
V, DEG, TURNING = SWING[1], np.degrees(Q), 5.0 * Q
U = np.sin(3.0 * T)
# Times of a slow, busy logger, and of one with a clock that jitters by a fifth of the interval.
RANDOM = np.sort(np.random.default_rng(1).uniform(0.0, 20.0, len(T)))
JITTERING = np.sort(T + np.random.default_rng(2).normal(0.0, 0.01, len(T)))
AT = np.random.default_rng(1).permutation(np.arange(5, len(T) - 5))


def rows(*columns: Sequence[object], head: str = 't,theta', mark: str = ',', end: str = '\n',
         form: str = '{:.5f}') -> str:
    """Return the text of a log."""
    lines = [mark.join(one if isinstance(one, str) else form.format(one) for one in row)
             for row in zip(*columns, strict=True)]
    return end.join([*([head] if head else []), *lines, ''])


def put(values: np.ndarray, at: np.ndarray, wrong: object) -> list[object]:
    """Return values with others at some places."""
    found = values.tolist()
    for i in at:
        found[i] = wrong(found[i]) if callable(wrong) else wrong
    return found


def at(t: np.ndarray) -> np.ndarray:
    """Return what the sensor gives at some times."""
    return CubicSpline(T, SWING[0])(t) + NOISE * np.random.default_rng(3).normal(size=len(t))


def comma(values: np.ndarray, quote: str = '') -> list[str]:
    return [f'{quote}{value:.5f}{quote}'.replace('.', ',') for value in values]


def wrapped(values: np.ndarray, low: float, turn: float) -> np.ndarray:
    return (values - low) % turn + low


# Text or bytes, and the angle that is meant.
READ: dict[str, Callable[[], tuple[str | bytes, np.ndarray]]] = {
    'plain': lambda: (rows(T, Q), Q),
    'degrees in brackets': lambda: (rows(T, DEG, head='t [s],angle [deg]'), Q),
    'degrees in the name': lambda: (rows(T, DEG, head='time,theta_deg'), Q),
    'degree sign of cp1252': lambda: (rows(T, DEG, head='t,angle (°)').encode('cp1252'), Q),
    'degree sign of UTF-8': lambda: (rows(T, DEG, head='t,angle (°)'), Q),
    'UTF-16': lambda: (rows(T, DEG, head='t,angle (°)').encode('utf-16'), Q),
    'UTF-16 without a mark': lambda: (rows(T, Q).encode('utf-16-le'), Q),
    'byte order mark': lambda: ('\ufeff' + rows(T, Q), Q),
    'milliseconds': lambda: (rows(1e3 * T, Q, head='time_ms,theta', form='{:.4f}'), Q),
    'microseconds': lambda: (rows(1e6 * T, Q, head='t [us],theta'), Q),
    'nanoseconds': lambda: (rows(1e9 * T, Q, head='stamp_ns,theta'), Q),
    'stamps since 1970': lambda: (rows(1.7e9 + T, Q, head='stamp,theta'), Q),
    'seconds and nanoseconds of ROS': lambda: (
        rows([f'{1692089273 + t // 1:.0f}' for t in T], [f'{1e9 * (t % 1.0):.0f}' for t in T], Q,
             head='header.stamp.sec,header.stamp.nanosec,theta'), Q),
    'nanoseconds beside words': lambda: (
        rows([f'{1692089273 * 10**9 + round(1e9 * t)}' for t in T], ['joint1'] * len(T), Q,
             head='time,name,theta'), Q),
    'stamps since 1970 in ms': lambda: (rows(1.7e12 + 1e3 * T, Q, head='stamp,theta'), Q),
    'semicolons and decimal commas': lambda: (rows(comma(T), comma(Q), mark=';',
                                                   head='t;theta'), Q),
    'quoted decimal commas': lambda: (rows(comma(T, '"'), comma(Q, '"')), Q),
    'tabs and decimal commas': lambda: (rows(comma(T), comma(Q), mark='\t', head='t\ttheta'), Q),
    'tabs': lambda: (rows(T, Q, mark='\t', head='t\ttheta'), Q),
    'spaces': lambda: (rows(T, Q, mark='   ', head='t   theta'), Q),
    'quoted': lambda: (rows(T, Q, head='"t","theta"', form='"{:.5f}"'), Q),
    'carriage returns': lambda: (rows(T, Q, end='\r\n'), Q),
    'trailing separators': lambda: (rows(T, Q, [''] * len(T), head='t,theta,'), Q),
    'trailing separators in rows alone': lambda: (rows(T, Q, [''] * len(T)), Q),
    'empty lines': lambda: (rows(T, Q, end='\n\n'), Q),
    'comments': lambda: ('# by hand\n# rig 3\n' + rows(T, Q), Q),
    'header in a comment': lambda: (rows(T, Q, head='# t theta', mark=' '), Q),
    'header in a comment with other spaces': lambda: (rows(T, Q, head='# t theta'), Q),
    'text above': lambda: ('Logger 2.1\nRate:,100\n\n' + rows(T, Q), Q),
    'units in a row': lambda: (rows(T, DEG, head='t,angle\ns,deg'), Q),
    'units in a row of brackets': lambda: (rows(T, DEG, head='t,angle\n[s],[°]'), Q),
    'sentinels': lambda: (rows(T, put(DEG, AT[:26], -999.0), head='t,theta_deg'), Q),
    'sentinels of sixteen bits': lambda: (rows(T, put(DEG, AT[:9], 32767.0),
                                               head='t,theta_deg'), Q),
    'glitches': lambda: (rows(T, put(Q, AT[:9], lambda q: q + 2.9)), Q),
    'words for nothing': lambda: (rows(T, put(Q, AT[:9], 'NaN')), Q),
    'empty fields': lambda: (rows(T, put(Q, AT[:9], '')), Q),
    'N/A': lambda: (rows(T, put(Q, AT[:9], 'N/A')), Q),
    'stuck': lambda: (rows(T, np.where((T > 5.0) & (T < 5.4), Q[101], Q), form='{:.6f}'), Q),
    'held': lambda: (rows(0.01 * np.arange(5 * len(T)), np.repeat(Q, 5)), Q),
    'truncated': lambda: (rows(T, Q)[:-6], Q),
    'truncated in a line': lambda: (rows(T, Q)[:-9], Q),
    'truncated after a line': lambda: (rows(T, Q) + '2', Q),
    'no last line end': lambda: (rows(T, Q)[:-1], Q),
    'times that come twice': lambda: (rows(*np.repeat([T, Q], np.where(T == 5.0, 2, 1), 1)), Q),
    'late samples': lambda: (rows(put(T, AT[:5], lambda t: t - 1.0), Q), Q),
    'gap': lambda: (rows(*np.array([T, Q])[:, (T < 5.0) | (T > 5.3)]), Q),
    'random times': lambda: (rows(RANDOM, at(RANDOM)), Q),
    'jittering clock': lambda: (rows(JITTERING, at(JITTERING)), Q),
    'two rates': lambda: ((lambda t: rows(t, at(t)))(np.concatenate(
        [T[:200], 10.0 + 0.02 * np.arange(500)])), Q),
    'time in minutes': lambda: (rows(T / 60.0, Q, head='time [min],theta', form='{:.8f}'), Q),
    'filtered beside measured': lambda: (rows(T, Q, 0.9 * Q, head='t,theta,theta_filtered'), Q),
    'reference beside measured': lambda: (rows(T, Q, U, head='t,theta,theta_ref'), Q),
    'index of pandas': lambda: (rows([f'{k}' for k in range(len(T))], T, Q, head=',t,theta'), Q),
    'zeros in place of values': lambda: (rows(T, put(Q, AT[:26], 0.0)), Q),
    'zeros in place of times': lambda: (rows(put(T, AT[:5], 0.0), Q), Q),
    'sentinels of a force': lambda: (rows(T, Q, V, put(U, AT[:9], -999.0),
                                          head='t,theta,omega,tau'), Q),
    'exponents': lambda: (rows(T, Q, form='{:.6e}'), Q),
    'stuck at the end': lambda: (rows(T, np.where(T > 19.42, Q[388], Q), form='{:.6f}'), Q),
    'wrapped at 180 degrees': lambda: (rows(T, wrapped(np.degrees(TURNING), -180.0, 360.0)),
                                       TURNING),
    'wrapped at 360 degrees': lambda: (rows(T, wrapped(np.degrees(TURNING), 0.0, 360.0),
                                            head='t,angle [deg]'), TURNING),
    'wrapped at two pi': lambda: (rows(T, wrapped(TURNING, 0.0, 2.0 * np.pi)), TURNING),
    'large angle': lambda: (rows(T, 3.0 * Q), 3.0 * Q),
    'wrapped at pi': lambda: (rows(T, wrapped(TURNING, -np.pi, 2.0 * np.pi)), TURNING),
    'without a header, wrapped': lambda: (rows(T, wrapped(np.degrees(TURNING), 0.0, 360.0),
                                               head=''), TURNING),
    'constant columns': lambda: (rows(T, Q, 0.0 * T, 0.0 * T + 3.0,
                                      head='t,theta,phi,temperature'), Q),
    'text columns': lambda: (rows(T, Q, ['ok'] * len(T), head='t,theta,status'), Q),
    'sample numbers': lambda: (rows(np.arange(len(T)), T, Q, head='sample,t,theta'), Q),
    'velocity': lambda: (rows(T, Q, V, head='t,theta,omega'), Q),
    'velocity in degrees': lambda: (rows(T, DEG, np.degrees(V), head='t,theta_deg,omega'), Q),
    'q and dq': lambda: (rows(T, Q, V, U, head='t,q,dq,tau'), Q),
    'millimetres': lambda: (rows(T, 1e3 * Q, head='t,x_mm'), Q),
    'joint states': lambda: (rows(
        T, Q, V, U, head='/time,/joint_states/arm/position,/joint_states/arm/velocity,'
        '/joint_states/arm/effort'), Q),
}
REFUSED: dict[str, Callable[[], str | bytes]] = {
    'without a header': lambda: rows(T, Q, head=''),
    'angle of a range for degrees or radians': lambda: rows(T, DEG),
    'angle of a small swing in degrees': lambda: rows(T, DEG / 11.0),
    'length of a range for m or mm': lambda: rows(T, 1e3 * Q, head='t,x'),
    'angle or length': lambda: rows(T, Q, head='t,q'),
    'milliseconds without a unit': lambda: rows(1e3 * T, Q),
    'decimal commas between commas': lambda: rows(comma(T), comma(Q)),
    'points and commas': lambda: rows(comma(T), Q, mark=';', head='t;theta'),
    'separators of thousands': lambda: rows(T, [f'"{1e5 * (q + 2):,.1f}"' for q in Q],
                                            head='t,x [mm]'),
    'many glitches': lambda: rows(T, put(Q, AT[:90], lambda q: q + 2.9), head='t,theta [rad]'),
    'stuck at the start': lambda: rows(T, np.where(T < 2.5, Q[50], Q), form='{:.6f}'),
    'stuck for seconds': lambda: rows(T, np.where((T > 5.0) & (T < 9.0), Q[101], Q)),
    'cosine': lambda: rows(T, np.cos(Q), head='t,cos_theta'),
    'velocity of another sign': lambda: rows(T, Q, -V, head='t,theta,omega'),
    'current and torque': lambda: rows(T, Q, U, V, head='t,theta,current [A],torque [Nm]'),
    'channels in rows': lambda: rows(*[['t', 'theta'], *np.array([T, Q]).T], head=''),
    'JSON': lambda: rows([f'{{"t": {t}, "theta": {q}}}' for t, q in zip(T, Q, strict=True)],
                         head=''),
    'whole seconds': lambda: rows(np.floor(T), Q),
    'whole seconds in a column with a unit': lambda: rows(np.floor(T), Q, head='t [s],theta'),
    'two motions in one': lambda: rows(0.01 * np.arange(2 * len(T)), np.concatenate([
        np.sin(0.6 * T), np.sin(0.6 * T + 2.0)])),
    'times that never increase': lambda: rows(T[::-1], Q),
    'no times': lambda: rows(Q, V, head='theta,omega'),
    'a column twice': lambda: rows(T, DEG, Q, head='t,theta_deg,theta_rad'),
    'a row too short': lambda: rows(T, Q).replace(f'\n{T[9]:.5f},', f'\n{T[9]:.5f};'),
    'a sheet': lambda: b'PK\x03\x04' + bytes(range(256)) * 9,
    'dates': lambda: rows([f'2026-01-01 10:00:{t:08.5f}' for t in T], Q),
    'nothing': lambda: 't,theta\n',
}


def read(path, coordinates=()):
    reading = read_header(path, coordinates)
    data = LogMotions.model_validate(reading.data)
    units = [one['q_unit'] for one in reading.configuration['coordinates']]
    return read_motions(path, data, units, [str(path)], units)


@pytest.mark.parametrize('shape', READ)
def test_log_is_read_as_it_is_meant(tmp_path, shape):
    text, expected = READ[shape]()
    path = tmp_path / 'log.csv'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    found, description = read(path)
    # Six standard deviations, and a cubic spline that bridges 0.45 s of a motion of at most 3.8
    # rad/s of phase: 5 / 384 (0.45 3.8)^4. Wrapped angles begin in any turn, and times anywhere.
    scale = np.ptp(expected) / np.ptp(Q)
    for motion in found:
        t = motion.t - (motion.t[0] if motion.t[0] > 1e6 else 0.0)
        error = motion.q[:, 0] - np.interp(t, T, expected)
        error -= 2.0 * np.pi * np.round(error[0] / (2.0 * np.pi))
        assert np.abs(error).max() < scale * (6.0 * NOISE + 5.0 / 384.0 * (0.45 * 3.8)**4)
    assert sum(len(motion.t) for motion in found) > 380, description


@pytest.mark.parametrize('shape', REFUSED)
def test_log_of_two_readings_or_none_is_refused_in_a_line(tmp_path, shape):
    text = REFUSED[shape]()
    path = tmp_path / 'log.csv'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with refused(DataError):
        read(path)
